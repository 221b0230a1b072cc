"""Twist of a yarn in one frame by a tracer: one dyed fibre that stays on the surface, the usual way to see twist.

On the unrolled surface the fibre is the line γ = 2πT·x + u₀ wherever it faces the camera. The surface is therefore
averaged over all pixels of equal u = γ − 2πT·x (modulo a turn), for each T tried: with the right T the fibre is one
narrow line of u, and the yarn's other fibres, which end after some diameters, average out. T is where the darkest or
brightest line is strongest.

The average is made in Fourier space: its m-th coefficient in u is the transform of the surface at m around and mT along
(the central slice theorem on a cylinder), for all m at once.

The estimate is credible where the line is stronger than that of any other twist by `MIN_CONTRAST`; where its pieces,
all along the yarn, lie `MIN_DEPTH` away from the surface's mean, in standard deviations of the surface beside it, and
are alike within `MAX_UNEVEN`, which other fibres that end, strung together, are not; and where the fibre is seen over
`MIN_TURNS`, from the first place to the last: then it passes the front twice, a turn apart.

Where it passes the front once, its slope is seen, which is 2πTρ: how deep ρ lies below the outline is not known. The
narrow line that stands out most is too flat then, because more of a flatter one lies on a fibre that is wider than it.
So the slope is that of the band, of whatever width, which explains most of the surface's variance: (Σ surface)²/n over
the n pixels in it. One pass is no more than a strong fibre among others shows, too. It counts where it leads over
`MIN_CROSSED` of the face and no other band at the same twist comes to more than `MAX_RIVAL` of it. Two parts of passes,
less than a turn apart, tell neither slope nor turn.
"""

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.measure.axis import YarnAxis
from pipeline.measure.lines import Image, Pixels, step_across
from pipeline.measure.twist import FrameTwist, unroll
from pipeline.records import Array

STEEPEST = 1.6
"""Largest πdT searched, both hands."""
NARROWEST = 3.0
"""Narrowest line looked for [px]."""
STEPS = 20
"""Twists tried per 1/length."""
MIN_DIAMETER = 12.0
MIN_CONTRAST = 0.25
MIN_TURNS = 1.0
MIN_DEPTH = 2.4
"""Mean distance of the line's pieces from the surface's mean, in standard deviations of the surface beside the line."""
MAX_UNEVEN = 0.3
"""Standard deviation of the pieces over that distance."""
BESIDE = 0.25
"""Distance from the line [radii] beyond which the surface is beside it."""
PIECE = 1.0
"""Length of a piece of the line [radii]."""
ONE_PASS = 0.5
"""Turns up to which what is seen of the fibre is one pass of the front: the face is less than half of a turn."""
MIN_CROSSED = 0.9
"""Share of the rows of the face that one pass leads over."""
MAX_RIVAL = 0.7
"""Mean level of any other band of its width over that of one pass."""
WIDEST = 0.4
"""Widest band looked for [radii]: a dyed fibre, blurred."""
WIDTHS = 8
SEARCHED = ((0.3, 31), (0.04, 17))
"""Twists tried for one pass: relative range about the one before, and number."""


