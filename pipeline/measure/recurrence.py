"""Twist of a single yarn over a clip, from the fibres that come back to the front after a full turn.

The slope of the fibres on the unrolled surface (`twist.py`) is 2πTρ, and only where they run on the outline itself ρ is
half of the yarn's diameter. Fibres have a thickness and wander: they run below the outline, and the slope tells a twist
that is as much too small. Fibres are many turns long, though, and what is at the front at x is there again at x + 1/T,
whatever ρ. The unrolled surface is therefore correlated with itself about one turn on,

    S(P) = mean over Δγ of C(P + Δγ/(2πT'), Δγ),   P up to `FARTHEST` times 1/T', or as far as the yarn is in view,

along the slope T' that was found, and averaged over frames. Its maximum is at P = 1/T, from `NEAREST` on. Where fibres
end or dive before that there is none, but other fibres that are alike by chance. They are so at any P, also at one too
short for a turn: a maximum only counts where it is `MIN_SCORE` high and stands out by `MIN_CONTRAST` of all P beyond
its flanks, which are as wide as fibres are.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft

from pipeline.measure.scatter import Face, turn_scatter
from pipeline.measure.twist import coefficients
from pipeline.records import Array

STEP = 0.003
"""Relative step of P."""
NEAREST, FARTHEST = 0.74, 1.08
"""Range of a full turn over that of the slope: fibres run at 0.74 of the outline's radius or further out."""
SHORTEST = 0.2
"""From here on P is too far for the same fibre at the same place, and shows what is alike by chance."""
REACH = 0.8
"""Share of the face that Δγ reaches over, at most."""
LONGEST = 0.15
"""Longest way along the yarn for that, in P."""
OVERLAP = 1.0
"""Least length of yarn that is seen twice [diameters]."""
FLANK = 0.1
"""Relative distance from the maximum within which it must fall to half: fibres are narrower than that."""
MIN_FRAMES = 3
MIN_SCORE = 0.2
MIN_CONTRAST = 0.5
"""With it no return is found in the 60 single yarns of benchmarks/measure_coverage.py, whose fibres end after half a
turn."""


@dataclass(frozen=True, slots=True)
class Recurrence:
    """S of one frame at P = exp(`STEP`·k) px."""

    face: Face
    first: int
    """k of the first P."""
    scores: Array
    """Weighed by the root of the length that is seen twice, over that in view: chance alone is then alike at all P."""
    reach: int
    """Largest Δγ [rows]."""


@dataclass(frozen=True, slots=True)
class FullTurn:
    """Where the fibres of a clip return."""

    length: float
    """[px]"""
    relative_u: float
    """By how far the few fibres in view scatter about it."""


def recurrence(face: Face) -> Recurrence | None:
    """Return S about one turn on, or None where too little of the yarn is in view.

    Parameters
    ----------
    face : the yarn's surface in a frame.
    """
    texture, turn, rise = face.texture, 1 / abs(face.per_pixel), face.rise
    rows, columns = texture.shape
    reach = math.floor(min(REACH * rows / 2, LONGEST * turn / face.step * abs(rise)))
    if reach < 1:
        return None
    lean = reach / abs(rise)
    longest = (columns - OVERLAP * 2 * face.radius / face.step - lean - 1) * face.step
    if longest < NEAREST * turn:
        return None
    low, high = math.log(SHORTEST * turn), math.log(min(FARTHEST * turn, longest))
    tried = np.arange(math.ceil(low / STEP), math.floor(high / STEP) + 1)
    periods = np.exp(STEP * tried) / face.step
    first, last = math.floor(periods[0] - lean) - 1, math.ceil(periods[-1] + lean) + 1
    if first < 1:
        return None
    lags = np.arange(first, last + 1)
    size = scipy.fft.next_fast_len(columns + last, real=True)
    spectra = scipy.fft.rfft(texture, size, axis=1)
    products = np.empty((2 * reach + 1, lags.size), np.float32)
    for d in range(-reach, reach + 1):
        before, after = spectra[max(0, -d) : rows - max(0, d)], spectra[max(0, d) : rows + min(0, d)]
        products[d + reach] = scipy.fft.irfft(np.einsum("ij,ij->j", before.conj(), after), size)[first : last + 1]
    alike = coefficients(products, texture, lags)
    apart = np.arange(-reach, reach + 1)
    pairs = rows - np.abs(apart)
    scores = np.zeros(periods.size)
    for d, weight, row in zip(apart, pairs, alike, strict=True):
        scores += weight * np.interp(periods + d / rise, lags, row)
    return Recurrence(face, int(tried[0]), scores / pairs.sum() * np.sqrt(1 - periods / columns), reach)


def full_turn(found: Sequence[Recurrence], per_pixel: float) -> FullTurn | None:
    """Return the length of a full turn from the frames of a clip; None where no one length stands out.

    Parameters
    ----------
    found : S of some frames.
    per_pixel : the twist of the clip that the slope of its fibres tells [1/px].
    """
    if len(found) < MIN_FRAMES:
        return None
    first = max(one.first for one in found)
    past = min(one.first + one.scores.size for one in found)
    low, high = (round(math.log(share / abs(per_pixel)) / STEP) - first for share in (NEAREST, FARTHEST))
    if low < 1 or past - first < low + 2:
        return None
    scores = np.mean([one.scores[first - one.first : past - one.first] for one in found], axis=0)
    best = low + int(np.argmax(scores[low : high + 1]))
    if not low < best < scores.size - 1 or scores[best] < MIN_SCORE:
        return None
    under = np.flatnonzero(scores < (1 - MIN_CONTRAST) * scores[best])
    before, after = under[under < best], under[under > best]
    if not before.size or best - before[-1] > FLANK / STEP or (after.size and after[0] - best > FLANK / STEP):
        return None
    end = int(after[0]) if after.size else scores.size
    other = np.concatenate([scores[: before[-1] + 1], scores[end:]])
    if other.max() > (1 - MIN_CONTRAST) * scores[best]:
        return None
    left, at, right = scores[best - 1 : best + 2].tolist()
    length = math.exp(STEP * (first + best + 0.5 * (left - right) / (left - 2 * at + right)))
    return FullTurn(length, turn_scatter([one.face for one in found], length, [one.reach for one in found]))
