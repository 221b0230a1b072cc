"""The free yarn of the fast mode: lag of the lay point, waves of the string, tension of both feeds."""

import math
from dataclasses import replace

import numpy as np
import pytest
from winding_scenes import winding_scene

from models.winding.drive import traverse
from models.winding.scene import WindingScene
from models.winding.solve import wind
from models.winding.span import fly, line_of, new_feed, path, tension_at


def times_of(scene: WindingScene, count: int) -> np.ndarray:
    """Of nodes that touch at full speed."""
    return np.arange(count) * scene.element_length / scene.speed


@pytest.mark.parametrize("speed", [0.6, 1e-3])
def test_slowly_traversed_yarn_is_laid_by_the_angle_of_the_straight_span(speed: float):
    """dz/ds = (z_eye − z)/g with the eye at the guide, once the waves are much faster than the guide."""
    scene = winding_scene(speed=speed, speed_rise=0.0, guide_clearance=0.0, turns_per_cycle=1.55)
    time = times_of(scene, 1500)
    z, _, _ = path(scene, time)
    place, expected = -scene.stroke / 2, []
    step = scene.element_length * math.cos(scene.winding_angle)
    for k in range(time.size):
        expected.append(place)
        phase = (k + 0.5) * step / (2 * math.pi * scene.bobbin_radius * scene.turns_per_cycle)
        guide = scene.stroke * traverse(phase, scene.reversal)[0]
        place += (guide - place) * (1 - math.exp(-step / scene.guide_distance))
    assert z == pytest.approx(np.array(expected), abs=0.01 * scene.stroke)


def test_a_kink_runs_up_the_yarn_against_its_speed():
    """The guide starts at once; its kink arrives at the eyelet after ℓ/(c − V): the length's curve in time bends."""
    scene = winding_scene(speed_rise=0.0, guide_clearance=0.0, turns_per_cycle=10.55, feed_length=1.0)
    line = line_of(scene)._replace(reversal=0.002)
    time = np.arange(3000) * 0.01e-3
    _, free, _ = fly(line, time, 30, 500, scene.feed_length)
    c, drawn = math.sqrt(scene.tension / scene.linear_density), scene.speed * math.cos(scene.winding_angle)
    arrives = scene.feed_length / (c - drawn)
    smooth = np.convolve(free, np.ones(50) / 50, mode="same")
    bent = np.abs(np.gradient(np.gradient(smooth, time), time))
    window = (time > 0.6 * arrives) & (time < 1.4 * arrives)
    assert time[window][np.argmax(bent[window])] == pytest.approx(arrives, rel=0.05)


def along_characteristics(scene: WindingScene, time: np.ndarray) -> np.ndarray:
    """Where yarn is laid [m] at the times [s], the eye held by the guide, the tension constant.

    F = v − c s goes down at V + c and comes back from the lay point, where v = 0, as −F at c − V. At the guide, which
    moves at the rate r, v = r + V s: F = (1 + q) r + q F(t − 2gc/(c² − V²)), q = (c − V)/(c + V). The lay point moves
    by −V s = (V/c) F.
    """
    c, drawn = math.sqrt(scene.tension / scene.linear_density), scene.speed * math.cos(scene.winding_angle)
    q, round_trip = (c - drawn) / (c + drawn), 2 * scene.guide_distance * c / (c**2 - drawn**2)
    per_second = scene.speed * scene.cycles / scene.wound_length
    place, leaves = np.full(time.size, -scene.stroke / 2), time - scene.guide_distance / (c + drawn)
    share = drawn / c * (1 + q)
    while np.any(leaves > 0):
        guide = [traverse(max(t, 0.0) * per_second, scene.reversal)[0] for t in leaves]
        place += share * scene.stroke * (np.array(guide) + 0.5)
        leaves, share = leaves - round_trip, share * q
    return place


