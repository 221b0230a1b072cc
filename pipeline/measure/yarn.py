"""A clip to angle, diameter and twist of the yarn, frame by frame and as means with uncertainties.

Conventions, stated here and used everywhere:

- Frames are rows top-down. Angles are counter-clockwise from the image's +x axis *as displayed*; a yarn's axis has no
  direction, so its angle lies in [0, π).
- The frame is seen from outside the cylinder, e_z points along `cylinder_axis` as displayed, and the yarn travels to
  the right of e_z. So θ = (cylinder_axis − axis_angle) mod π, in (0, π): π/2 where the yarn crosses e_z squarely.
- A yarn that is tilted out of the image plane by τ shows its length shortened: its twist appears as T/cos τ, and its
  angle with e_z as θ' with cos θ = cos τ·cos θ'. One camera does not see τ; where its standard uncertainty is given,
  the root mean squares of these errors for a normal τ, √3/2·u² relative and √3/2·u²·|cot θ|, are terms of u.
- Twist is positive for Z: on the near face the fibres run like the stroke of the letter, from lower left to upper right
  when the yarn is vertical, which is a right-handed helix. Turning or travelling yarn, or the choice of one of the
  axis' two directions, does not change it; a mirrored image does.

Frames are measured in chunks of `CHUNK`, several at a time. A chunk's first frame is searched as a whole and the next
ones where the yarn was, so the numbers do not depend on how many threads there are. Each thread reads a frame just
before it measures it: a frame is as large as a processor's own memory, and fetching it from where another thread left
it takes as long as cutting the yarn out. Only clips that are decoded in order are read chunk by chunk, in the caller's
thread.

Outlying frames (a diameter or a twist more than 5 standard deviations of the bulk away from the median, each from the
median absolute deviation) keep their values and are flagged, but do not enter the means.
"""

import math
import os
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from threading import Lock

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pipeline.errors import InputError, nearest
from pipeline.measure.align import ALIGNED
from pipeline.measure.axis import MAX_GROOVE, MAX_MISFIT, MIN_AGREEMENT, YarnAxis, expected, find_axis
from pipeline.measure.clip_twist import MIN_CREDIBLE, clip_twist
from pipeline.measure.hairs import hairiness
from pipeline.measure.lines import Pixels, share_above
from pipeline.measure.outline import find_scallops, strands_seen
from pipeline.measure.plied import YarnFound, followed_plied, plied_yarn
from pipeline.measure.recurrence import Recurrence, recurrence
from pipeline.measure.rotation import helix_turn
from pipeline.measure.scatter import Face, face
from pipeline.measure.strands_fit import Picture
from pipeline.measure.tracer import tracer_twist
from pipeline.measure.twist import FrameTwist, most_blur, strand_slope, surface_twist
from pipeline.measure.uncertainty import mean_estimate
from pipeline.records import (
    Array,
    CylinderAxis,
    Estimate,
    FrameFlag,
    Frames,
    RawVideo,
    Scale,
    SlopeRatio,
    Thumbnail,
    YarnMeasurement,
)

METHODS = ("surface", "ply", "tracer")
"""Known ways to measure twist: the slope of the fibres on a single yarn's unrolled surface (`twist.py`), the period of
a plied yarn's strands, which also give its axis and diameter (`plied.py`, `pitch.py`), a tracer fibre
(`tracer.py`)."""

METHOD_U_ANGLE = math.radians(0.01)
METHOD_U_DIAMETER: Mapping[str, float] = {"surface": 0.003, "ply": 0.005, "tracer": 0.003}
"""Standard uncertainties of the method, common to all frames (diameter relative; of twist: `clip_twist.py`): the size
of the clip-mean errors on rendered yarn of 20 to 60 px, see benchmarks/measure_coverage.py and its accepted result.
There the diameters of 20 clips of plied yarn have a bias of 0.03 % and a scatter of 0.14 %, at most 0.37 %."""
METHOD_U_TURN = 0.4 / 360
"""Standard uncertainty of the helix' turn between two frames, common to a clip [turns]."""

