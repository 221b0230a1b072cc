"""Twist of a single yarn in one frame, from the slope of the fibres on its unrolled surface.

At distance w from the axis the surface stands at γ = asin(w/R); there a fibre is the straight line γ = 2πT·x + const.
The unrolled texture is correlated with itself: C(Δx, Δγ) is Pearson's coefficient of all pairs of pixels so far apart,
with the means and variances of the parts of the rows that they are in. At a fixed Δx the ridge of C lies at
Δγ = 2πT·Δx whatever the texture's spectrum, and whatever the scatter of the fibres about their mean direction, as long
as it is even: both only change the ridge's height and width. (At a fixed wave number or a fixed Δγ the same scatter
would pull the slope, and with the means of whole rows broad fibres of little twist would.) The twist is the T with the
largest sum

    Q(T) = Σ_Δx C(Δx, 2πT·Δx),   Δx from 4 px to 4 diameters.

Pixel noise is uncorrelated from pixel to pixel and enters C at Δx < 4 px only, so it moves nothing. The sign of the
slope is the handedness. Correlation along inclined lines is the slant stack of seismology (Schultz and Claerbout,
Geophysics 43, 1978), taken of the autocorrelation.

Near the edge the optics mix the outermost surface with points further in only, because beyond it there is nothing, so
a row would show a smaller γ than its own: rows within `EDGE` times the blur's σ of the edge are not used. Further in,
the curvature of asin and the fall of Lambert's light shift the γ shown by +½ and −1 times σ²w/(R² − w²)^{3/2}: each row
is taken from the place where its γ shows (`lit.places_of`). Rows in a shadow darker than `DARKEST` are left out.

The estimate is credible where all of this holds: the yarn is at least `MIN_DIAMETER` across and in focus; the mean
correlation along the fibres is at least `MIN_COHERENCE`; no slope that is flatter or steeper by more than a factor of
two, or of the other hand, comes nearer to the maximum than `MIN_CONTRAST` of it; the maximum is inside the range
searched; `MIN_TURNS` are in view.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from models.compiled import compiled, inner
from pipeline.measure.axis import YarnAxis
from pipeline.measure.lines import Image, Pixels, step_across, unrolled
from pipeline.measure.lit import level, places_of
from pipeline.measure.profile import dot, total
from pipeline.records import Array

Indices = NDArray[np.intp]
Spectra = NDArray[np.complex64]

MIN_DIAMETER = 20.0
MAX_BLUR = 0.15
"""Blur over the radius above which an edge cannot be told from the body."""
MAX_BLUR_PX, UP_TO = 2.6, 30.0
"""Blur from which fibres mix and a lens out of focus, whose blur is no Gaussian, shows structure that is not there and,
with light from the side, diameters that are wrong by up to 29 % [px]; of yarn of a larger radius than the second one
[px] it is as much more: that is the same picture with finer pixels."""
MIN_TURNS = 0.1
MIN_COHERENCE = 0.2
MIN_CONTRAST = 0.5
MIN_HAND = 0.15
"""Least contrast of a slope to tell the hand of a plied yarn."""
WIDEST = 0.8
"""Largest |w|/R used: further out the fibres lie too close to be told apart."""
SLOPES = np.geomspace(0.04, 2.0, 72)
"""tan β = πdT searched, both signs: β from 2° to 63°."""
SIGNED_SLOPES = np.concatenate([-SLOPES[::-1], [0.0], SLOPES])
DARKEST = 0.2
"""Least level of a row over the brightest one's."""
EDGE = 2.5
"""Distance from the edge inside of which rows are not used, in standard deviations of the blur."""
NEAREST = 2
"""Smallest Δx [columns of two]: interpolation reaches over 2 single ones."""
FARTHEST = 4.0
"""Largest Δx [diameters]."""
LAGS = 32
"""Number of Δx used."""
GRID = 8
"""Step of the longest Δx [columns of two]: frames of about one size share tables."""
VECTOR = 32
"""Step of the transforms' lengths [columns of two]: half as many waves, and one, fill vector registers."""


