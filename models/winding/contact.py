"""Contacts of the reference mode, compiled: bobbin, eye of the guide, yarn on yarn.

All normal contacts are springs with a dashpot that never pulls. The bobbin is rough: a node that touches it is gripped
by a spring between it and the place it touched first, in the frame that turns with the bobbin, until it lifts off.
The bobbin turns clockwise about e_z by θ: lab = (c X + s Y, −s X + c Y, Z), c = cos θ, s = sin θ.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import borrowing, inner
from models.winding.rod import Rod

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

HARDENED = 0.5
"""Approach of two yarns over their diameter above which the contact hardens no further."""
PARALLEL = 0.01
"""sin² of the angle below which two elements count as side by side."""
NEIGHBOURS = 8
"""Elements of the same yarn this close by number are not tested against each other."""


class Bobbin(NamedTuple):
    """The bobbin as the contacts see it, SI."""

    radius: float
    """Of the centre line of yarn that touches, at z = 0, measured across the axis."""
    taper: float
    """Growth of the radius along z."""
    stiffness: float
    """Of a node on the surface [N/m]."""
    damping: float
    """[N s/m]."""
    grip: float
    """Of the spring along the surface [N/m]."""
    grip_damping: float


class Grip(NamedTuple):
    """Where nodes are gripped, in the bobbin's frame; arrays with room as the rod's."""

    held: Integers
    """1 where gripped."""
    x: Array
    y: Array
    z: Array
    damped_x: Array
    """Force of the dashpots on a gripped node in the last step, lab's frame [N]."""
    damped_y: Array
    damped_z: Array


class Crossing(NamedTuple):
    """Constants of yarn on yarn, SI."""

    diameter: float
    surface: float
    """K_t of one yarn [N/m²]; two in series share the approach."""
    element: float
    """L₀."""
    mass: float
    """Of a node."""
    damping: float
    """Over critical."""
    static: float
    dynamic: float


class Pairs(NamedTuple):
    """Pairs of elements that touch or nearly do, ordered by `first`, with their friction."""

    first: Integers
    second: Integers
    slides: Array
    """1 while sliding."""
    stiffness: Array
    """In the last step [N/m]; 0 where another pair has the contact."""
    gap: Array
    """Distance of the centre lines in the last step with contact [m]."""
    damped: Array
    """Force of the dashpot in the last step, outwards [N]; 0 without contact."""
    ux: Array
    """Stretch of the friction spring, bobbin's frame [m]."""
    uy: Array
    uz: Array


def new_grip(room: int) -> Grip:
    """No node gripped."""
    return Grip(np.zeros(room, np.int64), *(np.zeros(room) for _ in range(6)))


def new_pairs(room: int) -> Pairs:
    """Room for pairs."""
    return Pairs(np.zeros(room, np.int64), np.zeros(room, np.int64), *(np.zeros(room) for _ in range(7)))


