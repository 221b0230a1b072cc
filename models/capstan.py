"""The flexible yarn with a constant friction direction: closed forms, and with them the cheapest model.

    cosθ = −tanh(μ cosα (ψ − ψ₀)),   p₃ = p₃C exp(−tanα (θ_C − θ)),   τ = τ_C + R₀ cotα (p₃C − p₃)

and for cosα = 0 the capstan equation p₃ = p₃C exp(−μ sinα sinθ (φ − ψ)), θ and τ constant (Euler–Eytelwein; with
twist: the flexible yarn's equations integrated for constant α). Dimensionless: lengths in r₀, forces in K/r₀².

As a model, α is that of a yarn square to the cylinder axis (θ = 90°), tanα = v / (v_b + 2πR₀(n₁ − n₀)), and only n₁
is searched for. Exact where the cylinder is at rest (v_b = 0), where α does not depend on θ. Limits otherwise: those of
the flexible yarn, and an error that grows with v_b/v and with the change of θ along the wrap.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, inner
from models.complex_step import COMPLEX_STEP
from models.friction import friction_direction
from models.newton import CONVERGED, MAX_ITERATIONS_REACHED
from models.outcome import Solution
from models.refinement import NEWTON_FAILED, SETTLED, Refined, record
from models.scene import (
    CYLINDER_SPEED,
    FRICTION,
    SPAN_RATIO,
    TENSION_CD,
    TWIST_CD,
    TWIST_CONGESTION,
    TWIST_TRAPPING,
    WRAP_ANGLE,
    YARN_RADIUS,
    Dimensionless,
    Scene,
)
from models.solution import PROFILE_POINTS, Fields, solution

Array = NDArray[np.float64]
Values = NDArray[Any]

NAME = "capstan"
ALONG = 1e-9
"""|cosα| below which friction counts as along the yarn."""
PRECISION = 1e-13
"""Newton's correction of n₁/v, relative to 1 + |n₁/v|, at which the search ends."""
MAX_ITERATIONS = 50


@dataclass(frozen=True, slots=True)
class ConstantFriction:
    """A yarn with end values at C (ψ = wrap_angle) under friction of constant direction alpha [rad]."""

    wrap_angle: float
    friction: float
    alpha: float
    yarn_radius: float
    theta_C: float
    tension_C: float
    tau_C: float

    def theta(self, psi: Array) -> Array:
        """θ(ψ) [rad], same shape as psi."""
        # cosθ = −tanh q with q = ln tan(θ/2), and q' = μ cosα.
        q = np.log(np.tan(self.theta_C / 2)) - self.friction * np.cos(self.alpha) * (self.wrap_angle - psi)
        return 2 * np.arctan(np.exp(q))

    def tension(self, psi: Array) -> Array:
        """p₃(ψ) in units of K/r₀²."""
        if abs(np.cos(self.alpha)) < ALONG:
            pull = self.friction * np.sin(self.alpha) * np.sin(self.theta_C)
            return self.tension_C * np.exp(-pull * (self.wrap_angle - psi))
        return self.tension_C * np.exp(-np.tan(self.alpha) * (self.theta_C - self.theta(psi)))

    def tau(self, psi: Array) -> Array:
        """τ(ψ), material twist of the yarn in 1/r₀."""
        cosine, sine = np.cos(self.alpha), np.sin(self.alpha)
        if abs(sine) < 1e-12:  # tension constant: τ' = −μ cosα sinθ R₀ p₃ integrates to −R₀ p₃ (θ − θ_C)
            return self.tau_C + self.yarn_radius * self.tension_C * (self.theta_C - self.theta(psi))
        return self.tau_C + self.yarn_radius * cosine / sine * (self.tension_C - self.tension(psi))


@inner
def closed_form(scene: Values, w: Any) -> tuple[Any, Any, Any, Any]:
    """θ and τ at B, ln(p₃B/p₃CD) and θ at C, for a trial n₁/v; analytic."""
    cos_alpha, sin_alpha = friction_direction(scene, 1.0, 0.0, w)
    # With x = cosθ_C and t = tanh(μ cosα φ), the spans' geometry is a quadratic: t x² + (1 + l) x + l t = 0 for
    # l = l_AB/l_CD, since cosθ_B = (x + t)/(1 + x t) by the law for q = ln tan(θ/2).
    turn = scene[FRICTION] * cos_alpha * scene[WRAP_ANGLE]
    t, ratio = np.tanh(turn), scene[SPAN_RATIO]
    cosine = -2 * ratio * t / ((1 + ratio) + np.sqrt((1 + ratio) ** 2 - 4 * ratio * t * t))
    sine = np.sqrt(1 - cosine * cosine)
    tangent_C = sine / (1 + cosine)  # tan(θ_C/2)
    theta_C = 2 * np.arctan(tangent_C)
    theta_B = 2 * np.arctan(tangent_C * np.exp(-turn))
    tau_C = 2 * np.pi * scene[TWIST_CD] + sine * cosine
    if abs(cos_alpha) < ALONG:
        log_p = -scene[FRICTION] * sin_alpha * sine * scene[WRAP_ANGLE]
    else:
        log_p = -sin_alpha / cos_alpha * (theta_C - theta_B)
    # τ_B = τ_C + R₀ p₃CD cotα (1 − p₃B/p₃CD), which sinα = 0 takes to R₀ p₃CD (θ_C − θ_B).
    drop = theta_C - theta_B if abs(sin_alpha) < ALONG else cos_alpha / sin_alpha * (1 - np.exp(log_p))
    tau_B = tau_C + scene[YARN_RADIUS] * scene[TENSION_CD] * drop
    return theta_B, tau_B, log_p, theta_C


