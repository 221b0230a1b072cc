"""The results of a winding study as one tree with CF units, for its `results.nc`.

/                         study: title, source, notes, findings, provenance (attributes)
/runs                     numbers of every run (run): span, errors, outcome; cN, percent
/runs/run_<i>             time series of the span and of the guide (time), samples (sample), layers (layer); SI
/runs/run_<i>/snapshot_<j>  the laid yarn at one time (node), of cases and of variants weak inside; SI
/runs/run_<i>/energy      the reference mode's ledger (moment); SI
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields

import numpy as np
import xarray as xr

from models.winding.result import EnergyLedger, Snapshot
from pipeline.winding.findings import Finding, weak_inside
from pipeline.winding.run import Row
from pipeline.winding.study import WindingStudy

FORMAT = "yarnval winding 1"
_NUMBERS = {
    "tex": ("tex", "linear density, g/km"),
    "drum_rpm": ("min-1", "speed of the groove drum"),
    "speed": ("m s-1", "speed of the yarn"),
    "end_tension": ("cN", "tension T0 at the end of the yarn, at the start"),
    "span_mean": ("cN", "mean tension between guide and bobbin"),
    "span_u": ("cN", "standard uncertainty of that mean"),
    "span_sd": ("cN", "standard deviation of that tension"),
    "span_slope": ("cN s-1", "slope of that tension's least-squares line"),
    "span_slope_u": ("cN s-1", "standard uncertainty of that slope"),
    "span_peak": ("cN", "largest tension between guide and bobbin, settled"),
    "error_mean": ("percent", "mean relative error of the samples"),
    "error_max": ("percent", "largest relative error of the samples"),
    "error_all_mean": ("percent", "mean relative error with the guide's extremes left in"),
    "energy_residual": ("1", "largest imbalance of energy over the largest throughput"),
    "penetration_max": ("m", "largest approach of the contacts beyond touching"),
    "penetration_share": ("percent", "the same over the yarn's diameter"),
    "transverse_stiffness": ("N mm-2", "declared transverse stiffness of the yarn, which makes that approach"),
    "time_step": ("s", "time step"),
    "time_step_limit": ("s", "limit of stability"),
    "element_steps": ("1", "elements times time steps"),
    "wall": ("s", "elapsed time"),
}
"""Name → unit and long name of the numbers of a run."""


def run_numbers(row: Row) -> dict[str, float]:
    """The numbers of one run, by `_NUMBERS`; NaN where there is none."""
    result, span = row.result, row.span
    return {
        "tex": row.tex,
        "drum_rpm": math.nan if row.case.keys.drum_rpm is None else row.case.keys.drum_rpm,
        "speed": row.speed,
        "end_tension": 100 * row.end_tension,
        "span_mean": 100 * span.mean,
        "span_u": 100 * span.estimate.u,
        "span_sd": 100 * span.sd,
        "span_slope": 100 * span.slope,
        "span_slope_u": 100 * span.slope_u,
        "span_peak": 100 * span.peak,
        "error_mean": row.errors.mean_percent,
        "error_max": row.errors.max_percent,
        "error_all_mean": row.errors_all.mean_percent,
        "energy_residual": math.nan if result.energy is None else result.energy.residual,
        "penetration_max": result.penetration_max,
        "penetration_share": 100 * result.penetration_max / row.case.scene.diameter,
        "transverse_stiffness": 1e-6 * row.case.scene.transverse_stiffness,
        "time_step": result.time_step,
        "time_step_limit": result.time_step_limit,
        "element_steps": float(result.element_steps),
        "wall": result.wall_s,
    }


def to_tree(
    study: WindingStudy, rows: Sequence[Row], findings: Sequence[Finding], provenance: Mapping[str, object]
) -> xr.DataTree:
    """Build the tree (groups above). NaN and empty text stand where nothing is known."""
    numbers = [run_numbers(row) for row in rows]
    texts = {
        "name": [row.name for row in rows],
        "mode": [row.result.mode for row in rows],
        "mode_reason": [row.result.mode_reason for row in rows],
        "error_against": [row.errors.reference for row in rows],
        "outcome": [row.result.outcome.name.lower() for row in rows],
        "message": [row.result.message for row in rows],
    }
    nodes = {
        "/": xr.Dataset(
            attrs={
                "Conventions": "CF-1.11",
                "format": FORMAT,
                "study": study.name,
                "title": study.title,
                "source": study.source,
                "notes": _json(study.notes),
                "findings": _json([asdict(finding) for finding in findings]),
                "provenance": _json(provenance),
            }
        ),
        "/runs": xr.Dataset(
            {
                name: _variable("run", [of[name] for of in numbers], units, long_name)
                for name, (units, long_name) in _NUMBERS.items()
            }
            | {name: xr.Variable("run", np.array(values, dtype=object)) for name, values in texts.items()}
        ),
    }
    for index, row in enumerate(rows):
        path = f"/runs/run_{index}"
        nodes[path] = _run(row)
        if not row.variant or weak_inside(row):  # other packages are not drawn
            nodes |= {f"{path}/snapshot_{j}": _snapshot(shot) for j, shot in enumerate(row.result.snapshots)}
        if row.result.energy is not None:
            nodes[f"{path}/energy"] = _energy(row.result.energy)
    return xr.DataTree.from_dict(nodes)


def _variable(dims: str | tuple[str, ...], values: object, units: str, long_name: str = "") -> xr.Variable:
    return xr.Variable(dims, np.asarray(values), {"units": units} | ({"long_name": long_name} if long_name else {}))


def _json(document: object) -> str:
    return json.dumps(document, ensure_ascii=False, sort_keys=True)


def _run(row: Row) -> xr.Dataset:
    result = row.result
    scene = {f"scene_{name}": _attribute(value) for name, value in asdict(row.case.scene).items()}
    return xr.Dataset(
        {
            "time": _variable("time", result.time, "s"),
            "span_tension": _variable("time", result.span_tension, "N", "tension between guide and bobbin"),
            "extreme": xr.Variable(
                "time",
                row.extremes.astype(np.int8),
                {"flag_values": np.array([0, 1], dtype=np.int8), "flag_meanings": "kept removed_as_guide_collision"},
            ),
            "guide_phase": _variable("time", result.guide_phase, "1", "guide cycles since the start"),
            "guide_position": _variable("time", result.guide_position, "m"),
            "sample_time": _variable("sample", row.sample_time, "s"),
            "sample": _variable("sample", row.samples, "N"),
            "sample_error": _variable("sample", row.errors.percent, "percent", "relative error, Eq. 14"),
            "layers_T_over_T0": _variable("layer", row.layers, "1", "tension over that at laying, innermost first"),
        },
        attrs={"name": row.name, **scene},
    )


def _attribute(value: object) -> object:
    if isinstance(value, tuple):
        return np.array(value, dtype=np.float64)
    return "" if value is None else value


def _snapshot(shot: Snapshot) -> xr.Dataset:
    return xr.Dataset(
        {
            "layer": _variable("node", shot.layer, "1"),
            "position": _variable(("node", "xyz"), shot.position, "m"),
            "tension": _variable("node", shot.tension, "N"),
        },
        attrs={"time_s": shot.time},
    )


def _energy(ledger: EnergyLedger) -> xr.Dataset:
    return xr.Dataset(
        {
            field.name: _variable("moment", getattr(ledger, field.name), "s" if field.name == "time" else "J")
            for field in fields(ledger)
        }
    )
