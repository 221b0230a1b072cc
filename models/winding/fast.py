"""Fast mode: the package from the kinematics of the lay path and one radial degree of freedom per laid node.

Path. The span is straight and touches the bobbin at its top, so that its angle is the angle of lay:
dz/ds = (z_eye − z)/g over the circumference s. Nodes lie at equal angles of the bobbin and do not slip.

Tension of the span. Waves in the span pass to the feed at once compared with a guide cycle. Matched feed:
T = T₀ + ρc (u − ū), u the speed at which yarn is taken in, ū its running mean; free tail: the wave that u sends out
comes back with its tension reversed, T = ρc u + 2 g, g(t) = −f(t − 2ℓ/c), f = ρc u + g.

Package. Every crossing of the path with itself is known beforehand. New yarn is laid as a string of constant tension
over what is below it, and sinks by the share `SUNK` of what the surface yields; that fixes the natural length of its
elements. From then on it is held circumferentially and axially by the bobbin (no slip), its nodes move radially until
tension, bending, the yielding surface and the crossings are in equilibrium, node by node (Gauss–Seidel, only where
something still moves).

Left out: whirling and transverse waves, yarn lying alongside yarn without crossing it, friction between yarns.
"""

import math
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, inner
from models.winding.contact import HARDENED, hardening
from models.winding.drive import travel, traverse
from models.winding.result import Progress, Snapshot, WindingOutcome, WindingResult
from models.winding.sampling import SHOWN_LAYERS, layer_means, sample_times, window_means
from models.winding.scene import WindingScene

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BATCH = 24
"""Nodes laid before the package is relaxed: about a quarter turn."""
AHEAD = 8
"""Nodes beyond a batch that are laid on trial: yarn ahead lifts what lies up to √(2 R d) before it."""
SETTLED = 1e-8
"""Radial step [m] below which a node rests; 1e-9 m changes the layers of 9 m of yarn by 0.0002 T₀."""
SUNK = 0.75
"""Share of the sinking into the bobbin that happens before the yarn is held: while it lands, the span still draws slack
out of it. From the reference mode (2 mm): a soft loop that would keep 0.53 of its tension if held at first touch
keeps 0.88."""
TABLE = 20_001
"""Points of the table that inverts the drive's travel."""

_traverse = inner(traverse)


class Yarn(NamedTuple):
    """What the compiled functions need to know of the scene, SI."""

    axial: float
    bending: float
    diameter: float
    surface: float
    """K_t [N/m²]."""


class Package(NamedTuple):
    """Laid nodes, arrays of shape (n,), and crossings, (m,). Element k joins nodes k and k + 1."""

    angle_step: float
    radius: Array
    """Of the centre line where the yarn just touches the bobbin [m]."""
    z: Array
    height: Array
    """Above `radius` [m]."""
    natural: Array
    """Natural length of the element [m], 0 until laid."""
    relaxed: Array
    """Strain taken by the Prony branches."""
    below: Integers
    """Element crossed by element `above`, sorted by `above`, shape (m,)."""
    above: Integers
    below_at: Array
    """Place of the crossing on the element, 0 to 1."""
    above_at: Array
    stiffness: Array
    """[N/m]."""
    first_above: Integers
    """Crossings of element k from above are first_above[k] … first_above[k + 1] − 1, shape (n + 1,)."""
    order_below: Integers
    """Crossings sorted by `below`, shape (m,)."""
    first_below: Integers


@compiled
def lay_path(
    n: int,
    angle_step: float,
    bobbin_radius: float,
    taper: float,
    guide_distance: float,
    pull: float,
    clearance: float,
    stroke: float,
    turns_per_cycle: float,
    reversal: float,
) -> tuple[Array, Array]:
    """Axial position [m] of n nodes at equal steps of the bobbin's angle, and of the yarn in the eye, shape (n,) each.

    `pull` is guide distance over feed length: how much the straight yarn upstream draws the yarn in the eye to z = 0.
    """
    z, eye = np.empty(n), np.empty(n)
    place = stroke * _traverse(0.0, reversal)[0]
    for k in range(n):
        guide = stroke * _traverse(k * angle_step / (2 * math.pi * turns_per_cycle), reversal)[0]
        free = place / (1 + pull)
        eye[k] = min(max(free, guide - clearance), guide + clearance)
        z[k] = place
        step = (bobbin_radius + taper * place) * angle_step / guide_distance
        place += (eye[k] - place) * (1 - math.exp(-step))
    return z, eye


