"""Solutions integrated again from B by a peer (scipy's DOP853) that knows only the equations."""

import math

import numpy as np
import pytest
from scenes import scene, table_1
from scipy.integrate import solve_ivp

from models.flexible import solve_flexible
from models.scene import Scene


def integrate_flexible(problem: Scene, theta: float, tension: float, tau: float, rotation: float) -> np.ndarray:
    """θ, p₃, τ at C from B by the equations of the flexible yarn, dimensionless, written in θ and p₃ themselves."""
    d = problem.dimensionless()
    spin = 2 * math.pi * d.yarn_radius * (rotation - d.twist_CD)

    def slope(_: float, y: np.ndarray) -> tuple[float, float, float]:
        angle, pull, _tau = y
        alpha = math.atan2(d.cylinder_speed * math.cos(angle) + 1, d.cylinder_speed * math.sin(angle) + spin)
        across, along = d.friction * math.cos(alpha), d.friction * math.sin(alpha)
        return (
            across * math.sin(angle),
            along * math.sin(angle) * pull,
            -across * math.sin(angle) * d.yarn_radius * pull,
        )

    path = solve_ivp(slope, (0, d.wrap_angle), (theta, tension, tau), method="DOP853", rtol=1e-13, atol=1e-13)
    return path.y[:, -1]


@pytest.mark.parametrize("problem", [scene(), table_1(1), table_1(2), table_1(3), scene(cylinder_speed_ratio=-3.0)])
def test_flexible_solution_reaches_C(problem: Scene) -> None:
    found = solve_flexible(problem).require()
    r, force = problem.cylinder_radius, problem.force_unit
    twist, theta = found.ends.twist_AB * r, found.ends.theta_B
    tau = 2 * math.pi * twist + math.sin(theta) * math.cos(theta)
    rotation = found.rotation * r / problem.delivery_speed
    theta_C, tension_C, tau_C = integrate_flexible(problem, theta, found.ends.tension_AB / force, tau, rotation)
    assert theta_C == pytest.approx(found.theta_C, rel=1e-10)
    assert tension_C == pytest.approx(problem.tension_CD / force, rel=1e-10)
    twist_C = (tau_C - math.sin(theta_C) * math.cos(theta_C)) / (2 * math.pi)
    assert twist_C == pytest.approx(problem.twist_CD * r, rel=1e-10)