@inner
def bobbin_contact(
    rod: Rod, grip: Grip, b: Bobbin, n: int, cosine: float, sine: float, spin: float
) -> tuple[float, float, float, float]:
    """Add the bobbin's forces on nodes 1 … n − 1.

    Returns
    -------
    Power of the bobbin on the yarn [W], power lost in dashpots [W], energy of grips let go [J], energy stored [J].
    """
    power, lost, released, stored = 0.0, 0.0, 0.0, 0.0
    slant = math.sqrt(1.0 + b.taper * b.taper)
    for i in range(1, n):
        x, y, z = rod.x[i], rod.y[i], rod.z[i]
        reach = b.radius + b.taper * z
        square = x * x + y * y
        wx, wy, wz = rod.vx[i] - spin * y, rod.vy[i] + spin * x, rod.vz[i]
        if grip.held[i] == 1:
            # As for yarn on yarn below: half of it was entered with the old velocity.
            lost -= (grip.damped_x[i] * wx + grip.damped_y[i] * wy + grip.damped_z[i] * wz) / 2
        if square >= reach * reach:
            if grip.held[i] == 1:
                ex = x - cosine * grip.x[i] - sine * grip.y[i]
                ey = y - cosine * grip.y[i] + sine * grip.x[i]
                released += b.grip / 2 * (ex * ex + ey * ey + (z - grip.z[i]) ** 2)
                grip.held[i] = 0
            continue
        r = math.sqrt(square)
        nx, ny, nz = x / (r * slant), y / (r * slant), -b.taper / slant
        depth = (reach - r) / slant
        if grip.held[i] == 0:
            grip.held[i] = 1
            grip.x[i], grip.y[i], grip.z[i] = cosine * x - sine * y, sine * x + cosine * y, z
        ax, ay = cosine * grip.x[i] + sine * grip.y[i], cosine * grip.y[i] - sine * grip.x[i]
        ex, ey, ez = x - ax, y - ay, z - grip.z[i]
        out = ex * nx + ey * ny + ez * nz
        ex, ey, ez = ex - out * nx, ey - out * ny, ez - out * nz
        out = wx * nx + wy * ny + wz * nz
        wx, wy, wz = wx - out * nx, wy - out * ny, wz - out * nz
        push = max(b.stiffness * depth - b.damping * out, 0.0)
        fx = push * nx - b.grip * ex - b.grip_damping * wx
        fy = push * ny - b.grip * ey - b.grip_damping * wy
        fz = push * nz - b.grip * ez - b.grip_damping * wz
        rod.fx[i] += fx
        rod.fy[i] += fy
        rod.fz[i] += fz
        power += spin * (fx * y - fy * x)
        damped = push - b.stiffness * depth
        lost += (b.grip_damping * (wx * wx + wy * wy + wz * wz) - damped * out) / 2
        grip.damped_x[i] = damped * nx - b.grip_damping * wx
        grip.damped_y[i] = damped * ny - b.grip_damping * wy
        grip.damped_z[i] = damped * nz - b.grip_damping * wz
        stored += b.stiffness * depth * depth + b.grip * (ex * ex + ey * ey + ez * ez)
    return power, lost, released, stored / 2


@inner
def eye_contact(
    rod: Rod,
    j: int,
    plane: float,
    height: float,
    place: float,
    speed: float,
    clearance: float,
    stiffness: float,
    friction: float,
    creep: float,
) -> tuple[float, float, float]:
    """Add the force of an eye at (plane, height, place), moving along z, on element j, which crosses its plane.

    The centre line may move freely within `clearance` of the eye's centre. The force is the gradient of the spring's
    energy in the position of both nodes, so that it is perpendicular to the element: no friction is made by the mesh.
    Friction is that of a rope over a round edge that the mesh does not resolve, (T₁ + T₂) tanh(μφ/2) cos(φ/2) with the
    wrap φ from the normal force N = (T₁ + T₂) sin(φ/2); it is full above the sliding speed `creep`.

    Returns
    -------
    Power of the moving eye on the yarn [W], power lost by friction [W], energy stored [J].
    """
    span = rod.x[j] - rod.x[j + 1]
    w = (rod.x[j] - plane) / span
    dy, dz = rod.y[j + 1] - rod.y[j], rod.z[j + 1] - rod.z[j]
    gy, gz = rod.y[j] + w * dy - height, rod.z[j] + w * dz - place
    gap = math.sqrt(gy * gy + gz * gz)
    if gap <= clearance:
        return 0.0, 0.0, 0.0
    pull = -stiffness * (gap - clearance) / gap
    fy, fz = pull * gy, pull * gz
    fx = (fy * dy + fz * dz) / span
    power, lost = fz * speed, 0.0
    if friction > 0.0:
        around = max(rod.tension[j - 1] + rod.tension[j + 1], 1e-12)
        half = math.asin(min(math.sqrt(fx * fx + fy * fy + fz * fz) / around, 0.999))
        vx = (1 - w) * rod.vx[j] + w * rod.vx[j + 1]
        vy = (1 - w) * rod.vy[j] + w * rod.vy[j + 1]
        vz = (1 - w) * rod.vz[j] + w * rod.vz[j + 1] - speed
        slip = vx * rod.tx[j] + vy * rod.ty[j] + vz * rod.tz[j]
        drag = -around * math.tanh(friction * half) * math.cos(half) * min(max(slip / creep, -1.0), 1.0)
        fx, fy, fz = fx + drag * rod.tx[j], fy + drag * rod.ty[j], fz + drag * rod.tz[j]
        power += drag * rod.tz[j] * speed
        lost = -drag * slip
    rod.fx[j] += (1 - w) * fx
    rod.fy[j] += (1 - w) * fy
    rod.fz[j] += (1 - w) * fz
    rod.fx[j + 1] += w * fx
    rod.fy[j + 1] += w * fy
    rod.fz[j + 1] += w * fz
    return power, lost, stiffness / 2 * (gap - clearance) ** 2