@compiled
def find_crossings(z: Array, arc: Array, per_turn: float, cell: float) -> tuple[Integers, Integers, Array, Array]:
    """Crossings of the path with itself on the unrolled bobbin: lower and upper element, and the places on them.

    `arc` is the position along the circumference in units of node steps, `per_turn` their number per turn; z is scaled
    by the same step. Elements are searched in cells of side `cell` steps.
    """
    n = z.shape[0] - 1
    columns = max(int(per_turn / cell), 3)
    width = per_turn / columns
    lowest = z.min()
    rows = int((z.max() - lowest) / cell) + 1
    head = np.full(columns * rows, -1)
    following = np.full(n, -1)
    low, high = [0][:0], [0][:0]
    low_at, high_at = [0.0][:0], [0.0][:0]
    for k in range(n):
        middle = (arc[k] + 0.5) % per_turn
        column = min(int(middle / width), columns - 1)
        row = int(((z[k] + z[k + 1]) / 2 - lowest) / cell)
        for dc in range(-1, 2):
            for dr in range(-1, 2):
                if row + dr < 0 or row + dr >= rows:
                    continue
                i = int(head[((column + dc) % columns) * rows + row + dr])
                while i >= 0:
                    offset = arc[i] - arc[k]
                    offset -= per_turn * math.floor(offset / per_turn + 0.5)
                    # element k: (t, z_k + t dz_k); element i: (offset + s, z_i + s dz_i), both of unit length in arc
                    slope_k, slope_i = z[k + 1] - z[k], z[i + 1] - z[i]
                    if slope_k != slope_i and k - i > 8:
                        t = (z[i] - z[k] - offset * slope_i) / (slope_k - slope_i)
                        s = t - offset
                        if 0 <= t < 1 and 0 <= s < 1:
                            low.append(i)
                            high.append(k)
                            low_at.append(s)
                            high_at.append(t)
                    i = int(following[i])
        place = column * rows + row
        following[k] = head[place]
        head[place] = k
    return np.array(low), np.array(high), np.array(low_at), np.array(high_at)


@inner
def _length(p: Package, k: int) -> float:
    a, b = p.radius[k] + p.height[k], p.radius[k + 1] + p.height[k + 1]
    across = 2 * math.sin(p.angle_step / 2)
    dz = p.z[k + 1] - p.z[k]
    return math.sqrt((a - b) * (a - b) + a * b * across * across + dz * dz)


@inner
def _lean(p: Package, k: int, other: int, length: float) -> float:
    """∂ length / ∂ radius of node k, for the element to node `other`."""
    return (p.radius[k] + p.height[k] - (p.radius[other] + p.height[other]) * math.cos(p.angle_step)) / length


@inner
def _crossing(p: Package, c: int, diameter: float) -> float:
    """Approach of the two yarns of crossing c beyond touching [m]."""
    i, k, s, t = p.below[c], p.above[c], p.below_at[c], p.above_at[c]
    upper = (1 - t) * p.height[k] + t * p.height[k + 1]
    return (1 - s) * p.height[i] + s * p.height[i + 1] + diameter - upper


@inner
def _press(x: float) -> tuple[float, float]:
    """Force of one yarn on another over k d, and its slope, at the approach x d; see `contact.hardening`."""
    y = min(x, HARDENED)
    return hardening(x)[0], 1 / (1 - y) ** 2


