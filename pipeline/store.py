"""The results of one study as one tree with CF units, and its file `results.nc`.

Every figure, table and JSON file of the report reads this tree, so that a number has one source:

    /                        study: title, source, synthetic, notes, fitted, provenance (attributes)
    /comparison/<quantity>   M, cv_percent, u_D, n, … (case); S, E, u_…, bound, outcome (case, model), edge units
    /published/<quantity>    S, E_percent (case): the source's own simulation; edge units
    /solves                  ends, uncertainties and numerical evidence of every solve (case, model); SI
    /profiles/<case>/<model> the solution along the contact (psi); SI
    /measured/<case>/tension_<i>, yarn_<i>   the series as recorded, with their flags; SI

One group per quantity, because one variable has one unit.
"""

import json
import math
from collections.abc import Iterable
from dataclasses import asdict
from enum import IntFlag
from pathlib import Path

import numpy as np
import xarray as xr

from pipeline.errors import InputError
from pipeline.records import (
    Comparison,
    Estimate,
    Flags,
    FrameFlag,
    Measured,
    Prediction,
    Quantity,
    Results,
    TensionFlag,
    TensionMeasurement,
    YarnMeasurement,
)

FORMAT = "yarnval results 1"
CF_UNIT = {Quantity.TENSION_AB: "cN", Quantity.TWIST_AB: "m-1", Quantity.THETA_B: "degree"}
_Variables = dict[str, xr.Variable]


def to_tree(results: Results) -> xr.DataTree:
    """Build the tree of a study (groups above). NaN and empty text stand where nothing is known."""
    cases = _ordered(r.case for group in (results.measured, results.predictions, results.comparisons) for r in group)
    models = _ordered([*(p.solution.model for p in results.predictions), *(c.model for c in results.comparisons)])
    nodes = {
        "/": xr.Dataset(
            attrs={
                "Conventions": "CF-1.11",
                "format": FORMAT,
                "study": results.name,
                "title": results.title,
                "source": results.source,
                "synthetic": int(results.synthetic),
                "fitted": results.fitted,
                "notes": json.dumps(results.notes, ensure_ascii=False),
                "provenance": json.dumps(results.provenance, ensure_ascii=False, sort_keys=True),
            }
        ),
        "/comparison": xr.Dataset(coords={"case": _texts("case", cases), "model": _texts("model", models)}),
        "/published": xr.Dataset(coords={"case": _texts("case", cases)}),
    }
    for quantity in Quantity:
        rows = [c for c in results.comparisons if c.quantity is quantity]
        estimates = {m.case: m.values[quantity] for m in results.measured if quantity in m.values}
        nodes[f"/comparison/{quantity}"] = _comparison(rows, estimates, cases, models, CF_UNIT[quantity])
        published = [results.published.get(case, {}).get(quantity, (math.nan, math.nan)) for case in cases]
        nodes[f"/published/{quantity}"] = xr.Dataset(
            {
                "S": _variable("case", np.array([s for s, _ in published]), CF_UNIT[quantity]),
                "E_percent": _variable("case", np.array([e for _, e in published]), "percent"),
            }
        )
    for measured in results.measured:
        nodes |= _measured(measured)
    nodes["/solves"] = _solves(results.predictions, cases, models)
    for prediction in results.predictions:
        nodes[f"/profiles/{prediction.case}/{prediction.solution.model}"] = _profile(prediction)
    return xr.DataTree.from_dict(nodes)


def write_tree(tree: xr.DataTree, path: Path) -> None:
    """Write the tree as NetCDF 4."""
    tree.to_netcdf(path, engine="netcdf4")


def read_tree(path: str | Path, expected: str = FORMAT) -> xr.DataTree:
    """Read a tree that `write_tree` wrote, whole, into memory; `expected` is its `format` attribute.

    Raises
    ------
    InputError
        If there is no such file, or it is truncated, or it is not one of ours.
    """
    if not Path(path).is_file():
        raise InputError(path, "no such file", "results.nc of a report folder is expected; `yarnval report` makes one")
    try:
        with xr.open_datatree(path, engine="netcdf4", decode_times=False) as lazy:
            tree = lazy.load()
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise InputError(path, "truncated or not a NetCDF 4 file", "make it again with `yarnval report`") from error
    if tree.attrs.get("format") != expected:
        raise InputError(path, f"format {tree.attrs.get('format')!r}", f"{expected!r}, as yarnval writes it, is needed")
    return tree


def _ordered(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))


def _variable(dims: str | tuple[str, ...], values: np.ndarray | float, units: str, long_name: str = "") -> xr.Variable:
    return xr.Variable(dims, values, {"units": units} | ({"long_name": long_name} if long_name else {}))


def _texts(dims: str | tuple[str, ...], values: object) -> xr.Variable:
    return xr.Variable(dims, np.array(values, dtype=object))


