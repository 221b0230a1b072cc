"""Twist of a single yarn in one frame, from the slope of the fibres on its unrolled surface.

At distance w from the axis the surface stands at γ = asin(w/R); there a fibre is the straight line γ = 2πT·x + const.
The unrolled texture is correlated with itself: C(Δx, Δγ), each Δγ divided by the number of pairs it has in view. At a
fixed Δx the ridge of C lies at Δγ = 2πT·Δx whatever the texture's spectrum, and whatever the scatter of the fibres
about their mean direction, as long as it is even: both only change the ridge's height and width. (At a fixed wave
number or a fixed Δγ the same scatter would pull the slope.) The twist is the T with the largest sum

    Q(T) = Σ_Δx C(Δx, 2πT·Δx),   Δx from 3 px to 4 diameters.

Pixel noise is uncorrelated from pixel to pixel and enters C at Δx < 3 px only, so it moves nothing. The sign of the
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

import cv2
import numba
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import spline_filter1d

from pipeline.measure.axis import Image, YarnAxis
from pipeline.measure.lit import level, places_of
from pipeline.records import Array

Indices = NDArray[np.intp]

MIN_DIAMETER = 20.0
MAX_BLUR = 0.15
MAX_BLUR_PX = 2.6
"""Blur from which fibres mix, and a lens out of focus shows structure that is not there [px]."""
MIN_TURNS = 0.1
MIN_COHERENCE = 0.2
MIN_CONTRAST = 0.5
WIDEST = 0.8
"""Largest |w|/R used: further out the fibres lie too close to be told apart."""
SLOPES = np.geomspace(0.04, 2.0, 72)
"""tan β = πdT searched, both signs: β from 2° to 63°."""
SIGNED_SLOPES = np.concatenate([-SLOPES[::-1], [0.0], SLOPES])
DARKEST = 0.2
"""Least level of a row over the brightest one's."""
EDGE = 2.5
"""Distance from the edge inside of which rows are not used, in standard deviations of the blur."""
NEAREST = 3
"""Smallest Δx [px]: interpolation reaches over 2 px."""
FARTHEST = 4.0
"""Largest Δx [diameters]."""
LAGS = 32
"""Number of Δx used."""
GRID = 8
"""Step of the longest Δx and of the transforms' lengths [px]: frames of about one size share their tables."""


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


