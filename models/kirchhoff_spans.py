"""The frame-consistent Kirchhoff rod with elastic free spans: its layers are kept and end where the yarn lifts off.

The equations are those of `kirchhoff`, of third order in θ, and now with as many boundary conditions. In a free span of
tension P the angle relaxes to that of the straight yarn as e^{∓s/λ}, λ = √(B/P). The span's bending moment is that of
the yarn on the cylinder where contact ends, so that with subscript s = d/ds = sinθ d/dψ

    at B: θ_ss = θ_s/λ,   θ_AB = θ − λ θ_s           at C: θ_ss = −θ_s/λ,   θ_CD = θ + λ θ_s

and the far-field angles enter the geometry of the spans, l_AB cosθ_AB + l_CD cosθ_CD = 0. Solved as five equations of
first order for θ, θ_s, θ_ss, p₃/p₃CD and u₃, by collocation of a degree that resolves the layers. θ_B is the angle
where contact starts, not the far-field one.

Source: derived for this project; λ is the bending length of a rod under tension (Landau and Lifshitz, Theory of
Elasticity, section 20). Limits: small angles between span and contact (|λ θ_s| ≪ 1), as for `kirchhoff` otherwise;
p₃ → ∞ recovers the flexible yarn.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from models.boundary_value import Array, Values, highest_derivatives, linearised, register, solve
from models.compiled import compiled
from models.complex_step import sine_cosine
from models.continuation import Branch, End, collocated_family, follow
from models.diagnosis import Failure, fold, possible
from models.discretisation import chebyshev_collocation, interpolation, polynomial
from models.flexible import Guess, first_guess, nearest, several
from models.friction import end_conditions, friction_direction
from models.kirchhoff import balance_by_arc
from models.newton import NewtonStatus
from models.outcome import Outcome, Solution
from models.refinement import NEWTON_FAILED, SETTLED, UNRESOLVED, Refined, relative_change
from models.scene import BENDING_RIGIDITY, FRICTION, SPAN_RATIO, TENSION_CD, YARN_RADIUS, Dimensionless, Scene
from models.slow_manifold import LARGEST_CHANGE
from models.solution import PROFILE_POINTS, Fields, failed, solution

NAME = "kirchhoff-spans"
ORDERS = highest_derivatives(1, 1, 1, 1, 1)
DEGREES = (12, 16, 24, 32, 48, 64, 96, 128)
PRECISION = 1e-9
"""Change of the ends between neighbouring degrees at which the refinement ends."""
RESIDUAL_TOLERANCE = 1e-11
"""Times the degree squared, as the rounding of derivatives grows."""
LARGEST_DEFECT = 1e-8
"""Above it a solution counts as unresolved: forces that are differentiated anew from θ are off by 1e-3 from 3e-8 on (of
731 random solutions five were, none of 694 below)."""
BRANCH_DEGREES = (24, 40, 56)
"""For following the branch from no friction; a fold is located with two neighbouring ones."""
SLACK = 1e-3
"""p₃/p₃CD below which a branch beyond a fold counts as ended."""


class Spans(NamedTuple):
    """The problem of the consistent rod with elastic spans."""

    scene: Values
    """`Dimensionless.vector`."""


def equations(problem: Spans, f: Values, w: Any) -> tuple[Any, ...]:
    """Definitions of θ_s and θ_ss, balances along e_v and t in units of p₃CD, and that of the twisting moment.

    f holds θ, θ_s, θ_ss, p₃/p₃CD and u₃, each with its derivative by ψ.
    """
    sine, cosine = sine_cosine(f[0])
    by_arc, u3_s = (f[2], f[4], sine * f[5]), sine * f[9]
    along, across, normal = balance_by_arc(problem.scene, sine, cosine, by_arc, (f[6], sine * f[7]), (f[8], u3_s))
    cos_alpha, sin_alpha = friction_direction(problem.scene, sine, cosine, w)
    friction = problem.scene[FRICTION] * normal
    return (
        sine * f[1] - f[2],
        sine * f[3] - f[4],
        across + friction * cos_alpha,
        along - friction * sin_alpha,
        u3_s + friction * cos_alpha * problem.scene[YARN_RADIUS] * problem.scene[TENSION_CD],
    )


def boundary(problem: Spans, left: Values, right: Values, w: Any, out: Values) -> None:
    """Geometry of the far-field angles, p₃(φ), T(φ), the twist rotation, and the spans' relaxation at B and C."""
    rigidity = problem.scene[BENDING_RIGIDITY] / problem.scene[TENSION_CD]
    length_B, length_C = np.sqrt(rigidity / left[3]), np.sqrt(rigidity / right[3])
    ends = (np.sin(left[0]), np.cos(left[0]), np.sin(right[0]), np.cos(right[0]))
    end_conditions(problem.scene, ends, left[4], right[4], w, out)
    far_B, far_C = left[0] - length_B * left[1], right[0] + length_C * right[1]
    out[0] = problem.scene[SPAN_RATIO] * np.cos(far_B) + np.cos(far_C)
    out[1] = right[3] - 1
    out[4] = length_B * left[2] - left[1]
    out[5] = length_C * right[2] + right[1]