def tracer_twist(image: Image | Pixels, axis: YarnAxis) -> FrameTwist:
    """Find the twist of the yarn on an axis of a frame, shape (rows, columns), by its tracer fibre."""
    if axis.diameter < MIN_DIAMETER:
        found = f"the yarn is {axis.diameter:.1f} px across: at least {MIN_DIAMETER:.0f} px are needed"
        return FrameTwist(math.nan, 0.0, 0.0, found)
    radius = axis.diameter / 2
    surface = unroll(image, axis)
    if not np.any(surface):
        return FrameTwist(math.nan, 0.0, 0.0, "the yarn shows no texture")
    highest = STEEPEST / (math.pi * axis.diameter)
    tried = np.linspace(-highest, highest, 2 * math.ceil(highest * axis.length * STEPS) + 1)
    step = 1 / step_across(axis.angle)
    score = _strongest_line(surface, step, tried, radius)
    best = int(np.argmax(score))
    fine = tried[best] + (tried[1] - tried[0]) * np.linspace(-2, 2, 33)
    fine_score = _strongest_line(surface, step, fine, radius)
    top = int(np.clip(np.argmax(fine_score), 4, 28))
    a, b, _ = np.polyfit(np.arange(-4, 5), fine_score[top - 4 : top + 5], 2)
    twist = float(fine[top] + (fine[1] - fine[0]) * (np.clip(-b / (2 * a), -4, 4) if a < 0 else 0))
    elsewhere = np.abs(tried - twist) > max(2 / axis.length, 0.1 * abs(twist))
    contrast = 1 - float(score[elsewhere].max(initial=0.0)) / float(score[best])
    reason = ""
    depth, uneven, seen = _pieces(surface, step, twist, radius)
    if contrast < MIN_CONTRAST:
        reason = f"no one tracer fibre stands out (contrast {contrast:.2f}): at least {MIN_CONTRAST} is needed"
    elif depth < MIN_DEPTH:
        reason = f"no tracer fibre is seen all along the yarn (depth {depth:.1f}): at least {MIN_DEPTH} is needed"
    elif uneven > MAX_UNEVEN:
        reason = (
            f"what is seen as a tracer changes by {uneven:.2f} of its depth along the yarn: {MAX_UNEVEN} is too much"
        )
    elif ONE_PASS <= seen * abs(twist) < MIN_TURNS:
        found = f"parts of two passes of the tracer fibre are seen, over {seen * abs(twist):.2f} turns"
        reason = f"{found}: at least {MIN_TURNS:g}, or one whole pass, is needed"
    one_pass = not reason and seen * abs(twist) < MIN_TURNS
    if one_pass:
        twist, crossed, rival = _one_pass(surface, step, twist, radius)
        if crossed < MIN_CROSSED:
            reason = f"the tracer fibre is seen over {crossed:.2f} of the face: at least {MIN_CROSSED} is needed"
        elif rival > MAX_RIVAL:
            reason = (
                f"one pass of the face has a rival of {rival:.2f} its strength: {MAX_RIVAL} is too much for a tracer"
            )
    return FrameTwist(math.nan if reason else twist, float(fine_score.max()), contrast, reason, one_pass=one_pass)


