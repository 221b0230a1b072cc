"""A line in a frame, aligned with the yarn on it: the second step of `axis.py`.

The yarn is cut along the line (`lines.py`). Near either edge the mean cross profile p(w) is held against each short
block of the cut: I(w) = g·p(w) + o − δ·p′(w) is solved for how far the block's edge is shifted (the image registration
of Lucas and Kanade, IJCAI 1981, with gain and offset). Only rows from `WITHIN` inside of the edge outwards count, and
each edge has a gain of its own: fibres that shine or are dark there shift little. (δ₁ + δ₂)/2 is where the yarn's
middle is, whichever edge the light favours: with one shift for both edges a taper of 5 % tilted the axis by 0.1°. Of an
even yarn, or where the ground beside it changes, it is one shift of the whole body: texture enters that less, and what
the ground makes of one edge is mostly undone at the other. A robust line through the middles corrects the axis; blocks
with a hair or a second object drop out. Where a parabola's sagitta exceeds what texture may seem to bend, the yarn is
cut anew along it.

The mean profile of a yarn that is thick here and thin there is a mixture whose edges are blurred and whose width is no
diameter's. Where (δ₂ − δ₁)/2 varies along the yarn by more than `EVEN` and `EVEN_SHARE`, the blocks are laid on each
other: moved by the parabola and stretched so that both edges are where they are on the average. The profile is then
that of a yarn of the mean diameter.

Compiled as a whole: a frame needs one or two cuts, and between calls threads would wait for each other.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import inner, spliced
from models.newton import lu_factor, lu_solve
from pipeline.measure.lines import BLOCK, Image, Pixels, block_means, span, step_across, taps
from pipeline.measure.profile import background, feet, middle, products
from pipeline.records import Array

FEWEST = 4
"""Fewest blocks of a cut."""
MIN_ASPECT = 2.0
"""Length in view over diameter below which a thing has no axis."""
ALIGNED = 1.0
"""Tilt over the length in view up to which a cut counts as aligned [px]: it is corrected for, and blurs the profile
by less than the optics."""
CENTRED = 2.0
"""Distance of the yarn from a cut's middle up to which it counts as centred [px]; the profile's fit does the rest."""
ROUNDS = 6
"""Largest number of cuts made to align one."""
FEWEST_BENT = 8
"""Fewest blocks of a cut in which a bend is looked for."""
BENT = 4.0
"""Least sagitta of a bent yarn, over the robust standard deviation of its middles about the parabola; `ALIGNED` at
least."""
FEWEST_EVENED = 12
"""Fewest blocks of a cut in which unevenness is."""
WITHIN, WITHIN_SHARE = 4.0, 0.15
"""How far inside of an edge its rows begin [rows, and as a share of the half width]: the larger of the two, twice the
standard deviation of a blur that twist bears, and some."""
EVEN, EVEN_SHARE = 0.5, 0.03
"""Root mean square of what the half width varies by, up to which it blurs the profile by less than the optics do, and
texture may seem to [rows, and as a share of the half width]: the larger of the two."""
TAPERED = 0.03
"""Change of the half width from one end to the other, over the half width, up to which one shift of the whole body does
not tilt the axis by more than it scatters."""
SMOOTHED = 2
"""Blocks on either side whose median is taken: what varies over less of the yarn blurs the profile, evenly."""
GROUND = 0.05
"""Standard deviation of the level beside the yarn, along it, over the profile's height, from which on an edge by itself
is not believed: where the ground changes, as at the cylinder's edge, it seems to move."""
CHANGED = 0.6
"""Change of the level beside the yarn, along it, over the yarn's contrast with it, from which on there are
two grounds."""
ALIKE = 0.15
"""Half of the range of levels that are one ground's, over the yarn's contrast with it."""
GOES_ON = 0.5
"""Difference of a block's middle from the yarn's level, over its contrast with the ground, up to which it is yarn."""
COMMON = 0.3
"""Least share of the blocks that lie on one ground."""
GROUND_ROWS = 3
"""Rows at either end of a block that show the ground."""
EVENED = 4
"""Largest number of times that blocks are laid on each other: a blurred profile tells shifts too small at first."""


class Cut(NamedTuple):
    """Yarn cut along the frame's lines, see `block_means`."""

    blocks: Image
    """Shape (blocks, rows), rows `step` apart."""
    step: float
    """[px]"""
    x: float
    y: float
    """The point on the line that the middle row and the middle block have."""
    length: int
    """Of the band about the line in view [px]; 0 where that is too little, and nothing was cut."""


