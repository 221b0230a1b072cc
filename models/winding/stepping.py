"""One time step of the reference mode, and how long it may be.

Central differences in time (leapfrog: positions at whole, velocities at half steps), lumped masses. Node 0 is the
yarn's head, tied to the bobbin; numbers rise towards the feed. With the active feed new nodes enter upstream of a fixed
eyelet at the tension T₀ + ρc (u − ū), u the speed of the last node, ū its running mean: waves leave without echo. With
the tail all nodes are there from the start.

Sources: Belytschko, Liu, Moran, Nonlinear Finite Elements for Continua and Structures, chapter 6 (explicit integration,
its limit with damping, energy balance); the bulk viscosity is the linear one that is usual in explicit codes, 0.06.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, inner
from models.winding.contact import (
    HARDENED,
    Bobbin,
    Crossing,
    Grip,
    Pairs,
    bobbin_contact,
    eye_contact,
    find_pairs,
    pair_contact,
)
from models.winding.drive import travel, traverse
from models.winding.rod import (
    Material,
    Rod,
    bending_energy,
    internal_forces,
    kinetic_energy,
    push,
    relax,
    strain_energy,
    stretch,
)
from models.winding.scene import WindingScene

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BULK_VISCOSITY = 0.06
"""Damping over critical of the shortest axial wave."""
EYE = 0.25
"""Stiffness of the eyes, in EA/L₀: the yarn presses about 10 µm into the guide."""
REBUILD = 64
"""Steps between searches for pairs of elements that may touch."""
MARGIN = 0.25e-3
"""Distance beyond touching at which a pair is listed [m]: yarn would have to close in at 3 m/s to be missed."""
FEED_RUN = 6
"""Elements upstream of the eyelet."""
PROBE_MARGIN = 3
"""Elements left out of the span's mean next to the bobbin and to the guide."""
SEARCHED = 0.015
"""Length of the span next to the bobbin that is searched for contact [m]: further out it is 3 mm above the surface."""

_travel = inner(travel)
_traverse = inner(traverse)


class Machine(NamedTuple):
    """Constants of drive, guide, feed and time, SI."""

    dt: float
    mass: float
    speed: float
    rise: float
    speed_slope: float
    pull: float
    pull_slope: float
    turning: float
    """Angle of the bobbin per travel of the yarn [rad/m]."""
    per_cycle: float
    """Angle of the bobbin per guide cycle [rad]."""
    stroke: float
    reversal: float
    guide: float
    """x of the guide's plane [m]."""
    eyelet: float
    """x of the feed's eyelet [m]."""
    top: float
    """y of the straight yarn [m]."""
    clearance: float
    friction: float
    active: bool
    impedance: float
    memory: float


NODES, STEP, AT_GUIDE, AT_EYELET, LAID, PAIRS, WORK = range(7)
"""Places in `State.counts`: nodes, steps done, elements in the two eyes, first node not yet laid, pairs, and element
steps."""
(BOBBIN_WORK, GUIDE_WORK, FEED_WORK, VISCOUS, DAMPED, RUBBED, HANDED, DRIFT, SPAN, DEEPEST) = range(10)
"""Places in `State.sums`: energies [J], running mean of u − V [m/s], mean tension of the span over the last call [N],
deepest approach of yarns in the last step [m]."""
KINETIC, STRAIN, BENDING, CONTACT = range(4)
"""Places in `State.energies`."""
GOING, DIVERGED, SPENT, FULL = range(4)
"""How a call of `advance` ended: on time, no longer finite, no tail left, arrays too small."""


class State(NamedTuple):
    """All that changes during a run."""

    rod: Rod
    grip: Grip
    pairs: Pairs
    spare: Pairs
    """Room for the search for pairs."""
    landed: Array
    """Guide phase at which each node was laid [cycles], shape (room,)."""
    counts: Integers
    sums: Array
    energies: Array
    """In the last step of the last call [J]."""


class Setup(NamedTuple):
    """All that stays."""

    material: Material
    bobbin: Bobbin
    crossing: Crossing
    machine: Machine
    weights: Array
    """Prony weights, shape (branches,)."""
    times: Array
    """Prony times [s]."""


@inner
def _element_at(rod: Rod, start: int, plane: float, n: int) -> int:
    """The element that crosses the plane x = `plane`, searched from element `start` on; n − 3 if beyond."""
    j = start
    while j < n - 3 and rod.x[j + 1] > plane:
        j += 1
    while j > 1 and rod.x[j] <= plane:
        j -= 1
    return j


@inner
def _finite(rod: Rod, n: int) -> bool:
    """Whether no node has left for infinity: 100 m off the axis, across or along."""
    far = 0
    for i in range(n):
        if not (abs(rod.y[i]) < 100.0 and abs(rod.z[i]) < 100.0 and rod.x[i] < 100.0):
            far += 1
    return far == 0


