"""The cheapest model that meets a tolerance: its estimates against true errors, and what it says."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import scene, table_1

from models import auto, capstan, flexible, kirchhoff
from models.outcome import Ends
from models.scene import Scene


def relative(found: Ends, other: Ends) -> np.ndarray:
    a, b = (np.array([e.tension_AB, e.twist_AB, e.theta_B]) for e in (found, other))
    return np.abs(a / b - 1)


@pytest.mark.parametrize("problem", [scene(), table_1(1), table_1(2), table_1(3), scene(tension_CD=3000.0)])
def test_the_estimated_bending_effect_is_the_true_one_up_to_its_square(problem: Scene) -> None:
    vector = problem.dimensionless().vector
    yarn = flexible.find(vector, flexible.integration_matrices())
    estimate = auto.bending_effect(vector, yarn)
    rod, bent = kirchhoff.solve_kirchhoff(problem).require(), flexible.solve_flexible(problem).require()
    true = relative(rod.ends, bent.ends)
    np.testing.assert_allclose(estimate, true, rtol=0.1, atol=1e-4)


@pytest.mark.parametrize(
    ("tolerance", "chosen"), [(2.0, "capstan"), (0.05, "flexible"), (0.01, "flexible"), (1e-4, "kirchhoff")]
)
def test_a_smaller_tolerance_needs_a_dearer_model(tolerance: float, chosen: str) -> None:
    problem = table_1(1)
    found = auto.solve_auto(problem, tolerance=tolerance).require()
    assert found.model == "auto"
    assert found.message.startswith(f"by {chosen}: estimated relative errors ")
    assert f"asked for {tolerance:g}" in found.message
    assert "frame term" in found.message
    truth = kirchhoff.solve_kirchhoff(problem).require()
    assert np.all(relative(found.ends, truth.ends) <= tolerance)


def test_fewer_quantities_may_need_a_cheaper_model_only() -> None:
    # Bending moves θ_B most: at this tolerance tension alone is right without it.
    problem = scene(tension_CD=2000.0)
    effects = relative(kirchhoff.solve_kirchhoff(problem).ends, flexible.solve_flexible(problem).ends)
    tolerance = math.sqrt(effects[0] * effects[2])
    assert effects[0] < tolerance < effects[2]
    assert auto.solve_auto(problem, tolerance=tolerance).message.startswith("by kirchhoff")
    assert auto.solve_auto(problem, tolerance=tolerance, wanted=["tension_AB"]).message.startswith("by flexible")


def test_a_cylinder_at_rest_is_exact_in_closed_form() -> None:
    found = auto.solve_auto(scene(cylinder_speed_ratio=0.0, tension_CD=1e5, yarn_radius=1e-4))
    assert found.message.startswith("by capstan")


def test_wrong_calls_are_refused() -> None:
    with pytest.raises(ValueError, match="must be greater than 0"):
        auto.solve_auto(scene(), tolerance=0.0)
    with pytest.raises(ValueError, match="unknown quantity 'tension'"):
        auto.solve_auto(scene(), wanted=["tension"])


@pytest.mark.parametrize("speed", [0.2, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("problem", [scene(), table_1(1), table_1(3)])
def test_the_estimated_error_of_the_closed_form_covers_the_true_one(problem: Scene, speed: float) -> None:
    moved = replace(problem, cylinder_speed_ratio=speed)
    estimate = capstan.direction_error(moved.dimensionless().vector, capstan.find(moved.dimensionless().vector))
    true = relative(capstan.solve_capstan(moved).require().ends, flexible.solve_flexible(moved).require().ends)
    assert np.all(estimate >= true), (estimate, true)


def test_among_several_solutions_only_the_rods_own_solve_is_trusted() -> None:
    # Three solutions: a plain search finds any of them, so no cheaper tier is asked, however large the tolerance.
    found = auto.solve_auto(scene(cylinder_speed_ratio=0.2, tension_CD=6000.0), tolerance=2.0)
    assert "capstan" not in found.message
    assert "by kirchhoff" in found.message
