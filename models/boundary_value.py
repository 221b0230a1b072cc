"""Two-point boundary-value problems given pointwise, assembled for Newton with an exact Jacobian. Knows no yarn.

A problem has m fields on an interval and one unknown constant w. It states, at one point, how its m equations depend
on the fields, their derivatives and w, and how its m + 1 boundary conditions depend on the end values and w. The
Jacobian is exact: each pointwise argument is differentiated by a complex step (Squire and Trapp, SIAM Review 40
(1998) 110), so the two functions must be analytic (no abs, no atan2, no comparisons), and chained with the
discretisation's matrices. A problem is a NamedTuple of numbers; a model registers its functions for its own type of it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, implement, inner
from models.complex_step import COMPLEX_STEP, as_tuple, in_direction, unit_directions
from models.discretisation import Discretisation
from models.newton import NewtonStatus, advance, condition_number, jacobian, newton, residual, system, values

Array = NDArray[np.float64]
Values = NDArray[Any]
"""Real, or complex where a derivative is taken."""


def equations(problem: Any, f: Values | tuple[Any, ...], w: Any) -> tuple[Any, ...]:
    """The m residuals at one point. f holds field 0 with its derivatives, then field 1, …

    Compiled code picks the function that `register` gave for the problem's type.
    """
    raise NotImplementedError(f"no equations for {type(problem).__name__}")


def boundary(problem: Any, left: Values, right: Values, w: Any, out: Values) -> None:
    """Fill the m + 1 residuals of the boundary conditions from the fields' end values; see `equations`."""
    raise NotImplementedError(f"no boundary conditions for {type(problem).__name__}")


def slopes(problem: Any, f: Array, w: float, directions: Array, out: Array) -> None:
    """Fill the derivatives of the m residuals at one point, shape (m, a).

    Parameters
    ----------
    f : the pointwise arguments, shape (arguments,).
    directions : `unit_directions` of the arguments and w, shape (arguments + 1, a).
    """
    raise NotImplementedError(f"no equations for {type(problem).__name__}")


def highest_derivatives(*orders: int) -> NDArray[np.int64]:
    """The highest derivative of each field, read-only: constants of compiled code are, and so they are of one type."""
    given = np.array(orders)
    given.flags.writeable = False
    return given


def register(
    kind: type[Any],
    orders: NDArray[np.int64],
    own_equations: Callable[..., tuple[Any, ...]],
    own_boundary: Callable[..., None],
) -> None:
    """Give a problem type (a NamedTuple of arrays and numbers) its equations and boundary conditions to compile.

    Parameters
    ----------
    orders : highest derivative of each field in the equations, shape (m,).
    own_equations, own_boundary : they take the same arguments by the same names as `equations` and `boundary`.
    """
    implement(equations, kind, own_equations, merge=True)
    implement(boundary, kind, own_boundary)
    implement(slopes, kind, _slopes_of(int(np.sum(orders + 1))))


def _slopes_of(arguments: int) -> Callable[..., None]:
    """`slopes` of equations by so many arguments.

    All directions in one loop over local variables: real parts, which do not depend on the direction, are computed
    once, and the loop becomes vector instructions.
    """
    local, moved = as_tuple(arguments), in_direction(arguments)

    def own_slopes(problem: Any, f: Array, w: float, directions: Array, out: Array) -> None:
        point = local(f, 0)
        for a in range(directions.shape[1]):
            left_over = equations(problem, moved(point, directions, 0, a), complex(w, directions[arguments, a]))
            for e in range(len(left_over)):
                out[e, a] = left_over[e].imag / COMPLEX_STEP

    return own_slopes


class Collocated(NamedTuple):
    """A problem on a discretisation, as `newton` solves it."""

    problem: Any
    orders: NDArray[np.int64]
    """Highest derivative of each field that the equations use, shape (m,)."""
    derivatives: Values
    """The discretisation's matrices, shape (4, n, n + 1)."""


@inner
def argument_count(orders: NDArray[np.int64]) -> int:
    """Number of fields and derivatives that the equations at a point take."""
    count = 0
    for order in orders:
        count += order + 1
    return count


@inner
def pointwise_arguments(orders: NDArray[np.int64], derivatives: Values, j: int, x: Array, f: Values) -> None:
    """Fill f with the fields and their derivatives at collocation point j."""
    size, a = derivatives.shape[2], 0
    for i in range(orders.shape[0]):
        for k in range(orders[i] + 1):
            f[a] = 0.0
            for node in range(size):
                f[a] += derivatives[k, j, node] * x[i * size + node]
            a += 1


def fill_residual(problem: Collocated, x: Values, value: Values) -> None:
    """F(x), shape (m n + m + 1,), real or complex; x holds the nodal values of field 0, of field 1, …, then w."""
    pointwise, orders, derivatives = problem.problem, problem.orders, problem.derivatives
    m, n, size = orders.shape[0], derivatives.shape[1], derivatives.shape[2]
    f, w = np.empty(argument_count(orders), x.dtype), x[-1]
    for j in range(n):
        pointwise_arguments(orders, derivatives, j, x, f)
        left_over = equations(pointwise, f, w)
        for e in range(m):
            value[e * n + j] = left_over[e]
    left, right = np.empty(m, x.dtype), np.empty(m, x.dtype)
    for i in range(m):
        left[i], right[i] = x[i * size], x[(i + 1) * size - 1]
    boundary(pointwise, left, right, w, value[m * n :])