register(Spans, ORDERS, equations, boundary)


@compiled
def normal_force(scene: Array, values: Array) -> Array:
    """N in K/r₀³, shape (n,), from the pointwise arguments of `equations`, shape (10, n)."""
    normal = np.empty(values.shape[1])
    for j in range(values.shape[1]):
        f = values[:, j]
        sine = np.sin(f[0])
        by_arc, twist = (f[2], f[4], sine * f[5]), (f[8], sine * f[9])
        tension = (f[6], sine * f[7])
        normal[j] = balance_by_arc(scene, sine, np.cos(f[0]), by_arc, tension, twist)[2] * scene[TENSION_CD]
    return normal


def solve_kirchhoff_spans(scene: Scene, *, profile: bool = True, rotation: float | None = None) -> Solution:
    """Solve with resolved layers; arguments as for the flexible yarn."""
    problem = scene.dimensionless()
    found, roots = find(scene, rotation)
    if isinstance(found, Failure):
        return failed(scene, NAME, found.outcome, found.message)
    others = several(scene, roots, found.w, " of the flexible yarn")
    return solution(scene, NAME, found, (lambda: _fields(problem, found)) if profile else None, others=others)


def find(scene: Scene, rotation: float | None = None) -> tuple[Refined | Failure, Sequence[float]]:
    """The solution or the reason why there is none, and w of all solutions of the flexible yarn, as far as known.

    From the flexible yarn first, then along the branch of solutions that starts at the frictionless circle.
    """
    problem, start = scene.dimensionless(), first_guess(scene, rotation)
    roots = start.roots if start is not None else ()
    if start is not None:
        found = refine(problem, start)
        if found.ending == SETTLED and nearest(roots, found.w) == start.w:
            return found, roots
    if rotation is not None and len(roots) > 1:
        text = f"no solution of this model was found near n₁ = {rotation:.6g} /s, where the flexible yarn has one"
        return Failure(Outcome.NOT_CONVERGED, text), roots
    return _from_frictionless(problem), roots


def refine(scene: Dimensionless, start: Guess) -> Refined:
    """Raise the degree until the ends stop changing; `Refined.fields` holds the five fields."""
    best = Refined(
        NEWTON_FAILED, NewtonStatus.NOT_FINITE, 0, np.empty((5, 0)), start.w, np.full(3, np.nan), np.full(3, np.nan),
        np.inf, np.nan, np.inf, np.nan, 0, np.nan, np.nan, np.nan, np.nan,
    )  # fmt: skip
    iterations, previous, fields, w = 0, None, np.empty((5, 0)), start.w
    for degree in DEGREES:
        grid = chebyshev_collocation(degree, scene.wrap_angle)
        if previous is None:
            fields, w = _smooth(start.at(grid.nodes), grid.nodal_derivatives[1]), start.w
        else:
            fields = fields @ interpolation(fields.shape[1] - 1, degree).T
        residual_tolerance = RESIDUAL_TOLERANCE * degree**2
        trial = solve(Spans(scene.vector), ORDERS, grid, fields, w, residual_tolerance=residual_tolerance)
        iterations += trial.iterations
        if trial.status is not NewtonStatus.CONVERGED or not _possible(trial.fields):
            previous = None
            if best.ending == NEWTON_FAILED:
                best = best._replace(status=trial.status, degree=degree, iterations=iterations)
            continue
        fields, w = trial.fields, trial.w
        found = ends(scene.tension_CD, fields[:, 0])
        change = np.full(3, np.nan) if previous is None else found - previous
        size = np.inf if previous is None else relative_change(found, previous)
        if size <= best.size:
            best = Refined(
                SETTLED if size <= LARGEST_CHANGE else UNRESOLVED, trial.status, degree, fields, w, found, change, size,
                float(fields[0, -1]), np.inf, np.nan, iterations, trial.step, trial.residual, trial.boundary_residual,
                trial.condition,
            )  # fmt: skip
        if size < PRECISION:
            break
        previous = found
    if best.ending != SETTLED:
        return best
    if _defect(scene, best) > LARGEST_DEFECT:
        return best._replace(ending=UNRESOLVED)
    contact = _fields(scene, best)
    lowest = int(np.argmin(contact.normal_force))
    return best._replace(normal_min=float(contact.normal_force[lowest]), psi_min=float(contact.psi[lowest]))


