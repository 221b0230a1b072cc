"""A line in a frame, aligned with the yarn on it: the second step of `axis.py`.

The yarn is cut along the line (`lines.py`). The mean cross profile p(w) is held against each short block of it:
I(w) = g·p(w) + o − δ·p′(w) is solved for the block's shift δ (the image registration of Lucas and Kanade, IJCAI 1981,
with gain and offset). p′ is large at the two edges only, so δ is the mean of both edges' sub-pixel positions and
texture hardly enters. A robust line through δ corrects the axis; blocks with a hair or a second object drop out.

Compiled as a whole: a frame needs one or two cuts, and between calls threads would wait for each other.
"""

import math
from typing import NamedTuple

import numpy as np

from models.compiled import inner, spliced
from models.newton import lu_factor, lu_solve
from pipeline.measure.lines import Image, Pixels, block_means, span, step_across
from pipeline.measure.profile import background, middle, products
from pipeline.records import Array

BLOCK = 8
"""Lines whose shift is found at once."""
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
    agreement: float
    """Share of the blocks that follow the yarn; 0 without enough of them."""
    shift: float
    """Distance of the yarn from the middle row, to the right [rows]."""
    beside: tuple[float, float]
    """Levels beside the yarn, at the first and at the last row [counts]."""


class Aligned(NamedTuple):
    """A cut whose line runs along the yarn."""

    cut: Cut
    """Its length is 0 where there is no yarn."""
    registered: Registered
    angle: float
    """[rad]"""


@inner
def align(image: Image | Pixels, x: float, y: float, angle: float, radius: float) -> Aligned:
    """Align a line with the yarn on it.

    Parameters
    ----------
    image : shape (rows, columns).
    x, y, angle, radius : a point of the line [px], its angle [rad], and about half of the yarn's width [px].
    """
    none = Cut(np.empty((0, 0), np.float32), 1.0, x, y, 0)
    nothing = Registered(np.empty(0), np.empty(0), 0.0, 0.0, 0.0, (0.0, 0.0))
    for _ in range(ROUNDS):
        found = cut(image, x, y, angle, 1.3 * radius + 6, MIN_ASPECT * 2 * radius)
        if not found.length:
            break
        x, y = found.x, found.y
        registered = register(found.blocks)
        if not registered.agreement:
            break
        # from rows and lines to pixels
        tilt, shift = registered.tilt * found.step**2, registered.shift * found.step
        angle -= math.atan(tilt)
        if abs(shift) <= CENTRED and abs(tilt) * found.length <= ALIGNED:
            return Aligned(found, registered, angle)
        x, y = x + shift * math.sin(angle), y + shift * math.cos(angle)
    return Aligned(none, nothing, angle)


@inner
def cut(image: Image | Pixels, x: float, y: float, angle: float, reach: float, shortest: float) -> Cut:
    """Cut a frame over `reach` on each side of a line; nothing where less than `shortest` of that band is in view."""
    step = step_across(angle)
    half = math.ceil(reach / step)
    low, high = span(image.shape[0], image.shape[1], x, y, angle, half * step)
    length, count = math.floor(high - low), math.floor((high - low) * step / BLOCK)
    if length < shortest or count < FEWEST:
        return Cut(np.empty((0, 0), np.float32), step, x, y, 0)
    x, y = x + (low + high) / 2 * math.cos(angle), y - (low + high) / 2 * math.sin(angle)
    return Cut(block_means(image, x, y, angle, half, count, BLOCK), step, x, y, length)


@inner
def register(blocks: Image) -> Registered:
    """Find what blocks, shape (blocks, rows), have in common, and how the yarn lies in them."""
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
    tilt, agreement = _shifts(blocks, profile)
    shift = middle(profile) if agreement else 0.0
    return Registered(profile, spread, tilt, agreement, shift, background(profile))


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


@spliced
def _shifts(blocks: Image, profile: Array) -> tuple[float, float]:
    """Return the yarn's tilt [rows per line], and the share of the blocks that agree; 0 without enough."""
    count, rows = blocks.shape
    design = np.ones((3, rows))
    for i in range(rows):
        before, after = max(i - 1, 0), min(i + 1, rows - 1)
        design[0, i], design[2, i] = profile[i], (profile[before] - profile[after]) / (after - before)
    scale = np.empty(3)
    for k in range(3):
        scale[k] = math.sqrt(np.sum(design[k] ** 2))
        if scale[k] <= 0:
            return 0.0, 0.0
        design[k] /= scale[k]
    normal = products(design, design)
    for k in range(3):
        normal[k, k] += 1e-12
    pivots = np.empty(3, np.int64)
    lu_factor(normal, pivots)
    # rows of the pseudo-inverse: what weighs a block's rows to its gain and to gain times shift
    weighing = np.zeros((2, rows))
    for m in range(2):
        mixed = lu_solve(normal, pivots, np.eye(3)[2 * m])
        for k in range(3):
            weighing[m] += mixed[k] / scale[2 * m] * design[k]
    gain, moved = products(weighing, blocks)
    usable = (gain > 0.3) & (np.abs(moved) < np.abs(gain) * (rows / 4))
    used = np.count_nonzero(usable)
    if used < max(3, 0.3 * count):
        return 0.0, 0.0
    shift = moved[usable] / gain[usable]
    position = ((np.arange(count) - (count - 1) / 2) * BLOCK)[usable]
    weight = np.ones(used)
    tilt = 0.0
    for _ in range(10):
        last = tilt
        total = weight.sum()
        centred = position - np.sum(weight * position) / total
        weighted = weight * centred
        tilt = np.sum(weighted * shift) / np.sum(weighted * centred)
        rest = shift - np.sum(weight * shift) / total - tilt * centred
        # Tukey's biweight with the usual 4.685 deviations; the floor keeps a noise-free frame from rejecting itself
        reach = 4.685 * max(1.4826 * upper_median(np.abs(rest)), 0.02)
        weight = np.maximum(1 - (rest / reach) ** 2, 0.0) ** 2
        if abs(tilt - last) * BLOCK * count < 1e-3:
            break
    return tilt, np.sum(weight > 0.2) / count


@inner
def upper_median(values: Array) -> float:
    """Return the upper median of values, shape (n,): by sorting, because numba's partition takes seconds to compile."""
    return np.sort(values)[values.size // 2]
