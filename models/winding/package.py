"""The package of the fast mode: laid nodes with one radial degree of freedom each, and what acts on them.

Energy: stretch of the elements, ½ EA l_n (l/l_n − 1 − ε_r)², or pull · l where yarn is still a string of constant
tension; bending, ½ B/s³ (h_{j−1} − 2 h_j + h_{j+1})² over inner nodes j; the yielding bobbin, ½ K_t s h² below h = 0;
crossings, whose approach is hardened as in `contact.hardening`. Forces and stiffness, here and in `assembly.py`, are
its derivatives, so that rest is its minimum.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import borrowing, compiled
from models.winding.contact import HARDENED, hardening
from models.winding.crossings import find_crossings
from models.winding.landing import sunk_share
from models.winding.scene import WindingScene

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Records = Any
"""Arrays of records: compiled code reads their fields as attributes, of which type checkers know nothing."""


class Yarn(NamedTuple):
    """What the compiled functions need to know of the yarn, SI."""

    axial: float
    """EA [N]."""
    diameter: float
    sunk: float
    """Share of its sinking into the bobbin after which a landing yarn is held (`landing.py`)."""


NODE = np.dtype([(name, np.float64) for name in ("radius", "rise", "bending", "surface", "hold", "relaxed")])
"""A node k and the element from it to node k + 1: what is read together lies together in memory.

radius : of the centre line where the yarn just touches the bobbin [m].
rise : (z_{k+1} − z_k)² [m²].
bending : B/s³ [N/m], s the way round the bobbin from node to node.
surface : K_t s [N/m].
hold : EA over the element's natural length [N/m], 0 until laid.
relaxed : strain taken by its Prony branches.
"""
CROSSING = np.dtype(
    [
        ("other", np.int64),
        ("twin", np.int64),
        ("own_at", np.float64),
        ("other_at", np.float64),
        ("stiffness", np.float64),
    ]
)
"""A crossing as one of its two elements sees it.

other : the other element.
twin : the same crossing as the other element sees it.
own_at, other_at : its place on them, 0 to 1.
stiffness : at first touch [N/m].
"""
NEAR = np.dtype([("low", np.int64), ("high", np.int64)])
"""Of an element's crossings those from `low` to `high` − 1 may touch: all others are further apart than `MARGIN`."""
MARGIN = 1.0
"""Distance of two yarns beyond touching, over the diameter, at which they may touch before the next `look_around`."""


PRESSED = 0.02
"""Share of the diameter by which new yarn is put into what is below it: little, but the first step to rest then knows
what bears it."""


class Package(NamedTuple):
    """Laid nodes and their crossings. Element k joins nodes k and k + 1."""

    chord: float
    """2 (1 − cos Δθ), Δθ the bobbin's angle from node to node."""
    height: Array
    """Of each node above its `radius` [m], shape (n,)."""
    node: Records
    """Of `NODE`, shape (n,)."""
    first: Integers
    """Crossings of element k are first[k] … first[k + 1] − 1, in the order of the other element, shape (n + 1,)."""
    crossing: Records
    """Of `CROSSING`; each stands with both its elements."""
    near: Records
    """Of `NEAR`, shape (n,)."""


class Laying(NamedTuple):
    """How much is laid."""

    laid: int
    """Nodes there."""
    pull: float
    """Tension of elements without a natural length [N]."""


def yarn_of(scene: WindingScene) -> Yarn:
    """The yarn of `scene`."""
    return Yarn(scene.axial_stiffness, scene.diameter, sunk_share(scene))


