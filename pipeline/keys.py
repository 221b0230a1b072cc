"""The keys that users write: what study.toml, case.toml and a prediction table may hold. Units stand in the keys."""

import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from models.scene import Scene
from pipeline.errors import InputError, nearest
from pipeline.records import Estimate, Quantity


class Keys(BaseModel):
    """Keys that are all known, finite and not changed after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, str_strip_whitespace=True)


class Uncertain(Keys):
    """A number and, where known, its uncertainty: 902, {value = 902, cv_percent = 14.55} or {value = 5, u = 0.1}."""

    value: float
    cv_percent: Annotated[float, Field(ge=0)] | None = None
    """Coefficient of variation, taken as the relative standard uncertainty."""
    u: Annotated[float, Field(ge=0)] | None = None
    """Standard uncertainty in the unit of the value."""

    @model_validator(mode="after")
    def _one_uncertainty(self) -> "Uncertain":
        if self.cv_percent is not None and self.u is not None:
            raise ValueError("both cv_percent and u are given: give one")
        return self

    @property
    def standard_uncertainty(self) -> float:
        """In the unit of the value; NaN where none is given."""
        if self.u is not None:
            return self.u
        return abs(self.value) * self.cv_percent / 100 if self.cv_percent is not None else math.nan


def _number_or_table(given: Any) -> Any:
    if isinstance(given, int | float) and not isinstance(given, bool):
        return {"value": given}
    if not isinstance(given, dict | Uncertain):
        raise ValueError("give a number, {value, cv_percent} or {value, u}")
    return given


Number = Annotated[Uncertain, BeforeValidator(_number_or_table)]


class SceneKeys(Keys):
    """The keys of `predict`, in a table's columns and in case.toml."""

    phi_deg: Number
    r0_mm: Number
    d_mm: Number
    mu: Number
    T_CD_tpm: Number
    p3_CD_cN: Number
    K_Nm2: Number
    v_m_s: Number
    vb_over_v: Number
    k: Number = Uncertain(value=1)
    eta: Number = Uncertain(value=1)
    lAB_over_lCD: Number = Uncertain(value=1)
    B_over_K: Number = Uncertain(value=1.3)
    tex: Number | None = None
    E_note: str | None = None

    def scene(self) -> Scene:
        """The scene in SI.

        Raises
        ------
        ValueError
            If a value has no physical meaning; the message names the key as the user wrote it.
        """
        return _scene({key: getattr(self, key).value for key in _SCENE_FIELDS}, _SCENE_FIELDS)

    def uncertainties(self) -> Mapping[str, float]:
        """The standard uncertainties that are given, in SI, by the scene's field names."""
        found = {
            field: getattr(self, key).standard_uncertainty * to_si for key, (field, to_si) in _SCENE_FIELDS.items()
        }
        return {field: u for field, u in found.items() if math.isfinite(u)}


def _scene(given: Mapping[str, float], keys: Mapping[str, tuple[str, float]], **fixed: float) -> Scene:
    """The scene of values by key; a value without meaning is a ValueError that names the key as the user wrote it."""
    try:
        return Scene(**fixed, **{field: given[key] * to_si for key, (field, to_si) in keys.items()})
    except ValueError as error:
        field = str(error).split(" = ", 1)[0]
        key = next(key for key, (name, _) in keys.items() if name == field)
        right = str(error).split(": ", 1)[1]
        raise ValueError(f"{key} = {given[key]:g}: {right}") from None


_SCENE_FIELDS: Mapping[str, tuple[str, float]] = {
    "phi_deg": ("wrap_angle", math.radians(1)),
    "r0_mm": ("cylinder_radius", 1e-3),
    "d_mm": ("yarn_radius", 0.5e-3),
    "mu": ("friction", 1.0),
    "T_CD_tpm": ("twist_CD", 1.0),
    "p3_CD_cN": ("tension_CD", 1e-2),
    "K_Nm2": ("torsional_rigidity", 1.0),
    "v_m_s": ("delivery_speed", 1.0),
    "vb_over_v": ("cylinder_speed_ratio", 1.0),
    "k": ("twist_trapping", 1.0),
    "eta": ("twist_congestion", 1.0),
    "lAB_over_lCD": ("span_ratio", 1.0),
    "B_over_K": ("rigidity_ratio", 1.0),
}
"""Key → field of `Scene` and SI units per unit of the key. The yarn's diameter becomes its radius here."""


