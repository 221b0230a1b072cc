"""Twist of a single yarn over a clip, from the fibres that come back to the front after a full turn.

The slope of the fibres on the unrolled surface (`twist.py`) is 2πTρ, and only where they run on the outline itself ρ is
half of the yarn's diameter. Fibres have a thickness and wander: they run below the outline, and the slope tells a twist
that is as much too small. Fibres are many turns long, though, and what is at the front at x is there again at x + 1/T,
whatever ρ. The unrolled surface is therefore correlated with itself about one turn on,

    S(P) = mean over Δγ of C(P + Δγ/(2πT'), Δγ),   P up to `FARTHEST` times 1/T',

along the slope T' that was found, and averaged over frames. Its maximum is at P = 1/T, from `NEAREST` on. Where fibres
end or dive before that there is none, but other fibres that are alike by chance. They are so at any P, also at one too
short for a turn: a maximum only counts where it is `MIN_SCORE` high and stands out of all other P by `MIN_CONTRAST`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft

from pipeline.measure.axis import YarnAxis
from pipeline.measure.lines import Image, Pixels, step_across
from pipeline.measure.twist import unroll
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
PEAK = 0.03
"""Relative distance from the maximum from which P is another one."""
MIN_FRAMES = 3
MIN_SCORE = 0.2
MIN_CONTRAST = 0.5
"""With it no return is found in the 60 single yarns of benchmarks/measure_coverage.py, whose fibres end after half a
turn."""


@dataclass(frozen=True, slots=True)
class Recurrence:
    """S of one frame at P = exp(`STEP`·k) px."""

    first: int
    """k of the first P."""
    scores: Array
    """Weighed by the root of the length that is seen twice, over that in view: chance alone is then alike at all P."""


def recurrence(image: Image | Pixels, axis: YarnAxis, per_pixel: float) -> Recurrence | None:
    """Return S about one turn on, or None where less than that is in view.

    Parameters
    ----------
    image : shape (rows, columns).
    axis : where the yarn is.
    per_pixel : the twist that the slope of its fibres tells [1/px].
    """
    step = 1 / step_across(axis.angle)  # of the columns [px]
    rise = math.pi * per_pixel * axis.diameter * step  # rows of γ per column
    turn = 1 / abs(per_pixel)
    tried = np.arange(math.ceil(math.log(SHORTEST * turn) / STEP), math.floor(math.log(FARTHEST * turn) / STEP) + 1)
    periods = np.exp(STEP * tried)
    if axis.length < FARTHEST * turn * (1 + LONGEST) + OVERLAP * axis.diameter:
        return None
    texture = unroll(image, axis)
    rows, columns = texture.shape
    reach = math.floor(min(REACH * rows / 2, LONGEST * turn / step * abs(rise)))
    periods = periods / step
    first, last = math.floor(periods[0] - reach / abs(rise)) - 1, math.ceil(periods[-1] + reach / abs(rise)) + 1
    if reach < 1 or first < 1 or last >= columns:
        return None
    lags = np.arange(first, last + 1)  # from here on in columns, as the periods
    size = scipy.fft.next_fast_len(columns + last, real=True)
    spectra = scipy.fft.rfft(texture, size, axis=1)
    scores, pairs = np.zeros(periods.size), 0
    for d in range(-reach, reach + 1):
        before, after = spectra[max(0, -d) : rows - max(0, d)], spectra[max(0, d) : rows + min(0, d)]
        together = scipy.fft.irfft(np.einsum("ij,ij->j", before.conj(), after), size)[first : last + 1]
        scores += np.interp(periods + d / rise, lags, together / (columns - lags))
        pairs += rows - abs(d)
    return Recurrence(int(tried[0]), scores / pairs * np.sqrt(1 - periods / columns))


def full_turn(found: Sequence[Recurrence], per_pixel: float) -> float:
    """Return the length of a full turn [px] from the frames of a clip; NaN where no one length stands out.

    Parameters
    ----------
    found : S of some frames.
    per_pixel : the twist of the clip that the slope of its fibres tells [1/px].
    """
    if len(found) < MIN_FRAMES:
        return math.nan
    first = max(one.first for one in found)
    past = min(one.first + one.scores.size for one in found)
    low, high = (round(math.log(share / abs(per_pixel)) / STEP) - first for share in (NEAREST, FARTHEST))
    if low < 1 or past - first < (low + high) / 2:
        return math.nan
    scores = np.mean([one.scores[first - one.first : past - one.first] for one in found], axis=0)
    best = low + int(np.argmax(scores[low : high + 1]))
    other = np.abs(np.arange(scores.size) - best) > PEAK / STEP
    if not low < best < scores.size - 1 or scores[best] < MIN_SCORE:
        return math.nan
    if 1 - float(scores[other].max()) / float(scores[best]) < MIN_CONTRAST:
        return math.nan
    before, at, after = scores[best - 1 : best + 2].tolist()
    return math.exp(STEP * (first + best + 0.5 * (before - after) / (before - 2 * at + after)))
