"""Solving a rod on its slow manifold, and what is true of a scene where the plain search finds no solution.

Linearised at a point, the pointwise equations E y' + A y = 0 for y = (θ, θ', θ'', p₃, τ) have five rates; two belong to
the layers, three to the solution between them. The slow manifold means something only where the layers are faster:

    R = min over ψ of |λ₄| / max(|λ₃|, 1),    |λ₁| ≤ … ≤ |λ₅|,

with 1 rad as the longest scale that the geometry knows. Its expansion in 1/R, like any asymptotic series, leaves an
error that falls exponentially with R. R is a property of the equations, whatever the degree of the polynomial.

Where the search over low degrees fails or settles badly, in this order: higher degrees, from the flexible yarn; the
branch of solutions that starts at the frictionless yarn, a circle at constant tension and twist, followed in μ; and at
its end the reason: a fold, lost contact, or R too small.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.boundary_value import Array, Collocated, evaluated, linearised, solve
from models.continuation import Branch, End, collocated_family, follow
from models.discretisation import chebyshev_collocation, interpolation, polynomial
from models.flexible import Guess, first_guess, integration_matrices, nearest, several
from models.newton import NewtonStatus
from models.outcome import Outcome, Solution
from models.refinement import SETTLED, Refined, relative_change
from models.scene import FRICTION, Dimensionless, Scene
from models.slow_manifold import (
    LARGEST_CHANGE,
    LARGEST_CONDITION,
    NEWTON_TOLERANCE,
    ORDERS,
    PRECISION,
    Rod,
    collocation_matrices,
    find,
    rod_ends,
    rod_fields,
)
from models.solution import PROFILE_POINTS, Fields, failed, solution
from models.uniqueness import perhaps_several

WELL_SETTLED = 1e-6
"""Stated error above which higher degrees are tried, too: some random scenes state a smaller error than they have."""
HIGHER_DEGREES = (10, 14, 18, 24, 32, 40, 48)
SAMPLES = 41
SHIFT = 0.3717
"""No rate of a real scene, as far as one can choose."""
CONDITION_OF_LAYERS, GROWTH_BY_LAYERS = 1e7, 100.0
"""Scaled condition number, and its growth over the degrees, that say that the polynomials carry layers."""
MAX_ITERATIONS, MAX_FAILURES = 15, 3
"""Of Newton's method at one degree, and of degrees one after another."""
BRANCH_DEGREES = (12, 20, 28)
"""For following a branch. A fold is located with two neighbouring ones; the difference is stated."""
SEPARATED = 2.0
"""R below which a scene without a solution is one without scale separation; see benchmarks/hard_cases.py."""
LARGEST_DEFECT = 5e-4
"""Force between the collocation points, relative to tension, above which a solution is not reported."""
LEAST_SEPARATION = 1.01
"""R below which no solution is reported, however well it seems to settle: layers that are slower are none, and R is 1
where a layer and the solution are one conjugate pair."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Why there is no solution."""

    outcome: Outcome
    message: str


def solve_rod(scene: Scene, rod: Rod, *, profile: bool, rotation: float | None) -> Solution:
    """Solve on the slow manifold; the outcome says what happened, with the reason.

    Parameters
    ----------
    profile : whether to evaluate the solution along the contact.
    rotation : n₁ [1/s] near which a solution is wanted, where the flexible yarn has several.
    """
    problem = scene.dimensionless()
    first = find(rod.problem(problem.vector), integration_matrices(), collocation_matrices())
    found, roots = _find(scene, problem, rod, rotation, first)
    if isinstance(found, Failure):
        return failed(scene, rod.name, found.outcome, found.message, first)
    others = several(scene, roots, found.w, " of the flexible yarn")
    return solution(scene, rod.name, found, (lambda: _fields(problem, rod, found)) if profile else None, others=others)


