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

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from models import flexible
from models.boundary_value import Array, BoundaryValueResult, Values, solve
from models.discretisation import Discretisation, chebyshev_collocation, interpolation
from models.newton import NewtonStatus
from models.outcome import Outcome, Stats
from models.scene import Dimensionless
from models.solution import Fields, newton_outcome, relative_change

ORDERS = np.array([3, 1, 1])
"""Highest derivatives of the fields θ, p₃/p₃CD and τ."""
DEGREES = (4, 6, 8, 10, 12, 14, 16, 18)
PRECISION = 1e-9
"""Change of the ends between neighbouring degrees at which the search ends."""
STEP_TOLERANCE = 1e-10
"""Of Newton's correction: below PRECISION, above the rounding of an acceptable Jacobian."""
LARGEST_CHANGE = 1e-4
"""Change above which the slow manifold is not defined well enough to report numbers."""
LARGEST_CONDITION = 1e9
"""Above it the layers have entered the discrete problem."""


@dataclass(frozen=True, slots=True)
class Rod:
    """A rod model with the fields θ, p₃/p₃CD and τ."""

    name: str
    problem: Callable[..., Any]
    """Makes the problem that is solved from the scene's numbers."""
    normal_force: Callable[[Array, Array], Array]
    """N in K/r₀³, shape (n,), from the scene's numbers and the pointwise arguments, shape (8, n)."""


@dataclass(frozen=True, slots=True)
class SlowManifold:
    """The best polynomial of the search over degrees, or why there is none."""

    outcome: Outcome
    message: str
    stats: Stats
    degree: int = 0
    result: BoundaryValueResult | None = None
    error: Array | None = None
    """Change of p₃AB, T_AB and θ_B from the degree before, shape (3,)."""


def search(problem: Dimensionless, rod: Rod) -> SlowManifold:
    """Raise the degree while the ends settle."""
    start, _, error, iterations = flexible.solve_fields(problem)
    if error is None:
        text = f"the flexible start failed ({start.status.text})"
        return SlowManifold(Outcome.NOT_CONVERGED, text, Stats(iterations))
    best: SlowManifold | None = None
    smallest_change = last_change = np.inf
    previous: Array | None = None
    result: BoundaryValueResult | None = None
    condition = np.inf
    for degree in DEGREES:
        discretisation = chebyshev_collocation(degree, problem.wrap_angle)
        if result is None:
            fields, w = flexible.start_values(problem, start, degree), start.w
        else:
            fields, w = result.fields @ interpolation(result.fields.shape[1] - 1, degree).T, result.w
        result = solve(rod.problem(problem.vector), ORDERS, discretisation, fields, w, step_tolerance=STEP_TOLERANCE)
        iterations += result.iterations
        condition = result.condition
        if result.status is not NewtonStatus.CONVERGED or condition > LARGEST_CONDITION:
            break
        ends = rod_ends(problem.tension_CD, result.fields[:, 0])
        if previous is not None:
            change = relative_change(ends, previous)
            if change < smallest_change:
                smallest_change = change
                stats = Stats(iterations, result.residual, result.boundary_residual, result.step, degree + 1, condition)
                best = SlowManifold(Outcome.CONVERGED, "", stats, degree, result, ends - previous)
            if change < PRECISION or change > 2 * last_change:
                break
            last_change = change
        previous = ends
    assert result is not None
    separation = Outcome.NO_SCALE_SEPARATION
    if best is None:
        if result.status is not NewtonStatus.CONVERGED:
            outcome, text = newton_outcome(result.status)
            return SlowManifold(outcome, text, Stats(iterations))
        text = f"{separation.value} (condition number {condition:.1e} at the lowest degrees)"
        return SlowManifold(separation, text, Stats(iterations, condition=condition))
    if smallest_change > LARGEST_CHANGE:
        text = f"{separation.value} (the ends change by {smallest_change:.1e} between degrees)"
        return SlowManifold(separation, text, best.stats)
    return best


def rod_ends(tension_CD: Any, at_B: Values) -> Values:
    """p₃AB, T_AB and θ_B, dimensionless, shape (3,), from θ, p₃/p₃CD and τ at B; analytic."""
    theta, tension, tau = at_B
    return np.array([tension * tension_CD, (tau - np.sin(theta) * np.cos(theta)) / (2 * np.pi), theta])


def rod_fields(
    scene: Dimensionless,
    rod: Rod,
    discretisation: Discretisation,
    result: BoundaryValueResult,
    psi: Array,
    to_psi: Array,
) -> Fields:
    """The solution and its normal force at psi, shape (n,); `to_psi` takes nodal values there."""
    values = np.array(
        [
            to_psi @ (discretisation.nodal_derivatives[k] @ field)
            for field, order in zip(result.fields, ORDERS, strict=True)
            for k in range(order + 1)
        ]
    )
    normal = rod.normal_force(scene.vector, values)
    return Fields(scene, psi, values[0], values[1], values[4] * scene.tension_CD, values[6], result.w, normal)
