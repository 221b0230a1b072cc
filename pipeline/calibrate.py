"""Calibrate: one value of named parameters for all cases of a study, and what the fit is worth where it was not made.

Least squares of the report's own measure of error, E = (S − M) / M, over all cases and measured quantities. Weights by
uncertainty are not used: of published summaries some are not known. Derivatives are exact (`models.sensitivity`). The
standard uncertainty of a parameter comes from the scatter that the fit leaves, s²(JᵀJ)⁻¹ with s² = ΣE²/(n − p).

A fit is near the data that it was made of; it says something where it was not. So each case is also predicted by a
fit to the other cases alone (leave one out).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from models.scene import Scene
from models.sensitivity import sensitivities
from models.solve import MODELS
from pipeline.case import Case, Study
from pipeline.errors import InputError
from pipeline.records import Array, Measured, Quantity
from pipeline.threads import one_thread

PARAMETERS: Mapping[str, tuple[str, float, float]] = {
    "k": ("twist_trapping", -10.0, 10.0),
    "eta": ("twist_congestion", -10.0, 10.0),
    "mu": ("friction", 0.0, 5.0),
    "lAB_over_lCD": ("span_ratio", 0.05, 20.0),
}
"""What can be fitted: key of case.toml → field of `Scene`, lowest and highest value."""
SETS = ("S_given", "S_fitted", "S_left_out")
"""Fields of `Row`: what is simulated with the study's own parameters, the fitted ones, and those of the other cases."""
ENTANGLED = 0.95
"""Correlation from which on two parameters are said not to be determined each."""
AT_BOUND = 1e-3
"""Distance from a bound, over the range, below which a fit is said to have ended there."""


@dataclass(frozen=True, slots=True)
class Row:
    """One measured quantity of one case, in edge units, as simulated with three sets of parameters."""

    case: str
    quantity: Quantity
    M: float
    S_given: float
    """With the study's own parameters."""
    S_fitted: float
    """With those fitted to all cases."""
    S_left_out: float
    """With those fitted to the other cases; NaN where these are too few."""

    def E_percent(self, S: float) -> float:
        """|S − M| / |M| in %."""
        return 100 * abs(S - self.M) / abs(self.M)


@dataclass(frozen=True, slots=True)
class Calibration:
    """Parameters of a model fitted to a study."""

    study: str
    synthetic: bool
    """Whether the measured data were computed rather than measured."""
    model: str
    given: Mapping[str, tuple[float, ...]]
    """The study's own values, one per case, by parameter."""
    values: Mapping[str, float]
    u: Mapping[str, float]
    """Standard uncertainties; NaN where there are no more data than parameters."""
    correlation: Array
    """Of the parameters' errors, shape (p, p)."""
    left_out: Mapping[str, Mapping[str, float]]
    """Parameters fitted without a case, by that case; empty where the rest is too few."""
    rows: tuple[Row, ...]
    failures: tuple[str, ...]
    """Fits and solves that failed, one line each."""
    notes: tuple[str, ...]
    """What the data do not determine."""

    def errors(self, which: str) -> tuple[float, float]:
        """Root mean square and largest error in % of the rows' field `which`."""
        errors = [row.E_percent(getattr(row, which)) for row in self.rows]
        return float(np.sqrt(np.mean(np.square(errors)))), max(errors, default=math.nan)


@dataclass(frozen=True, slots=True)
class _Fit:
    x: Array
    jacobian: Array
    """Of E by the parameters, shape (data, p)."""
    rest: Array
    failure: str = ""


