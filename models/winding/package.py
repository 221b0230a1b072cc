"""The package of the fast mode: laid nodes with one radial degree of freedom each, and what acts on them.

Energy: stretch of the elements, ½ EA l_n (l/l_n − 1 − ε_r)², or pull · l where yarn is still a string of constant
tension; bending, ½ B/s³ (h_{j−1} − 2 h_j + h_{j+1})² over inner nodes j; the yielding bobbin, ½ K_t s h² below h = 0;
crossings, whose approach is hardened as in `contact.hardening`. Forces and stiffnesses here are its derivatives, so
that rest is its minimum.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, inner
from models.winding.contact import HARDENED, hardening

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SUNK = 0.75
"""Share of the sinking into the bobbin that happens before the yarn is held: while it lands, the span still draws slack
out of it. From the reference mode (2 mm): a soft loop that would keep 0.53 of its tension if held at first touch
keeps 0.88."""


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
    cosine: float
    """Of that step."""
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


class Laying(NamedTuple):
    """What is laid, and how."""

    laid: int
    """Nodes there."""
    fresh: int
    """Nodes from here on are being laid, with only `SUNK` of the bobbin's yielding."""
    pull: float
    """Tension of elements without a natural length [N]."""


@inner
def length_of(p: Package, k: int) -> float:
    """Length of element k [m]."""
    a, b = p.radius[k] + p.height[k], p.radius[k + 1] + p.height[k + 1]
    dz = p.z[k + 1] - p.z[k]
    return math.sqrt((a - b) * (a - b) + 2 * a * b * (1 - p.cosine) + dz * dz)


@inner
def _lean(p: Package, k: int, other: int, length: float) -> float:
    """∂ length / ∂ radius of node k, for the element to node `other`."""
    return (p.radius[k] + p.height[k] - (p.radius[other] + p.height[other]) * p.cosine) / length


@inner
def approach(p: Package, c: int, diameter: float) -> float:
    """Approach of the two yarns of crossing c beyond touching [m]."""
    i, k, s, t = p.below[c], p.above[c], p.below_at[c], p.above_at[c]
    upper = (1 - t) * p.height[k] + t * p.height[k + 1]
    return (1 - s) * p.height[i] + s * p.height[i + 1] + diameter - upper


@inner
def press(x: float) -> tuple[float, float]:
    """Force of one yarn on another over k d, and its slope, at the approach x d; see `contact.hardening`."""
    y = min(x, HARDENED)
    return hardening(x)[0], 1 / (1 - y) ** 2


@inner
def along(p: Package, yarn: Yarn, now: Laying, k: int) -> tuple[float, float, float, float]:
    """What the yarn itself and the bobbin do to node k.

    Returns
    -------
    Force outwards [N], stiffness of the node, its coupling to node k + 1, to node k + 2 [N/m].
    """
    force, stiffness, next_one, next_two = 0.0, 0.0, 0.0, 0.0
    for e in range(max(k - 1, 0), min(k + 1, now.laid - 1)):
        length = length_of(p, e)
        other = e if e < k else e + 1
        lean, far = _lean(p, k, other, length), _lean(p, other, k, length)
        tension, axial = now.pull, 0.0
        if p.natural[e] > 0:
            tension = yarn.axial * (length / p.natural[e] - 1 - p.relaxed[e])
            axial = yarn.axial / p.natural[e]
        force -= tension * lean
        # |T|: a slack element's softening is left out, so that the stiffness stays positive.
        string = abs(tension) / length
        stiffness += axial * lean * lean + string * (1 - lean * lean)
        if e == k:
            next_one = axial * lean * far - string * (p.cosine + lean * far)
    h = p.height
    for j in range(max(k - 1, 1), min(k + 2, now.laid - 1)):
        bending = yarn.bending / (p.radius[j] * p.angle_step) ** 3
        arm = -2.0 if j == k else 1.0
        force -= arm * bending * (h[j - 1] - 2 * h[j] + h[j + 1])
        stiffness += arm * arm * bending
        if j >= k:
            next_one -= 2 * bending
        if j == k + 1:
            next_two = bending
    if h[k] < 0:
        surface = yarn.surface * p.radius[k] * p.angle_step
        if k >= now.fresh:
            surface /= SUNK
        force -= surface * h[k]
        stiffness += surface
    return force, stiffness, next_one, next_two


@inner
def across(p: Package, yarn: Yarn, now: Laying, k: int) -> tuple[float, float]:
    """What the yarns that cross the elements at node k do to it: force outwards [N], stiffness [N/m]."""
    force, stiffness = 0.0, 0.0
    for e in range(max(k - 1, 0), min(k + 1, now.laid - 1)):
        for c in range(p.first_above[e], p.first_above[e + 1]):
            depth = approach(p, c, yarn.diameter)
            if depth > 0:
                share = float(p.above_at[c] if e < k else 1 - p.above_at[c])
                push, slope = press(depth / yarn.diameter)
                force += p.stiffness[c] * yarn.diameter * push * share
                stiffness += p.stiffness[c] * slope * share * share
        for q in range(p.first_below[e], p.first_below[e + 1]):
            c = int(p.order_below[q])
            if p.above[c] + 1 >= now.laid:
                continue
            depth = approach(p, c, yarn.diameter)
            if depth > 0:
                share = float(p.below_at[c] if e < k else 1 - p.below_at[c])
                push, slope = press(depth / yarn.diameter)
                force -= p.stiffness[c] * yarn.diameter * push * share
                stiffness += p.stiffness[c] * slope * share * share
    return force, stiffness


@compiled
def put_on_top(p: Package, diameter: float, start: int, stop: int) -> None:
    """Heights of nodes start … stop − 1 at which their elements touch, or lie above, all that they cross."""
    p.height[start:stop] = 0.0
    for e in range(max(start - 1, 0), stop - 1):
        for c in range(p.first_above[e], p.first_above[e + 1]):
            i, s = p.below[c], p.below_at[c]
            top = (1 - s) * p.height[i] + s * p.height[i + 1] + diameter
            for k in range(max(e, start), e + 2):
                p.height[k] = max(p.height[k], top)


@compiled
def element_lengths(p: Package, start: int, stop: int) -> Array:
    """Lengths [m] of elements start … stop − 1."""
    lengths = np.empty(stop - start)
    for k in range(start, stop):
        lengths[k - start] = length_of(p, k)
    return lengths