def new_package(scene: WindingScene, z: Array, angle_step: float) -> Package:
    """The package along the path `z` [m], shape (n,), a node every `angle_step`, with its crossings; nothing laid."""
    n = z.size
    step = scene.bobbin_radius * angle_step
    first, crossing = pair_up(*find_crossings(z / step, 2 * math.pi / angle_step), n)
    around = (scene.bobbin_radius + math.tan(scene.cone_angle) * z) * angle_step
    node = np.zeros(n, NODE)
    node["radius"] = around / angle_step + scene.diameter / 2 / math.cos(scene.cone_angle)
    node["rise"][:-1] = np.diff(z) ** 2
    node["bending"] = scene.bending_stiffness / around**3
    node["surface"] = scene.transverse_stiffness * around
    lean = np.arctan(np.diff(z, append=z[-1]) / step)
    angle = np.abs(lean[crossing["other"]] - np.repeat(lean, np.diff(first)))
    contact = np.minimum(scene.diameter / np.maximum(np.sin(angle), 1e-9), scene.element_length)
    crossing["stiffness"] = scene.transverse_stiffness * contact / 2
    near = np.zeros(n, NEAR)
    near["low"], near["high"] = first[:-1], first[:-1]
    return Package(2 * (1 - math.cos(angle_step)), np.zeros(n), node, first, crossing, near)


@compiled
def pair_up(below: Integers, above: Integers, below_at: Array, above_at: Array, n: int) -> tuple[Integers, Records]:
    """`first` and `crossing` of a package of n nodes, without stiffness, from crossings in the order of `above`."""
    order = np.arange(below.size)
    for c in range(1, below.size):  # by `below` where `above` is the same
        k = c
        while k > 0 and above[order[k - 1]] == above[order[k]] and below[order[k - 1]] > below[order[k]]:
            order[k - 1], order[k] = order[k], order[k - 1]
            k -= 1
    first = np.zeros(n + 1, np.int64)
    for c in range(below.size):
        first[below[c] + 1] += 1
        first[above[c] + 1] += 1
    for k in range(n):
        first[k + 1] += first[k]
    crossing: Records = np.empty(2 * below.size, CROSSING)
    free = first.copy()
    for c in order:
        i, k = below[c], above[c]
        p, q = free[i], free[k]
        free[i] += 1
        free[k] += 1
        crossing[p].other, crossing[p].twin = k, q
        crossing[p].own_at, crossing[p].other_at = below_at[c], above_at[c]
        crossing[q].other, crossing[q].twin = i, p
        crossing[q].own_at, crossing[q].other_at = above_at[c], below_at[c]
    return first, crossing


@borrowing
def length_of(p: Package, k: int, share: float) -> float:
    """Length of element k [m], had its nodes sunk into the bobbin by `share` of what they have."""
    a, b = p.height[k], p.height[k + 1]
    a = p.node[k].radius + (a if a > 0 else share * a)
    b = p.node[k + 1].radius + (b if b > 0 else share * b)
    return math.sqrt((a - b) * (a - b) + p.chord * a * b + p.node[k].rise)


@borrowing
def approach(p: Package, e: int, q: int, diameter: float) -> float:
    """Approach of the two yarns of crossing q of element e beyond touching [m]."""
    c = p.crossing[q]
    s, t, o = c.own_at, c.other_at, c.other
    above = (1 - s) * p.height[e] + s * p.height[e + 1] - (1 - t) * p.height[o] - t * p.height[o + 1]
    return diameter - above if o < e else diameter + above


@borrowing
def press(x: float) -> tuple[float, float]:
    """Force of one yarn on another over k d, and its slope, at the approach x d; see `contact.hardening`."""
    y = min(x, HARDENED)
    return hardening(x)[0], 1 / (1 - y) ** 2


@borrowing
def pulled(p: Package, yarn: Yarn, now: Laying, k: int) -> tuple[float, float, float, float, float]:
    """Tension of element k at its two nodes.

    Slack softens: |T| is taken instead of T in the stiffness, so that all together stays a minimum's.

    Returns
    -------
    Tension times ∂l/∂h of the first and of the second node [N], the energy's second derivatives in the first, in the
    second, and in both [N/m].
    """
    element, half = p.node[k], p.chord / 2
    here, there = element.radius + p.height[k], p.node[k + 1].radius + p.height[k + 1]
    length = math.sqrt((here - there) * (here - there) + p.chord * here * there + element.rise)
    inverse = 1 / length
    near, far = (here - there + half * there) * inverse, (there - here + half * here) * inverse
    axial = element.hold
    tension = axial * length - yarn.axial * (1 + element.relaxed) if axial > 0 else now.pull
    string = abs(tension) * inverse
    return (
        tension * near,
        tension * far,
        axial * near * near + string * (1 - near * near),
        axial * far * far + string * (1 - far * far),
        axial * near * far - string * (1 - half + near * far),
    )


