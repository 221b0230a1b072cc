"""The flexible yarn with a constant friction direction: closed forms, and with them the cheapest model.

    cosθ = −tanh(μ cosα (ψ − ψ₀)),   p₃ = p₃C exp(−tanα (θ_C − θ)),   τ = τ_C + R₀ cotα (p₃C − p₃)

and for cosα = 0 the capstan equation p₃ = p₃C exp(−μ sinα sinθ (φ − ψ)), θ and τ constant (Euler–Eytelwein; with
twist: the flexible yarn's equations integrated for constant α). Dimensionless: lengths in r₀, forces in K/r₀².

As a model, α is that of a yarn square to the cylinder axis (θ = 90°), tanα = v / (v_b + 2πR₀(n₁ − n₀)), and only n₁
is searched for. Exact where the cylinder is at rest (v_b = 0), where α does not depend on θ. Limits otherwise: those of
the flexible yarn, and an error that grows with v_b/v and with the change of θ along the wrap.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root_scalar

from models.outcome import Outcome, Solution, Stats
from models.scene import Dimensionless, Scene
from models.solution import PROFILE_POINTS, Fields, failed, solution

Array = NDArray[np.float64]

NAME = "capstan"
ALONG = 1e-9
"""|cosα| below which friction counts as along the yarn."""


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


def solve_capstan(scene: Scene) -> Solution:
    """Solve by the closed forms. The outcome says what happened."""
    problem = scene.dimensionless()

    def mismatch(w: float) -> float:
        return w - problem.twist_rotation(_twist_AB(_closed_form(problem, w)))

    start = problem.twist_rotation(problem.twist_CD)
    with np.errstate(all="ignore"):  # a secant may leave the domain; it is then not converged
        found = root_scalar(mismatch, x0=start, x1=start + 1e-3, method="secant", xtol=1e-13, rtol=1e-13, maxiter=100)
    residual = abs(mismatch(found.root)) if math.isfinite(found.root) else math.nan
    if not (found.converged and residual <= 1e-9 * (1 + abs(found.root))):
        text = f"{Outcome.NOT_CONVERGED.value} (n₁ was not found in {found.iterations} secant steps)"
        return failed(scene, NAME, Outcome.NOT_CONVERGED, text)
    w = float(found.root)
    form = _closed_form(problem, w)
    psi = np.linspace(0.0, problem.wrap_angle, PROFILE_POINTS)
    theta, tension = form.theta(psi), form.tension(psi)
    slope = problem.friction * np.cos(form.alpha) * np.sin(theta)
    fields = Fields(problem, psi, theta, slope, tension, form.tau(psi), w, tension * np.sin(theta) ** 2)
    stats = Stats(iterations=int(found.iterations), residual=0.0, boundary_residual=residual)
    return solution(scene, NAME, fields, np.abs(fields.ends) * np.finfo(float).eps, stats)


def _closed_form(scene: Dimensionless, w: float) -> ConstantFriction:
    """The closed form for a trial n₁/v."""
    across = scene.cylinder_speed + 2 * math.pi * scene.yarn_radius * (w - scene.twist_CD)
    alpha = math.atan2(1.0, across)
    # With x = cosθ_C and t = tanh(μ cosα φ), the spans' geometry is a quadratic: t x² + (1 + l) x + l t = 0 for
    # l = l_AB/l_CD, since cosθ_B = (x + t)/(1 + x t) by the law for q = ln tan(θ/2).
    t, ratio = math.tanh(scene.friction * math.cos(alpha) * scene.wrap_angle), scene.span_ratio
    cosine = -2 * ratio * t / ((1 + ratio) + math.sqrt((1 + ratio) ** 2 - 4 * ratio * t * t))
    theta_C = math.acos(cosine)
    return ConstantFriction(
        wrap_angle=scene.wrap_angle,
        friction=scene.friction,
        alpha=alpha,
        yarn_radius=scene.yarn_radius,
        theta_C=theta_C,
        tension_C=scene.tension_CD,
        tau_C=2 * math.pi * scene.twist_CD + math.sin(theta_C) * cosine,
    )


def _twist_AB(form: ConstantFriction) -> float:
    at_B = np.zeros(1)
    theta = float(form.theta(at_B)[0])
    return (float(form.tau(at_B)[0]) - math.sin(theta) * math.cos(theta)) / (2 * math.pi)