@inner
def _relax_and_search(s: State, c: Setup) -> int:
    """Every `REBUILD` steps: let the yarn relax and list the pairs that may touch; GOING or why not."""
    n, natural = s.counts[NODES], c.material.natural
    if not _finite(s.rod, n):
        return DIVERGED
    shares = 1 - np.exp(-REBUILD * c.machine.dt / c.times)
    s.sums[VISCOUS] += relax(s.rod, c.material, n, c.weights, shares)
    tested = min(s.counts[LAID] + int(SEARCHED / natural) + 1, n - 1)
    reach = 1.05 * natural + c.crossing.diameter + MARGIN
    s.counts[PAIRS] = find_pairs(s.rod, s.pairs, s.counts[PAIRS], s.spare, MARGIN, c.crossing.diameter, tested, reach)
    return GOING if s.counts[PAIRS] >= 0 else FULL


@inner
def _contacts(s: State, c: Setup, angle: float, spin: float, place: float, speed: float) -> float:
    """Forces of guide, eyelet, yarn and bobbin on the yarn, their works and losses; the energy stored in them [J]."""
    rod, m, dt, sums = s.rod, c.machine, c.machine.dt, s.sums
    cosine, sine = math.cos(angle), math.sin(angle)
    stiffness = EYE * c.material.axial / c.material.natural
    creep = 0.01 * m.speed
    power, lost, total = eye_contact(
        rod, s.counts[AT_GUIDE], m.guide, m.top, place, speed, m.clearance, stiffness, m.friction, creep
    )
    sums[GUIDE_WORK] += power * dt
    sums[RUBBED] += lost * dt
    if m.active:
        _, _, stored = eye_contact(rod, s.counts[AT_EYELET], m.eyelet, m.top, 0.0, 0.0, 0.0, stiffness, 0.0, creep)
        total += stored
    power, damped, rubbed, handed, stored, deepest = pair_contact(
        rod, s.pairs, s.counts[PAIRS], c.crossing, cosine, sine, spin, dt
    )
    sums[BOBBIN_WORK] += power * dt
    sums[DAMPED] += damped * dt
    sums[RUBBED] += rubbed
    sums[HANDED] += handed
    sums[DEEPEST] = deepest
    total += stored
    power, damped, released, stored = bobbin_contact(rod, s.grip, c.bobbin, s.counts[AT_GUIDE], cosine, sine, spin)
    sums[BOBBIN_WORK] += power * dt
    sums[DAMPED] += damped * dt + released
    return total + stored


@inner
def _pull_end(s: State, m: Machine, time: float, speed: float) -> float:
    """Force of the feed on the last node: matched, along its line, or that of the tail's free end; the tension [N]."""
    rod, sums = s.rod, s.sums
    end = s.counts[NODES] - 1
    pull = m.pull + m.pull_slope * time
    old = rod.vx[end]
    if m.active:
        pull -= m.impedance * (speed + sums[DRIFT])
        # Midpoint rule for the dashpot, which alone would bring the time step's limit down.
        new = (old * (m.mass / m.dt - m.impedance / 2) + rod.fx[end] - pull) / (m.mass / m.dt + m.impedance / 2)
        pull += m.impedance * (old + new) / 2
        sums[DRIFT] += m.dt / m.memory * (new - speed - sums[DRIFT])
        rod.fy[end], rod.fz[end] = 0.0, 0.0
    rod.fx[end] -= pull
    sums[FEED_WORK] -= pull * (old + rod.fx[end] * m.dt / m.mass / 2) * m.dt
    return pull


@inner
def _feed_in(s: State, c: Setup, pull: float) -> bool:
    """Add a node behind the last at the tension `pull` [N] once there is room for it; False if the arrays are full."""
    rod, m, end = s.rod, c.machine, s.counts[NODES] - 1
    if rod.x[end] < m.eyelet - (FEED_RUN - 1) * c.material.natural:
        return True
    n = end + 1
    if n >= rod.x.shape[0]:
        return False
    strain = pull / c.material.axial
    rod.x[n], rod.y[n], rod.z[n] = rod.x[end] - c.material.natural * (1 + strain), m.top, 0.0
    rod.vx[n] = rod.vx[end]
    s.sums[FEED_WORK] += m.mass / 2 * rod.vx[end] ** 2
    s.sums[FEED_WORK] += c.material.axial * c.material.natural / 2 * strain * strain
    s.counts[NODES] += 1
    return True


