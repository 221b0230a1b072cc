"""Studies and cases: frozen SI records, read through the keys of keys.py.

A study is a folder with `study.toml` and one folder per case with `case.toml`: the keys of `yarnval predict`, each a
number or `{value, cv_percent}` or `{value, u}`, and either `[measured]` (a published summary) or `[raw]` (files).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from models.scene import Scene
from models.solve import MODELS
from pipeline.errors import InputError, nearest, refuse_unknown
from pipeline.keys import CaseKeys, RawKeys, SceneKeys, StudyKeys, TensionKeys, read_toml, validated
from pipeline.records import CylinderAxis, Measured, Quantity, Scale, SlopeRatio


@dataclass(frozen=True, slots=True)
class TensionFile:
    """A tension log and the layout profile that reads it."""

    path: Path
    profile: str
    channel: str | None


@dataclass(frozen=True, slots=True)
class RawFiles:
    """The raw files of a case and the camera's set-up."""

    tension: tuple[TensionFile, ...]
    video: tuple[Path, ...]
    scale: Scale | None
    """None where the cylinder's edges are to give it."""
    cylinder_diameter: float | None
    """[m], where the scale is to be taken from it."""
    scale_image: Path | None
    """Image or clip to take it from, if not the first video."""
    fps: float | None
    bits: int | None
    """Significant bits of a pixel, where the files do not state them."""
    cylinder_axis: CylinderAxis | None
    """None where the cylinder's edges are to give it."""
    u_tilt: float
    """Standard uncertainty of the yarn's tilt out of the image plane [rad]; NaN where it is not stated."""
    ratio: SlopeRatio | None
    """None where the yarn's slope was not compared with direct counting."""
    method: str
    plies: int | None


@dataclass(frozen=True, slots=True)
class Published:
    """The source's own simulation of one quantity, in edge units (cN, tpm, °), and its own error in %."""

    S: float
    E_percent: float


@dataclass(frozen=True, slots=True)
class Case:
    """One scene, with the uncertainties of its inputs and where its measurement comes from."""

    name: str
    path: Path
    scene: Scene
    input_u: Mapping[str, float]
    """Standard uncertainties in SI by field name of `Scene`, where stated."""
    measured: Measured | None
    raw: RawFiles | None
    published: Mapping[Quantity, Published]


@dataclass(frozen=True, slots=True)
class Bound:
    """Largest accepted |S − M| / |M|, in %; `reason` only where a case differs from the study's bound."""

    percent: float
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Study:
    """A set of cases that are reported together."""

    name: str
    title: str
    path: Path
    source: str
    synthetic: bool
    notes: tuple[str, ...]
    cases: tuple[Case, ...]
    models: tuple[str, ...]
    bounds: Mapping[tuple[str, str, Quantity], Bound]
    """By case, model and quantity."""
    fitted: str
    """Which parameters were fitted on which cases, in words; empty where none was."""


def find_studies(paths: Sequence[Path]) -> tuple[Path, ...]:
    """Folders with a study.toml among `paths` or directly below them, sorted within each.

    Raises
    ------
    InputError
        If a path is missing or holds no study.
    """
    found: list[Path] = []
    for path in paths:
        if not path.is_dir():
            raise InputError(path, "no such folder", "give a study folder (with study.toml) or a folder of studies")
        studies = [path] if (path / "study.toml").is_file() else sorted(p.parent for p in path.glob("*/study.toml"))
        if not studies:
            right = "give a study folder or a folder of studies"
            raise InputError(path, "no study.toml here or one level below", right)
        found.extend(study for study in studies if study not in found)
    return tuple(found)


def load_study(path: Path) -> Study:
    """Read a study folder and all its cases.

    Raises
    ------
    InputError
        If a file is missing or not TOML, a key is unknown, missing or of the wrong kind, or a value is out of range.
    """
    file = path / "study.toml"
    keys = validated(StudyKeys, read_toml(file), file)
    for what, given in (("case", keys.cases), ("model", keys.models)):
        for twice in (name for name in given if given.count(name) > 1):
            raise InputError(file, f"the {what} '{twice}' is named twice", "name it once")
    for model in [*keys.models, *keys.bounds, *(e.model for e in keys.exceptions)]:
        refuse_unknown(file, "model", model, list(MODELS))
    for name in [*keys.fitted.cases, *(e.case for e in keys.exceptions)]:
        refuse_unknown(file, "case", name, keys.cases)
    cases = tuple(load_case(path / name / "case.toml") for name in keys.cases)
    bounds: dict[tuple[str, str, Quantity], Bound] = {}
    for model, by_quantity in keys.bounds.items():
        for name, percent in by_quantity.items():
            quantity = _quantity(file, f"bounds.{model}", name)
            bounds |= {(case, model, quantity): Bound(percent) for case in keys.cases}
    for e in keys.exceptions:
        bounds[e.case, e.model, _quantity(file, "exceptions", e.quantity)] = Bound(e.bound_percent, e.reason)
    fitted = (
        f"{', '.join(keys.fitted.parameters)} fitted on {', '.join(keys.fitted.cases)}"
        if keys.fitted.parameters
        else ""
    )
    return Study(
        keys.name, keys.title, path, keys.source, keys.synthetic, tuple(keys.notes), cases, tuple(keys.models),
        bounds, fitted,
    )  # fmt: skip


