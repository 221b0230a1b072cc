"""Calibration of a case: its measurement read, its scene fitted on the fast mode, and what a later run makes of it."""

import csv
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from models.winding.calibrate import Calibration, calibrate_to_layers, calibrate_to_span
from pipeline.errors import InputError
from pipeline.ingest.source import source
from pipeline.measure.tension import EXCLUDED
from pipeline.records import Array, Source
from pipeline.winding.run import Row
from pipeline.winding.study import MeasuredLog, WindingStudy, read_log

_COLUMNS = ("layer", "T_over_T0")

HIGHEST = 100.0
"""Largest T/T₀ of a layer that is taken for a measurement."""


@dataclass(frozen=True, slots=True)
class CalibratedStudy:
    """A study of one case with its fitted scene."""

    study: WindingStudy
    calibration: Calibration
    kind: str
    """What was compared: 'layers' or 'span'."""
    origin: Source
    """The measurement's file."""

    def verified(self, row: Row) -> float:
        """Root mean square difference of a run's layers from the profile, in T₀; NaN against a log or a failed run."""
        found = row.layers[: self.calibration.measured.size]
        if self.kind != "layers" or found.size < self.calibration.measured.size:
            return math.nan
        return float(np.sqrt(np.mean((found - self.calibration.measured) ** 2)))


def calibrated(study: WindingStudy, file: Path, profile: str) -> CalibratedStudy:
    """The study's one case, fitted to a measurement.

    Parameters
    ----------
    file : a layer profile (CSV with the columns `layer` and `T_over_T0`, innermost first), or a tension log.
    profile : the layout of a log.

    Raises
    ------
    InputError
        If the study has several cases, or the file is neither, is damaged, or has too little in it.
    """
    cases = [case for case in study.cases if case.variant is None]
    if len(cases) > 1:
        raise InputError("--calibrate", f"{len(cases)} cases", "one case is fitted at a time: name it with --case")
    case = cases[0]
    try:
        layers = read_layers(file)
        if layers is not None:
            kind, found = "layers", calibrate_to_layers(case.scene, layers)
        else:
            log = read_log(file, profile)
            kind, found, case = "span", calibrate_to_span(case.scene, _readings(log)), replace(case, log=log)
    except ValueError as error:
        raise InputError(file, *str(error).split(": ", 1)) from None
    keys = case.keys.model_copy(
        update={
            "transverse_stiffness_N_per_mm2": found.scene.transverse_stiffness * 1e-6,
            "prony_weights": found.scene.prony_weights,
            "modulus_N_per_tex": found.scene.axial_stiffness / case.keys.tex,
            "guide_friction": found.scene.guide_friction,
        }
    )
    fitted = replace(case, keys=keys, scene=replace(found.scene, mode=case.scene.mode))
    return CalibratedStudy(replace(study, cases=(fitted,)), found, kind, source(file))


def read_layers(file: Path) -> Array | None:
    """T/T₀ of the layers in a profile, innermost first, shape (n,); None where the file has other columns.

    Raises
    ------
    InputError
        If it cannot be read, or a layer is missing, out of order or without a number.
    """
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        return None  # a log in another encoding: its layout knows
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})", "give an existing, readable file") from None
    rows = csv.DictReader(text.splitlines(), strict=True)
    try:
        if not set(_COLUMNS) <= set(rows.fieldnames or ()):
            return None
        found = [(rows.line_num, row) for row in rows]
    except csv.Error:
        return None
    values: list[float] = []
    for line, row in found:
        where = f"{file} line {line}"
        if row["layer"] != str(len(values) + 1):
            raise InputError(where, f"layer is {row['layer']!r}", f"give layer {len(values) + 1}: from 1, one a line")
        try:
            value = float(row["T_over_T0"])
        except (TypeError, ValueError):
            value = math.nan
        if not 0 <= value <= HIGHEST:
            raise InputError(where, f"T_over_T0 is {row['T_over_T0']!r}", f"give a tension over T₀, 0 to {HIGHEST:g}")
        values.append(value)
    return np.array(values)


def _readings(log: MeasuredLog) -> Array:
    """The usable readings [N] from the start of the winding on."""
    raw = log.raw
    return raw.tension[(raw.flag & EXCLUDED == 0) & np.isfinite(raw.tension) & (raw.time >= log.start)]
