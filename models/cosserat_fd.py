"""The paper's own scheme for the printed Cosserat model (Yin, Tao, Jasper, Cellulose 2020, section 3).

Finite differences in ψ; Newton–Raphson at a trial n₁ until the norm of the equations is below 10⁻⁵ (in K/r₀²); then
n₁ = η v (T_AB − k T_CD) anew, until two neighbouring values differ by less than 10⁻⁵. The paper does not print its
grid or stencils: here every derivative is of second order, and the equations are closed at the end where the fast
mode of E1 is largest (B where τθ' > 0, as in the paper's scenes; C otherwise). The stated numerical error is the
difference to half as many intervals, divided by 2² − 1 (Richardson).

A grid much finer than the fast mode's width gains nothing: the closure, not the stencil, then limits the accuracy.
"""

from typing import Any, NamedTuple

import numpy as np

from models import cosserat, flexible
from models.boundary_value import Array, Values, register, solve
from models.compiled import inner
from models.cosserat import equations
from models.discretisation import finite_differences, interpolation
from models.newton import NewtonStatus
from models.outcome import Outcome, Solution
from models.refinement import DRIFTING, NEWTON_FAILED, SETTLED, START_FAILED, Refined, relative_change
from models.scene import Dimensionless, Scene
from models.slow_manifold import ORDERS, rod_ends, rod_fields
from models.solution import Fields, failed, solution

NAME = "cosserat-fd"
INTERVALS = 40
TOLERANCE = 1e-5
ROTATION_TOLERANCE = 1e-8
"""The paper's 10⁻⁵ on n₁ at its v = 10³, as a change of n₁/v."""
MAX_ROTATIONS = 50
LARGEST_CHANGE = 1e-2
"""Relative change of the ends between the two grids above which the layers, not the solution, are seen."""


class PrescribedRotation(NamedTuple):
    """The problem of the printed rod at a trial n₁."""

    scene: Values
    """`Dimensionless.vector`."""
    rotation: float
    """Trial value of n₁/v."""


printed_boundary = inner(cosserat.boundary)


def boundary(problem: Any, left: Values, right: Values, w: Any, out: Values) -> None:
    """The printed conditions, with n₁ prescribed."""
    printed_boundary(problem, left, right, w, out)
    out[3] = w - problem.rotation


register(PrescribedRotation, ORDERS, equations, boundary)


def solve_cosserat_fd(scene: Scene, intervals: int = INTERVALS, *, profile: bool = True) -> Solution:
    """Solve with `intervals` equal intervals (≥ 10, even); without `profile` the numbers only.

    The outcome says what happened.
    """
    problem = scene.dimensionless()
    start = flexible.find(problem.vector, flexible.integration_matrices())
    if start.ending != SETTLED:
        return solution(scene, NAME, start._replace(ending=START_FAILED), None)
    coarse = _solve_on(problem, start, intervals // 2)
    if isinstance(coarse, str):
        return failed(scene, NAME, Outcome.NOT_CONVERGED, coarse)
    fine = coarse if coarse.ending != SETTLED else _solve_on(problem, start, intervals)
    if isinstance(fine, str):
        return failed(scene, NAME, Outcome.NOT_CONVERGED, fine)
    if fine.ending == SETTLED:
        change = fine.ends - coarse.ends
        size = float(relative_change(fine.ends, coarse.ends))
        fine = fine._replace(change=change / 3, size=size, ending=SETTLED if size <= LARGEST_CHANGE else DRIFTING)
    return solution(scene, NAME, fine, (lambda: _fields(problem, fine)) if profile else None)


def _solve_on(problem: Dimensionless, start: Refined, intervals: int) -> Refined | str:
    """The solution on one grid, or why n₁ was not found."""
    nodal = np.array([2 * np.arctan(np.exp(start.fields[0])), np.exp(start.fields[1]), start.fields[2]])
    grid = finite_differences(intervals, problem.wrap_angle, closed_at_start=_fast_mode_at_B(nodal))
    fields, w = nodal @ interpolation(start.degree, intervals, even=True).T, float(start.w)
    iterations, change = 0, np.inf
    for _ in range(MAX_ROTATIONS):
        result = solve(
            PrescribedRotation(problem.vector, w), ORDERS, grid, fields, w,
            step_tolerance=1e-8, residual_tolerance=TOLERANCE / problem.tension_CD,
        )  # fmt: skip
        iterations += result.iterations
        fields = result.fields
        ends = rod_ends(problem.tension_CD, *fields[:, 0])
        found = Refined(
            SETTLED, result.status, intervals, fields, w, ends, np.full(3, np.nan), np.inf, fields[0, -1],
            np.inf, np.nan, iterations, result.step, result.residual, result.boundary_residual, result.condition,
        )  # fmt: skip
        if result.status is not NewtonStatus.CONVERGED:
            return found._replace(ending=NEWTON_FAILED)
        updated = problem.twist_rotation(float(ends[1]))
        change, w = abs(updated - w), updated
        if change < ROTATION_TOLERANCE:
            normal = _fields(problem, found).normal_force
            lowest = int(np.argmin(normal))
            return found._replace(w=w, normal_min=float(normal[lowest]), psi_min=float(grid.nodes[lowest]))
    return (
        f"the iteration of n₁ did not settle in {MAX_ROTATIONS} rounds (last change {change:.1e} of v/r₀): "
        "use the model 'cosserat', which solves for n₁ in the same Newton system"
    )


def _fast_mode_at_B(nodal: Array) -> bool:
    """Whether the fast mode of E1 grows towards B: where τθ' > 0; θ rises or falls along the whole contact."""
    return bool(nodal[2].mean() * (nodal[0, -1] - nodal[0, 0]) >= 0)


def _fields(problem: Dimensionless, found: Refined) -> Fields:
    grid = finite_differences(found.degree, problem.wrap_angle, closed_at_start=True)
    return rod_fields(problem, cosserat.ROD, found.fields, grid.nodes, grid.nodal_derivatives)