@inner
def hardening(x: float) -> tuple[float, float]:
    """Force of one yarn on another over k d, and its energy over k d², at the approach x d; k is the initial stiffness.

    x/(1 − x), because a yarn that is flattened has less left to flatten; straight on from `HARDENED`, with the slope
    1/(1 − HARDENED)² there, so that the time step stays bounded.
    """
    y = min(x, HARDENED)
    beyond = x - y
    force, slope = y / (1 - y), 1 / (1 - HARDENED) ** 2
    return force + slope * beyond, -y - math.log(1 - y) + force * beyond + slope / 2 * beyond * beyond


@inner
def _part(rod: Rod, i: int, place: float, dx: float, dy: float, dz: float) -> float:
    """Share of element i in a contact at `place` on it: 1 inside; at a node ½ if the node is nearest, else 0.

    (dx, dy, dz) points to the other yarn. The element beyond the node finds the same point there and has the other
    half, so that a contact passes from one element to the next without a jump.
    """
    if 0.0 < place < rod.length[i] or (i == 0 and place == 0.0):
        return 1.0
    k = i + 1 if place > 0.0 else i - 1
    along = dx * rod.tx[k] + dy * rod.ty[k] + dz * rod.tz[k]
    if place > 0.0:
        along = -along
    return 0.5 if along >= 0.0 else 0.0


@inner
def _approach(rod: Rod, i: int, j: int) -> tuple[float, float, float, float, float, float, float, float]:
    """Nearest points of elements i and j: places s, t in shares of the elements; share of the contact that is theirs;
    sine of their angle; distance, and unit vector from j to i. Side by side it is measured at the middle of i.

    The nearest points of two segments are found as in Ericson, Real-Time Collision Detection (2005), section 5.1.9.
    """
    dx, dy, dz = rod.x[i] - rod.x[j], rod.y[i] - rod.y[j], rod.z[i] - rod.z[j]
    ix, iy, iz, jx, jy, jz = rod.tx[i], rod.ty[i], rod.tz[i], rod.tx[j], rod.ty[j], rod.tz[j]
    along_i, along_j = dx * ix + dy * iy + dz * iz, dx * jx + dy * jy + dz * jz
    cosine = ix * jx + iy * jy + iz * jz
    square = 1.0 - cosine * cosine
    s, sine = rod.length[i] / 2, 0.0
    if square > PARALLEL:
        s, sine = min(max((cosine * along_j - along_i) / square, 0.0), rod.length[i]), math.sqrt(square)
    t = min(max(along_j + s * cosine, 0.0), rod.length[j])
    if square > PARALLEL:
        s = min(max(t * cosine - along_i, 0.0), rod.length[i])
    dx, dy, dz = dx + s * ix - t * jx, dy + s * iy - t * jy, dz + s * iz - t * jz
    gap = math.sqrt(dx * dx + dy * dy + dz * dz)
    share = _part(rod, i, s, -dx, -dy, -dz) * _part(rod, j, t, dx, dy, dz)
    return s / rod.length[i], t / rod.length[j], share, sine, gap, dx / gap, dy / gap, dz / gap


