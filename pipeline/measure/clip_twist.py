"""Twist of a clip from that of its frames: a yarn has one hand, and its fibres return after a full turn."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.measure.recurrence import Recurrence, full_turn
from pipeline.measure.scatter import Face, slope_scatter
from pipeline.records import Array, SlopeRatio

METHOD_U: Mapping[str, float] = {"surface": 0.005, "ply": 0.003, "tracer": 0.015}
"""Relative standard uncertainties of the method, common to all frames: the size of the clip-mean errors on rendered
yarn of 20 to 60 px, see benchmarks/measure_coverage.py and its accepted result; of the slope of fibres what is left
where they scatter least (`scatter.py` tells by how much they do). For a tracer it is mostly how far one fibre lies off
the helix."""
U_PASS = 0.03
"""The same for the slope of one pass of a tracer at a known depth."""
U_SCATTER = 0.015
"""The same for fibres whose scatter cannot be told."""
U_DEPTH = 0.08
"""The same for the slope of fibres that were not seen again a turn on: it is 2πTρ, and how deep ρ lies below the
outline is not known. On a painted cylinder it is the outline, R; fibres of radius r on the outside of a yarn run at
R − r, for cotton of 12 to 20 µm in a yarn of 0.16 mm at 0.87 to 0.93 R, and dive from there. This is the root mean
square of a rectangle from 0 to 14 %. Of the clips "deep" of benchmarks/measure_coverage.py, whose fibres run that deep,
twice u holds 86 %, of those that are painted on the outline all, of all kinds together 95 %."""
U_DEPTH_PASS = 0.12
"""The same for the slope of one pass of a tracer, which is that of a line over all of the face that is used, evenly. A
fibre at (1 − δ)R is seen at γ = asin((1 − δ) sin γ'): over ±53° of γ its slope is 18 % too small at δ = 14 %, and
this is the root mean square of what that slope is to be raised by."""
U_TURN = 0.003
"""The same for the length of a full turn, of which fibres return (`recurrence.py`)."""
PASS_ONLY = "one pass of the tracer fibre is seen, and in other frames a turn"
"""Why a frame of a tracer does not count."""
MIN_CREDIBLE = 0.3
"""Share of the frames with yarn whose twist, or diameter, must be credible: fewer are so by chance."""
MAX_OTHER_HAND = 0.2
"""Share of the frames with a twist that may tell the other hand."""


@dataclass(frozen=True, slots=True)
class ClipTwist:
    """What a clip's frames say together."""

    per_pixel: Array
    """Turns per pixel of each frame, Z > 0; NaN where not credible."""
    relative_u: Mapping[str, float]
    """Relative standard uncertainties common to all frames, by name: 'method'; of a single yarn 'fibres', their
    scatter about the helix, and 'depth', how far they run below the outline, also of a tracer of which one pass is
    seen; of a plied one 'texture', what fibres and background make of the strands' period."""
    left_out: Mapping[str, int]
    """Frames whose twist was taken away, by the reason."""
    note: str
    """What of a tracer the twist is from; empty for other methods, and where there is none."""


def clip_twist(
    frames: Array,
    u_frames: Array,
    one_pass: NDArray[np.bool_],
    yarn: NDArray[np.bool_],
    faces: Sequence[tuple[Face, Recurrence | None]],
    method: str,
    ratio: SlopeRatio | None,
) -> ClipTwist:
    """Decide on the twist of a clip.

    Parameters
    ----------
    frames : turns per pixel of each frame, Z > 0, NaN where not credible, shape (n,).
    u_frames : standard uncertainty of each by what it does not explain [1/px], NaN where not told, shape (n,).
    one_pass : whether it is that of one pass of a tracer, shape (n,).
    yarn : whether there is yarn in it, shape (n,).
    faces : of the frames that were looked at for a full turn.
    method : a name of `METHOD_U`.
    ratio : that the slope of the fibres is to be divided by, where it is known.
    """
    twist, other_hand, reason = _one_hand(frames)
    left_out = {reason: other_hand} if other_hand else {}
    least = MIN_CREDIBLE * np.count_nonzero(yarn)
    u, note = {"method": METHOD_U[method]}, ""
    passes = one_pass & np.isfinite(twist)
    if method == "tracer" and np.count_nonzero(np.isfinite(twist) & ~passes) >= least:
        note = "of the tracer fibre a turn or more is seen"
        twist = np.where(passes, math.nan, twist)
        if np.any(passes):
            left_out[PASS_ONLY] = int(np.count_nonzero(passes))
    elif method == "tracer":
        note = "of the tracer fibre one pass is seen: the twist is by its slope"
        u = {"method": U_PASS, "depth": U_DEPTH_PASS}
        if ratio is not None:
            twist, u["depth"] = np.where(passes, twist / ratio.value, twist), ratio.u / ratio.value
    if np.count_nonzero(np.isfinite(twist)) < least or not np.any(np.isfinite(twist)):
        twist, note = np.full(frames.size, math.nan), ""
    known = twist[np.isfinite(twist)]
    slope = float(np.median(known)) if known.size else math.nan
    spread = float(known.std(ddof=1)) / abs(slope) if known.size > 1 else 0.0
    told = u_frames[np.isfinite(twist) & np.isfinite(u_frames)]
    if told.size:
        u["texture"] = _shared(math.sqrt(float(np.mean(told**2))) / abs(slope), spread)
    if method == "surface" and known.size:
        u |= {"fibres": _shared(slope_scatter([face for face, _ in faces]), spread), "depth": U_DEPTH}
        by_slope = 1.0
        if ratio is not None:
            by_slope, u["depth"] = ratio.value, ratio.u / ratio.value
        turn = full_turn([again for _, again in faces if again is not None], slope)
        if turn is not None:
            by_turn = {"method": U_TURN, "fibres": _shared(turn.relative_u, 0.0)}
            if math.hypot(*by_turn.values()) < math.hypot(*u.values()):  # depth no longer counts
                by_slope, u = turn.length * abs(slope), by_turn
        twist = twist / by_slope
    return ClipTwist(twist, u, left_out, note)


def _shared(scatter: float, spread: float) -> float:
    """Return the part of the scatter of one frame, as by its fibres, that is not seen as spread of the frames.

    Frames show the same fibres over and over, and their mean is as wrong as one of them; what differs from frame to
    frame is in the spread of the twist.
    """
    return math.sqrt(max(scatter**2 - spread**2, 0.0)) if math.isfinite(scatter) else U_SCATTER


def _one_hand(twist: Array) -> tuple[Array, int, str]:
    """Return the twist without frames that tell the other hand, or without any where many do; of how many, and why."""
    z, s = int(np.count_nonzero(twist > 0)), int(np.count_nonzero(twist < 0))
    if not min(z, s):
        return twist, 0, ""
    many = min(z, s) > MAX_OTHER_HAND * (z + s)
    taken = np.isfinite(twist) if many else (twist > 0) != (z > s)
    return np.where(taken, math.nan, twist), z + s if many else min(z, s), f"{z} frames tell Z and {s} tell S"
