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

from typing import Any, NamedTuple

import numpy as np

from models.boundary_value import Array, Values, register
from models.compiled import implement, merged
from models.complex_step import reciprocal, sine_cosine, square_root
from models.diagnosis import solve_rod
from models.flexible import integration_matrices
from models.friction import end_conditions, friction_direction
from models.outcome import Solution
from models.scene import BENDING_RIGIDITY, FRICTION, TENSION_CD, YARN_RADIUS, Scene
from models.slow_manifold import ORDERS, Rod, collocation_matrices, find_rows, normal_force

NAME = "cosserat"


class Printed(NamedTuple):
    """The problem of the printed rod."""

    scene: Values
    """`Dimensionless.vector`."""


@merged
def balance(scene: Values, f: Values) -> tuple[Any, Any, Any, Any]:
    """−bX + aY, N and p₁ in units of p₃CD, and κ; f holds θ, θ', θ'', θ''', p₃/p₃CD, its derivative, τ, τ'."""
    theta, d1, d2, d3, p, tau, dtau = f[0], f[1], f[2], f[3], f[4], f[6], f[7]
    B, unit = scene[BENDING_RIGIDITY], 1 / scene[TENSION_CD]
    sine, cosine = sine_cosine(theta)
    # S S' = R and κ = sinθ S give κ' = θ' G / S with G = θ'' sinθ + θ'² cosθ + 2 sin²θ cosθ.
    per_S = reciprocal(square_root(d1 * d1 + sine * sine))
    R = d1 * (d2 + sine * cosine)
    G = d2 * sine + d1 * d1 * cosine + 2 * sine * sine * cosine
    dG = (
        d3 * sine
        + 3 * d1 * d2 * cosine
        - d1 * d1 * d1 * sine
        + d1 * (4 * sine * cosine * cosine - 2 * sine * sine * sine)
    )
    kappa = sine * (d1 * d1 + sine * sine) * per_S
    dkappa = d1 * G * per_S
    ddkappa = (d2 * G + d1 * dG - d1 * G * R * per_S * per_S) * per_S
    p1 = -unit * B * sine * dkappa
    dp1 = -unit * B * (sine * ddkappa + cosine * d1 * dkappa)
    p2 = -unit * (B - 1) * kappa * tau
    dp2 = -unit * (B - 1) * (dkappa * tau + kappa * dtau)
    a, b = sine * per_S, d1 * per_S
    X = sine * dp1 - p2 * tau + p * kappa
    Y = sine * dp2 + p1 * tau
    return -b * X + a * Y, a * X + b * Y, p1, kappa


def equations(problem: Printed, f: Values, w: Any) -> tuple[Any, ...]:
    """Residuals of E1 and E2, in units of p₃CD, and of E3, in units of K/r₀ + R₀ p₃CD."""
    across, normal, p1, kappa = balance(problem.scene, f)
    sine, cosine = sine_cosine(f[0])
    cos_alpha, sin_alpha = friction_direction(problem.scene, sine, cosine, w)
    friction = problem.scene[FRICTION] * normal
    moment = problem.scene[YARN_RADIUS] * problem.scene[TENSION_CD]
    return (
        across + friction * cos_alpha,
        sine * f[5] - kappa * p1 - friction * sin_alpha,
        (sine * f[7] + friction * cos_alpha * moment) * reciprocal(1 + moment),
    )


def boundary(problem: Printed, left: Values, right: Values, w: Any, out: Values) -> None:
    """Geometry of the spans, p₃(φ), T(φ) and the twist rotation (Eq. 19)."""
    sine_B, cosine_B = sine_cosine(left[0])
    sine_C, cosine_C = sine_cosine(right[0])
    end_conditions(problem.scene, (sine_B, cosine_B, sine_C, cosine_C), left[2], right[2], w, out)
    out[1] = right[1] - 1


register(Printed, ORDERS, equations, boundary)


def own_normal_force(problem: Printed, f: Values) -> Any:
    """N in units of p₃CD/r₀."""
    return balance(problem.scene, f)[1]


implement(normal_force, Printed, own_normal_force)


ROD = Rod(NAME, Printed)


def solve_rows(scenes: Array, table: Any) -> None:
    """Solve many scenes, `Dimensionless.vector` in each row, into a table of type ROW."""
    find_rows(Printed(np.empty(scenes.shape[1])), scenes, integration_matrices(), collocation_matrices(), table)


def solve_cosserat(scene: Scene, *, profile: bool = True, rotation: float | None = None) -> Solution:
    """Solve the printed equations on their slow manifold; arguments as for the flexible yarn."""
    return solve_rod(scene, ROD, profile=profile, rotation=rotation)
