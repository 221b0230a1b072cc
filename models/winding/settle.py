"""Rest of the package: the minimum of its energy (`package.py`), found where something moves.

A node that is moved alone hands a disturbance on by one contact, so that a stack of L layers needs of the order of L²
visits to each node. Here a queue of nodes that are moved alone only finds which nodes move; those then take one step of
Newton's method together, by conjugate gradients, which reach through the stack. The queue goes on from those that are
not at rest after it: deep down, where contacts do not open and close, one step is enough.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import borrowing, compiled
from models.winding.package import Laying, Package, Yarn, across, along, approach, press

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SWEEPS = 1.0
"""Moves alone per visited node before all are corrected together."""
GRADIENTS = 40
"""Conjugate gradients per Newton step."""
INEXACT = 0.1
"""Share of the force left by them: more exact steps are wasted while contacts still open and close."""
OVERSHOOT = 0.3
"""Newton steps are shortened where the force against them exceeds this share of the force along them at their start."""
LONGEST = 1.0
"""Longest Newton step of a node over the diameter: the approach at which contact hardens is two of them."""
SHORTENED = 6
"""Times a Newton step is shortened."""
ROUNDS = 100
"""Of queue and correction; four to six are usual."""
NEVER, BEFORE = -1, -2
"""Places of nodes that were not visited, and of those visited in the round before only."""


class Room(NamedTuple):
    """Room for `settle`, empty between its calls; n nodes, m crossings. `visited` arrays have shape (n + 1,): the last
    entry stands for all nodes that were not visited and are held.
    """

    queue: Integers
    """A ring of nodes, shape (n,)."""
    waiting: NDArray[np.bool_]
    """Whether a node is in it, shape (n,)."""
    counts: Integers
    """Head of the queue, nodes in it, nodes visited, crossings that press, shape (4,)."""
    visited: Integers
    """Nodes in the order of their first visit, shape (n,)."""
    before: Integers
    """Those of the round before, shape (n,)."""
    place: Integers
    """Of each node among the visited, or a negative code, shape (n + 2,)."""
    one: Integers
    """Place of the next node along the yarn; of visited nodes, as all below."""
    two: Integers
    """Place of the next but one."""
    force: Array
    """Outwards [N]."""
    stiffness: Array
    """[N/m]."""
    next_one: Array
    """Coupling to the next node along the yarn [N/m]."""
    next_two: Array
    """Coupling to the next but one [N/m]."""
    step: Array
    """[m]."""
    rest: Array
    """Force that the step leaves [N]."""
    direction: Array
    """[m]."""
    image: Array
    """Stiffness times direction [N]."""
    ends: Integers
    """Places of the four nodes at each crossing that presses, shape (m, 4)."""
    arms: Array
    """Derivatives of its approach in their heights, shape (m, 4)."""
    slopes: Array
    """Its stiffness [N/m], shape (m,)."""


def new_room(p: Package) -> Room:
    """Room for the whole of `p`."""
    n, m = p.height.size, p.crossing.size // 2
    return Room(
        np.empty(n, np.int64),
        np.zeros(n, np.bool_),
        np.zeros(4, np.int64),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.full(n + 2, NEVER),
        np.empty(n + 1, np.int64),
        np.empty(n + 1, np.int64),
        *(np.zeros(n + 1) for _ in range(8)),
        ends=np.empty((m, 4), np.int64),
        arms=np.empty((m, 4)),
        slopes=np.empty(m),
    )


@borrowing
def _wake(room: Room, k: int) -> None:
    """Put node k into the queue, and among the visited."""
    if room.waiting[k]:
        return
    room.waiting[k] = True
    last = room.counts[0] + room.counts[1]
    room.queue[last - room.queue.shape[0] if last >= room.queue.shape[0] else last] = k
    room.counts[1] += 1
    if room.place[k] < 0:
        room.place[k] = room.counts[2]
        room.visited[room.counts[2]] = k
        room.counts[2] += 1


@borrowing
def _next(room: Room) -> int:
    """Take the first node out of the queue."""
    k = int(room.queue[room.counts[0]])
    room.counts[0] = room.counts[0] + 1 if room.counts[0] + 1 < room.queue.shape[0] else 0
    room.counts[1] -= 1
    room.waiting[k] = False
    return k


@borrowing
def _wake_around(p: Package, yarn: Yarn, room: Room, k: int, laid: int, step: float, new: bool) -> None:
    """Wake what a `step` of node k acts on: its neighbours along the yarn, and the nodes of the elements that touch its
    two elements or touched them before; of these only those that were never visited if `new`.
    """
    for other in range(max(k - 2, 1), min(k + 3, laid)):
        if other != k and (room.place[other] == NEVER or not new):
            _wake(room, other)
    for e in range(max(k - 1, 0), min(k + 1, laid - 1)):
        for q in range(p.near[e].low, p.near[e].high):
            o = p.crossing[q].other
            if o + 1 >= laid:
                break
            if new and room.place[o] != NEVER and room.place[o + 1] != NEVER:
                continue
            if approach(p, e, q, yarn.diameter) < -step:
                continue
            for other in range(o, o + 2):
                if other > 0 and (room.place[other] == NEVER or not new):
                    _wake(room, other)


@borrowing
def _rests(now: Laying, k: int, settled: float, fade: float) -> float:
    """Step [m] below which node k rests."""
    return settled * (1 + fade * (now.laid - k))


@borrowing
def _find(p: Package, yarn: Yarn, room: Room, now: Laying, settled: float, fade: float) -> int:
    """Move the nodes of the queue alone, and what they move, until none is left or enough are found; their number."""
    counts = room.counts
    alone = 0
    while counts[1] > 0 and alone < SWEEPS * counts[2]:
        k = _next(room)
        alone += 1
        force, stiffness, _, _ = along(p, yarn, now, k)
        pressed, resisting = across(p, yarn, now, k)
        step = (force + pressed) / (stiffness + resisting)
        p.height[k] += step
        if abs(step) > _rests(now, k, settled, fade):
            _wake_around(p, yarn, room, k, now.laid, abs(step), False)
    return alone


@borrowing
def _assemble(p: Package, yarn: Yarn, room: Room, now: Laying) -> None:
    """Forces on the visited nodes and their stiffness, all other nodes held."""
    count, held = room.counts[2], room.queue.shape[0]
    place = room.place
    for a in range(count):
        k = room.visited[a]
        force, stiffness, next_one, next_two = along(p, yarn, now, k)
        room.force[a], room.stiffness[a], room.next_one[a], room.next_two[a] = force, stiffness, next_one, next_two
        room.one[a] = place[k + 1] if place[k + 1] >= 0 else held
        room.two[a] = place[k + 2] if place[k + 2] >= 0 else held
    pressing = 0
    for a in range(count):
        k = room.visited[a]
        for e in range(k - 1, k + 1):
            # Each element once: from its first node, or its second if that alone was visited. Each crossing once: from
            # the element below, or that above if neither node of the other was visited.
            if e < 0 or e + 1 >= now.laid or (e < k and place[e] >= 0):
                continue
            for q in range(p.near[e].low, p.near[e].high):
                c = p.crossing[q]
                o = c.other
                if o + 1 >= now.laid:
                    break
                if o < e and (place[o] >= 0 or place[o + 1] >= 0):
                    continue
                depth = approach(p, e, q, yarn.diameter)
                if depth <= 0:
                    continue
                push, slope = press(depth / yarn.diameter)
                push *= c.stiffness * yarn.diameter
                slope *= c.stiffness
                s, t, sign = c.own_at, c.other_at, 1.0 if o > e else -1.0
                arms = (sign * (1 - s), sign * s, sign * (t - 1), -sign * t)
                for i, node in enumerate((e, e + 1, o, o + 1)):
                    b = place[node] if place[node] >= 0 else held
                    room.ends[pressing, i], room.arms[pressing, i] = b, arms[i]
                    room.force[b] -= push * arms[i]
                    room.stiffness[b] += slope * arms[i] * arms[i]
                room.slopes[pressing] = slope
                pressing += 1
    room.counts[3] = pressing


@borrowing
def _apply(room: Room) -> None:
    """Image ← stiffness · direction."""
    count, held = room.counts[2], room.queue.shape[0]
    x, y = room.direction, room.image
    x[held], y[held] = 0.0, 0.0
    for a in range(count):
        y[a] = room.stiffness[a] * x[a]
    for a in range(count):
        b, c = room.one[a], room.two[a]
        y[a] += room.next_one[a] * x[b] + room.next_two[a] * x[c]
        y[b] += room.next_one[a] * x[a]
        y[c] += room.next_two[a] * x[a]
    for c in range(room.counts[3]):
        change = 0.0
        for i in range(4):
            change += room.arms[c, i] * x[room.ends[c, i]]
        for i in range(4):
            a, arm = room.ends[c, i], room.arms[c, i]
            y[a] += room.slopes[c] * arm * (change - arm * x[a])  # its own share is in the stiffness


@borrowing
def _newton_step(room: Room) -> int:
    """Step ← stiffness⁻¹ · force to `INEXACT`, by conjugate gradients scaled by the nodes' stiffness; their number."""
    count = room.counts[2]
    size = 0.0
    for a in range(count):
        room.step[a], room.rest[a] = 0.0, room.force[a]
        room.direction[a] = room.force[a] / room.stiffness[a]
        size += room.rest[a] * room.direction[a]
    goal = INEXACT * INEXACT * size
    for done in range(GRADIENTS):
        if size <= goal:
            return done
        _apply(room)
        curvature = 0.0
        for a in range(count):
            curvature += room.direction[a] * room.image[a]
        share, before = size / curvature, size
        size = 0.0
        for a in range(count):
            room.step[a] += share * room.direction[a]
            room.rest[a] -= share * room.image[a]
            size += room.rest[a] * room.rest[a] / room.stiffness[a]
        for a in range(count):
            room.direction[a] = room.rest[a] / room.stiffness[a] + size / before * room.direction[a]
    return GRADIENTS