def calibrate(study: Study, measured: Sequence[Measured], model: str, names: Sequence[str]) -> Calibration:
    """Fit parameters of one model to all cases of a study, and to all but each one.

    Parameters
    ----------
    measured : of each case, in the study's order.
    names : keys of `PARAMETERS`.

    Raises
    ------
    InputError
        If there are not more measured values than parameters.
    """
    data = {case.name: _values(m) for case, m in zip(study.cases, measured, strict=True)}
    count = sum(map(len, data.values()))
    if count <= len(names):
        right = "measure more, or fit fewer parameters"
        raise InputError(study.path, f"{count} measured values for {len(names)} parameters", right)
    given = {name: tuple(getattr(case.scene, PARAMETERS[name][0]) for case in study.cases) for name in names}
    start = np.array([sum(given[name]) / len(given[name]) for name in names])
    with one_thread():
        fit = _fit(study.cases, data, model, names, start)
        others = {
            out.name: _fit([case for case in study.cases if case is not out], data, model, names, fit.x)
            for out in study.cases
            if count - len(data[out.name]) > len(names)
        }
        rows = tuple(row for case in study.cases for row in _rows(case, data[case.name], model, names, fit, others))
    failures = [f"{model} fitted to all cases: {fit.failure}"] if fit.failure else []
    failures += [f"{model} fitted without {out}: {other.failure}" for out, other in others.items() if other.failure]
    u, correlation = _spread(fit)
    return Calibration(
        study=study.name,
        synthetic=study.synthetic,
        model=model,
        given=given,
        values=dict(zip(names, fit.x.tolist(), strict=True)),
        u=dict(zip(names, u.tolist(), strict=True)),
        correlation=correlation,
        left_out={out: dict(zip(names, other.x.tolist(), strict=True)) for out, other in others.items()},
        rows=rows,
        failures=tuple(failures),
        notes=_notes(names, fit.x, correlation),
    )


def _values(measured: Measured) -> dict[Quantity, float]:
    """What was measured of a case, in SI; 0 has no relative error and is left out."""
    found = {quantity: measured.values[quantity].mean for quantity in Quantity if quantity in measured.values}
    return {quantity: mean for quantity, mean in found.items() if math.isfinite(mean) and mean}


def _scene(case: Case, names: Sequence[str], x: Array) -> Scene:
    return replace(case.scene, **{PARAMETERS[name][0]: float(value) for name, value in zip(names, x, strict=True)})


def _fit(
    cases: Sequence[Case], data: Mapping[str, Mapping[Quantity, float]], model: str, names: Sequence[str], start: Array
) -> _Fit:
    """Fit to some cases; a start without solutions is a failure and is returned as it is."""

    def rest(x: Array) -> Array:
        found = []
        for case in cases:
            solution = MODELS[model](_scene(case, names, x), profile=False)
            if not solution.outcome.ok:
                reasons[case.name] = f"{case.name}: {solution.outcome.name.lower()}: {solution.message}"
            ends = solution.ends  # NaN where there is no solution: the step is then shortened
            found += [quantity.of(ends) / mean - 1 for quantity, mean in data[case.name].items()]
        return np.array(found)

    def jacobian(x: Array) -> Array:
        found = []
        for case in cases:
            slopes = sensitivities(_scene(case, names, x), model)
            for quantity, mean in data[case.name].items():
                row = [math.nan if slopes is None else quantity.of(slopes[PARAMETERS[n][0]]) / mean for n in names]
                found.append(row)
        return np.array(found)

    reasons: dict[str, str] = {}
    first, slopes = rest(start), jacobian(start)
    if not (np.all(np.isfinite(first)) and np.all(np.isfinite(slopes))):
        why = "; ".join(reasons.values()) or "several solutions: no one derivative"
        return _Fit(start, slopes, first, f"no start: {why}")
    bounds = [PARAMETERS[name][1] for name in names], [PARAMETERS[name][2] for name in names]
    try:
        found = least_squares(rest, start, jacobian, bounds, x_scale="jac", xtol=1e-10, ftol=1e-12, gtol=1e-12)
    except (ValueError, np.linalg.LinAlgError):  # a derivative that is none, on the way
        return _Fit(start, slopes, first, "; ".join(reasons.values()) or "several solutions: no one derivative")
    return _Fit(found.x, np.asarray(found.jac), found.fun, "" if found.success else str(found.message))


def _rows(
    case: Case,
    values: Mapping[Quantity, float],
    model: str,
    names: Sequence[str],
    fit: _Fit,
    others: Mapping[str, _Fit],
) -> list[Row]:
    scenes = [case.scene, _scene(case, names, fit.x)]
    if case.name in others:
        scenes.append(_scene(case, names, others[case.name].x))
    ends = [MODELS[model](scene, profile=False).ends for scene in scenes]
    rows = []
    for quantity, mean in values.items():
        simulated = [quantity.of(end) * quantity.per_si for end in ends] + [math.nan] * (3 - len(ends))
        rows.append(Row(case.name, quantity, mean * quantity.per_si, *simulated))
    return rows


