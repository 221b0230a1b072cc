"""The paper's own scheme for the printed Cosserat model (Yin, Tao, Jasper, Cellulose 2020, section 3).

Finite differences in ψ; Newton–Raphson at a trial n₁ until the norm of the equations is below 10⁻⁵ (in K/r₀²); then
n₁ = η v (T_AB − k T_CD) anew, until two neighbouring values differ by less than 10⁻⁵. The paper does not print its
grid or stencils: here every derivative is of second order, and the equations are closed at the end where the fast
mode of E1 is largest (B where τθ' > 0, as in the paper's scenes; C otherwise). The stated numerical error is the
difference to half as many intervals, divided by 2² − 1 (Richardson).

Limits: those of the printed model, `cosserat`, whose solve says why where the scheme fails because the equations have
no solution. A grid much finer than the fast mode's width gains nothing: the closure, not the stencil, then limits the
accuracy. One solution is found; others are not looked for.
"""

import math
from dataclasses import replace

import numpy as np

from models import cosserat
from models.boundary_value import Array, Collocated, evaluated
from models.discretisation import Discretisation, finite_differences
from models.flexible import Guess, first_guess
from models.newton import NewtonStatus
from models.outcome import Outcome, Solution
from models.refinement import SETTLED, Refined, relative_change
from models.scene import Dimensionless, Scene
from models.slow_manifold import ORDERS, rod_ends, rod_fields
from models.solution import Fields, failed, solution

NAME = "cosserat-fd"
INTERVALS, FEWEST_INTERVALS = 40, 10
TOLERANCE = 1e-5
"""Of the equations' norm, in K/r₀²."""
MAX_CORRECTIONS = 30
ROTATION_TOLERANCE = 1e-8
"""The paper's 10⁻⁵ on n₁ at its v = 10³, as a change of n₁/v."""
MAX_ROTATIONS = 50
LARGEST_CHANGE = 1e-2
"""Relative change of the ends between the two grids above which the layers, not the solution, are seen."""


def solve_cosserat_fd(scene: Scene, intervals: int = INTERVALS, *, profile: bool = True) -> Solution:
    """Solve with `intervals` equal intervals; without `profile` the numbers only. The outcome says what happened.

    Raises
    ------
    ValueError
        If the number of intervals is odd or below 10: half as many are solved, too.
    """
    if intervals < FEWEST_INTERVALS or intervals % 2:
        raise ValueError(f"intervals = {intervals}: must be an even number, {FEWEST_INTERVALS} or greater")
    problem = scene.dimensionless()
    start = first_guess(scene)
    if start is None:
        return failed(scene, NAME, Outcome.STICKING, Outcome.STICKING.value)
    coarse = _solve_on(problem, start, intervals // 2)
    fine = coarse if isinstance(coarse, str) else _solve_on(problem, start, intervals)
    if isinstance(coarse, str) or isinstance(fine, str):
        return _why(scene, str(fine))
    size = float(relative_change(fine.ends, coarse.ends))
    if size > LARGEST_CHANGE:
        return _why(scene, f"the ends differ by {size:.1e} between {intervals // 2} and {intervals} intervals")
    found = fine._replace(change=(fine.ends - coarse.ends) / 3, size=size)
    return solution(scene, NAME, found, (lambda: _contact(problem, found.fields)) if profile else None)


def _why(scene: Scene, detail: str) -> Solution:
    """The scheme failed: the outcome of the same equations where they have no solution, else NOT_CONVERGED."""
    other = cosserat.solve_cosserat(scene, profile=False)
    if not other.outcome.ok:
        return replace(other, model=NAME, message=f"{other.message}; the paper's scheme: {detail}")
    text = f"the paper's scheme fails ({detail}), though the equations have a solution: use the model 'cosserat'"
    return failed(scene, NAME, Outcome.NOT_CONVERGED, text)


def _solve_on(problem: Dimensionless, start: Guess, intervals: int) -> Refined | str:
    """The solution on one grid, or why there is none."""
    even = np.linspace(0.0, problem.wrap_angle, intervals + 1)
    fields, w = start.at(even), start.w
    grid = finite_differences(intervals, problem.wrap_angle, closed_at_start=_fast_mode_at_B(fields))
    iterations, change = 0, np.inf
    for _ in range(MAX_ROTATIONS):
        x = np.append(fields, w)
        found = _newton_raphson(problem, grid, x)
        if isinstance(found, str):
            return found
        residual, boundary_residual, count = found
        iterations += count
        fields = x[:-1].reshape(3, -1)
        ends = rod_ends(problem.tension_CD, *fields[:, 0])
        updated = problem.twist_rotation(float(ends[1]))
        change, w = abs(updated - w), updated
        if change < ROTATION_TOLERANCE:
            normal = _contact(problem, fields).normal_force
            lowest = int(np.argmin(normal))
            return Refined(
                SETTLED, NewtonStatus.CONVERGED, intervals, fields, w, ends, np.full(3, np.nan), np.nan,
                float(fields[0, -1]), float(normal[lowest]), float(even[lowest]), iterations, change, residual,
                boundary_residual, np.nan,
            )  # fmt: skip
    return f"the iteration of n₁ did not settle in {MAX_ROTATIONS} rounds, last change {change:.1e} of v/r₀"


def _newton_raphson(problem: Dimensionless, grid: Discretisation, x: Array) -> tuple[float, float, int] | str:
    """Solve at the n₁/v that is the last of x, in place: residuals of equations and conditions, and corrections.

    Where it fails, the reason.
    """
    collocated = Collocated(cosserat.Printed(problem.vector), ORDERS, grid.derivatives)
    rows, norm = ORDERS.size * grid.points.size, math.inf
    for iteration in range(MAX_CORRECTIONS):
        value, jacobian = evaluated(collocated, x)
        value, jacobian = value[:-1], jacobian[:-1, :-1]  # the last condition and the last unknown are those of n₁
        if not (np.all(np.isfinite(value)) and np.all(np.isfinite(jacobian))):
            return "the equations have no finite value at an iterate of Newton-Raphson"
        try:
            x[:-1] -= np.linalg.solve(jacobian, value)
        except np.linalg.LinAlgError:
            return "the matrix of a Newton-Raphson step is singular"
        norm = float(np.max(np.abs(value))) * problem.tension_CD  # from units of p₃CD
        if norm <= TOLERANCE:
            return float(np.max(np.abs(value[:rows]))), float(np.max(np.abs(value[rows:]))), iteration + 1
    return f"Newton-Raphson left a norm of {norm:.1e} after {MAX_CORRECTIONS} corrections"


def _fast_mode_at_B(nodal: Array) -> bool:
    """Whether the fast mode of E1 grows towards B: where τθ' > 0; θ rises or falls along the whole contact."""
    return bool(nodal[2].mean() * (nodal[0, -1] - nodal[0, 0]) >= 0)


def _contact(problem: Dimensionless, fields: Array) -> Fields:
    grid = finite_differences(fields.shape[1] - 1, problem.wrap_angle, closed_at_start=True)
    return rod_fields(problem, cosserat.ROD, fields, grid.nodes, grid.nodal_derivatives)
