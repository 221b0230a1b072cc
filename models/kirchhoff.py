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

from typing import Any, NamedTuple

import numpy as np

from models.boundary_value import Array, Values, register
from models.compiled import implement, merged
from models.complex_step import reciprocal, sine_cosine
from models.cosserat import boundary
from models.diagnosis import solve_rod
from models.flexible import integration_matrices
from models.friction import friction_direction
from models.outcome import Solution
from models.scene import BENDING_RIGIDITY, FRICTION, TENSION_CD, YARN_RADIUS, Scene
from models.slow_manifold import ORDERS, Rod, collocation_matrices, find_rows, normal_force

NAME = "kirchhoff"


class Consistent(NamedTuple):
    """The problem of the consistent rod."""

    scene: Values
    """`Dimensionless.vector`."""


@merged
def balance_by_arc(
    scene: Values, sine: Any, cosine: Any, theta: tuple[Any, ...], tension: tuple[Any, ...], twist: tuple[Any, ...]
) -> tuple[Any, Any, Any]:
    """Force along t and along e_v without friction, and N, in units of p₃CD.

    Parameters
    ----------
    theta : θ_s, θ_ss and θ_sss.
    tension, twist : P and u₃, each with its derivative by s.
    """
    B, unit = scene[BENDING_RIGIDITY], 1 / scene[TENSION_CD]
    theta_s, theta_ss, theta_sss = theta
    P, P_s = tension
    u3, u3_s = twist
    V = unit * (B * theta_ss - B * sine * sine * sine * cosine + u3 * sine * sine)
    V_s = unit * (
        B * theta_sss
        - B * (3 * sine * sine * cosine * cosine - sine * sine * sine * sine) * theta_s
        + u3_s * sine * sine
        + 2 * u3 * sine * cosine * theta_s
    )
    Q = unit * (3 * B * sine * cosine - u3) * theta_s
    Q_s = unit * (
        (3 * B * (cosine * cosine - sine * sine) * theta_s - u3_s) * theta_s + (3 * B * sine * cosine - u3) * theta_ss
    )
    along = P_s + V * theta_s + Q * sine * sine
    across = -P * theta_s + V_s - Q * sine * cosine
    return along, across, P * sine * sine - V * sine * cosine - Q_s


@merged
def balance(scene: Values, f: Values) -> tuple[Any, Any, Any]:
    """Force along t and along e_v without friction, and N, in units of p₃CD; f as for the printed model, u₃ for τ."""
    theta, d1, d2, d3, P, dP, u3, du3 = f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7]
    sine, cosine = sine_cosine(theta)
    # d/ds = sinθ d/dψ, applied three times.
    by_arc = (
        sine * d1,
        sine * (sine * d2 + cosine * d1 * d1),
        sine * (sine * sine * d3 + 4 * sine * cosine * d1 * d2 + (cosine * cosine - sine * sine) * d1 * d1 * d1),
    )
    return balance_by_arc(scene, sine, cosine, by_arc, (P, sine * dP), (u3, sine * du3))


def equations(problem: Consistent, f: Values, w: Any) -> tuple[Any, ...]:
    """Residuals along e_v and t, in units of p₃CD, and of the twisting moment, in units of K/r₀ + R₀ p₃CD."""
    along, across, normal = balance(problem.scene, f)
    sine, cosine = sine_cosine(f[0])
    cos_alpha, sin_alpha = friction_direction(problem.scene, sine, cosine, w)
    friction = problem.scene[FRICTION] * normal
    moment = problem.scene[YARN_RADIUS] * problem.scene[TENSION_CD]
    return (
        across + friction * cos_alpha,
        along - friction * sin_alpha,
        (sine * f[7] + friction * cos_alpha * moment) * reciprocal(1 + moment),
    )


register(Consistent, ORDERS, equations, boundary)


def own_normal_force(problem: Consistent, f: Values) -> Any:
    """N in units of p₃CD/r₀."""
    return balance(problem.scene, f)[2]


implement(normal_force, Consistent, own_normal_force)


ROD = Rod(NAME, Consistent)


def solve_rows(scenes: Array, table: Any) -> None:
    """Solve many scenes, `Dimensionless.vector` in each row, into a table of type ROW."""
    find_rows(Consistent(np.empty(scenes.shape[1])), scenes, integration_matrices(), collocation_matrices(), table)


def solve_kirchhoff(scene: Scene, *, profile: bool = True, rotation: float | None = None) -> Solution:
    """Solve the consistent rod on its slow manifold; arguments as for the flexible yarn."""
    return solve_rod(scene, ROD, profile=profile, rotation=rotation)