@inner
def _move(p: Package, yarn: Yarn, k: int, laid: int, fresh: int, pull: float) -> float:
    """One Newton step of node k towards radial equilibrium; the step taken [m]. See `settle`."""
    force, stiffness = 0.0, 0.0
    for e in range(k - 1, k + 1):
        if e < 0 or e + 1 >= laid:
            continue
        length = _length(p, e)
        other = e if e < k else e + 1
        lean = _lean(p, k, other, length)
        tension = pull
        if p.natural[e] > 0:
            tension = yarn.axial * (length / p.natural[e] - 1 - p.relaxed[e])
            stiffness += yarn.axial * lean * lean / p.natural[e]
        force -= tension * lean
        stiffness += abs(tension) * (1 - lean * lean) / length
    size = (p.radius[k] * p.angle_step) ** 3
    if 2 <= k < laid - 2:
        h = p.height
        force -= yarn.bending / size * (h[k - 2] - 4 * h[k - 1] + 6 * h[k] - 4 * h[k + 1] + h[k + 2])
        stiffness += 6 * yarn.bending / size
    if p.height[k] < 0:
        surface = yarn.surface * p.radius[k] * p.angle_step
        if k >= fresh:
            surface /= SUNK
        force -= surface * p.height[k]
        stiffness += surface
    for e in range(max(k - 1, 0), min(k + 1, laid - 1)):
        for c in range(p.first_above[e], p.first_above[e + 1]):
            depth = _crossing(p, c, yarn.diameter)
            if depth > 0:
                share = p.above_at[c] if e < k else 1 - p.above_at[c]
                press, slope = _press(depth / yarn.diameter)
                force += p.stiffness[c] * yarn.diameter * press * share
                stiffness += p.stiffness[c] * slope * share * share
        for q in range(p.first_below[e], p.first_below[e + 1]):
            c = p.order_below[q]
            if p.above[c] + 1 >= laid:
                continue
            depth = _crossing(p, c, yarn.diameter)
            if depth > 0:
                share = p.below_at[c] if e < k else 1 - p.below_at[c]
                press, slope = _press(depth / yarn.diameter)
                force -= p.stiffness[c] * yarn.diameter * press * share
                stiffness += p.stiffness[c] * slope * share * share
    old = p.height[k]
    p.height[k] = old + force / stiffness
    return abs(p.height[k] - old)


@compiled
def element_lengths(p: Package, start: int, stop: int) -> Array:
    """Lengths [m] of elements start … stop − 1."""
    lengths = np.empty(stop - start)
    for k in range(start, stop):
        lengths[k - start] = _length(p, k)
    return lengths


@compiled
def settle(p: Package, yarn: Yarn, start: int, laid: int, fresh: int, pull: float, settled: float) -> int:
    """Bring nodes start … laid − 1, and whatever they move, to rest; the number of node updates.

    Nodes from `fresh` on are being laid, with only `SUNK` of the bobbin's yielding; elements without a natural length
    are a string of tension `pull` [N].
    """
    queue = np.empty(laid + 1, np.int64)
    waiting = np.zeros(laid, np.bool_)
    head, count, updates = 0, 0, 0
    for k in range(max(start, 1), laid):
        queue[count] = k
        waiting[k] = True
        count += 1
    limit = 2000 * (count + 1) + 20 * laid
    while count > 0 and updates < limit:
        k = queue[head]
        head = (head + 1) % queue.shape[0]
        count -= 1
        waiting[k] = False
        updates += 1
        if _move(p, yarn, k, laid, fresh, pull) <= settled:
            continue
        # Neighbours along the yarn, and the nodes of the elements that cross the two elements at k.
        for other in range(max(k - 2, 1), min(k + 3, laid)):
            if other != k and not waiting[other]:
                queue[(head + count) % queue.shape[0]] = other
                waiting[other] = True
                count += 1
        for e in range(max(k - 1, 0), min(k + 1, laid - 1)):
            for side in range(2):
                first = p.first_above if side == 0 else p.first_below
                for q in range(first[e], first[e + 1]):
                    c = q if side == 0 else p.order_below[q]
                    across = p.below[c] if side == 0 else p.above[c]
                    if across + 1 >= laid or _crossing(p, c, yarn.diameter) < -settled * 1000:
                        continue
                    for other in range(across, across + 2):
                        if other > 0 and not waiting[other]:
                            queue[(head + count) % queue.shape[0]] = other
                            waiting[other] = True
                            count += 1
    return updates


