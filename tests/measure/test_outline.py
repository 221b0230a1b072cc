"""The outline of plied yarn: how deep its scallops are, how many a turn has, and what is told by them."""

import math

import numpy as np
import pytest
from yarn_frames import clip, yarn

from pipeline.measure.axis import find_axis
from pipeline.measure.outline import (
    Scallops,
    depth,
    find_scallops,
    scallops,
    slope_share,
    steep_as,
    strands_seen,
    why_not_of,
)
from pipeline.measure.twist import strand_slope
from pipeline.measure.yarn import measure_yarn
from pipeline.records import FrameFlag, Scale

SHAPE = (220, 300)


def half_width(plies, turn):
    """Half the width of strands of radius 1 that touch, on one side, at the helix' angle [rad]."""
    places = turn[:, None] + 2 * np.pi * np.arange(plies) / plies
    return 1 + np.cos(places).max(axis=1) / math.sin(math.pi / plies)


def one_frame(seed, plies, **scene):
    shown = {"tan_beta": 0.8, "angle": 35.0, "diameter": 36.0, "phase": 0.7 * seed, **scene}
    return yarn(seed, shape=SHAPE, material={"plies": plies}, **shown)


@pytest.mark.parametrize("plies", [2, 3, 4, 5])
def test_depth_and_slope_are_those_of_circles_that_touch(plies):
    turn = 2 * np.pi * np.arange(5000) / 5000
    width = half_width(plies, turn)
    assert depth(plies) == pytest.approx(2 * np.mean(width * np.cos(plies * turn)) / width.mean(), rel=1e-3)
    in_front = np.array([-1, 1]) * math.pi / plies
    gamma = np.arcsin(np.sin(in_front) / math.sin(math.pi / plies) / width.mean())
    assert slope_share(plies) == pytest.approx(np.diff(gamma)[0] / np.diff(in_front)[0], rel=1e-6)


def test_the_strongest_period_of_both_edges_with_a_hair_and_a_gap():
    x = np.arange(400)
    turn = 2 * np.pi * 0.01 * x
    edges = 10 * np.stack([half_width(3, turn + 0.3), half_width(3, turn + 0.3 + np.pi)]) + 0.005 * x
    width = float(edges.mean())
    edges[0, 100:103] += 30
    edges[1, 200:230] = np.nan
    found = scallops(edges, width, blur=0.0)
    assert found.frequency == pytest.approx(0.03, rel=0.01)
    # the average along the yarn, that `outline` takes and these edges have not seen
    average = math.exp(-2 * (math.pi * 0.03 * 2) ** 2)
    assert found.amplitude * average == pytest.approx(depth(3), rel=0.06)
    assert found.share > 0.8
    assert found.periods == pytest.approx(12, rel=0.01)
    edges[0, :120] = np.nan
    edges[1, 40:] = np.nan
    assert scallops(edges, width, blur=0.0) is None


@pytest.mark.parametrize("plies", [2, 3, 4])
def test_strands_are_counted_in_rendered_frames(plies):
    for seed in range(3):
        image, twist = one_frame(seed, plies, diameter=28.0 + 6 * seed, tan_beta=(0.6 + 0.2 * seed) * (-1) ** seed)
        axis = find_axis(image)
        found, slope = find_scallops(image, axis), strand_slope(image, axis)
        assert found.frequency == pytest.approx(plies * abs(twist), rel=0.05)
        assert 0.8 < found.amplitude / depth(plies) < 1.15
        assert math.copysign(1, slope) == math.copysign(1, twist)
        assert strands_seen(found, slope) == plies
        assert not why_not_of(found, plies, slope)
        for wrong in {plies - 1, plies + 1} - {1}:
            assert why_not_of(found, wrong, slope)


def test_a_single_yarn_has_no_strands():
    for seed in range(3):
        image, _ = one_frame(seed, 1, tan_beta=0.5)
        axis = find_axis(image)
        found, slope = find_scallops(image, axis), strand_slope(image, axis)
        assert not strands_seen(found, slope)
        assert all(why_not_of(found, plies, slope) for plies in (2, 3, 4))


def test_depth_alone_tells_two_strands_from_three_and_is_no_proof_where_none_are_said_to_be():
    found = Scallops(frequency=0.03, amplitude=0.25, share=0.9, periods=10.0)
    assert not why_not_of(found, 2, 0.0)
    assert "those of 2 strands, not of 3" in why_not_of(found, 3, 0.0)
    assert strands_seen(found, 0.0) == 0


@pytest.mark.parametrize(("plies", "said"), [(4, 3), (3, 2), (2, 3)])
def test_a_wrong_count_of_strands_gives_no_number(plies, said):
    images = [one_frame(seed, plies)[0] for seed in range(2)]
    m = measure_yarn(clip(images), Scale(1.0, 0.0), cylinder_axis=None, method="ply", plies=said)
    assert np.all(np.isnan(m.twist))
    assert np.all(np.isnan(m.diameter))
    assert f"those of {plies} strands, not of {said}" in m.reason


def test_a_plied_yarn_measured_as_a_single_one_gives_no_number():
    images = [one_frame(seed, 3)[0] for seed in range(4)]
    m = measure_yarn(clip(images), Scale(1.0, 0.0), cylinder_axis=None)
    assert np.all(np.isnan(m.twist))
    assert np.all(np.isnan(m.diameter))
    assert np.all(m.flag & FrameFlag.TWIST_NOT_CREDIBLE)
    assert np.all(m.flag & FrameFlag.DIAMETER_NOT_CREDIBLE)
    assert "the outline is that of a plied yarn, of 3 strands as it seems" in m.reason


def test_a_period_that_holds_for_long_needs_less_of_the_outline():
    twist = 0.01
    few, many = (Scallops(4 * twist, depth(4), 0.4, periods) for periods in (4.0, 12.0))
    assert strands_seen(few, slope_share(4) * twist) == 0
    assert strands_seen(many, slope_share(4) * twist) == 4


def test_strands_are_as_steep_as_what_is_on_the_face():
    assert steep_as(4, 0.01, -0.8 * slope_share(4) * 0.01)
    assert not steep_as(4, 0.0017, slope_share(4) * 0.01)
    assert steep_as(4, 0.01, 0.0)