@inner
def mismatch(scene: Values, w: Any) -> Any:
    """How far a trial n₁/v is from η (T_AB − k T_CD)."""
    theta_B, tau_B, _, _ = closed_form(scene, w)
    twist_AB = (tau_B - np.sin(theta_B) * np.cos(theta_B)) / (2 * np.pi)
    return w - scene[TWIST_CONGESTION] * (twist_AB - scene[TWIST_TRAPPING] * scene[TWIST_CD])


@inner
def search(scene: Array) -> Refined:
    """Newton's method for n₁/v."""
    w = scene[TWIST_CONGESTION] * (1 - scene[TWIST_TRAPPING]) * scene[TWIST_CD]
    status, step, iterations, value = MAX_ITERATIONS_REACHED, np.inf, 0, np.nan
    while iterations < MAX_ITERATIONS and status != CONVERGED:
        moved = mismatch(scene, w + 1j * COMPLEX_STEP)
        step = -moved.real / (moved.imag / COMPLEX_STEP)
        w += step
        iterations += 1
        value = mismatch(scene, w)
        if abs(step) <= PRECISION * (1 + abs(w)):
            status = CONVERGED
        elif not np.isfinite(step):
            break
    theta_B, tau_B, log_p, theta_C = closed_form(scene, w)
    tension = scene[TENSION_CD] * np.exp(log_p)
    at_B = np.array([tension, (tau_B - np.sin(theta_B) * np.cos(theta_B)) / (2 * np.pi), theta_B])
    normal_B, normal_C = tension * np.sin(theta_B) ** 2, scene[TENSION_CD] * np.sin(theta_C) ** 2
    return Refined(
        SETTLED if status == CONVERGED else NEWTON_FAILED, status, 0, np.empty((3, 0)), w, at_B,
        np.finfo(np.float64).eps * at_B, np.finfo(np.float64).eps, theta_C, min(normal_B, normal_C),
        0.0 if normal_B < normal_C else scene[WRAP_ANGLE], iterations, step, 0.0, abs(value), np.nan,
    )  # fmt: skip


@compiled
def find(scene: Array) -> Refined:
    """Solve one scene, `Dimensionless.vector`."""
    return search(scene)


@compiled
def find_rows(scenes: Array, table: Any) -> None:
    """Solve many scenes, `Dimensionless.vector` in each row, into a table of type ROW."""
    for i in range(scenes.shape[0]):
        record(search(scenes[i]), table[i])


def direction_error(scene: Array, found: Refined) -> Array:
    """Estimated relative error of p₃AB, T_AB and θ_B by the constant friction direction, shape (3,).

    Over the wrap φ, cosα and sinα differ by up to Δc and Δs from those at θ = 90°. Then q' = μ cosα is off by μΔc and
    (ln p₃)' = μ sinα sinθ by μ(Δs + Δc), and −τ' = μ cosα sinθ R₀p₃ by both. Meant for weak feedback of the twist on
    itself: what n₁ passes on to α is not counted.
    """
    theta_B = float(found.ends[2])
    square = np.array(_friction_direction(scene, np.pi / 2, found.w))
    change = np.max([np.abs(_friction_direction(scene, t, found.w) - square) for t in (theta_B, found.theta_C)], axis=0)
    reach = scene[FRICTION] * scene[WRAP_ANGLE]
    angle, log_tension = reach * change[0], reach * (change[0] + change[1])
    turned = scene[FRICTION] * abs(square[0]) * scene[WRAP_ANGLE] * scene[YARN_RADIUS] * scene[TENSION_CD]
    twist = (turned * log_tension + scene[YARN_RADIUS] * scene[TENSION_CD] * angle + angle) / (2 * np.pi)
    return np.array([log_tension, twist / max(abs(found.ends[1]), 1 / (2 * np.pi)), angle / theta_B])


def _friction_direction(scene: Array, theta: float, w: float) -> Array:
    across = scene[CYLINDER_SPEED] * np.sin(theta) + 2 * np.pi * scene[YARN_RADIUS] * (w - scene[TWIST_CD])
    along = scene[CYLINDER_SPEED] * np.cos(theta) + 1
    return np.array([across, along]) / np.hypot(across, along)


def solve_rows(scenes: Array, table: Any) -> None:
    """Solve many scenes, `Dimensionless.vector` in each row, into a table of type ROW."""
    find_rows(scenes, table)


def solve_capstan(scene: Scene, *, profile: bool = True) -> Solution:
    """Solve by the closed forms; without `profile` the numbers only. The outcome says what happened."""
    problem = scene.dimensionless()
    found = find(problem.vector)
    return solution(scene, NAME, found, (lambda: _fields(problem, found)) if profile else None)


def _fields(scene: Dimensionless, found: Refined) -> Fields:
    across = scene.cylinder_speed + 2 * np.pi * scene.yarn_radius * (found.w - scene.twist_CD)
    form = ConstantFriction(
        wrap_angle=scene.wrap_angle,
        friction=scene.friction,
        alpha=float(np.arctan2(1.0, across)),
        yarn_radius=scene.yarn_radius,
        theta_C=found.theta_C,
        tension_C=scene.tension_CD,
        tau_C=2 * np.pi * scene.twist_CD + float(np.sin(found.theta_C) * np.cos(found.theta_C)),
    )
    psi = np.linspace(0.0, scene.wrap_angle, PROFILE_POINTS)
    theta, tension = form.theta(psi), form.tension(psi)
    slope = scene.friction * np.cos(form.alpha) * np.sin(theta)
    return Fields(scene, psi, theta, slope, tension, form.tau(psi), tension * np.sin(theta) ** 2)
