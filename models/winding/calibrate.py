"""Calibration of what no data sheet gives, by least squares on the fast mode.

The fast mode is fitted, because a fit needs tens of runs; verify its result by one run of the reference mode.

Two kinds of measurement are known:

- A layer profile: T/T₀ of each layer of a package at the end. It determines the transverse stiffness and the
  relaxation: a soft yarn loses tension by being wound over, a relaxing one by the time since it was laid.
- Readings of the tension between guide and bobbin. Their phase against the guide is not known, so that the quantiles
  of the readings are compared and not the series. They determine the friction on the guide, by their mean, and the
  axial stiffness, whose waves ρc make the spread. A span hardly knows what becomes of the yarn on the bobbin: a
  parameter that a measurement does not determine is said to be undetermined and stays as it was.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from models.winding.fast import wind_fast
from models.winding.result import WindingResult
from models.winding.scene import WindingScene

Array = NDArray[np.float64]
Name = Literal["transverse_stiffness", "relaxation", "axial_stiffness", "guide_friction"]
OF_LAYERS: tuple[Name, ...] = ("transverse_stiffness", "relaxation")
OF_SPAN: tuple[Name, ...] = ("transverse_stiffness", "relaxation", "axial_stiffness", "guide_friction")

QUANTILES = np.linspace(0.05, 0.95, 19)
"""Of the readings of a span's tension that are compared."""
STIFFNESS = (1e5, 1e9)
"""Range of the transverse stiffness [N/m²]: outside it a yarn is pulp, or rigid."""
AXIAL = 10.0
"""Largest factor on the axial stiffness, up or down."""
SCANNED = (5.5, 6.0, 6.5, 7.0)
"""log₁₀ of the stiffnesses that a fit is tried from, beside the scene's own; the best is taken."""
LARGEST_SUM = 0.99
"""Largest sum of the Prony weights."""
FAINT = 5e-3
"""Change of the predicted numbers over the largest of them, for a large step of a parameter, that counts as none: what
a good tension meter just tells apart."""
STEP = 0.02
"""Of the differences that make the Jacobian: the run's own tolerance is far below what this changes."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """One parameter."""

    name: Name
    start: float
    value: float
    """SI; the relaxation is the first Prony weight."""
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


def calibrate_to_layers(scene: WindingScene, profile: Array, names: Sequence[Name] = OF_LAYERS) -> Calibration:
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


def calibrate_to_span(scene: WindingScene, readings: Array, names: Sequence[Name] = OF_SPAN) -> Calibration:
    """Fit to readings of the tension between guide and bobbin [N], shape (n,), of a settled winding, any phase.

    Raises
    ------
    ValueError
        If there are fewer readings than quantiles that are compared, or their mean is not above 0.
    """
    if readings.size < QUANTILES.size:
        raise ValueError(f"{readings.size} readings: at least {QUANTILES.size} are needed")
    if not readings.mean() > 0:
        raise ValueError(f"mean tension {readings.mean():g} N: must be greater than 0")

    def quantiles(result: WindingResult) -> Array:
        settled = result.span_tension[result.time > 2 * scene.speed_rise]
        return np.quantile(settled, QUANTILES)

    return _fit(scene, names, np.quantile(readings, QUANTILES), quantiles)


def _fit(
    scene: WindingScene, names: Sequence[Name], measured: Array, predict: Callable[[WindingResult], Array]
) -> Calibration:
    """Fit what the measurement determines: a parameter whose u is as wide as its range is put back and left out."""
    runs = 0

    def predicted(chosen: Sequence[Name], x: Array) -> Array:
        nonlocal runs
        runs += 1
        return predict(wind_fast(_with(scene, chosen, x), "calibration"))

    before = predicted(names, _of(scene, names))
    faint = FAINT * float(np.max(np.abs(measured)))
    seen: list[Name] = [
        name
        for name in names
        if np.max(np.abs(predicted([name], _of(scene, [name]) + _far(scene, name)) - before)) > faint
    ]
    while seen:
        found = _least_squares(scene, seen, measured, predicted)
        u = _uncertainty(np.asarray(found.jac, dtype=np.float64), np.asarray(found.fun, dtype=np.float64))
        low, high = _bounds(scene, seen)
        weak = u > (high - low) / 2
        if not weak.any():
            best = _with(scene, seen, found.x)
            known = {
                name: Fitted(name, _value(scene, name), _value(best, name), _u_of(best, name, float(u[k])))
                for k, name in enumerate(seen)
            }
            fitted = tuple(known.get(name, _undetermined(scene, name)) for name in names)
            after = measured + np.asarray(found.fun, dtype=np.float64)
            return Calibration(best, fitted, measured, before, after, runs, bool(found.success), str(found.message))
        seen = [name for k, name in enumerate(seen) if not weak[k]]
    fitted = tuple(_undetermined(scene, name) for name in names)
    return Calibration(scene, fitted, measured, before, before, runs, False, "the measurement determines no parameter")


def _least_squares(
    scene: WindingScene, names: Sequence[Name], measured: Array, predicted: Callable[[Sequence[Name], Array], Array]
) -> Any:
    """Result of scipy's solver. The Jacobian's steps are absolute: relative ones vanish where a parameter is 0."""
    low, high = _bounds(scene, names)

    def misses(x: Array) -> Array:
        return predicted(names, x) - measured

    def jacobian(x: Array) -> Array:
        steps = np.where(x + STEP < high, STEP, -STEP)
        here = predicted(names, x)
        return np.column_stack(
            [
                (predicted(names, x + step * unit) - here) / step
                for step, unit in zip(steps, np.eye(x.size), strict=True)
            ]
        )

    starts = [_of(scene, names)]
    if "transverse_stiffness" in names:  # a profile may have one valley for sinking and one for relaxing
        which = np.array([name == "transverse_stiffness" for name in names])
        starts += [np.where(which, decade, starts[0]) for decade in SCANNED]
    first = min(starts, key=lambda x: float(np.sum(misses(x) ** 2)))
    inside = np.clip(first, low + 1e-6, high - 1e-6)
    return least_squares(misses, inside, jacobian, bounds=(low, high), xtol=1e-5, ftol=1e-8, gtol=1e-10)  # pyright: ignore[reportArgumentType, reportUnknownVariableType]


def _uncertainty(jacobian: Array, residuals: Array) -> Array:
    """√ of the diagonal of s² (JᵀJ)⁻¹, s² the residuals' variance over their freedom."""
    freedom = max(1, residuals.size - jacobian.shape[1])
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * float(residuals @ residuals) / freedom
    return np.sqrt(np.diag(covariance))


