"""The winding scene's refusals, the machine's motion, the fast mode and the choice of mode."""

import math
import re
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from winding_scenes import winding_scene

from models.winding import fast
from models.winding.drive import travel, traverse
from models.winding.landing import sunk_share
from models.winding.result import WindingOutcome, WindingResult
from models.winding.scene import LARGEST, LIMITS
from models.winding.solve import wind

SOFT = 3.9e5


@pytest.fixture(scope="module")
def full() -> WindingResult:
    """9 m in 1.5 s."""
    return wind(winding_scene(duration=1.5))


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"tension": 0.0}, "tension = 0.0"),
        ({"speed": math.nan}, "speed = nan"),
        ({"prony_weights": (0.123, 924.09)}, "prony_weights"),
        ({"prony_times": (3.53,)}, "prony_times"),
        ({"friction_dynamic": 0.4}, "friction_dynamic = 0.4"),
        ({"element_length": 0.03}, "element_length = 0.03"),
        ({"cone_angle": 0.7}, "cone_angle = 0.7"),
        ({"time_step": 1e-15}, "time_step = 1e-15"),
        ({"tension": 0.0047}, "tension = 0.0047.*ρV² = 0.00472 N"),
        ({"tension_slope": -25.0}, "tension_slope = -25.0.*to the end of the run"),
        ({"feed": "tail", "feed_length": 201.0}, "feed_length = 201.0.*100000 elements"),
        ({"element_length": 4e-4}, "element_length = 0.0004.*diameter"),
        ({"bobbin_radius": 7.9e-3}, "element_length = 0.002.*quarter of the bobbin's radius"),
        ({"duration": 9e-4}, "duration = 0.0009: must be 0.001 to 3600 s"),
        ({"duration": 34.0}, "duration = 34.0.*at most 100000"),
        ({"duration": 1.0, "speed_slope": -6.1}, "speed_slope = -6.1.*to the end of the run"),
    ],
)
def test_a_scene_without_meaning_is_refused(changes: dict[str, Any], place: str):
    with pytest.raises(ValueError, match=place):
        winding_scene(**changes)


@pytest.mark.parametrize("name", [*LIMITS, *LARGEST])
def test_what_cannot_be_computed_is_refused_with_its_limits(name: str):
    low, high = LIMITS[name][:2] if name in LIMITS else (0.0, LARGEST[name][0])
    for beyond, says in ((low - 0.1 * low - 1e-12, low), (1.1 * high, high)):
        with pytest.raises(ValueError, match=rf"^{name} = .*must be .*{re.escape(f'{says:g}')}"):
            winding_scene(**{name: beyond})


def test_a_run_that_is_no_longer_finite_is_not_called_complete(monkeypatch: pytest.MonkeyPatch):
    def lay(*arguments: Any) -> tuple[bool, int]:
        tension = arguments[8]
        tension[-1] = math.nan
        return True, 0

    monkeypatch.setattr(fast, "_lay", lay)
    assert wind(winding_scene(duration=0.1, mode="fast")).outcome is WindingOutcome.DIVERGED


def test_a_package_that_does_not_come_to_rest_is_not_called_complete():
    """A thread as soft as gel, pressed to nine times its thickness."""
    result = wind(winding_scene(duration=0.3, mode="fast", diameter=1.6e-5, transverse_stiffness=3.4e3))
    assert result.outcome is WindingOutcome.RESTLESS
    assert "did not come to rest" in result.message


@pytest.mark.parametrize(
    "changes",
    [
        {"speed": 42.0, "guide_distance": 0.13},  # the span's waves make it slack
        {"speed": 45.0, "guide_distance": 0.56, "bobbin_radius": 0.15, "grip_length": 5.3e-3},
        {"diameter": 3.7e-4, "grip_length": 0.011, "speed": 14.0, "tension": 0.17, "guide_distance": 0.18},
        {"tension": 0.06, "diameter": 1.7e-5, "winding_angle": 0.7, "bending_stiffness": 0.0},
        {"transverse_stiffness": 5.8e11, "turns_per_cycle": 4.33},  # contacts that open and close in turn
        {"linear_density": 4.02e-4, "speed": 14.1, "tension": 0.13, "guide_distance": 0.068, "element_length": 5.7e-4},
    ],
)
def test_a_package_comes_to_rest_on_hard_scenes(changes: dict[str, float]):
    """The first four were no longer finite when slack yarn could push while it was laid; the last is held by its
    bending alone while the span is slack.
    """
    result = wind(winding_scene(**{"duration": 0.3, "mode": "fast", **changes}))
    assert result.outcome is WindingOutcome.COMPLETED
    assert np.all(np.isfinite(result.layers_T_over_T0))


