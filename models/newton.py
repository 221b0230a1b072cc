"""Damped Newton iteration for square nonlinear systems, compiled. Knows no yarn.

Deuflhard, Newton Methods for Nonlinear Problems (2004), section 3.3: the step is shortened until the simplified
Newton correction J⁻¹F at the trial point decreases (natural monotonicity test), which does not depend on how the
equations are scaled. Success needs both a small correction and a small residual.
"""

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.compiled import inner

Array = NDArray[np.float64]

MIN_DAMPING = 1e-4
"""Smallest step length tried before the iteration counts as stalled."""
SMALLEST_PIVOT = 1e-15
"""Pivot relative to the largest, below which a matrix counts as singular."""


class NewtonStatus(IntEnum):
    """Why the iteration ended."""

    CONVERGED = 0
    MAX_ITERATIONS = 1
    STALLED = 2
    SINGULAR = 3
    NOT_FINITE = 4

    @property
    def text(self) -> str:
        """The reason in words."""
        return (
            "step and residual are below their tolerances",
            "the iteration limit was reached",
            "no step length along the Newton direction decreases the correction",
            "the Jacobian is singular to working precision",
            "the equations have no finite value at the starting point",
        )[self]


def evaluate(problem: Any, x: Array, value: Array, jacobian: Array) -> None:
    """Fill F(x), shape (n,), and its Jacobian, shape (n, n). `implement` gives each type of problem its own."""
    raise NotImplementedError(f"no equations for {type(problem).__name__}")


_CONVERGED, _MAX_ITERATIONS, _STALLED, _SINGULAR, _NOT_FINITE = range(5)


@inner
def lu_factor(matrix: Array, pivots: NDArray[np.int64]) -> bool:
    """Factorise in place with partial pivoting; False where a pivot vanishes to working precision.

    Written out because the matrices are small (up to about 100 rows): a call of LAPACK costs more than it saves.
    """
    n = matrix.shape[0]
    largest, smallest = 0.0, np.inf
    for k in range(n):
        p = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[p, k]):
                p = i
        pivots[k] = p
        pivot = matrix[p, k]
        largest, smallest = max(largest, abs(pivot)), min(smallest, abs(pivot))
        if pivot == 0.0:
            return False
        if p != k:
            for j in range(n):
                matrix[k, j], matrix[p, j] = matrix[p, j], matrix[k, j]
        for i in range(k + 1, n):
            factor = matrix[i, k] / pivot
            matrix[i, k] = factor
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
    return smallest > SMALLEST_PIVOT * largest


@inner
def lu_solve(factors: Array, pivots: NDArray[np.int64], right: Array) -> Array:
    """Solve with the factors; `right`, shape (n,), is not changed."""
    n = factors.shape[0]
    x = right.copy()
    for k in range(n):
        p = pivots[k]
        x[k], x[p] = x[p], x[k]
    for i in range(n):
        for j in range(i):
            x[i] -= factors[i, j] * x[j]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            x[i] -= factors[i, j] * x[j]
        x[i] /= factors[i, i]
    return x


@inner
def newton(
    problem: Any,
    x: Array,
    step_tolerance: float,
    residual_tolerance: float,
    max_iterations: int,
) -> tuple[int, int, float, float, Array, Array]:
    """Solve F(x) = 0 in place.

    Parameters
    ----------
    problem : an instance of a type that `evaluate` is implemented for.
    x : start on entry and last iterate on return, shape (n,).
    step_tolerance : largest accepted Newton correction |J⁻¹F| at x, relative to 1 + |x|.
    residual_tolerance : largest accepted |F| at x.
    max_iterations : Newton steps, each with one Jacobian.

    Returns
    -------
    tuple
        Status, iterations, |F| at x, the last correction, then F and the Jacobian at x; norms are maximum norms.
    """
    n = x.shape[0]
    value, trial_value = np.empty(n), np.empty(n)
    jacobian, trial_jacobian, factors = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    pivots = np.empty(n, np.int64)
    evaluate(problem, x, value, jacobian)
    step, damping, residual = np.inf, 1.0, np.inf
    for iteration in range(max_iterations + 1):
        residual = np.max(np.abs(value))
        if not (np.isfinite(residual) and np.all(np.isfinite(jacobian))):
            return _NOT_FINITE, iteration, residual, step, value, jacobian
        factors[:] = jacobian
        if not lu_factor(factors, pivots):
            return _SINGULAR, iteration, residual, step, value, jacobian
        direction = -lu_solve(factors, pivots, value)
        step = np.max(np.abs(direction) / (1.0 + np.abs(x)))
        if step <= step_tolerance and residual <= residual_tolerance:
            trial = x + direction  # the correction is known: take it, so that the error is its square
            evaluate(problem, trial, trial_value, trial_jacobian)
            if np.max(np.abs(trial_value)) <= residual:
                x[:] = trial
                return _CONVERGED, iteration + 1, np.max(np.abs(trial_value)), step, trial_value, trial_jacobian
            return _CONVERGED, iteration, residual, step, value, jacobian
        if iteration == max_iterations:
            break
        size = np.sqrt(np.sum(direction * direction))
        damping = min(1.0, 4.0 * damping)
        while True:
            trial = x + damping * direction
            evaluate(problem, trial, trial_value, trial_jacobian)
            if np.all(np.isfinite(trial_value)):
                simplified = lu_solve(factors, pivots, trial_value)
                if np.sqrt(np.sum(simplified * simplified)) <= (1.0 - damping / 4.0) * size:
                    break
            damping /= 2.0
            if damping < MIN_DAMPING:
                return _STALLED, iteration, residual, step, value, jacobian
        x[:] = trial
        value[:] = trial_value
        jacobian[:] = trial_jacobian
    return _MAX_ITERATIONS, max_iterations, residual, step, value, jacobian