class Registered(NamedTuple):
    """What a cut's blocks have in common."""

    profile: Array
    """Mean of the middle half of each row's values, shape (rows,)."""
    spread: Array
    """Their interquartile range, shape (rows,)."""
    tilt: float
    """Of the yarn against the cut [rows per line]."""
    bend: float
    """Curvature of the yarn against the cut [rows per line²]."""
    agreement: float
    """Share of the blocks that follow the yarn; 0 without enough of them."""
    shift: float
    """Distance of the yarn from the middle row, to the right [rows]."""
    beside: tuple[float, float]
    """Levels beside the yarn, at the first and at the last row [counts]."""
    form: Array
    """Width of each block over the mean, shape (blocks,); empty where it does not vary enough to matter."""
    uneven: float
    """Coefficient of variation of the width along the yarn."""


class Aligned(NamedTuple):
    """A cut whose line runs along the yarn."""

    cut: Cut
    """Its length is 0 where there is no yarn."""
    registered: Registered
    angle: float
    """In the cut's middle [rad]."""
    bend: float
    """Curvature, to the right [1/px]."""


@inner
def align(image: Image | Pixels, x: float, y: float, angle: float, bend: float, radius: float) -> Aligned:
    """Align a line with the yarn on it.

    Parameters
    ----------
    image : shape (rows, columns).
    x, y, angle, bend, radius : a point of the line [px], its angle there [rad], its curvature to the right [1/px], and
        about half of the yarn's width [px].
    """
    none = Cut(np.empty((0, 0), np.float32), 1.0, x, y, 0)
    nothing = Registered(np.empty(0), np.empty(0), 0.0, 0.0, 0.0, 0.0, (0.0, 0.0), np.empty(0), 0.0)
    for _ in range(ROUNDS):
        found = cut(image, x, y, angle, bend, 1.3 * radius + 6, MIN_ASPECT * 2 * radius)
        if not found.length:
            break
        x, y = found.x, found.y
        registered = register(found.blocks, bend / found.step**3)
        if not registered.agreement:
            break
        # from rows and lines to pixels
        tilt, shift, bent = (
            registered.tilt * found.step**2,
            registered.shift * found.step,
            registered.bend * found.step**3,
        )
        angle -= math.atan(tilt)
        bend += bent
        sagitta = bent * found.length**2 / 8
        if abs(shift) <= CENTRED and abs(tilt) * found.length <= ALIGNED and abs(sagitta) <= ALIGNED:
            return Aligned(found, registered, angle, bend)
        shift -= sagitta / 3  # from the yarn's mean place to that of the bent line's middle
        x, y = x + shift * math.sin(angle), y + shift * math.cos(angle)
    return Aligned(none, nothing, angle, bend)


@inner
def cut(image: Image | Pixels, x: float, y: float, angle: float, bend: float, reach: float, shortest: float) -> Cut:
    """Cut a frame over `reach` on each side of a line; nothing where less than `shortest` of that band is in view."""
    step = step_across(angle)
    half = math.ceil(reach / step)
    low, high = span(image.shape[0], image.shape[1], x, y, angle, half * step)
    if bend:  # its ends lie beside the tangent
        aside = abs(bend) * (high - low) ** 2 / 8
        low, high = span(image.shape[0], image.shape[1], x, y, angle, half * step + aside)
    length, count = math.floor(high - low), math.floor((high - low) * step / BLOCK)
    if length < shortest or count < FEWEST:
        return Cut(np.empty((0, 0), np.float32), step, x, y, 0)
    x, y = x + (low + high) / 2 * math.cos(angle), y - (low + high) / 2 * math.sin(angle)
    return Cut(block_means(image, x, y, angle, bend, half, count, BLOCK), step, x, y, length)


