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
the curvature of asin and the fall of Lambert's light shift the γ shown by +½ and −1 times σ²w/(R² − w²)^{3/2}: the sum
lies within ±½ of that, for which nothing is corrected and `MAX_BLUR` limits σ/R.

The estimate is credible where all of this holds: the yarn is at least `MIN_DIAMETER` across and in focus; the mean
correlation along the fibres is at least `MIN_COHERENCE`; no slope that is flatter or steeper by more than a factor of
two, or of the other hand, comes nearer to the maximum than `MIN_CONTRAST` of it; the maximum is inside the range
searched; `MIN_TURNS` are in view.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from pipeline.measure.axis import Image, YarnAxis
from pipeline.records import Array

Indices = NDArray[np.intp]

MIN_DIAMETER = 20.0
MAX_BLUR = 0.15
MIN_TURNS = 0.1
MIN_COHERENCE = 0.1
MIN_CONTRAST = 0.3
WIDEST = 0.8
"""Largest |w|/R used: further out the fibres lie too close to be told apart."""
SLOPES = np.geomspace(0.04, 2.0, 72)
"""tan β = πdT searched, both signs: β from 2° to 63°."""
EDGE = 2.5
"""Distance from the edge inside of which rows are not used, in standard deviations of the blur."""
NEAREST = 3
"""Smallest Δx [px]: interpolation reaches over 2 px."""
FARTHEST = 4.0
"""Largest Δx [diameters]."""
LAGS = 32
"""Number of Δx used."""


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


def surface_twist(axis: YarnAxis) -> FrameTwist:
    """Find the twist of the yarn in a straightened strip."""
    if axis.diameter < MIN_DIAMETER:
        found = f"the yarn is {axis.diameter:.1f} px across: at least {MIN_DIAMETER:.0f} px are needed"
        return FrameTwist(math.nan, 0.0, 0.0, found)
    radius = axis.diameter / 2
    if axis.blur > MAX_BLUR * radius:
        found = f"the edges are blurred over {axis.blur:.1f} px: at most {MAX_BLUR * radius:.1f} px at this diameter"
        return FrameTwist(math.nan, 0.0, 0.0, found)
    texture, gamma_step = unroll(axis)
    lags = np.unique(np.linspace(NEAREST, min(FARTHEST * axis.diameter, axis.strip.shape[1] / 2), LAGS).astype(np.intp))
    correlation = _correlation(texture, lags)
    if correlation is None:
        return FrameTwist(math.nan, 0.0, 0.0, "the yarn shows no texture")
    zero = correlation.shape[0] // 2
    spline = spline_filter(correlation, order=3)

    def stack(slopes: Array, used: Indices) -> Array:
        """Return Q for slopes tan β, over the lags in `used` (indices)."""
        place = zero + np.outer(slopes / radius, lags[used]) / gamma_step
        index = np.broadcast_to(used, place.shape)
        return map_coordinates(spline, [place, index], order=3, prefilter=False, cval=0.0).sum(axis=1)

    every = np.arange(lags.size)
    slopes = np.concatenate([-SLOPES[::-1], [0.0], SLOPES])
    scores = stack(slopes, every)
    best = int(np.argmax(scores))
    slope = slopes[best]
    if scores[best] <= 0 or abs(slope) in (0.0, SLOPES[0], SLOPES[-1]):
        return FrameTwist(math.nan, 0.0, 0.0, "no inclined fibres stand out")
    elsewhere = (slopes * slope <= 0) | (np.abs(slopes) > 2 * abs(slope)) | (np.abs(slopes) < abs(slope) / 2)
    contrast = 1 - max(0.0, float(scores[elsewhere].max(initial=0.0)) / float(scores[best]))

    coherence = 0.0
    for _ in range(2):
        # only lags whose ridge stays well inside the view, so that no slope near by gains by leaving it
        used = every[1.2 * abs(slope) / radius * lags / gamma_step < zero - 1]
        if used.size < 3:
            return FrameTwist(math.nan, 0.0, contrast, "the fibres leave the view within a few pixels")
        fine = slope * np.linspace(0.88, 1.12, 49)
        fine_scores = stack(fine, used)
        slope = _top(fine, fine_scores)
        coherence = float(fine_scores.max()) / used.size
    twist = slope / (2 * math.pi * radius)
    turns = axis.strip.shape[1] * abs(twist)
    reason = ""
    if coherence < MIN_COHERENCE:
        reason = f"the correlation along the fibres is {coherence:.2f}: at least {MIN_COHERENCE} is needed"
    elif contrast < MIN_CONTRAST:
        reason = f"no one slope stands out (contrast {contrast:.2f}): at least {MIN_CONTRAST} is needed"
    elif turns < MIN_TURNS:
        reason = f"{turns:.2f} turns are in view: at least {MIN_TURNS} are needed"
    return FrameTwist(math.nan if reason else twist, coherence, contrast, reason)


def unroll(axis: YarnAxis) -> tuple[Image, float]:
    """Resample a strip at even steps of γ, one pixel apart on the axis, and remove the light.

    Returns
    -------
    texture : shape (rows in γ, columns along), each row without its quadratic trend along x and with unit variance.
    step : γ between rows [rad].
    """
    radius = axis.diameter / 2
    count = math.floor(math.asin(min(WIDEST, 1 - EDGE * axis.blur / radius)) * radius)
    gamma = np.arange(-count, count + 1) / radius
    rows, columns = axis.strip.shape
    height = rows // 2 + axis.offset + radius * np.sin(gamma)
    along, across = np.meshgrid(np.arange(columns, dtype=np.float32), height.astype(np.float32))
    texture = cv2.remap(axis.strip, along, across, cv2.INTER_CUBIC).astype(np.float32)
    trend = np.linalg.qr(np.vander(np.linspace(-1, 1, columns), 3))[0].astype(np.float32)
    texture -= (texture @ trend) @ trend.T
    spread = texture.std(axis=1, keepdims=True)
    texture /= np.where(spread > 0, spread, 1)
    return texture, 1 / radius


def _correlation(texture: Image, lags: Indices) -> Array | None:
    """Return C at all Δγ with at least a quarter of the rows in common (middle row Δγ = 0) and Δx in `lags`."""
    rows, columns = texture.shape
    if not np.any(texture):
        return None
    padded = (scipy.fft.next_fast_len(2 * rows), scipy.fft.next_fast_len(columns + int(lags[-1]), real=True))
    power = np.abs(scipy.fft.rfft2(texture, s=padded)) ** 2
    full = scipy.fft.irfft2(power, s=padded)
    reach = 3 * rows // 4
    shift = np.arange(-reach, reach + 1)
    pairs = np.outer(rows - np.abs(shift), columns - lags)
    return full[shift[:, None], lags] / pairs


def _top(x: Array, y: Array) -> float:
    """Return the place of the maximum of evenly spaced samples, refined by a parabola through eleven of them."""
    best = int(np.clip(np.argmax(y), 5, x.size - 6))
    near = slice(best - 5, best + 6)
    step = x[1] - x[0]
    a, b, _ = np.polyfit((x[near] - x[best]) / step, y[near], 2)
    return float(x[best] + step * np.clip(-b / (2 * a), -5, 5)) if a < 0 else float(x[best])
