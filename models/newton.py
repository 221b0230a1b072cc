"""Damped Newton iteration for square nonlinear systems, compiled. Knows no yarn.

Deuflhard, Newton Methods for Nonlinear Problems (2004), section 3.3: the step is shortened until the simplified
Newton correction J⁻¹F at the trial point decreases (natural monotonicity test), which does not depend on how the
equations are scaled. Where full steps contract well the Jacobian is kept (chord steps): for pointwise problems it costs
several residuals. Success needs both a small correction and a small residual.
"""

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import inner

Array = NDArray[np.float64]

MIN_DAMPING = 1e-4
"""Smallest step length tried before the iteration counts as stalled."""
GOOD_CONTRACTION = 0.2
"""Ratio Θ of neighbouring corrections up to which another step with the same Jacobian is cheaper than a new one."""
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


def residual(problem: Any, x: Array, value: Array) -> None:
    """Fill F(x), shape (n,). `implement` gives each type of problem its own."""
    raise NotImplementedError(f"no equations for {type(problem).__name__}")


def jacobian(problem: Any, x: Array, matrix: Array) -> None:
    """Fill ∂F/∂x, shape (n, n). `implement` gives each type of problem its own."""
    raise NotImplementedError(f"no derivatives for {type(problem).__name__}")


# What is compiled for a call from an inner function is not shared with calls from others: these two are for the latter.


@inner
def system(problem: Any, x: Array) -> tuple[Array, Array]:
    """F(x), shape (n,), and ∂F/∂x, shape (n, n)."""
    value, matrix = np.empty(x.shape[0]), np.empty((x.shape[0], x.shape[0]))
    residual(problem, x, value)
    jacobian(problem, x, matrix)
    return value, matrix


@inner
def values(problem: Any, x: NDArray[Any]) -> NDArray[Any]:
    """F(x), shape (n,), real or complex."""
    value = np.empty_like(x)
    residual(problem, x, value)
    return value


class LinearSystem(NamedTuple):
    """A factorised matrix."""

    factors: Array
    """By `lu_factor`, shape (n, n)."""
    pivots: NDArray[np.int64]
    norm: float
    """‖A‖₁ of the matrix itself; infinite where there is none."""


CONVERGED, MAX_ITERATIONS_REACHED, STALLED, SINGULAR, NOT_FINITE = map(int, NewtonStatus)
"""The reasons as compiled code knows them."""


@inner
def lu_factor(matrix: Array, pivots: NDArray[np.int64]) -> bool:
    """Factorise in place with partial pivoting; False where a pivot vanishes to working precision.

    Written out because the matrices are small (up to about 100 rows): a call of LAPACK costs more than it saves.
    """
    n = matrix.shape[0]
    biggest, smallest = 0.0, np.inf
    for k in range(n):
        pivots[k] = k  # also of rows that are not reached: what solves with them stays inside of the matrix
    for k in range(n):
        p = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[p, k]):
                p = i
        pivots[k] = p
        pivot = matrix[p, k]
        biggest, smallest = max(biggest, abs(pivot)), min(smallest, abs(pivot))
        if pivot == 0.0:
            return False
        if p != k:
            for j in range(n):
                matrix[k, j], matrix[p, j] = matrix[p, j], matrix[k, j]
        # Two rows at a time, as slices, so that the innermost loops become vector instructions that share `upper`.
        upper = matrix[k, k + 1 :]
        for i in range(k + 1, n - 1, 2):
            factor, next_factor = matrix[i, k] / pivot, matrix[i + 1, k] / pivot
            matrix[i, k], matrix[i + 1, k] = factor, next_factor
            row, next_row = matrix[i, k + 1 :], matrix[i + 1, k + 1 :]
            for j in range(row.shape[0]):
                row[j] -= factor * upper[j]
                next_row[j] -= next_factor * upper[j]
        if (n - k) % 2 == 0:
            factor = matrix[n - 1, k] / pivot
            matrix[n - 1, k] = factor
            row = matrix[n - 1, k + 1 :]
            for j in range(row.shape[0]):
                row[j] -= factor * upper[j]
    return smallest > SMALLEST_PIVOT * biggest


@inner
def lu_solve(factors: Array, pivots: NDArray[np.int64], right: Array) -> Array:
    """Solve with the factors; `right`, shape (n,), is not changed."""
    n = factors.shape[0]
    x = np.empty(n)
    assign(x, right)
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
def one_norm(matrix: Array) -> float:
    """‖A‖₁, the largest column sum; infinite where an entry is not finite."""
    result = 0.0
    for j in range(matrix.shape[1]):
        total = 0.0
        for i in range(matrix.shape[0]):
            total += abs(matrix[i, j])
        if not np.isfinite(total):
            return np.inf
        result = max(result, total)
    return result


# Loops rather than array expressions: numba takes seconds to compile each of those, and they allocate.


@inner
def largest(values: Array) -> float:
    """Max |values|; NaN where one is."""
    result = 0.0
    for i in range(values.shape[0]):
        if not abs(values[i]) <= result:
            result = abs(values[i])
            if np.isnan(result):
                break
    return result


@inner
def norm(values: Array) -> float:
    """Euclidean norm."""
    total = 0.0
    for i in range(values.shape[0]):
        total += values[i] * values[i]
    return np.sqrt(total)


