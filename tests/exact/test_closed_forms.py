"""Every solver against closed forms of physics that it does not share code with."""

import math

import numpy as np
import pytest
from scenes import scene

from models.capstan import ConstantFriction
from models.flexible import solve_flexible
from models.scene import Scene


def exact(problem: Scene, theta_C: float, tau_C: float, rotation: float) -> ConstantFriction:
    """The closed form for a cylinder at rest, where the friction direction is constant."""
    across = 2 * math.pi * problem.yarn_radius * (rotation - problem.twist_CD)
    return ConstantFriction(
        wrap_angle=problem.wrap_angle,
        friction=problem.friction,
        alpha=math.atan2(1.0, across),
        yarn_radius=problem.yarn_radius,
        theta_C=theta_C,
        tension_C=problem.tension_CD,
        tau_C=tau_C,
    )


@pytest.mark.parametrize("twist", [-3.0, -0.5, 0.7, 4.0])
@pytest.mark.parametrize(("wrap_deg", "friction"), [(10, 0.1), (60, 0.8), (180, 0.4), (360, 1.2)])
def test_flexible_on_a_cylinder_at_rest(twist: float, wrap_deg: float, friction: float) -> None:
    problem = scene(
        cylinder_speed_ratio=0.0, twist_CD=twist, wrap_angle=math.radians(wrap_deg), friction=friction, span_ratio=1.7
    )
    found = solve_flexible(problem).require()
    assert found.profile is not None
    profile = found.profile
    form = exact(problem, profile.theta[-1], profile.torsional_moment[-1], found.rotation)
    np.testing.assert_allclose(profile.theta, form.theta(profile.psi), rtol=1e-10)
    np.testing.assert_allclose(profile.tension, form.tension(profile.psi), rtol=1e-10)
    np.testing.assert_allclose(profile.torsional_moment, form.tau(profile.psi), rtol=1e-10, atol=1e-10)


def test_flexible_boundary_conditions_hold() -> None:
    problem = scene(span_ratio=1.7, twist_trapping=0.6, twist_congestion=0.8)
    found = solve_flexible(problem).require()
    assert found.profile is not None
    assert found.profile.tension[-1] == pytest.approx(problem.tension_CD, rel=1e-12)
    assert found.profile.twist[-1] == pytest.approx(problem.twist_CD, rel=1e-12)
    assert 1.7 * math.cos(found.ends.theta_B) + math.cos(found.theta_C) == pytest.approx(0, abs=1e-12)
    assert found.rotation == pytest.approx((found.ends.twist_AB - 0.6 * problem.twist_CD) * 0.8, rel=1e-12)


def test_capstan_equation_where_friction_is_along_the_yarn() -> None:
    # η = k = 0 with no twist: n₁ = n₀ = 0, so the friction has no component across the yarn.
    problem = scene(cylinder_speed_ratio=0.0, twist_CD=0.0, twist_congestion=0.0)
    found = solve_flexible(problem).require()
    expected = problem.tension_CD * math.exp(-problem.friction * problem.wrap_angle)
    assert found.ends.tension_AB == pytest.approx(expected, rel=1e-12)
    assert found.ends.theta_B == pytest.approx(math.pi / 2, abs=1e-12)
    assert found.ends.twist_AB == pytest.approx(0, abs=1e-12)
    form = exact(problem, math.pi / 2, 0.0, 0.0)
    assert form.tension(np.array([0.0]))[0] == pytest.approx(expected, rel=1e-12)


def test_frictionless_yarn_keeps_tension_and_twist() -> None:
    found = solve_flexible(scene(friction=0.0, span_ratio=2.0)).require()
    assert found.ends.tension_AB == pytest.approx(600, rel=1e-12)
    assert found.ends.twist_AB == pytest.approx(1, rel=1e-12)
    assert found.ends.theta_B == pytest.approx(math.pi / 2, rel=1e-12)
