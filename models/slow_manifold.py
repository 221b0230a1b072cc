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
from functools import cache
from typing import Any

import numpy as np

from models.boundary_value import Array, Collocated, Values, pointwise_arguments
from models.compiled import inner
from models.discretisation import chebyshev_reference, resample
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
)
from models.scene import TENSION_CD, WRAP_ANGLE, Dimensionless
from models.solution import Fields

ORDERS = np.array([3, 1, 1])
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

Matrices = tuple[tuple[Array, ...], tuple[Array, ...]]
"""For each of DEGREES, values and derivatives at the collocation points, and at the nodes; on [−1, 1]."""


def normal_force(problem: Any, f: Values) -> Any:
    """N in units of p₃CD/r₀ from the pointwise arguments, shape (8,); each rod gives its own by `implement`."""
    raise NotImplementedError(f"no normal force for {type(problem).__name__}")


@cache
def collocation_matrices() -> Matrices:
    """The matrices that `search` takes."""
    references = [chebyshev_reference(degree) for degree in DEGREES]
    return tuple(r[2] for r in references), tuple(r[3] for r in references)


@inner
def search(problem: Any, start: Refined, matrices: Matrices) -> Refined:
    """Raise the degree from the flexible yarn's solution `start` while the ends settle."""
    scene, nothing = problem.scene, np.full(3, np.nan)
    fields, w = start.fields, start.w
    best = Refined(
        START_FAILED, start.status, start.degree, fields, w, nothing, nothing, np.inf, np.nan, np.nan, np.nan,
        start.iterations, np.nan, np.nan, np.nan, np.nan,
    )  # fmt: skip
    if start.ending != SETTLED:
        return best
    at_B, change, smallest, last, chosen = nothing, nothing, np.inf, np.inf, 0
    iterations, ending, last_condition = start.iterations, NEWTON_FAILED, np.inf
    for rung in range(len(matrices[0])):
        at_points = matrices[0][rung]
        degree = at_points.shape[1]
        x = start_values(start, degree) if rung == 0 else unknowns(fields, w, degree)
        collocated = Collocated(problem, ORDERS, scaled(at_points, scene[WRAP_ANGLE]))
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
            smallest, chosen = size, rung
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
    lowest, where = lowest_normal_force(problem, matrices[0][chosen], matrices[1][chosen], best)
    return Refined(
        best.ending, best.status, best.degree, best.fields, best.w, best.ends, best.change, best.size, best.theta_C,
        lowest, where, best.iterations, best.step, best.residual, best.boundary_residual, best.condition,
    )  # fmt: skip


@inner
def first_correction(problem: Any, yarn: Refined, at_points: Array) -> Array:
    """Relative change of p₃AB, T_AB and θ_B by one Newton step from the flexible yarn, shape (3,).

    Infinite where the Jacobian at this degree is singular or shows fast modes.
    """
    degree, scene = at_points.shape[1], problem.scene
    x = start_values(yarn, degree)
    size = x.shape[0]
    value, factors, pivots = np.empty(size), np.empty((size, size)), np.empty(size, np.int64)
    collocated = Collocated(problem, ORDERS, scaled(at_points, scene[WRAP_ANGLE]))
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


@inner
def start_values(yarn: Refined, degree: int) -> Array:
    """The flexible yarn as unknowns of a rod at another degree: θ, p₃/p₃CD and τ at the nodes, then w."""
    fields = np.empty_like(yarn.fields)
    for j in range(yarn.degree + 1):
        fields[0, j] = 2 * np.arctan(np.exp(yarn.fields[0, j]))
        fields[1, j] = np.exp(yarn.fields[1, j])
        fields[2, j] = yarn.fields[2, j]
    return unknowns(fields, yarn.w, degree)


@inner
def unknowns(fields: Array, w: float, degree: int) -> Array:
    """Nodal values at another degree, then w, shape (3 degree + 4,)."""
    x = np.empty(3 * (degree + 1) + 1)
    for i in range(3):
        assign(x[i * (degree + 1) : (i + 1) * (degree + 1)], resample(fields[i], degree))
    x[-1] = w
    return x


@inner
def scaled(reference: Array, length: float) -> Array:
    """Matrices of derivatives for [0, length] from those for [−1, 1], shape (4, n, m)."""
    matrices = np.empty_like(reference)
    factor = 1.0
    for k in range(reference.shape[0]):
        for i in range(reference.shape[1]):
            for j in range(reference.shape[2]):
                matrices[k, i, j] = reference[k, i, j] * factor
        factor *= 2.0 / length
    return matrices


@inner
def lowest_normal_force(problem: Any, at_points: Array, at_nodes: Array, found: Refined) -> tuple[float, float]:
    """Smallest N [K/r₀³] at collocation points and nodes, and its ψ [rad]."""
    degree, length, f = found.degree, problem.scene[WRAP_ANGLE], np.empty(ARGUMENTS)
    x = found.fields.ravel()
    lowest, where = np.inf, np.nan
    for shift, reference in ((0.5, at_points), (0.0, at_nodes)):
        derivatives = scaled(reference, length)
        for j in range(derivatives.shape[1]):
            pointwise_arguments(ORDERS, derivatives, j, x, f)
            normal = normal_force(problem, f)
            if normal < lowest:
                lowest, where = normal, (1 - np.cos(np.pi * (j + shift) / degree)) / 2
    return lowest * problem.scene[TENSION_CD], where * length


@dataclass(frozen=True, slots=True)
class Rod:
    """A rod model with the fields θ, p₃/p₃CD and τ."""

    name: str
    problem: Callable[..., Any]
    """Makes the problem that is solved from the scene's numbers."""
    find: Callable[[Array, tuple[Array, ...], Matrices], Refined]
    """Compiled search, from the scene's numbers and the matrices of the flexible yarn and of the rod."""
    normal_forces: Callable[[Array, Array], Array]
    """N in K/r₀³, shape (n,), from the scene's numbers and the pointwise arguments, shape (8, n)."""


def rod_fields(scene: Dimensionless, rod: Rod, nodal: Array, psi: Array, matrices: Array) -> Fields:
    """The solution and its normal force at psi, shape (n,); `matrices` take nodal values there, shape (4, n, m)."""
    values = np.array([matrices[k] @ f for f, order in zip(nodal, ORDERS, strict=True) for k in range(order + 1)])
    normal = rod.normal_forces(scene.vector, values)
    return Fields(scene, psi, values[0], values[1], values[4] * scene.tension_CD, values[6], normal)


def rod_ends(tension_CD: Any, theta: Any, tension: Any, tau: Any) -> Values:
    """p₃AB, T_AB and θ_B, dimensionless, shape (3,), from θ, p₃/p₃CD and τ at B; analytic."""
    return np.array([tension * tension_CD, (tau - np.sin(theta) * np.cos(theta)) / (2 * np.pi), theta])


compiled_rod_ends = inner(rod_ends)