@compiled
def put_on_top(p: Package, diameter: float, start: int, stop: int) -> None:
    """Heights of nodes start … stop − 1 as of a thread drawn taut over the bobbin and all that they cross.

    A straight line rises over a circle of radius R by s²/2R, so that h − s²/2R is the least concave function that is
    nowhere below what is crossed. The last node is free: the thread ends at right angles to the radius, or lies there.
    """
    first = max(start - 1, 0)
    p.height[start:stop] = 0.0
    for e in range(first, stop - 1):
        for q in range(p.first[e], p.first[e + 1]):
            o, s = p.crossing[q].other, p.crossing[q].other_at
            if o > e:
                break
            top = (1 - s) * p.height[o] + s * p.height[o + 1] + (1 - PRESSED) * diameter
            for k in range(max(e, start), e + 2):
                p.height[k] = max(p.height[k], top)
    bulge = p.chord * p.node[first].radius / 2
    line, at = np.empty(stop - first), np.empty(stop - first, np.int64)
    corners = 0
    for k in range(first, stop):
        x = k - first
        level = p.height[k] - bulge * x * x
        while corners > 1 and (line[corners - 1] - line[corners - 2]) * (x - at[corners - 1]) <= (
            level - line[corners - 1]
        ) * (at[corners - 1] - at[corners - 2]):
            corners -= 1
        line[corners], at[corners] = level, x
        corners += 1
    end, falling, leaves = stop - 1 - first, -2 * bulge * (stop - 1 - first), 0
    for i in range(1, corners):
        if line[i] - line[leaves] > falling * (at[i] - at[leaves]):
            leaves = i
    if at[leaves] < end:
        corners = leaves + 2
        line[leaves + 1], at[leaves + 1] = line[leaves] + falling * (end - at[leaves]), end
        p.height[stop - 1] = line[leaves + 1] + bulge * end * end
    for i in range(corners - 1):
        for x in range(at[i] + 1, at[i + 1]):
            level = line[i] + (line[i + 1] - line[i]) * (x - at[i]) / (at[i + 1] - at[i])
            p.height[first + x] = level + bulge * x * x
    for e in range(first, stop - 1):
        _look_down(p, diameter, e)


@borrowing
def _look_down(p: Package, diameter: float, e: int) -> None:
    """Note which of the yarns below element e may touch it, on both sides."""
    q = p.first[e]
    p.near[e].low = q
    while q < p.first[e + 1] and p.crossing[q].other < e:
        if approach(p, e, q, diameter) > -MARGIN * diameter:
            o, twin = p.crossing[q].other, p.crossing[q].twin
            p.near[o].high = max(p.near[o].high, twin + 1)
        elif q == p.near[e].low:
            p.near[e].low = q + 1
        q += 1
    p.near[e].high = max(p.near[e].high, q)


@compiled
def look_around(p: Package, diameter: float, laid: int) -> None:
    """Note anew which of the yarns in a package of so many nodes may touch."""
    for e in range(laid - 1):
        p.near[e].high = p.first[e]
    for e in range(laid - 1):
        _look_down(p, diameter, e)


@compiled
def element_lengths(p: Package, start: int, stop: int) -> Array:
    """Lengths [m] of elements start … stop − 1."""
    lengths = np.empty(stop - start)
    for k in range(start, stop):
        lengths[k - start] = length_of(p, k, 1.0)
    return lengths
