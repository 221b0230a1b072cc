"""Following a branch of solutions F(x, λ) = 0 from one parameter value to another, around folds. Knows no yarn.

Natural continuation first: predict along the tangent, correct with Newton at fixed λ, lengthen or shorten the step by
the number of corrections. Where that no longer works, pseudo-arclength: λ joins the unknowns, and the arc's projection
on the tangent is prescribed, so that the branch can turn back (Keller, in Applications of Bifurcation Theory (1977)
359). At a fold the tangent's λ component changes sign; the fold is then located on the arc by root finding on that
component. λ is stationary there, so that its error is of second order in the arc's.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.boundary_value import COMPLEX_STEP, Array, Collocated, Values, evaluated, parameter_slopes
from models.discretisation import Discretisation

Family = Callable[[Array, float], tuple[Array, Array, Array]]
"""x, shape (n,), and λ to F, shape (n,), ∂F/∂x, shape (n, n), and ∂F/∂λ, shape (n,)."""

CORRECTIONS = 8
FEW, MANY = 3, 5
"""Numbers of corrections below and above which the step is lengthened and shortened."""
LONGEST_ARC = 0.25
FOLD_TOLERANCE = 1e-7
"""Of the arc at a fold; λ is then exact to its square."""


def collocated_family(
    make: Callable[[Values], Any],
    numbers: Array,
    place: int,
    orders: NDArray[np.int64],
    discretisation: Discretisation,
) -> Family:
    """The family of a boundary-value problem in one of its numbers, with exact derivatives.

    Parameters
    ----------
    make : makes the problem from its numbers, real or complex.
    place : of the number that is the parameter; the discretisation must not depend on it.
    """
    derivatives = discretisation.derivatives
    complex_derivatives = derivatives.astype(np.complex128)

    def family(x: Array, parameter: float) -> tuple[Array, Array, Array]:
        moved = numbers.astype(np.complex128)
        moved[place] = parameter + 1j * COMPLEX_STEP
        at = Collocated(make(moved.real.copy()), orders, derivatives)
        value, jacobian = evaluated(at, x)
        return value, jacobian, parameter_slopes(Collocated(make(moved), orders, complex_derivatives), x)

    return family


class End(Enum):
    """Why following a branch ended."""

    REACHED = "the target was reached"
    TURNED = "the branch turned back at a fold and returned to where it began"
    STALLED = "the corrector failed on the shortest step"
    STEPS = "the number of steps ran out"


@dataclass(frozen=True, slots=True)
class Fold:
    """A point where two solutions meet and the branch turns back."""

    parameter: float
    x: Array


@dataclass(frozen=True, slots=True)
class Branch:
    """A branch as far as it was followed."""

    end: End
    x: Array
    """The last point, at the target where it was reached, shape (n,)."""
    parameter: float
    folds: tuple[Fold, ...]
    steps: int


@dataclass(frozen=True, slots=True)
class _Point:
    """A point of the branch with its unit tangent."""

    x: Array
    parameter: float
    tangent: Array
    """(dx/ds, dλ/ds), shape (n + 1,), of unit length in the scaled norm."""


def follow(
    family: Family,
    x: Array,
    start: float,
    target: float,
    *,
    tolerance: float = 1e-9,
    first_step: float = 0.1,
    shortest_step: float = 1e-4,
    max_steps: int = 200,
) -> Branch:
    """Follow the branch through (x, start) to λ = target.

    Parameters
    ----------
    family : the equations with their derivatives; values that are not finite count as a failed correction.
    x : a solution, or nearly one, at λ = start, shape (n,).
    tolerance : largest accepted Newton correction relative to 1 + |x|.
    first_step, shortest_step : of λ, relative to |target − start|; the shortest also of the arc.
    max_steps : accepted and rejected steps together.

    Returns
    -------
    Branch
        With the folds passed on the way. `End.TURNED` after a fold means that the branch has no point at the target;
        with folds and `End.REACHED` it reaches the target after turning forward again.
    """
    span = target - start

    def scaled(x: Array, s: float) -> tuple[Array, Array, Array]:
        """The family with its parameter from 0 to 1."""
        return _scale(family(x, start + s * span), span)

    x, converged, _ = _correct_natural(scaled, x, 0.0, tolerance)
    if not converged:
        return Branch(End.STALLED, x, start, (), 0)
    x, reached, steps = _natural(scaled, x, tolerance, first_step, shortest_step, max_steps)
    if reached == 1.0:
        return Branch(End.REACHED, x, target, (), steps)
    end, x, reached, folds, more = _arclength(scaled, x, reached, tolerance, shortest_step, max_steps - steps)
    found = tuple(Fold(start + fold.parameter * span, fold.x) for fold in folds)
    return Branch(end, x, start + reached * span, found, steps + more)


def _scale(values: tuple[Array, Array, Array], span: float) -> tuple[Array, Array, Array]:
    return values[0], values[1], values[2] * span


def _correct_natural(family: Family, x: Array, parameter: float, tolerance: float) -> tuple[Array, bool, int]:
    """Newton at fixed λ: x, whether it converged and the number of corrections."""
    last = np.inf
    for iteration in range(CORRECTIONS):
        value, jacobian, _ = family(x, parameter)
        correction = _solve(jacobian, -value)
        if correction is None:
            return x, False, iteration
        size = float(np.max(np.abs(correction) / (1 + np.abs(x))))
        if size > 2 * last:
            return x, False, iteration
        x, last = x + correction, size
        if size <= tolerance:
            return x, True, iteration + 1
    return x, False, CORRECTIONS


def _natural(
    family: Family, x: Array, tolerance: float, step: float, shortest: float, max_steps: int
) -> tuple[Array, float, int]:
    """Continue in λ from 0 while steps of useful length succeed: x, λ reached and the number of steps."""
    reached, steps = 0.0, 0
    slope = _natural_slope(family, x, reached)
    while reached < 1.0 and step >= 10 * shortest and slope is not None and steps < max_steps:
        steps += 1
        trial = min(1.0, reached + step)
        corrected, converged, count = _correct_natural(family, x + (trial - reached) * slope, trial, tolerance)
        if not converged:
            step /= 2
            continue
        x, reached = corrected, trial
        slope = _natural_slope(family, x, reached)
        step *= 2.0 if count <= FEW else (0.5 if count > MANY else 1.0)
    return x, reached, steps


def _natural_slope(family: Family, x: Array, parameter: float) -> Array | None:
    _, jacobian, by_parameter = family(x, parameter)
    return _solve(jacobian, -by_parameter)


def _arclength(
    family: Family, x: Array, parameter: float, tolerance: float, shortest: float, max_steps: int
) -> tuple[End, Array, float, list[Fold], int]:
    """Continue along the arc: end, x and λ of the last point, folds and the number of steps."""
    forward = np.append(np.zeros_like(x), 1.0)
    tangent = _tangent(family, x, parameter, forward)
    if tangent is None:
        return End.STALLED, x, parameter, [], 0
    point = _Point(x, parameter, tangent)
    folds: list[Fold] = []
    step = 10 * shortest
    for steps in range(1, max_steps + 1):
        found, count = _step(family, point, step, tolerance)
        if found is None:
            step /= 2
            if step < shortest * 1e-2:
                return End.STALLED, point.x, point.parameter, folds, steps
            continue
        if found.tangent[-1] * point.tangent[-1] < 0:
            folds.append(_locate(family, point, found, step, tolerance))
        if found.parameter >= 1.0:
            x, converged, _ = _correct_natural(family, found.x, 1.0, tolerance)
            part = (1.0 - point.parameter) / (found.parameter - point.parameter)
            if not converged:
                x, converged, _ = _correct_natural(family, point.x + part * (found.x - point.x), 1.0, tolerance)
            if converged:
                return End.REACHED, x, 1.0, folds, steps
            step /= 2
            continue
        if found.parameter < shortest and folds:
            return End.TURNED, found.x, found.parameter, folds, steps
        point = found
        step = min(LONGEST_ARC, step * (2.0 if count <= FEW else (0.5 if count > MANY else 1.0)))
    return End.STEPS, point.x, point.parameter, folds, max_steps


def _weights(x: Array) -> Array:
    """Squared weights of the norm in which arcs are measured: the mean square of x relative to 1 + |x|, and λ."""
    return np.append(1 / (x.size * (1 + np.abs(x)) ** 2), 1.0)


def _tangent(family: Family, x: Array, parameter: float, along: Array) -> Array | None:
    """Unit tangent at a point of the branch, in the direction of `along`; None where it is not defined."""
    _, jacobian, by_parameter = family(x, parameter)
    weights = _weights(x)
    bordered = np.block([[jacobian, by_parameter[:, None]], [(weights * along)[None, :]]])
    direction = _solve(bordered, np.append(np.zeros_like(x), 1.0))
    if direction is None:
        return None
    return np.asarray(direction / np.sqrt(np.sum(weights * direction**2)), dtype=np.float64)


def _step(family: Family, point: _Point, step: float, tolerance: float) -> tuple[_Point | None, int]:
    """The point at arc `step` along the tangent, by Newton in (x, λ), and the number of corrections."""
    weights = _weights(point.x)
    x, parameter = point.x + step * point.tangent[:-1], point.parameter + step * point.tangent[-1]
    last = np.inf
    for count in range(1, CORRECTIONS + 1):
        value, jacobian, by_parameter = family(x, parameter)
        moved = np.append(x - point.x, parameter - point.parameter)
        arc = float(np.sum(weights * point.tangent * moved)) - step
        bordered = np.block([[jacobian, by_parameter[:, None]], [(weights * point.tangent)[None, :]]])
        correction = _solve(bordered, -np.append(value, arc))
        if correction is None:
            return None, count
        size = float(np.max(np.abs(correction) / (1 + np.abs(np.append(x, parameter)))))
        if size > 2 * last:
            return None, count
        last = size
        x, parameter = x + correction[:-1], float(parameter + correction[-1])
        if size <= tolerance:
            tangent = _tangent(family, x, parameter, point.tangent)
            return (None if tangent is None else _Point(x, parameter, tangent)), count
    return None, CORRECTIONS


def _locate(family: Family, before: _Point, after: _Point, step: float, tolerance: float) -> Fold:
    """The fold between two points, by regula falsi (Illinois) on dλ/ds as a function of the arc."""
    low, high = 0.0, step
    at_low, at_high = float(before.tangent[-1]), float(after.tangent[-1])
    best = after if abs(at_high) < abs(at_low) else before
    side = 0
    for _ in range(40):
        if high - low <= FOLD_TOLERANCE * step:
            break
        middle = (low * at_high - high * at_low) / (at_high - at_low)
        found, _ = _step(family, before, middle, tolerance)
        if found is None:
            break
        at_middle = float(found.tangent[-1])
        if abs(at_middle) < abs(best.tangent[-1]):
            best = found
        if abs(at_middle) <= FOLD_TOLERANCE:
            break
        if (at_middle > 0) == (at_low > 0):
            low, at_low = middle, at_middle
            at_high, side = (at_high / 2 if side == -1 else at_high), -1
        else:
            high, at_high = middle, at_middle
            at_low, side = (at_low / 2 if side == 1 else at_low), 1
    return Fold(best.parameter, best.x)


def _solve(matrix: NDArray[np.float64], right: Array) -> Array | None:
    """The solution of a linear system; None where it is singular or not finite."""
    if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(right))):
        return None
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
