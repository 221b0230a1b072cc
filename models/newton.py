"""Damped Newton iteration for square nonlinear systems. Knows no yarn.

Deuflhard, Newton Methods for Nonlinear Problems (2004), section 3.3: the step is shortened until the simplified
Newton correction J⁻¹F at the trial point decreases (natural monotonicity test), which does not depend on how the
equations are scaled. Success needs both a small step and a small residual.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgWarning, lu_factor, lu_solve

Array = NDArray[np.float64]


class NewtonStatus(Enum):
    """Why the iteration ended."""

    CONVERGED = "step and residual are below their tolerances"
    MAX_ITERATIONS = "the iteration limit was reached"
    STALLED = "no step length along the Newton direction decreases the correction"
    SINGULAR = "the Jacobian is singular to working precision"
    NOT_FINITE = "the equations have no finite value at the starting point"


@dataclass(frozen=True, slots=True)
class NewtonResult:
    """Last iterate, shape (n,), and the evidence for it: maximum norms of F and of the Newton correction at x."""

    x: Array
    status: NewtonStatus
    iterations: int
    residual: float
    step: float
    value: Array
    """F at x, shape (n,)."""
    jacobian: Array
    """J at x, shape (n, n)."""


def newton(
    function: Callable[[Array], tuple[Array, Array]],
    start: Array,
    *,
    step_tolerance: float,
    residual_tolerance: float,
    max_iterations: int = 40,
    min_damping: float = 1e-4,
) -> NewtonResult:
    """Solve F(x) = 0.

    Parameters
    ----------
    function : x of shape (n,) → (F of shape (n,), exact Jacobian of shape (n, n)).
    start : shape (n,), not changed.
    step_tolerance : largest accepted Newton correction |J⁻¹F| at x, relative to 1 + |x|.
    residual_tolerance : largest accepted |F| at x.
    max_iterations : Newton steps, each with one Jacobian.
    min_damping : smallest step length tried before the iteration counts as stalled.
    """
    x = np.array(start, dtype=float)
    value, jacobian = function(x)
    step, damping = np.inf, 1.0
    for iteration in range(max_iterations):
        residual = float(np.max(np.abs(value)))
        if not (np.isfinite(residual) and np.all(np.isfinite(jacobian))):
            return NewtonResult(x, NewtonStatus.NOT_FINITE, iteration, residual, step, value, jacobian)
        factors = _factorise(jacobian)
        if factors is None:
            return NewtonResult(x, NewtonStatus.SINGULAR, iteration, residual, step, value, jacobian)
        direction: Array = -lu_solve(factors, value)
        step = float(np.max(np.abs(direction) / (1.0 + np.abs(x))))
        if step <= step_tolerance and residual <= residual_tolerance:
            return NewtonResult(x, NewtonStatus.CONVERGED, iteration, residual, step, value, jacobian)
        size = float(np.linalg.norm(direction))
        damping = min(1.0, 4.0 * damping)
        while True:
            trial = x + damping * direction
            trial_value, trial_jacobian = function(trial)
            if np.all(np.isfinite(trial_value)):
                simplified = float(np.linalg.norm(lu_solve(factors, trial_value)))
                if simplified <= (1.0 - damping / 4.0) * size:
                    break
            damping /= 2.0
            if damping < min_damping:
                return NewtonResult(x, NewtonStatus.STALLED, iteration, residual, step, value, jacobian)
        x, value, jacobian = trial, trial_value, trial_jacobian
    residual = float(np.max(np.abs(value)))
    return NewtonResult(x, NewtonStatus.MAX_ITERATIONS, max_iterations, residual, step, value, jacobian)


def _factorise(jacobian: Array) -> tuple[Array, NDArray[np.int32]] | None:
    """LU factors, or None where a pivot vanishes to working precision."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)  # an exactly singular matrix is handled below
        factors = lu_factor(jacobian, check_finite=False)
    pivots = np.abs(np.diag(factors[0]))
    return factors if pivots.min() > 1e-15 * pivots.max() else None