def load_case(file: Path) -> Case:
    """Read one case.toml; the case is named after its folder.

    Raises
    ------
    InputError
        As for `load_study`.
    """
    keys = validated(CaseKeys, read_toml(file), file)
    name, folder = file.parent.name, file.parent
    try:
        scene, uncertainties = keys.scene(), keys.uncertainties()
    except ValueError as error:
        raise InputError(file, *str(error).split(": ", 1)) from None
    measured = None
    if keys.measured is not None:
        values = {}
        for key, given in keys.measured.items():
            quantity = _quantity(file, "measured", key)
            values[quantity] = given.estimate(quantity)
        measured = Measured(name, values)
    published = {}
    for key, own in keys.published.items():
        quantity = _quantity(file, "published", key)
        published[quantity] = Published(own.S, own.E_percent if own.E_percent is not None else math.nan)
    return Case(
        name, folder, scene, uncertainties, measured, _raw_files(keys.raw, file) if keys.raw else None, published
    )


def load_scene(file: Path) -> Scene:
    """Read only the scene of a case.toml, which then needs neither [measured] nor [raw] (for `predict`)."""
    given = {k: v for k, v in read_toml(file).items() if k not in ("measured", "raw", "published", "note")}
    try:
        return validated(SceneKeys, given, file).scene()
    except ValueError as error:
        raise InputError(file, *str(error).split(": ", 1)) from None


def _raw_files(keys: RawKeys, file: Path) -> RawFiles:
    scale = None
    if keys.video:
        where = f"{file}: [raw]"
        if keys.scale_um_per_px is None and keys.scale_from_diameter_mm is None:
            right = "give the object scale, or scale_from_diameter_mm: no scale, no mm and no tpm"
            raise InputError(where, "a video without 'scale_um_per_px'", right)
        # in another image the camera may have been turned
        if keys.axis_deg is None and (keys.scale_from_diameter_mm is None or keys.scale_image is not None):
            right = "give the direction of the cylinder axis as displayed"
            raise InputError(where, "a video without 'axis_deg'", right)
        if keys.scale_um_per_px is not None:
            given = keys.scale_um_per_px
            if given.value <= 0:
                raise InputError(f"{where} scale_um_per_px", f"{given.value:g}", "give µm per pixel, greater than 0")
            scale = Scale(given.value * 1e-6, given.standard_uncertainty / given.value)
    elif not keys.tension:
        raise InputError(f"{file}: [raw]", "neither 'tension' nor 'video'", "name at least one raw file")
    tension = [TensionKeys(file=t) if isinstance(t, str) else t for t in keys.tension]
    images = [keys.scale_image] if keys.scale_image is not None else []
    for name in [*(t.file for t in tension), *keys.video, *images]:
        if not (file.parent / name).exists():
            raise InputError(f"{file}: [raw]", f"'{name}' is not in this folder", "name files relative to case.toml")
    diameter = keys.scale_from_diameter_mm
    return RawFiles(
        tension=tuple(TensionFile(file.parent / t.file, t.profile, t.channel) for t in tension),
        video=tuple(file.parent / v for v in keys.video),
        scale=scale,
        cylinder_diameter=diameter * 1e-3 if diameter is not None else None,
        scale_image=file.parent / keys.scale_image if keys.scale_image is not None else None,
        fps=keys.fps,
        bits=keys.bits,
        cylinder_axis=None
        if keys.axis_deg is None
        else CylinderAxis(math.radians(keys.axis_deg.value), math.radians(keys.axis_deg.standard_uncertainty)),
        u_tilt=math.nan if keys.tilt_u_deg is None else math.radians(keys.tilt_u_deg),
        ratio=None
        if keys.slope_ratio is None
        else SlopeRatio(keys.slope_ratio.value, keys.slope_ratio.standard_uncertainty),
        method=keys.method,
        plies=keys.plies,
    )


def _quantity(file: Path, table: str, name: str) -> Quantity:
    try:
        return Quantity(name)
    except ValueError:
        known = [quantity.value for quantity in Quantity]
        raise InputError(f"{file}: [{table}]", f"unknown quantity '{name}'", nearest(name, known)) from None