@inner
def relative_step(step: Array, x: Array) -> float:
    """Max |step| / (1 + |x|)."""
    result = 0.0
    for i in range(x.shape[0]):
        result = max(result, abs(step[i]) / (1.0 + abs(x[i])))
    return result


@inner
def advance(x: Array, length: float, direction: Array, result: Array) -> None:
    """Fill x + length · direction."""
    for i in range(x.shape[0]):
        result[i] = x[i] + length * direction[i]


@inner
def assign(target: Array, source: Array) -> None:
    """Copy to the beginning of an array."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@inner
def lu_solve_transposed(factors: Array, pivots: NDArray[np.int64], right: Array) -> Array:
    """Solve with the transposed matrix; `right`, shape (n,), is not changed."""
    n = factors.shape[0]
    x = np.empty(n)
    assign(x, right)
    # By rows, which lie together, so that the inner loops become vector instructions.
    for i in range(n):
        x[i] /= factors[i, i]
        row, below, value = factors[i, i + 1 :], x[i + 1 :], x[i]
        for j in range(row.shape[0]):
            below[j] -= row[j] * value
    for i in range(n - 1, -1, -1):
        row, value = factors[i, :i], x[i]
        for j in range(i):
            x[j] -= row[j] * value
    for k in range(n - 1, -1, -1):
        p = pivots[k]
        x[k], x[p] = x[p], x[k]
    return x


@inner
def condition_number(system: LinearSystem) -> float:
    """Estimate of the condition number in the 1-norm, a lower bound that is rarely below a third of it.

    ‖A⁻¹‖₁ by Higham, Accuracy and Stability of Numerical Algorithms (2002), Algorithm 15.1. Infinite for a singular
    or not finite matrix.
    """
    factors, pivots = system.factors, system.pivots
    n = factors.shape[0]
    regular = np.isfinite(system.norm)
    for i in range(n):
        regular = regular and factors[i, i] != 0.0
    if not regular:
        return np.inf
    x, signs = np.empty(n), np.empty(n)
    for i in range(n):
        x[i] = 1.0 / n
    estimate, unit = 0.0, -1
    for _ in range(5):
        y = lu_solve(factors, pivots, x)
        total = 0.0
        for i in range(n):
            total += abs(y[i])
            signs[i] = 1.0 if y[i] >= 0.0 else -1.0
        if total <= estimate:
            break
        estimate = total
        z = lu_solve_transposed(factors, pivots, signs)
        peak, product = 0, 0.0
        for i in range(n):
            product += z[i] * x[i]
            if abs(z[i]) > abs(z[peak]):
                peak = i
        if peak == unit or abs(z[peak]) <= product:
            break
        unit = peak
        for i in range(n):
            x[i] = 1.0 if i == peak else 0.0
    return system.norm * estimate


@inner
def newton(
    problem: Any, x: Array, step_tolerance: float, residual_tolerance: float, max_iterations: int
) -> tuple[int, int, float, Array, LinearSystem]:
    """Solve F(x) = 0 in place.

    Parameters
    ----------
    problem : an instance of a type that `residual` and `jacobian` are implemented for.
    x : start on entry and last iterate on return, shape (n,).
    step_tolerance : largest accepted correction |J⁻¹F| at x, relative to 1 + |x|.
    residual_tolerance : largest accepted |F| at x.
    max_iterations : largest number of corrections, with a new Jacobian or the last one.

    Returns
    -------
    tuple
        Status, number of corrections, the last one relative to 1 + |x|, F at x, and the last Jacobian.
    """
    n = x.shape[0]
    value, trial_value, trial = np.empty(n), np.empty(n), np.empty(n)
    direction = simplified = value
    factors, pivots, matrix_norm = np.empty((n, n)), np.empty(n, np.int64), np.inf
    status, corrections, step, damping, chord = MAX_ITERATIONS_REACHED, 0, np.inf, 1.0, False
    residual(problem, x, value)
    while corrections < max_iterations:
        corrections += 1
        size = largest(value)
        if not chord:
            jacobian(problem, x, factors)
            matrix_norm = one_norm(factors)
            finite = np.isfinite(size) and np.isfinite(matrix_norm)
            if not (finite and lu_factor(factors, pivots)):
                status = SINGULAR if finite else NOT_FINITE
                break
            direction = lu_solve(factors, pivots, value)
            damping = min(1.0, 4.0 * damping)
        step = relative_step(direction, x)
        if step <= step_tolerance and size <= residual_tolerance:
            advance(x, -1.0, direction, trial)  # the correction is known: take it
            residual(problem, trial, trial_value)
            if largest(trial_value) <= size:
                assign(x, trial)
                assign(value, trial_value)
            status = CONVERGED
            break
        length, contraction = norm(direction), np.inf
        while damping >= MIN_DAMPING:
            advance(x, -damping, direction, trial)
            residual(problem, trial, trial_value)
            if np.isfinite(largest(trial_value)):
                simplified = lu_solve(factors, pivots, trial_value)
                contraction = norm(simplified) / length
                if contraction <= 1.0 - damping / 4.0:
                    assign(x, trial)
                    assign(value, trial_value)
                    break
            if chord:
                contraction = np.inf  # the old Jacobian is of no use here: a new one at the same x
                break
            damping /= 2.0
        if damping < MIN_DAMPING:
            status = STALLED
            break
        chord = damping == 1.0 and contraction <= GOOD_CONTRACTION
        if chord:
            direction = simplified
    return status, corrections, step, value, LinearSystem(factors, pivots, matrix_norm)
