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
from models.boundary_value import BoundaryValueResult, Values, register, solve
from models.compiled import inner
from models.cosserat import equations, normal_force
from models.discretisation import finite_differences, interpolation
from models.newton import NewtonStatus
from models.outcome import Outcome, Solution, Stats
from models.scene import Dimensionless, Scene
from models.slow_manifold import ORDERS, Rod, rod_ends, rod_fields
from models.solution import Fields, failed, newton_outcome, relative_change, solution

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


register(PrescribedRotation, equations, boundary)
ROD = Rod(NAME, PrescribedRotation, normal_force)


def solve_cosserat_fd(scene: Scene, intervals: int = INTERVALS) -> Solution:
    """Solve with `intervals` equal intervals (≥ 10, even). The outcome says what happened."""
    problem = scene.dimensionless()
    start, _, error, _ = flexible.solve_fields(problem)
    if error is None:
        return failed(scene, NAME, Outcome.NOT_CONVERGED, f"the flexible start failed ({start.status.text})")
    coarse = _solve_on(scene, problem, start, intervals // 2)
    if isinstance(coarse, Solution):
        return coarse
    fine = _solve_on(scene, problem, start, intervals)
    if isinstance(fine, Solution):
        return fine
    fields, stats = fine
    change = relative_change(fields.ends, coarse[0].ends)
    if change > LARGEST_CHANGE:
        text = f"{Outcome.NO_SCALE_SEPARATION.value} (the ends change by {change:.1e} between the two grids)"
        return failed(scene, NAME, Outcome.NO_SCALE_SEPARATION, text, stats=stats)
    return solution(scene, NAME, fields, (fields.ends - coarse[0].ends) / 3, stats)


def _solve_on(
    scene: Scene, problem: Dimensionless, start: BoundaryValueResult, intervals: int
) -> tuple[Fields, Stats] | Solution:
    """Fields on one grid, or the failed solution."""
    degree = start.fields.shape[1] - 1
    nodal = flexible.start_values(problem, start, degree)
    # θ rises or falls along the whole contact; the fast mode of E1 grows towards B where τθ' > 0.
    fast_mode_at_B = bool(nodal[2].mean() * (nodal[0, -1] - nodal[0, 0]) >= 0)
    grid = finite_differences(intervals, problem.wrap_angle, closed_at_start=fast_mode_at_B)
    fields, w = nodal @ interpolation(degree, intervals, even=True).T, start.w
    iterations, change = 0, np.inf
    for _ in range(MAX_ROTATIONS):
        result = solve(
            PrescribedRotation(problem.vector, w), ORDERS, grid, fields, w,
            step_tolerance=1e-8, residual_tolerance=TOLERANCE / problem.tension_CD,
        )  # fmt: skip
        iterations += result.iterations
        if result.status is not NewtonStatus.CONVERGED:
            return failed(scene, NAME, *newton_outcome(result.status))
        fields = result.fields
        updated = problem.twist_rotation(float(rod_ends(problem.tension_CD, result.fields[:, 0])[1]))
        change, w = abs(updated - w), updated
        if change < ROTATION_TOLERANCE:
            stats = Stats(iterations, result.residual, result.boundary_residual, result.step, intervals + 1)
            return rod_fields(problem, ROD, grid, result, grid.nodes, np.eye(intervals + 1)), stats
    return failed(
        scene, NAME, Outcome.NOT_CONVERGED,
        f"the iteration of n₁ did not settle in {MAX_ROTATIONS} rounds (last change {change:.1e} of v/r₀): "
        "use the model 'cosserat', which solves for n₁ in the same Newton system",
    )  # fmt: skip
