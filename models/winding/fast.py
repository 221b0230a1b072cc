"""Fast mode: the package from the kinematics of the lay path and one radial degree of freedom per laid node.

Path and span. The free yarn is a string (`span.py`): it gives the path on the bobbin and, with the length that the
package takes in, the tension. Nodes lie at equal angles of the bobbin and do not slip.

Package. Every crossing of the path with itself is known beforehand (`crossings.py`). New yarn is laid as a string of
constant tension over what is below it; the natural length of its elements is that at which the bobbin holds it, after a
share of its sinking (`landing.py`). From then on it is held circumferentially and axially by the bobbin (no slip), its
nodes move radially until tension, bending, the yielding surface and the crossings are in equilibrium (`settle.py`).

Cost. New yarn moves what lies below it the less the deeper it lies. So deep nodes count as resting at larger steps
while yarn is laid, and the package as a whole relaxes and comes to rest each time its layers have grown by a share:
once a package is deeper than a landing reaches, a metre costs nearly the same however deep it is. Until then it costs
more with each layer, because a landing moves more nodes.

Left out: whirling, the weight and inertia of laid yarn, yarn lying alongside yarn without crossing it, friction between
yarns, and yarn that may slide off what it crosses at a small angle, as in the reversals: here it stays on top.
"""

import math
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled
from models.winding.assembly import Room, new_room
from models.winding.drive import travels, traverses
from models.winding.package import (
    Laying,
    Package,
    Yarn,
    approach,
    element_lengths,
    length_of,
    look_around,
    new_package,
    put_on_top,
    yarn_of,
)
from models.winding.result import Progress, Snapshot, WindingOutcome, WindingResult, giving_said
from models.winding.sampling import SHOWN_LAYERS, layer_means, sample_times, window_means
from models.winding.scene import WindingScene
from models.winding.settle import settle
from models.winding.span import Feed, Line, line_of, new_feed, path, tension_at

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BATCH = 24
"""Nodes laid before the package comes to rest: about a quarter turn. With 4, 12 or 48 layers of 9 m change by up to
0.01 T₀, of 30 m by 0.02 T₀, of 90 m by 0.03 T₀."""
AHEAD = 8
"""Nodes beyond a batch that are laid on trial: yarn ahead lifts what lies up to √(2 R d) before it. With 12 or 16
layers change by up to 0.002 T₀ (9 and 30 m) and 0.004 T₀ (90 m)."""
SETTLED = 1e-6
"""Radial step [m] below which a node rests. Against 1e-9 m at every depth layers of 9 m change by up to 0.0003 T₀, of
30 m by 0.009 T₀, of 90 m by 0.02 T₀: less than by another `BATCH`."""
FADE = 0.3
"""Growth of that step per layer of depth, over itself, while yarn is laid."""
LEAST = 0.05
"""Share of T₀ at which yarn is laid at least: a slack string has no shape. Where the span goes slack, its tension is
still that of its waves."""
GROWTH = 1.3
"""Growth of the number of layers after which the whole package relaxes and comes to rest. Against 1.03 layers of 30 m
change by up to 0.005 T₀, of 90 m by 0.009 T₀."""
TABLE = 20_001
"""Points of the table that inverts the drive's travel."""


class _Relaxation:
    """Strains of the Prony branches of all laid elements."""

    def __init__(self, scene: WindingScene, elements: int) -> None:
        self.weights, self.times = np.array(scene.prony_weights), np.array(scene.prony_times)
        self.strains = np.zeros((len(self.weights), elements))
        self.since = np.zeros(elements)
        """Time up to which each element has relaxed [s]."""

    def advance(self, package: Package, strain: Array, time: float) -> None:
        """Let the elements with `strain`, shape (k,), relax until `time`; writes the nodes' `relaxed`."""
        k = len(strain)
        share = 1 - np.exp(-(time - self.since[:k]) / self.times[:, np.newaxis])
        self.strains[:, :k] += share * (strain - self.strains[:, :k])
        self.since[:k] = time
        package.node["relaxed"][:k] = self.weights @ self.strains[:, :k]


class _Schedule:
    """When each node touches the bobbin."""

    def __init__(self, scene: WindingScene) -> None:
        self.angle_step = scene.element_length * math.cos(scene.winding_angle) / scene.bobbin_radius
        per_cycle = 2 * math.pi * scene.turns_per_cycle / self.angle_step
        self.total = int(scene.cycles * per_cycle) + 2
        """Nodes that are laid."""
        self.phase = np.arange(self.total + AHEAD) / per_cycle
        """[cycles], shape (n,)."""
        # A little beyond the end, because nodes on trial are laid after it.
        end = scene.duration + scene.speed_rise + 2 * AHEAD * scene.element_length / scene.speed
        table = np.linspace(0, end, TABLE)
        travelled = travels(table, scene.speed, scene.speed_rise, scene.speed_slope)
        self.time = np.interp(self.phase * (scene.wound_length / scene.cycles), travelled, table)
        """[s], shape (n,)."""

    def layers_by(self, nodes: int) -> int:
        """Layers that so many nodes complete."""
        return int(self.phase[nodes - 1])


