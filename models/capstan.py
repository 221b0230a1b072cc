"""Closed forms of the flexible yarn for a constant friction direction α: the exact check of every solver.

    cosθ = −tanh(μ cosα (ψ − ψ₀)),   p₃ = p₃C exp(−tanα (θ_C − θ)),   τ = τ_C + R₀ cotα (p₃C − p₃)

and for cosα = 0 the capstan equation p₃ = p₃C exp(−μ sinα sinθ (φ − ψ)), θ and τ constant. α is constant where the
cylinder is at rest (v_b = 0). Euler–Eytelwein; with twist: physics of the flexible baseline. Dimensionless.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
        if abs(np.cos(self.alpha)) < 1e-12:
            pull = self.friction * np.sin(self.alpha) * np.sin(self.theta_C)
            return self.tension_C * np.exp(-pull * (self.wrap_angle - psi))
        return self.tension_C * np.exp(-np.tan(self.alpha) * (self.theta_C - self.theta(psi)))

    def tau(self, psi: Array) -> Array:
        """τ(ψ), material twist of the yarn in 1/r₀."""
        cosine, sine = np.cos(self.alpha), np.sin(self.alpha)
        if abs(sine) < 1e-12:  # tension constant: τ' = −μ cosα sinθ R₀ p₃ integrates to −R₀ p₃ (θ − θ_C)
            return self.tau_C + self.yarn_radius * self.tension_C * (self.theta_C - self.theta(psi))
        return self.tau_C + self.yarn_radius * cosine / sine * (self.tension_C - self.tension(psi))
