"""The outline of a yarn along its length: whether it is scalloped as that of n strands is.

n strands of radius r about the axis at h (`strands.py`) have the half width r + h·max_k cos(θ + 2πk/n), of which one
period is a strand's, 1/(nT) long. With h = r/sin(π/n), where they touch, its mean is r(1 + n/π), and over that its
first harmonic is

    2n / (π(n² − 1)) / (1 + n/π):   26, 12, 7, 5 % for n = 2, 3, 4, 5.

Light, colour and fibres do not change the outline, so its period is the strands' where that of the levels is a half or
a third of it, because strands differ, or that of fibres. A single yarn's outline is straight, or bumpy without period.

The count of the strands is told by the depth, and by how many of them a turn has. A strand is in front while θ is
within ±π/n, and is seen on its centre line, w = h·sin θ. On the unrolled cylinder of the mean half width, on which
`twist.py` finds a twist λT from what is inclined, it has by then moved by twice the γ of w = h·sin(π/n) = r, so that

    λ = (n/π)·asin(1/(1 + n/π)):   0.42, 0.51, 0.58, 0.63.

A period of frequency f is that of n strands if both f·λ/(λT) is n and the depth is that of n strands. Strands that are
flat where they touch have shallower scallops and fibres have slopes of their own: both hold within some `SPREAD`.

The outline is where the level has fallen to `LEVEL` of the body's above the background: low, so that the texture of
what is seen at the edge hardly moves it, but above the noise, which is first averaged along the yarn. That average and
the lens' blur make the scallops shallower, by exp(−2π²f²σ²) as they do a wave's.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import median_filter

from pipeline.measure.axis import YarnAxis, straighten
from pipeline.measure.lines import Image, Pixels
from pipeline.records import Array

LEVEL = 0.2
AVERAGED = 2.0
"""Standard deviation of the average along the yarn [px]."""
INSIDE = 0.4
"""Share of the half width inside of which the level is the body's: no strand's edge comes as near to the axis."""
BESIDE = 1.5
"""Half widths from which on the level is that of the background."""
SHORTEST = 0.7
"""Shortest period looked for [half widths]."""
FLATTEST = 0.1
"""Least slope of the strands, 2πTR, of the longest period looked for."""
MIN_PERIODS = 1.5
SPREAD = 0.15
"""Standard deviation of the logarithms of the depth and of the strands in a turn about those of n strands."""
FARTHEST = 16.0
"""Square of the deviation from n strands, over `SPREAD`, from which on they are not n."""
NEARER = 1.0
"""By how much less the square of another count's must be for that to be the right one."""
COUNTS = range(2, 7)
MIN_SHARE = 0.3
"""Share of what varies along the outline that its strongest period is, at least, to be the strands'."""
MIN_SHARE_UNTOLD, FARTHEST_UNTOLD = 0.5, 9.0
"""These two where nobody says that there are strands."""
MANY_PERIODS = 8.0
"""Periods over which what is strongest by chance does not stay so: from there on `MIN_SHARE` will do all the same."""
MAX_UNSEEN = 0.2
"""Share of the length at which no edge is seen from which on there is no outline."""
HAIR = 4.0
"""Robust standard deviations from which on an edge's place is a hair's."""


@dataclass(frozen=True, slots=True)
class Scallops:
    """The strongest period of an outline."""

    frequency: float
    """[1/px]"""
    amplitude: float
    """Of the first harmonic, over the half width, before the lens and the average along the yarn."""
    share: float
    """Of what varies along the outline."""
    periods: float
    """In view."""


def depth(plies: int) -> float:
    """Return the amplitude of the scallops of n strands that touch, over the outline's mean half width."""
    return 2 * plies / (math.pi * (plies**2 - 1)) / (1 + plies / math.pi)


def slope_share(plies: int) -> float:
    """Return λ, by which the slope of n strands on the unrolled face is less than that of lines there."""
    return plies / math.pi * math.asin(1 / (1 + plies / math.pi))


def find_scallops(image: Image | Pixels, axis: YarnAxis) -> Scallops | None:
    """Return the strongest period of the outline of the yarn on an axis of a frame, shape (rows, columns)."""
    half = math.ceil(axis.diameter) + 2
    strip = straighten(image, axis.centre, axis.angle, half, axis.length)
    return scallops(outline(strip, axis.diameter / 2), axis.diameter / 2, axis.blur)


def why_not_of(found: Scallops | None, plies: int, per_pixel: float) -> str:
    """Say why an outline is not that of so many strands; empty where it is.

    Parameters
    ----------
    found : the outline's period.
    plies : strands n, at least 2.
    per_pixel : the twist λT that the slope of what is on the face tells [1/px]; 0 where it tells none.
    """
    if found is None or found.share < MIN_SHARE:
        return "the outline has no period as the strands of a plied yarn make it"
    off = {count: _off(found, count, per_pixel) for count in {*COUNTS, plies}}
    likest = min(off, key=lambda count: off[count])
    percent = 100 * found.amplitude
    if off[likest] > FARTHEST:
        return f"the outline's scallops are {percent:.0f} % deep: {plies} strands make some {100 * depth(plies):.0f} %"
    if off[plies] > off[likest] + NEARER:
        return f"the outline's scallops, {percent:.0f} % deep, are those of {likest} strands, not of {plies}"
    return ""


