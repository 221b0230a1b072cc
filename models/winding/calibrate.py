"""Calibration of what no data sheet gives: the transverse stiffness and the relaxation of a yarn, by least squares.

The fast mode is fitted, because a fit needs tens of runs; verify its result by one run of the reference mode.

Two kinds of measurement are known:

- A layer profile: T/T₀ of each layer of a package at the end. It determines both parameters: a soft yarn loses tension
  by being wound over, a relaxing one by the time since it was laid.
- Readings of the tension between guide and bobbin. Their phase against the guide is not known, so that the quantiles of
  the readings are compared and not the series. A span hardly knows what becomes of the yarn on the bobbin: a parameter
  that it does not determine is said to be undetermined and stays as it was.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from models.winding.fast import wind_fast
from models.winding.result import WindingResult
from models.winding.scene import WindingScene

Array = NDArray[np.float64]
Name = Literal["transverse_stiffness", "relaxation"]
NAMES: tuple[Name, ...] = ("transverse_stiffness", "relaxation")

QUANTILES = np.linspace(0.05, 0.95, 19)
"""Of the readings of a span's tension that are compared."""
STIFFNESS = (1e5, 1e9)
"""Range of the transverse stiffness [N/m²]: outside it a yarn is pulp, or rigid."""
SCANNED = (5.5, 6.0, 6.5, 7.0)
"""log₁₀ of the stiffnesses that a fit is tried from, beside the scene's own; the best is taken."""
LARGEST_SUM = 0.99
"""Largest sum of the Prony weights."""
FAINT = 1e-4
"""Change of the predicted numbers over themselves, for a tenfold stiffness or full relaxation, that counts as none."""
STEP = 0.02
"""Of the differences that make the Jacobian: the run's own tolerance is far below what this changes."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """One parameter."""

    name: Name
    start: float
    value: float
    """SI: N/m² for the transverse stiffness; the relaxation is the first Prony weight."""
    u: float
    """Standard uncertainty from the scatter of the residuals, linearised at the fit; infinite where the measurement
    does not determine the parameter."""

    @property
    def determined(self) -> bool:
        """Whether the measurement says anything of it."""
        return math.isfinite(self.u)


@dataclass(frozen=True, slots=True)
class Calibration:
    """A scene fitted to a measurement, all arrays of shape (n,) in the measurement's unit."""

    scene: WindingScene
    """With the fitted values."""
    fitted: tuple[Fitted, ...]
    measured: Array
    """What was compared: T/T₀ of the layers, or quantiles of the span's tension [N]."""
    before: Array
    """The same as the scene gave it."""
    after: Array
    """The same as the fitted scene gives it."""
    runs: int
    """Fast runs that the fit took."""
    converged: bool
    message: str

    @property
    def rms_before(self) -> float:
        """Root mean square difference from the measurement."""
        return float(np.sqrt(np.mean((self.before - self.measured) ** 2)))

    @property
    def rms_after(self) -> float:
        """Root mean square difference from the measurement."""
        return float(np.sqrt(np.mean((self.after - self.measured) ** 2)))


def calibrate_to_layers(scene: WindingScene, profile: Array, names: Sequence[Name] = NAMES) -> Calibration:
    """Fit to T/T₀ of the layers, innermost first, shape (n,).

    Raises
    ------
    ValueError
        If there are fewer layers than parameters and one more, or more than the scene completes.
    """
    complete = wind_fast(scene, "calibration").layers_T_over_T0.size
    if not len(names) < profile.size <= complete:
        raise ValueError(f"{profile.size} layers: {len(names) + 1} to {complete} can be fitted in this scene")
    return _fit(scene, names, profile, lambda result: result.layers_T_over_T0[: profile.size])


def calibrate_to_span(scene: WindingScene, readings: Array, names: Sequence[Name] = NAMES) -> Calibration:
    """Fit to readings of the tension between guide and bobbin [N], shape (n,), of a settled winding, any phase.

    Raises
    ------
    ValueError
        If there are fewer readings than quantiles that are compared.
    """
    if readings.size < QUANTILES.size:
        raise ValueError(f"{readings.size} readings: at least {QUANTILES.size} are needed")

    def quantiles(result: WindingResult) -> Array:
        settled = result.span_tension[result.time > 2 * scene.speed_rise]
        return np.quantile(settled, QUANTILES)

    return _fit(scene, names, np.quantile(readings, QUANTILES), quantiles)


