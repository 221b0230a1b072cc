"""Reference mode: explicit dynamics of the yarn from the feed to the package, which stays live to its first node.

Node 0 is the yarn's head, tied to the bobbin; numbers rise towards the feed. Central differences in time (leapfrog:
positions at whole, velocities at half steps), lumped masses. With the active feed new nodes enter upstream of a fixed
eyelet at the tension T₀ + ρc (u − ū), u the speed of the last node, ū its running mean: waves leave without echo. With
the tail all nodes are there from the start.

Sources: Belytschko, Liu, Moran, Nonlinear Finite Elements for Continua and Structures, chapter 6 (explicit integration,
its limit with damping, energy balance); the bulk viscosity is the linear one that is usual in explicit codes, 0.06.
"""

import math
from time import perf_counter
from typing import Any, NamedTuple

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
    new_grip,
    new_pairs,
    pair_contact,
)
from models.winding.drive import travel, traverse
from models.winding.result import Checkpoint, EnergyLedger, Kept, Progress, Snapshot, WindingOutcome, WindingResult
from models.winding.rod import (
    Material,
    Rod,
    bending_energy,
    internal_forces,
    kinetic_energy,
    new_rod,
    push,
    relax,
    strain_energy,
    stretch,
)
from models.winding.sampling import SAMPLE_INTERVAL, SHOWN_LAYERS, layer_means, sample_times
from models.winding.scene import WindingScene

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BULK_VISCOSITY = 0.06
"""Damping over critical of the shortest axial wave."""
GRIP = 0.25
"""Stiffness of a node's grip on the bobbin, in EA/L₀: a penalty for no slip, tension is passed on over 2 L₀."""
EYE = 0.25
"""Stiffness of the eyes, in EA/L₀: the yarn presses about 10 µm into the guide."""
SAFETY = 0.9
"""Share of the limit of stability that is used."""
REBUILD = 64
"""Steps between searches for pairs of elements that may touch."""
MARGIN = 0.25e-3
"""Distance beyond touching at which a pair is listed [m]: yarn would have to close in at 3 m/s to be missed."""
FEED_RUN = 6
"""Elements upstream of the eyelet."""
PROBE_MARGIN = 3
"""Elements left out of the span's mean next to the bobbin and to the guide."""
CHECKPOINT_INTERVAL = 20.0
"""[s] of computation."""
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
    axial = (4 + GRIP) * unit
    axial_damping = 4 * BULK_VISCOSITY * scene.impedance + 2 * damping * math.sqrt(GRIP * unit * mass)
    across = 16 * scene.bending_stiffness / length**3 + 4 * scene.tension / length + EYE * unit + contact
    across_damping = 2 * damping * math.sqrt(contact * mass)

    def limit(stiffness: float, viscosity: float) -> float:
        ratio = viscosity / (2 * math.sqrt(stiffness * mass))
        return 2 * math.sqrt(mass / stiffness) * (math.sqrt(1 + ratio**2) - ratio)

    return min(limit(axial, axial_damping), limit(across, across_damping))