def test_waves_of_the_span_are_those_of_a_threadline_between_the_guide_and_the_bobbin():
    scene = winding_scene(speed_rise=0.0, guide_clearance=0.0, turns_per_cycle=1.55, duration=0.5)
    time = times_of(scene, 1500)
    exact = along_characteristics(scene, time)
    still = line_of(scene)._replace(impedance=0.0)  # no change of tension pushes the string
    coarse, fine = (np.abs(fly(still, time, 8 * n, 40 * n, scene.feed_length)[0] - exact).max() for n in (1, 4))
    assert coarse < 0.003 * scene.stroke
    assert fine < coarse / 3


def test_a_mirrored_guide_lays_the_mirrored_path_bit_by_bit():
    scene = winding_scene(turns_per_cycle=1.55, guide_friction=0.2)
    line, time = line_of(scene), times_of(scene, 800)
    z, free, wrap = fly(line, time, 8, 40, scene.feed_length)
    mirrored = fly(line._replace(stroke=-line.stroke), time, 8, 40, scene.feed_length)
    for own, other in zip((-z, free, wrap), mirrored, strict=True):
        np.testing.assert_array_equal(own, other)


@pytest.mark.parametrize("changes", [{"tension": 0.01}, {"speed": 40.0}, {"guide_friction": 0.4}, {"feed": "tail"}])
def test_the_string_stays_bounded_where_it_is_slack_or_fast(changes):
    scene = winding_scene(**{"turns_per_cycle": 1.55, "feed_length": 9.0 if "feed" in changes else 0.3} | changes)
    z, free, wrap = path(scene, times_of(scene, 3000))
    assert np.all(np.isfinite(free))
    assert np.abs(z).max() <= 1.1 * (scene.stroke / 2 + scene.guide_clearance)
    assert np.ptp(free) < 0.1 * scene.feed_length
    assert wrap.max() < math.pi / 2


def test_finer_cells_change_the_path_and_the_length_little():
    scene = winding_scene(turns_per_cycle=1.55)
    time = times_of(scene, 1500)
    coarse, fine = (fly(line_of(scene), time, 8 * n, 40 * n, scene.feed_length) for n in (1, 3))
    assert coarse[0] == pytest.approx(fine[0], abs=2e-4)
    assert np.std(coarse[1] - fine[1]) < 0.1 * np.std(fine[1])


def test_both_feeds_answer_a_step_of_speed_by_the_impedance():
    """Matched: ρcΔu that fades with the feed's memory; tail: it comes back reversed after 2ℓ/c."""
    scene = winding_scene(speed_rise=0.0, feed_memory=0.02)
    time = np.arange(400) * 0.1e-3
    faster = scene.speed + 0.1
    for feed in ("active", "tail"):
        own = replace(scene, feed=feed, feed_length=4.0)
        line, state = line_of(own), new_feed(time.size)
        tension = np.array([tension_at(line, state, time, k, faster * 0.1e-3, 0.0) for k in range(1, time.size)])
        if feed == "active":
            expected = own.tension + own.impedance * 0.1 * np.exp(-time[:-1] / own.feed_memory)
            assert tension == pytest.approx(expected, rel=1e-3)
        else:
            echo = 2 * own.feed_length / own.wave_speed
            before, after = time[1:] < 0.9 * echo, (time[1:] > 1.2 * echo) & (time[1:] < 1.8 * echo)
            assert tension[before] == pytest.approx(own.tension + own.impedance * faster)
            assert tension[after] == pytest.approx(own.tension - own.impedance * faster, abs=1e-6)


def test_modes_agree_on_a_short_package_whose_guide_hardly_stops_turning_round():
    scene = winding_scene(turns_per_cycle=1.55, element_length=4e-3, duration=0.25)
    fast, reference = (wind(replace(scene, mode=mode)) for mode in ("fast", "reference"))
    settled = fast.time > 0.1
    phase = (fast.guide_phase[settled] % 1 * 20).astype(int)
    cycle = [[result.span_tension[settled][phase == k].mean() for k in range(20)] for result in (fast, reference)]
    assert np.corrcoef(*cycle)[0, 1] > 0.85