def _flags(dim: str, values: Flags, kind: type[IntFlag]) -> xr.Variable:
    # CF 3.5: independent conditions are bits; masks have the type of the variable.
    masks = np.array([int(flag) for flag in kind], dtype=values.dtype)
    return xr.Variable(dim, values, {"flag_masks": masks, "flag_meanings": " ".join(str(f.name).lower() for f in kind)})


def _comparison(
    rows: list[Comparison], estimates: dict[str, Estimate], cases: list[str], models: list[str], unit: str
) -> xr.Dataset:
    place = {(cases.index(row.case), models.index(row.model)): row for row in rows}
    first = {index: row for (index, _), row in reversed(place.items())}
    grid = (len(cases), len(models))

    def of_case(name: str, units: str, long_name: str) -> xr.Variable:
        values = np.full(len(cases), math.nan)
        for index, row in first.items():
            values[index] = getattr(row, name)
        return _variable("case", values, units, long_name)

    def of_model(name: str, units: str, long_name: str) -> xr.Variable:
        values = np.full(grid, math.nan)
        for index, row in place.items():
            values[index] = getattr(row, name)
        return _variable(("case", "model"), values, units, long_name)

    def text(name: str) -> xr.Variable:
        values = np.full(grid, "", dtype=object)
        for index, row in place.items():
            value = getattr(row, name)
            values[index] = value if isinstance(value, str) else " ".join(value)
        return xr.Variable(("case", "model"), values)

    missing = Estimate(math.nan, reason="not measured")
    known = [estimates.get(case, missing) for case in cases]
    counts = np.array([math.nan if e.n is None else e.n for e in known], dtype=np.float64)
    within = np.zeros(grid, dtype=np.int8)
    for index, row in place.items():
        within[index] = row.within
    return xr.Dataset(
        {
            "M": of_case("M", unit, "measured mean"),
            "cv_percent": of_case("cv_percent", "percent", "coefficient of variation of the measurement"),
            "u_D": of_case("u_D", unit, "standard uncertainty of the measured value"),
            "n": _variable("case", counts, "1", "number of samples"),
            "n_eff": _variable("case", np.array([e.n_eff for e in known]), "1", "effective number of samples"),
            "reason": _texts("case", [e.reason for e in known]),
            "S": of_model("S", unit, "simulated value"),
            "E": of_model("E", unit, "comparison error S - M"),
            "E_percent": of_model("E_percent", "percent", "absolute comparison error relative to |M|"),
            "u_num": of_model("u_num", unit, "numerical uncertainty"),
            "u_input": of_model("u_input", unit, "uncertainty from the inputs"),
            "u_val": of_model("u_val", unit, "validation uncertainty, ASME V&V 20"),
            "missing_u": text("missing_u"),
            "outcome": text("outcome"),
            "message": text("message"),
            "bound_percent": of_model("bound_percent", "percent", "largest E_percent accepted"),
            "bound_reason": text("bound_reason"),
            "within": xr.Variable(
                ("case", "model"),
                within,
                {"flag_values": np.array([0, 1], dtype=np.int8), "flag_meanings": "no yes"},
            ),
        }
    )


def _estimate(estimate: Estimate, units: str) -> xr.Variable:
    attrs: dict[str, object] = {
        "units": units,
        "standard_uncertainty": estimate.u,
        "cv_percent": estimate.cv * 100,
        "n": math.nan if estimate.n is None else estimate.n,
        "n_eff": estimate.n_eff,
        "reason": estimate.reason,
    }
    return xr.Variable((), estimate.mean, attrs)


def _measured(measured: Measured) -> dict[str, xr.Dataset]:
    path = f"/measured/{measured.case}"
    diameter = {} if measured.diameter is None else {"diameter": _estimate(measured.diameter, "m")}
    return (
        {path: xr.Dataset(diameter)}
        | {f"{path}/tension_{i}": _tension(log) for i, log in enumerate(measured.tension)}
        | {f"{path}/yarn_{i}": _yarn(clip) for i, clip in enumerate(measured.yarn)}
    )


def _tension(log: TensionMeasurement) -> xr.Dataset:
    gaps = np.array(log.gaps, dtype=np.float64).reshape(-1, 2)
    return xr.Dataset(
        {
            "time": _variable("sample", log.raw.time, "s"),
            "tension": _variable("sample", log.raw.tension, "N"),
            "flag": _flags("sample", log.raw.flag, TensionFlag),
            "window": _variable("edge", np.array(log.window, dtype=np.float64), "s"),
            "gaps": _variable(("gap", "edge"), gaps, "s"),
            "rate": _variable((), log.rate, "s-1", "median sampling rate"),
            "drift": _variable((), log.drift, "N s-1", "slope of the least-squares line"),
            "mean": _estimate(log.estimate, "N"),
        },
        attrs={
            **asdict(log.raw.source),
            "layout": log.raw.layout,
            "unit_in_file": log.raw.unit_in_file,
        },
    )