@pytest.mark.parametrize(("metres", "tolerance", "growth"), [(9, 5e-4, 5e-4), (30, 0.01, 0.01), (90, 0.025, 0.01)])
def test_layers_are_those_of_exact_rest(
    metres: float, tolerance: float, growth: float, monkeypatch: pytest.MonkeyPatch
):
    """What `SETTLED`, with `FADE`, and `GROWTH` cost, as said there, T/T₀."""

    def layers() -> np.ndarray:
        result = wind(winding_scene(mode="fast", duration=metres / 6.0))
        assert result.outcome.ok
        return result.layers_T_over_T0

    usual = layers()
    with monkeypatch.context() as oftener:
        oftener.setattr(fast, "GROWTH", 1.03)
        assert np.abs(usual - layers()).max() < growth
    monkeypatch.setattr(fast, "SETTLED", 1e-9)
    monkeypatch.setattr(fast, "FADE", 0.0)
    assert 0 < np.abs(usual - layers()).max() < tolerance


def test_random_scenes_are_computed_to_rest():
    """Half of the inputs within a factor of five of their defaults, speeds that make the span slack included."""
    random, default = np.random.default_rng(7), winding_scene(mode="fast", duration=0.2)
    names = [name for name in LIMITS if name not in ("duration", "feed_length", "feed_memory")]
    outcomes: list[WindingOutcome] = []
    while len(outcomes) < 150:
        chosen = [name for name in names if random.uniform() < 0.5]
        inputs = {name: getattr(default, name) * 5 ** random.uniform(-1, 1) for name in chosen}
        try:
            scene = replace(default, **inputs)
        except ValueError:  # beyond a limit, which its message says
            continue
        outcomes.append(wind(scene).outcome)
    assert outcomes == [WindingOutcome.COMPLETED] * len(outcomes)


@given(st.floats(0, 5), st.floats(0.01, 0.25))
def test_the_guide_stays_within_its_stroke_and_comes_back(phase: float, reversal: float):
    z, slope = traverse(phase, reversal)
    assert abs(z) <= 0.5 + 1e-12
    assert abs(slope) <= 2 / (1 - reversal) + 1e-9
    assert traverse(phase + 0.5, reversal)[0] == pytest.approx(-z, abs=1e-9)
    ahead, behind = traverse(phase + 1e-6, reversal)[0], traverse(phase - 1e-6, reversal)[0]
    assert (ahead - behind) / 2e-6 == pytest.approx(slope, abs=1e-3)


@given(st.floats(0, 2), st.floats(0.001, 0.5), st.floats(-0.5, 0.5))
def test_speed_is_the_rate_of_travel(time: float, rise: float, slope: float):
    shift = 1e-6
    rate = (travel(time + shift, 6.0, rise, slope)[0] - travel(time - shift, 6.0, rise, slope)[0]) / (2 * shift)
    if time > shift:
        assert rate == pytest.approx(travel(time, 6.0, rise, slope)[1], abs=5e-3)


def test_nine_metres_give_ten_layers_at_the_end_tension(full: WindingResult):
    assert full.outcome is WindingOutcome.COMPLETED
    assert full.mode == "fast"
    assert len(full.layers_T_over_T0) == 10
    assert full.snapshots[-1].position.shape[0] * 2e-3 == pytest.approx(8.85, rel=0.01)
    assert full.span_tension[100:].mean() == pytest.approx(0.5, rel=0.02)
    assert [round(float(s.layer[-1])) for s in full.snapshots[:-1]] == [2, 4, 6, 8, 10]


def test_start_points_of_the_cycles_are_displaced_by_198_degrees(full: WindingResult):
    starts = full.guide_position == full.guide_position.min()
    assert starts.any()
    assert (full.scene.turns_per_cycle % 1) * 360 == pytest.approx(198)


def test_stiff_yarn_keeps_its_tension_soft_yarn_loses_it_towards_the_inside(full: WindingResult):
    soft = wind(winding_scene(duration=1.5, transverse_stiffness=SOFT))
    assert full.layers_T_over_T0.min() > 0.85
    assert soft.layers_T_over_T0[0] < 0.7
    assert all(inner < outer for inner, outer in pairwise(soft.layers_T_over_T0))