def _spread(fit: _Fit) -> tuple[Array, Array]:
    """Standard uncertainties and correlation of the parameters; NaN where the data do not say."""
    count, p = fit.jacobian.shape
    nothing = np.full(p, np.nan), np.full((p, p), np.nan)
    if fit.failure or np.linalg.matrix_rank(fit.jacobian) < p:
        return nothing
    covariance = np.linalg.inv(fit.jacobian.T @ fit.jacobian) * float(fit.rest @ fit.rest) / (count - p)
    u = np.sqrt(np.diag(covariance))
    return u, covariance / np.outer(u, u)


def _notes(names: Sequence[str], x: Array, correlation: Array) -> tuple[str, ...]:
    notes = []
    for i, name in enumerate(names):
        _, low, high = PARAMETERS[name]
        if min(x[i] - low, high - x[i]) < AT_BOUND * (high - low):
            notes.append(f"{name} ended at the bound of its range, {x[i]:.3g}: the data do not determine it")
        for j in range(i):
            if abs(correlation[i, j]) >= ENTANGLED:
                told = f"{names[j]} and {name} are correlated by {correlation[i, j]:+.3f}"
                notes.append(f"{told}: the data determine a combination of them, not each")
    return tuple(notes)


def document(found: Calibration) -> dict[str, object]:
    """Return the document of `yarnval calibrate --json`: null where a number is not known."""
    errors = {}
    for which in SETS:
        rms, largest = found.errors(which)
        errors[which.removeprefix("S_")] = {"rms_percent": _known(rms), "largest_percent": _known(largest)}
    rows = []
    for row in found.rows:
        numbers = {"M": row.M}
        for which in SETS:
            S = getattr(row, which)
            numbers |= {which: S, f"E{which[1:]}_percent": row.E_percent(S)}
        told = {name: _known(value) for name, value in numbers.items()}
        rows.append({"case": row.case, "quantity": row.quantity.value, **told})
    return {
        "study": found.study,
        "synthetic": found.synthetic,
        "model": found.model,
        "parameters": {
            name: {"given": list(found.given[name]), "value": value, "u": _known(found.u[name])}
            for name, value in found.values.items()
        },
        "correlation": [[_known(value) for value in line] for line in found.correlation.tolist()],
        "left_out": found.left_out,
        "errors": errors,
        "rows": rows,
        "notes": list(found.notes),
        "failures": list(found.failures),
    }


def told(found: Calibration) -> str:
    """Return the calibration as text: parameters, errors with each set of them, and what the data do not determine."""
    where = f"{found.study}{' (SYNTHETIC)' if found.synthetic else ''}"
    lines = [f"{found.model} fitted to {', '.join(found.left_out) or 'all cases'} of {where}", ""]
    head = ["parameter", "given", "fitted", "u", *(f"without {case}" for case in found.left_out)]
    table = []
    for name, value in found.values.items():
        given = sorted(set(found.given[name]))
        shown = f"{given[0]:g}" if len(given) == 1 else f"{given[0]:g} to {given[-1]:g}"
        others = [f"{other[name]:.4g}" for other in found.left_out.values()]
        table.append([name, shown, f"{value:.4g}", f"{found.u[name]:.2g}", *others])
    lines += _columns(head, table)
    head = ["case", "quantity", "M", "S given", "E %", "S fitted", "E %", "S left out", "E %"]
    table = []
    for row in found.rows:
        cells = [row.case, row.quantity.value, f"{row.M:.4g}"]
        for which in SETS:
            S = getattr(row, which)
            cells += [f"{S:.4g}", f"{row.E_percent(S):.2f}"]
        table.append(cells)
    for name, place in (("root mean square", 0), ("largest", 1)):
        table.append([name, "", ""] + [cell for which in SETS for cell in ("", f"{found.errors(which)[place]:.2f}")])
    lines += ["", *_columns(head, table), ""]
    lines += [f"note: {note}" for note in found.notes]
    lines.append("E = |S − M| / |M|. Left out: predicted by a fit to the other cases. The study was not changed.")
    return "\n".join(lines)


def _columns(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(line[i]) for line in [head, *rows]) for i in range(len(head))]
    return ["  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in [head, *rows]]


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
