"""The nodes of the package that may move: where they stand in a linear system, forces on them, their stiffness.

A disturbance reaches few of all nodes. Those that it may move are loose, all others are held. Loose nodes stand in runs
of consecutive nodes, with two places left empty after each, so that the yarn's own stiffness, which reaches two nodes
either way, couples a place to the two before and the two after it, and nothing has to be looked up. At an empty place
force and step are zero: it stands for a node that is held.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import borrowing, borrowing_apart
from models.winding.package import Laying, Package, Records, Yarn, approach, press, pulled

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

HELD, LOOSE = -1, 0
"""Places of nodes that are held, and of loose ones that have none yet."""
EMPTY = -1
"""Node at an empty place."""
GAP = 2
"""Empty places before, between and after runs."""
ASIDE = 0
"""The first place, where an element stands of which both nodes are held."""
TOUCH = np.dtype(
    [
        ("own", np.int64),
        ("other", np.int64),
        ("own_at", np.float64),
        ("other_at", np.float64),
        ("slope", np.float64),
    ]
)
"""A crossing that presses.

own, other : places of the first nodes of its two elements; the next places are those of their second nodes.
own_at, other_at : its place on them, 0 to 1.
slope : its stiffness [N/m].
"""


class Room(NamedTuple):
    """Room for loose nodes of a package of n nodes; none are between calls of `settle`."""

    counts: Integers
    """Loose nodes, places, crossings that press, shape (3,)."""
    loose: Integers
    """Loose nodes in the order in which they became so, shape (n,)."""
    moved: Array
    """Last step of each of them [m], shape (n,)."""
    place: Integers
    """Of each node, or `HELD` or `LOOSE`, shape (n + 2,)."""
    node: Integers
    """At each place, or `EMPTY`, shape (n + 4,); as all below."""
    force: Array
    """Outwards [N]."""
    stiffness: Array
    """Of the yarn itself and of the bobbin [N/m]."""
    next_one: Array
    """Coupling to the next place [N/m]."""
    next_two: Array
    """Coupling to the next but one [N/m]."""
    yielding: Array
    """One over all of a node's stiffness, of crossings too [m/N]; 0 at empty places."""
    step: Array
    """[m]."""
    rest: Array
    """Force that the step leaves [N]."""
    direction: Array
    """[m]."""
    image: Array
    """Stiffness times direction [N]."""
    touch: Records
    """Of `TOUCH`, a crossing each, shape (m,)."""


def new_room(p: Package) -> Room:
    """Room for all nodes of `p`."""
    n, m = p.height.size, p.crossing.size // 2
    # Runs are two held nodes or more apart, and the first node is always held.
    return Room(
        np.zeros(3, np.int64),
        np.empty(n, np.int64),
        np.empty(n),
        np.full(n + 2, HELD),
        np.empty(n + 2 * GAP, np.int64),
        *(np.zeros(n + 2 * GAP) for _ in range(9)),
        touch=np.empty(m, TOUCH),
    )


@borrowing
def loosen(room: Room, k: int) -> None:
    """Let node k, which is held, move."""
    room.loose[room.counts[0]] = k
    room.counts[0] += 1
    room.place[k] = LOOSE
    room.moved[k] = 0.0


@borrowing
def hold_all(room: Room) -> None:
    """Let no node move."""
    for i in range(room.counts[0]):
        room.place[room.loose[i]] = HELD
    room.counts[0] = 0


@borrowing_apart
def arrange(room: Room) -> None:
    """Give loose nodes their places. A single held node between two of them becomes loose: it would be in both runs."""
    place, node = room.place, room.node
    for i in range(room.counts[0]):
        place[room.loose[i]] = LOOSE
    node[0], node[1] = EMPTY, EMPTY
    size = GAP
    for i in range(room.counts[0]):
        k = room.loose[i]
        if place[k] != LOOSE:
            continue
        while place[k - 1] == LOOSE or (k > 1 and place[k - 2] == LOOSE):
            k -= 1
        while True:
            if place[k] == HELD:
                loosen(room, k)
            place[k], node[size] = size, k
            size += 1
            k += 1
            if place[k] == HELD and place[k + 1] == HELD:
                break
        node[size], node[size + 1] = EMPTY, EMPTY
        size += GAP
    room.counts[1] = size


@borrowing_apart
def assemble(p: Package, yarn: Yarn, room: Room, now: Laying) -> None:
    """Forces on loose nodes and their stiffness, run by run."""
    size, node = room.counts[1], room.node
    for a in range(size):
        room.force[a] = room.stiffness[a] = room.next_one[a] = room.next_two[a] = room.yielding[a] = 0.0
    room.counts[2] = 0
    a = GAP
    while a < size:
        start = a
        while node[a] != EMPTY:
            a += 1
        _add_elements(p, yarn, room, now, start, a)
        _add_bending(p, room, now, start, a)
        _add_bobbin(p, room, start, a)
        a += GAP
    for a in range(size):
        if node[a] == EMPTY:
            room.force[a] = room.yielding[a] = 0.0
        else:
            room.yielding[a] = 1 / (room.yielding[a] + room.stiffness[a])