def surface_twist(image: Image, axis: YarnAxis) -> FrameTwist:
    """Find the twist of the yarn on an axis of a frame, shape (rows, columns)."""
    if axis.diameter < MIN_DIAMETER:
        found = f"the yarn is {axis.diameter:.1f} px across: at least {MIN_DIAMETER:.0f} px are needed"
        return FrameTwist(math.nan, 0.0, 0.0, found)
    radius = axis.diameter / 2
    limit = min(MAX_BLUR * radius, MAX_BLUR_PX)
    if axis.blur > limit:
        found = f"the edges are blurred over {axis.blur:.1f} px: at most {limit:.1f} px at this diameter"
        return FrameTwist(math.nan, 0.0, 0.0, found)
    texture = unroll(image, axis)
    if not np.any(texture):
        return FrameTwist(math.nan, 0.0, 0.0, "the yarn shows no texture")
    farthest = min(GRID * round(FARTHEST * axis.diameter / GRID), GRID * (axis.length // (2 * GRID)))
    lags = _lags(max(farthest, NEAREST + 1))
    reach = 3 * texture.shape[0] // 4
    ridges = spline_filter1d(_correlation(texture, lags, reach), axis=0)

    slopes = SIGNED_SLOPES
    scores = _stack(ridges, slopes, lags)
    best = int(np.argmax(scores))
    slope = float(slopes[best])
    if scores[best] <= 0 or abs(slope) in (0.0, SLOPES[0], SLOPES[-1]):
        return FrameTwist(math.nan, 0.0, 0.0, "no inclined fibres stand out")
    elsewhere = (slopes * slope <= 0) | (np.abs(slopes) > 2 * abs(slope)) | (np.abs(slopes) < abs(slope) / 2)
    contrast = 1 - max(0.0, float(scores[elsewhere].max(initial=0.0)) / float(scores[best]))

    coherence = 0.0
    for _ in range(2):
        # only lags whose ridge stays well inside the view, so that no slope near by gains by leaving it
        used = int(np.searchsorted(1.2 * abs(slope) * lags, reach - 1))
        if used < 3:
            return FrameTwist(math.nan, 0.0, contrast, "the fibres leave the view within a few pixels")
        fine = slope * np.linspace(0.88, 1.12, 49)
        fine_scores = _stack(ridges, fine, lags[:used])
        slope = _top(fine, fine_scores)
        coherence = float(fine_scores.max()) / used
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


def unroll(image: Image, axis: YarnAxis) -> Image:
    """Resample the face of the yarn on its unrolled surface by bicubic interpolation.

    Returns
    -------
    Shape (rows, length): rows are 1/R apart in γ, columns a pixel along the axis; each row without its quadratic
    trend along x and with unit variance.
    """
    radius = axis.diameter / 2
    count = max(1, math.floor(math.asin(max(0.0, min(WIDEST, 1 - EDGE * axis.blur / radius))) * radius))
    gamma = np.arange(-count, count + 1) / radius
    bright = level(gamma, axis.light, axis.shade)
    gamma = gamma[bright >= DARKEST * bright.max()]
    across = places_of(gamma, radius, axis.blur, axis.light, axis.shade)
    along = np.arange(axis.length) - (axis.length - 1) / 2
    c, s = math.cos(axis.angle), math.sin(axis.angle)
    x = np.add.outer((axis.centre[0] + s * across).astype(np.float32), (c * along).astype(np.float32))
    y = np.add.outer((axis.centre[1] + c * across).astype(np.float32), (-s * along).astype(np.float32))
    texture = cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    trend = _trend(axis.length)
    texture -= (texture @ trend) @ trend.T
    spread = np.sqrt(np.einsum("ij,ij->i", texture, texture) / axis.length)[:, None]
    texture /= np.where(spread > 0, spread, 1)
    return texture  # pyright: ignore[reportReturnType]


@lru_cache(maxsize=64)
def _trend(columns: int) -> Image:
    """Return an orthonormal basis of quadratics, shape (columns, 3)."""
    return np.linalg.qr(np.vander(np.linspace(-1, 1, columns), 3))[0].astype(np.float32)


@lru_cache(maxsize=16)
def _lags(farthest: int) -> Indices:
    return np.unique(np.linspace(NEAREST, farthest, LAGS).astype(np.intp))


@lru_cache(maxsize=16)
def _harmonics(length: int, farthest: int) -> Image:
    """Return the real inverse transform of `length` samples at the lags alone: cosines, then sines."""
    angle = 2 * math.pi / length * np.outer(np.arange(length // 2 + 1), _lags(farthest))
    # of each pair of conjugate wave numbers one is held, of 0 and the middle one there is no pair
    single = (np.arange(length // 2 + 1) % (length / 2) == 0)[:, None]
    return (np.hstack([np.cos(angle), np.sin(angle)]) * np.where(single, 1, 2) / length).astype(np.float32)


def _correlation(texture: Image, lags: Indices, reach: int) -> Array:
    """Return C at Δγ from −reach to reach rows and Δx in `lags`, shape (2 reach + 1, lags)."""
    rows, columns = texture.shape
    farthest = int(lags[-1])
    length = scipy.fft.next_fast_len(GRID * math.ceil((columns + farthest) / GRID), real=True)
    height = scipy.fft.next_fast_len(rows + reach)
    spectrum = scipy.fft.fft(scipy.fft.rfft(texture, length, axis=1), height, axis=0, overwrite_x=True)
    power = spectrum.real**2 + spectrum.imag**2
    halves = power @ _harmonics(length, farthest)
    full = scipy.fft.ifft(halves[:, : lags.size] + 1j * halves[:, lags.size :], axis=0).real
    shift = np.arange(-reach, reach + 1)
    pairs = np.outer(rows - np.abs(shift), columns - lags)
    return full[shift] / pairs


@numba.njit(cache=True, nogil=True)
def _stack(ridges: Array, slopes: Array, lags: Indices) -> Array:
    """Return Q for slopes tan β: the sum over Δx of C on the lines Δγ = tan β·Δx/R, by cubic splines in Δγ.

    Parameters
    ----------
    ridges : spline coefficients of C, shape (2 reach + 1, at least as many columns as lags); rows are 1/R apart.
    slopes : tan β, shape (m,).
    lags : Δx of the first columns [px].
    """
    rows = ridges.shape[0]
    sums = np.zeros(slopes.size)
    taps = np.empty(4)
    for i in range(slopes.size):
        for j in range(lags.size):
            place = rows // 2 + slopes[i] * lags[j]
            first = math.floor(place)
            t = place - first
            taps[0] = (1 - t) ** 3
            taps[1] = 4 - 6 * t**2 + 3 * t**3
            taps[2] = 4 - 6 * (1 - t) ** 2 + 3 * (1 - t) ** 3
            taps[3] = t**3
            for k in range(4):
                row = first - 1 + k
                if 0 <= row < rows:
                    sums[i] += taps[k] * ridges[row, j] / 6
    return sums


PARABOLA = np.linalg.pinv(np.vander(np.arange(-5.0, 6.0), 3))
"""Coefficients of the least-squares parabola through eleven evenly spaced samples."""


def _top(x: Array, y: Array) -> float:
    """Return the place of the maximum of evenly spaced samples, refined by a parabola through eleven of them."""
    best = int(np.clip(np.argmax(y), 5, x.size - 6))
    near = slice(best - 5, best + 6)
    step = x[1] - x[0]
    a, b, _ = PARABOLA @ y[near]
    return float(x[best] + step * np.clip(-b / (2 * a), -5, 5)) if a < 0 else float(x[best])
