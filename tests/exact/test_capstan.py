"""The closed-form model against the equations it integrates, and the flexible solver where both are exact."""

import math
from dataclasses import astuple

import numpy as np
import pytest
from scenes import scene, table_1

from models.capstan import ConstantFriction, solve_capstan
from models.flexible import solve_flexible


@pytest.mark.parametrize("changes", [{}, {"span_ratio": 0.3}, {"span_ratio": 4.0, "twist_CD": -2.0}, {"friction": 0.0}])
@pytest.mark.parametrize("wrap_deg", [5, 60, 300])
def test_equals_the_flexible_yarn_on_a_cylinder_at_rest(wrap_deg: float, changes: dict[str, float]) -> None:
    problem = scene(cylinder_speed_ratio=0.0, wrap_angle=math.radians(wrap_deg), **changes)
    closed, solved = solve_capstan(problem).require(), solve_flexible(problem).require()
    np.testing.assert_allclose(astuple(closed.ends), astuple(solved.ends), rtol=1e-9)
    assert closed.rotation == pytest.approx(solved.rotation, rel=1e-9, abs=1e-9)


def test_boundary_conditions_hold_on_a_moving_cylinder() -> None:
    for case in (1, 2, 3):
        found = solve_capstan(table_1(case)).require()
        assert math.cos(found.ends.theta_B) + math.cos(found.theta_C) == pytest.approx(0, abs=1e-12)
        assert found.rotation == pytest.approx(
            (found.ends.twist_AB - table_1(case).twist_CD) * table_1(case).delivery_speed
        )
        assert found.profile is not None
        assert found.profile.twist[-1] == pytest.approx(table_1(case).twist_CD, rel=1e-12)


@pytest.mark.parametrize("alpha", [0.3, 1.2, 2.2, -0.8, math.pi / 2, math.pi - 1e-13])
def test_closed_forms_satisfy_the_equations(alpha: float) -> None:
    form = ConstantFriction(1.0, 0.7, alpha, 0.03, 1.9, 500.0, 6.0)
    psi, h = np.linspace(0.05, 0.95, 9), 1e-5
    across, along = form.friction * math.cos(alpha), form.friction * math.sin(alpha)
    sine, tension = np.sin(form.theta(psi)), form.tension(psi)
    for field, slope in (
        (form.theta, across * sine),
        (form.tension, along * sine * tension),
        (form.tau, -across * sine * form.yarn_radius * tension),
    ):
        difference = (field(psi + h) - field(psi - h)) / (2 * h)
        np.testing.assert_allclose(difference, slope, rtol=1e-6, atol=1e-6)


def test_error_of_the_frozen_direction_is_of_the_stated_kind() -> None:
    # Second order in the change of θ along the wrap: a quarter of the wrap, a sixteenth of the error or less.
    errors = []
    for wrap in (0.8, 0.2):
        problem = scene(wrap_angle=wrap, cylinder_speed_ratio=2.0)
        errors.append(abs(solve_capstan(problem).ends.theta_B - solve_flexible(problem).ends.theta_B))
    assert errors[1] < errors[0] / 14
