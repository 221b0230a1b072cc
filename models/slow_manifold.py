"""The smooth solution of a rod problem whose highest derivatives have small factors.

The rod equations are third order in θ, but only one boundary condition is for θ: fast modes, which live in thin
layers at the ends, are left open. The slow manifold is the solution without layers, the one that tends to the
flexible yarn as p₃ grows. A layer of relative width δ needs a polynomial degree of about 1/√δ to be seen, so one
polynomial of lower degree cannot carry it, and collocation without extra conditions finds the slow manifold.

As for an asymptotic series, more terms help only up to a point: past it the layers become representable, the
Jacobian's condition number explodes and the ends drift. So the degree is raised while the ends settle, and the search
ends at the tolerance, at the first growth of the change or at an ill-conditioned Jacobian. The smallest change
between neighbouring degrees is the stated error. Where even that is large the outcome is NO_SCALE_SEPARATION.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from models.boundary_value import Array, BoundaryValueResult, Problem, solve
from models.discretisation import chebyshev_collocation, chebyshev_values
from models.flexible import solve_flexible
from models.newton import NewtonStatus
from models.outcome import Outcome, Solution, Stats
from models.scene import Scene
from models.solution import PROFILE_POINTS, Fields, failed, solution, start_values

DEGREES = (4, 6, 8, 10, 12, 14, 16, 18)
PRECISION = 1e-9
"""Change of the ends between neighbouring degrees at which the search ends."""
STEP_TOLERANCE = 1e-10
"""Of Newton's correction: below PRECISION, above the rounding of an acceptable Jacobian."""
LARGEST_CHANGE = 1e-4
"""Change above which the slow manifold is not defined well enough to report numbers."""
LARGEST_CONDITION = 1e9
"""Above it the layers have entered the discrete problem."""


class RodProblem(Problem, Protocol):
    """A problem with the fields θ, p₃/p₃CD and τ."""

    def normal_force(self, fields: Sequence[Sequence[Array]], w: float) -> Array:
        """N in K/r₀³ from fields[i][k], the k-th derivative of field i."""
        ...


def solve_slow_manifold(scene: Scene, model: str, problem: RodProblem) -> Solution:
    """Solve by collocation of rising degree from the flexible yarn's solution. The outcome says what happened."""
    flexible = solve_flexible(scene)
    if not flexible.outcome.ok:
        return failed(scene, model, flexible.outcome, f"the flexible start failed: {flexible.message}")
    length = scene.wrap_angle
    best: tuple[float, Fields, Array, Stats] | None = None
    previous: Fields | None = None
    last_change = np.inf
    result: BoundaryValueResult | None = None
    iterations = 0
    for degree in DEGREES:
        discretisation = chebyshev_collocation(degree, length)
        if result is None:
            start, w = start_values(flexible, discretisation.nodes)
        else:
            start = np.array([chebyshev_values(f, discretisation.nodes, length) for f in result.fields])
            w = result.w
        result = solve(problem, discretisation, start, w, step_tolerance=STEP_TOLERANCE)
        iterations += result.newton.iterations
        condition = result.condition
        if result.newton.status is not NewtonStatus.CONVERGED or condition > LARGEST_CONDITION:
            break
        fields = _fields(scene, problem, degree, result)
        if previous is not None:
            change = fields.end_difference(previous)
            stats = Stats(
                iterations, result.residual, result.boundary_residual, result.newton.step, degree + 1, condition
            )
            if best is None or change < best[0]:
                best = change, fields, fields.ends - previous.ends, stats
            if change < PRECISION or change > 2 * last_change:
                break
            last_change = change
        previous = fields
    if best is None:
        assert result is not None
        return _failed_newton(scene, model, result)
    change, fields, error, stats = best
    if change > LARGEST_CHANGE:
        text = f"{Outcome.NO_SCALE_SEPARATION.value} (the ends change by {change:.1e} between degrees)"
        return failed(scene, model, Outcome.NO_SCALE_SEPARATION, text, stats=stats)
    return solution(scene, model, fields, error, stats)


def _fields(scene: Scene, problem: RodProblem, degree: int, result: BoundaryValueResult) -> Fields:
    """The polynomial solution on an even grid."""
    psi = np.linspace(0.0, scene.wrap_angle, PROFILE_POINTS)
    matrices = chebyshev_collocation(degree, scene.wrap_angle).nodal_derivatives

    def derivative(i: int, k: int) -> Array:
        return chebyshev_values(matrices[k] @ result.fields[i], psi, scene.wrap_angle)

    values = [[derivative(i, k) for k in range(order + 1)] for i, order in enumerate(problem.orders)]
    (theta, slope, *_), (tension, _), (tau, _) = values
    dimensionless = scene.dimensionless()
    return Fields(
        dimensionless, psi, theta, slope, tension * dimensionless.tension_CD, tau, result.w,
        problem.normal_force(values, result.w),
    )  # fmt: skip


def _failed_newton(scene: Scene, model: str, result: BoundaryValueResult) -> Solution:
    """The outcome where not even two low degrees gave a solution."""
    status = result.newton.status
    if status is NewtonStatus.CONVERGED:
        text = f"{Outcome.NO_SCALE_SEPARATION.value} (condition number {result.condition:.1e} at the lowest degrees)"
        return failed(scene, model, Outcome.NO_SCALE_SEPARATION, text)
    outcome = Outcome.SINGULAR if status is NewtonStatus.SINGULAR else Outcome.NOT_CONVERGED
    return failed(scene, model, outcome, f"{outcome.value} ({status.value})")
