"""Flexible yarn on the moving cylinder: tension and twist, no bending (Feng et al. 2012; paper's baseline).

    θ' = μ cosα sinθ        p₃' = μ sinα sinθ p₃        τ' = −μ cosα sinθ R₀ p₃        N = p₃ sin²θ

with ' = d/dψ, lengths in r₀, forces in K/r₀². Solved for q = ln tan(θ/2), so that q' = μ cosα, sinθ = 1/cosh q and
cosθ = −tanh q, and for ln p₃: both stay in their domain whatever Newton tries. Boundary conditions: p₃(φ) = p₃CD,
T(φ) = T_CD, l_AB cosθ(0) + l_CD cosθ(φ) = 0, n₁ = η v (T_AB − k T_CD).

Limits: no bending or torsional stiffness in the force balance, inextensible, weightless, steady, contact everywhere.
Chebyshev collocation is refined until the ends stop changing, near machine precision. Where twist acts strongly on
itself, or collocation does not resolve the solution, all solutions are found by quadrature (self_consistency.py).
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from models.boundary_value import Array, BoundaryValueResult, Values, register, solve
from models.discretisation import Discretisation, chebyshev_collocation, interpolation
from models.friction import end_conditions, friction_direction
from models.newton import NewtonStatus
from models.outcome import Outcome, Solution, Stats
from models.scene import FRICTION, TENSION_CD, YARN_RADIUS, Dimensionless, Scene
from models.self_consistency import STRONG_FEEDBACK, TOLERANCE, Roots, feedback, find_roots, path_values
from models.solution import PROFILE_POINTS, Fields, failed, relative_change, solution

NAME = "flexible"
ORDERS = np.array([1, 1, 1])
DEGREES = (8, 12, 16, 24, 32, 64, 128)
PRECISION = 1e-11
"""Change of the ends between neighbouring degrees at which the refinement ends."""
SAME_ROOT = 1e-6
"""Relative difference of w below which collocation and quadrature mean the same solution."""


class Flexible(NamedTuple):
    """The problem of the flexible yarn."""

    scene: Values
    """`Dimensionless.vector`."""


def equations(problem: Flexible, f: Values, w: Any, out: Values) -> None:
    """Residuals of q', (ln p₃)' and τ'; f holds q, q', ln(p₃/p₃CD), its derivative, τ, τ'."""
    sine, cosine = 1 / np.cosh(f[0]), -np.tanh(f[0])
    cos_alpha, sin_alpha = friction_direction(problem.scene, sine, cosine, w)
    mu = problem.scene[FRICTION]
    out[0] = f[1] - mu * cos_alpha
    out[1] = f[3] - mu * sin_alpha * sine
    out[2] = f[5] + mu * cos_alpha * sine * problem.scene[YARN_RADIUS] * problem.scene[TENSION_CD] * np.exp(f[2])


def boundary(problem: Flexible, left: Values, right: Values, w: Any, out: Values) -> None:
    """Geometry of the spans, p₃(φ), T(φ) and the twist rotation."""
    ends = (1 / np.cosh(left[0]), -np.tanh(left[0]), 1 / np.cosh(right[0]), -np.tanh(right[0]))
    end_conditions(problem.scene, ends, left[2], right[2], w, out)
    out[1] = right[1]


register(Flexible, equations, boundary)


def solve_flexible(scene: Scene, *, rotation: float | None = None) -> Solution:
    """Solve the flexible yarn. Never raises for a hard scene: the outcome says what happened.

    Parameters
    ----------
    rotation : n₁ [1/s] near which a solution is wanted, for a scene with several; without it, the one that the yarn
        settles on while the friction is raised from zero.
    """
    problem = scene.dimensionless()
    result, degree, error, iterations = solve_fields(problem)
    resolved = error is not None and result.status is NewtonStatus.CONVERGED
    stats = Stats(iterations, result.residual, result.boundary_residual, result.step, degree + 1)
    if error is not None and resolved and feedback(problem.vector) < STRONG_FEEDBACK:
        return solution(scene, NAME, as_fields(problem, degree, result), error, stats)
    roots = find_roots(problem.vector)
    w = choose(scene, roots, rotation)
    if w is None:
        return failed(scene, NAME, Outcome.STICKING, Outcome.STICKING.value, stats=stats)
    if error is not None and resolved and abs(result.w - w) <= SAME_ROOT * (1 + abs(w)):
        fields = as_fields(problem, degree, result)
    else:
        fields, error = _on_path(problem, w)
    return solution(scene, NAME, fields, error, stats, others=several(scene, roots, w))


def choose(scene: Scene, roots: Roots, rotation: float | None = None) -> float | None:
    """The w of the solution to take: nearest to a wanted n₁ [1/s], else the one that the yarn settles on."""
    if not roots.w:
        return None
    if rotation is not None:
        wanted = rotation * scene.cylinder_radius / scene.delivery_speed
        return min(roots.w, key=lambda w: abs(w - wanted))
    return roots.settled if np.isfinite(roots.settled) else roots.w[0]