def steep_as(plies: int, twist: float, per_pixel: float) -> bool:
    """Say whether what is on the face is about as steep as n strands of a twist.

    Parameters
    ----------
    plies : strands n, at least 2.
    twist : T [1/px].
    per_pixel : the twist λT that the slope of what is on the face tells [1/px]; 0 where it tells none.
    """
    return not per_pixel or math.log(slope_share(plies) * abs(twist / per_pixel)) ** 2 <= FARTHEST * SPREAD**2


def strands_seen(found: Scallops | None, per_pixel: float) -> int:
    """Return the count of strands that an outline is that of, without having been told it; 0 where of none.

    For `per_pixel`, without which depth alone would decide, see `why_not_of`.
    """
    if found is None or not per_pixel:
        return 0
    if found.share < (MIN_SHARE_UNTOLD if found.periods < MANY_PERIODS else MIN_SHARE):
        return 0
    off = {count: _off(found, count, per_pixel) for count in COUNTS}
    likest = min(off, key=lambda count: off[count])
    return likest if off[likest] < FARTHEST_UNTOLD else 0


def _off(found: Scallops, plies: int, per_pixel: float) -> float:
    """Return the square of an outline's deviation from that of n strands, over `SPREAD`."""
    off = [math.log(max(found.amplitude, 1e-9) / depth(plies))]
    if per_pixel:
        off.append(math.log(found.frequency * slope_share(plies) / abs(per_pixel) / plies))
    return sum(one**2 for one in off) / SPREAD**2


def outline(strip: Image, width: float) -> Array:
    """Return how far both edges are from the middle row [px], shape (2, length), NaN where none is seen.

    Parameters
    ----------
    strip : along the yarn, shape (2 half + 1, length), of `BESIDE` half widths and more.
    width : the yarn's half width, about [px].
    """
    half, length = strip.shape[0] // 2, strip.shape[1]
    even = cv2.GaussianBlur(strip, (2 * math.ceil(3 * AVERAGED) + 1, 1), AVERAGED, borderType=cv2.BORDER_REFLECT_101)
    inside, size = round(INSIDE * width), 2 * round(width) + 1
    body = median_filter(np.median(even[half - inside : half + inside + 1], axis=0), 2 * size - 1, mode="nearest")
    edges = np.full((2, length), np.nan)
    columns = np.arange(length)
    for side, rows in enumerate((even[half - inside :: -1], even[half + inside :])):
        beside = rows[max(1, round(BESIDE * width)) - inside :]
        ground = median_filter(np.median(beside, axis=0), size, mode="nearest")
        above = body - ground
        level = (rows - ground) / np.where(np.abs(above) > 0, above, np.nan)
        below = level < LEVEL
        first = np.maximum(np.argmax(below, axis=0), 1)
        before, after = level[first - 1, columns], level[first, columns]
        place = inside + first - 1 + (before - LEVEL) / np.where(before > after, before - after, np.nan)
        edges[side] = np.where(below.any(axis=0) & ~below[0], place, np.nan)
    return edges


def scallops(edges: Array, width: float, blur: float) -> Scallops | None:
    """Return the strongest period of an outline; None where there is none in view.

    Parameters
    ----------
    edges : as `outline` returns them.
    width : the yarn's half width, about [px].
    blur : standard deviation of the lens' blur [px].
    """
    length = edges.shape[1]
    lowest = max(MIN_PERIODS / length, FLATTEST / (2 * math.pi * width))
    unseen = np.isnan(edges)
    if unseen.mean() > MAX_UNSEEN or lowest >= 1 / (SHORTEST * width):
        return None
    x = np.linspace(-0.5, 0.5, length)
    trend = np.linalg.qr(np.vander(x, 3))[0]
    filled = np.where(unseen, np.nanmedian(edges, axis=1, keepdims=True), edges)
    smooth = median_filter(filled, (1, 5), mode="nearest")
    off = smooth - (smooth @ trend) @ trend.T
    limit = HAIR * 1.4826 * np.median(np.abs(off), axis=1, keepdims=True) + 0.1
    off = np.clip(off, -limit, limit)
    size = 8 * 2 ** math.ceil(math.log2(length))
    power = np.sum(np.abs(np.fft.rfft(off, size, axis=1)) ** 2, axis=0)
    tried = np.arange(math.ceil(lowest * size), min(power.size, math.floor(size / (SHORTEST * width)) + 1))
    if not tried.size:
        return None
    best = int(tried[np.argmax(power[tried])])
    angle = 2 * math.pi * best / size * length * np.outer(x, (1, 2))
    waves = np.hstack([np.cos(angle[:, :1]), np.sin(angle[:, :1]), np.cos(angle[:, 1:]), np.sin(angle[:, 1:])])
    waves = np.linalg.qr(waves - trend @ (trend.T @ waves))[0]
    parts = (off @ waves) ** 2
    flattened = math.exp(-2 * (math.pi * best / size) ** 2 * (AVERAGED**2 + blur**2))
    # where no edge is seen it stands for a straight one
    amplitude = math.sqrt(2 * float(parts[:, :2].sum()) / off.size) / width / flattened / (1 - float(unseen.mean()))
    share = float(parts.sum()) / max(float(np.sum(off**2)), 1e-12)
    return Scallops(best / size, amplitude, share, best / size * length)
