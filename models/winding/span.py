"""The free yarn of the fast mode: a string from the feed through the guide to the bobbin, and its tension.

String. Across, with v the velocity of the yarn and s its slope dz/dx, drawn at the speed V, T its tension:

    v_t + V v_x = (T/ρ) s_x,     s_t + V s_x = v_x,     characteristics v ∓ c s at the speeds V ± c,  c² = T/ρ.

It rests across in the feed's eyelet (z = 0; a free tail has no end that echoes), moves with the guide's eye or freely
in its play, and is laid where it touches the bobbin on top: there it moves with the surface, v = 0, and what is laid
has its slope. Its waves and the lag of the lay point behind the guide follow from that, the latter as the limit of slow
motion: dz/ds = (z_eye − z)/g. Scheme: Lax and Wendroff at T₀, characteristics at the ends, then a push of (T − T₀) s_x,
implicit in what it does to the length, so that it never drives what it damps.

Tension. Along the yarn waves pass at once. Matched feed: T = T₀ + ρc (u − ū), u the speed at which yarn is taken in, ū
its running mean; free tail: the wave that u sends out comes back with its tension reversed, T = ρc u + 2 g,
g(t) = −f(t − 2ℓ/c), f = ρc u + g. Yarn is taken in by the bobbin, and by what the string grows longer.

Left out: the string's vertical motion; its bending, whose waves are faster by (2π/wavelength)² B/2T; the guide's
friction, but in the tension after it.

The string: Swope and Ames, Vibrations of a moving threadline, J. Franklin Inst. 275 (1963).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import borrowing, compiled, inner
from models.winding.drive import travel, traverse
from models.winding.scene import WindingScene

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

CELL = 7.5e-3
"""Usual cell of the string [m]: half of that changes the tension of a short package by 1 % (rms over the cycle)."""
FEWEST, MOST = 3, 300
"""Cells of each part of the string: a span of metres has waves that are slower than they need to be told."""
TAIL_SEEN = 0.3
"""Length of a tail whose motion across is computed [m]."""
COURANT = 0.9
"""Distance in cells that a wave travels in a step."""
SLOWEST = 4.0
"""Least c over V: yarn nearly as fast as its own waves is computed with faster ones, so that it lags as if at rest."""
STEPS = 200
"""Most steps per node, about: waves that come and go more often meanwhile may be slower, the yarn follows at once."""

_travel = inner(travel)
_traverse = inner(traverse)


class Line(NamedTuple):
    """The machine as the yarn's path and tension need it, SI."""

    density: float
    """ρ [kg/m]."""
    impedance: float
    """ρc of longitudinal waves."""
    pull: float
    pull_slope: float
    speed: float
    rise: float
    speed_slope: float
    radius: float
    """Of the bobbin in the middle."""
    taper: float
    turning: float
    """Angle of the bobbin per travel of the yarn [rad/m]."""
    per_cycle: float
    """Angle of the bobbin per guide cycle [rad]."""
    stroke: float
    reversal: float
    guide: float
    """Guide to bobbin [m]."""
    feed: float
    """Eyelet to guide, or length of the tail [m]."""
    clearance: float
    friction: float
    memory: float
    active: bool
    echo: float
    """Twice the time over the length that a longitudinal wave takes through the tail [s/m]."""


def line_of(scene: WindingScene) -> Line:
    """The line of `scene`."""
    return Line(
        density=scene.linear_density,
        impedance=scene.impedance,
        pull=scene.tension,
        pull_slope=scene.tension_slope,
        speed=scene.speed,
        rise=scene.speed_rise,
        speed_slope=scene.speed_slope,
        radius=scene.bobbin_radius,
        taper=math.tan(scene.cone_angle),
        turning=math.cos(scene.winding_angle) / scene.bobbin_radius,
        per_cycle=2 * math.pi * scene.turns_per_cycle,
        stroke=scene.stroke,
        reversal=scene.reversal,
        guide=scene.guide_distance,
        feed=scene.feed_length,
        clearance=scene.guide_clearance,
        friction=scene.guide_friction,
        memory=scene.feed_memory,
        active=scene.feed == "active",
        echo=2 / scene.wave_speed,
    )


@borrowing
def _matched(m: Line, drift: float, time: float, step: float, taken: float) -> tuple[float, float]:
    """Tension [N] at a matched feed from which yarn is drawn at the speed `taken` during `step`, and the new ū − V."""
    change = taken - _travel(time, m.speed, m.rise, m.speed_slope)[1]
    pull = m.pull + m.pull_slope * time + m.impedance * (change - drift)
    return pull, drift + (1 - math.exp(-step / m.memory)) * (change - drift)


