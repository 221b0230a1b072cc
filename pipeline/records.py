"""The records that flow through the pipeline, named by stage: frozen, SI inside, units in names only at the edges.

ingest → RawTension, RawVideo → measure → TensionMeasurement, YarnMeasurement, Measured → predict → Prediction
→ compare → Comparison. An array named `flag` runs parallel to the data and never edits it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntFlag, StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from models.outcome import Ends, Solution

Array = NDArray[np.float64]
Flags = NDArray[np.uint16]


class Quantity(StrEnum):
    """The three quantities that a model and the rig are compared in; the value is the field name at the edges."""

    TENSION_AB = "p3_AB_cN"
    TWIST_AB = "T_AB_tpm"
    THETA_B = "theta_B_deg"

    @property
    def per_si(self) -> float:
        """Edge units per SI unit: cN per N, turns per metre per 1/m, degrees per radian."""
        return {"p3_AB_cN": 100.0, "T_AB_tpm": 1.0, "theta_B_deg": math.degrees(1.0)}[self.value]

    @property
    def unit(self) -> str:
        """Unit at the edges."""
        return {"p3_AB_cN": "cN", "T_AB_tpm": "tpm", "theta_B_deg": "°"}[self.value]

    @property
    def field(self) -> str:
        """Its name in `Ends`."""
        return {"p3_AB_cN": "tension_AB", "T_AB_tpm": "twist_AB", "theta_B_deg": "theta_B"}[self.value]

    @property
    def symbol(self) -> str:
        """Symbol in the paper."""
        return {"p3_AB_cN": "p₃AB", "T_AB_tpm": "T_AB", "theta_B_deg": "θ_B"}[self.value]

    def of(self, ends: Ends) -> float:
        """This quantity of a solution, in SI."""
        return getattr(ends, self.field)


class TensionFlag(IntFlag):
    """What may be wrong with a tension sample."""

    MISSING = 1
    SATURATED = 2
    NEGATIVE = 4
    STUCK = 8
    SPIKE = 16
    TIME_BACKWARD_OR_DUPLICATE = 32
    AFTER_GAP = 64


class FrameFlag(IntFlag):
    """What may be wrong with a frame or with what was measured in it."""

    UNREADABLE = 1
    NO_YARN = 2
    SATURATED = 4
    TWIST_NOT_CREDIBLE = 8
    OUTLIER = 16
    REDUCED_DEPTH = 32
    DIAMETER_NOT_CREDIBLE = 64
    BENT = 128
    """The yarn is bent: its angle is that of its tangent in the middle of the length in view."""


@dataclass(frozen=True, slots=True)
class Source:
    """Where data came from: file name relative to the study, size, and SHA-256 of the bytes."""

    name: str
    sha256: str
    """Empty where it was not asked for."""
    size: int


@dataclass(frozen=True, slots=True)
class Estimate:
    """A measured mean with spread and standard uncertainty, in SI. NaN where it cannot be known; `reason` says why."""

    mean: float
    u: float = math.nan
    """Standard uncertainty of the mean (k = 1), all stated terms included."""
    cv: float = math.nan
    """Coefficient of variation of the samples, as a fraction."""
    n: int | None = None
    n_eff: float = math.nan
    """Number of independent samples that carry as much information as the n correlated ones."""
    reason: str = ""
    u_terms: Mapping[str, float] = field(default_factory=dict)
    """What u is made of, where it was put together here: the root of the sum of squares."""


@dataclass(frozen=True, slots=True)
class RawTension:
    """A tension log as read. `tension` is NaN where the file has no number; nothing else is altered."""

    source: Source
    layout: str
    unit_in_file: str
    time: Array
    """Time from the log's start [s], shape (n,)."""
    tension: Array
    """Yarn tension [N], shape (n,)."""
    flag: Flags
    """Bits of `TensionFlag`, shape (n,)."""
    resolution: float
    """Step of the instrument [N]; NaN where not stated."""
    calibration_u: float
    """Relative standard uncertainty of the calibration, as a fraction; NaN where not stated."""
    metadata: Mapping[str, str] = field(default_factory=dict)