@inner
def _move_head(s: State, m: Machine, angle: float) -> None:
    """Move node 0 to its place on the bobbin at the end of the step."""
    rod, grip, dt = s.rod, s.grip, m.dt
    cosine, sine = math.cos(angle), math.sin(angle)
    x, y = cosine * grip.x[0] + sine * grip.y[0], cosine * grip.y[0] - sine * grip.x[0]
    wx, wy, wz = (x - rod.x[0]) / dt, (y - rod.y[0]) / dt, (grip.z[0] - rod.z[0]) / dt
    ux, uy, uz = rod.vx[0], rod.vy[0], rod.vz[0]
    work = (m.mass * (wx - ux) / dt - rod.fx[0]) * (ux + wx)
    work += (m.mass * (wy - uy) / dt - rod.fy[0]) * (uy + wy)
    work += (m.mass * (wz - uz) / dt - rod.fz[0]) * (uz + wz)
    s.sums[BOBBIN_WORK] += work * dt / 2
    rod.x[0], rod.y[0], rod.z[0] = x, y, grip.z[0]
    rod.vx[0], rod.vy[0], rod.vz[0] = wx, wy, wz


@inner
def _span_tension(s: State) -> float:
    """Mean over the elements between bobbin and guide [N]: by number, so that no laid yarn is among them."""
    total = 0.0
    first, last = s.counts[LAID] + PROBE_MARGIN, s.counts[AT_GUIDE] - PROBE_MARGIN
    for i in range(first, last):
        total += s.rod.tension[i]
    return total / (last - first)


@compiled
def advance(s: State, c: Setup, steps: int) -> int:
    """Advance by `steps` time steps, or until something ends the run: GOING or one of the codes beside it."""
    rod, counts, m, dt = s.rod, s.counts, c.machine, c.machine.dt
    s.sums[SPAN] = 0.0
    for done in range(steps):
        n = counts[NODES]
        time = counts[STEP] * dt
        way, speed = _travel(time, m.speed, m.rise, m.speed_slope)
        angle, spin = way * m.turning, speed * m.turning
        place, steep = _traverse(angle / m.per_cycle, m.reversal)

        s.sums[VISCOUS] += stretch(rod, c.material, n, dt)
        if counts[STEP] % REBUILD == 0:
            code = _relax_and_search(s, c)
            if code != GOING:
                return code
        internal_forces(rod, c.material, n)
        counts[AT_GUIDE] = _element_at(rod, counts[AT_GUIDE], m.guide, n)
        counts[AT_EYELET] = _element_at(rod, counts[AT_EYELET], m.eyelet, n)
        if counts[AT_GUIDE] >= n - 3:
            return SPENT
        while rod.x[counts[LAID]] >= 0.0 and counts[LAID] < counts[AT_GUIDE] - 2 * PROBE_MARGIN - 1:
            s.landed[counts[LAID]] = angle / m.per_cycle
            counts[LAID] += 1
        contact = _contacts(s, c, angle, spin, m.stroke * place, m.stroke * steep * spin / m.per_cycle)
        s.sums[SPAN] += _span_tension(s) / steps
        pull = _pull_end(s, m, time, speed)

        last = done == steps - 1
        if last:
            s.energies[KINETIC] = kinetic_energy(rod, m.mass, n) / 2
            s.energies[STRAIN] = strain_energy(rod, c.material, c.weights, n)
            s.energies[BENDING] = bending_energy(rod, c.material, n)
            s.energies[CONTACT] = contact
        _move_head(s, m, _travel(time + dt, m.speed, m.rise, m.speed_slope)[0] * m.turning)
        push(rod, 1, n, m.mass, dt)
        if last:
            s.energies[KINETIC] += kinetic_energy(rod, m.mass, n) / 2
        counts[STEP] += 1
        counts[WORK] += n - 1
        if m.active and not _feed_in(s, c, pull):
            return FULL
    return GOING


def grip_stiffness(scene: WindingScene) -> float:
    """Stiffness of a node's grip on the bobbin [N/m]: K_g L₀."""
    return scene.axial_stiffness * scene.element_length / scene.grip_length**2


def time_step_limit(scene: WindingScene) -> float:
    """Largest stable time step of the reference mode [s].

    2/ω (√(1 + ξ²) − ξ) with the highest frequency ω of a mesh of lumped masses and its damping ratio ξ, for axial
    waves with the grips and for transverse motion with bending, tension and every contact that may act at once.
    """
    length, mass = scene.element_length, scene.linear_density * scene.element_length
    unit = scene.axial_stiffness / length
    # The bobbin, and yarn on both sides that is as hard as it gets; each yarn's half of K_t times its slope.
    contact = (1 + 1 / (1 - HARDENED) ** 2) * scene.transverse_stiffness * length
    damping = scene.contact_damping
    grip = grip_stiffness(scene)
    axial = 4 * unit + grip
    axial_damping = 4 * BULK_VISCOSITY * scene.impedance + 2 * damping * math.sqrt(grip * mass)
    across = 16 * scene.bending_stiffness / length**3 + 4 * scene.tension / length + EYE * unit + contact
    across_damping = 2 * damping * math.sqrt(contact * mass)

    def limit(stiffness: float, viscosity: float) -> float:
        ratio = viscosity / (2 * math.sqrt(stiffness * mass))
        return 2 * math.sqrt(mass / stiffness) * (math.sqrt(1 + ratio**2) - ratio)

    return min(limit(axial, axial_damping), limit(across, across_damping))