def _pack(scene: WindingScene) -> tuple[Package, Array, Array]:
    """The path with its crossings, nothing laid yet; z of the yarn in the eye [m] and phase [cycles], shape (n,)."""
    angle_step = scene.element_length * math.cos(scene.winding_angle) / scene.bobbin_radius
    per_cycle = 2 * math.pi * scene.turns_per_cycle / angle_step
    n = int(scene.cycles * per_cycle) + 2 + AHEAD
    taper = math.tan(scene.cone_angle)
    pull = scene.guide_distance / scene.feed_length if scene.feed == "active" else 0.0
    z, eye = lay_path(
        n,
        angle_step,
        scene.bobbin_radius,
        taper,
        scene.guide_distance,
        pull,
        scene.guide_clearance,
        scene.stroke,
        scene.turns_per_cycle,
        scene.reversal,
    )
    step = scene.bobbin_radius * angle_step
    below, above, below_at, above_at = find_crossings(
        z / step, np.arange(n, dtype=np.float64), 2 * math.pi / angle_step, 2.0
    )
    slope = np.diff(z) / step
    angle = np.abs(np.arctan(slope[above]) - np.arctan(slope[below]))
    contact = np.minimum(scene.diameter / np.maximum(np.sin(angle), 1e-9), scene.element_length)
    order = np.argsort(below, kind="stable")
    edges = np.arange(n + 1)
    package = Package(
        angle_step=angle_step,
        radius=scene.bobbin_radius + taper * z + scene.diameter / 2 / math.cos(scene.cone_angle),
        z=z,
        height=np.zeros(n),
        natural=np.zeros(n),
        relaxed=np.zeros(n),
        below=below,
        above=above,
        below_at=below_at,
        above_at=above_at,
        stiffness=scene.transverse_stiffness * contact / 2,
        first_above=np.searchsorted(above, edges),
        order_below=order,
        first_below=np.searchsorted(below[order], edges),
    )
    return package, eye, np.arange(n) / per_cycle


class _Span:
    """Tension of the span, advanced element by element of laid yarn."""

    def __init__(self, scene: WindingScene) -> None:
        self.scene = scene
        self.drift = 0.0
        """Running mean of u − V [m/s]."""
        self.sent_time = [0.0]
        self.sent = [0.0]
        """f, the tension of the wave sent up the tail [N]."""
        self.taken = 0.0
        """Length of yarn taken in [m]."""

    def advance(self, time: float, step: float, taken: float, wrap: float) -> float:
        """Tension [N] while `taken` m of yarn go in during `step` s until `time`, deflected by `wrap` at the guide."""
        scene = self.scene
        pull = scene.tension + scene.tension_slope * time
        speed = taken / step
        if scene.feed == "active":
            change = speed - travel(time, scene.speed, scene.speed_rise, scene.speed_slope)[1]
            pull += scene.impedance * (change - self.drift)
            self.drift += (1 - math.exp(-step / scene.feed_memory)) * (change - self.drift)
        else:
            tail = max(scene.feed_length - self.taken, scene.element_length)
            back = -float(np.interp(time - 2 * tail / scene.wave_speed, self.sent_time, self.sent))
            pull += scene.impedance * speed + 2 * back
            self.sent_time.append(time)
            self.sent.append(scene.impedance * speed + back)
        self.taken += taken
        return pull * math.exp(scene.guide_friction * wrap)


class _Relaxation:
    """Strains of the Prony branches of all laid elements."""

    def __init__(self, scene: WindingScene, elements: int) -> None:
        self.weights, self.times = np.array(scene.prony_weights), np.array(scene.prony_times)
        self.strains = np.zeros((len(self.weights), elements))
        self.since = np.zeros(elements)
        """Time up to which each element has relaxed [s]."""

    def advance(self, package: Package, strain: Array, time: float) -> None:
        """Let the elements with `strain`, shape (k,), relax until `time`; writes `package.relaxed`."""
        k = len(strain)
        share = 1 - np.exp(-(time - self.since[:k]) / self.times[:, np.newaxis])
        self.strains[:, :k] += share * (strain - self.strains[:, :k])
        self.since[:k] = time
        package.relaxed[:k] = self.weights @ self.strains[:, :k]


def _snapshot(scene: WindingScene, package: Package, phase: Array, laid: int, time: float) -> Snapshot:
    strain = element_lengths(package, 0, laid - 1) / package.natural[: laid - 1] - 1
    tension = scene.axial_stiffness * (strain - package.relaxed[: laid - 1])
    radius = package.radius[:laid] + package.height[:laid]
    angle = package.angle_step * np.arange(laid)
    return Snapshot(
        time=time,
        layer=np.floor(phase[:laid]).astype(np.int64) + 1,
        # The bobbin turns clockwise, seen against e_z: yarn laid at time 0 is on top.
        position=np.column_stack([radius * np.sin(-angle), radius * np.cos(angle), package.z[:laid]]),
        tension=np.concatenate([tension[:1], (tension[1:] + tension[:-1]) / 2, tension[-1:]]),
    )