class Frames(Protocol):
    """Frames read one at a time at full depth; constant memory whatever the length."""

    def __len__(self) -> int: ...

    def frame(self, index: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Frame `index`, shape (rows, columns), rows top-down as displayed.

        Raises
        ------
        pipeline.errors.InputError
            If this frame is truncated or corrupt; other frames stay readable.
        """
        ...


@dataclass(frozen=True, slots=True)
class RawVideo:
    """A clip as read, frames still on disk."""

    source: Source
    frames: Frames
    time: Array
    """Recording time of each frame [s], from the first frame, shape (n,)."""
    rate: float
    """Recording rate [1/s]."""
    bits: int
    """Significant bits of a pixel: full scale is 2**bits - 1."""
    shape: tuple[int, int]
    """Rows, columns."""
    metadata: Mapping[str, str] = field(default_factory=dict)
    sequential: bool = False
    """Whether a frame takes long to read unless it is the next one."""


@dataclass(frozen=True, slots=True)
class Scale:
    """Object scale of a camera set-up [m per pixel] with its relative standard uncertainty (a fraction)."""

    metres_per_pixel: float
    relative_u: float = math.nan


@dataclass(frozen=True, slots=True)
class CylinderAxis:
    """Direction of e_z [rad], counter-clockwise from +x as displayed, with its standard uncertainty [rad]."""

    angle: float
    u: float = math.nan


@dataclass(frozen=True, slots=True)
class SlopeRatio:
    """Twist that the slope of fibres, or of a tracer, tells over that by direct counting (ISO 2061), of one yarn."""

    value: float
    u: float
    """Standard uncertainty."""


@dataclass(frozen=True, slots=True)
class TensionMeasurement:
    """Tension statistics of one log, over the chosen window, with flagged samples left out of the statistics."""

    raw: RawTension
    window: tuple[float, float]
    """Start and end of the window [s]."""
    estimate: Estimate
    rate: float
    """Median sampling rate [1/s]."""
    drift: float
    """Slope of the least-squares line [N/s]."""
    gaps: tuple[tuple[float, float], ...]
    """Start and end [s] of each gap in the time stamps."""
    flag_counts: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Thumbnail:
    """A frame reduced for the contact sheet, with what was measured in it, in pixels of `image`."""

    frame: int
    image: NDArray[np.uint8]
    """Shape (rows, columns)."""
    centre: tuple[float, float]
    """A point (x, y) on the yarn axis [px]."""
    axis_angle: float
    """[rad], counter-clockwise from +x as displayed."""
    diameter: float
    """[px]"""
    twist: float
    """[1/m], NaN where not credible."""


@dataclass(frozen=True, slots=True)
class YarnMeasurement:
    """Angle, diameter and twist in every frame of one clip; arrays have shape (n,), NaN where flagged."""

    raw: RawVideo
    method: str
    axis_angle: Array
    """Yarn axis in [0, π) [rad], counter-clockwise from the image's +x axis as displayed."""
    theta: Array
    """θ_B = (cylinder axis − yarn axis) mod π [rad]; NaN where no cylinder axis was given."""
    twist: Array
    """Signed twist [1/m], Z > 0."""
    diameter: Array
    """[m]"""
    confidence: Array
    """0 (no yarn found) to 1."""
    flag: Flags
    """Bits of `FrameFlag`."""
    summary: Mapping[str, Estimate]
    """Keys 'axis_angle', 'theta_B', 'twist', 'diameter', 'unevenness', 'hairiness', 'helix_rotation', and 'rotation'
    where the yarn's speed was given."""
    handedness: str
    """'Z', 'S' or '' where twist is not credible."""
    reason: str
    """Why twist, or anything else, is not given; empty where all is given."""
    centre: Array
    """A point (x, y) on the yarn axis [px], shape (n, 2); NaN where no yarn was found."""
    hairiness: Array
    """Hairs that cross a line beside the yarn, per length [1/m], shape (n,); see measure/hairs.py."""
    helix_rotation: Array
    """Turns a second of the helix at a fixed place, until the next frame, right-handed about the direction of travel
    [1/s], shape (n,); NaN where not resolved or not looked at. See measure/rotation.py."""
    sagitta: Array
    """Of the yarn's axis over the length in view, to the right of its direction [m], shape (n,); 0 where it is straight
    as far as can be told."""
    unevenness: Array
    """Coefficient of variation of the diameter along the yarn in view, shape (n,); the fibres' texture counts as 0.01
    to 0.03. NaN for plied yarn."""
    thumbnails: tuple[Thumbnail, ...] = ()


@dataclass(frozen=True, slots=True)
class Measured:
    """What the rig says of one case. Published summaries have no logs and no clips."""

    case: str
    values: Mapping[Quantity, Estimate]
    diameter: Estimate | None = None
    tension: tuple[TensionMeasurement, ...] = ()
    yarn: tuple[YarnMeasurement, ...] = ()


@dataclass(frozen=True, slots=True)
class Prediction:
    """What a model says of one case, and how much the uncertain inputs matter."""

    case: str
    solution: Solution
    u_input: Ends
    """Standard uncertainty from the inputs' stated uncertainties, SI; NaN where none is stated or a solve failed."""
    wall: float
    """Median wall time of a warm solve [s]."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """One quantity of one case by one model against the measurement, in edge units (cN, tpm, °)."""

    case: str
    quantity: Quantity
    model: str
    M: float
    cv_percent: float
    S: float
    E: float
    """S − M, signed."""
    E_percent: float
    """|S − M| / |M| in %."""
    u_D: float
    u_num: float
    u_input: float
    u_val: float
    """√(u_num² + u_input² + u_D²), ASME V&V 20; terms that are not stated count as 0 and `missing_u` names them."""
    missing_u: tuple[str, ...]
    outcome: str
    message: str
    bound_percent: float
    """Largest E_percent that `yarnval check` accepts; NaN where the model is reported, not bounded."""
    bound_reason: str
    """Why this bound differs from the study's bound for the model; empty where it does not."""

    @property
    def bounded(self) -> bool:
        """Whether a bound was set."""
        return not math.isnan(self.bound_percent)

    @property
    def within(self) -> bool:
        """Whether the bound holds; a failed solve or a missing measurement is not within any bound."""
        return self.E_percent <= self.bound_percent


@dataclass(frozen=True, slots=True)
class Results:
    """Everything the report of one study says; `pipeline.store.to_tree` makes it the tree that the report reads."""

    name: str
    title: str
    source: str
    """Where the data come from, in words: a citation, a rig, a generator."""
    synthetic: bool
    """Whether the measured data were computed rather than measured."""
    notes: tuple[str, ...]
    fitted: str
    """Which parameters were fitted on which cases, in words; empty where none was."""
    measured: tuple[Measured, ...]
    predictions: tuple[Prediction, ...]
    comparisons: tuple[Comparison, ...]
    published: Mapping[str, Mapping[Quantity, tuple[float, float]]] = field(default_factory=dict)
    """By case and quantity: the source's own simulation in edge units and its stated error |E| / M in %."""
    provenance: Mapping[str, object] = field(default_factory=dict)
    """Inputs' SHA-256, versions, settings; anything that `json.dumps` takes."""
