"""Twist of a clip from that of its frames: a yarn has one hand, and its fibres return after a full turn."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.measure.recurrence import Recurrence, full_turn
from pipeline.records import Array

METHOD_U: Mapping[str, float] = {"surface": 0.015, "ply": 0.003, "tracer": 0.015}
"""Relative standard uncertainties of the method, common to all frames: the size of the clip-mean errors on rendered
yarn of 20 to 60 px, see benchmarks/measure_coverage.py and its accepted result. For the slope of fibres and for a
tracer it is mostly how far the few fibres of one stretch of yarn lie off the helix, which more frames of it do not
mend."""
U_DEPTH = 0.08
"""The same for the slope of fibres that were not seen again a turn on: it is 2πTρ, and how deep ρ lies below the
outline is not known. On a painted cylinder it is the outline, R; fibres of radius r on the outside of a yarn run at
R − r, for cotton of 12 to 20 µm in a yarn of 0.16 mm at 0.87 to 0.93 R, and dive from there. This is the root mean
square of a rectangle from 0 to 14 %."""
U_RECURRENCE = 0.005
"""The same for the twist of a single yarn whose fibres are seen again after a full turn (`recurrence.py`)."""
MIN_CREDIBLE = 0.3
"""Share of the frames with yarn whose twist, or diameter, must be credible: fewer are so by chance."""
MAX_OTHER_HAND = 0.2
"""Share of the frames with a twist that may tell the other hand."""


@dataclass(frozen=True, slots=True)
class ClipTwist:
    """What a clip's frames say together."""

    per_pixel: Array
    """Turns per pixel of each frame, Z > 0; NaN where not credible."""
    relative_u: float
    """Relative standard uncertainty of the method, common to all frames."""
    other_hand: int
    """Frames whose twist was taken away because of their hand."""
    reason: str
    """Why, with the frames of each hand; empty where there is but one."""


def clip_twist(frames: Array, yarn: NDArray[np.bool_], turns: Sequence[Recurrence], method: str) -> ClipTwist:
    """Decide on the twist of a clip.

    Parameters
    ----------
    frames : turns per pixel of each frame, Z > 0, NaN where not credible, shape (n,).
    yarn : whether there is yarn in it, shape (n,).
    turns : of the frames that were looked at for a full turn.
    method : a name of `METHOD_U`.
    """
    twist, other_hand, reason = _one_hand(frames)
    if np.count_nonzero(np.isfinite(twist)) < MIN_CREDIBLE * np.count_nonzero(yarn):
        twist = np.full(frames.size, math.nan)
    slope = float(np.nanmedian(np.abs(twist))) if np.any(np.isfinite(twist)) else math.nan
    period = full_turn(turns, slope) if math.isfinite(slope) else math.nan
    if math.isfinite(period):  # how deep below the outline the fibres run no longer counts
        twist = twist / (period * slope)
        u = U_RECURRENCE
    else:
        u = math.hypot(METHOD_U[method], U_DEPTH) if method == "surface" else METHOD_U[method]
    return ClipTwist(twist, u, other_hand, reason)


def _one_hand(twist: Array) -> tuple[Array, int, str]:
    """Return the twist without frames that tell the other hand, or without any where many do; of how many, and why."""
    z, s = int(np.count_nonzero(twist > 0)), int(np.count_nonzero(twist < 0))
    if not min(z, s):
        return twist, 0, ""
    many = min(z, s) > MAX_OTHER_HAND * (z + s)
    taken = np.isfinite(twist) if many else (twist > 0) != (z > s)
    return np.where(taken, math.nan, twist), z + s if many else min(z, s), f"{z} frames tell Z and {s} tell S"