FARTHEST_LIGHT = 1.3
"""Direction of the light from which on the far edge is not seen [rad]."""
MIN_STRAIGHT = 0.85
"""Least share of the blocks that agree about an axis without a credible diameter: what is neither round nor straight is
the edge of something else or no thing at all, and its angle is not that of a yarn."""
PAIRS = 100
"""Pairs of frames in a clip, about, that the helix' turn is looked at in."""
COUNTED = 200
"""Frames of a clip, at least, that hairs are counted in: neighbouring frames show the same ones."""
SCATTERED = 60
"""Frames of a clip, about, whose fibres' scatter is looked at, and which are looked at for a full turn."""
MIN_RESOLVED = 0.6
"""Share of the pairs looked at that must show a turn."""

UNSTATED: Mapping[str, str] = {
    "scale": "the scale's uncertainty",
    "axis": "the cylinder axis' uncertainty",
    "tilt": "the tilt out of the image plane",
}
"""What the terms of u are that a user may not have stated."""

OUTLYING = 5.0
SATURATED_SHARE = 0.01
"""Share of the yarn's pixels at full scale from which a frame is flagged."""
REDUCED_BITS = 8
"""Significant bits up to which a clip is flagged as reduced: exports lose the camera's 12 bits this way."""
CHUNK = 32
"""Frames measured one after another by one thread."""
THUMBNAILS = 6
THUMBNAIL_WIDTH = 480


@dataclass(frozen=True, slots=True)
class _Frame:
    """What was measured in one frame."""

    flag: FrameFlag
    axis: YarnAxis | None = None
    twist: FrameTwist | None = None
    hairs: float = math.nan
    """[1/px]; NaN where not counted."""
    turn: float = math.nan
    """Turn of the helix until the next frame [rad]; NaN where not resolved or not looked at."""
    face: tuple[Face, Recurrence | None] | None = None
    """The unrolled surface, and where its fibres return; None where not looked at."""
    doubt: str = ""
    """Why the diameter is not credible."""
    reduced: NDArray[np.uint8] | None = None
    """The frame for the contact sheet, where it is to be there."""
    strands: int | None = None
    """Count of the strands that the outline of what was measured as a single yarn tells, 0 for none; None where not
    looked at."""


class _Clip:
    """What was found in a clip's frames, in pixels, arrays of shape (n,) but `centre`, (n, 2); NaN where nothing."""

    def __init__(self, n: int):
        self.angle, self.twist, self.u_twist, self.diameter = (np.full(n, np.nan) for _ in range(4))
        self.hairs, self.turn, self.sagitta, self.uneven = (np.full(n, np.nan) for _ in range(4))
        self.centre = np.full((n, 2), np.nan)
        self.confidence, self.flag, self.one_pass = np.zeros(n), np.zeros(n, np.uint16), np.zeros(n, bool)
        self.reasons, self.doubts = Counter[str](), Counter[str]()
        self.images: dict[int, NDArray[np.uint8]] = {}
        self.misfits: list[float] = []
        self.faces: list[tuple[Face, Recurrence | None]] = []
        self.strands: list[int] = []

    def put(self, i: int, found: _Frame) -> None:
        """Take over frame i."""
        self.flag[i] = found.flag
        if found.axis is None or found.twist is None:
            return
        axis = found.axis
        self.centre[i], self.angle[i], self.twist[i] = axis.centre, axis.angle, found.twist.per_pixel
        self.u_twist[i], self.hairs[i], self.turn[i] = found.twist.u, found.hairs, found.turn
        self.sagitta[i], self.one_pass[i] = _sagitta(axis), found.twist.one_pass
        if found.face is not None:
            self.faces.append(found.face)
        if found.strands is not None:
            self.strands.append(found.strands)
        if found.doubt:
            self.doubts[found.doubt] += 1
        else:
            self.diameter[i], self.uneven[i] = axis.diameter, axis.uneven
            self.misfits.append(axis.misfit)
        self.confidence[i] = axis.agreement * (0.5 + 0.5 * min(1.0, found.twist.coherence) * (not found.twist.reason))
        if found.twist.reason:
            self.reasons[found.twist.reason] += 1
        if found.reduced is not None:
            self.images[i] = found.reduced

    def drop_chance_diameters(self) -> None:
        """Leave no diameter where few of the frames with yarn have a credible one."""
        seen = np.isfinite(self.angle)
        if np.count_nonzero(np.isfinite(self.diameter)) < MIN_CREDIBLE * np.count_nonzero(seen):
            self.diameter[:] = math.nan
            self.flag[seen] |= np.uint16(FrameFlag.DIAMETER_NOT_CREDIBLE)

    def refuse_plied(self) -> None:
        """Leave neither diameter nor twist of a yarn that was measured as a single one and has a plied one's outline.

        Its strands' slope is no single yarn's twist, and its outline is not that of one cylinder.
        """
        plied = [count for count in self.strands if count]
        if not plied or 2 * len(plied) < len(self.strands):
            return
        seen = np.isfinite(self.angle)
        count, _ = Counter(plied).most_common(1)[0]
        why = f"the outline is that of a plied yarn, of {count} strands as it seems"
        self.twist[:], self.diameter[:] = math.nan, math.nan
        self.flag[seen] |= np.uint16(FrameFlag.DIAMETER_NOT_CREDIBLE)
        self.reasons, self.doubts = (Counter({why: int(np.count_nonzero(seen))}) for _ in range(2))


