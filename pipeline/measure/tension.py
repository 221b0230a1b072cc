"""Statistics of a tension log, with an uncertainty that says what it holds."""

import math

import numpy as np

from pipeline.errors import InputError
from pipeline.ingest.tension_flags import sampling_interval
from pipeline.measure.uncertainty import mean_estimate
from pipeline.records import Array, Estimate, RawTension, TensionFlag, TensionMeasurement

EXCLUDED = (
    TensionFlag.MISSING
    | TensionFlag.SATURATED
    | TensionFlag.STUCK
    | TensionFlag.SPIKE
    | TensionFlag.TIME_BACKWARD_OR_DUPLICATE
)
"""Flags whose samples are left out of the statistics."""


def measure_tension(raw: RawTension, window: tuple[float | None, float | None] | None = None) -> TensionMeasurement:
    """Mean, spread and drift of a log over a window, with u = √(s²/n_eff + resolution²/12 + (u_cal · mean)²).

    Left out: MISSING (no number), STUCK (repeats one reading, so it holds no information), SPIKE (an electrical or
    handling disturbance, not the yarn's mean), TIME_BACKWARD_OR_DUPLICATE (a sample written twice would count twice),
    and SATURATED (the true tension is unknown, only that it is higher; leaving these out makes the mean too low, and
    `estimate.reason` says so). Kept: NEGATIVE (noise about zero is as often below it; leaving out one side would bias
    the mean upwards) and AFTER_GAP (the reading itself is sound). For n_eff the samples left count as evenly spaced.

    Parameters
    ----------
    raw : the log.
    window : start and end [s] from the log's start, both inclusive; None stands for the log's own end on that side.

    Raises
    ------
    pipeline.errors.InputError
        If the window holds no sample.
    """
    first, last = float(raw.time.min()), float(raw.time.max())
    start, end = window or (None, None)
    start, end = first if start is None else start, last if end is None else end
    inside = (raw.time >= start) & (raw.time <= end)
    if not inside.any():
        right = f"the log spans {first:g} to {last:g} s"
        raise InputError(raw.source.name, f"no sample in the window {start:g} to {end:g} s", right)
    flag = raw.flag[inside]
    usable = flag & EXCLUDED == 0
    tension = raw.tension[inside][usable]
    mean = float(tension.mean()) if tension.size else math.nan
    return TensionMeasurement(
        raw=raw,
        window=(start, end),
        estimate=mean_estimate(
            tension,
            extra_u={"resolution": raw.resolution / math.sqrt(12), "calibration": raw.calibration_u * mean},
            reason=_reason(raw, flag, int(tension.size)),
        ),
        rate=1 / sampling_interval(raw.time, raw.flag),
        drift=_slope(raw.time[inside][usable], tension),
        gaps=_gaps(raw, inside),
        flag_counts={str(bit.name).lower(): int(np.count_nonzero(flag & bit)) for bit in TensionFlag},
    )


def tension_json(m: TensionMeasurement) -> dict[str, object]:
    """The document that ``yarnval tension --json`` prints, in cN; None where a number cannot be known."""
    e: Estimate = m.estimate
    return {
        "n": e.n,
        "rate_Hz": _number(m.rate),
        "mean_cN": _number(e.mean * 100),
        "cv_percent": _number(e.cv * 100),
        "u_cN": _number(e.u * 100),
        "n_eff": _number(e.n_eff),
        "drift_cN_per_s": _number(m.drift * 100),
        "flags": dict(m.flag_counts),
        "gaps": [list(gap) for gap in m.gaps],
        "unit_in_file": m.raw.unit_in_file,
        "window_s": list(m.window),
        "layout": m.raw.layout,
        "reason": e.reason,
    }


def _reason(raw: RawTension, flag: np.ndarray, usable: int) -> str:
    """What is not in u, and what leaving samples out does to the mean."""
    parts: list[str] = []
    if usable < 2:
        parts.append(f"{usable} usable samples of {flag.size}: at least 2 are needed for an uncertainty")
    saturated = int(np.count_nonzero(flag & TensionFlag.SATURATED))
    if saturated:
        parts.append(f"{saturated} of {flag.size} samples saturated and left out: the mean is biased low")
    if math.isnan(raw.calibration_u):
        parts.append("calibration uncertainty not stated and not in u")
    if math.isnan(raw.resolution):
        parts.append("resolution not stated and not in u")
    return "; ".join(parts)


def _slope(time: Array, tension: Array) -> float:
    """Slope of the least-squares line [N/s]; NaN where fewer than two different times are left."""
    if tension.size < 2:
        return math.nan
    centred = time - time.mean()
    spread = float(centred @ centred)
    return float(centred @ tension) / spread if spread > 0 else math.nan


def _gaps(raw: RawTension, inside: np.ndarray) -> tuple[tuple[float, float], ...]:
    """Start and end [s] of the gaps that end inside the window."""
    increasing = np.flatnonzero(raw.flag & TensionFlag.TIME_BACKWARD_OR_DUPLICATE == 0)
    late = np.flatnonzero((raw.flag & TensionFlag.AFTER_GAP != 0) & inside)
    before = increasing[np.searchsorted(increasing, late) - 1]
    return tuple((float(raw.time[b]), float(raw.time[i])) for b, i in zip(before, late, strict=True))


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
