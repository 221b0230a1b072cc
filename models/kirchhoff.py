"""The frame-consistent Kirchhoff rod on the moving cylinder, in the surface (Darboux) frame (t, e_v, e_r).

An isotropic rod's shear follows from its centreline and its material twist u₃ = τ kept apart. Dimensionless with
K = 1, subscript s = d/ds = sinθ d/dψ, P = p₃:

    V = B θ_ss − B sin³θ cosθ + u₃ sin²θ            Q = 3B θ_s sinθ cosθ − u₃ θ_s
    P_s + V θ_s + Q sin²θ − μN sinα = 0
    −P θ_s + V_s − Q sinθ cosθ + μN cosα = 0
    −P sin²θ + V sinθ cosθ + Q_s + N = 0
    u₃,s + μN cosα R₀ = 0                            u₃ = 2πT + sinθ cosθ

No square roots, regular at θ' = 0, and p₃ → ∞ recovers the flexible yarn. Closed on the slow manifold, as the printed
model is, so that the two differ by their equations only. Source: derived for this project from the balance of force
and moment on the cylinder; it corrects the printed model, which uses τ as the Frenet torsion of the centreline.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.boundary_value import Array, Values
from models.cosserat import CosseratProblem
from models.friction import friction_direction
from models.outcome import Solution
from models.scene import Dimensionless, Scene
from models.slow_manifold import solve_slow_manifold

NAME = "kirchhoff"


@dataclass(frozen=True, slots=True)
class KirchhoffProblem:
    """Fields θ, p₃/p₃CD and u₃ as a pointwise boundary-value problem; n₁ is the constant w = n₁/v."""

    scene: Dimensionless
    orders: tuple[int, ...] = (3, 1, 1)

    def equations(self, fields: Sequence[Sequence[Values]], w: Values) -> Sequence[Values]:
        """Residuals along e_v and t, in units of p₃CD, and of the twisting moment."""
        theta_s, P, sine, cosine, V, V_s, Q, normal = self._balance(fields)
        mu = self.scene.friction
        cos_alpha, sin_alpha = friction_direction(self.scene, sine, cosine, w)
        return (
            -P * theta_s + V_s - Q * sine * cosine + mu * normal * cos_alpha,
            sine * fields[1][1] + V * theta_s + Q * sine**2 - mu * normal * sin_alpha,
            sine * fields[2][1] + mu * normal * cos_alpha * self.scene.yarn_radius * self.scene.tension_CD,
        )

    def _balance(self, fields: Sequence[Sequence[Values]]) -> tuple[Values, ...]:
        """θ_s, P, sinθ, cosθ, then V, V_s, Q and N in units of p₃CD."""
        (theta, d1, d2, d3), (P, _), (u3, du3) = fields
        B, unit = self.scene.bending_rigidity, 1 / self.scene.tension_CD
        sine, cosine = np.sin(theta), np.cos(theta)
        # d/ds = sinθ d/dψ, applied three times.
        theta_s = sine * d1
        theta_ss = sine * (sine * d2 + cosine * d1**2)
        theta_sss = sine * (sine**2 * d3 + 4 * sine * cosine * d1 * d2 + (cosine**2 - sine**2) * d1**3)
        u3_s = sine * du3
        V = unit * (B * theta_ss - B * sine**3 * cosine + u3 * sine**2)
        V_s = unit * (
            B * theta_sss
            - B * (3 * sine**2 * cosine**2 - sine**4) * theta_s
            + u3_s * sine**2
            + 2 * u3 * sine * cosine * theta_s
        )
        Q = unit * (3 * B * sine * cosine - u3) * theta_s
        Q_s = unit * (
            (3 * B * (cosine**2 - sine**2) * theta_s - u3_s) * theta_s + (3 * B * sine * cosine - u3) * theta_ss
        )
        normal = P * sine**2 - V * sine * cosine - Q_s
        return theta_s, P, sine, cosine, V, V_s, Q, normal

    def normal_force(self, fields: Sequence[Sequence[Array]], w: float) -> Array:
        """N in K/r₀³, same shape as the fields."""
        return self._balance(fields)[-1] * self.scene.tension_CD

    def boundary(self, left: Sequence[Values], right: Sequence[Values], w: Values) -> Sequence[Values]:
        """The same four conditions as for the printed model."""
        return CosseratProblem(self.scene).boundary(left, right, w)


def solve_kirchhoff(scene: Scene) -> Solution:
    """Solve the consistent rod on its slow manifold, n₁ inside the one Newton system."""
    return solve_slow_manifold(scene, NAME, KirchhoffProblem(scene.dimensionless()))
