"""The paper's own scheme for the printed Cosserat model (Yin, Tao, Jasper, Cellulose 2020, section 3).

Finite differences in ψ; Newton–Raphson at a trial n₁ until the norm of the equations is below 10⁻⁵ (in K/r₀²); then
n₁ = η v (T_AB − k T_CD) anew, until two neighbouring values differ by less than 10⁻⁵. The paper does not print its
grid or stencils: here every derivative is of second order, and the equations are closed at the end where the fast
mode of E1 is largest (B where τθ' > 0, as in the paper's scenes; C otherwise). The stated numerical error is the
difference to half as many intervals, divided by 2² − 1 (Richardson).

A grid much finer than the fast mode's width gains nothing: the closure, not the stencil, then limits the accuracy.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.boundary_value import Array, BoundaryValueResult, Values, solve
from models.cosserat import CosseratProblem
from models.discretisation import Discretisation, finite_differences
from models.flexible import solve_flexible
from models.newton import NewtonStatus
from models.outcome import Outcome, Solution, Stats
from models.scene import Scene
from models.solution import Fields, failed, solution, start_values

NAME = "cosserat-fd"
INTERVALS = 40
TOLERANCE = 1e-5
ROTATION_TOLERANCE = 1e-8
"""The paper's 10⁻⁵ on n₁ at its v = 10³, as a change of n₁/v."""
MAX_ROTATIONS = 50
LARGEST_CHANGE = 1e-2
"""Relative change of the ends between the two grids above which the layers, not the solution, are seen."""


@dataclass(frozen=True, slots=True)
class PrescribedRotation:
    """The printed problem at a trial value of n₁/v."""

    cosserat: CosseratProblem
    rotation: float
    orders: tuple[int, ...] = (3, 1, 1)

    def equations(self, fields: Sequence[Sequence[Values]], w: Values) -> Sequence[Values]:
        """E1, E2, E3."""
        return self.cosserat.equations(fields, w)

    def boundary(self, left: Sequence[Values], right: Sequence[Values], w: Values) -> Sequence[Values]:
        """The printed conditions, with n₁ prescribed."""
        return *self.cosserat.boundary(left, right, w)[:3], w - self.rotation


def solve_cosserat_fd(scene: Scene, intervals: int = INTERVALS) -> Solution:
    """Solve with `intervals` equal intervals (≥ 10, even). The outcome says what happened."""
    flexible = solve_flexible(scene)
    if not flexible.outcome.ok:
        return failed(scene, NAME, flexible.outcome, f"the flexible start failed: {flexible.message}")
    coarse = _solve_on(scene, flexible, intervals // 2)
    if isinstance(coarse, Solution):
        return coarse
    fine = _solve_on(scene, flexible, intervals)
    if isinstance(fine, Solution):
        return fine
    fields, stats = fine
    change = fields.end_difference(coarse[0])
    if change > LARGEST_CHANGE:
        text = f"{Outcome.NO_SCALE_SEPARATION.value} (the ends change by {change:.1e} between the two grids)"
        return failed(scene, NAME, Outcome.NO_SCALE_SEPARATION, text, stats=stats)
    return solution(scene, NAME, fields, (fields.ends - coarse[0].ends) / 3, stats)


def _solve_on(scene: Scene, start: Solution, intervals: int) -> tuple[Fields, Stats] | Solution:
    """Fields on one grid, or the failed solution."""
    problem = CosseratProblem(scene.dimensionless())
    assert start.profile is not None
    fast_mode_at_B = float(np.mean(start.profile.torsional_moment * np.gradient(start.profile.theta))) >= 0
    grid = finite_differences(intervals, scene.wrap_angle, closed_at_start=fast_mode_at_B)
    fields, w = start_values(start, grid.nodes)
    iterations, change = 0, np.inf
    for _ in range(MAX_ROTATIONS):
        result = solve(
            PrescribedRotation(problem, w), grid, fields, w,
            step_tolerance=1e-8, residual_tolerance=TOLERANCE / problem.scene.tension_CD,
        )  # fmt: skip
        iterations += result.newton.iterations
        if result.newton.status is not NewtonStatus.CONVERGED:
            singular = result.newton.status is NewtonStatus.SINGULAR
            outcome = Outcome.SINGULAR if singular else Outcome.NOT_CONVERGED
            return failed(scene, NAME, outcome, f"{outcome.value} ({result.newton.status.value})")
        fields = result.fields
        found = _as_fields(problem, grid, result)
        updated = problem.scene.twist_rotation(float(found.twist[0]))
        change, w = abs(updated - w), updated
        if change < ROTATION_TOLERANCE:
            stats = Stats(
                iterations, result.residual, result.boundary_residual, result.newton.step, intervals + 1,
                result.condition,
            )  # fmt: skip
            return found, stats
    return failed(
        scene, NAME, Outcome.NOT_CONVERGED,
        f"the iteration of n₁ did not settle in {MAX_ROTATIONS} rounds (last change {change:.1e} of v/r₀): "
        "use the model 'cosserat', which solves for n₁ in the same Newton system",
    )  # fmt: skip


def _as_fields(problem: CosseratProblem, grid: Discretisation, result: BoundaryValueResult) -> Fields:
    """The grid solution as it is."""
    values: list[list[Array]] = [
        [grid.nodal_derivatives[k] @ result.fields[i] for k in range(order + 1)]
        for i, order in enumerate(problem.orders)
    ]
    theta, tension, tau = result.fields
    return Fields(
        problem.scene, grid.nodes, theta, values[0][1], tension * problem.scene.tension_CD, tau, result.w,
        problem.normal_force(values, result.w),
    )  # fmt: skip
