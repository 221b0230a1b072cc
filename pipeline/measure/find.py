"""Where in a frame a yarn may be: straight bands, good to about a pixel, without a threshold from the user.

Two searches on a reduced frame. What deviates from a smooth background, a quadratic in x and y fitted robustly, finds a
thin yarn on uneven ground. What departs from the ground's level finds a yarn that fills so much of the frame that no
background can be fitted. Otsu's threshold and connected components give elongated things; a line is fitted to their
full cross-sections only, because the slanted ends where the frame cuts the yarn would turn the line. Where the yarn is
brighter than one ground and darker than another, as before a cylinder, both find it in a part of the frame only.
"""

import math
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled
from models.newton import lu_factor, lu_solve
from pipeline.measure.align import MIN_ASPECT, upper_median
from pipeline.measure.lines import Image, Pixels, span
from pipeline.records import Array

REDUCTION = 4
"""Step of the reduced frame [px]."""
SMALLEST = 4 * REDUCTION
"""Least side of a frame that a yarn is looked for in [px]."""
MIN_PIXELS = 12
"""Fewest pixels of the reduced frame that a line is fitted to."""
FOOT = 0.3
"""Share of the way from the ground to a thing's mean level that is on its edge."""
SHORTEST_CUT = 200
"""Least side of a frame that is cut in parts [px]."""
THINGS = 3
"""Largest things of a mask that are tried."""

Line = tuple[float, float, float, float]
"""A point (x, y) on it, its angle, and half the width of the band about it [px]."""


@compiled
def _reduced(frame: Image | Pixels) -> Image:
    """Return the mean of each `REDUCTION` × `REDUCTION` pixels; what is left over at the far ends is left out."""
    rows, columns = frame.shape[0] // REDUCTION, frame.shape[1] // REDUCTION
    small = np.empty((rows, columns), np.float32)
    sums = np.empty(columns * REDUCTION, np.float32)
    for i in range(rows):
        sums[:] = 0
        for k in range(REDUCTION):
            line = frame[i * REDUCTION + k]
            for j in range(sums.size):
                sums[j] += np.float32(line[j])
        for j in range(columns):
            total = np.float32(0)
            for k in range(REDUCTION):
                total += sums[j * REDUCTION + k]
            small[i, j] = total / np.float32(REDUCTION * REDUCTION)
    return small