@inner
def find_pairs(
    rod: Rod, pairs: Pairs, count: int, spare: Pairs, margin: float, diameter: float, n: int, reach: float
) -> int:
    """List the pairs among elements 0 … n − 1 whose yarns are less than `margin` from touching; their number.

    Cells of side `reach` ≥ L₀ + d + margin over angle and z. Friction of pairs that stay is kept; −1 if there is no
    room. Overwrites `spare`.
    """
    first_old = np.zeros(n + 1, np.int64)
    for q in range(count):
        spare.second[q], spare.slides[q], spare.stiffness[q] = pairs.second[q], pairs.slides[q], pairs.stiffness[q]
        spare.gap[q], spare.damped[q] = pairs.gap[q], pairs.damped[q]
        spare.ux[q], spare.uy[q], spare.uz[q] = pairs.ux[q], pairs.uy[q], pairs.uz[q]
        if pairs.first[q] < n:
            first_old[pairs.first[q] + 1] += 1
    for i in range(n):
        first_old[i + 1] += first_old[i]
    radius = math.sqrt(rod.x[0] ** 2 + rod.y[0] ** 2)
    columns = max(int(2 * math.pi * radius / reach), 3)
    low, high = rod.z[0], rod.z[0]
    for i in range(n):
        low, high = min(low, rod.z[i]), max(high, rod.z[i])
    rows = int((high - low) / reach) + 2
    head = np.full(columns * rows, -1)
    following = np.empty(n, np.int64)
    found = 0
    near = (reach) ** 2
    for i in range(n):
        mx, my, mz = (rod.x[i] + rod.x[i + 1]) / 2, (rod.y[i] + rod.y[i + 1]) / 2, (rod.z[i] + rod.z[i + 1]) / 2
        column = int((math.atan2(my, mx) + math.pi) / (2 * math.pi) * columns)
        column = min(max(column, 0), columns - 1)
        row = min(max(int((mz - low) / reach), 0), rows - 1)
        for dc in range(-1, 2):
            for dr in range(-1, 2):
                if row + dr < 0 or row + dr >= rows:
                    continue
                j = int(head[((column + dc) % columns) * rows + row + dr])
                while j >= 0:
                    ox, oy, oz = (
                        mx - (rod.x[j] + rod.x[j + 1]) / 2,
                        my - (rod.y[j] + rod.y[j + 1]) / 2,
                        mz - (rod.z[j] + rod.z[j + 1]) / 2,
                    )
                    if i - j >= NEIGHBOURS and ox * ox + oy * oy + oz * oz < near:
                        _, _, _, _, gap, _, _, _ = _approach(rod, i, j)
                        if gap < diameter + margin:
                            if found >= pairs.first.shape[0]:
                                return -1
                            pairs.first[found], pairs.second[found] = i, j
                            pairs.slides[found], pairs.stiffness[found] = 0.0, 0.0
                            pairs.gap[found], pairs.damped[found] = 0.0, 0.0
                            pairs.ux[found], pairs.uy[found], pairs.uz[found] = 0.0, 0.0, 0.0
                            for q in range(first_old[i], first_old[i + 1]):
                                if spare.second[q] == j:
                                    pairs.slides[found], pairs.stiffness[found] = spare.slides[q], spare.stiffness[q]
                                    pairs.gap[found], pairs.damped[found] = spare.gap[q], spare.damped[q]
                                    pairs.ux[found], pairs.uy[found], pairs.uz[found] = (
                                        spare.ux[q],
                                        spare.uy[q],
                                        spare.uz[q],
                                    )
                            found += 1
                    j = int(following[j])
        following[i] = head[column * rows + row]
        head[column * rows + row] = i
    return found


@borrowing
def _rub(
    pairs: Pairs,
    q: int,
    c: Crossing,
    push: float,
    sx: float,
    sy: float,
    sz: float,
    nx: float,
    ny: float,
    nz: float,
    cosine: float,
    sine: float,
) -> tuple[float, float, float, float]:
    """Stretch the friction spring of pair q by (sx, sy, sz) [m] along the surface with the normal (nx, ny, nz), and let
    it slide where `push` [N] does not hold it.

    Returns
    -------
    Its stretch, in the lab's frame [m], and what sliding has lost [J]: the mean of the forces before and after the step
    times the way slid, which is what the time stepping does.
    """
    stiffness = pairs.stiffness[q]
    ax, ay, az = cosine * pairs.ux[q] + sine * pairs.uy[q], cosine * pairs.uy[q] - sine * pairs.ux[q], pairs.uz[q]
    ux, uy, uz = ax + sx, ay + sy, az + sz
    off = ux * nx + uy * ny + uz * nz
    ux, uy, uz = ux - off * nx, uy - off * ny, uz - off * nz
    size = math.sqrt(ux * ux + uy * uy + uz * uz)
    limit = c.dynamic if pairs.slides[q] > 0.0 else c.static
    pairs.slides[q] = 0.0
    if stiffness * size > limit * push:
        kept = c.dynamic * push / (stiffness * size)
        ux, uy, uz = kept * ux, kept * uy, kept * uz
        pairs.slides[q] = 1.0
    pairs.ux[q], pairs.uy[q], pairs.uz[q] = cosine * ux - sine * uy, sine * ux + cosine * uy, uz
    lost = (ax + ux) * (ax + sx - ux) + (ay + uy) * (ay + sy - uy) + (az + uz) * (az + sz - uz)
    return ux, uy, uz, stiffness / 2 * lost