def _one_pass(surface: Image, step: float, twist: float, radius: float) -> tuple[float, float, float]:
    """Return the twist that the slope of the band which explains most tells [1/px], and what the band is like.

    That is the share of the face's rows that it leads over, and the mean level of the strongest other band of its
    width at the same twist over its own.

    Parameters
    ----------
    surface, step : see `_pieces`.
    twist : near the one looked for [1/px].
    """
    rows = surface.shape[0]
    around = round(2 * math.pi * radius)
    widths = np.unique(np.linspace(NARROWEST, max(NARROWEST + 1, WIDEST * radius), WIDTHS).round().astype(int))
    width = 0
    for share, number in SEARCHED:
        tried = twist * (1 + share * np.linspace(-1, 1, number))
        explained = np.empty((number, widths.size))
        for i, one in enumerate(tried.tolist()):
            count, total = _bands(surface, _around(surface, step, one, radius), around, widths)
            explained[i] = (total**2 / np.maximum(count, 1)).max(axis=1)
        best, width = np.unravel_index(np.argmax(explained), explained.shape)
        top = int(np.clip(best, 4, number - 5))
        a, b, _ = np.polyfit(np.arange(-4, 5), explained[top - 4 : top + 5, width], 2)
        twist = float(tried[top] + (tried[1] - tried[0]) * (np.clip(-b / (2 * a), -4, 4) if a < 0 else 0))
    place, wide = _around(surface, step, twist, radius), int(widths[width])
    count, total = (part[0] for part in _bands(surface, place, around, widths[width : width + 1]))
    level = np.abs(total) / np.maximum(count, 1)
    first = int(np.argmax(level**2 * count))
    crossed = np.count_nonzero(((place - first) % around < wide).any(axis=1)) / rows
    apart = np.abs((np.arange(around) - first + around // 2) % around - around // 2)
    beside = (apart >= wide + 0.1 * radius) & (count > 0.3 * count[first])
    return twist, crossed, float(level[beside].max(initial=0.0)) / max(float(level[first]), 1e-9)


def _around(surface: Image, step: float, twist: float, radius: float) -> NDArray[np.intp]:
    """Return u of the surface's pixels, modulo a turn [1/radius, rounded]; parameters as for `_pieces`."""
    rows, length = surface.shape
    row, x = np.arange(rows) - (rows - 1) / 2, step * (np.arange(length) - (length - 1) / 2)
    return np.round(row[:, None] - 2 * math.pi * radius * twist * x).astype(np.intp) % round(2 * math.pi * radius)


def _bands(surface: Image, place: NDArray[np.intp], around: int, widths: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return how many pixels the bands hold, and the sums of these, shape (widths, around).

    Parameters
    ----------
    surface : shape (rows, columns).
    place : see `_around`.
    around : number of u, at which the bands begin.
    widths : of the bands.
    """
    u = np.arange(around)
    of_each = (np.bincount(place.ravel(), weight, around) for weight in (None, surface.ravel()))
    count, total = (np.concatenate([[0.0], np.cumsum(np.tile(values, 2))]) for values in of_each)
    ends = u + widths[:, None]
    return count[ends] - count[u], total[ends] - total[u]


def _pieces(surface: Image, step: float, twist: float, radius: float) -> tuple[float, float, float]:
    """Return what the strongest line's pieces say.

    Their mean depth, see `MIN_DEPTH`, how uneven they are, see `MAX_UNEVEN`, and the length over which the line is seen
    [px].

    Parameters
    ----------
    surface : see `unroll`.
    step : distance between its columns [px].
    """
    length = surface.shape[1]
    around = round(2 * math.pi * radius)
    x = step * (np.arange(length) - (length - 1) / 2)
    place = _around(surface, step, twist, radius)
    count = np.bincount(place.ravel(), minlength=around)
    line = np.bincount(place.ravel(), surface.ravel(), minlength=around) / np.maximum(count, 1)
    line = np.where(count > 0.3 * count.mean(), line, 0)
    half = round(NARROWEST) // 2
    line = np.convolve(np.concatenate([line[-half:], line, line[:half]]), np.ones(2 * half + 1), "valid")
    top = int(np.argmax(np.abs(line)))
    away = np.abs((place - top + around // 2) % around - around // 2)
    on, beside = away <= half, away > max(BESIDE * radius, NARROWEST)
    piece = np.broadcast_to((x - x[0]) // (PIECE * radius), place.shape).astype(int)
    pixels, values = np.bincount(piece[on]), np.bincount(piece[on], surface[on])
    whole = pixels >= 0.25 * NARROWEST * PIECE * radius / step
    if not np.any(whole) or not np.any(beside):
        return 0.0, 0.0, 0.0
    means = values[whole] / pixels[whole] * np.sign(line[top])
    columns = np.flatnonzero(on.any(axis=0))
    depth = float(means.mean())
    uneven = float(means.std()) / max(depth, 1e-9)
    return depth / max(float(surface[beside].std()), 1e-9), uneven, step * float(columns[-1] - columns[0])


def _strongest_line(surface: Image, step: float, twists: Array, radius: float) -> Array:
    """Return how far the strongest line of u stands out, in standard deviations of the surface, shape (twists,).

    Parameters
    ----------
    surface : see `unroll`; rows are 1/R apart in γ.
    step : distance between its columns [px].
    twists : [1/px], shape (n,).
    """
    rows, length = surface.shape
    around = round(2 * math.pi * radius)
    highest = max(4, math.floor(math.pi * radius / NARROWEST))
    gamma = (np.arange(rows) - (rows - 1) / 2) / radius
    x = step * (np.arange(length) - (length - 1) / 2)
    waves = np.exp(-1j * np.outer(np.arange(1, highest + 1), gamma)) @ surface
    turn = np.exp(2j * math.pi * np.outer(twists, x))
    power = np.ones_like(turn)
    slices = np.zeros((twists.size, around // 2 + 1), complex)
    for m in range(1, highest + 1):
        power = power * turn
        slices[:, m] = power @ waves[m - 1]
    line = np.fft.irfft(slices, around, axis=1)
    # every u is seen on its part of the circumference
    return np.abs(line).max(axis=1) * around / (length * rows)
