"""Rotation of the yarn's helix from one frame to the next, by its unrolled surface.

Surface that stood at (x, γ) stands at (x + s, γ + ρ) in the next frame: s is the yarn's travel, ρ its rotation. The two
unrolled surfaces are correlated, C(Δx, Δγ); fibres are long and thin, so C is a ridge along Δγ = 2πT·Δx + δ with

    δ = ρ − 2πT·s,

the turn of the helix at a fixed place. δ is sharp. Where on the ridge s lies is not: fibres are longer than the yarn
travels between frames, and surface that turns towards the edge is seen less well, which moves the ridge's top by more
than that. So δ is measured, and the rotation n of the yarn needs its speed v: n = δ/(2πΔt) + T·v. Yarn that screws
through its own helix, as steadily false-twisted yarn does, has δ = 0.

Limits: the surface that faces the camera is 2·asin(0.8) = 106° wide, and at least `MIN_OVERLAP` of it must show in both
frames: |δ| up to about 70°, 230 turns a second at 1200 frames a second. A further whole turn between two frames looks
the same (n plies: a further 1/n turn): what is given is the least that it can be.

Sign: δ > 0 is a right-handed rotation about the direction of the axis' angle.
"""

import math

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates, uniform_filter1d

from pipeline.measure.axis import YarnAxis
from pipeline.measure.lines import Image, Pixels, step_across
from pipeline.measure.twist import unroll
from pipeline.records import Array

MIN_OVERLAP = 0.35
MIN_CORRELATION = 0.35
MIN_CONTRAST = 0.3
FARTHEST = 3.0
"""Largest travel along the ridge that is looked at [diameters]: about the length of fibres on the surface."""
APART = 0.35
"""Distance from the ridge from which on other maxima are others [rad]."""


def helix_turn(first: Image | Pixels, second: Image | Pixels, axes: tuple[YarnAxis, YarnAxis], twist: float) -> float:
    """Return δ between two frames [rad]; NaN where it is not resolved.

    Parameters
    ----------
    first, second : the frames, shape (rows, columns).
    axes : where the yarn is in each.
    twist : signed [1/px]; the ridge's slope.
    """
    if math.cos(axes[0].angle - axes[1].angle) < 0:  # the same axis, named by its other direction
        axes = axes[0], axes[1]._replace(angle=axes[1].angle - math.pi, light=-axes[1].light)
    one, other = unroll(first, axes[0]), unroll(second, axes[1])
    rows = min(one.shape[0], other.shape[0])
    one, other = _middle_rows(one, rows), _middle_rows(other, rows)
    radius = (axes[0].diameter + axes[1].diameter) / 4
    # the columns of both: they differ by as much as the axis turned, at most by a few pixels at the ends
    step = 2 / (step_across(axes[0].angle) + step_across(axes[1].angle))
    reach = min(round(FARTHEST * 2 * radius / step), min(one.shape[1], other.shape[1]) // 2)
    deep = math.floor((1 - MIN_OVERLAP) * rows)
    if deep < 2:
        return math.nan
    correlation = _correlation(one, other, reach, deep)

    # C on lines along the ridge: rows are δ, columns Δx
    lags, turns = np.arange(-reach, reach + 1), np.arange(-deep, deep + 1)
    place = turns[:, None] + 2 * math.pi * twist * radius * step * lags + deep
    across = np.broadcast_to(lags + reach, place.shape)
    ridges = map_coordinates(correlation, [place, across], order=1, cval=0.0)
    score = uniform_filter1d(ridges, 2 * round(radius / step) + 1, axis=1, mode="constant").max(axis=1)
    best = int(np.argmax(score))
    elsewhere = score[np.abs(turns - turns[best]) > APART * radius].max(initial=0.0)
    if score[best] < MIN_CORRELATION or elsewhere > (1 - MIN_CONTRAST) * score[best]:
        return math.nan
    if not 1 <= best < turns.size - 1:
        return math.nan
    along = math.cos(axes[0].angle), -math.sin(axes[0].angle)
    # x is counted from the middle of the yarn in view, which moves
    moved = sum((b - a) * e for a, b, e in zip(axes[0].centre, axes[1].centre, along, strict=True))
    return float(turns[best] + _vertex(score[best - 1 : best + 2])) / radius - 2 * math.pi * twist * moved


def _middle_rows(surface: Image, rows: int) -> Image:
    first = (surface.shape[0] - rows) // 2
    return surface[first : first + rows]


def _correlation(one: Image, other: Image, reach: int, deep: int) -> Array:
    """Return C at Δγ from −deep to deep rows and Δx from −reach to reach, per pair in view."""
    rows, columns = one.shape[0], max(one.shape[1], other.shape[1])
    shape = scipy.fft.next_fast_len(rows + deep), scipy.fft.next_fast_len(columns + reach, real=True)
    first, second = _centred(one, columns), _centred(other, columns)
    product = np.conj(scipy.fft.rfft2(first, shape)) * scipy.fft.rfft2(second, shape)
    full = scipy.fft.irfft2(product, shape)
    down, right = np.arange(-deep, deep + 1), np.arange(-reach, reach + 1)
    pairs = np.outer(rows - np.abs(down), min(one.shape[1], other.shape[1]) - np.abs(right))
    return full[np.ix_(down, right)] / pairs


def _centred(surface: Image, columns: int) -> Image:
    before = (columns - surface.shape[1]) // 2
    return np.pad(surface, ((0, 0), (before, columns - surface.shape[1] - before)))


def _vertex(three: Array) -> float:
    """Return where the parabola through three values has its top, from the middle one."""
    bend = three[0] - 2 * three[1] + three[2]
    return float(np.clip(0.5 * (three[0] - three[2]) / bend, -0.5, 0.5)) if bend < 0 else 0.0