class MeasuredKeys(Keys):
    """One quantity of a published summary."""

    mean: float
    cv_percent: Annotated[float, Field(ge=0)] | None = None
    n: Annotated[int, Field(ge=2)] | None = None
    u: Annotated[float, Field(ge=0)] | None = None

    def estimate(self, quantity: Quantity) -> Estimate:
        """In SI. Without a number of readings the standard deviation stands for u, and the reason says so."""
        cv = self.cv_percent / 100 if self.cv_percent is not None else math.nan
        deviation = abs(self.mean) * cv
        if self.u is not None:
            u, reason = self.u, ""
        elif self.n is not None:
            u, reason = deviation / math.sqrt(self.n), ""
        elif self.cv_percent is not None:
            u, reason = deviation, "number of readings not published: the standard deviation stands for u of the mean"
        else:
            u, reason = math.nan, "CV not published"
        return Estimate(self.mean / quantity.per_si, u / quantity.per_si, cv, self.n, reason=reason)


class PublishedKeys(Keys):
    """One quantity of the source's own simulation."""

    S: float
    E_percent: float | None = None


class TensionKeys(Keys):
    """A tension log and how to read it."""

    file: str
    profile: str = "plain-csv"
    channel: str | None = None


class RawKeys(Keys):
    """[raw]: files and the camera set-up."""

    tension: list[str | TensionKeys] = []
    video: list[str] = []
    scale_um_per_px: Number | None = None
    scale_from_diameter_mm: Annotated[float, Field(gt=0)] | None = None
    """Diameter of the cylinder, whose two edges then give the scale, and the axis unless that is given."""
    scale_image: str | None = None
    """Image or clip with that cylinder, where it is not in the first video."""
    fps: Annotated[float, Field(gt=0)] | None = None
    bits: Annotated[int, Field(ge=1, le=16)] | None = None
    axis_deg: Number | None = None
    """Direction of the cylinder axis as displayed."""
    tilt_u_deg: Annotated[float, Field(ge=0, lt=45)] | None = None
    """Standard uncertainty of the yarn's tilt out of the image plane."""
    slope_ratio: Number | None = None
    """Twist by the slope of fibres, or of a tracer, over that by direct counting, of this kind of yarn."""
    method: Literal["surface", "ply", "tracer"] = "surface"
    plies: Annotated[int, Field(ge=2, le=12)] | None = None
    """Strands of a plied yarn, for the method 'ply'."""

    @model_validator(mode="after")
    def _one_scale(self) -> "RawKeys":
        if self.scale_um_per_px is not None and self.scale_from_diameter_mm is not None:
            raise ValueError("the scale is given twice: leave scale_um_per_px or scale_from_diameter_mm out")
        if self.scale_image is not None and self.scale_from_diameter_mm is None:
            raise ValueError("'scale_image' without 'scale_from_diameter_mm': give the diameter of the cylinder in it")
        if (self.method == "ply") != (self.plies is not None):
            raise ValueError("give 'plies', 2 or more, with method = 'ply' and only with it")
        ratio = self.slope_ratio
        if ratio is not None and not (ratio.value > 0 and math.isfinite(ratio.standard_uncertainty)):
            raise ValueError("give 'slope_ratio' as {value, u} or {value, cv_percent}, its value greater than 0")
        if ratio is not None and self.method == "ply":
            raise ValueError("'slope_ratio' is for the slope of fibres, not for method = 'ply': leave it out")
        return self


class CaseKeys(SceneKeys):
    """case.toml."""

    note: str | None = None
    measured: dict[str, MeasuredKeys] | None = None
    published: dict[str, PublishedKeys] = {}
    raw: RawKeys | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "CaseKeys":
        if (self.measured is None) == (self.raw is None):
            raise ValueError("give either [measured] (a published summary) or [raw] (files), not both or neither")
        return self


class ExceptionKeys(Keys):
    """A bound that differs from the study's, with the reason."""

    case: str
    model: str
    quantity: str
    bound_percent: Annotated[float, Field(gt=0)]
    reason: Annotated[str, Field(min_length=20)]


class FittedKeys(Keys):
    """Which parameters were fitted on which cases."""

    parameters: list[str] = []
    cases: list[str] = []


Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
"""A study's or a case's name is also a folder's."""


class StudyKeys(Keys):
    """study.toml."""

    name: Name
    title: str
    source: str
    synthetic: bool
    notes: list[str] = []
    cases: Annotated[list[Name], Field(min_length=1)]
    models: Annotated[list[str], Field(min_length=1)] = ["flexible", "cosserat", "cosserat-fd", "kirchhoff"]
    bounds: dict[str, dict[str, Annotated[float, Field(gt=0)]]] = {
        "cosserat": {quantity.value: 10.0 for quantity in Quantity}
    }
    exceptions: list[ExceptionKeys] = []
    fitted: FittedKeys = FittedKeys()


StrictNumber = Annotated[float, Field(strict=True)]
"""A number that is written as one: no string, no boolean."""