@compiled
def _lay(
    p: Package,
    yarn: Yarn,
    room: Room,
    line: Line,
    feed: Feed,
    time: Array,
    free: Array,
    wrap: Array,
    tension: Array,
    start: int,
    stop: int,
    settled: float,
    fade: float,
) -> tuple[bool, int]:
    """Lay nodes start … stop − 1, a batch at a time, each at rest while it is laid; whether all were, visits to nodes.

    `tension` at `start` − 1 is known, and written for the nodes laid.
    """
    at_rest, visits = True, 0
    for begin in range(start, stop, BATCH):
        end = min(begin + BATCH, stop)
        first = max(begin - 1, 0)
        put_on_top(p, yarn.diameter, begin, end + AHEAD)
        now = Laying(end + AHEAD, max(tension[first], LEAST * tension[0]))
        rests, more = settle(p, yarn, room, max(begin - 2, 0), now, settled, fade)
        at_rest, visits = at_rest and rests, visits + more
        for k in range(first, end - 1):
            length = length_of(p, k, yarn.sunk)
            taken = length + free[k + 1] - free[k]
            tension[k + 1] = tension_at(line, feed, time, k + 1, taken, wrap[k + 1])
            p.node[k].hold = (yarn.axial + tension[k + 1]) / length
    return at_rest, visits


def _snapshot(scene: WindingScene, package: Package, schedule: _Schedule, z: Array, laid: int, time: float) -> Snapshot:
    tension = scene.axial_stiffness * (_strain(package, scene, laid) - package.node["relaxed"][: laid - 1])
    radius = package.node["radius"][:laid] + package.height[:laid]
    angle = schedule.angle_step * np.arange(laid)
    return Snapshot(
        time=time,
        layer=np.floor(schedule.phase[:laid]).astype(np.int64) + 1,
        # The bobbin turns clockwise, seen against e_z: yarn laid at time 0 is on top.
        position=np.column_stack([radius * np.sin(-angle), radius * np.cos(angle), z[:laid]]),
        tension=np.concatenate([tension[:1], (tension[1:] + tension[:-1]) / 2, tension[-1:]]),
    )


def _strain(package: Package, scene: WindingScene, laid: int) -> Array:
    """Strain of the elements, shape (laid − 1,)."""
    return element_lengths(package, 0, laid - 1) * package.node["hold"][: laid - 1] / scene.axial_stiffness - 1


def wind_fast(scene: WindingScene, reason: str, progress: Progress | None = None) -> WindingResult:
    """Run `scene` in the fast mode.

    Parameters
    ----------
    reason : why this mode, kept in the result.
    progress : told the share of the nodes laid.
    """
    begin = perf_counter()
    schedule = _Schedule(scene)
    time, total = schedule.time, schedule.total
    z, free, wrap = path(scene, time)
    package, yarn = new_package(scene, z, schedule.angle_step), yarn_of(scene)
    room, line, feed = new_room(package), line_of(scene), new_feed(total)
    relaxation = _Relaxation(scene, total)
    relaxation.since[:] = time[1 : total + 1]
    tension = np.full(total, scene.tension)
    snapshots: list[Snapshot] = []
    fade = FADE * float(schedule.phase[1])
    at_rest, visits, laid, last_whole = True, 0, 0, 0
    while laid < total:
        start, cycle = laid, schedule.layers_by(max(laid, 1)) + 1
        # To the end of the batch that completes the layer.
        complete = int(np.searchsorted(schedule.phase, cycle)) + 1
        laid = min(start + -(-(complete - start) // BATCH) * BATCH, total)
        were_at_rest, spent = _lay(
            package, yarn, room, line, feed, time, free, wrap, tension, start, laid, SETTLED, fade
        )  # fmt: skip
        done = schedule.layers_by(laid)
        shown = done in SHOWN_LAYERS and done == cycle
        whole = shown or done >= GROWTH * last_whole or laid == total
        if whole:
            last_whole = done
            relaxation.advance(package, _strain(package, scene, laid), float(time[laid - 1]))
            look_around(package, yarn.diameter, laid)
        start = 0 if whole else max(laid - 2, 0)
        rests, more = settle(package, yarn, room, start, Laying(laid, 0.0), SETTLED, 0.0 if whole else fade)
        at_rest, visits = at_rest and were_at_rest and rests, visits + spent + more
        if shown:
            snapshots.append(_snapshot(scene, package, schedule, z, laid, float(time[laid - 1])))
        if progress is not None:
            progress(laid / total)
    snapshots.append(_snapshot(scene, package, schedule, z, total, scene.duration))
    ends = sample_times(scene)
    while_laid = np.concatenate(
        [time[:1], (time[1:total] + time[: total - 1]) / 2]
    )  # a node's tension is a step's mean
    guide_phase = np.interp(ends, time[:total], schedule.phase[:total])
    end = snapshots[-1]
    pull = scene.tension + scene.tension_slope * time[:total]
    deepest = _deepest(package, yarn, total)
    finite = bool(np.all(np.isfinite(tension)) and np.all(np.isfinite(end.tension)))
    outcome = WindingOutcome.COMPLETED if at_rest else WindingOutcome.RESTLESS
    if not finite:
        outcome = WindingOutcome.DIVERGED
    return WindingResult(
        scene=scene,
        mode="fast",
        mode_reason=reason,
        outcome=outcome,
        message=giving_said(scene, deepest) if outcome.ok else outcome.value,
        time=ends,
        span_tension=window_means(while_laid, tension, ends),
        guide_phase=guide_phase,
        guide_position=scene.stroke * traverses(guide_phase, scene.reversal),
        layers_T_over_T0=layer_means(end.layer, end.tension / pull, math.floor(scene.cycles)),
        snapshots=tuple(snapshots),
        penetration_max=deepest,
        element_steps=visits,
        wall_s=perf_counter() - begin,
    )


@compiled
def _deepest(p: Package, yarn: Yarn, laid: int) -> float:
    """Largest approach beyond touching [m], of yarn to bobbin or to yarn."""
    deepest = 0.0
    for e in range(laid - 1):
        deepest = max(deepest, -p.height[e])
        for q in range(p.first[e], p.first[e + 1]):
            if p.crossing[q].other > e:
                break
            deepest = max(deepest, approach(p, e, q, yarn.diameter))
    return deepest