def fill_jacobian(problem: Collocated, x: Array, matrix: Array) -> None:
    """∂F/∂x by one complex step per pointwise argument, chained with the discretisation's matrices."""
    pointwise, orders, derivatives = problem.problem, problem.orders, problem.derivatives
    m, n, size = orders.shape[0], derivatives.shape[1], derivatives.shape[2]
    count = argument_count(orders)
    step = 1j * COMPLEX_STEP
    matrix.fill(0.0)
    directions = unit_directions(count + 1)
    f, by_argument = np.empty(count), np.empty((m, directions.shape[1]))
    w = x[-1]
    for j in range(n):
        pointwise_arguments(orders, derivatives, j, x, f)
        slopes(pointwise, f, w, directions, by_argument)
        for e in range(m):
            row_of_all, a = matrix[e * n + j], 0
            row_of_all[-1] = by_argument[e, count]
            for i in range(m):
                row = row_of_all[i * size : (i + 1) * size]
                for k in range(orders[i] + 1):
                    if by_argument[e, a] != 0.0:
                        advance(row, by_argument[e, a], derivatives[k, j], row)
                    a += 1
    left, right, conditions = np.empty(m, np.complex128), np.empty(m, np.complex128), np.empty(m + 1, np.complex128)
    for a in range(2 * m + 1):
        for i in range(m):
            left[i], right[i] = x[i * size], x[(i + 1) * size - 1]
        column = a * size if a < m else ((a - m + 1) * size - 1 if a < 2 * m else m * size)
        if a < m:
            left[a] += step
        elif a < 2 * m:
            right[a - m] += step
        boundary(pointwise, left, right, w + step if a == 2 * m else w + 0j, conditions)
        for e in range(m + 1):
            matrix[m * n + e, column] = conditions[e].imag / COMPLEX_STEP


implement(residual, Collocated, fill_residual)
implement(jacobian, Collocated, fill_jacobian)


@compiled
def solve_compiled(
    collocated: Collocated, x: Array, tolerances: tuple[float, float], max_iterations: int
) -> tuple[int, int, float, Array, float]:
    """Newton's method on a collocated problem; compiled once for each problem type."""
    status, iterations, step, value, system = newton(collocated, x, tolerances[0], tolerances[1], max_iterations)
    return status, iterations, step, value, condition_number(system)


@compiled
def evaluated(problem: Any, x: Array) -> tuple[Array, Array]:
    """F(x), shape (n,), and ∂F/∂x, shape (n, n), of a problem that `newton` can solve."""
    return system(problem, x)


@compiled
def residuals(problem: Any, x: Values) -> Values:
    """F(x), shape (n,), of real or complex numbers."""
    return values(problem, x)


def parameter_slopes(problem: Any, x: Array) -> Array:
    """∂F/∂λ at x, shape (n,), of a problem whose numbers and matrices are moved by i · COMPLEX_STEP in λ."""
    moved: NDArray[np.complex128] = residuals(problem, x.astype(np.complex128))
    return np.asarray(moved.imag / COMPLEX_STEP, dtype=np.float64)


@compiled
def linearised(problem: Any, f: Array, w: float, equation_count: int) -> tuple[Array, Array]:
    """The equations' residuals, shape (points, m), and their slopes, (points, m, b), at arguments f, (points, a).

    The first a of the b slopes are by f, the next is by w.
    """
    return linear_part(problem, f, w, equation_count)


@inner
def linear_part(problem: Any, f: Array, w: float, equation_count: int) -> tuple[Array, Array]:
    """As `linearised`, for which it is compiled with the settings of its parts, which are then compiled once."""
    directions = unit_directions(f.shape[1] + 1)
    values = np.empty((f.shape[0], equation_count))
    by_argument = np.empty((f.shape[0], equation_count, directions.shape[1]))
    for j in range(f.shape[0]):
        left_over = equations(problem, f[j], w)
        for e in range(equation_count):
            values[j, e] = left_over[e]
        slopes(problem, f[j], w, directions, by_argument[j])
    return values, by_argument


@dataclass(frozen=True, slots=True)
class BoundaryValueResult:
    """Nodal fields, shape (m, n + 1), the constant w, and the evidence: maximum norms of residuals and correction."""

    fields: Array
    w: float
    status: NewtonStatus
    iterations: int
    step: float
    residual: float
    """Largest residual of the equations."""
    boundary_residual: float
    """Largest residual of the boundary conditions."""
    condition: float
    """Condition number of the last Jacobian in the 1-norm, estimated; infinite where there is none."""


def solve(
    problem: Any,
    orders: NDArray[np.int64],
    discretisation: Discretisation,
    fields: Array,
    w: float,
    *,
    step_tolerance: float = 1e-11,
    residual_tolerance: float = 1e-9,
    max_iterations: int = 60,
) -> BoundaryValueResult:
    """Solve from nodal start values `fields`, shape (m, n + 1), and `w`, all equations in one Newton system."""
    x = np.append(fields, w)
    collocated = Collocated(problem, orders, discretisation.derivatives)
    status, iterations, step, value, condition = solve_compiled(
        collocated, x, (step_tolerance, residual_tolerance), max_iterations
    )
    m, size = fields.shape
    rows = m * (size - 1)
    return BoundaryValueResult(
        fields=x[:-1].reshape(m, size),
        w=float(x[-1]),
        status=NewtonStatus(status),
        iterations=iterations,
        step=step,
        residual=float(np.max(np.abs(value[:rows]))),
        boundary_residual=float(np.max(np.abs(value[rows:]))),
        condition=condition,
    )