@dataclass(frozen=True, slots=True)
class FrameTwist:
    """What one frame says of the twist."""

    per_pixel: float
    """Signed twist [1/px], Z > 0; NaN where not credible."""
    coherence: float
    """Mean correlation along the fibres, at most 1."""
    contrast: float
    """1 − (the best Q of any other slope) / (the largest Q)."""
    reason: str
    """Why there is no twist; empty where there is."""
    u: float = math.nan
    """Standard uncertainty by what texture and background leave unexplained [1/px]; NaN where not told."""
    one_pass: bool = False
    """Whether it is the slope of one pass of a tracer fibre over the face, see `tracer.py`."""


def most_blur(radius: float) -> float:
    """Return the blur up to which yarn of a radius can be measured, both in px."""
    return min(MAX_BLUR * radius, MAX_BLUR_PX * max(1.0, radius / UP_TO))


def surface_twist(image: Image | Pixels, axis: YarnAxis) -> FrameTwist:
    """Find the twist of the yarn on an axis of a frame, shape (rows, columns)."""
    if axis.diameter < MIN_DIAMETER:
        found = f"the yarn is {axis.diameter:.1f} px across: at least {MIN_DIAMETER:.0f} px are needed"
        return FrameTwist(math.nan, 0.0, 0.0, found)
    radius = axis.diameter / 2
    limit = most_blur(radius)
    if axis.blur > limit:
        found = f"the edges are blurred over {axis.blur:.1f} px: at most {limit:.1f} px at this diameter"
        return FrameTwist(math.nan, 0.0, 0.0, found)
    texture, slope, contrast, coherence = _strongest(image, axis)
    if not slope:
        found = "no inclined fibres stand out" if np.any(texture) else "the yarn shows no texture"
        return FrameTwist(math.nan, 0.0, 0.0, found)
    if not coherence:
        return FrameTwist(math.nan, 0.0, contrast, "the fibres leave the view within a few pixels")
    twist = slope / (2 * math.pi * radius)
    turns = axis.length * abs(twist)
    reason = ""
    if coherence < MIN_COHERENCE:
        reason = f"the correlation along the fibres is {coherence:.2f}: at least {MIN_COHERENCE} is needed"
    elif contrast < MIN_CONTRAST:
        reason = f"no one slope stands out (contrast {contrast:.2f}): at least {MIN_CONTRAST} is needed"
    elif turns < MIN_TURNS:
        reason = f"{turns:.2f} turns are in view: at least {MIN_TURNS} are needed"
    return FrameTwist(math.nan if reason else twist, coherence, contrast, reason)


def strand_slope(image: Image | Pixels, axis: YarnAxis) -> float:
    """Return the twist of lines on the cylinder as steep as what stands out on the face [1/px]; 0 where nothing does.

    Of plied yarn, whose strands and the grooves between them are inclined as fibres are. They are no lines on the
    cylinder (`outline.py` says by how much), but of the same hand.
    """
    # bulges of its outline are its strands, not a yarn that is thick here and thin there
    _, slope, contrast, _ = _strongest(image, axis._replace(form=np.empty(0)))
    return slope / (math.pi * axis.diameter) if contrast >= MIN_HAND else 0.0