def several(scene: Scene, roots: Roots, taken: float) -> str:
    """The other solutions and how to get them; empty where there are none."""
    if len(roots.w) < 2:
        return ""
    unit = scene.delivery_speed / scene.cylinder_radius
    others = ", ".join(f"{w * unit:.6g}" for w in roots.w if w != taken)
    return f"n₁ = {taken * unit:.6g} /s; others at n₁ = {others} /s: solve with rotation= near one of them"


def _on_path(scene: Dimensionless, w: float) -> tuple[Fields, Array]:
    """The solution with a known w by quadrature, and its error as the change by a hundredfold tolerance."""
    psi = np.linspace(0.0, scene.wrap_angle, PROFILE_POINTS)
    q, log_p, tau = path_values(scene.vector, w, psi, TOLERANCE)
    coarse = path_values(scene.vector, w, psi[[0, -1]], 100 * TOLERANCE)
    sine, cosine = 1 / np.cosh(q), -np.tanh(q)
    slope = scene.friction * friction_direction(scene.vector, sine, cosine, w)[0] * sine
    theta, tension = 2 * np.arctan(np.exp(q)), scene.tension_CD * np.exp(log_p)
    at_B = np.array([q[0], log_p[0], tau[0]])
    error = ends(scene.tension_CD, at_B) - ends(scene.tension_CD, coarse[:, 0])
    return Fields(scene, psi, theta, slope, tension, tau, w, tension * sine**2), error


def solve_fields(scene: Dimensionless) -> tuple[BoundaryValueResult, int, Array | None, int]:
    """Refine until the ends stop changing.

    Returns
    -------
    tuple
        The last result, its degree, the last change of p₃AB, T_AB and θ_B, shape (3,) (None if they still change or
        Newton failed), and all iterations.
    """
    iterations, degree, previous = 0, 0, None
    result: BoundaryValueResult | None = None
    for degree in DEGREES:
        discretisation = chebyshev_collocation(degree, scene.wrap_angle)
        if result is None:
            fields, w = _start(scene, discretisation)
        else:
            fields, w = result.fields @ interpolation(result.fields.shape[1] - 1, degree).T, result.w
        result = solve(Flexible(scene.vector), ORDERS, discretisation, fields, w)
        iterations += result.iterations
        if result.status is not NewtonStatus.CONVERGED:
            result = _from_frictionless(scene, discretisation)
            iterations += result.iterations
            if result.status is not NewtonStatus.CONVERGED:
                return result, degree, None, iterations
        found = ends(scene.tension_CD, result.fields[:, 0])
        if previous is not None and relative_change(found, previous) < PRECISION:
            return result, degree, found - previous, iterations
        previous = found
    assert result is not None
    return result, degree, None, iterations


def start_values(scene: Dimensionless, result: BoundaryValueResult, degree: int) -> Array:
    """θ, p₃/p₃CD and τ at the Chebyshev nodes of another degree, shape (3, degree + 1), to start a rod model from."""
    q, log_p, tau = result.fields @ interpolation(result.fields.shape[1] - 1, degree).T
    return np.array([2 * np.arctan(np.exp(q)), np.exp(log_p), tau])


def as_fields(scene: Dimensionless, degree: int, result: BoundaryValueResult) -> Fields:
    """Change the solved variables back to θ, p₃, τ on an even grid."""
    psi = np.linspace(0.0, scene.wrap_angle, PROFILE_POINTS)
    q, log_p, tau = result.fields @ interpolation(degree, PROFILE_POINTS - 1, even=True).T
    theta = 2 * np.arctan(np.exp(q))
    sine = np.sin(theta)
    slope_q = chebyshev_collocation(degree, scene.wrap_angle).nodal_derivatives[1] @ result.fields[0]
    slope = interpolation(degree, PROFILE_POINTS - 1, even=True) @ slope_q * sine
    tension = scene.tension_CD * np.exp(log_p)
    return Fields(scene, psi, theta, slope, tension, tau, result.w, tension * sine**2)


def ends(tension_CD: Any, at_B: Values) -> Values:
    """p₃AB, T_AB and θ_B, dimensionless, shape (3,), from q, ln(p₃/p₃CD) and τ at B; analytic."""
    q, log_p, tau = at_B
    twist = (tau + np.tanh(q) / np.cosh(q)) / (2 * np.pi)
    return np.array([tension_CD * np.exp(log_p), twist, 2 * np.arctan(np.exp(q))])


def _start(scene: Dimensionless, discretisation: Discretisation) -> tuple[Array, float]:
    """The frictionless yarn: a circle at constant tension and twist."""
    fields = np.zeros((3, discretisation.nodes.size))
    fields[2] = 2 * np.pi * scene.twist_CD
    return fields, scene.twist_rotation(scene.twist_CD)


def _from_frictionless(scene: Dimensionless, discretisation: Discretisation) -> BoundaryValueResult:
    """Continue in friction from 0, where the solution is known, halving the step where Newton fails."""
    fields, w = _start(scene, discretisation)
    reached, step = 0.0, 0.25
    while True:
        part = min(1.0, reached + step)
        vector = replace(scene, friction=part * scene.friction).vector
        result = solve(Flexible(vector), ORDERS, discretisation, fields, w)
        if result.status is NewtonStatus.CONVERGED:
            if part == 1.0:
                return result
            fields, w, reached, step = result.fields, result.w, part, 2 * step
        else:
            step /= 2
            if step < 1e-3:
                return result
