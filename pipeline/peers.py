"""The flexible yarn solved by other programs, for comparison, from the circle at constant tension and twist.

The equations are those of models/flexible.py in θ, p₃/p₃CD and τ, written once more in plain numpy and for CasADi.
"""

import math
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid, solve_bvp, solve_ivp
from scipy.optimize import root

from models.scene import Dimensionless

HAVE_CASADI = find_spec("casadi") is not None
"""CasADi is the optional dependency `peers`: 90 MB for one row of a table."""
CASADI_ORDER = 4
"""Legendre points in an interval: the ends converge with order 8."""


def by_solve_bvp(
    d: Dimensionless, tolerance: float, nodes: int = 5, *, straight: bool = False
) -> tuple[bool, float, int]:
    """By scipy's solve_bvp, adaptive collocation of fourth order: success, p₃AB and the number of nodes.

    Parameters
    ----------
    straight : start where models/flexible.py starts, instead of from the circle.
    """
    psi = np.linspace(0, d.wrap_angle, nodes)
    guess = _straight(d, psi) if straight else np.repeat(_circle(d)[:, None], nodes, axis=1)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # a diverging iterate overflows; success says what became of it
        found = solve_bvp(
            lambda _, y, p: np.array(_slopes(np, d, y, p[0])), lambda b, c, p: np.array(_ends(np, d, b, c, p[0])),
            psi, guess[:3], p=guess[3, :1], tol=tolerance, max_nodes=20_000,
        )  # fmt: skip
    return bool(found.success), float(d.tension_CD * found.y[1, 0]), int(found.x.size)


def by_shooting(d: Dimensionless, tolerance: float) -> float:
    """p₃AB by shooting: DOP853 from C to B, scipy's root in θ_C and n₁."""

    def at_B(theta_C: float, w: float) -> np.ndarray:
        tau_C = 2 * math.pi * d.twist_CD + math.sin(theta_C) * math.cos(theta_C)
        path = solve_ivp(
            lambda _, y: np.array(_slopes(np, d, y, w)), (d.wrap_angle, 0.0), [theta_C, 1.0, tau_C], method="DOP853",
            rtol=tolerance, atol=tolerance,
        )  # fmt: skip
        return path.y[:, -1]

    def gap(x: np.ndarray) -> list[float]:
        conditions = _ends(np, d, at_B(x[0], x[1]), np.array([x[0], 1.0, 0.0]), x[1])
        return [conditions[0], conditions[3]]

    circle = _circle(d)
    found = root(gap, [circle[0], circle[3]], tol=tolerance)
    return float(d.tension_CD * at_B(*found.x)[1])


def by_casadi(d: Dimensionless, intervals: int) -> Callable[[], float]:
    """A function that solves for p₃AB by CasADi: collocation at Legendre points, its own Newton with exact derivatives.

    What CasADi builds and differentiates once is not part of the call.
    """
    import casadi as ca  # noqa: PLC0415  # pyright: ignore[reportMissingImports] (optional)

    legendre, continuation, _ = ca.collocation_coeff(ca.collocation_points(CASADI_ORDER, "legendre"))
    w, at = ca.SX.sym("w"), ca.SX.sym("B", 3)
    left, unknowns, equations = at, [at], []
    for i in range(intervals):
        inside, end = ca.SX.sym(f"inside_{i}", 3, CASADI_ORDER), ca.SX.sym(f"end_{i}", 3)
        slopes = [ca.vertcat(*_slopes(ca, d, inside[:, k], w)) for k in range(CASADI_ORDER)]
        step = d.wrap_angle / intervals * ca.horzcat(*slopes)
        nodes = ca.horzcat(at, inside)
        equations += [ca.vec(ca.mtimes(nodes, legendre) - step), end - ca.mtimes(nodes, continuation)]
        unknowns += [ca.vec(inside), end]
        at = end
    problem = {"x": ca.vertcat(*unknowns, w), "g": ca.vertcat(*equations, *_ends(ca, d, left, at, w))}
    solver = ca.rootfinder("solver", "fast_newton", problem, {"abstol": 1e-11})
    circle = _circle(d)
    start = np.append(np.tile(circle[:3], 1 + intervals * (CASADI_ORDER + 1)), circle[3])
    return lambda: float(solver(start, [])[1]) * d.tension_CD


def _circle(d: Dimensionless) -> np.ndarray:
    """θ, p₃/p₃CD, τ and n₁/v of the circle, shape (4,)."""
    return np.array([math.pi / 2, 1.0, 2 * math.pi * d.twist_CD, d.twist_rotation(d.twist_CD)])


def _straight(d: Dimensionless, psi: np.ndarray) -> np.ndarray:
    """θ, p₃/p₃CD, τ and n₁/v at ψ, shape (4, n): q = ln tan(θ/2) straight along the contact, p₃ and τ by quadrature.

    Friction has the direction that a yarn square to the axis has, with the rotation of the circle, for q; then that of
    the yarn.
    """
    w, fine = float(_circle(d)[3]), np.linspace(0, d.wrap_angle, 1001)
    spin = 2 * math.pi * d.yarn_radius * (w - d.twist_CD)
    slope = d.friction * (d.cylinder_speed + spin) / math.hypot(d.cylinder_speed + spin, 1)
    theta = 2 * np.arctan(np.exp(slope * (fine - d.wrap_angle / (1 + d.span_ratio))))

    def to_C(slopes: np.ndarray) -> np.ndarray:
        """∫ from ψ to φ."""
        return cumulative_trapezoid(slopes[::-1], -fine[::-1], initial=0)[::-1]

    _, log_slope, _ = _slopes(np, d, (theta, 1.0, 0.0), w)
    tension = np.exp(-to_C(log_slope))
    _, _, tau_slope = _slopes(np, d, (theta, tension, 0.0), w)
    bent = np.sin(theta) * np.cos(theta)
    tau = 2 * math.pi * d.twist_CD + bent[-1] - to_C(tau_slope)
    w = d.twist_rotation((tau[0] - bent[0]) / (2 * math.pi))
    return np.array([np.interp(psi, fine, values) for values in (theta, tension, tau, np.full_like(fine, w))])


def _slopes(library: Any, d: Dimensionless, y: Any, w: Any) -> tuple[Any, Any, Any]:
    """θ', p₃' and τ'."""
    sine, cosine = library.sin(y[0]), library.cos(y[0])
    across = d.cylinder_speed * sine + 2 * math.pi * d.yarn_radius * (w - d.twist_CD)
    along = d.cylinder_speed * cosine + 1
    friction = d.friction * sine / library.sqrt(across * across + along * along)
    return friction * across, friction * along * y[1], -friction * across * d.yarn_radius * d.tension_CD * y[1]


def _ends(library: Any, d: Dimensionless, b: Any, c: Any, w: Any) -> tuple[Any, Any, Any, Any]:
    """Geometry of the spans, p₃(φ), T(φ) and the twist rotation, from θ, p₃/p₃CD and τ at B and C."""
    bent_B, bent_C = library.sin(b[0]) * library.cos(b[0]), library.sin(c[0]) * library.cos(c[0])
    return (
        d.span_ratio * library.cos(b[0]) + library.cos(c[0]),
        c[1] - 1,
        c[2] - bent_C - 2 * math.pi * d.twist_CD,
        w - d.twist_rotation((b[2] - bent_B) / (2 * math.pi)),
    )