# The unknowns x: log₁₀ of the stiffnesses, whose effects go over decades, the others as they are.


def _logarithmic(name: Name) -> bool:
    return name in ("transverse_stiffness", "axial_stiffness")


def _value(scene: WindingScene, name: Name) -> float:
    return scene.prony_weights[0] if name == "relaxation" else float(getattr(scene, name))


def _of(scene: WindingScene, names: Sequence[Name]) -> Array:
    return np.array([_unknown(scene, name) for name in names])


def _unknown(scene: WindingScene, name: Name) -> float:
    return math.log10(_value(scene, name)) if _logarithmic(name) else _value(scene, name)


def _with(scene: WindingScene, names: Sequence[Name], x: Array) -> WindingScene:
    for name, unknown in zip(names, x, strict=True):
        value = float(10**unknown) if _logarithmic(name) else float(unknown)
        if name == "relaxation":
            scene = replace(scene, prony_weights=(value, *scene.prony_weights[1:]))
        else:
            scene = replace(scene, **{name: value})
    return scene


def _bounds(scene: WindingScene, names: Sequence[Name]) -> tuple[Array, Array]:
    """Lowest and highest unknowns, each of shape (n,)."""
    axial = math.log10(scene.axial_stiffness)
    ranges: dict[Name, tuple[float, float]] = {
        "transverse_stiffness": (math.log10(STIFFNESS[0]), math.log10(STIFFNESS[1])),
        "axial_stiffness": (axial - math.log10(AXIAL), axial + math.log10(AXIAL)),
        "relaxation": (0.0, LARGEST_SUM - sum(scene.prony_weights[1:])),
        "guide_friction": (0.0, 1.0),
    }
    return np.array([ranges[name][0] for name in names]), np.array([ranges[name][1] for name in names])


def _undetermined(scene: WindingScene, name: Name) -> Fitted:
    return Fitted(name, _value(scene, name), _value(scene, name), math.inf)


def _far(scene: WindingScene, name: Name) -> float:
    """A large step of the unknown: a tenfold softer yarn, half the modulus, full relaxation, friction 0.3."""
    if name == "relaxation":
        return LARGEST_SUM - sum(scene.prony_weights)
    return {"transverse_stiffness": -1.0, "axial_stiffness": -math.log10(2), "guide_friction": 0.3}[name]


def _u_of(scene: WindingScene, name: Name, u: float) -> float:
    """The standard uncertainty of the value from that of the unknown."""
    return u * math.log(10) * _value(scene, name) if _logarithmic(name) else u
