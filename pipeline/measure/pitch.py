"""Ply twist of a plied yarn in one frame, from the period of its strands along the yarn.

n plies of twist T bring a strand to the front every 1/(nT) of length, so every row of the straightened yarn is periodic
in x with the frequency f = nT, whatever the light, the diameter and the strands' own twist. Each row is fitted by

    y(x, w) ≈ trend(x) + Σ_k a_k(w) cos 2πkfx + b_k(w) sin 2πkfx,   k = 1 … `HARMONICS`,

and f is where the rows' explained squares are most: least squares for a periodic signal of any shape (Quinn and
Thomson, Biometrika 78, 1991), free of the leakage that the spectrum of a few periods has. A spectrum only says where to
look; of frequencies that explain about as much the highest is taken, because each has subharmonics that do.

The hand is the way in which the first harmonic's phase drifts across the face: crests run along γ = 2πT·x + const.

The estimate is credible where the period explains at least `MIN_EXPLAINED` of what varies along the yarn, no other
frequency comes nearer to it than `MIN_CONTRAST`, `MIN_TURNS` are in view, and the phase drifts about as much as that of
crests on a cylinder does.
"""

import math

import numpy as np
from scipy.optimize import minimize_scalar

from pipeline.measure.axis import YarnAxis, straighten
from pipeline.measure.lines import Image, Pixels
from pipeline.measure.twist import FrameTwist
from pipeline.records import Array

HARMONICS = 3
SLOPES = (0.05, 1.6)
"""Range of πdT searched."""
MIN_EXPLAINED = 0.45
MIN_CONTRAST = 0.4
MIN_TURNS = 1.0
MIN_DIAMETER = 8.0
SHORTEST = 4.0
"""Shortest period looked for [px]."""
AS_MUCH = 0.85
"""Share of the most explained squares from which a higher frequency is taken."""
DRIFT = (0.2, 3.0)
"""Range of the phase's drift, over that of crests on the cylinder."""


def ply_twist(image: Image | Pixels, axis: YarnAxis, plies: int) -> FrameTwist:
    """Find the ply twist of the yarn on an axis of a frame, shape (rows, columns), that has this many strands."""
    if axis.diameter < MIN_DIAMETER:
        return _none(f"the yarn is {axis.diameter:.1f} px across: at least {MIN_DIAMETER:.0f} px are needed")
    length = axis.length
    half = math.floor(0.4 * axis.diameter)
    strip = straighten(image, axis.centre, axis.angle, half, length).astype(float)
    x = np.arange(length, dtype=np.float64) - (length - 1) / 2
    trend = np.linalg.qr(np.vander(x / length, 3))[0]
    rows = strip - (strip @ trend) @ trend.T
    total = float(np.sum(rows**2))
    per_slope = plies / (math.pi * axis.diameter)
    low = max(SLOPES[0] * per_slope, MIN_TURNS * plies / length)
    high = min(SLOPES[1] * per_slope, 1 / SHORTEST)
    if total <= 0:
        return _none("the yarn shows no texture")
    if high <= low:
        return _none(f"{length} px of the yarn are in view: at least {MIN_TURNS:g} turns of the plies are needed")

    size = 8 * 2 ** math.ceil(math.log2(length))
    power = np.sum(np.abs(np.fft.rfft(rows, size, axis=1)) ** 2, axis=0)
    tried = np.arange(math.ceil(low * size), math.floor(high * size) + 1)
    score = np.zeros(tried.size)
    for k in range(1, HARMONICS + 1):
        score += np.where(k * tried < power.size, power[np.minimum(k * tried, power.size - 1)], 0)
    tops = np.flatnonzero((score[1:-1] >= score[:-2]) & (score[1:-1] >= score[2:])) + 1
    tops = tops[score[tops] >= AS_MUCH * score.max()]
    if not tops.size:
        return _none("no period of the plies stands out")
    coarse = float(tried[tops[-1]]) / size

    def explained(frequency: float) -> float:
        angle = 2 * math.pi * frequency * np.outer(x, np.arange(1, HARMONICS + 1))
        basis = np.hstack([np.cos(angle), np.sin(angle)])
        basis = np.linalg.qr(basis - trend @ (trend.T @ basis))[0]
        return float(np.sum((rows @ basis) ** 2)) / total

    reach = 0.5 / length
    found = minimize_scalar(
        lambda f: -explained(f),
        bounds=(coarse - reach, coarse + reach),
        method="bounded",
        options={"xatol": 1e-4 / length},
    )
    frequency, share = float(found.x), -float(found.fun)
    related = np.min(np.abs(np.outer(tried / size, (1, 2, 3, 0.5, 1 / 3)) - frequency), axis=1) < 1.5 / length
    contrast = 1 - float(score[~related].max(initial=0.0)) / float(score[tops[-1]])
    drift = _drift(rows, x, frequency, axis.diameter / 2) / plies
    reason = ""
    if share < MIN_EXPLAINED:
        reason = f"a period of the plies explains {share:.2f} of what is seen: at least {MIN_EXPLAINED} is needed"
    elif contrast < MIN_CONTRAST:
        reason = f"no one period stands out (contrast {contrast:.2f}): at least {MIN_CONTRAST} is needed"
    elif not DRIFT[0] < abs(drift) < DRIFT[1]:
        reason = "what is periodic along the yarn does not run around it as plies do"
    twist = math.copysign(frequency / plies, drift)
    return FrameTwist(math.nan if reason else twist, share, contrast, reason)


def _drift(rows: Array, x: Array, frequency: float, radius: float) -> float:
    """Return by how much the phase of a frequency changes with γ; positive for Z."""
    wave = rows @ np.exp(-2j * math.pi * frequency * x)
    lag = max(1, round(radius / 4))
    gamma = np.arcsin(np.clip((np.arange(len(rows)) - len(rows) // 2) / radius, -1, 1))
    product = wave[lag:] * np.conj(wave[:-lag])
    weight = np.abs(product)
    apart = float(weight @ (gamma[lag:] - gamma[:-lag])) / max(float(weight.sum()), 1e-300)
    return -float(np.angle(product.sum())) / apart


def _none(reason: str) -> FrameTwist:
    return FrameTwist(math.nan, 0.0, 0.0, reason)
