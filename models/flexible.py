"""Flexible yarn on the moving cylinder: tension and twist, no bending (Feng et al. 2012; paper's baseline).

    θ' = μ cosα sinθ        p₃' = μ sinα sinθ p₃        τ' = −μ cosα sinθ R₀ p₃        N = p₃ sin²θ

with ' = d/dψ, lengths in r₀, forces in K/r₀². Solved for q = ln tan(θ/2), so that q' = μ cosα, sinθ = 1/cosh q and
cosθ = −tanh q, and for ln p₃: both stay in their domain whatever Newton tries. Boundary conditions: p₃(φ) = p₃CD,
T(φ) = T_CD, l_AB cosθ(0) + l_CD cosθ(φ) = 0, n₁ = η v (T_AB − k T_CD).

Limits: no bending or torsional stiffness in the force balance, inextensible, weightless, steady, contact everywhere.
Chebyshev collocation is refined until the ends stop changing, near machine precision.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.boundary_value import Array, BoundaryValueResult, Values, solve
from models.discretisation import Discretisation, chebyshev_collocation, chebyshev_values
from models.friction import friction_direction
from models.newton import NewtonStatus
from models.outcome import Outcome, Solution, Stats
from models.scene import Dimensionless, Scene
from models.solution import PROFILE_POINTS, Fields, failed, solution

NAME = "flexible"
DEGREES = (16, 32, 64, 128)
PRECISION = 1e-11


@dataclass(frozen=True, slots=True)
class FlexibleProblem:
    """Fields q, ln(p₃/p₃CD) and τ as a pointwise boundary-value problem."""

    scene: Dimensionless
    orders: tuple[int, ...] = (1, 1, 1)

    def equations(self, fields: Sequence[Sequence[Values]], w: Values) -> Sequence[Values]:
        """Residuals of q', (ln p₃)' and τ'."""
        (q, dq), (log_p, dlog_p), (_, dtau) = fields
        sine, cosine = 1 / np.cosh(q), -np.tanh(q)
        cos_alpha, sin_alpha = friction_direction(self.scene, sine, cosine, w)
        mu, pull = self.scene.friction, self.scene.yarn_radius * self.scene.tension_CD
        return (
            dq - mu * cos_alpha,
            dlog_p - mu * sin_alpha * sine,
            dtau + mu * cos_alpha * sine * pull * np.exp(log_p),
        )

    def boundary(self, left: Sequence[Values], right: Sequence[Values], w: Values) -> Sequence[Values]:
        """Geometry of the spans, p₃(φ), T(φ) and the twist rotation."""
        (q_B, _, tau_B), (q_C, log_p_C, tau_C) = left, right
        scene = self.scene
        twist_AB = (tau_B + np.tanh(q_B) / np.cosh(q_B)) / (2 * np.pi)
        return (
            -scene.span_ratio * np.tanh(q_B) - np.tanh(q_C),
            log_p_C,
            tau_C + np.tanh(q_C) / np.cosh(q_C) - 2 * np.pi * scene.twist_CD,
            w - scene.twist_congestion * (twist_AB - scene.twist_trapping * scene.twist_CD),
        )


def solve_flexible(scene: Scene) -> Solution:
    """Solve the flexible yarn. Never raises for a hard scene: the outcome says what happened."""
    problem = scene.dimensionless()
    previous: Fields | None = None
    iterations = 0
    result: BoundaryValueResult | None = None
    for degree in DEGREES:
        discretisation = chebyshev_collocation(degree, problem.wrap_angle)
        start, w = _start(problem, discretisation) if result is None else _refined(problem, discretisation, result)
        result = solve(FlexibleProblem(problem), discretisation, start, w)
        iterations += result.newton.iterations
        if result.newton.status is not NewtonStatus.CONVERGED:
            result = _from_frictionless(problem, discretisation)
            iterations += result.newton.iterations
            if result.newton.status is not NewtonStatus.CONVERGED:
                outcome = Outcome.SINGULAR if result.newton.status is NewtonStatus.SINGULAR else Outcome.NOT_CONVERGED
                return failed(scene, NAME, outcome, f"{outcome.value} ({result.newton.status.value})")
        fields = as_fields(problem, result)
        stats = Stats(
            iterations, result.residual, result.boundary_residual, result.newton.step, degree + 1,
            result.condition,
        )  # fmt: skip
        if previous is not None and fields.end_difference(previous) < PRECISION:
            return solution(scene, NAME, fields, fields.ends - previous.ends, stats)
        previous = fields
    return failed(
        scene, NAME, Outcome.NOT_CONVERGED,
        f"the solution is not resolved by {DEGREES[-1]} nodes",
    )  # fmt: skip


def as_fields(scene: Dimensionless, result: BoundaryValueResult) -> Fields:
    """Change the solved variables back to θ, p₃, τ on an even grid."""
    psi = np.linspace(0.0, scene.wrap_angle, PROFILE_POINTS)
    q, log_p, tau = (chebyshev_values(f, psi, scene.wrap_angle) for f in result.fields)
    theta = 2 * np.arctan(np.exp(q))
    sine = np.sin(theta)
    cos_alpha, _ = friction_direction(scene, sine, np.cos(theta), np.array(result.w))
    tension = scene.tension_CD * np.exp(log_p)
    slope = scene.friction * cos_alpha * sine
    return Fields(scene, psi, theta, slope, tension, tau, result.w, tension * sine**2)


def _start(scene: Dimensionless, discretisation: Discretisation) -> tuple[Array, float]:
    """The frictionless yarn: a circle at constant tension and twist."""
    fields = np.zeros((3, discretisation.nodes.size))
    fields[2] = 2 * np.pi * scene.twist_CD
    return fields, scene.twist_rotation(scene.twist_CD)


def _refined(scene: Dimensionless, discretisation: Discretisation, coarse: BoundaryValueResult) -> tuple[Array, float]:
    """The coarser solution at the finer nodes."""
    fields = [chebyshev_values(f, discretisation.nodes, scene.wrap_angle) for f in coarse.fields]
    return np.array(fields), coarse.w


def _from_frictionless(scene: Dimensionless, discretisation: Discretisation) -> BoundaryValueResult:
    """Continue in friction from 0, where the solution is known, halving the step where Newton fails."""
    fields, w = _start(scene, discretisation)
    reached, step = 0.0, 0.25
    while True:
        part = min(1.0, reached + step)
        problem = FlexibleProblem(replace(scene, friction=part * scene.friction))
        result = solve(problem, discretisation, fields, w)
        if result.newton.status is NewtonStatus.CONVERGED:
            if part == 1.0:
                return result
            fields, w, reached, step = result.fields, result.w, part, 2 * step
        else:
            step /= 2
            if step < 1e-3:
                return result
