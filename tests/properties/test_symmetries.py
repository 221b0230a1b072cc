"""What must not depend on the choice of units or handedness, and limits that all models share."""

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import scene, table_1

from models.outcome import Outcome, Solution
from models.scene import Scene
from models.solve import MODELS

moderate = st.fixed_dictionaries(
    {
        "wrap_angle": st.floats(0.6, 1.6),
        "friction": st.floats(0.3, 1.0),
        "twist_CD": st.floats(0.5, 2.0),
        "tension_CD": st.floats(400, 2000),
        "cylinder_speed_ratio": st.floats(0.5, 2.0),
        "span_ratio": st.floats(0.5, 2.0),
    }
)


def ends(found: Solution) -> np.ndarray:
    e = found.require().ends
    return np.array([e.tension_AB, e.twist_AB, e.theta_B])


@pytest.mark.parametrize("model", ["flexible", "cosserat", "kirchhoff"])
@settings(max_examples=15, deadline=None)
@given(changes=moderate, length=st.floats(1e-4, 1e-1), rigidity=st.floats(1e-10, 1e-7), speed=st.floats(0.01, 10))
def test_units_do_not_matter(
    model: str, changes: dict[str, float], length: float, rigidity: float, speed: float
) -> None:
    plain = MODELS[model](scene(**changes))
    scaled = MODELS[model](
        scene(
            **changes
            | {
                "cylinder_radius": length,
                "yarn_radius": 0.03 * length,
                "torsional_rigidity": rigidity,
                "delivery_speed": speed,
                "twist_CD": changes["twist_CD"] / length,
                "tension_CD": changes["tension_CD"] * rigidity / length**2,
            }
        )
    )
    assert plain.outcome is scaled.outcome
    if plain.outcome is Outcome.CONVERGED:
        unit = np.array([rigidity / length**2, 1 / length, 1.0])
        np.testing.assert_allclose(ends(scaled), ends(plain) * unit, rtol=1e-6)
        assert scaled.rotation == pytest.approx(plain.rotation * speed / length, rel=1e-6)


@pytest.mark.parametrize("model", ["flexible", "cosserat", "cosserat-fd", "kirchhoff"])
@pytest.mark.parametrize("case", [1, 2, 3])
def test_tension_scale_alone_is_dimensionless(model: str, case: int) -> None:
    # Twice the tension with twice the torsional rigidity is the same shape, twice the force.
    once = table_1(case)
    twice = Scene(
        **{
            name: getattr(once, name) * (2 if name in ("tension_CD", "torsional_rigidity") else 1)
            for name in Scene.__dataclass_fields__
        }
    )
    np.testing.assert_allclose(ends(MODELS[model](twice)), ends(MODELS[model](once)) * [2, 1, 1], rtol=1e-7)


def mirrored(problem: Scene) -> Scene:
    """The scene seen in a mirror across the plane of the cross-section: S for Z, the cylinder moves the other way."""
    values = {name: getattr(problem, name) for name in Scene.__dataclass_fields__}
    return Scene(**values | {"twist_CD": -problem.twist_CD, "cylinder_speed_ratio": -problem.cylinder_speed_ratio})


def test_handedness_does_not_matter() -> None:
    # A mirror across the cross-section: θ → 180° − θ, T → −T, p₃ the same. The spin 2πR₀(n₁ − n₀) changes sign
    # with the twist and v_b sinθ with the cylinder, so cosα → −cosα and sinα stays.
    for case in (1, 2, 3):
        for model in ("flexible", "cosserat", "cosserat-fd", "kirchhoff"):
            left, right = MODELS[model](table_1(case)), MODELS[model](mirrored(table_1(case)))
            expected = ends(left) * [1, -1, -1] + [0, 0, math.pi]
            stated = np.array([astuple(left.u_num), astuple(right.u_num)]).sum(axis=0)
            assert np.all(np.abs(ends(right) - expected) <= 3 * stated + 1e-10 * np.abs(expected))
            assert np.all(stated < 1e-3 * np.abs(expected))


def test_high_tension_recovers_the_flexible_yarn() -> None:
    # p̄₃ → ∞: the consistent rod's difference to the flexible yarn falls as 1/p̄₃.
    difference = []
    for tension in (1e3, 1e4, 1e5):
        flexible, rod = (
            ends(MODELS[m](scene(tension_CD=tension, yarn_radius=3 / tension))) for m in ("flexible", "kirchhoff")
        )
        difference.append(np.max(np.abs(rod / flexible - 1)))
    assert difference[0] > 5 * difference[1] > 25 * difference[2]
    assert difference[2] < 1e-4


def test_frame_term_is_the_printed_models_difference() -> None:
    # B = K switches the term (B − K) κ τ² off, and with it nearly all of the printed model's difference.
    for case in (1, 2, 3):
        values = {name: getattr(table_1(case), name) for name in Scene.__dataclass_fields__}
        printed = ends(MODELS["cosserat"](table_1(case)))
        without = ends(MODELS["cosserat"](Scene(**values | {"rigidity_ratio": 1.0})))
        flexible = ends(MODELS["flexible"](table_1(case)))
        assert abs(without[0] - flexible[0]) < 0.15 * abs(printed[0] - flexible[0])
        assert abs(without[1] - flexible[1]) < 0.15 * abs(printed[1] - flexible[1])