@borrowing
def _add_elements(p: Package, yarn: Yarn, room: Room, now: Laying, start: int, stop: int) -> None:
    """Tension of the elements at the nodes at places start … stop − 1, and what crosses them."""
    before = room.node[start] - 1  # node 0 is never loose
    for a in range(start - 1, stop):
        k = before + a - start + 1
        if k + 1 >= now.laid:
            break
        here, there, own, other, both = pulled(p, yarn, now, k)
        room.force[a] -= here
        room.force[a + 1] -= there
        room.stiffness[a] += own
        room.stiffness[a + 1] += other
        room.next_one[a] += both
        _add_crossings(p, yarn, room, now, k, a)


@borrowing
def _add_crossings(p: Package, yarn: Yarn, room: Room, now: Laying, e: int, a: int) -> None:
    """What crosses element e, whose first node stands at the place a."""
    place = room.place
    for q in range(p.near[e].low, p.near[e].high):
        c = p.crossing[q]
        o = c.other
        if o + 1 >= now.laid:
            break
        b = ASIDE
        if place[o] != HELD:
            b = place[o]
        elif place[o + 1] != HELD:
            b = place[o + 1] - 1
        if o < e and b != ASIDE:
            continue  # was added from the element below
        depth = approach(p, e, q, yarn.diameter)
        if depth <= 0:
            continue
        push, slope = press(depth / yarn.diameter)
        push *= c.stiffness * yarn.diameter
        slope *= c.stiffness
        if o < e:
            push = -push
        s, t = c.own_at, c.other_at
        room.force[a] -= push * (1 - s)
        room.force[a + 1] -= push * s
        room.force[b] += push * (1 - t)
        room.force[b + 1] += push * t
        room.yielding[a] += slope * (1 - s) * (1 - s)
        room.yielding[a + 1] += slope * s * s
        room.yielding[b] += slope * (1 - t) * (1 - t)
        room.yielding[b + 1] += slope * t * t
        w = room.touch[room.counts[2]]
        w.own, w.other, w.own_at, w.other_at, w.slope = a, b, s, t, slope
        room.counts[2] += 1


@borrowing
def _add_bending(p: Package, room: Room, now: Laying, start: int, stop: int) -> None:
    """Bending at the nodes at places start … stop − 1, and at those before and after."""
    h = p.height
    for a in range(start - 1, stop + 1):
        k = room.node[start] + a - start
        if k < 1 or k + 1 >= now.laid:
            continue
        stiff = p.node[k].bending
        bent = stiff * (h[k - 1] - 2 * h[k] + h[k + 1])
        room.force[a - 1] -= bent
        room.force[a] += 2 * bent
        room.force[a + 1] -= bent
        room.stiffness[a - 1] += stiff
        room.stiffness[a] += 4 * stiff
        room.stiffness[a + 1] += stiff
        room.next_one[a - 1] -= 2 * stiff
        room.next_one[a] -= 2 * stiff
        room.next_two[a - 1] += stiff


@borrowing
def _add_bobbin(p: Package, room: Room, start: int, stop: int) -> None:
    """The bobbin under the nodes at places start … stop − 1."""
    for a in range(start, stop):
        k = room.node[a]
        if p.height[k] < 0:
            room.force[a] -= p.node[k].surface * p.height[k]
            room.stiffness[a] += p.node[k].surface


@borrowing
def multiply(room: Room) -> None:
    """Image ← stiffness · direction. Indices start at 0, as the compiler needs it to work on several at once."""
    x, y, one, two = room.direction, room.image, room.next_one, room.next_two
    for a in range(room.counts[1] - 2 * GAP):
        y[a + 2] = (
            room.stiffness[a + 2] * x[a + 2]
            + one[a + 2] * x[a + 3]
            + two[a + 2] * x[a + 4]
            + one[a + 1] * x[a + 1]
            + two[a] * x[a]
        )
    for c in range(room.counts[2]):
        w = room.touch[c]
        a, b, s, t = w.own, w.other, w.own_at, w.other_at
        force = w.slope * ((1 - s) * x[a] + s * x[a + 1] - (1 - t) * x[b] - t * x[b + 1])
        y[a] += (1 - s) * force
        y[a + 1] += s * force
        y[b] -= (1 - t) * force
        y[b + 1] -= t * force