def _yarn(clip: YarnMeasurement) -> xr.Dataset:
    units = {"axis_angle": "radian", "theta_B": "radian", "twist": "m-1", "diameter": "m", "hairiness": "m-1"}
    units |= {"helix_rotation": "s-1", "rotation": "s-1", "unevenness": "1"}
    variables: _Variables = {
        "time": _variable("frame", clip.raw.time, "s"),
        "axis_angle": _variable("frame", clip.axis_angle, "radian"),
        "theta": _variable("frame", clip.theta, "radian"),
        "twist": _variable("frame", clip.twist, "m-1"),
        "diameter": _variable("frame", clip.diameter, "m"),
        "hairiness": _variable("frame", clip.hairiness, "m-1", "hairs that cross a line beside the yarn"),
        "sagitta": _variable("frame", clip.sagitta, "m", "sagitta of the yarn's axis over the length in view"),
        "unevenness": _variable(
            "frame", clip.unevenness, "1", "coefficient of variation of the diameter along the yarn"
        ),
        "helix_rotation": _variable("frame", clip.helix_rotation, "s-1", "turns of the helix at a fixed place"),
        "confidence": _variable("frame", clip.confidence, "1"),
        "flag": _flags("frame", clip.flag, FrameFlag),
    }
    for name, estimate in clip.summary.items():
        variables[f"summary_{name}"] = _estimate(estimate, units[name])
    if clip.thumbnails:
        sheet = clip.thumbnails
        variables |= {
            "thumbnail": _variable(("shot", "row", "column"), np.stack([t.image for t in sheet]), "1", "grey level"),
            "shot_frame": _variable("shot", np.array([t.frame for t in sheet]), "1", "index of the frame"),
            "shot_centre": _variable(("shot", "xy"), np.array([t.centre for t in sheet]), "1", "axis point in pixels"),
            "shot_axis_angle": _variable("shot", np.array([t.axis_angle for t in sheet]), "radian"),
            "shot_diameter": _variable("shot", np.array([t.diameter for t in sheet]), "1", "diameter in pixels"),
            "shot_twist": _variable("shot", np.array([t.twist for t in sheet]), "m-1"),
        }
    return xr.Dataset(
        variables,
        attrs={
            **asdict(clip.raw.source),
            "method": clip.method,
            "handedness": clip.handedness,
            "reason": clip.reason,
            "rate_per_s": clip.raw.rate,
        },
    )


def _solves(predictions: Iterable[Prediction], cases: list[str], models: list[str]) -> xr.Dataset:
    grid = (len(cases), len(models))
    dims = ("case", "model")
    units = {
        "tension_AB": "N", "twist_AB": "m-1", "theta_B": "radian",
        "u_num_tension_AB": "N", "u_num_twist_AB": "m-1", "u_num_theta_B": "radian",
        "u_input_tension_AB": "N", "u_input_twist_AB": "m-1", "u_input_theta_B": "radian",
        "theta_C": "radian", "rotation": "s-1", "normal_force_min": "N m-1", "wall": "s",
        "iterations": "1", "nodes": "1", "residual": "1", "boundary_residual": "1", "condition": "1",
    }  # fmt: skip
    numbers = {name: np.full(grid, math.nan) for name in units}
    texts = {name: np.full(grid, "", dtype=object) for name in ("outcome", "message")}
    for prediction in predictions:
        solution = prediction.solution
        place = cases.index(prediction.case), models.index(solution.model)
        values = {
            **asdict(solution.ends),
            **{f"u_num_{name}": value for name, value in asdict(solution.u_num).items()},
            **{f"u_input_{name}": value for name, value in asdict(prediction.u_input).items()},
            **{name: getattr(solution, name) for name in ("theta_C", "rotation", "normal_force_min")},
            "wall": prediction.wall,
        }
        evidence = asdict(solution.stats)
        for name, array in numbers.items():
            array[place] = values[name] if name in values else evidence[name]
        texts["outcome"][place] = solution.outcome.name.lower()
        texts["message"][place] = solution.message
    return xr.Dataset(
        {name: _variable(dims, numbers[name], unit) for name, unit in units.items()}
        | {name: xr.Variable(dims, values) for name, values in texts.items()},
        coords={"case": _texts("case", cases), "model": _texts("model", models)},
    )


def _profile(prediction: Prediction) -> xr.Dataset:
    solution = prediction.solution
    units = {
        "psi": "radian", "theta": "radian", "tension": "N", "twist": "m-1", "normal_force": "N m-1",
        "bending_moment": "N m", "torsional_moment": "N m", "z": "m",
    }  # fmt: skip
    series = {}
    if solution.profile is not None:
        series = {name: _variable("psi", getattr(solution.profile, name), unit) for name, unit in units.items()}
    scene = {f"scene_{name}": value for name, value in asdict(solution.scene).items()}
    return xr.Dataset(series, attrs={"outcome": solution.outcome.name.lower(), "message": solution.message, **scene})
