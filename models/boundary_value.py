"""Two-point boundary-value problems given pointwise, assembled for Newton with an exact Jacobian. Knows no yarn.

A problem states, at one point, how its equations depend on the fields and their derivatives, and how its boundary
conditions depend on the end values. The Jacobian is exact: each pointwise argument is differentiated by a complex
step (Squire and Trapp, SIAM Review 40 (1998) 110), all arguments in one vectorised call, and chained with the
discretisation's matrices.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from models.discretisation import Discretisation
from models.newton import NewtonResult, newton

Array = NDArray[np.float64]
Values = NDArray[Any]
"""Real or complex: pointwise functions must be analytic, so no abs, no atan2, no comparisons."""

COMPLEX_STEP = 1e-200


class Problem(Protocol):
    """m fields on an interval and one unknown constant w."""

    @property
    def orders(self) -> tuple[int, ...]:
        """Highest derivative of each field that the equations use."""
        ...

    def equations(self, fields: Sequence[Sequence[Values]], w: Values) -> Sequence[Values]:
        """Return the m residuals at the points.

        fields[i][k] is the k-th derivative of field i; all arrays broadcast against each other.
        """
        ...

    def boundary(self, left: Sequence[Values], right: Sequence[Values], w: Values) -> Sequence[Values]:
        """Return the m + 1 residuals of the boundary conditions from the fields' end values."""
        ...


@dataclass(frozen=True, slots=True)
class BoundaryValueResult:
    """Nodal fields, shape (m, n + 1), the constant w, and the Newton evidence."""

    fields: Array
    w: float
    newton: NewtonResult
    residual: float
    """Largest residual of the equations."""
    boundary_residual: float
    """Largest residual of the boundary conditions."""

    @property
    def condition(self) -> float:
        """Condition number of the last Jacobian in the 1-norm; infinite where it is singular."""
        return float(np.linalg.cond(self.newton.jacobian, 1))


def solve(
    problem: Problem,
    discretisation: Discretisation,
    fields: Array,
    w: float,
    *,
    step_tolerance: float = 1e-11,
    residual_tolerance: float = 1e-9,
    max_iterations: int = 40,
) -> BoundaryValueResult:
    """Solve from nodal start values `fields`, shape (m, n + 1), and `w`, all equations in one Newton system."""
    m, size = fields.shape

    def function(x: Array) -> tuple[Array, Array]:
        return assemble(problem, discretisation, x[:-1].reshape(m, size), float(x[-1]))

    result = newton(
        function,
        np.append(fields.ravel(), w),
        step_tolerance=step_tolerance,
        residual_tolerance=residual_tolerance,
        max_iterations=max_iterations,
    )
    rows = m * (size - 1)
    return BoundaryValueResult(
        fields=result.x[:-1].reshape(m, size),
        w=float(result.x[-1]),
        newton=result,
        residual=float(np.max(np.abs(result.value[:rows]))),
        boundary_residual=float(np.max(np.abs(result.value[rows:]))),
    )


def assemble(problem: Problem, discretisation: Discretisation, fields: Array, w: float) -> tuple[Array, Array]:
    """Residual, shape (m n + m + 1,), and Jacobian of the discrete problem. Unknowns: fields row by row, then w."""
    m, size = fields.shape
    n = size - 1
    matrices = [discretisation.derivatives[: order + 1] for order in problem.orders]
    values = np.concatenate([matrix @ field for matrix, field in zip(matrices, fields, strict=True)])

    # Row d of every argument is perturbed in direction d: one direction per pointwise argument, and one for w.
    count = sum(order + 1 for order in problem.orders)
    directions = count + 1
    step = 1j * COMPLEX_STEP
    arguments = np.repeat(values[:, None, :].astype(complex), directions, axis=1)
    arguments[range(count), range(count)] += step
    constant = np.full((directions, 1), w, dtype=complex)
    constant[-1] += step
    splits = np.cumsum([order + 1 for order in problem.orders])
    grouped = [list(group) for group in np.split(arguments, splits[:-1])]
    with np.errstate(all="ignore"):  # a trial step may leave the domain; Newton sees the non-finite value
        equations = _stacked(problem.equations(grouped, constant), (directions, n))
    slopes = equations.imag / COMPLEX_STEP

    residual = np.empty(m * n + m + 1)
    jacobian = np.zeros((m * n + m + 1, m * size + 1))
    residual[: m * n] = equations[:, 0].real.ravel()
    blocks = jacobian[: m * n, :-1].reshape(m, n, m, size)
    for i, (matrix, slope) in enumerate(zip(matrices, np.split(slopes[:, :-1], splits[:-1], axis=1), strict=True)):
        blocks[:, :, i, :] = np.einsum("ekn,knj->enj", slope, matrix)
    jacobian[: m * n, -1] = slopes[:, -1].ravel()

    ends = np.tile(np.concatenate([fields[:, 0], fields[:, -1], [w]]).astype(complex), (2 * m + 1, 1)).T
    ends[np.arange(2 * m + 1), np.arange(2 * m + 1)] += step
    with np.errstate(all="ignore"):
        conditions = _stacked(problem.boundary(list(ends[:m]), list(ends[m:-1]), ends[-1]), (2 * m + 1,))
    residual[m * n :] = conditions[:, 0].real
    columns = [i * size for i in range(m)] + [(i + 1) * size - 1 for i in range(m)] + [m * size]
    jacobian[m * n :, columns] = conditions.imag / COMPLEX_STEP
    return residual, jacobian


def _stacked(residuals: Sequence[Values], shape: tuple[int, ...]) -> NDArray[np.complex128]:
    """One array of all residuals; a residual that does not depend on every argument is repeated."""
    return np.array([np.broadcast_to(residual, shape) for residual in residuals], dtype=np.complex128)