@dataclass(frozen=True, slots=True)
class _Wanted:
    """What is looked at in some frames of a chunk only, by their places in it."""

    shots: set[int]
    """Those that go on the contact sheet, and whose outline is looked at."""
    counted: set[int]
    """Those whose hairs are counted."""
    unrolled: set[int]
    """Those whose fibres' scatter is looked at, and which are looked at for a full turn."""
    pairs: NDArray[np.bool_]
    """Whether the turn until the next frame is looked at, shape (frames,)."""


def measure_yarn(
    video: RawVideo,
    scale: Scale,
    *,
    cylinder_axis: CylinderAxis | None,
    u_tilt: float = math.nan,
    ratio: SlopeRatio | None = None,
    method: str = "surface",
    plies: int | None = None,
    speed: float | None = None,
    threads: int | None = None,
) -> YarnMeasurement:
    """Measure the yarn in every frame of a clip; a few frames, or chunks of them, are held in memory at a time.

    Parameters
    ----------
    video : the clip, n frames.
    scale : object scale; without its uncertainty the means' u lack that term, and `reason` says so.
    cylinder_axis : direction of e_z; without it θ is NaN, without its uncertainty θ's u lacks that term, and its
        reason says so.
    u_tilt : standard uncertainty of the yarn's tilt out of the image plane [rad]; without it the u of twist and θ lack
        that term, and their reasons say so.
    ratio : of the slope on this kind of yarn, where it was compared with direct counting; not for the method 'ply'.
    method : one of `METHODS`.
    plies : strands of a plied yarn, for the method 'ply', at least 2.
    speed : of the yarn along its axis [m/s]; with it the summary holds its rotation.
    threads : how many measure at once; as many as there are processors if not given. The numbers do not depend on it.

    Raises
    ------
    InputError
        If the method is not known or lacks its number of plies, or if the scale is not a positive number. Frames that
        cannot be read are flagged.
    """
    _check_call(method, plies, scale, ratio)
    n = len(video.frames)
    found = _Clip(n)
    for i, frame in enumerate(_measure_frames(video, method, plies or 1, threads or os.cpu_count() or 1)):
        found.put(i, frame)
    found.drop_chance_diameters()
    found.refuse_plied()
    angle, centre, turn, flag, reasons = found.angle, found.centre, found.turn, found.flag, found.reasons
    whole = clip_twist(found.twist, found.u_twist, found.one_pass, np.isfinite(angle), found.faces, method, ratio)
    reasons.update(whole.left_out)
    flag[np.isfinite(angle) & np.isnan(whole.per_pixel)] |= np.uint16(FrameFlag.TWIST_NOT_CREDIBLE)
    twist = whole.per_pixel / scale.metres_per_pixel
    diameter, hairs = found.diameter * scale.metres_per_pixel, found.hairs / scale.metres_per_pixel
    if video.bits <= REDUCED_BITS:
        flag |= np.uint16(FrameFlag.REDUCED_DEPTH)
    flag[_outlying(diameter) | _outlying(twist)] |= np.uint16(FrameFlag.OUTLIER)
    e_z = None if cylinder_axis is None else cylinder_axis.angle
    theta = np.mod(e_z - angle, math.pi) if e_z is not None else np.full(n, np.nan)
    kept = (flag & FrameFlag.OUTLIER) == 0
    # what the profile's model leaves unexplained counts against the diameter
    misfit = float(np.median(found.misfits or [0.0]))
    u_diameter = math.hypot(METHOD_U_DIAMETER[method], misfit)
    foreshortened = math.sqrt(3) / 2 * u_tilt**2
    scaled = {"scale": scale.relative_u}
    summary = {
        "axis_angle": _mean(_unwrapped(angle), kept, {"method": METHOD_U_ANGLE}),
        "theta_B": Estimate(math.nan, n=0, reason="no cylinder axis was given"),
        "twist": _mean(
            twist, kept, {**whole.relative_u, **scaled, "tilt": foreshortened}, relative=True, note=whole.note
        ),
        "diameter": _mean(diameter, kept, {"method": u_diameter, **scaled}, relative=True),
    }
    if cylinder_axis is not None:
        middle = _middle(theta)
        cotangent = abs(math.cos(middle)) / max(math.sin(middle), 1e-9)
        # a yarn along e_z is seen as such, and is off by the tilt itself
        terms = {"method": METHOD_U_ANGLE, "axis": cylinder_axis.u, "tilt": min(foreshortened * cotangent, u_tilt)}
        summary["theta_B"] = _mean(_unwrapped(theta), kept, terms)
    uneven = "along the yarn in view; of even yarn 1 to 3 % by texture"
    summary["unevenness"] = mean_estimate(found.uneven, reason=uneven)
    summary["hairiness"] = mean_estimate(hairs, reason="crossings beside the yarn: not a standard's hairiness")
    rotation = _rotation(video.time, turn, angle, e_z)
    summary["helix_rotation"] = _mean_rotation(rotation, video.rate)
    if speed is not None:
        summary["rotation"] = _yarn_rotation(summary["helix_rotation"], summary["twist"], speed)
    mean_twist = summary["twist"].mean
    return YarnMeasurement(
        raw=video,
        method=method,
        axis_angle=angle,
        theta=theta,
        twist=twist,
        diameter=diameter,
        confidence=found.confidence,
        flag=flag,
        summary=summary,
        handedness="" if math.isnan(mean_twist) else "Z" if mean_twist > 0 else "S",
        centre=centre,
        hairiness=hairs,
        helix_rotation=rotation,
        sagitta=found.sagitta * scale.metres_per_pixel,
        unevenness=found.uneven,
        reason=_reason(video, scale, flag, reasons, found.doubts),
        thumbnails=tuple(
            _thumbnail(i, image, video.shape, centre[i], angle[i], diameter[i] / scale.metres_per_pixel, twist[i])
            for i, image in found.images.items()
        ),
    )