def _possible(fields: Array) -> bool:
    return possible(fields[0], fields[3])


def _defect(scene: Dimensionless, found: Refined) -> float:
    """Largest residual between the collocation points: of θ_s, of λ θ_ss, of forces relative to the largest tension."""
    values = _arguments(scene, found)
    left_over, _ = linearised(Spans(scene.vector), np.ascontiguousarray(values.T), found.w, len(ORDERS))
    scale = np.array([1.0, np.sqrt(scene.bending_rigidity / scene.tension_CD), 1.0, 1.0])
    scale[2:] /= np.max(found.fields[3])
    return float(np.max(np.abs(left_over[:, :4]) * scale))


def _from_frictionless(scene: Dimensionless) -> Refined | Failure:
    """Follow the branch from μ = 0: the solution at its end, or the reason why there is none."""
    degrees = BRANCH_DEGREES
    branch = _follow(scene, degrees[0])
    if branch.end is End.REACHED and not _possible(
        branch.x[:-1].reshape(5, -1)
    ):  # the polynomial was too coarse to see a fold
        degrees = degrees[1:]
        branch = _follow(scene, degrees[0])
    fields, w = branch.x[:-1].reshape(5, -1), float(branch.x[-1])
    if branch.end is End.REACHED:
        found = refine(scene, Guess(polynomial(fields[[0, 3, 4]], scene.wrap_angle), w, (w,)))
        if found.ending == SETTLED:
            return found
        if found.ending == UNRESOLVED:
            width = np.sqrt(scene.bending_rigidity / (scene.tension_CD * np.max(found.fields[3]))) / scene.wrap_angle
            text = f"degree {DEGREES[-1]}, layers of {width:.1e} of the contact"
            return Failure(Outcome.UNRESOLVED, f"{Outcome.UNRESOLVED.value} ({text}); kirchhoff leaves layers out")
    if branch.folds and (branch.end is End.TURNED or np.min(fields[3]) < SLACK):
        return fold(branch, _follow(scene, degrees[1]), scene.friction)
    text = f"followed from no friction to μ = {branch.parameter:.3g} of {scene.friction:.3g}: {branch.end.value}"
    if not _possible(fields):
        text += ", where the yarn would be slack or turned past the cylinder's axis"
    return Failure(Outcome.NOT_CONVERGED, f"{Outcome.NOT_CONVERGED.value} ({text})")


def _follow(scene: Dimensionless, degree: int) -> Branch:
    """The branch from the frictionless circle to μ."""
    fields = np.zeros((5, degree + 1))
    fields[0], fields[3], fields[4] = np.pi / 2, 1.0, 2 * np.pi * scene.twist_CD
    grid = chebyshev_collocation(degree, scene.wrap_angle)
    family = collocated_family(Spans, scene.vector, FRICTION, ORDERS, grid)
    with np.errstate(all="ignore"):  # a trial may leave the domain: it then counts as failed
        return follow(family, np.append(fields, scene.twist_rotation(scene.twist_CD)), 0.0, scene.friction)


def _smooth(values: Array, derivative: Array) -> Array:
    """The five fields of a smooth solution θ, p₃/p₃CD, u₃ at the nodes, shape (5, n + 1)."""
    theta, tension, u3 = values
    theta_s = np.sin(theta) * (derivative @ theta)
    return np.array([theta, theta_s, np.sin(theta) * (derivative @ theta_s), tension, u3])


def ends(tension_CD: Any, at_B: Values) -> Values:
    """p₃AB, T_AB and θ_B, dimensionless, shape (3,), from the five fields at B; analytic."""
    theta, _, _, tension, u3 = at_B
    return np.array([tension * tension_CD, (u3 - np.sin(theta) * np.cos(theta)) / (2 * np.pi), theta])


def _arguments(scene: Dimensionless, found: Refined) -> Array:
    """The fields, each with its derivative by ψ, on an even grid, shape (10, PROFILE_POINTS)."""
    to_profile = interpolation(found.degree, PROFILE_POINTS - 1, even=True)
    slopes = found.fields @ chebyshev_collocation(found.degree, scene.wrap_angle).nodal_derivatives[1].T
    return np.stack([found.fields, slopes], axis=1).reshape(10, -1) @ to_profile.T


def _fields(scene: Dimensionless, found: Refined) -> Fields:
    """The solution and its normal force on an even grid."""
    psi, values = np.linspace(0.0, scene.wrap_angle, PROFILE_POINTS), _arguments(scene, found)
    theta, slope, tension, u3 = values[0], values[1], values[6], values[8]
    return Fields(scene, psi, theta, slope, tension * scene.tension_CD, u3, normal_force(scene.vector, values))