@inner
def pair_contact(
    rod: Rod, pairs: Pairs, count: int, c: Crossing, cosine: float, sine: float, spin: float, dt: float
) -> tuple[float, float, float, float, float, float]:
    """Add the forces of yarn on yarn.

    Returns
    -------
    Power of the bobbin's frame on the yarn [W], power lost in dashpots [W], energy rubbed away [J], energy handed on
    [J], energy stored [J], deepest approach [m].
    Friction acts at the surfaces, a diameter apart on the two centre lines: its couple, which these cannot bear, is
    borne by the frame that turns with the bobbin. Handed on is what the springs lose at once where a contact passes to
    another element, changes its angle or jumps along the elements, which no motion of the yarn explains.
    """
    power, damped, rubbed, handed, stored, deepest = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for q in range(count):
        i, j = int(pairs.first[q]), int(pairs.second[q])
        s, t, share, angle, gap, nx, ny, nz = _approach(rod, i, j)
        depth = c.diameter - gap
        touching, before = depth > 0.0 and share > 0.0, pairs.stiffness[q]
        if not touching and before == 0.0:
            continue
        i0, i1, j0, j1 = 1 - s, s, 1 - t, t
        wx = i0 * rod.vx[i] + i1 * rod.vx[i + 1] - j0 * rod.vx[j] - j1 * rod.vx[j + 1] - spin * gap * ny
        wy = i0 * rod.vy[i] + i1 * rod.vy[i + 1] - j0 * rod.vy[j] - j1 * rod.vy[j + 1] + spin * gap * nx
        wz = i0 * rod.vz[i] + i1 * rod.vz[i + 1] - j0 * rod.vz[j] - j1 * rod.vz[j + 1]
        out = wx * nx + wy * ny + wz * nz
        wx, wy, wz = wx - out * nx, wy - out * ny, wz - out * nz
        # The dashpot's force of the last step acted while the velocity went from the old to the new value.
        damped -= pairs.damped[q] * out / 2
        # What the springs of the last step and of this one hold half-way between them, where one force takes over.
        half = dt * out / 2
        left = hardening(max(c.diameter - pairs.gap[q] - half, 0.0) / c.diameter)[1]
        taken = hardening(max(depth + half, 0.0) / c.diameter)[1]
        drawn = (pairs.ux[q] ** 2 + pairs.uy[q] ** 2 + pairs.uz[q] ** 2) / 2
        stiffness = 0.0
        if touching:
            contact = c.diameter / angle if angle * c.element > c.diameter else c.element
            stiffness = share * c.surface / 2 * contact
        square = c.diameter * c.diameter
        handed += before * (square * left + drawn) - stiffness * (square * taken + drawn)
        pairs.stiffness[q], pairs.gap[q] = stiffness, gap
        if not touching:
            pairs.ux[q], pairs.uy[q], pairs.uz[q] = 0.0, 0.0, 0.0
            pairs.slides[q], pairs.damped[q] = 0.0, 0.0
            continue
        force, energy = hardening(depth / c.diameter)
        spring = stiffness * c.diameter * force
        push = max(spring - 2 * c.damping * math.sqrt(stiffness * c.mass) * out, 0.0)
        ux, uy, uz, lost = _rub(pairs, q, c, push, dt * wx, dt * wy, dt * wz, nx, ny, nz, cosine, sine)
        rubbed += lost
        fx, fy, fz = push * nx - stiffness * ux, push * ny - stiffness * uy, push * nz - stiffness * uz
        for node, part in ((i, i0), (i + 1, i1), (j, -j0), (j + 1, -j1)):
            rod.fx[node] += part * fx
            rod.fy[node] += part * fy
            rod.fz[node] += part * fz
        power += spin * gap * (fx * ny - fy * nx)
        pairs.damped[q] = push - spring
        damped -= pairs.damped[q] * out / 2
        stored += stiffness * (square * energy + (ux * ux + uy * uy + uz * uz) / 2)
        deepest = max(deepest, depth)
    return power, damped, rubbed, handed, stored, deepest
