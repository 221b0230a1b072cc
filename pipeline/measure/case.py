"""The three compared quantities of one case from its logs and clips."""

from collections.abc import Sequence
from dataclasses import replace

from pipeline.case import Case
from pipeline.measure.tension import measure_tension
from pipeline.measure.uncertainty import combine
from pipeline.measure.yarn import measure_yarn
from pipeline.records import Estimate, Measured, Quantity, RawTension, RawVideo, YarnMeasurement


def measure_case(case: Case, logs: Sequence[RawTension], clips: Sequence[RawVideo]) -> Measured:
    """Measure every log and clip, and combine those of one quantity by inverse variance. All in SI."""
    raw = case.raw
    if raw is None:
        raise ValueError(f"{case.name} has a published summary and no raw files")
    tension = tuple(measure_tension(log) for log in logs)
    yarn = tuple(
        measure_yarn(clip, raw.scale, cylinder_axis=raw.cylinder_axis, method=raw.method)
        for clip in clips
        if raw.scale is not None
    )
    values: dict[Quantity, Estimate] = {}
    if tension:
        values[Quantity.TENSION_AB] = combine([log.estimate for log in tension])
    if yarn:
        values[Quantity.TWIST_AB] = combine([_estimate(clip, "twist") for clip in yarn])
        values[Quantity.THETA_B] = combine([_estimate(clip, "theta_B") for clip in yarn])
    diameter = combine([_estimate(clip, "diameter") for clip in yarn]) if yarn else None
    return Measured(case.name, values, diameter, tension, yarn)


def _estimate(clip: YarnMeasurement, name: str) -> Estimate:
    """A clip's estimate with what is to be said of the whole clip."""
    estimate = clip.summary[name]
    return replace(estimate, reason="; ".join(part for part in (estimate.reason, clip.reason) if part))