def _fields(scene: Dimensionless, rod: Rod, found: Refined) -> Fields:
    psi = np.linspace(0.0, scene.wrap_angle, PROFILE_POINTS)
    to_profile = interpolation(found.degree, PROFILE_POINTS - 1, even=True)
    matrices = to_profile @ chebyshev_collocation(found.degree, scene.wrap_angle).nodal_derivatives
    return rod_fields(scene, rod, found.fields, psi, matrices)


def separation(problem: Dimensionless, rod: Rod, fields: Array, w: float) -> tuple[float, float]:
    """R of the linearised equations along the nodal fields θ, p₃/p₃CD and τ, shape (3, n + 1), and their defect.

    The defect is the largest force that is left between the collocation points, relative to the largest tension.
    """
    degree = fields.shape[1] - 1
    matrices = chebyshev_collocation(degree, problem.wrap_angle).nodal_derivatives
    to_points = interpolation(degree, SAMPLES - 1, even=True)
    values = np.array(
        [
            to_points @ (matrices[k] @ field)
            for field, order in zip(fields, ORDERS, strict=True)
            for k in range(order + 1)
        ]
    )
    forces, slopes = linearised(rod.problem(problem.vector), np.ascontiguousarray(values.T), w, 3)
    if not np.all(np.isfinite(slopes)):
        return 0.0, math.inf
    highest, lower = np.zeros((SAMPLES, 5, 5)), np.zeros((SAMPLES, 5, 5))
    highest[:, [0, 1], [0, 1]] = lower[:, [0, 1], [1, 2]] = 1.0
    highest[:, 2:, 2:] = slopes[:, :, [3, 5, 7]]
    lower[:, 2:] = -slopes[:, :, [0, 1, 2, 4, 6]]
    # Shifted and inverted, so that a layer of no width, a rate without bound, is an eigenvalue 0.
    inverted = np.linalg.eigvals(np.linalg.solve(lower - SHIFT * highest, highest))
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.sort(np.abs(SHIFT + 1 / inverted), axis=1)
    ratios = rates[:, 3] / np.maximum(rates[:, 2], 1.0)
    defect = np.max(np.abs(forces[:, :2])) / np.max(np.abs(fields[1]))
    return float(np.min(ratios[np.isfinite(ratios)], initial=math.inf)), float(defect)


@dataclass(frozen=True, slots=True)
class _Climb:
    """What raising the degree gave."""

    best: Refined | None
    """Where the ends settled to LARGEST_CHANGE."""
    smallest_change: float
    lowest_condition: float
    highest_condition: float
    """Scaled condition numbers over the degrees."""

    @property
    def found(self) -> str:
        """The evidence in words."""
        settling = f"to {self.smallest_change:.1e}" if math.isfinite(self.smallest_change) else "at no two degrees"
        return f"the ends settle {settling} before the polynomials carry the layers, which are not thin enough"

    @property
    def layers_entered(self) -> bool:
        """Whether the polynomials carry the layers; without them the scaled condition number hardly grows."""
        return self.highest_condition > CONDITION_OF_LAYERS or (
            self.highest_condition > GROWTH_BY_LAYERS * self.lowest_condition
        )


def _find(
    scene: Scene, problem: Dimensionless, rod: Rod, rotation: float | None, first: Refined
) -> tuple[Refined | Failure, Sequence[float]]:
    """The solution or the reason why there is none, and w of all solutions of the flexible yarn, as far as known."""
    if first.ending == SETTLED and first.size <= WELL_SETTLED and not perhaps_several(problem.vector):
        checked = _checked(problem, rod, first)
        if checked is not None:
            return checked, ()
    start = first_guess(scene, rotation)
    climb = _climb(problem, rod, start) if start is not None else None
    roots = start.roots if start is not None else ()
    settled = [climb.best] if climb is not None and climb.best is not None else []
    if first.ending == SETTLED:
        settled.append(first)
    for found in sorted(settled, key=lambda found: found.size):
        # Newton's method may have left the solution that it started from for another one.
        checked = _checked(problem, rod, found) if start is None or nearest(roots, found.w) == start.w else None
        if checked is not None:
            return checked, roots
    if rotation is not None and len(roots) > 1:
        text = f"no solution of this model was found near n₁ = {rotation:.6g} /s, where the flexible yarn has one"
        return Failure(Outcome.NOT_CONVERGED, text), roots
    return _from_frictionless(problem, rod, start, climb), roots