@inner
def register(blocks: Image, cut_bend: float) -> Registered:
    """Find what blocks have in common, and how the yarn lies in them.

    Parameters
    ----------
    blocks : shape (blocks, rows).
    cut_bend : of the line that they were cut along [rows per line²].
    """
    one, expected = _on_one_ground(blocks)
    profile, spread = _common(blocks[one])
    form, uneven = np.empty(0), 0.0
    nothing = Registered(profile, spread, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0), form, uneven)
    if profile.max() <= profile.min():
        return nothing
    centre, half = feet(profile)
    inside, even = half - max(WITHIN, WITHIN_SHARE * half), True
    if _ground_varies(blocks[one], float(profile.max() - profile.min())):
        inside = -math.inf
    edges, usable = _edges(blocks, profile, centre, inside)
    usable &= one
    tilt, bend, agreement = _parabola(edges[0], usable, cut_bend, expected)
    if not agreement:
        return nothing
    count = blocks.shape[0]
    if count >= FEWEST_EVENED and half > 0:
        place, curve = _powers(count)
        moved, limit = np.zeros((2, count)), max(EVEN, EVEN_SHARE * half)
        for _ in range(EVENED):
            change = _smooth(edges[1], usable)
            even = even and abs(np.sum(change * place) / np.sum(place * place)) * BLOCK * count <= TAPERED * half
            moved[1] += change
            if math.sqrt(np.mean(change**2)) <= limit:
                break
            limit, even = EVEN / 2, False  # once laid on each other, blocks are so for good
            moved[0] = tilt * place + bend * curve
            laid = _laid_on(blocks, centre, half, moved)
            profile, spread = _common(laid[one])
            edges, usable = _edges(laid, profile, centre, inside)
            usable &= one
            further = _parabola(edges[0], usable, cut_bend + bend, expected)
            tilt, bend, agreement = tilt + further[0], bend + further[1], further[2]
            if not agreement:
                return nothing
            form = moved[1]
        uneven = math.sqrt(np.mean(moved[1] ** 2)) / half
        if even and inside > -math.inf:
            edges, usable = _edges(blocks, profile, centre, -math.inf)
            usable &= one
            tilt, bend, agreement = _parabola(edges[0], usable, cut_bend, expected)
            if not agreement:
                return nothing
        if form.size:
            form = 1 + form / half
    return Registered(profile, spread, tilt, bend, agreement, middle(profile), background(profile), form, uneven)


@inner
def _powers(count: int) -> tuple[Array, Array]:
    """Return the places of blocks from their middle, x, and x²/2 without its mean [lines, and their square]."""
    place, curve = np.empty(count), np.empty(count)
    for k in range(count):
        place[k] = (k - (count - 1) / 2) * BLOCK
        curve[k] = 0.5 * place[k] * place[k]
    curve -= curve.mean()
    return place, curve


@inner
def about(form: Array, lean: float) -> tuple[float, float]:
    """Return by how much a yarn tilts and bends further than its middle does, from which its axis is `lean` apart.

    Light from one side puts the middle between the profile's feet off the axis. What is wider by a share moves that
    middle by as large a share of this lean; so a taper, unless that is put right, tilts the axis.

    Parameters
    ----------
    form : width of blocks over the mean, shape (blocks,), or empty.
    lean : from the middle to the axis [rows].

    Returns
    -------
    Rows per line, and rows per line².
    """
    if not form.size:
        return 0.0, 0.0
    place, curve = _powers(form.size)
    tilt = lean * np.sum(place * (form - 1)) / np.sum(place * place)
    return tilt, lean * np.sum(curve * (form - 1)) / np.sum(curve * curve)


@inner
def _common(blocks: Image) -> tuple[Array, Array]:
    """Return the mean and the range of the middle half of the values in each row of the blocks, (blocks, rows)."""
    count, rows = blocks.shape
    quarter = count // 4
    ordered = blocks.copy()
    _sort_columns(ordered)
    profile, spread = np.zeros(rows), np.empty(rows)
    for j in range(quarter, count - quarter):
        for i in range(rows):
            profile[i] += ordered[j, i]
    for i in range(rows):
        profile[i] /= count - 2 * quarter
        spread[i] = ordered[count - quarter - 1, i] - ordered[quarter, i]
    return profile, spread


@inner
def _laid_on(blocks: Image, centre: float, half: float, moved: Array) -> Image:
    """Move and stretch blocks so that edges at `centre` ± `half` + `moved` come to lie at `centre` ± `half`.

    Parameters
    ----------
    blocks : shape (blocks, rows).
    centre : from the middle row [rows].
    moved : how far each block's middle is moved, and how much wider each half of it is [rows], shape (2, blocks).
    """
    count, rows = blocks.shape
    laid = np.empty(blocks.shape, np.float32)
    middle = rows // 2 + centre
    for k in range(count):
        stretch = 1 + moved[1, k] / half
        for i in range(rows):
            place = min(max(middle + moved[0, k] + (i - middle) * stretch, 1.0), rows - 2.001)
            near = math.floor(place)
            a, b, c, d = taps(place - near)
            laid[k, i] = (
                a * blocks[k, near - 1]
                + b * blocks[k, near]
                + c * blocks[k, near + 1]
                + d * blocks[k, min(near + 2, rows - 1)]
            )
    return laid