class String(NamedTuple):
    """A part of the string, its points from upstream to downstream, arrays of shape (cells + 1,)."""

    cell: float
    """[m]."""
    v: Array
    """Velocity across [m/s]."""
    s: Array
    """Slope."""
    next_v: Array
    """Room for both after a step."""
    next_s: Array


@inner
def _new_string(length: float, cells: int, slope: float) -> String:
    """A straight string at rest."""
    return String(
        length / cells, np.zeros(cells + 1), np.full(cells + 1, slope), np.zeros(cells + 1), np.zeros(cells + 1)
    )


@borrowing
def _flow(of: String, speed: float, c: float, dt: float) -> None:
    """A step of the inner points by Lax and Wendroff, into the room."""
    v, s = of.v, of.s
    ratio, square = dt / of.cell, c * c
    first, second, sum_ = ratio / 2, ratio * ratio / 2, speed * speed + square
    for i in range(1, v.shape[0] - 1):
        dv, ds = v[i + 1] - v[i - 1], s[i + 1] - s[i - 1]
        ddv, dds = v[i + 1] - 2 * v[i] + v[i - 1], s[i + 1] - 2 * s[i] + s[i - 1]
        of.next_v[i] = v[i] - first * (speed * dv - square * ds) + second * (sum_ * ddv - 2 * speed * square * dds)
        of.next_s[i] = s[i] - first * (speed * ds - dv) + second * (sum_ * dds - 2 * speed * ddv)


@borrowing
def _arriving(of: String, end: int, inside: int, c: float, way: float) -> float:
    """The characteristic v + c s that arrives at the point `end`, having come `way` m from the point `inside`."""
    share = way / of.cell
    return (1 - share) * (of.v[end] + c * of.s[end]) + share * (of.v[inside] + c * of.s[inside])


@borrowing
def _length(of: String) -> float:
    """[m]."""
    total = 0.0
    for i in range(of.s.shape[0] - 1):
        slope = (of.s[i] + of.s[i + 1]) / 2
        total += math.sqrt(1 + slope * slope)
    return of.cell * total


@borrowing
def _bends(of: String) -> float:
    """∫ s_x² dx [1/m]."""
    total = 0.0
    for i in range(1, of.s.shape[0] - 1):
        total += (of.s[i + 1] - of.s[i - 1]) ** 2
    return total / (4 * of.cell)


@borrowing
def _push(of: String, gain: float) -> None:
    """Velocity of the inner points ← itself + `gain` · s_x."""
    for i in range(1, of.v.shape[0] - 1):
        of.v[i] += gain * (of.s[i + 1] - of.s[i - 1]) / (2 * of.cell)


PLACE, EYE, GONE = range(3)
"""Places in the state of `fly`: z of the lay point and of the yarn in the eye [m]; length that a tail's waves have
taken with them [m]."""


@borrowing
def _step(m: Line, front: String, back: String, at: Array, guide: float, speed: float, c: float, dt: float) -> None:
    """A step of both strings, with the guide at z = `guide` after it."""
    _flow(front, speed, c, dt)
    _flow(back, speed, c, dt)
    last, eye = front.v.shape[0] - 1, back.v.shape[0] - 1
    down, up = (speed + c) * dt, (c - speed) * dt
    # Laid yarn does not move across.
    front.next_v[last], front.next_s[last] = 0.0, -_arriving(front, last, last - 1, -c, down) / c
    # Nor does that in the eyelet; waves up a tail do not come back.
    sent = _arriving(back, 0, 1, c, up)
    if m.active:
        back.next_s[0] = sent / (c + speed)
        back.next_v[0] = speed * back.next_s[0]
    else:
        back.next_v[0], back.next_s[0] = sent / 2, sent / (2 * c)
        at[GONE] += back.next_s[0] ** 2 / 2 * up
    # In its play the yarn has one velocity and slope on both sides of the guide; else the velocity is that of the eye.
    ahead, behind = _arriving(front, 0, 1, c, up), _arriving(back, eye, eye - 1, -c, down)
    slope = (ahead - behind) / (2 * c)
    free = at[EYE] + ((ahead + behind) / 2 - speed * slope) * dt
    held = min(max(free, guide - m.clearance), guide + m.clearance)
    rate = (held - at[EYE]) / dt
    at[EYE] = held
    if held == free:
        front.next_s[0], back.next_s[eye] = slope, slope
    else:
        front.next_s[0], back.next_s[eye] = (ahead - rate) / (c + speed), (rate - behind) / (c - speed)
    front.next_v[0], back.next_v[eye] = rate + speed * front.next_s[0], rate + speed * back.next_s[eye]
    at[PLACE] -= speed * (front.s[last] + front.next_s[last]) / 2 * dt
    for of in (front, back):
        for i in range(of.v.shape[0]):
            of.v[i], of.s[i] = of.next_v[i], of.next_s[i]


