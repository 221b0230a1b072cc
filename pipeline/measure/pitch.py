"""Ply twist of a plied yarn in one frame, from the period of its strands along the yarn.

n plies of twist T bring a strand to the edge, and to the front, every 1/(nT) of length. The outline (`outline.py`) says
what that period is, about: levels also have the period of what differs from strand to strand, and of fibres. Every row
of the straightened yarn is periodic in x with the frequency f = nT, whatever the light, the diameter and the strands'
own twist, and is fitted by

    y(x, w) ≈ trend(x) + Σ_k a_k(w) cos 2πkfx + b_k(w) sin 2πkfx,   k = 1 … `HARMONICS`;

f is where the rows' explained squares are most: least squares for a periodic signal of any shape (Quinn and Thomson,
Biometrika 78, 1991), free of the leakage that the spectrum of a few periods has.

The hand is that of what is inclined on the face (`twist.strand_slope`).

The estimate is credible where the outline is that of so many strands, the period explains at least `MIN_EXPLAINED` of
what varies along the yarn, `MIN_TURNS` are in view, and the face tells a hand.
"""

import math

import numpy as np
from scipy.optimize import minimize_scalar

from pipeline.measure.axis import YarnAxis, straighten
from pipeline.measure.coloured import coloured_u
from pipeline.measure.lines import Image, Pixels
from pipeline.measure.outline import find_scallops, why_not_of
from pipeline.measure.twist import FrameTwist, strand_slope
from pipeline.records import Array

HARMONICS = 3
SLOPES = (0.05, 1.6)
"""Range of πdT of the strands."""
MIN_EXPLAINED = 0.3
MIN_TURNS = 1.0
MIN_DIAMETER = 8.0
SEEN = 0.6
"""Diameters from the axis within which a row shows the yarn."""


def ply_twist(image: Image | Pixels, axis: YarnAxis, plies: int) -> FrameTwist:
    """Find the ply twist of the yarn on an axis of a frame, shape (rows, columns), that has this many strands."""
    if axis.diameter < MIN_DIAMETER:
        return _none(f"the yarn is {axis.diameter:.1f} px across: at least {MIN_DIAMETER:.0f} px are needed")
    found = find_scallops(image, axis)
    slope = strand_slope(image, axis)
    why = why_not_of(found, plies, slope)
    if found is None or why:
        return _none(why)
    if found.periods < MIN_TURNS * plies:
        return _none(f"{found.periods / plies:.2f} turns of the plies are in view: at least {MIN_TURNS:g} are needed")
    length = axis.length
    seen = straighten(image, axis.centre, axis.angle, math.floor(SEEN * axis.diameter), length).astype(float)
    x = np.arange(length, dtype=np.float64) - (length - 1) / 2
    trend = np.linalg.qr(np.vander(x / length, 3))[0]
    rows = seen - (seen @ trend) @ trend.T
    total = max(float(np.sum(rows**2)), 1e-12)

    def waves(frequency: float) -> Array:
        angle = 2 * math.pi * frequency * np.outer(x, np.arange(1, HARMONICS + 1))
        basis = np.hstack([np.cos(angle), np.sin(angle)])
        return basis - trend @ (trend.T @ basis)

    def explained(frequency: float) -> float:
        return float(np.sum((rows @ np.linalg.qr(waves(frequency))[0]) ** 2)) / total

    reach = 0.5 / length
    best = minimize_scalar(
        lambda f: -explained(f),
        bounds=(found.frequency - reach, found.frequency + reach),
        method="bounded",
        options={"xatol": 1e-4 / length},
    )
    frequency, share = float(best.x), -float(best.fun)
    reason = ""
    if share < MIN_EXPLAINED:
        reason = f"a period of the plies explains {share:.2f} of what is seen: at least {MIN_EXPLAINED} is needed"
    elif not slope:
        reason = "nothing on the face of the yarn tells its hand"
    twist = math.nan if reason else math.copysign(frequency / plies, slope)
    return FrameTwist(twist, share, found.share, reason, _u_frequency(rows, x, trend, waves(frequency)) / plies)


def _u_frequency(rows: Array, x: Array, trend: Array, waves: Array) -> float:
    """Return the standard uncertainty of the frequency by what the periodic signal leaves of the rows [1/px].

    Parameters
    ----------
    rows : without their trend, shape (rows, length).
    x : places along the yarn, shape (length,) [px].
    trend : orthonormal, shape (length, 3).
    waves : cosines and sines of the harmonics without their trend, shape (length, 2 `HARMONICS`).
    """
    shares = np.linalg.lstsq(waves, rows.T, rcond=None)[0]
    rest = rows - (waves @ shares).T
    order = 2 * math.pi * np.arange(1, HARMONICS + 1)
    cosines, sines = waves[:, :HARMONICS] * order, waves[:, HARMONICS:] * order
    change = x[:, None] * (cosines @ shares[HARMONICS:] - sines @ shares[:HARMONICS])
    fitted = np.linalg.qr(np.hstack([trend, waves]))[0]
    change = (change - fitted @ (fitted.T @ change)).T
    influence = change / max(float(np.sum(change**2)), 1e-300)
    spread = np.sqrt(np.mean(rest**2, axis=1, keepdims=True)) + 1e-300
    return coloured_u(influence * spread, rest / spread)


def _none(reason: str) -> FrameTwist:
    return FrameTwist(math.nan, 0.0, 0.0, reason)
