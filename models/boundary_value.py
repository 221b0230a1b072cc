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

from models.compiled import compiled, implement
from models.discretisation import Discretisation
from models.newton import NewtonStatus, evaluate, newton

Array = NDArray[np.float64]
Values = NDArray[Any]
"""Real, or complex where a derivative is taken."""

COMPLEX_STEP = 1e-40


def equations(problem: Any, f: Values, w: Any, out: Values) -> None:
    """Fill the m residuals at one point. f holds field 0 with its derivatives, then field 1, …

    Compiled code picks the function that `register` gave for the problem's type.
    """
    raise NotImplementedError(f"no equations for {type(problem).__name__}")


def boundary(problem: Any, left: Values, right: Values, w: Any, out: Values) -> None:
    """Fill the m + 1 residuals of the boundary conditions from the fields' end values; see `equations`."""
    raise NotImplementedError(f"no boundary conditions for {type(problem).__name__}")


def register(kind: type[Any], own_equations: Callable[..., None], own_boundary: Callable[..., None]) -> None:
    """Give a problem type (a NamedTuple of arrays and numbers) its equations and boundary conditions to compile.

    The functions take the same arguments by the same names as `equations` and `boundary`.
    """
    implement(equations, kind, own_equations)
    implement(boundary, kind, own_boundary)


class Collocated(NamedTuple):
    """A problem on a discretisation, as `newton` solves it."""

    problem: Any
    orders: NDArray[np.int64]
    """Highest derivative of each field that the equations use, shape (m,)."""
    derivatives: Values
    """The discretisation's matrices, shape (4, n, n + 1)."""


def assemble(problem: Collocated, x: Array, value: Array, jacobian: Array) -> None:
    """Fill residual, shape (m n + m + 1,), and Jacobian; x holds the nodal values of field 0, of field 1, …, then w."""
    pointwise, orders, derivatives = problem.problem, problem.orders, problem.derivatives
    m, n, size = orders.shape[0], derivatives.shape[1], derivatives.shape[2]
    count = m + np.sum(orders)
    step = 1j * COMPLEX_STEP
    jacobian[:] = 0.0
    f, out = np.empty(count, np.complex128), np.empty(m, np.complex128)
    field, order = np.empty(count, np.int64), np.empty(count, np.int64)
    a = 0
    for i in range(m):
        for k in range(orders[i] + 1):
            field[a], order[a] = i, k
            a += 1
    for j in range(n):
        for a in range(count):
            total = 0.0
            for node in range(size):
                total += derivatives[order[a], j, node] * x[field[a] * size + node]
            f[a] = total
        for a in range(count + 1):  # one direction per pointwise argument, and the last for w
            w = x[-1] + 0j
            if a < count:
                f[a] += step
            else:
                w += step
            equations(pointwise, f, w, out)
            for e in range(m):
                slope, row = out[e].imag / COMPLEX_STEP, e * n + j
                if a == count:
                    value[row] = out[e].real
                    jacobian[row, -1] = slope
                elif slope != 0.0:
                    for node in range(size):
                        jacobian[row, field[a] * size + node] += slope * derivatives[order[a], j, node]
            if a < count:
                f[a] = f[a].real
    ends, conditions = np.empty(2 * m + 1, np.complex128), np.empty(m + 1, np.complex128)
    for a in range(2 * m + 1):
        for i in range(m):
            ends[i], ends[m + i] = x[i * size], x[(i + 1) * size - 1]
        ends[2 * m] = x[-1]
        ends[a] += step
        boundary(pointwise, ends[:m], ends[m : 2 * m], ends[2 * m], conditions)
        column = a * size if a < m else ((a - m + 1) * size - 1 if a < 2 * m else m * size)
        for e in range(m + 1):
            value[m * n + e] = conditions[e].real
            jacobian[m * n + e, column] = conditions[e].imag / COMPLEX_STEP


implement(evaluate, Collocated, assemble)


@compiled
def solve_compiled(
    collocated: Collocated, x: Array, tolerances: tuple[float, float], max_iterations: int
) -> tuple[int, int, float, float, Array, Array]:
    """Newton's method on a collocated problem; compiled once for each problem type."""
    return newton(collocated, x, tolerances[0], tolerances[1], max_iterations)


@compiled
def parameter_slopes(problem: Collocated, x: Array) -> Array:
    """∂F/∂λ at x, shape (m n + m + 1,): the problem's numbers and matrices are complex, moved by COMPLEX_STEP in λ."""
    pointwise, orders, derivatives = problem.problem, problem.orders, problem.derivatives
    m, n, size = orders.shape[0], derivatives.shape[1], derivatives.shape[2]
    slopes = np.empty(m * n + m + 1)
    f, out = np.empty(m + np.sum(orders), np.complex128), np.empty(m, np.complex128)
    w = x[-1] + 0j
    for j in range(n):
        a = 0
        for i in range(m):
            for k in range(orders[i] + 1):
                f[a] = 0.0
                for node in range(size):
                    f[a] += derivatives[k, j, node] * x[i * size + node]
                a += 1
        equations(pointwise, f, w, out)
        for e in range(m):
            slopes[e * n + j] = out[e].imag / COMPLEX_STEP
    ends, conditions = np.empty(2 * m, np.complex128), np.empty(m + 1, np.complex128)
    for i in range(m):
        ends[i], ends[m + i] = x[i * size], x[(i + 1) * size - 1]
    boundary(pointwise, ends[:m], ends[m:], w, conditions)
    slopes[m * n :] = conditions.imag / COMPLEX_STEP
    return slopes


@compiled
def pointwise_slopes(problem: Any, f: Array, w: float, equation_count: int) -> Array:
    """Derivatives of the equations by the pointwise arguments f, shape (a, points), as (points, m, a)."""
    count, points = f.shape
    out = np.empty(equation_count, np.complex128)
    slopes = np.empty((points, equation_count, count))
    for j in range(points):
        argument = f[:, j].astype(np.complex128)
        for a in range(count):
            argument[a] += 1j * COMPLEX_STEP
            equations(problem, argument, w + 0j, out)
            slopes[j, :, a] = out.imag / COMPLEX_STEP
            argument[a] = f[a, j]
    return slopes


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
    jacobian: Array
    """At the last iterate, for conditioning and sensitivities."""

    @property
    def condition(self) -> float:
        """Condition number of the Jacobian in the 1-norm; infinite where it is singular."""
        return float(np.linalg.cond(self.jacobian, 1))

    @property
    def scaled_condition(self) -> float:
        """The same with unknowns in units of 1 + |x| and rows of largest element 1: it sees no units, only modes."""
        scaled = self.jacobian * (1 + np.abs(np.append(self.fields, self.w)))
        return float(np.linalg.cond(scaled / np.max(np.abs(scaled), axis=1, keepdims=True), 1))


def solve(
    problem: Any,
    orders: NDArray[np.int64],
    discretisation: Discretisation,
    fields: Array,
    w: float,
    *,
    step_tolerance: float = 1e-11,
    residual_tolerance: float = 1e-9,
    max_iterations: int = 40,
) -> BoundaryValueResult:
    """Solve from nodal start values `fields`, shape (m, n + 1), and `w`, all equations in one Newton system."""
    x = np.append(fields, w)
    collocated = Collocated(problem, orders, discretisation.derivatives)
    status, iterations, _, step, value, jacobian = solve_compiled(
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
        jacobian=jacobian,
    )
