"""How far the fibres that a frame shows scatter about the helix: what the twist of a few fibres is uncertain by.

A frame shows a dozen fibres, frame after frame the same ones, and each leans a little: the mean of many frames can be
wrong by as much as that of one. How much is seen within the frame. With u = γ − 2πT·x a fibre of the helix keeps its u,
so the sum Q over pairs of pixels whose maximum is the twist (`twist.py`), or the turn (`recurrence.py`), is one over
blocks of u, each with its own fibres. At the maximum the blocks' slopes of Q by the logarithm of T add up to 0; were
other fibres in view they would not, and the maximum would lie elsewhere. With slopes g and curvatures h of the blocks

    σ² = Σ g² / (Σ h)² · b/(b − 1)

is the variance of ln T over yarn with other fibres (Huber's sandwich, Proc. 5th Berkeley Symp. 1967, 221).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled
from pipeline.measure.axis import YarnAxis
from pipeline.measure.lines import Image, Pixels, step_across
from pipeline.measure.twist import FARTHEST, NEAREST, halved
from pipeline.records import Array

BLOCK = 0.5
"""Width of a block of u, some fibres [rad]."""
FACE = 0.75
"""Share of the face that a pair of rows lies apart, at most."""
FEWEST = 4
"""Fewest blocks that say anything."""


@dataclass(frozen=True, slots=True)
class Face:
    """The yarn's unrolled surface in one frame."""

    texture: Image
    """Shape (rows, columns), see `unroll`; of each two columns the mean."""
    step: float
    """Between columns [px]."""
    radius: float
    """Rows are 1/`radius` apart in γ [px]."""
    per_pixel: float
    """The twist that the slope of the fibres in this frame tells [1/px]."""

    @property
    def rise(self) -> float:
        """Rows that a fibre rises by from one column to the next."""
        return 2 * math.pi * self.per_pixel * self.radius * self.step


def face(image: Image | Pixels, axis: YarnAxis, per_pixel: float) -> Face:
    """Unroll the yarn on an axis of a frame, shape (rows, columns)."""
    return Face(halved(image, axis), 2 / step_across(axis.angle), axis.diameter / 2, per_pixel)


def slope_scatter(faces: Sequence[Face]) -> float:
    """Return σ of one frame's ln T by the slope of its fibres; NaN where too few fibres tell.

    Parameters
    ----------
    faces : of some frames of a clip.
    """
    variances: list[float] = []
    for one in faces:
        rows, columns = one.texture.shape
        rise = one.rise
        farthest = min(FARTHEST * 2 * one.radius / one.step, columns / 2, FACE * rows / abs(rise))
        apart = np.arange(math.ceil(NEAREST * abs(rise)), math.floor(farthest * abs(rise)) + 1)
        apart = np.copysign(apart[apart > 0], rise).astype(np.intp)
        if apart.size:
            g, h = _scores(one.texture, apart, apart / rise, rise, BLOCK * one.radius)
            variances.append(_variance(g, h))
    return _root(variances)


def turn_scatter(faces: Sequence[Face], turn: float, reach: Sequence[int]) -> float:
    """Return σ of one frame's ln T by the length of a full turn [px]; NaN where too few fibres tell.

    Parameters
    ----------
    faces : see `slope_scatter`.
    reach : rows that pairs lie apart, at most, for each face.
    """
    variances: list[float] = []
    for one, most in zip(faces, reach, strict=True):
        rise = one.rise
        apart = np.arange(-most, most + 1)
        g, h = _scores(one.texture, apart, turn / one.step + apart / rise, rise, BLOCK * one.radius)
        variances.append(_variance(g, h))
    return _root(variances)


def _root(variances: Sequence[float]) -> float:
    known = [value for value in variances if math.isfinite(value)]
    return math.sqrt(float(np.mean(known))) if known else math.nan


def _variance(slopes: Array, curvatures: Array) -> float:
    seen = curvatures != 0
    total, count = -float(curvatures.sum()), int(np.count_nonzero(seen))
    if total <= 0 or count < FEWEST:
        return math.nan
    # at the frame's own maximum
    left = slopes + curvatures * float(slopes.sum()) / total
    return float(left @ left) / total**2 * count / (count - 1)


@compiled
def _scores(texture: Image, apart: NDArray[np.intp], lags: Array, rise: float, width: float) -> tuple[Array, Array]:
    """Return the blocks' slopes and curvatures of Q by ln Δx, shape (blocks,).

    Parameters
    ----------
    texture : see `Face`.
    apart, lags : Δγ [rows] and Δx [columns] of the pairs, shape (n,).
    rise : rows by which a fibre rises from one column to the next.
    width : of a block [rows].
    """
    rows, columns = texture.shape
    low = min(0.0, -rise * columns)
    blocks = int((rows + abs(rise) * columns) / width) + 2
    slopes, curvatures = np.zeros(blocks), np.zeros(blocks)
    products = np.empty((3, blocks))
    for n in range(apart.size):
        d, lag = apart[n], round(lags[n])
        count = columns - lag - 1
        if lag < 1 or count < 1:
            continue
        off = lags[n] - lag
        products[:] = 0
        for i in range(max(0, -d), min(rows, rows - d)):
            first = texture[i]
            for k in range(3):
                second, into = texture[i + d, lag + k - 1 :], products[k]
                for x in range(count):
                    into[int((i - rise * x - low) / width)] += first[x] * second[x]
        for b in range(blocks):
            bend = products[2, b] - 2 * products[1, b] + products[0, b]
            slopes[b] += lags[n] * ((products[2, b] - products[0, b]) / 2 + off * bend)
            curvatures[b] += lags[n] ** 2 * bend
    return slopes, curvatures
