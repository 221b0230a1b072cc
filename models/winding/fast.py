"""Fast mode: the package from the kinematics of the lay path and one radial degree of freedom per laid node.

Path. The span is straight and touches the bobbin at its top, so that its angle is the angle of lay:
dz/ds = (z_eye − z)/g over the circumference s. Nodes lie at equal angles of the bobbin and do not slip.

Tension of the span. Waves in the span pass to the feed at once compared with a guide cycle. Matched feed:
T = T₀ + ρc (u − ū), u the speed at which yarn is taken in, ū its running mean; free tail: the wave that u sends out
comes back with its tension reversed, T = ρc u + 2 g, g(t) = −f(t − 2ℓ/c), f = ρc u + g.

Package. Every crossing of the path with itself is known beforehand. New yarn is laid as a string of constant tension
over what is below it, and sinks by the share `SUNK` of what the surface yields; that fixes the natural length of its
elements. From then on it is held circumferentially and axially by the bobbin (no slip), its nodes move radially until
tension, bending, the yielding surface and the crossings are in equilibrium (`settle.py`).

Cost. New yarn moves what lies below it the less the deeper it lies. So deep nodes count as resting at larger steps
while yarn is laid, and the package as a whole relaxes and comes to rest each time its layers have grown by a share:
once a package is deeper than a landing reaches, a metre costs the same however deep it is.

Left out: whirling and transverse waves, yarn lying alongside yarn without crossing it, friction between yarns.
"""

import math
from bisect import bisect
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from models.winding.drive import travel, traverse
from models.winding.lay_path import find_crossings, lay_path
from models.winding.package import Laying, Package, Yarn, element_lengths, put_on_top
from models.winding.result import Progress, Snapshot, WindingOutcome, WindingResult
from models.winding.sampling import SHOWN_LAYERS, layer_means, sample_times, window_means
from models.winding.scene import WindingScene
from models.winding.settle import new_room, settle

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BATCH = 24
"""Nodes laid before the package is relaxed: about a quarter turn."""
AHEAD = 8
"""Nodes beyond a batch that are laid on trial: yarn ahead lifts what lies up to √(2 R d) before it."""
SETTLED = 1e-7
"""Radial step [m] below which a node rests. Against 1e-9 m at every depth, and the whole at rest after every layer, no
layer of 9 m changes by more than 0.0005 T₀, of 30 m by more than 0.006 T₀."""
FADE = 1.0
"""Growth of that step per layer of depth, over itself, while yarn is laid."""
GROWTH = 1.2
"""Growth of the number of layers after which the whole package relaxes and comes to rest."""
TABLE = 20_001
"""Points of the table that inverts the drive's travel."""


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
        cosine=math.cos(angle_step),
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
            back = -self._sent_at(time - 2 * tail / scene.wave_speed)
            pull += scene.impedance * speed + 2 * back
            self.sent_time.append(time)
            self.sent.append(scene.impedance * speed + back)
        self.taken += taken
        return pull * math.exp(scene.guide_friction * wrap)

    def _sent_at(self, time: float) -> float:
        """F [N] at a time [s], linear between its points; its first value before them."""
        after = bisect(self.sent_time, time)
        if after == 0 or after == len(self.sent):
            return self.sent[min(after, len(self.sent) - 1)]
        (t0, t1), (f0, f1) = self.sent_time[after - 1 : after + 1], self.sent[after - 1 : after + 1]
        return f0 + (f1 - f0) / (t1 - t0) * (time - t0)


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
    room = new_room(package)
    span, relaxation = _Span(scene), _Relaxation(scene, total)
    tension = np.full(total, scene.tension)
    snapshots: list[Snapshot] = []
    cycle, updates, last_whole = 1, 0, 0
    fade = FADE * float(phase[1])
    for start in range(0, total, BATCH):
        stop = min(start + BATCH, total)
        first = max(start - 1, 0)
        put_on_top(package, yarn.diameter, start, stop + AHEAD)
        updates += settle(package, yarn, room, start, Laying(stop + AHEAD, start, tension[first]), SETTLED, fade)
        lengths = element_lengths(package, first, stop - 1)
        for k, length in enumerate(lengths, first):
            taken = length + free[k + 1] - free[k]
            tension[k + 1] = span.advance(time[k + 1], time[k + 1] - time[k], taken, abs(wrap[k + 1]))
        package.natural[first : stop - 1] = lengths / (1 + tension[first + 1 : stop] / scene.axial_stiffness)
        relaxation.since[first : stop - 1] = time[first + 1 : stop]
        complete = bool(phase[stop - 1] >= cycle)
        if (complete and (cycle in SHOWN_LAYERS or cycle >= GROWTH * last_whole)) or stop == total:
            last_whole = cycle
            strain = element_lengths(package, 0, stop - 1) / package.natural[: stop - 1] - 1
            relaxation.advance(package, strain, time[stop - 1])
            updates += settle(package, yarn, room, 0, Laying(stop, stop, 0.0), SETTLED, 0.0)
            if complete and cycle in SHOWN_LAYERS:
                snapshots.append(_snapshot(scene, package, phase, stop, float(time[stop - 1])))
        else:
            updates += settle(package, yarn, room, max(start - 2, 0), Laying(stop, stop, 0.0), SETTLED, fade)
        cycle += complete
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
