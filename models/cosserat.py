"""The Cosserat rod on the moving cylinder, as printed (Yin, Tao, Jasper, Cellulose 2020, Eqs 10–19).

Dimensionless (lengths r₀, forces K/r₀², K = 1, B = B/K), ' = d/dψ, ds = dψ/sinθ:

    κ = sinθ S,  S = √(θ'² + sin²θ)             τ = 2πT + sinθ cosθ
    p₁ = −B sinθ κ'                              p₂ = −(B − 1) κ τ
    a = sin²θ/κ,  b = sinθ θ'/κ                  X = sinθ p₁' − p₂ τ + p₃ κ,  Y = sinθ p₂' + p₁ τ
    N = aX + bY
    (E1)  −bX + aY + μN cosα = 0
    (E2)  sinθ p₃' − κ p₁ − μN sinα = 0
    (E3)  sinθ τ' + μN cosα R₀ = 0

E1 holds θ''' with a small factor, of order B θ'²/p₃, and θ'' with one of order B τ θ'/p₃: fast modes, for which
the four boundary conditions are too few. What the printed problem means is its slow manifold (slow_manifold.py).

Limits: the material twist τ stands where the Frenet torsion belongs (the term −p₂τ acts as extra tension), so B → 0
does not give back the flexible yarn. Steady, inextensible, weightless, contact everywhere (N > 0, checked).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.boundary_value import Array, Values
from models.friction import friction_direction
from models.outcome import Solution
from models.scene import Dimensionless, Scene
from models.slow_manifold import solve_slow_manifold

NAME = "cosserat"


@dataclass(frozen=True, slots=True)
class CosseratProblem:
    """Fields θ, p₃/p₃CD and τ as a pointwise boundary-value problem; n₁ is the constant w = n₁/v."""

    scene: Dimensionless
    orders: tuple[int, ...] = (3, 1, 1)

    def equations(self, fields: Sequence[Sequence[Values]], w: Values) -> Sequence[Values]:
        """Residuals of E1 and E2, in units of p₃CD, and of E3."""
        _, dp, dtau = (f[1] for f in fields)
        sine = np.sin(fields[0][0])
        e1, normal, p1, kappa, cos_alpha, sin_alpha = self.balance(fields, w)
        mu = self.scene.friction
        return (
            e1,
            sine * dp - kappa * p1 - mu * normal * sin_alpha,
            sine * dtau + mu * normal * cos_alpha * self.scene.yarn_radius * self.scene.tension_CD,
        )

    def balance(self, fields: Sequence[Sequence[Values]], w: Values) -> tuple[Values, ...]:
        """E1, N and p₁ in units of p₃CD, then κ, cosα, sinα."""
        (theta, d1, d2, d3), (p, _), (tau, dtau) = fields
        B, unit = self.scene.bending_rigidity, 1 / self.scene.tension_CD
        sine, cosine = np.sin(theta), np.cos(theta)
        # S S' = R and κ = sinθ S give κ' = θ' G / S with G = θ'' sinθ + θ'² cosθ + 2 sin²θ cosθ.
        S = np.sqrt(d1 * d1 + sine * sine)
        R = d1 * (d2 + sine * cosine)
        G = d2 * sine + d1 * d1 * cosine + 2 * sine * sine * cosine
        dG = d3 * sine + 3 * d1 * d2 * cosine - d1**3 * sine + d1 * (4 * sine * cosine**2 - 2 * sine**3)
        kappa = sine * S
        dkappa = d1 * G / S
        ddkappa = (d2 * G + d1 * dG) / S - d1 * G * R / S**3
        p1 = -unit * B * sine * dkappa
        dp1 = -unit * B * (sine * ddkappa + cosine * d1 * dkappa)
        p2 = -unit * (B - 1) * kappa * tau
        dp2 = -unit * (B - 1) * (dkappa * tau + kappa * dtau)
        a, b = sine / S, d1 / S
        X = sine * dp1 - p2 * tau + p * kappa
        Y = sine * dp2 + p1 * tau
        normal = a * X + b * Y
        cos_alpha, sin_alpha = friction_direction(self.scene, sine, cosine, w)
        return -b * X + a * Y + self.scene.friction * normal * cos_alpha, normal, p1, kappa, cos_alpha, sin_alpha

    def normal_force(self, fields: Sequence[Sequence[Array]], w: float) -> Array:
        """N in K/r₀³, same shape as the fields."""
        return self.balance(fields, np.array(w))[1] * self.scene.tension_CD

    def boundary(self, left: Sequence[Values], right: Sequence[Values], w: Values) -> Sequence[Values]:
        """Geometry of the spans, p₃(φ), T(φ) and the twist rotation (Eq. 19)."""
        (theta_B, _, tau_B), (theta_C, p_C, tau_C) = left, right
        scene = self.scene
        twist_AB = (tau_B - np.sin(theta_B) * np.cos(theta_B)) / (2 * np.pi)
        return (
            scene.span_ratio * np.cos(theta_B) + np.cos(theta_C),
            p_C - 1,
            tau_C - np.sin(theta_C) * np.cos(theta_C) - 2 * np.pi * scene.twist_CD,
            w - scene.twist_congestion * (twist_AB - scene.twist_trapping * scene.twist_CD),
        )


def solve_cosserat(scene: Scene) -> Solution:
    """Solve the printed equations on their slow manifold, n₁ inside the one Newton system."""
    return solve_slow_manifold(scene, NAME, CosseratProblem(scene.dimensionless()))
