"""Rest of the package: the minimum of its energy (`package.py`), found where something moves.

Nodes moved one at a time hand a disturbance on by one contact each, so that a stack of L layers needs of the order of
L² visits to each. So all loose nodes (`assembly.py`) take Newton's steps together, each found by conjugate gradients,
and what a step moves beyond them becomes loose as well. At rest the last step is small and so is the force that it left
over every node's stiffness: the force alone does not show that many nodes would still go the same way together.
"""

import math

from models.compiled import borrowing, borrowing_apart, borrowing_sums, compiled
from models.winding.assembly import EMPTY, HELD, Room, arrange, assemble, hold_all, loosen, multiply
from models.winding.package import Laying, Package, Yarn, approach

USUAL = 20
"""Newton steps after which nearly all searches have ended. Further ones are careful, see below."""
INEXACT, CAREFUL_INEXACT = 0.1, 1e-3
"""Share of the force that conjugate gradients leave. More exact steps are wasted while contacts still open and close,
but needed where soft yarn is held by its bending alone."""
GRADIENTS, CAREFUL_GRADIENTS = 40, 1000
"""Conjugate gradients per Newton step."""
OVERSHOOT, CAREFUL_OVERSHOOT = 30.0, 0.3
"""Newton steps are halved where the force against them exceeds so many times the force along them at their start. A
contact that a step closes is stiffer than what was there before, and is best left to the next step, unless steps go
round in a circle."""
LONGEST = 1.0
"""Longest Newton step of a node over the diameter: the approach at which contact hardens is half of it."""
HALVED = 6
"""Times a Newton step is halved."""
ROUNDS = 100
"""Newton steps; five to seven are usual."""
HANDED_ON = 0.3
"""Share of a step that nodes beyond are expected to take. With 0.2 or 0.4, at a tolerance that keeps the layers as
exact, laying takes as long."""


@borrowing
def _loosen_around(p: Package, yarn: Yarn, room: Room, k: int, laid: int, step: float) -> None:
    """Loosen what a `step` of node k acts on: its neighbours along the yarn, and the nodes of the elements that touch
    its two elements or touched them before.
    """
    place = room.place
    for other in range(max(k - 2, 1), min(k + 3, laid)):
        if place[other] == HELD:
            loosen(room, other)
    for e in range(k - 1, min(k + 1, laid - 1)):
        for q in range(p.near[e].low, p.near[e].high):
            o = p.crossing[q].other
            if o + 1 >= laid:
                break
            if (place[o] != HELD and place[o + 1] != HELD) or approach(p, e, q, yarn.diameter) < -step:
                continue
            for other in range(max(o, 1), o + 2):
                if place[other] == HELD:
                    loosen(room, other)


@borrowing
def _rests(now: Laying, k: int, settled: float, fade: float) -> float:
    """Step [m] below which node k rests."""
    return settled * (1 + fade * (now.laid - k))


@borrowing
def _spread(p: Package, yarn: Yarn, room: Room, now: Laying, settled: float, fade: float) -> bool:
    """Loosen what the last step moves beyond the loose nodes, and what that is expected to move; whether any."""
    before = room.counts[0]
    i = 0
    while i < room.counts[0]:
        k = int(room.loose[i])
        step = abs(room.moved[k])
        if step > _rests(now, k, settled, fade):
            reached = room.counts[0]
            _loosen_around(p, yarn, room, k, now.laid, step)
            for j in range(reached, room.counts[0]):
                room.moved[room.loose[j]] = HANDED_ON * step
        i += 1
    for j in range(before, room.counts[0]):
        room.moved[room.loose[j]] = 0.0
    return room.counts[0] > before


@borrowing_sums
def _find_step(room: Room, inexact: float, most: int) -> int:
    """Step ← stiffness⁻¹ · force but for the share `inexact`, by at most so many conjugate gradients, scaled by the
    nodes' stiffness; their number.
    """
    size = room.counts[1]
    step, rest, direction, image, yielding = room.step, room.rest, room.direction, room.image, room.yielding
    image[0] = image[1] = image[size - 1] = image[size - 2] = 0.0
    left = 0.0
    for a in range(size):
        step[a], rest[a] = 0.0, room.force[a]
        direction[a] = room.force[a] * yielding[a]
        left += rest[a] * direction[a]
    goal = inexact * inexact * left
    for done in range(most):
        if left <= goal:
            return done
        multiply(room)
        curvature = 0.0
        for a in range(size):
            curvature += direction[a] * image[a]
        share, before = left / curvature, left
        left = 0.0
        for a in range(size):
            step[a] += share * direction[a]
            rest[a] -= share * image[a]
            left += rest[a] * rest[a] * yielding[a]
        for a in range(size):
            direction[a] = rest[a] * yielding[a] + left / before * direction[a]
    return most