def wind_fast(scene: WindingScene, reason: str, progress: Progress | None = None) -> WindingResult:
    """Run `scene` in the fast mode.

    Parameters
    ----------
    reason : why this mode, kept in the result.
    progress : told the share of the nodes laid.
    """
    begin = perf_counter()
    package, eye, phase = _pack(scene)
    yarn = Yarn(scene.axial_stiffness, scene.bending_stiffness, scene.diameter, scene.transverse_stiffness)
    total = len(phase) - AHEAD
    # A little beyond the end, because the last node is the first that is laid after it.
    table = np.linspace(0, scene.duration + scene.speed_rise + 2 * scene.element_length / scene.speed, TABLE)
    travelled = np.array([travel(t, scene.speed, scene.speed_rise, scene.speed_slope)[0] for t in table])
    time = np.interp(phase * (scene.wound_length / scene.cycles), travelled, table)
    free = np.hypot(scene.guide_distance, eye - package.z)
    wrap = np.arctan2(eye - package.z, scene.guide_distance)
    if scene.feed == "active":
        free += np.hypot(scene.feed_length, eye)
        wrap += np.arctan2(eye, scene.feed_length)
    span, relaxation = _Span(scene), _Relaxation(scene, total)
    tension = np.full(total, scene.tension)
    shown = list(SHOWN_LAYERS)
    snapshots: list[Snapshot] = []
    cycle, updates = 1, 0
    for start in range(0, total, BATCH):
        stop = min(start + BATCH, total)
        first = max(start - 1, 0)
        package.height[start : stop + AHEAD] = 0.0
        updates += settle(package, yarn, start, stop + AHEAD, start, tension[first], SETTLED)
        lengths = element_lengths(package, first, stop - 1)
        for k, length in enumerate(lengths, first):
            taken = length + free[k + 1] - free[k]
            tension[k + 1] = span.advance(time[k + 1], time[k + 1] - time[k], taken, abs(wrap[k + 1]))
        package.natural[first : stop - 1] = lengths / (1 + tension[first + 1 : stop] / scene.axial_stiffness)
        relaxation.since[first : stop - 1] = time[first + 1 : stop]
        if phase[stop - 1] >= cycle:
            strain = element_lengths(package, 0, stop - 1) / package.natural[: stop - 1] - 1
            relaxation.advance(package, strain, time[stop - 1])
            updates += settle(package, yarn, 0, stop, stop, 0.0, SETTLED)
            if cycle in shown:
                snapshots.append(_snapshot(scene, package, phase, stop, float(time[stop - 1])))
            cycle += 1
        else:
            updates += settle(package, yarn, max(start - 2, 0), stop, stop, 0.0, SETTLED)
        if progress is not None:
            progress(stop / total)
    snapshots.append(_snapshot(scene, package, phase, total, scene.duration))
    ends = sample_times(scene)
    guide_phase = np.interp(ends, time[:total], phase[:total])
    end = snapshots[-1]
    pull = scene.tension + scene.tension_slope * time[:total]
    return WindingResult(
        scene=scene,
        mode="fast",
        mode_reason=reason,
        outcome=WindingOutcome.COMPLETED,
        message="",
        time=ends,
        span_tension=window_means(time[:total], tension, ends),
        guide_phase=guide_phase,
        guide_position=np.array([scene.stroke * traverse(p, scene.reversal)[0] for p in guide_phase]),
        layers_T_over_T0=layer_means(end.layer, end.tension / pull, math.floor(scene.cycles)),
        snapshots=tuple(snapshots),
        penetration_max=_approach(package, yarn, total),
        element_steps=updates,
        wall_s=perf_counter() - begin,
    )


def _approach(package: Package, yarn: Yarn, laid: int) -> float:
    """Largest approach beyond touching [m], of yarn to bobbin or to yarn."""
    present = package.above + 1 < laid
    i, k = package.below[present], package.above[present]
    s, t = package.below_at[present], package.above_at[present]
    h = package.height
    yarns = yarn.diameter + (1 - s) * h[i] + s * h[i + 1] - (1 - t) * h[k] - t * h[k + 1]
    return float(max(-h[:laid].min(), yarns.max(initial=0.0), 0.0))