def test_a_run_says_how_far_its_yarn_gives_way_where_it_does():
    soft, stiff = (wind(winding_scene(duration=0.1, transverse_stiffness=k)) for k in (SOFT, 2.4e9))
    assert soft.penetration_max > 0.05 * soft.scene.diameter
    assert f"{100 * soft.penetration_max / soft.scene.diameter:.1f} % of its diameter" in soft.message
    assert "declared transverse stiffness, 0.39 N/mm²" in soft.message
    assert stiff.penetration_max < 0.05 * stiff.scene.diameter
    assert stiff.message == ""


def test_a_single_soft_loop_loses_what_its_sinking_predicts():
    # Held after a share of its sinking T/(R K_t), a loop sinks on until K_t δ = T'/R, here on a path of angle α.
    scene = winding_scene(duration=0.1, transverse_stiffness=SOFT, prony_weights=(0.0, 0.0))
    shot = wind(scene).snapshots[-1]
    lost = scene.softness * math.cos(scene.winding_angle) ** 4
    slope = np.abs(np.gradient(shot.position[:, 2], scene.element_length))
    sunk = scene.bobbin_radius + scene.diameter / 2 - np.hypot(shot.position[:, 0], shot.position[:, 1])
    alone = (slope < math.sin(scene.winding_angle) * 1.05) & (np.arange(len(slope)) > 100)
    bearing = scene.transverse_stiffness * sunk * scene.bobbin_radius / math.cos(scene.winding_angle) ** 2
    assert np.median(bearing[alone] / shot.tension[alone]) == pytest.approx(1, rel=0.03)
    assert np.median(shot.tension[alone]) == pytest.approx(0.5 * (1 + sunk_share(scene) * lost) / (1 + lost), rel=0.05)


def test_a_ramp_of_tension_is_followed():
    result = wind(winding_scene(duration=1.0, tension_slope=0.2))
    slope = np.polyfit(result.time[100:], result.span_tension[100:], 1)[0]
    assert slope == pytest.approx(0.2, rel=0.1)


def test_friction_on_the_guide_raises_the_tension():
    plain, rough = wind(winding_scene(duration=0.3)), wind(winding_scene(duration=0.3, guide_friction=0.3))
    ratio = rough.span_tension[100:] / plain.span_tension[100:]
    assert 1.02 < ratio.mean() < math.exp(0.3 * 0.4)


def test_a_tail_makes_the_tension_fluctuate_more():
    matched = wind(winding_scene(duration=0.5))
    tail = wind(winding_scene(duration=0.5, feed="tail", feed_length=9.0))
    assert tail.span_tension[100:].std() > matched.span_tension[100:].std()


def test_a_cone_is_wound_faster_at_its_thick_end():
    result = wind(winding_scene(duration=0.5, cone_angle=math.radians(4)))
    assert result.outcome is WindingOutcome.COMPLETED
    radius = np.hypot(result.snapshots[-1].position[:, 0], result.snapshots[-1].position[:, 1])
    assert np.corrcoef(radius, result.snapshots[-1].position[:, 2])[0, 1] > 0.99


def test_the_same_scene_gives_the_same_bits(full: WindingResult):
    again = wind(full.scene)
    np.testing.assert_array_equal(again.span_tension, full.span_tension)
    np.testing.assert_array_equal(again.snapshots[-1].tension, full.snapshots[-1].tension)


def test_auto_says_what_it_chose_and_why(full: WindingResult):
    assert "tension of the span" in full.mode_reason
    stiff = wind(replace(full.scene, wanted="layers", duration=0.1))
    assert stiff.mode == "fast"
    assert "EA/(R² K_t) = 0.0146" in stiff.mode_reason
    soft = wind(winding_scene(duration=0.005, wanted="layers", transverse_stiffness=SOFT))
    assert soft.mode == "reference"
    assert "soft" in soft.mode_reason


def test_a_run_shorter_than_its_start_lays_what_it_can():
    result = wind(winding_scene(duration=0.005))
    assert result.outcome is WindingOutcome.COMPLETED
    assert np.all(np.isfinite(result.span_tension))
    assert result.span_tension[-1] == pytest.approx(0.5, abs=0.1)


def test_the_last_sample_is_no_worse_than_the_others(full: WindingResult):
    assert full.span_tension[-20:].std() < 0.1