@borrowing_sums
def _work(room: Room) -> tuple[float, float]:
    """Force along the step that was found [N m], and the longest step of a node [m]."""
    along, longest = 0.0, 0.0
    for a in range(room.counts[1]):
        along += room.force[a] * room.step[a]
        longest = max(longest, abs(room.step[a]))
    return along, longest


@borrowing
def _shift(p: Package, room: Room, share: float) -> None:
    """Move all loose nodes by `share` of the step that was found."""
    for a in range(room.counts[1]):
        k = room.node[a]
        if k != EMPTY:
            p.height[k] += share * room.step[a]
            room.moved[k] = share * room.step[a]


@borrowing
def _halve(p: Package, room: Room) -> None:
    """Take half of the last step back."""
    for i in range(room.counts[0]):
        k = room.loose[i]
        room.moved[k] /= 2
        p.height[k] -= room.moved[k]


@borrowing
def _against(room: Room) -> float:
    """Force against the last step [N m]."""
    against = 0.0
    for i in range(room.counts[0]):
        k = int(room.loose[i])
        against -= room.force[int(room.place[k])] * room.moved[k]
    return against


@borrowing_apart
def _correct(
    p: Package, yarn: Yarn, room: Room, now: Laying, settled: float, fade: float, done: int
) -> tuple[bool, int]:
    """A Newton step of all loose nodes, from assembled forces to assembled forces, after `done` others; whether it went
    beyond them, and the number of visits to nodes.
    """
    careful = done > USUAL
    inexact, most = (CAREFUL_INEXACT, CAREFUL_GRADIENTS) if careful else (INEXACT, GRADIENTS)
    overshoot = CAREFUL_OVERSHOOT if careful else OVERSHOOT
    visits = room.counts[0] * _find_step(room, inexact, most)
    start, longest = _work(room)
    share = 1.0 if longest <= LONGEST * yarn.diameter else LONGEST * yarn.diameter / longest
    _shift(p, room, share)
    beyond = done > 0 and _spread(p, yarn, room, now, settled, fade)
    if beyond:
        arrange(room)
    assemble(p, yarn, room, now)
    visits += room.counts[0]
    for _ in range(HALVED):
        if _against(room) <= overshoot * share * start:
            break
        _halve(p, room)
        assemble(p, yarn, room, now)
        visits += room.counts[0]
    return beyond, visits


@borrowing
def _at_rest(room: Room, now: Laying, settled: float, fade: float) -> bool:
    """Whether all loose nodes rest."""
    for i in range(room.counts[0]):
        k = room.loose[i]
        a, most = room.place[k], _rests(now, k, settled, fade)
        if not (abs(room.moved[k]) <= most and abs(room.force[a]) * room.yielding[a] <= most):
            return False
    return True


@borrowing
def _hold_resting(room: Room, now: Laying, settled: float, fade: float) -> None:
    """Hold the nodes on which no force is left."""
    hold_all(room)
    for a in range(room.counts[1]):
        k = room.node[a]
        if k != EMPTY and not abs(room.force[a]) * room.yielding[a] <= _rests(now, k, settled, fade):
            loosen(room, k)


@borrowing
def _settle(
    p: Package, yarn: Yarn, room: Room, start: int, now: Laying, settled: float, fade: float
) -> tuple[bool, int]:
    """As `settle`, without references."""
    for k in range(max(start, 1), now.laid):
        loosen(room, k)
    arrange(room)
    assemble(p, yarn, room, now)
    visits = room.counts[0]
    if start == 0:  # All nodes take one step together; then few are left.
        _, more = _correct(p, yarn, room, now, settled, fade, 0)
        _hold_resting(room, now, settled, fade)
        arrange(room)
        assemble(p, yarn, room, now)
        visits += more + room.counts[0]
    rests = room.counts[0] == 0
    for done in range(1, ROUNDS):
        if rests or not math.isfinite(room.moved[room.loose[0]]):  # a sum over all is in the step of each
            break
        beyond, more = _correct(p, yarn, room, now, settled, fade, done)
        visits += more
        rests = not beyond and _at_rest(room, now, settled, fade)
    hold_all(room)
    return rests, visits


@compiled
def settle(
    p: Package, yarn: Yarn, room: Room, start: int, now: Laying, settled: float, fade: float
) -> tuple[bool, int]:
    """Bring nodes start … laid − 1, and whatever they move, to rest.

    Parameters
    ----------
    room : from `new_room`.
    settled : step [m] below which the last node laid rests.
    fade : growth of that step per node before the last, over itself.

    Returns
    -------
    Whether all rest, and the number of visits to nodes.
    """
    return _settle(p, yarn, room, start, now, settled, fade)
