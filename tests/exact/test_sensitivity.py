"""Derivatives by the implicit function theorem against finite differences of whole solves, and against scaling laws."""

from dataclasses import astuple, fields, replace

import numpy as np
import pytest
from scenes import scene, table_1

from models.scene import Scene
from models.sensitivity import sensitivities
from models.solve import MODELS

INPUTS = [field.name for field in fields(Scene)]


@pytest.mark.parametrize("model", ["flexible", "cosserat", "kirchhoff"])
@pytest.mark.parametrize("name", INPUTS)
def test_agrees_with_central_differences(model: str, name: str) -> None:
    problem = scene(span_ratio=1.3, twist_trapping=0.8, twist_congestion=0.9, cylinder_speed_ratio=1.5)
    found = sensitivities(problem, model)
    assert found is not None
    value = getattr(problem, name)
    # Fourth-order differences with a step at which rounding and truncation are both far below the tolerance.
    h = 2e-3 * value

    def ends(step: float) -> np.ndarray:
        return np.array(astuple(MODELS[model](replace(problem, **{name: value + step})).require().ends))

    difference = (8 * (ends(h) - ends(-h)) - (ends(2 * h) - ends(-2 * h))) / (12 * h)
    size = np.abs(ends(0.0)) / value
    tolerance = 1e-8 if model == "flexible" else 2e-5  # the rods' ends jitter by their stated error, 1e-8, over h
    np.testing.assert_array_less(np.abs(np.array(astuple(found[name])) - difference), tolerance * size)


@pytest.mark.parametrize("model", ["flexible", "cosserat", "kirchhoff"])
@pytest.mark.parametrize("case", [1, 2, 3])
def test_scaling_laws_hold(model: str, case: int) -> None:
    # The ends are homogeneous: p₃AB of degree 1 in (p₃CD, K), T_AB and θ_B of degree 0; in lengths, with
    # K ~ L² p₃: T_AB of degree −1. Euler's theorem then ties the derivatives together.
    problem = table_1(case)
    found, ends = sensitivities(problem, model), MODELS[model](problem).require().ends
    assert found is not None
    force = [found[n].tension_AB * getattr(problem, n) for n in ("tension_CD", "torsional_rigidity")]
    assert sum(force) == pytest.approx(ends.tension_AB, rel=1e-7)
    for end in ("twist_AB", "theta_B"):
        terms = [getattr(found[n], end) * getattr(problem, n) for n in ("tension_CD", "torsional_rigidity")]
        assert sum(terms) == pytest.approx(0, abs=1e-7 * abs(getattr(ends, end)))
    lengths = {"cylinder_radius": 1, "yarn_radius": 1, "twist_CD": -1, "torsional_rigidity": 2}
    twist = sum(power * found[n].twist_AB * getattr(problem, n) for n, power in lengths.items())
    assert twist == pytest.approx(-ends.twist_AB, rel=1e-7)


def test_speed_alone_changes_nothing_but_rotation() -> None:
    found = sensitivities(table_1(1), "cosserat")
    assert found is not None
    assert astuple(found["delivery_speed"]) == (0.0, 0.0, 0.0)


def test_no_solution_no_derivative() -> None:
    slack = replace(table_1(1), wrap_angle=0.03, tension_CD=0.005)
    assert MODELS["cosserat"](slack).outcome.ok is False
    assert sensitivities(slack, "cosserat") is None


def test_auto_has_the_derivatives_of_the_rod_that_it_stands_for() -> None:
    assert sensitivities(table_1(1), "auto") == sensitivities(table_1(1), "kirchhoff")
    assert sensitivities(table_1(1), "auto") != sensitivities(table_1(1), "cosserat")
