"""The three compared quantities of one case from its logs and clips."""

from collections.abc import Sequence
from dataclasses import replace

from pipeline.case import Case, RawFiles
from pipeline.ingest.video import open_video
from pipeline.measure.scale import cylinder_in
from pipeline.measure.tension import measure_tension
from pipeline.measure.uncertainty import combine
from pipeline.measure.yarn import measure_yarn
from pipeline.records import CylinderAxis, Estimate, Measured, Quantity, RawTension, RawVideo, Scale, YarnMeasurement


def measure_case(case: Case, logs: Sequence[RawTension], clips: Sequence[RawVideo]) -> Measured:
    """Measure every log and clip, and combine those of one quantity by inverse variance. All in SI."""
    raw = case.raw
    if raw is None:
        raise ValueError(f"{case.name} has a published summary and no raw files")
    tension = tuple(measure_tension(log) for log in logs)
    yarn: tuple[YarnMeasurement, ...] = ()
    if clips:
        scale, axis = _scale_and_axis(raw, clips[0])
        yarn = tuple(
            measure_yarn(
                clip,
                scale,
                cylinder_axis=axis,
                u_tilt=raw.u_tilt,
                ratio=raw.ratio,
                method=raw.method,
                plies=raw.plies,
                speed=case.scene.delivery_speed,
            )
            for clip in clips
        )
    values: dict[Quantity, Estimate] = {}
    if tension:
        values[Quantity.TENSION_AB] = combine([log.estimate for log in tension])
    if yarn:
        values[Quantity.TWIST_AB] = combine([_estimate(clip, "twist") for clip in yarn])
        values[Quantity.THETA_B] = combine([_estimate(clip, "theta_B") for clip in yarn])
    diameter = combine([_estimate(clip, "diameter") for clip in yarn]) if yarn else None
    return Measured(case.name, values, diameter, tension, yarn)


def _scale_and_axis(raw: RawFiles, clip: RawVideo) -> tuple[Scale, CylinderAxis | None]:
    """The object scale and e_z, as given or from the cylinder's two edges.

    Raises
    ------
    pipeline.errors.InputError
        If the edges are to give them and are not in view.
    """
    if raw.scale is not None:
        return raw.scale, raw.cylinder_axis
    if raw.cylinder_diameter is None:
        raise ValueError("a video without a scale")  # case.py lets none in
    seen = clip if raw.scale_image is None else open_video(raw.scale_image, fps=raw.fps or 1.0, bits=raw.bits)
    cylinder = cylinder_in(seen.frames, raw.scale_image or clip.source.name)
    axis = cylinder.axis if raw.cylinder_axis is None else raw.cylinder_axis
    return cylinder.scale(raw.cylinder_diameter), axis


def _estimate(clip: YarnMeasurement, name: str) -> Estimate:
    """A clip's estimate with what is to be said of the whole clip."""
    estimate = clip.summary[name]
    return replace(estimate, reason="; ".join(part for part in (estimate.reason, clip.reason) if part))