@compiled
def _deviation(image: Image) -> Image:
    """Return |image − background|: a quadratic in x and y, fitted to every fourth pixel both ways, or to the median.

    What deviates by more than 3 median deviations is left out, iterated. Along a side that every fourth pixel leaves
    fewer than the three of that a quadratic needs, all are taken.
    """
    rows, columns = image.shape
    v, u = np.linspace(-1, 1, rows), np.linspace(-1, 1, columns)
    down, along = 4 if rows > 8 else 1, 4 if columns > 8 else 1
    count = ((rows + down - 1) // down) * ((columns + along - 1) // along)
    basis, values = np.ones((6, count)), np.empty(count)
    at = 0
    for i in range(0, rows, down):
        for j in range(0, columns, along):
            basis[1, at], basis[2, at], values[at] = u[j], v[i], image[i, j]
            at += 1
    basis[3], basis[4], basis[5] = basis[1] * basis[1], basis[1] * basis[2], basis[2] * basis[2]
    middle, c = upper_median(values), np.zeros(6)
    c[0], rest = middle, values - middle
    normal, right, pivots = np.empty((6, 6)), np.empty(6), np.empty(6, np.int64)
    for _ in range(4):
        keep = np.abs(rest) <= 3 * 1.4826 * upper_median(np.abs(rest)) + 1e-9
        for k in range(6):
            kept = np.where(keep, basis[k], 0.0)
            right[k] = np.sum(kept * values)
            for m in range(k + 1):
                normal[k, m] = normal[m, k] = np.sum(kept * basis[m])
        if not lu_factor(normal, pivots):
            break
        c = lu_solve(normal, pivots, right)
        rest[:] = values
        for k in range(6):
            rest -= c[k] * basis[k]
    deviation = np.empty(image.shape, np.float32)
    for i in range(rows):
        level, slope = c[0] + (c[2] + c[5] * v[i]) * v[i], c[1] + c[4] * v[i]
        for j in range(columns):
            deviation[i, j] = abs(image[i, j] - (level + (slope + c[3] * u[j]) * u[j]))
    return deviation


def find_line(image: Image | Pixels) -> Line | None:
    """Return the largest elongated thing of a frame, shape (rows, columns), that deviates from a smooth background."""
    if min(image.shape) < SMALLEST:
        return None
    deviation = _deviation(_reduced(image))
    threshold = _otsu(deviation, 0.0)
    return None if threshold is None else _largest(deviation >= threshold)


def level_lines(image: Image | Pixels) -> list[Line]:
    """Return the largest elongated things that stand out by their level: at most four.

    Brighter than the ground and darker than it: the ground is taken for one of two levels, and what departs from it by
    more than `FOOT` of the way to the other is a thing; half way, dark fibres would cut a bright yarn in pieces. And
    between the two: a yarn brighter than what is behind the cylinder, and darker than that.
    """
    if min(image.shape) < SMALLEST:
        return []
    small = _reduced(image)
    least = float(small.min())
    threshold = _otsu(small, least)
    if threshold is None:
        return []
    above = small >= threshold
    bright, dark = float(small[above].mean()), float(small[~above].mean())
    things = [small > dark + FOOT * (bright - dark), small < bright - FOOT * (bright - dark)]
    if (between := _otsu(small[~above], least)) is not None:
        things.append((small >= between) & ~above)
    if (between := _otsu(small[above], float(small[above].min()))) is not None:
        things.append((small < between) & above)
    return [line for thing in things if (line := _largest(thing)) is not None]


def part_lines(image: Image | Pixels) -> Iterator[Line]:
    """Yield the lines of both searches in overlapping parts of a frame, half as wide and half as high.

    A side that is too short for half of it to hold a yarn and its ground is not cut.
    """
    sizes = [side // 2 if side >= SHORTEST_CUT else side for side in image.shape]
    for top in range(0, image.shape[0] - sizes[0] + 1, max(sizes[0] // 2, 1)):
        for left in range(0, image.shape[1] - sizes[1] + 1, max(sizes[1] // 2, 1)):
            part = image[top : top + sizes[0], left : left + sizes[1]].copy()
            for line in (find_line(part), *level_lines(part)):
                if line is not None:
                    yield line[0] + left, line[1] + top, line[2], line[3]


def _otsu(values: Image, low: float) -> float | None:
    """Return the least level above Otsu's threshold, of values of any shape; None where all are `low`, the least."""
    high = float(values.max())
    if high <= low:
        return None
    stretched = ((values - np.float32(low)) * (255 / (high - low))).astype(np.uint8)
    level, _ = cv2.threshold(stretched, 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    return low + (level + 1) * (high - low) / 255


def _largest(thing: NDArray[np.bool_]) -> Line | None:
    """Return the line through the largest band of a thing in a reduced frame."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(thing.astype(np.uint8), connectivity=8)
    for label in 1 + np.argsort(stats[1:, cv2.CC_STAT_AREA])[::-1][:THINGS]:
        rows, columns = np.nonzero(labels == label)
        x, y, angle, half = _line_through(columns.astype(float), rows.astype(float), *thing.shape)
        if half:
            edge = (REDUCTION - 1) / 2
            return x * REDUCTION + edge, y * REDUCTION + edge, angle, half * REDUCTION
    return None


@compiled
def _line_through(xs: Array, ys: Array, rows: int, columns: int) -> tuple[float, float, float, float]:
    """Fit a line to the full cross-sections of a band of pixels in a frame of `rows` and `columns`.

    Parameters
    ----------
    xs, ys : the pixels, shape (n,), rows top-down.

    Returns
    -------
    A point x, y, the angle and half the width; zeros where the pixels are no band.
    """
    none = (0.0, 0.0, 0.0, 0.0)
    if xs.size < MIN_PIXELS:
        return none
    x, y = xs.mean(), ys.mean()
    xx, yy = np.sum((xs - x) ** 2) / (xs.size - 1), np.sum((ys - y) ** 2) / (xs.size - 1)
    xy = np.sum((xs - x) * (ys - y)) / (xs.size - 1)
    # variances along and across the principal axis
    middle, reach = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
    if middle + reach < MIN_ASPECT**2 * (middle - reach):
        return none
    angle = -0.5 * math.atan2(2 * xy, xx - yy)
    half = math.sqrt(3 * max(middle - reach, 1 / 12))
    for _ in range(4):
        c, s = math.cos(angle), math.sin(angle)
        along = (xs - x) * c - (ys - y) * s
        across = (xs - x) * s + (ys - y) * c
        low, high = span(rows, columns, x, y, angle, half)
        near = np.abs(across - upper_median(across)) < 1.3 * half + 1
        if low < high:
            near &= (along > low) & (along < high)
        along, across = along[near], across[near]
        if along.size < MIN_PIXELS:
            return none
        length = along.max() - along.min() + 1
        centred = along - along.mean()
        tilt = np.sum(centred * across) / np.sum(centred * centred)
        half = max(0.5, along.size / length / 2)
        if length < MIN_ASPECT * 2 * half:
            return none
        shift = across.mean() - tilt * along.mean()
        x, y = x + shift * s, y + shift * c
        angle -= math.atan(tilt)
    return x, y, angle, half