def _strongest(image: Image | Pixels, axis: YarnAxis) -> tuple[Image, float, float, float]:
    """Return the unrolled surface and the slope tan β that stands out most there, its contrast and its coherence."""
    # fibres are longer than wide: half as many places along the axis will do
    texture, step = halved(image, axis), 2 / step_across(axis.angle)
    farthest = GRID * min(round(FARTHEST * axis.diameter / step / GRID), texture.shape[1] // (2 * GRID))
    lags = _lags(max(farthest, NEAREST + 1))
    if lags[-1] >= texture.shape[1]:
        return texture, 0.0, 0.0, 0.0
    spectra = _spectra(texture, lags)
    harmonics = _harmonics(spectra.shape[1], int(lags[-1]))
    return texture, *_ridge(texture, spectra, *harmonics, lags, step)


@compiled
def unroll(image: Image | Pixels, axis: YarnAxis) -> Image:
    """Resample the face of the yarn on its unrolled surface.

    Returns
    -------
    Shape (rows, columns): rows are 1/R apart in γ, columns 1/`step_across` along the axis; each row without its mean
    and with unit variance, all without the quadratic trend along x that they have in common: light falls off along the
    yarn on all rows alike. Each row's own trend is mostly fibres; taken off, it would let the steeper ones stand out.
    """
    radius = axis.diameter / 2
    count = max(1, math.floor(math.asin(max(0.0, min(WIDEST, 1 - EDGE * axis.blur / radius))) * radius))
    gamma = np.arange(-count, count + 1) / radius
    bright = level(gamma, axis.light, axis.shade)
    # where a lamp's share is fitted below 0, as strands let it, the level may be so everywhere
    seen = bright >= min(DARKEST * bright.max(), bright.max())
    across = places_of(gamma[seen], radius, axis.blur, axis.light, axis.shade)
    count = max(1, math.floor(axis.length * step_across(axis.angle)))
    x, y = axis.centre
    texture = unrolled(image, x, y, axis.angle, axis.bend, axis.form, across, count)
    _flatten(texture)
    return texture


@inner
def _flatten(texture: Image) -> None:
    """Take from each row its mean, give it unit variance, and take from all the trend that they share, in place."""
    columns = texture.shape[1]
    shared = np.zeros(columns, np.float32)
    for i in range(texture.shape[0]):
        row = texture[i]
        row -= np.float32(total(row) / columns)
        spread = np.float32(math.sqrt(dot(row, row) / columns))
        if spread > 0:
            row /= spread
        for k in range(columns):
            shared[k] += row[k]
    place = ((np.arange(columns) - (columns - 1) / 2) / columns).astype(np.float32)
    bend = place * place - np.mean(place * place)
    trend = np.zeros(columns, np.float32)
    for one in (np.ones(columns, np.float32), place, bend):
        trend += one * np.float32(dot(shared, one) / max(dot(one, one), 1e-30) / texture.shape[0])
    for i in range(texture.shape[0]):
        row = texture[i]
        for k in range(columns):
            row[k] -= trend[k]


@compiled
def halved(image: Image | Pixels, axis: YarnAxis) -> Image:
    """Return the unrolled surface as the mean of each two columns; the last of an odd number is left out."""
    texture = unroll(image, axis)
    half = np.empty((texture.shape[0], texture.shape[1] // 2), np.float32)
    for i in range(half.shape[0]):
        row, means = texture[i], half[i]
        for k in range(means.size):
            means[k] = np.float32(0.5) * (row[2 * k] + row[2 * k + 1])
    return half


@lru_cache(maxsize=16)
def _lags(farthest: int) -> Indices:
    return np.unique(np.linspace(NEAREST, farthest, LAGS).astype(np.intp))


def _spectra(texture: Image, lags: Indices) -> Spectra:
    """Return the transforms of the rows along x, long enough for the lags, shape (rows, waves)."""
    places = texture.shape[1] + int(lags[-1])
    length = VECTOR * scipy.fft.next_fast_len(math.ceil(places / VECTOR), real=True)
    return scipy.fft.rfft(texture, length, axis=1)


@lru_cache(maxsize=16)
def _harmonics(waves: int, farthest: int) -> tuple[Image, Image]:
    """Return what transforms an even number of samples back at `_lags` alone: cosines and sines, (waves, lags)."""
    angle = math.pi / (waves - 1) * np.outer(np.arange(waves), _lags(farthest))
    # of each pair of conjugate wave numbers one is held, of 0 and the middle one there is no pair
    weight = np.full((waves, 1), 1 / (waves - 1))
    weight[[0, -1]] /= 2
    return (weight * np.cos(angle)).astype(np.float32), (weight * np.sin(angle)).astype(np.float32)


@compiled
def _correlation(texture: Image, spectra: Spectra, cosines: Image, sines: Image, lags: Indices) -> Array:
    """Return C at Δγ from −reach to reach rows and Δx in `lags` [columns], shape (2 reach + 1, lags).

    By transforms along x, where both texture and lags are long, and by sums over pairs of rows in γ, where they are
    short; of the transform back only the lags wanted are computed. What is even in Δx comes from the real part of
    Σ_r S_r* S_{r+d}, what is odd from the imaginary part.

    Parameters
    ----------
    texture : shape (rows, columns); `reach` is three quarters of its rows.
    spectra : S, see `_spectra`.
    cosines, sines : see `_harmonics`.
    lags : ascending.
    """
    rows, waves = spectra.shape
    reach = 3 * rows // 4
    re, im = spectra.real.copy(), spectra.imag.copy()
    even, odd = np.zeros((reach + 1, waves), np.float32), np.zeros((reach + 1, waves), np.float32)
    for d in range(reach + 1):
        into_even, into_odd = even[d], odd[d]
        for r in range(rows - d):
            a, b, c, e = re[r], im[r], re[r + d], im[r + d]
            for k in range(waves):
                into_even[k] += a[k] * c[k] + b[k] * e[k]
                into_odd[k] += a[k] * e[k] - b[k] * c[k]
    even, odd = even @ cosines, odd @ sines
    products = np.empty((2 * reach + 1, lags.size), np.float32)
    for d in range(reach + 1):
        for j in range(lags.size):
            # −Δγ at Δx is Δγ at −Δx, where the sines change sign
            products[reach + d, j] = even[d, j] - odd[d, j]
            products[reach - d, j] = even[d, j] + odd[d, j]
    return coefficients(products, texture, lags)


@compiled
def coefficients(products: Image, texture: Image, lags: Indices) -> Array:
    """Return Pearson's coefficients from the sums of products of all pairs in view, shape (2 reach + 1, lags).

    Parameters
    ----------
    products : shape (2 reach + 1, lags), as what is returned.
    texture, lags : see `_correlation`.
    """
    rows, columns = texture.shape
    reach, count = products.shape[0] // 2, lags.size
    # of the part of each row that the first, and that the second pixel of the pairs is in: sums, and squares of what
    # is off the mean, these summed over the rows before
    firsts, seconds = np.empty((rows, count)), np.empty((rows, count))
    first_squares, second_squares = np.zeros((rows + 1, count)), np.zeros((rows + 1, count))
    for i in range(rows):
        row, at = texture[i], 0
        first, square = float(total(row)), float(dot(row, row))
        second, second_square = first, square
        for k in range(count):
            for j in range(at, lags[k]):
                head, tail = row[j], row[columns - 1 - j]
                first, second = first - tail, second - head
                square, second_square = square - tail * tail, second_square - head * head
            at = lags[k]
            pairs = columns - at
            firsts[i, k], seconds[i, k] = first, second
            first_squares[i + 1, k] = first_squares[i, k] + square - first * first / pairs
            second_squares[i + 1, k] = second_squares[i, k] + second_square - second * second / pairs
    result = np.empty(products.shape)
    means = np.empty(count)
    for d in range(-reach, reach + 1):
        low, high = max(0, -d), min(rows, rows - d)
        means[:] = 0
        for i in range(low, high):
            one, other = firsts[i], seconds[i + d]
            for k in range(count):
                means[k] += one[k] * other[k]
        for k in range(count):
            one_square = first_squares[high, k] - first_squares[low, k]
            other_square = second_squares[high + d, k] - second_squares[low + d, k]
            excess = products[d + reach, k] - means[k] / (columns - lags[k])
            result[d + reach, k] = excess / math.sqrt(max(one_square * other_square, 1e-30))
    return result


@compiled
def _ridge(
    texture: Image, spectra: Spectra, cosines: Image, sines: Image, lags: Indices, step: float
) -> tuple[float, float, float]:
    """Return what `_search` does, for columns `step` px apart."""
    return _search(_correlation(texture, spectra, cosines, sines, lags), step * lags.astype(np.float64))


@inner
def _search(correlation: Array, lags: Array) -> tuple[float, float, float]:
    """Return the slope tan β with the largest Q, its contrast and its coherence, see `FrameTwist`.

    The slope is 0 where none has its maximum inside of the range searched, the coherence where fewer than three Δx
    keep the ridge in view.

    Parameters
    ----------
    correlation : see `_correlation`.
    lags : its Δx [px].
    """
    ridges, reach = _spline(correlation), correlation.shape[0] // 2
    scores = _stack(ridges, SIGNED_SLOPES, lags)
    best = np.argmax(scores)
    slope, elsewhere = SIGNED_SLOPES[best], 0.0
    if scores[best] <= 0 or abs(slope) <= SLOPES[0] or abs(slope) >= SLOPES[-1]:
        return 0.0, 0.0, 0.0
    for i in range(scores.size):
        ratio = SIGNED_SLOPES[i] / slope
        if ratio <= 0 or ratio > 2 or ratio < 0.5:
            elsewhere = max(elsewhere, scores[i])
    contrast, coherence = 1 - elsewhere / scores[best], 0.0
    for _ in range(2):
        # only lags whose ridge stays well inside the view, so that no slope near by gains by leaving it
        used = np.searchsorted(1.2 * abs(slope) * lags, reach - 1)
        if used < 3:
            return slope, contrast, 0.0
        fine = slope * np.linspace(0.88, 1.12, 49)
        fine_scores = _stack(ridges, fine, lags[:used])
        slope, coherence = _top(fine, fine_scores), fine_scores.max() / used
    return slope, contrast, coherence


@inner
def _spline(values: Array) -> Array:
    """Return the coefficients of the cubic spline through each column's values, mirrored at its ends.

    Unser, Aldroubi and Eden, IEEE Trans. Signal Process. 41 (1993) 834: one recursion down and one up.
    """
    rows, columns = values.shape
    pole = math.sqrt(3) - 2
    c = 6 * values
    for j in range(columns):
        total, power, far = c[0, j] + pole ** (rows - 1) * c[rows - 1, j], pole, pole ** (rows - 1)
        for i in range(1, rows - 1):
            total += power * (c[i, j] + far * c[rows - 1 - i, j])
            power *= pole
        c[0, j] = total / (1 - far * far)
        for i in range(1, rows):
            c[i, j] += pole * c[i - 1, j]
        c[rows - 1, j] = pole / (pole * pole - 1) * (pole * c[rows - 2, j] + c[rows - 1, j])
        for i in range(rows - 2, -1, -1):
            c[i, j] = pole * (c[i + 1, j] - c[i, j])
    return c


@inner
def _stack(ridges: Array, slopes: Array, lags: Array) -> Array:
    """Return Q for slopes tan β: the sum over Δx of C on the lines Δγ = tan β·Δx/R, by cubic splines in Δγ.

    Parameters
    ----------
    ridges : spline coefficients of C, shape (2 reach + 1, at least as many columns as lags); rows are 1/R apart.
    slopes : tan β, shape (m,).
    lags : Δx of the first columns [px].
    """
    rows = ridges.shape[0]
    sums = np.zeros(slopes.size)
    for j in range(lags.size):
        for i in range(slopes.size):
            place = rows // 2 + slopes[i] * lags[j]
            row = math.floor(place)
            if row < -2 or row > rows:
                continue
            t = place - row
            u = 1 - t
            # beyond the first and the last row the coefficients are taken for 0
            if row >= 0:
                sums[i] += (4 - 3 * t * t * (1 + u)) * ridges[row, j] if row < rows else 0.0
            if row >= 1:
                sums[i] += u * u * u * ridges[row - 1, j]
            if -1 <= row < rows - 1:
                sums[i] += (4 - 3 * u * u * (1 + t)) * ridges[row + 1, j]
            if row < rows - 2:
                sums[i] += t * t * t * ridges[row + 2, j]
    return sums / 6


PARABOLA = np.linalg.pinv(np.vander(np.arange(-5.0, 6.0), 3))
"""Coefficients of the least-squares parabola through eleven evenly spaced samples."""


@inner
def _top(x: Array, y: Array) -> float:
    """Return the place of the maximum of evenly spaced samples, refined by a parabola through eleven of them."""
    best = min(max(np.argmax(y), 5), x.size - 6)
    a, b = 0.0, 0.0
    for i in range(11):
        a += PARABOLA[0, i] * y[best - 5 + i]
        b += PARABOLA[1, i] * y[best - 5 + i]
    step = x[1] - x[0]
    return x[best] + step * min(max(-b / (2 * a), -5.0), 5.0) if a < 0 else x[best]
