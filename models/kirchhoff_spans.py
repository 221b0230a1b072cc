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

from typing import Any, NamedTuple

import numpy as np

from models import flexible
from models.boundary_value import Array, Values, highest_derivatives, register, solve
from models.compiled import compiled
from models.complex_step import sine_cosine
from models.discretisation import chebyshev_collocation, interpolation
from models.friction import end_conditions, friction_direction
from models.kirchhoff import balance_by_arc
from models.newton import NewtonStatus
from models.outcome import Outcome, Solution
from models.refinement import NEWTON_FAILED, SETTLED, START_FAILED, UNRESOLVED, Refined, relative_change
from models.scene import BENDING_RIGIDITY, FRICTION, SPAN_RATIO, TENSION_CD, YARN_RADIUS, Dimensionless, Scene
from models.solution import PROFILE_POINTS, Fields, failed, solution

NAME = "kirchhoff-spans"
ORDERS = highest_derivatives(1, 1, 1, 1, 1)
DEGREES = (12, 16, 24, 32, 48, 64, 96)
PRECISION = 1e-9
"""Change of the ends between neighbouring degrees at which the refinement ends."""
LARGEST_CHANGE = 1e-6
"""Change above which the layers count as not resolved."""


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


def solve_kirchhoff_spans(scene: Scene, *, profile: bool = True) -> Solution:
    """Solve with resolved layers. Never raises for a hard scene: the outcome says what happened."""
    problem = scene.dimensionless()
    found = find(problem)
    if found.ending == UNRESOLVED:
        width = np.sqrt(problem.bending_rigidity / problem.tension_CD) / problem.wrap_angle
        text = f"layers of {width:.1e} of the contact are not resolved by a polynomial of degree {found.degree}"
        return failed(scene, NAME, Outcome.NOT_CONVERGED, text, found)
    return solution(scene, NAME, found, (lambda: _fields(problem, found)) if profile else None)


def find(scene: Dimensionless) -> Refined:
    """Refine from the flexible yarn until the ends stop changing; `Refined.fields` holds the five fields."""
    yarn = flexible.find(scene.vector, flexible.integration_matrices())
    if yarn.ending != SETTLED:
        return yarn._replace(ending=START_FAILED)
    nodal = np.array([2 * np.arctan(np.exp(yarn.fields[0])), np.exp(yarn.fields[1]), yarn.fields[2]])
    iterations, previous = int(yarn.iterations), None
    fields, w = np.empty((5, 0)), float(yarn.w)
    best = yarn._replace(ending=UNRESOLVED)
    for degree in DEGREES:
        grid = chebyshev_collocation(degree, scene.wrap_angle)
        if fields.size:
            fields = fields @ interpolation(fields.shape[1] - 1, degree).T
        else:
            fields = _start(nodal @ interpolation(yarn.degree, degree).T, grid.nodal_derivatives[1])
        trial = solve(Spans(scene.vector), ORDERS, grid, fields, w)
        iterations += trial.iterations
        best = best._replace(status=trial.status, degree=degree, iterations=iterations)
        if trial.status is not NewtonStatus.CONVERGED:
            best = best._replace(ending=NEWTON_FAILED)
            previous, fields, w = None, np.empty((5, 0)), float(yarn.w)
            continue
        fields, w = trial.fields, trial.w
        found = ends(scene.tension_CD, fields[:, 0])
        best = Refined(
            UNRESOLVED, trial.status, degree, fields, w, found, np.full(3, np.nan), np.inf, float(fields[0, -1]),
            np.inf, np.nan, iterations, trial.step, trial.residual, trial.boundary_residual, trial.condition,
        )  # fmt: skip
        if previous is not None:
            size = float(relative_change(found, previous))
            ending = SETTLED if size < LARGEST_CHANGE else UNRESOLVED
            best = best._replace(ending=ending, change=found - previous, size=size)
            if size < PRECISION:
                break
        previous = found
    if best.ending != SETTLED:
        return best
    contact = _fields(scene, best)
    lowest = int(np.argmin(contact.normal_force))
    return best._replace(normal_min=float(contact.normal_force[lowest]), psi_min=float(contact.psi[lowest]))


def _start(values: Array, derivative: Array) -> Array:
    """The five fields of a smooth solution θ, p₃/p₃CD, u₃ at the nodes, shape (5, n + 1)."""
    theta, tension, u3 = values
    theta_s = np.sin(theta) * (derivative @ theta)
    return np.array([theta, theta_s, np.sin(theta) * (derivative @ theta_s), tension, u3])


def ends(tension_CD: Any, at_B: Values) -> Values:
    """p₃AB, T_AB and θ_B, dimensionless, shape (3,), from the five fields at B; analytic."""
    theta, _, _, tension, u3 = at_B
    return np.array([tension * tension_CD, (u3 - np.sin(theta) * np.cos(theta)) / (2 * np.pi), theta])


def _fields(scene: Dimensionless, found: Refined) -> Fields:
    """The solution and its normal force on an even grid."""
    psi = np.linspace(0.0, scene.wrap_angle, PROFILE_POINTS)
    to_profile = interpolation(found.degree, PROFILE_POINTS - 1, even=True)
    slopes = found.fields @ chebyshev_collocation(found.degree, scene.wrap_angle).nodal_derivatives[1].T
    values = np.stack([found.fields, slopes], axis=1).reshape(10, -1) @ to_profile.T
    theta, slope, tension, u3 = values[0], values[1], values[6], values[8]
    return Fields(scene, psi, theta, slope, tension * scene.tension_CD, u3, normal_force(scene.vector, values))