def _checked(problem: Dimensionless, rod: Rod, found: Refined) -> Refined | Failure | None:
    """The solution, or NO_SCALE_SEPARATION where its layers are slower than itself; None where its defect is large."""
    ratio, defect = separation(problem, rod, found.fields, found.w)
    if ratio < LEAST_SEPARATION:
        return _no_separation(f"R = {ratio:.2g} on the solution")
    return found if defect <= LARGEST_DEFECT else None


def _no_separation(detail: str) -> Failure:
    text = f"{Outcome.NO_SCALE_SEPARATION.value} (rate of the layers over that of the solution: {detail})"
    return Failure(Outcome.NO_SCALE_SEPARATION, text)


def _scaled_condition(jacobian: Array, x: Array) -> float:
    """Condition number with unknowns in units of 1 + |x| and rows of largest element 1: it sees modes, not units."""
    if not np.all(np.isfinite(jacobian)):
        return math.inf
    scaled = jacobian * (1 + np.abs(x))
    return float(np.linalg.cond(scaled / np.max(np.abs(scaled), axis=1, keepdims=True), 1))


def _climb(problem: Dimensionless, rod: Rod, start: Guess) -> _Climb:
    """Raise the degree further than the plain search does, until the ends settle."""
    best: Refined | None = None
    smallest, lowest_condition, highest_condition = math.inf, math.inf, 0.0
    previous: Array | None = None
    fields: Array | None = None
    w, iterations, failures = start.w, 0, 0
    for degree in HIGHER_DEGREES:
        grid = chebyshev_collocation(degree, problem.wrap_angle)
        first = start.at(grid.nodes) if fields is None else fields @ interpolation(fields.shape[1] - 1, degree).T
        result = solve(
            rod.problem(problem.vector), ORDERS, grid, first, w,
            step_tolerance=NEWTON_TOLERANCE, max_iterations=MAX_ITERATIONS,
        )  # fmt: skip
        iterations += result.iterations
        x = np.append(result.fields, result.w)
        collocated = Collocated(rod.problem(problem.vector), ORDERS, grid.derivatives)
        condition = _scaled_condition(evaluated(collocated, x)[1], x)
        lowest_condition, highest_condition = min(condition, lowest_condition), max(condition, highest_condition)
        if result.status is not NewtonStatus.CONVERGED:
            failures += 1
            if failures == MAX_FAILURES:
                break
            continue
        failures = 0
        if condition > LARGEST_CONDITION:
            break
        fields, w = result.fields, result.w
        ends = rod_ends(problem.tension_CD, *fields[:, 0])
        if previous is not None:
            change = relative_change(ends, previous)
            if change < smallest:
                smallest = change
                normal = rod_fields(problem, rod, fields, grid.nodes, grid.nodal_derivatives).normal_force
                lowest = int(np.argmin(normal))
                best = Refined(
                    SETTLED, result.status, degree, fields, w, ends, ends - previous, change, float(fields[0, -1]),
                    float(normal[lowest]), float(grid.nodes[lowest]), iterations, result.step, result.residual,
                    result.boundary_residual, condition,
                )  # fmt: skip
            if change < PRECISION:
                break
        previous = ends
    settled = smallest <= LARGEST_CHANGE
    return _Climb(best if settled else None, smallest, lowest_condition, highest_condition)


