"""The smooth solution of a rod problem whose highest derivatives have small factors.

The rod equations are third order in θ, but only one boundary condition is for θ: fast modes, which live in thin
layers at the ends, are left open. The slow manifold is the solution without layers, the one that tends to the
flexible yarn as p₃ grows. A layer of relative width δ needs a polynomial degree of about 1/√δ to be seen, so one
polynomial of lower degree cannot carry it, and collocation without extra conditions finds the slow manifold.

As for an asymptotic series, more terms help only up to a point: past it the layers become representable, the
Jacobian's condition number explodes and the ends drift. So the degree is raised while the ends settle, and the search
ends at the tolerance, at the first growth of the change or where the next Jacobian would be ill-conditioned. The
smallest change between neighbouring degrees is the stated error. Where even that is large the outcome is
NO_SCALE_SEPARATION.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models import flexible
from models.boundary_value import Array, Collocated, Values, highest_derivatives, pointwise_arguments
from models.compiled import compiled, inner
from models.discretisation import Derivatives, Integrals, derivatives, resample
from models.newton import (
    CONVERGED,
    LinearSystem,
    advance,
    assign,
    condition_number,
    jacobian,
    largest,
    lu_factor,
    lu_solve,
    newton,
    one_norm,
    residual,
)
from models.refinement import (
    DRIFTING,
    ILL_CONDITIONED,
    NEWTON_FAILED,
    SETTLED,
    START_FAILED,
    Refined,
    compiled_relative_change,
    record,
)
from models.scene import TENSION_CD, WRAP_ANGLE, Dimensionless
from models.solution import Fields

ORDERS = highest_derivatives(3, 1, 1)
"""Highest derivatives of the fields θ, p₃/p₃CD and τ."""
ARGUMENTS = 8
"""θ, θ', θ'', θ''', p₃, p₃', τ, τ': what the equations at a point take."""
DEGREES = (4, 6, 8, 10, 12, 14, 16, 18)
PRECISION = 1e-8
"""Change of the ends between neighbouring degrees at which the search ends."""
NEWTON_TOLERANCE = 1e-10
"""Largest correction: below PRECISION, above the rounding of an acceptable Jacobian. Residuals: ten times that."""
SHARE_OF_CHANGE, FIRST_CHANGE = 1e-3, 1e-2
"""Newton need not be more accurate than this share of the change between the last degrees, at first of the second."""
MAX_ITERATIONS = 60
LARGEST_CHANGE = 1e-4
"""Change above which the slow manifold is not defined well enough to report numbers."""
CORRECTION_DEGREE = 8
"""Degree of `first_correction`: fast modes are not representable yet in most scenes, and the ends have four digits."""
LARGEST_CONDITION = 1e9
"""Above it the layers have entered the discrete problem."""


def normal_force(problem: Any, f: Values) -> Any:
    """N in units of p₃CD/r₀ from the pointwise arguments, shape (8,); each rod gives its own by `implement`."""
    raise NotImplementedError(f"no normal force for {type(problem).__name__}")


def collocation_matrices() -> Derivatives:
    """The matrices that `find` takes."""
    return derivatives(DEGREES)


@compiled
def find(problem: Any, integration: Integrals, matrices: Derivatives) -> Refined:
    """Raise the degree from the flexible yarn's solution while the ends settle.

    Parameters
    ----------
    problem : of a rod's type, with the numbers of `Dimensionless.vector` as its scene.
    integration : `flexible.integration_matrices`.
    matrices : `collocation_matrices`.
    """
    scene, nothing = problem.scene, np.full(3, np.nan)
    start = flexible.find(scene, integration)
    fields, w = flexible.rod_values(start.fields), start.w
    best = Refined(
        START_FAILED, start.status, start.degree, fields, w, nothing, nothing, np.inf, np.nan, np.nan, np.nan,
        start.iterations, np.nan, np.nan, np.nan, np.nan,
    )  # fmt: skip
    if start.ending != SETTLED:
        return best
    at_B, change, smallest, last = nothing, nothing, np.inf, np.inf
    iterations, ending, last_condition, first = start.iterations, NEWTON_FAILED, np.inf, 0
    for degree in matrices.degrees:
        x = unknowns(fields, w, degree)
        at_points = scaled(matrices.at_points[first:], degree, degree + 1, scene[WRAP_ANGLE])
        first += at_points.size
        collocated = Collocated(problem, ORDERS, at_points)
        tolerance = max(NEWTON_TOLERANCE, SHARE_OF_CHANGE * min(last, FIRST_CHANGE))
        status, count, step, value, system = newton(collocated, x, tolerance, 10 * tolerance, MAX_ITERATIONS)
        iterations += count
        condition = condition_number(system)
        if status != CONVERGED or condition > LARGEST_CONDITION:
            if not np.isfinite(smallest):
                ending = NEWTON_FAILED if status != CONVERGED else ILL_CONDITIONED
                best = Refined(
                    ending, status, degree, fields, w, nothing, nothing, np.inf, np.nan, np.nan, np.nan,
                    iterations, step, np.nan, np.nan, condition,
                )  # fmt: skip
            break
        fields, w = x[:-1].copy().reshape((3, degree + 1)), x[-1]
        found = compiled_rod_ends(scene[TENSION_CD], fields[0, 0], fields[1, 0], fields[2, 0])
        size, change, at_B = compiled_relative_change(found, at_B), found - at_B, found
        if size < smallest:
            smallest = size
            rows = 3 * degree
            best = Refined(
                SETTLED if size <= LARGEST_CHANGE else DRIFTING, status, degree, fields, w, at_B, change, size,
                fields[0, -1], np.nan, np.nan, iterations, step,
                largest(value[:rows]), largest(value[rows:]), condition,
            )  # fmt: skip
        # The condition number grows by about the same factor at each degree: a hopeless degree need not be tried.
        growth, last_condition = condition / last_condition, condition
        if size < PRECISION or size > 2 * last or growth * condition > LARGEST_CONDITION:
            break
        last = size
    if not np.isfinite(smallest):
        return best
    lowest, where = lowest_normal_force(problem, matrices, best.fields)
    return Refined(
        best.ending, best.status, best.degree, best.fields, best.w, best.ends, best.change, best.size, best.theta_C,
        lowest, where, best.iterations, best.step, best.residual, best.boundary_residual, best.condition,
    )  # fmt: skip


@compiled
def find_rows(problem: Any, scenes: Array, integration: Integrals, matrices: Derivatives, table: NDArray[Any]) -> None:
    """Solve many scenes, `Dimensionless.vector` in each row, into a table of type ROW.

    The problem's own numbers are overwritten: each thread needs its own problem.
    """
    for i in range(scenes.shape[0]):
        assign(problem.scene, scenes[i])
        record(find(problem, integration, matrices), table[i])


@compiled
def first_correction(problem: Any, yarn: Refined, matrices: Derivatives) -> Array:
    """Relative change of p₃AB, T_AB and θ_B by one Newton step from the flexible yarn, shape (3,).

    At the first degree of the matrices; infinite where the Jacobian is singular or shows fast modes there.
    """
    degree, scene = matrices.degrees[0], problem.scene
    x = unknowns(flexible.rod_values(yarn.fields), yarn.w, degree)
    size = x.shape[0]
    value, factors, pivots = np.empty(size), np.empty((size, size)), np.empty(size, np.int64)
    at_points = scaled(matrices.at_points, degree, degree + 1, scene[WRAP_ANGLE])
    collocated = Collocated(problem, ORDERS, at_points)
    residual(collocated, x, value)
    jacobian(collocated, x, factors)
    system = LinearSystem(factors, pivots, one_norm(factors))
    before = compiled_rod_ends(scene[TENSION_CD], x[0], x[degree + 1], x[2 * degree + 2])
    change = np.full(3, np.inf)
    if np.isfinite(system.norm) and lu_factor(factors, pivots) and condition_number(system) <= LARGEST_CONDITION:
        step = lu_solve(factors, pivots, value)
        advance(x, -1.0, step, x)
        after = compiled_rod_ends(scene[TENSION_CD], x[0], x[degree + 1], x[2 * degree + 2])
        smallest_twist = 1 / (2 * np.pi)
        change[0] = abs(after[0] / before[0] - 1)
        change[1] = abs(after[1] - before[1]) / max(abs(before[1]), smallest_twist)
        change[2] = abs(after[2] / before[2] - 1)
    return change


@compiled
def normal_forces(problem: Any, f: Array) -> Array:
    """N in K/r₀³, shape (n,), from the pointwise arguments, shape (n, 8)."""
    normal = np.empty(f.shape[0])
    for j in range(f.shape[0]):
        normal[j] = normal_at(problem, f[j])
    return normal


@inner
def normal_at(problem: Any, f: Array) -> float:
    """N in K/r₀³."""
    return normal_force(problem, f) * problem.scene[TENSION_CD]


@inner
def unknowns(fields: Array, w: float, degree: int) -> Array:
    """Nodal values at another degree, then w, shape (3 degree + 4,)."""
    size = degree + 1
    x = np.empty(3 * size + 1)
    for i in range(3):
        assign(x[i * size :], resample(fields[i], degree))
    x[-1] = w
    return x


@inner
def scaled(packed: Array, rows: int, columns: int, length: float) -> Array:
    """Matrices of derivatives for [0, length], shape (4, rows, columns), from those at the beginning of `packed`."""
    matrices = np.empty((4, rows, columns))
    factor, place = 1.0, 0
    for k in range(4):
        for i in range(rows):
            for j in range(columns):
                matrices[k, i, j] = packed[place] * factor
                place += 1
        factor *= 2.0 / length
    return matrices


@inner
def lowest_normal_force(problem: Any, matrices: Derivatives, fields: Array) -> tuple[float, float]:
    """Smallest N [K/r₀³] at collocation points and nodes, and its ψ [rad]."""
    degree, length, f = fields.shape[1] - 1, problem.scene[WRAP_ANGLE], np.empty(ARGUMENTS)
    x = fields.ravel()
    point, node = 0, 0
    for other in matrices.degrees:
        if other == degree:
            break
        point += 4 * other * (other + 1)
        node += 4 * (other + 1) * (other + 1)
    lowest, where = np.inf, np.nan
    for shift, packed in ((0.5, matrices.at_points[point:]), (0.0, matrices.at_nodes[node:])):
        points = degree if shift else degree + 1
        derivatives = scaled(packed, points, degree + 1, length)
        for j in range(points):
            pointwise_arguments(ORDERS, derivatives, j, x, f)
            normal = normal_at(problem, f)
            if normal < lowest:
                lowest, where = normal, (1 - np.cos(np.pi * (j + shift) / degree)) / 2
    return lowest, where * length


@dataclass(frozen=True, slots=True)
class Rod:
    """A rod model with the fields θ, p₃/p₃CD and τ."""

    name: str
    problem: Callable[..., Any]
    """Makes the problem that is solved from the scene's numbers."""


def rod_fields(scene: Dimensionless, rod: Rod, nodal: Array, psi: Array, matrices: Array) -> Fields:
    """The solution and its normal force at psi, shape (n,); `matrices` take nodal values there, shape (4, n, m)."""
    values = np.array([matrices[k] @ f for f, order in zip(nodal, ORDERS, strict=True) for k in range(order + 1)])
    normal = normal_forces(rod.problem(scene.vector), np.ascontiguousarray(values.T))
    return Fields(scene, psi, values[0], values[1], values[4] * scene.tension_CD, values[6], normal)


def rod_ends(tension_CD: Any, theta: Any, tension: Any, tau: Any) -> Values:
    """p₃AB, T_AB and θ_B, dimensionless, shape (3,), from θ, p₃/p₃CD and τ at B; analytic."""
    return np.array([tension * tension_CD, (tau - np.sin(theta) * np.cos(theta)) / (2 * np.pi), theta])


compiled_rod_ends = inner(rod_ends)