@inner
def _smooth(values: Array, usable: NDArray[np.bool_]) -> Array:
    """Return running medians of the usable values, shape (n,), without their mean; hairs are shorter than these."""
    count = values.size
    smooth = np.zeros(count)
    for k in range(count):
        first, past = max(0, k - SMOOTHED), min(count, k + SMOOTHED + 1)
        near = values[first:past][usable[first:past]]
        if near.size:
            ordered = np.sort(near)
            smooth[k] = (ordered[(near.size - 1) // 2] + ordered[near.size // 2]) / 2
        elif k:
            smooth[k] = smooth[k - 1]
    return smooth - smooth.mean()


@inner
def _sort_columns(values: Image) -> None:
    """Sort each column of values in place, all of them side by side.

    Batcher's odd–even merging (AFIPS Proc. 32, 1968): which rows are compared does not depend on the values, so each
    comparison is one of whole rows, by vector instructions.
    """
    count = values.shape[0]
    merged = 1
    while merged < count:
        apart = merged
        while apart >= 1:
            for first in range(apart % merged, count - apart, 2 * apart):
                for i in range(first, min(first + apart, count - apart)):
                    if i // (2 * merged) == (i + apart) // (2 * merged):
                        upper, lower = values[i], values[i + apart]
                        for j in range(upper.size):
                            a, b = upper[j], lower[j]
                            upper[j], lower[j] = (a, b) if a < b else (b, a)
            apart //= 2
        merged *= 2


@inner
def _edges(blocks: Image, profile: Array, centre: float, inside: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return how far the yarn's middle and each half of its width are off the profile's, and where that can be told.

    Parameters
    ----------
    blocks, profile : shape (blocks, rows) and (rows,).
    centre : of the yarn, from the middle row [rows].
    inside : distance from it from which on rows count for the edge on their side [rows]; −∞ makes one shift of both.

    Returns
    -------
    Shapes (2, blocks) [rows] and (blocks,).
    """
    count, rows = blocks.shape
    edges, usable = np.zeros((2, count)), np.zeros(count, np.bool_)
    # for either edge, what weighs a block's rows to its gain and to gain times shift: rows of a pseudo-inverse
    weighing, pivots = np.zeros((4, rows)), np.empty(3, np.int64)
    for side in range(2):
        design, share = np.zeros((3, rows)), np.zeros(rows)
        for i in range(rows):
            # no row enters at once: another cut of the same frame has its rows elsewhere
            share[i] = min(max((i - rows // 2 - centre) * (2 * side - 1) - inside + 0.5, 0.0), 1.0)
            if share[i] > 0:
                before, after = max(i - 1, 0), min(i + 1, rows - 1)
                design[0, i], design[1, i] = profile[i], 1
                design[2, i] = (profile[before] - profile[after]) / (after - before)
        scale = np.empty(3)
        for k in range(3):
            scale[k] = math.sqrt(np.sum(design[k] ** 2))
            if scale[k] <= 0:
                return edges, usable
            design[k] /= scale[k]
        weighed = design * share
        normal = products(weighed, design)
        for k in range(3):
            normal[k, k] += 1e-12
        lu_factor(normal, pivots)
        for m in range(2):
            mixed = lu_solve(normal, pivots, np.eye(3)[2 * m])
            for k in range(3):
                weighing[2 * side + m] += mixed[k] / scale[2 * m] * weighed[k]
    told = products(weighing, blocks)
    for k in range(count):
        if min(told[0, k], told[2, k]) > 0.3:
            left, right = told[1, k] / told[0, k], told[3, k] / told[2, k]
            edges[0, k], edges[1, k] = (left + right) / 2, (right - left) / 2
            usable[k] = abs(edges[0, k]) < rows / 4
    return edges, usable


@inner
def _on_one_ground(blocks: Image) -> tuple[NDArray[np.bool_], int]:
    """Say which blocks lie on one ground, all unless it changes much along the yarn, and how many should agree.

    The yarn passes from before the cylinder to before what is behind that: brighter than the one, darker than the
    other, it has no profile in common there. The blocks are then those of the commonest levels beside the yarn. Of the
    others those should agree, too, where the yarn itself is not seen to go on: something is in front of it.

    Parameters
    ----------
    blocks : shape (blocks, rows).
    """
    count, rows = blocks.shape
    beside, body = np.empty((2, count)), np.empty(count)
    for k in range(count):
        beside[0, k], beside[1, k] = np.mean(blocks[k, :GROUND_ROWS]), np.mean(blocks[k, rows - GROUND_ROWS :])
        body[k] = np.mean(blocks[k, rows // 3 : rows - rows // 3])
    level, change = upper_median(body), 0.0
    for side in range(2):
        ordered = np.sort(beside[side])
        change = max(change, ordered[count - 1 - count // 10] - ordered[count // 10])
    contrast = np.minimum(np.abs(beside[0] - level), np.abs(beside[1] - level))
    one = np.ones(count, np.bool_)
    if change <= CHANGED * upper_median(contrast):
        return one, count
    most, chosen = 0, 0
    for k in range(count):
        alike = 0
        for m in range(count):
            alike += max(abs(beside[0, m] - beside[0, k]), abs(beside[1, m] - beside[1, k])) <= ALIKE * contrast[k]
        if alike > most:
            most, chosen = alike, k
    if most < max(FEWEST, COMMON * count):
        return one, count
    for m in range(count):
        away = max(abs(beside[0, m] - beside[0, chosen]), abs(beside[1, m] - beside[1, chosen]))
        one[m] = away <= ALIKE * contrast[chosen]
    level = upper_median(body[one])
    goes_on = np.abs(body - level) <= GOES_ON * contrast[chosen]
    return one, most + int(np.count_nonzero(~one & ~goes_on))


@inner
def _ground_varies(blocks: Image, height: float) -> bool:
    """Say whether the level beside the yarn varies along it by more than `GROUND` of the profile's height."""
    count, rows = blocks.shape
    beside = np.empty(count)
    for side in range(2):
        first = side * (rows - GROUND_ROWS)
        for k in range(count):
            beside[k] = np.mean(blocks[k, first : first + GROUND_ROWS])
        ordered = np.sort(beside)
        # standard deviation of a normal variable from its first and last tenth, which may be hairs
        if ordered[count - 1 - count // 10] - ordered[count // 10] > 2.56 * GROUND * height:
            return True
    return False


@spliced
def _parabola(middles: Array, usable: NDArray[np.bool_], cut_bend: float, expected: int) -> tuple[float, float, float]:
    """Return the yarn's tilt [rows per line], bend [rows per line²] and the share of the blocks that agree.

    First a robust line, then from its weights a parabola: that alone might follow a second object. A bend that is not
    significant is taken for none, and none is looked for where only a part of the blocks can tell.

    Parameters
    ----------
    middles : shape (blocks,) [rows].
    usable : shape (blocks,); without enough of them nothing agrees. Blocks that do not agree are made not usable.
    cut_bend : see `register`; the bend returned is on top of it.
    expected : blocks that could agree.
    """
    count, used = middles.size, np.count_nonzero(usable)
    if used < max(3, 0.3 * expected):
        return 0.0, 0.0, 0.0
    position = ((np.arange(count) - (count - 1) / 2) * BLOCK)[usable]
    shift = middles[usable] + 0.5 * cut_bend * position * position
    weight, kept = np.ones(used), np.ones(used, np.bool_)
    tilt, bend, agreement = 0.0, 0.0, 0.0
    for bent in range(2 if used >= FEWEST_BENT and expected == count else 1):
        last, slope, curvature, deviation = math.inf, 0.0, 0.0, 0.0
        for _ in range(10):
            total = weight.sum()
            centred = position - np.sum(weight * position) / total
            weighted = weight * centred
            squares = np.sum(weighted * centred)
            rest = shift - np.sum(weight * shift) / total
            slope = np.sum(weighted * rest) / squares
            rest -= slope * centred
            if bent:
                curve = 0.5 * position * position
                curve -= np.sum(weight * curve) / total
                lean = np.sum(weighted * curve) / squares
                curve -= lean * centred
                curvature = np.sum(weight * curve * rest) / np.sum(weight * curve * curve)
                rest -= curvature * curve
                slope -= curvature * lean  # at place 0
            deviation = 1.4826 * upper_median(np.abs(rest))
            # Tukey's biweight with the usual 4.685 deviations; the floor keeps a noise-free frame from rejecting itself
            weight = np.maximum(1 - (rest / (4.685 * max(deviation, 0.02))) ** 2, 0.0) ** 2
            if abs(slope - last) * BLOCK * count < 1e-3:
                break
            last = slope
        sagitta = abs(curvature) * (BLOCK * count) ** 2 / 8
        if not bent or sagitta > max(ALIGNED, BENT * deviation):
            tilt, bend, agreement = slope, curvature, np.sum(weight > 0.2) / expected
            kept = weight > 0.2
    at = 0
    for k in range(count):
        if usable[k]:
            usable[k] = kept[at]
            at += 1
    return tilt, bend - cut_bend, agreement


@inner
def upper_median(values: Array) -> float:
    """Return the upper median of values, shape (n,): by sorting, because numba's partition takes seconds to compile."""
    return np.sort(values)[values.size // 2]