def _from_frictionless(
    problem: Dimensionless, rod: Rod, start: Guess | None, climb: _Climb | None
) -> Refined | Failure:
    """Follow the branch from μ = 0: the solution at its end, or the reason why there is none."""
    degrees = BRANCH_DEGREES
    branch = _follow(problem, rod, degrees[0])
    fields, w = _split(branch.x)
    if branch.end is End.REACHED and not possible(fields[0], fields[1]):  # the polynomial was too coarse to see a fold
        degrees = degrees[1:]
        branch = _follow(problem, rod, degrees[0])
        fields, w = _split(branch.x)
    if branch.end is End.REACHED:
        climb = _climb(problem, rod, Guess(polynomial(fields, problem.wrap_angle), w, (w,)))
        checked = _checked(problem, rod, climb.best) if climb.best is not None else None
        if checked is not None:
            return checked
    if branch.end is End.TURNED:
        at_fold, _ = separation(_at(problem, branch.folds[0].parameter), rod, *_split(branch.folds[0].x))
        if at_fold >= SEPARATED:
            return fold(branch, _follow(problem, rod, degrees[1]), problem.friction)
        return _no_separation(f"R = {at_fold:.2g} at μ = {branch.folds[0].parameter:.3g}")
    at_end, _ = separation(_at(problem, branch.parameter), rod, fields, w)
    at_start = math.inf
    if start is not None:
        nodes = chebyshev_collocation(degrees[0], problem.wrap_angle).nodes
        at_start, _ = separation(problem, rod, start.at(nodes), start.w)
    if min(at_start, at_end) < SEPARATED:
        detail = f"R = {at_start:.2g} on the flexible yarn, {at_end:.2g} on the rod at μ = {branch.parameter:.3g}"
        return _no_separation(detail)
    if climb is not None and climb.layers_entered:
        return _no_separation(f"R = {at_end:.2g}; {climb.found}")
    return Failure(
        Outcome.NOT_CONVERGED,
        f"{Outcome.NOT_CONVERGED.value} (followed from no friction to μ = {branch.parameter:.3g}: {branch.end.value}; "
        f"R = {at_end:.2g}, {at_start:.2g} on the flexible yarn)",
    )


def possible(theta: Array, tension: Array) -> bool:
    """Whether the yarn is in tension and nowhere turned past the cylinder's axis, where the equations go on."""
    return bool(np.all(np.sin(theta) > 0) and np.all(tension > 0))


def _at(problem: Dimensionless, friction: float) -> Dimensionless:
    values = {name: getattr(problem, name) for name in Dimensionless.__dataclass_fields__}
    return Dimensionless(**values | {"friction": max(friction, 0.0)})


def _split(x: Array) -> tuple[Array, float]:
    return x[:-1].reshape(3, -1), float(x[-1])


def _follow(problem: Dimensionless, rod: Rod, degree: int) -> Branch:
    """The branch from the frictionless circle to μ."""
    x = np.empty(3 * (degree + 1) + 1)
    x[: degree + 1], x[degree + 1 : 2 * (degree + 1)] = np.pi / 2, 1.0
    x[2 * (degree + 1) : -1], x[-1] = 2 * np.pi * problem.twist_CD, problem.twist_rotation(problem.twist_CD)
    grid = chebyshev_collocation(degree, problem.wrap_angle)
    make: Callable[[Any], Any] = rod.problem
    family = collocated_family(make, problem.vector, FRICTION, ORDERS, grid)
    with np.errstate(all="ignore"):  # a trial may leave the domain: it then counts as failed
        return follow(family, x, 0.0, problem.friction)


def fold(branch: Branch, finer: Branch, friction: float) -> Failure:
    """FOLD, with the friction at which the branch ends by two degrees."""
    coarse = branch.folds[0].parameter
    at = finer.folds[0].parameter if finer.folds else coarse
    detail = f"μ = {at:.4g}, to about {abs(at - coarse):.1g}; here μ = {friction:.4g}"
    return Failure(Outcome.FOLD, f"{Outcome.FOLD.value} ({detail})")