class Run:
    """The state of a reference run."""

    def __init__(self, scene: WindingScene, steps_per_sample: int) -> None:
        self.scene = scene
        self.steps_per_sample = steps_per_sample
        natural, diameter = scene.element_length, scene.diameter
        mass = scene.linear_density * natural
        taper = math.tan(scene.cone_angle)
        surface = scene.transverse_stiffness * natural
        grip = GRIP * scene.axial_stiffness / natural
        active = scene.feed == "active"
        top = scene.bobbin_radius + diameter / 2 / math.cos(scene.cone_angle) - taper * scene.stroke / 2
        material = Material(natural, scene.axial_stiffness, scene.bending_stiffness, BULK_VISCOSITY * scene.impedance)
        bobbin = Bobbin(
            radius=scene.bobbin_radius + diameter / 2 / math.cos(scene.cone_angle),
            taper=taper,
            stiffness=surface,
            damping=2 * scene.contact_damping * math.sqrt(surface * mass),
            grip=grip,
            grip_damping=2 * scene.contact_damping * math.sqrt(grip * mass),
        )
        crossing = Crossing(
            diameter=diameter,
            surface=scene.transverse_stiffness,
            element=natural,
            mass=mass,
            damping=scene.contact_damping,
            static=scene.friction_static,
            dynamic=scene.friction_dynamic,
        )
        machine = Machine(
            dt=SAMPLE_INTERVAL / steps_per_sample,
            mass=mass,
            speed=scene.speed,
            rise=scene.speed_rise,
            speed_slope=scene.speed_slope,
            pull=scene.tension,
            pull_slope=scene.tension_slope,
            turning=math.cos(scene.winding_angle) / scene.bobbin_radius,
            per_cycle=2 * math.pi * scene.turns_per_cycle,
            stroke=scene.stroke,
            reversal=scene.reversal,
            guide=-scene.guide_distance,
            eyelet=-scene.guide_distance - scene.feed_length,
            top=top,
            clearance=scene.guide_clearance,
            friction=scene.guide_friction,
            active=active,
            impedance=scene.impedance,
            memory=scene.feed_memory,
        )
        weights, times = np.array(scene.prony_weights), np.array(scene.prony_times)
        self.setup = Setup(material, bobbin, crossing, machine, weights, times)
        self._thread()

    def _thread(self) -> None:
        """Yarn at rest from the top of the bobbin through the guide to the feed, stretched by T₀."""
        scene, machine = self.scene, self.setup.machine
        spacing = scene.element_length * (1 + scene.tension / scene.axial_stiffness)
        start = -scene.stroke / 2
        corners_x = [0.0, machine.guide, machine.eyelet]
        corners_z = [start, start, 0.0 if machine.active else start]
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(corners_x), np.diff(corners_z)))])
        nodes = int(arc[-1] / spacing) + (FEED_RUN if machine.active else 1)
        room = nodes + (int(1.03 * scene.wound_length / scene.element_length) + 100 if machine.active else 0)
        places = spacing * np.arange(nodes)
        rod, grip, counts = new_rod(room, len(scene.prony_weights)), new_grip(room), np.zeros(7, np.int64)
        rod.x[:nodes] = np.interp(places, arc, corners_x) - np.maximum(places - arc[-1], 0.0)
        rod.y[:nodes] = machine.top
        rod.z[:nodes] = np.interp(places, arc, corners_z)
        grip.held[0], grip.y[0], grip.z[0] = 1, machine.top, start
        counts[[NODES, AT_GUIDE, AT_EYELET, LAID]] = nodes, 1, 1, 1
        pairs = 4 * room + 1000
        self.state = State(
            rod, grip, new_pairs(pairs), new_pairs(pairs), np.zeros(room), counts, np.zeros(10), np.zeros(4)
        )
        self.span: list[float] = []
        self.ledger = [np.concatenate([[0.0], self._start_energies(nodes), np.zeros(7)])]
        self.snapshots: list[Snapshot] = []

    def _start_energies(self, nodes: int) -> Array:
        """Kinetic, strain, bending and contact energy [J] before the first step."""
        m, rod = self.setup.material, self.state.rod
        edge = np.diff(np.stack([rod.x[:nodes], rod.y[:nodes], rod.z[:nodes]]))
        length = np.linalg.norm(edge, axis=0)
        turn = np.diff(edge / length)
        strain = m.axial * m.natural / 2 * np.sum((length / m.natural - 1) ** 2)
        return np.array([0.0, strain, m.bending / m.natural / 2 * np.sum(turn**2), 0.0])

    def advance(self, steps: int) -> int:
        """Take `steps` steps; GOING or why it stopped."""
        return advance(self.state, self.setup, steps)

    @property
    def time(self) -> float:
        """[s]."""
        return float(self.state.counts[STEP]) * self.setup.machine.dt

    def phase(self, time: float) -> float:
        """Guide cycles since the start."""
        m = self.setup.machine
        return travel(time, m.speed, m.rise, m.speed_slope)[0] * m.turning / m.per_cycle

    def snapshot(self) -> Snapshot:
        """The laid yarn now, in the bobbin's frame."""
        rod, laid = self.state.rod, int(self.state.counts[LAID])
        laid = laid if laid > 1 else 0  # one node is no yarn yet
        angle = self.phase(self.time) * self.setup.machine.per_cycle
        x, y = rod.x[:laid], rod.y[:laid]
        before = rod.tension[: max(laid - 1, 0)]
        return Snapshot(
            time=self.time,
            layer=np.floor(self.state.landed[:laid]).astype(np.int64) + 1,
            position=np.column_stack(
                [
                    math.cos(angle) * x - math.sin(angle) * y,
                    math.sin(angle) * x + math.cos(angle) * y,
                    rod.z[:laid],
                ]
            ),
            tension=np.concatenate([before[:1], (before[1:] + before[:-1]) / 2, before[-1:]]),
        )

    def sample(self) -> int:
        """Advance by one sample; GOING or why it stopped."""
        code = self.advance(self.steps_per_sample)
        sums, energies = self.state.sums, self.state.energies
        if code == GOING and not (math.isfinite(sums[SPAN]) and np.all(np.isfinite(energies))):
            return DIVERGED
        if code == GOING:
            self.span.append(float(sums[SPAN]))
            self.ledger.append(np.concatenate([[self.time], energies, sums[:DRIFT]]))
            done = self.phase(self.time)
            if any(self.phase(self.time - SAMPLE_INTERVAL) < layer <= done for layer in SHOWN_LAYERS):
                self.snapshots.append(self.snapshot())
        return code

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of the state, by name."""
        s = self.state
        arrays: dict[str, NDArray[Any]] = {
            "landed": s.landed,
            "counts": s.counts,
            "sums": s.sums,
            "energies": s.energies,
        }
        for group in (s.rod, s.grip, s.pairs):
            arrays |= {f"{type(group).__name__}.{name}": array for name, array in group._asdict().items()}
        return arrays

    def save(self) -> Kept:
        """Everything that `load` needs to go on, bit by bit, as if the run had not stopped."""
        kept = {name: array.copy() for name, array in self._arrays().items()}
        kept |= {"span": np.array(self.span), "ledger": np.array(self.ledger)}
        for k, shot in enumerate(self.snapshots):
            kept |= {f"snapshot{k}.{name}": np.asarray(getattr(shot, name)) for name in SNAPSHOT}
        return kept

    def load(self, kept: Kept) -> None:
        """Go on from `kept`.

        Raises
        ------
        ValueError
            If it belongs to another scene, as far as its array sizes and its time show.
        """
        arrays = self._arrays()
        steps = self.steps_per_sample * len(kept["span"])
        if kept["Rod.x"].shape != self.state.rod.x.shape or int(kept["counts"][STEP]) != steps:
            raise ValueError("checkpoint: belongs to another scene or time step; remove it to start anew")
        for name, array in arrays.items():
            array[...] = kept[name]
        self.span = [float(x) for x in kept["span"]]
        self.ledger = list(kept["ledger"])
        self.snapshots = []
        while f"snapshot{len(self.snapshots)}.time" in kept:
            time, layer, position, tension = (kept[f"snapshot{len(self.snapshots)}.{name}"] for name in SNAPSHOT)
            self.snapshots.append(Snapshot(float(time), layer, position, tension))


SNAPSHOT = ("time", "layer", "position", "tension")
OUTCOMES = {
    GOING: WindingOutcome.COMPLETED,
    DIVERGED: WindingOutcome.DIVERGED,
    SPENT: WindingOutcome.TAIL_SPENT,
}


def wind_reference(
    scene: WindingScene, reason: str, progress: Progress | None = None, checkpoint: Checkpoint | None = None
) -> WindingResult:
    """Run `scene` in the reference mode; see `wind`.

    Parameters
    ----------
    reason : why this mode, kept in the result.
    """
    limit = time_step_limit(scene)
    step = SAFETY * limit if scene.time_step is None else scene.time_step
    if step > limit:
        outcome = WindingOutcome.TIME_STEP
        message = f"time_step = {step:.4g} s: {outcome.value}; the limit of this scene is {limit:.4g} s"
        return WindingResult(scene, "reference", reason, outcome, message, time_step=step, time_step_limit=limit)
    run = Run(scene, math.ceil(SAMPLE_INTERVAL / step))
    run.advance(0)  # compiles, outside the time taken
    begin = perf_counter()
    state = checkpoint.load() if checkpoint is not None else None
    if state is not None:
        run.load(state)
    ends = sample_times(scene)
    code, kept = GOING, perf_counter()
    # A step of a node costs the same wherever it is, and nodes grow with the yarn laid: the work done rises with both.
    start, full = float(run.state.counts[NODES]), len(ends)
    rise = scene.wound_length / scene.element_length / full if scene.feed == "active" else 0.0
    while len(run.span) < full and code == GOING:
        code = run.sample()
        if progress is not None:
            k = len(run.span)
            progress(k * (start + rise * k / 2) / (full * (start + rise * full / 2)))
        if checkpoint is not None and perf_counter() - kept > CHECKPOINT_INTERVAL:
            checkpoint.save(run.save())
            kept = perf_counter()
    if code == FULL:
        raise RuntimeError("the arrays of the run were sized too small for its nodes or pairs")
    if checkpoint is not None and code == GOING:
        checkpoint.save(run.save())
    outcome = OUTCOMES[code]
    m, bobbin = run.setup.machine, run.setup.bobbin
    done = ends[: len(run.span)]
    phase = np.array([run.phase(t) for t in done])
    end = run.snapshot()
    pull = scene.tension + scene.tension_slope * end.time
    ledger = EnergyLedger(*np.array(run.ledger).T)
    depth = bobbin.radius + bobbin.taper * end.position[:, 2] - np.hypot(*end.position[:, :2].T)
    return WindingResult(
        scene=scene,
        mode="reference",
        mode_reason=reason,
        outcome=outcome,
        message="" if outcome.ok else f"{outcome.value} (at t = {run.time:.4g} s)",
        time=done,
        span_tension=np.array(run.span),
        guide_phase=phase,
        guide_position=np.array([m.stroke * traverse(p, m.reversal)[0] for p in phase]),
        layers_T_over_T0=layer_means(end.layer, end.tension / pull, math.floor(run.phase(run.time))),
        snapshots=(*run.snapshots, end),
        energy=ledger,
        penetration_max=float(depth.max(initial=run.state.sums[DEEPEST])),
        time_step=m.dt,
        time_step_limit=limit,
        element_steps=int(run.state.counts[WORK]),
        wall_s=perf_counter() - begin,
    )
