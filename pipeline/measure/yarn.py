"""A clip to angle, diameter and twist of the yarn, frame by frame and as means with uncertainties.

Conventions, stated here and used everywhere:

- Frames are rows top-down. Angles are counter-clockwise from the image's +x axis *as displayed*; a yarn's axis has no
  direction, so its angle lies in [0, π).
- The frame is seen from outside the cylinder, e_z points along `cylinder_axis` as displayed, and the yarn travels to
  the right of e_z. So θ = (cylinder_axis − axis_angle) mod π, in (0, π): π/2 where the yarn crosses e_z squarely.
- Twist is positive for Z: on the near face the fibres run like the stroke of the letter, from lower left to upper right
  when the yarn is vertical, which is a right-handed helix. Turning or travelling yarn, or the choice of one of the
  axis' two directions, does not change it; a mirrored image does.

Frames are read in order in the caller's thread and measured in chunks of `CHUNK`, several at a time. A chunk's first
frame is searched as a whole and the next ones where the yarn was, so the numbers do not depend on how many threads
there are.

Outlying frames (a diameter or a twist more than 5 standard deviations of the bulk away from the median, each from the
median absolute deviation) keep their values and are flagged, but do not enter the means.
"""

import math
import os
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pipeline.errors import InputError, nearest
from pipeline.measure.axis import Pixels, YarnAxis, expected, find_axis, straighten
from pipeline.measure.twist import FrameTwist, surface_twist
from pipeline.measure.uncertainty import mean_estimate
from pipeline.records import Array, Estimate, FrameFlag, Frames, RawVideo, Scale, Thumbnail, YarnMeasurement

METHODS = ("surface",)
"""Known ways to measure twist: 'surface' is the slope of the fibres on a single yarn's unrolled surface."""

METHOD_U_ANGLE = math.radians(0.02)
METHOD_U_DIAMETER = 0.01
METHOD_U_TWIST = 0.01
"""Standard uncertainties of the method, common to all frames (diameter and twist relative): the size of the clip-mean
errors on rendered yarn of 20 to 60 px, see tests/measure/test_yarn_truth.py."""

OUTLYING = 5.0
SATURATED_SHARE = 0.01
"""Share of the yarn's pixels at full scale from which a frame is flagged."""
REDUCED_BITS = 8
"""Significant bits up to which a clip is flagged as reduced: exports lose the camera's 12 bits this way."""
CHUNK = 16
"""Frames measured one after another by one thread."""
THUMBNAILS = 6
THUMBNAIL_WIDTH = 480


@dataclass(frozen=True, slots=True)
class _Frame:
    """What was measured in one frame."""

    flag: FrameFlag
    axis: YarnAxis | None = None
    twist: FrameTwist | None = None
    reduced: NDArray[np.uint8] | None = None
    """The frame for the contact sheet, where it is to be there."""


def measure_yarn(
    video: RawVideo,
    scale: Scale,
    *,
    cylinder_axis: float | None,
    method: str = "surface",
    threads: int | None = None,
) -> YarnMeasurement:
    """Measure the yarn in every frame of a clip; a few chunks of frames are held in memory at a time.

    Parameters
    ----------
    video : the clip, n frames.
    scale : object scale; without its uncertainty the means' u lack that term, and `reason` says so.
    cylinder_axis : direction of e_z [rad], counter-clockwise from +x as displayed; without it θ is NaN.
    method : one of `METHODS`.
    threads : how many measure at once; as many as there are processors if not given. The numbers do not depend on it.

    Raises
    ------
    InputError
        If the method is not known or the scale is not a positive number. Frames that cannot be read are flagged.
    """
    if method not in METHODS:
        raise InputError("method", f"'{method}' is not known", nearest(method, list(METHODS)))
    if not (math.isfinite(scale.metres_per_pixel) and scale.metres_per_pixel > 0):
        raise InputError(
            "scale", f"{scale.metres_per_pixel:g} m per pixel", "a positive number: without it nothing is in mm"
        )
    n = len(video.frames)
    angle, twist, diameter = np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    centre = np.full((n, 2), np.nan)
    confidence, flag = np.zeros(n), np.zeros(n, np.uint16)
    reasons: Counter[str] = Counter()
    images: dict[int, NDArray[np.uint8]] = {}
    for i, found in enumerate(_measure_frames(video, threads or os.cpu_count() or 1)):
        flag[i] = found.flag
        if found.axis is None or found.twist is None:
            continue
        axis = found.axis
        centre[i], angle[i], diameter[i], twist[i] = axis.centre, axis.angle, axis.diameter, found.twist.per_pixel
        confidence[i] = axis.agreement * (0.5 + 0.5 * min(1.0, found.twist.coherence) * (not found.twist.reason))
        if found.twist.reason:
            reasons[found.twist.reason] += 1
        if found.reduced is not None:
            images[i] = found.reduced

    diameter *= scale.metres_per_pixel
    twist /= scale.metres_per_pixel
    if video.bits <= REDUCED_BITS:
        flag |= np.uint16(FrameFlag.REDUCED_DEPTH)
    flag[_outlying(diameter) | _outlying(twist)] |= np.uint16(FrameFlag.OUTLIER)
    theta = np.mod(cylinder_axis - angle, math.pi) if cylinder_axis is not None else np.full(n, np.nan)
    kept = (flag & FrameFlag.OUTLIER) == 0
    summary = _summary({"axis_angle": angle, "theta_B": theta, "twist": twist, "diameter": diameter}, kept, scale)
    if cylinder_axis is None:
        summary["theta_B"] = Estimate(math.nan, n=0, reason="no cylinder axis was given")
    mean_twist = summary["twist"].mean
    return YarnMeasurement(
        raw=video,
        method=method,
        axis_angle=angle,
        theta=theta,
        twist=twist,
        diameter=diameter,
        confidence=confidence,
        flag=flag,
        summary=summary,
        handedness="" if math.isnan(mean_twist) else "Z" if mean_twist > 0 else "S",
        centre=centre,
        reason=_reason(video, scale, flag, reasons),
        thumbnails=tuple(
            _thumbnail(i, image, video.shape, centre[i], angle[i], diameter[i] / scale.metres_per_pixel, twist[i])
            for i, image in images.items()
        ),
    )