def _fit(
    scene: WindingScene, names: Sequence[Name], measured: Array, predict: Callable[[WindingResult], Array]
) -> Calibration:
    runs = 0

    def predicted(chosen: Sequence[Name], x: Array) -> Array:
        nonlocal runs
        runs += 1
        return predict(wind_fast(_with(scene, chosen, x), "calibration"))

    start = _of(scene, names)
    before = predicted(names, start)
    scale = float(np.max(np.abs(measured)))
    seen: tuple[Name, ...] = tuple(
        name
        for k, name in enumerate(names)
        if np.max(np.abs(predicted(names, start + _far(scene, name) * np.eye(len(names))[k]) - before)) > FAINT * scale
    )
    if not seen:
        fitted = tuple(Fitted(name, _value(scene, name), _value(scene, name), math.inf) for name in names)
        return Calibration(
            scene, fitted, measured, before, before, runs, False, "the measurement determines no parameter"
        )
    bounds = np.array([_bounds(scene, name) for name in seen]).T
    starts = [start[[names.index(name) for name in seen]]]
    if "transverse_stiffness" in seen:  # a profile may have one valley for sinking and one for relaxing
        starts += [_with_stiffness(starts[0], seen, decade) for decade in SCANNED]
    misses = [float(np.sum((predicted(seen, x) - measured) ** 2)) for x in starts]
    first = np.clip(starts[int(np.argmin(misses))], bounds[0] + 1e-6, bounds[1] - 1e-6)
    found = least_squares(
        lambda x: predicted(seen, x) - measured,
        first,
        bounds=(bounds[0], bounds[1]),
        diff_step=np.full(len(seen), STEP),
        xtol=1e-5,
        ftol=1e-8,
        gtol=1e-10,
    )
    best = _with(scene, seen, found.x)
    u = _uncertainty(np.asarray(found.jac, dtype=np.float64), np.asarray(found.fun, dtype=np.float64))
    fitted = tuple(
        Fitted(name, _value(scene, name), _value(best, name), _u_of(best, name, float(u[seen.index(name)])))
        if name in seen
        else Fitted(name, _value(scene, name), _value(scene, name), math.inf)
        for name in names
    )
    after = measured + np.asarray(found.fun, dtype=np.float64)
    return Calibration(best, fitted, measured, before, after, runs, bool(found.success), str(found.message))


def _uncertainty(jacobian: Array, residuals: Array) -> Array:
    """√ of the diagonal of s² (JᵀJ)⁻¹, s² the residuals' variance over their freedom."""
    freedom = max(1, residuals.size - jacobian.shape[1])
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * float(residuals @ residuals) / freedom
    return np.sqrt(np.diag(covariance))


# The unknowns x: log₁₀ of the stiffness, whose effect goes over decades, and the relaxation as it is.


def _with_stiffness(x: Array, names: Sequence[Name], decade: float) -> Array:
    changed = x.copy()
    changed[names.index("transverse_stiffness")] = decade
    return changed


def _value(scene: WindingScene, name: Name) -> float:
    return scene.transverse_stiffness if name == "transverse_stiffness" else scene.prony_weights[0]


def _of(scene: WindingScene, names: Sequence[Name]) -> Array:
    values = [_value(scene, name) for name in names]
    return np.array([math.log10(v) if n == "transverse_stiffness" else v for n, v in zip(names, values, strict=True)])


def _with(scene: WindingScene, names: Sequence[Name], x: Array) -> WindingScene:
    for name, value in zip(names, x, strict=True):
        if name == "transverse_stiffness":
            scene = replace(scene, transverse_stiffness=float(10**value))
        else:
            scene = replace(scene, prony_weights=(float(value), *scene.prony_weights[1:]))
    return scene


def _bounds(scene: WindingScene, name: Name) -> tuple[float, float]:
    if name == "transverse_stiffness":
        return math.log10(STIFFNESS[0]), math.log10(STIFFNESS[1])
    return 0.0, LARGEST_SUM - sum(scene.prony_weights[1:])


def _far(scene: WindingScene, name: Name) -> float:
    """A large step of the unknown: a tenfold softer yarn, full relaxation."""
    return -1.0 if name == "transverse_stiffness" else _bounds(scene, name)[1] - scene.prony_weights[0]


def _u_of(scene: WindingScene, name: Name, u: float) -> float:
    """The standard uncertainty of the value from that of the unknown."""
    return u * math.log(10) * scene.transverse_stiffness if name == "transverse_stiffness" else u