def _check_call(method: str, plies: int | None, scale: Scale, ratio: SlopeRatio | None) -> None:
    if method not in METHODS:
        raise InputError("method", f"'{method}' is not known", nearest(method, list(METHODS)))
    if (method == "ply") != (plies is not None) or (plies is not None and plies < 2):
        raise InputError("plies", f"{plies} with the method '{method}'", "2 or more with the method 'ply', else none")
    if ratio is not None and (method == "ply" or not (ratio.value > 0 and ratio.u >= 0)):
        found = f"{ratio.value:g} with u {ratio.u:g} and the method '{method}'"
        raise InputError("slope ratio", found, "a positive number with its u, not for the method 'ply'")
    if not (math.isfinite(scale.metres_per_pixel) and scale.metres_per_pixel > 0):
        raise InputError(
            "scale", f"{scale.metres_per_pixel:g} m per pixel", "a positive number: without it nothing is in mm"
        )


def measure_json(measurement: YarnMeasurement) -> dict[str, object]:
    """Return the document of `yarnval measure --json`: edge units (°, tpm, mm), null where a number is not known."""
    summary = {}
    for key, name, unit in (
        ("theta_B", "theta_B_deg", math.degrees(1)),
        ("axis_angle", "axis_angle_deg", math.degrees(1)),
        ("twist", "twist_tpm", 1.0),
        ("diameter", "diameter_mm", 1e3),
        ("unevenness", "diameter_cv_along_yarn_percent", 100.0),
        ("hairiness", "hairiness_per_m", 1.0),
        ("helix_rotation", "helix_rotation_per_s", 1.0),
        ("rotation", "rotation_per_s", 1.0),
    ):
        if key not in measurement.summary or (key == "theta_B" and not np.any(np.isfinite(measurement.theta))):
            continue
        estimate = measurement.summary[key]
        summary[name] = {
            "mean": _number(estimate.mean * unit),
            "cv_percent": _number(estimate.cv * 100),
            "n": estimate.n,
            "n_eff": _number(estimate.n_eff),
            "u": _number(estimate.u * unit),
            "u_terms": {name: u * unit for name, u in estimate.u_terms.items()},
            "reason": estimate.reason,
        }
    return {
        "clip": dict(measurement.raw.metadata),
        "frames": len(measurement.flag),
        "fps": _number(measurement.raw.rate),
        "time_s": _numbers(measurement.raw.time),
        "axis_angle_deg": _numbers(np.degrees(measurement.axis_angle)),
        "twist_tpm": _numbers(measurement.twist),
        "diameter_mm": _numbers(measurement.diameter * 1e3),
        "sagitta_mm": _numbers(measurement.sagitta * 1e3),
        "diameter_cv_along_yarn_percent": _numbers(measurement.unevenness * 100),
        "hairiness_per_m": _numbers(measurement.hairiness),
        "helix_rotation_per_s": _numbers(measurement.helix_rotation),
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


def _measure_frames(video: RawVideo, method: str, plies: int, threads: int) -> Iterator[_Frame]:
    """Yield what is found in each frame, in order; at most `threads` + 2 chunks are under way at a time."""
    n = len(video.frames)
    shots = set(np.linspace(0, n - 1, THUMBNAILS).round().astype(int).tolist())
    looked_at, spaced = _looked_at(n), (max(1, n // COUNTED), max(1, n // SCATTERED))
    read = _locked(video.frames)
    with _one_thread_each(), ThreadPoolExecutor(threads) as pool:
        running: deque[Future[list[_Frame]]] = deque()
        for start in range(0, n, CHUNK):
            places = range(start, min(start + CHUNK, n))
            frames = map(read, places)
            if video.sequential:
                frames = iter([*frames])
            counted, unrolled = ({i - start for i in places if i % every == 0} for every in spaced)
            wanted = _Wanted({i - start for i in shots}, counted, unrolled, looked_at[start : start + CHUNK])
            running.append(pool.submit(_measure_chunk, frames, video.bits, method, plies, wanted))
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


def _locked(frames: Frames) -> Callable[[int], Pixels | None]:
    """Return what reads a frame by its number, one at a time whichever thread asks; None where it cannot be read."""
    lock = Lock()

    def read(index: int) -> Pixels | None:
        try:
            with lock:
                return frames.frame(index)
        except InputError:
            return None

    return read


def _looked_at(n: int) -> NDArray[np.bool_]:
    """Say for which of n frames the helix' turn until the next is looked at: both are in one chunk."""
    chosen = np.arange(n) % CHUNK % max(1, n // PAIRS) == 0
    return chosen & (np.arange(n) % CHUNK < CHUNK - 1) & (np.arange(n) < n - 1)


def _sagitta(axis: YarnAxis) -> float:
    """Return the sagitta of an axis over the length in view, to its right [px]."""
    return axis.bend * axis.length**2 / 8


def _yarn(image: Pixels, axis: YarnAxis, method: str, plies: int, before: Picture | None) -> YarnFound:
    """Measure the yarn on an axis; `before` is the picture of a plied yarn in the frame before."""
    if method == "ply":
        return plied_yarn(image, axis, plies, before)
    doubt = _doubt(axis)
    if axis.agreement < (MIN_STRAIGHT if doubt else MIN_AGREEMENT):
        return YarnFound(None, FrameTwist(math.nan, 0.0, 0.0, ""), doubt)
    twist = tracer_twist(image, axis) if method == "tracer" else surface_twist(image, axis)
    if doubt and method == "surface" and not twist.reason:  # its surface is unrolled by the diameter
        twist = replace(twist, per_pixel=math.nan, reason=doubt)
    return YarnFound(axis, twist, doubt)


def _doubt(axis: YarnAxis) -> str:
    """Say why the diameter is not credible; empty where it is."""
    radius = axis.diameter / 2
    limit = most_blur(radius)
    if axis.blur > limit:
        return f"the edges are blurred over {axis.blur:.1f} px: at most {limit:.1f} px at this diameter"
    if abs(axis.light) > FARTHEST_LIGHT:
        angle = math.degrees(abs(axis.light))
        if angle > 90:  # more than a lamp in front of the yarn can do
            return "one of the edges hardly stands out from the background"
        return f"the light comes from {angle:.0f}° beside the camera: the far edge is in the dark"
    if axis.groove > MAX_GROOVE:
        return f"a groove, {100 * axis.groove:.0f} % deep, runs along the yarn: something else lies beside it"
    if axis.misfit > MAX_MISFIT:
        return f"the profile is not that of a round body: {100 * axis.misfit:.0f} % of its height is left unexplained"
    return ""


def _measure_chunk(
    frames: Iterator[Pixels | None],
    bits: int,
    method: str,
    plies: int,
    wanted: _Wanted,
) -> list[_Frame]:
    """Measure successive frames, each read when its turn comes; None where one cannot be read."""
    found: list[_Frame] = []
    followed, before, seen, picture = None, None, None, None
    for i, frame in enumerate(frames):
        last, seen = seen, None
        if frame is None:
            found.append(_Frame(FrameFlag.UNREADABLE))
            continue
        where = followed if followed is None or before is None else expected(followed, before)
        before = followed
        yarn = None if where is None or picture is None else followed_plied(frame, where, plies, picture)
        followed = find_axis(frame, where) if yarn is None else yarn.axis
        if yarn is None and followed is not None:
            yarn = _yarn(frame, followed, method, plies, picture)
        picture = None if yarn is None else yarn.picture
        if yarn is None or yarn.axis is None:
            found.append(_Frame(FrameFlag.NO_YARN))
            continue
        axis, twist, doubt = yarn.axis, yarn.twist, yarn.doubt
        flag = FrameFlag.TWIST_NOT_CREDIBLE if twist.reason else FrameFlag(0)
        if abs(_sagitta(axis)) > ALIGNED:
            flag |= FrameFlag.BENT
        if doubt:
            flag |= FrameFlag.DIAMETER_NOT_CREDIBLE
        if _saturated(frame, axis, bits):
            flag |= FrameFlag.SATURATED
        if last is not None and not doubt:
            turn = helix_turn(last[0], frame, (last[1], axis), last[2])
            found[-1] = replace(found[-1], turn=turn)
        if wanted.pairs[i] and math.isfinite(twist.per_pixel) and not doubt:
            seen = frame, axis, twist.per_pixel
        crossings = hairiness(frame, axis) if i in wanted.counted else math.nan
        surface = None
        if method == "surface" and i in wanted.unrolled and math.isfinite(twist.per_pixel):
            seen_face = face(frame, axis, twist.per_pixel)
            surface = seen_face, recurrence(seen_face)
        reduced, strands = None, None
        if i in wanted.shots:
            reduced = _reduced(frame)
            strands = None if method == "ply" else strands_seen(find_scallops(frame, axis), strand_slope(frame, axis))
        found.append(_Frame(flag, axis, twist, crossings, face=surface, doubt=doubt, reduced=reduced, strands=strands))
    return found


def _rotation(time: Array, turn: Array, angle: Array, cylinder_axis: float | None) -> Array:
    """Return the helix' turns a second until the next frame, about the direction of travel, shape (n,).

    The yarn travels to the right of e_z; where that is not given, in the direction of the axis' mean angle in [0, π).
    """
    rate = turn / (2 * math.pi * np.append(np.diff(time), np.nan))
    travel = _unwrapped(angle)
    if cylinder_axis is not None:  # θ in (0, π) makes e_z − θ the direction of travel
        travel = cylinder_axis - np.mod(cylinder_axis - angle, math.pi)
    # the axis' angle is that direction or the opposite
    return rate * np.where(np.cos(travel - angle) > 0, 1, -1)


def _mean_rotation(rotation: Array, rate: float) -> Estimate:
    looked = int(np.count_nonzero(_looked_at(rotation.size)))
    known = int(np.count_nonzero(np.isfinite(rotation)))
    if known < max(2, MIN_RESOLVED * looked):
        why = f"the surface was seen again in {known} of {looked} pairs of frames: it turned or travelled too far"
        return Estimate(math.nan, n=known, reason=why)
    alias = f"what turns by a further whole turn between frames ({rate:g} turns a second) looks the same"
    return mean_estimate(rotation, extra_u={"method": METHOD_U_TURN * rate}, reason=alias)


def _yarn_rotation(helix: Estimate, twist: Estimate, speed: float) -> Estimate:
    """Rotation of the yarn [1/s], right-handed about its travel: what the helix turns and what travels through it."""
    mean = helix.mean + speed * twist.mean
    terms = {"helix": helix.u, "twist": abs(speed) * twist.u}
    reason = helix.reason or twist.reason
    return Estimate(mean, math.hypot(*terms.values()), n=helix.n, n_eff=helix.n_eff, reason=reason, u_terms=terms)


def _saturated(frame: Pixels, axis: YarnAxis, bits: int) -> bool:
    """Say whether more than `SATURATED_SHARE` of the yarn's pixels are at full scale."""
    share = share_above(frame, *axis.centre, axis.angle, axis.bend, axis.diameter / 2, axis.length, 2**bits - 1)
    return share > SATURATED_SHARE


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


def _middle(angles: Array) -> float:
    """Mean direction of axes in [0, π)."""
    good = angles[np.isfinite(angles)]
    return (0.5 * float(np.angle(np.exp(2j * good).sum())) if good.size else 0.0) % math.pi


def _unwrapped(angles: Array) -> Array:
    """Shift angles of axes by multiples of π to within π/2 of their mean direction."""
    middle = _middle(angles)
    return middle + np.mod(angles - middle + math.pi / 2, math.pi) - math.pi / 2


def _mean(
    values: Array, kept: NDArray[np.bool_], terms: Mapping[str, float], *, relative: bool = False, note: str = ""
) -> Estimate:
    """Estimate a clip's mean from the frames kept; `terms` of u that are NaN are not stated, and the reason says so."""
    used = np.where(kept, values, np.nan)
    if relative:
        level = abs(float(np.nanmean(used))) if np.any(np.isfinite(used)) else 0.0
        terms = {what: u * level for what, u in terms.items()}
    dropped = int(np.count_nonzero(~kept))
    notes = [note] if note else []
    notes += [f"{dropped} outlying frames left out"] if dropped else []
    notes += [f"{UNSTATED[what]} is not stated and not in u" for what, u in terms.items() if math.isnan(u)]
    return mean_estimate(used, extra_u=terms, reason="; ".join(notes))


def _reason(
    video: RawVideo, scale: Scale, flag: NDArray[np.uint16], reasons: Counter[str], doubts: Counter[str]
) -> str:
    n = len(flag)
    parts = []
    for bit, what in (
        (FrameFlag.UNREADABLE, "cannot be read"),
        (FrameFlag.NO_YARN, "show no yarn whose axis could be found"),
        (FrameFlag.SATURATED, "are saturated on the yarn"),
        (FrameFlag.BENT, "show a bent yarn: its angle is that of the tangent in the middle of the length in view"),
        (FrameFlag.OUTLIER, "are outliers and do not enter the means"),
    ):
        count = int(np.count_nonzero(flag & bit))
        if count:
            parts.append(f"{count} of {n} frames {what}")
    if reasons:
        text, _ = reasons.most_common(1)[0]
        parts.append(f"twist is not credible in {sum(reasons.values())} of {n} frames: {text}")
    if doubts:
        text, _ = doubts.most_common(1)[0]
        parts.append(f"the diameter is not credible in {sum(doubts.values())} of {n} frames: {text}")
    if video.bits <= REDUCED_BITS:
        parts.append(f"the clip holds {video.bits} bits, a high-speed camera gives 12: the texture's depth is reduced")
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