@compiled
def fly(m: Line, time: Array, cells_front: int, cells_back: int, length_back: float) -> tuple[Array, Array, Array]:
    """Motion of the string while the bobbin turns.

    Parameters
    ----------
    time : at which each node touches the bobbin [s], shape (n,), from 0.
    cells_front, cells_back : of the string before and behind the guide.
    length_back : of the string behind the guide [m].

    Returns
    -------
    Where each node is laid along the axis [m]; length of the free yarn then, but for a constant [m]; wrap at the guide
    [rad]; shape (n,) each.
    """
    z, free, wrap = np.empty(time.size), np.empty(time.size), np.zeros(time.size)
    at = np.zeros(3)
    at[PLACE] = at[EYE] = m.stroke * _traverse(0.0, m.reversal)[0]
    front = _new_string(m.guide, cells_front, 0.0)
    back = _new_string(length_back, cells_back, at[EYE] / length_back if m.active else 0.0)
    cell = min(front.cell, back.cell)
    length, drift = _length(front) + _length(back), 0.0
    z[0], free[0] = at[PLACE], length
    for k in range(1, time.size):
        duration = time[k] - time[k - 1]
        fastest = _travel(time[k], m.speed, m.rise, m.speed_slope)[1] * (1 + abs(m.taper) * m.stroke / 2 / m.radius)
        c = min(math.sqrt((m.pull + m.pull_slope * time[k]) / m.density), STEPS * COURANT * cell / duration - fastest)
        c = max(c, SLOWEST * fastest)
        steps = int(duration * (fastest + c) / (COURANT * cell)) + 1
        dt = duration / steps
        for step in range(1, steps + 1):
            now = time[k - 1] + step * dt
            way, speed = _travel(now, m.speed, m.rise, m.speed_slope)
            speed *= m.turning * (m.radius + m.taper * at[PLACE])
            guide = m.stroke * _traverse(way * m.turning / m.per_cycle, m.reversal)[0]
            _step(m, front, back, at, guide, speed, c, dt)
            longer = _length(front) + _length(back) + at[GONE]
            taken = speed * math.sqrt(1 + front.s[-1] ** 2) + (longer - length) / dt
            length = longer
            pull, drift = _matched(m, drift, now, dt, taken)
            own = m.impedance / m.density * dt * (_bends(front) + _bends(back))
            gain = (pull - m.pull - m.pull_slope * now) / (1 + own) * dt / m.density
            _push(front, gain)
            _push(back, gain)
        z[k], free[k] = at[PLACE], length
        wrap[k] = abs(math.atan(front.s[0]) - math.atan(back.s[-1]))
    return z, free, wrap


def path(scene: WindingScene, time: Array) -> tuple[Array, Array, Array]:
    """As `fly`, for `scene` and the times at which the nodes touch [s], shape (n,)."""
    back = scene.feed_length if scene.feed == "active" else min(scene.feed_length, TAIL_SEEN)
    cells_front, cells_back = (min(max(math.ceil(x / CELL), FEWEST), MOST) for x in (scene.guide_distance, back))
    return fly(line_of(scene), time, cells_front, cells_back, back)


class Feed(NamedTuple):
    """State of the feed while yarn is laid; one node a step."""

    state: Array
    """ū − V [m/s], length of yarn taken in [m], shape (2,)."""
    sent: Array
    """f, the tension of the wave sent up the tail at each node [N], shape (n,)."""


def new_feed(nodes: int) -> Feed:
    """A feed at rest."""
    return Feed(np.zeros(2), np.zeros(nodes))


@borrowing
def _sent_at(feed: Feed, time: Array, count: int, moment: float) -> float:
    """F [N] at a moment [s], linear between the first `count` nodes; its first value before them."""
    if moment <= time[0]:
        return float(feed.sent[0])
    after = min(int(np.searchsorted(time[:count], moment)), count - 1)
    if after == 0 or moment >= time[count - 1]:
        return float(feed.sent[count - 1])
    share = (moment - time[after - 1]) / (time[after] - time[after - 1])
    return float((1 - share) * feed.sent[after - 1] + share * feed.sent[after])


@borrowing
def tension_at(m: Line, feed: Feed, time: Array, k: int, taken: float, wrap: float) -> float:
    """Tension of the span [N] while node k is laid and `taken` m of yarn are drawn in since the node before it."""
    step = time[k] - time[k - 1]
    speed = taken / step
    if m.active:
        pull, feed.state[0] = _matched(m, feed.state[0], time[k], step, speed)
    else:
        left = max(m.feed - feed.state[1], 0.0)
        back = -_sent_at(feed, time, k, time[k] - left * m.echo)
        pull = m.pull + m.pull_slope * time[k] + m.impedance * speed + 2 * back
        feed.sent[k] = m.impedance * speed + back
    feed.state[1] += taken
    return pull * math.exp(m.friction * wrap)