def measure_json(measurement: YarnMeasurement) -> dict[str, object]:
    """Return the document of `yarnval measure --json`: edge units (°, tpm, mm), null where a number is not known."""
    summary = {}
    for key, name, unit in (
        ("theta_B", "theta_B_deg", math.degrees(1)),
        ("axis_angle", "axis_angle_deg", math.degrees(1)),
        ("twist", "twist_tpm", 1.0),
        ("diameter", "diameter_mm", 1e3),
    ):
        estimate = measurement.summary[key]
        if key == "theta_B" and not np.any(np.isfinite(measurement.theta)):
            continue
        summary[name] = {
            "mean": _number(estimate.mean * unit),
            "cv_percent": _number(estimate.cv * 100),
            "n": estimate.n,
            "n_eff": _number(estimate.n_eff),
            "u": _number(estimate.u * unit),
        }
    return {
        "frames": len(measurement.flag),
        "fps": _number(measurement.raw.rate),
        "time_s": _numbers(measurement.raw.time),
        "axis_angle_deg": _numbers(np.degrees(measurement.axis_angle)),
        "twist_tpm": _numbers(measurement.twist),
        "diameter_mm": _numbers(measurement.diameter * 1e3),
        "confidence": _numbers(measurement.confidence),
        "flag": [" ".join(f.name or "" for f in FrameFlag if f & int(bits)) for bits in measurement.flag],
        "summary": summary,
        "method": measurement.method,
        "handedness": measurement.handedness,
        "reason": measurement.reason,
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _numbers(values: Array) -> list[float | None]:
    return [_number(value) for value in values]


def _measure_frames(video: RawVideo, threads: int) -> Iterator[_Frame]:
    """Yield what is found in each frame, in order; at most `threads` + 2 chunks of frames are held at a time."""
    n = len(video.frames)
    shots = set(np.linspace(0, n - 1, THUMBNAILS).round().astype(int).tolist())
    with _one_thread_each(), ThreadPoolExecutor(threads) as pool:
        running: deque[Future[list[_Frame]]] = deque()
        for start in range(0, n, CHUNK):
            frames = [_read(video.frames, i) for i in range(start, min(start + CHUNK, n))]
            running.append(pool.submit(_measure_chunk, frames, video.bits, {i - start for i in shots}))
            if len(running) > threads:
                yield from running.popleft().result()
        while running:
            yield from running.popleft().result()


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Keep the libraries from sharing out one frame's work: it is too little, and chunks run side by side."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        cv2.setNumThreads(before)


def _read(frames: Frames, index: int) -> Pixels | None:
    try:
        return frames.frame(index)
    except InputError:
        return None


def _measure_chunk(frames: Sequence[Pixels | None], bits: int, shots: set[int]) -> list[_Frame]:
    """Measure successive frames; `shots` are the places of those that go on the contact sheet."""
    found, axis, before = [], None, None
    for i, frame in enumerate(frames):
        if frame is None:
            found.append(_Frame(FrameFlag.UNREADABLE))
            continue
        axis, before = find_axis(frame, axis if axis is None or before is None else expected(axis, before)), axis
        if axis is None:
            found.append(_Frame(FrameFlag.NO_YARN))
            continue
        twist = surface_twist(frame, axis)
        flag = FrameFlag.TWIST_NOT_CREDIBLE if twist.reason else FrameFlag(0)
        if _saturated(frame, axis, bits):
            flag |= FrameFlag.SATURATED
        found.append(_Frame(flag, axis, twist, _reduced(frame) if i in shots else None))
    return found


def _saturated(frame: Pixels, axis: YarnAxis, bits: int) -> bool:
    """Say whether more than `SATURATED_SHARE` of the yarn's pixels are at full scale."""
    full = 2**bits - 1
    if int(frame.max()) < full:
        return False
    strip = straighten((frame >= full).astype(np.float32), axis.centre, axis.angle, int(axis.diameter / 2), axis.length)
    return float(strip.mean()) > SATURATED_SHARE


def _outlying(values: Array) -> NDArray[np.bool_]:
    """Say which values lie far outside the bulk; NaN does not."""
    good = values[np.isfinite(values)]
    if good.size < 5:
        return np.zeros(values.shape, bool)
    median = float(np.median(good))
    # at least 1 % of the median, so that a steady yarn's rounding is no outlier
    spread = max(1.4826 * float(np.median(np.abs(good - median))), 0.01 * abs(median))
    with np.errstate(invalid="ignore"):
        return np.abs(values - median) > OUTLYING * spread


def _unwrapped(angles: Array) -> Array:
    """Shift angles of axes by multiples of π to within π/2 of their mean direction."""
    good = angles[np.isfinite(angles)]
    middle = 0.5 * float(np.angle(np.exp(2j * good).sum())) if good.size else 0.0
    middle %= math.pi
    return middle + np.mod(angles - middle + math.pi / 2, math.pi) - math.pi / 2


def _summary(series: dict[str, Array], kept: NDArray[np.bool_], scale: Scale) -> dict[str, Estimate]:
    dropped = int(np.count_nonzero(~kept))
    left_out = [f"{dropped} outlying frames left out"] if dropped else []
    no_scale_u = [] if math.isfinite(scale.relative_u) else ["the scale's uncertainty is not stated and not in u"]
    estimates = {}
    for name, values in series.items():
        if name in ("axis_angle", "theta_B"):
            used = np.where(kept, _unwrapped(values), np.nan)
            terms, notes = [METHOD_U_ANGLE], left_out
        else:
            used = np.where(kept, values, np.nan)
            level = abs(float(np.nanmean(used))) if np.any(np.isfinite(used)) else 0.0
            method_u = METHOD_U_TWIST if name == "twist" else METHOD_U_DIAMETER
            terms, notes = [method_u * level, scale.relative_u * level], left_out + no_scale_u
        estimates[name] = mean_estimate(used, extra_u=terms, reason="; ".join(notes))
    return estimates


def _reason(video: RawVideo, scale: Scale, flag: NDArray[np.uint16], reasons: Counter[str]) -> str:
    n = len(flag)
    parts = []
    for bit, what in (
        (FrameFlag.UNREADABLE, "cannot be read"),
        (FrameFlag.NO_YARN, "show no yarn whose axis could be found"),
        (FrameFlag.SATURATED, "are saturated on the yarn"),
        (FrameFlag.OUTLIER, "are outliers and do not enter the means"),
    ):
        count = int(np.count_nonzero(flag & bit))
        if count:
            parts.append(f"{count} of {n} frames {what}")
    if reasons:
        text, _ = reasons.most_common(1)[0]
        parts.append(f"twist is not credible in {sum(reasons.values())} of {n} frames: {text}")
    if video.bits <= REDUCED_BITS:
        parts.append(f"the clip holds {video.bits} bits where the camera's depth is 12: the texture's depth is lost")
    if not math.isfinite(scale.relative_u):
        parts.append("the scale's uncertainty is not stated: u of diameter and twist lack it")
    return "; ".join(parts)


def _reduced(frame: Pixels) -> NDArray[np.uint8]:
    """Reduce a frame to at most THUMBNAIL_WIDTH columns and 8 bits, stretched to its range."""
    shrink = min(1.0, THUMBNAIL_WIDTH / frame.shape[1])
    image = cv2.resize(frame, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA).astype(np.float32)
    dark, bright = np.percentile(image, (0.5, 99.8))
    return np.clip((image - dark) * (255 / max(bright - dark, 1.0)), 0, 255).astype(np.uint8)


def _thumbnail(
    i: int, image: NDArray[np.uint8], shape: tuple[int, int], centre: Array, angle: float, diameter: float, twist: float
) -> Thumbnail:
    """A reduced frame of a clip with frames of `shape`, with what was measured in it; `diameter` in pixels."""
    shrink = image.shape[1] / shape[1]
    x, y = ((float(value) + 0.5) * shrink - 0.5 for value in centre)
    return Thumbnail(i, image, (x, y), float(angle), float(diameter) * shrink, float(twist))