@borrowing
def _work(room: Room) -> tuple[float, float]:
    """Force along the step [N m], and the longest step of a node [m]."""
    along_step, longest = 0.0, 0.0
    for a in range(room.counts[2]):
        along_step += room.force[a] * room.step[a]
        longest = max(longest, abs(room.step[a]))
    return along_step, longest


@borrowing
def _correct(p: Package, yarn: Yarn, room: Room, now: Laying) -> int:
    """A Newton step of all visited nodes together; `step` is what they moved by. The number of visits to nodes."""
    count = room.counts[2]
    _assemble(p, yarn, room, now)
    visits = count * (1 + _newton_step(room))
    start, longest = _work(room)
    share, taken = 1.0, 0.0
    if longest > LONGEST * yarn.diameter:
        share = LONGEST * yarn.diameter / longest
    for _ in range(SHORTENED):
        for a in range(count):
            p.height[room.visited[a]] += (share - taken) * room.step[a]
        taken = share
        _assemble(p, yarn, room, now)
        visits += count
        end, _ = _work(room)
        if end >= -OVERSHOOT * start:
            break
        share *= max(start / (start - end), 0.1)
    for a in range(count):
        room.step[a] *= taken
    return visits


@borrowing
def _go_on(p: Package, yarn: Yarn, room: Room, now: Laying, settled: float, fade: float) -> None:
    """Forget the visited nodes, and wake those that are not at rest and what the others' steps moved beyond them."""
    counts, place = room.counts, room.place
    while counts[1] > 0:
        _next(room)
    count = counts[2]
    for a in range(count):
        room.before[a] = room.visited[a]
        place[room.before[a]] = BEFORE
    counts[2] = 0
    for a in range(count):
        k = room.before[a]
        if abs(room.force[a]) > _rests(now, k, settled, fade) * room.stiffness[a]:
            _wake(room, k)
    for a in range(count):
        k, step = room.before[a], abs(room.step[a])
        if step > _rests(now, k, settled, fade):
            _wake_around(p, yarn, room, k, now.laid, step, True)
    for a in range(count):
        k = room.before[a]
        if place[k] == BEFORE:
            place[k] = NEVER


@compiled
def settle(p: Package, yarn: Yarn, room: Room, start: int, now: Laying, settled: float, fade: float) -> int:
    """Bring nodes start … laid − 1, and whatever they move, to rest; the number of visits to nodes.

    Parameters
    ----------
    room : from `new_room`.
    settled : step [m] below which the last node laid rests.
    fade : growth of that step per node before the last, over itself.
    """
    counts = room.counts
    visits = 0
    for k in range(max(start, 1), now.laid):
        _wake(room, k)
    if start == 0:  # All nodes are there to be corrected, none has to be found.
        visits += _correct(p, yarn, room, now)
        _go_on(p, yarn, room, now, settled, fade)
    for _ in range(ROUNDS):
        visits += _find(p, yarn, room, now, settled, fade)
        if counts[1] == 0:
            break
        visits += _correct(p, yarn, room, now)
        _go_on(p, yarn, room, now, settled, fade)
    while counts[1] > 0:
        _next(room)
    for a in range(counts[2]):
        room.place[room.visited[a]] = NEVER
    counts[0], counts[2] = 0, 0
    return visits
