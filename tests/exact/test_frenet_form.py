"""The Kirchhoff rod once more, in the Frenet frame of its centreline: own balance, own discretisation, own Newton."""

import math

import numpy as np
import pytest
from numpy.polynomial import chebyshev
from scenes import scene, table_1
from scipy.optimize import root

from models.flexible import solve_flexible
from models.kirchhoff import solve_kirchhoff
from models.scene import Scene

DEGREE = 12


def matrices(length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Chebyshev–Lobatto nodes on [0, length], differentiation there, and interpolation to the Gauss points."""
    nodes = -np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
    gauss = -np.cos(np.pi * (np.arange(DEGREE) + 0.5) / DEGREE)
    to_coefficients = np.linalg.inv(chebyshev.chebvander(nodes, DEGREE))
    slope = chebyshev.chebvander(nodes, DEGREE - 1) @ chebyshev.chebder(to_coefficients)
    return (nodes + 1) * length / 2, slope * 2 / length, chebyshev.chebvander(gauss, DEGREE) @ to_coefficients


def frenet_residual(problem: Scene, x: np.ndarray) -> np.ndarray:
    """Force along b and t and twisting moment at the Gauss points, and the four boundary conditions.

    With F = p_t t + p_n n + p_b b:  p_n = −B κ_s,  p_b = κ (K u₃ − B τ_F),  and of F_s + f = 0

        p_t,s − κ p_n + f_t = 0      p_n,s + κ p_t − τ_F p_b + f_n = 0      p_b,s + τ_F p_n + f_b = 0

    where τ_F = sinθ cosθ − χ_s is the Frenet torsion of a curve on the cylinder whose normal makes the angle
    χ = atan(θ_s / sin²θ) with the surface's.
    """
    d = problem.dimensionless()
    _, slope, to_gauss = matrices(d.wrap_angle)
    theta, p_t, u3 = x[:-1].reshape(3, -1)
    p_t, w, B = p_t * d.tension_CD, x[-1], d.bending_rigidity
    sine, cosine = np.sin(theta), np.cos(theta)

    def by_arc(values: np.ndarray) -> np.ndarray:
        return sine * (slope @ values)

    theta_s = by_arc(theta)
    kappa = np.hypot(theta_s, sine**2)
    in_surface, out_of_it = theta_s / kappa, sine**2 / kappa  # −e_v·n = −e_r·b and −e_r·n = e_v·b
    torsion = sine * cosine - by_arc(np.arctan2(theta_s, sine**2))
    p_n, p_b = -B * by_arc(kappa), kappa * (u3 - B * torsion)
    across = d.cylinder_speed * sine + 2 * math.pi * d.yarn_radius * (w - d.twist_CD)
    alpha = np.arctan2(d.cylinder_speed * cosine + 1, across)
    bare_n = by_arc(p_n) + kappa * p_t - torsion * p_b
    bare_b = by_arc(p_b) + torsion * p_n
    # N (e_r + μ cosα e_v) closes the balance along n and b; N follows from their part along e_r.
    N = out_of_it * bare_n + in_surface * bare_b
    along_v = -in_surface * bare_n + out_of_it * bare_b
    pull = d.friction * N
    twist = (u3 - sine * cosine) / (2 * math.pi)
    ends = [
        d.span_ratio * cosine[0] + cosine[-1],
        p_t[-1] / d.tension_CD - 1,
        twist[-1] - d.twist_CD,
        w - d.twist_congestion * (twist[0] - d.twist_trapping * d.twist_CD),
    ]
    fields = [
        (along_v + pull * np.cos(alpha)) / d.tension_CD,
        (by_arc(p_t) - kappa * p_n - pull * np.sin(alpha)) / d.tension_CD,
        by_arc(u3) + pull * np.cos(alpha) * d.yarn_radius,
    ]
    return np.concatenate([*(to_gauss @ field for field in fields), ends])


@pytest.mark.parametrize("problem", [scene(), table_1(1), table_1(2), table_1(3)])
def test_the_frenet_form_gives_the_same_ends_as_the_darboux_form(problem: Scene) -> None:
    d, start = problem.dimensionless(), solve_flexible(problem).require()
    profile = start.profile
    assert profile is not None
    nodes = matrices(d.wrap_angle)[0]
    theta, tension, twist = (
        np.interp(nodes, profile.psi, values)
        for values in (profile.theta, profile.tension / problem.tension_CD, profile.twist * problem.cylinder_radius)
    )
    guess = np.concatenate([theta, tension, 2 * math.pi * twist + np.sin(theta) * np.cos(theta)])
    w = start.rotation * problem.cylinder_radius / problem.delivery_speed
    found = root(lambda x: frenet_residual(problem, x), np.append(guess, w), tol=1e-12)
    assert np.max(np.abs(frenet_residual(problem, found.x))) < 1e-9
    theta, tension, u3 = found.x[:-1].reshape(3, -1)[:, 0]
    darboux = solve_kirchhoff(problem).require().ends
    assert tension * problem.tension_CD == pytest.approx(darboux.tension_AB, rel=1e-6)
    twist = (u3 - math.sin(theta) * math.cos(theta)) / (2 * math.pi) / problem.cylinder_radius
    assert twist == pytest.approx(darboux.twist_AB, rel=1e-6)
    assert theta == pytest.approx(darboux.theta_B, rel=1e-6)