class DimensionlessKeys(Keys):
    """A scene in the paper's normalised numbers: lengths in r₀, forces in K/r₀², speeds in v (Eq. 17)."""

    phi_deg: StrictNumber
    mu: StrictNumber
    R0_bar: StrictNumber
    T_CD_bar: StrictNumber
    p3_CD_bar: StrictNumber
    vb_over_v: StrictNumber
    k: StrictNumber = 1
    eta: StrictNumber = 1
    lAB_over_lCD: StrictNumber = 1
    B_over_K: StrictNumber = 1.3

    def scene(self) -> Scene:
        """The scene with r₀ = K = v = 1, whose SI numbers are the normalised ones.

        Raises
        ------
        ValueError
            As `SceneKeys.scene`.
        """
        return _scene(dict(self), _DIMENSIONLESS_FIELDS, cylinder_radius=1, torsional_rigidity=1, delivery_speed=1)


_DIMENSIONLESS_FIELDS: Mapping[str, tuple[str, float]] = {
    "R0_bar": ("yarn_radius", 1.0),
    "T_CD_bar": ("twist_CD", 1.0),
    "p3_CD_bar": ("tension_CD", 1.0),
} | {
    key: _SCENE_FIELDS[key] for key in ("phi_deg", "mu", "vb_over_v", "k", "eta", "lAB_over_lCD", "B_over_K")
}  # fmt: skip
"""Key → field of `Scene` and SI units per unit of the key."""


class SetKeys(Keys):
    """One pair of propagation coefficients, with its origin in words."""

    name: Annotated[str, Field(min_length=1)]
    k: StrictNumber
    eta: StrictNumber
    note: str


class ParameterKeys(Keys):
    """One parameter study: a key of the scene and the values that it takes."""

    name: Annotated[str, Field(min_length=1)]
    parameter: str
    values: Annotated[list[StrictNumber], Field(min_length=1)]
    figure: Name
    paths: bool = False
    """Whether the yarn's path on the cylinder is drawn for each value."""
    note: str = ""


class QuotedKeys(Keys):
    """A number that the source gives for one value of one study."""

    study: str
    value: StrictNumber
    quantity: str
    published: StrictNumber
    where: str = ""


class SweepKeys(Keys):
    """A sweep file."""

    name: Name
    title: str
    source: str
    notes: list[str] = []
    models: Annotated[list[str], Field(min_length=1)]
    source_model: str
    """The model that the figures show and the quoted numbers are of."""
    scene: dict[str, Any] | None = None
    """Keys of `SceneKeys`."""
    dimensionless: dict[str, Any] | None = None
    """Keys of `DimensionlessKeys`."""
    sets: Annotated[list[SetKeys], Field(min_length=1)]
    studies: Annotated[list[ParameterKeys], Field(min_length=1)]
    relation_figure: Name | None = None
    """Name of the figure of bending against torsional moment, if it is wanted."""
    quoted: list[QuotedKeys] = []

    @model_validator(mode="after")
    def _one_base(self) -> "SweepKeys":
        if (self.scene is None) == (self.dimensionless is None):
            raise ValueError("give the base scene as [scene] (SI keys) or as [dimensionless], not both or neither")
        return self


Validated = TypeVar("Validated", bound=Keys)


_STUDY_FILES = "a study needs study.toml, and case.toml in each case's folder"


def read_toml(file: Path, missing: str = _STUDY_FILES) -> dict[str, Any]:
    """Read a TOML file; `missing` says what to give where there is none.

    Raises
    ------
    InputError
        If it is missing, unreadable or not TOML; the message keeps the parser's line number.
    """
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(file, "no such file", missing) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(file, f"not TOML: {error}", "mend that line (UTF-8 text, strings in quotes)") from None
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})", "give a readable TOML file") from None


def validated(kind: type[Validated], given: dict[str, Any], file: Path | str) -> Validated:
    """Validate, turning the first complaint into one line that names the key."""
    try:
        return kind.model_validate(given)
    except ValidationError as error:
        # An unknown key is told first: it is often the misspelt form of one that is then missing.
        first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
        path = [str(part) for part in first["loc"]]
        key = ".".join(path) or "the file"
        if first["type"] == "extra_forbidden":
            known = _known_keys(kind, path[:-1])
            raise InputError(file, f"unknown key '{key}'", nearest(path[-1], known)) from None
        if first["type"] == "missing":
            raise InputError(file, f"'{key}' is missing", f"give {key}") from None
        message = first["msg"].removeprefix("Value error, ")
        found = f"'{key}'" if isinstance(first["input"], dict) else f"'{key}' is {first['input']!r}"
        raise InputError(file, found, message[0].lower() + message[1:]) from None


def _known_keys(kind: type[BaseModel], path: Sequence[str]) -> list[str]:
    """The keys of the table at `path` inside a model."""
    for part in path:
        field = kind.model_fields.get(part)
        nested = _models_in(field.annotation) if field else []
        kind = nested[0] if nested else kind
    return list(kind.model_fields)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """Models named in a type annotation, however nested."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]
