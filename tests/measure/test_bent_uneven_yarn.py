"""Yarn that is bent, thick here and thin there. Frames are synthetic."""

import math

import numpy as np
import pytest
from yarn_frames import clip, yarn

from pipeline.measure.axis import find_axis
from pipeline.measure.lines import step_across, unrolled
from pipeline.measure.yarn import measure_json, measure_yarn
from pipeline.records import FrameFlag, Scale

SHAPE = (300, 400)


def measured(seed, *, angle, diameter=32.0, tan_beta=0.5, **scene):
    """Three frames of one yarn, their measurement, and the twist [1/px]."""
    scene |= {"shape": SHAPE, "angle": angle, "diameter": diameter, "tan_beta": tan_beta}
    frames = [yarn(seed, phase=0.7 * i, travel=40.0 * i, **scene) for i in range(3)]
    return measure_yarn(clip([image for image, _ in frames]), Scale(1.0, 0.0), cylinder_axis=None), frames[0][1]


def off(m, angle):
    """Errors of the axis' angle [°]."""
    return np.mod(np.degrees(m.axis_angle) - angle + 90, 180) - 90


@pytest.mark.parametrize(("angle", "sagitta"), [(5.0, 6.0), (30.0, -12.0), (75.0, 12.0), (135.0, 8.0)])
def test_a_bent_yarn_has_the_angle_of_its_tangent_and_its_diameter_and_twist(angle, sagitta):
    """Before, a sagitta of 16 px made the diameter 9 % too large, or left no yarn at all."""
    bend = 8 * sagitta / 400**2
    m, twist = measured(1, angle=angle, bend=bend)
    length = find_axis(yarn(1, shape=SHAPE, tan_beta=0.5, angle=angle, diameter=32.0, bend=bend)[0]).length
    assert np.all(m.flag == FrameFlag.BENT)
    assert np.abs(off(m, angle)).max() < 0.15
    assert m.sagitta == pytest.approx(sagitta * (length / 400) ** 2, rel=0.1)
    square_to_the_axis = 32.0 * (1 - (bend * length) ** 2 / 24)
    assert m.summary["diameter"].mean == pytest.approx(square_to_the_axis, rel=0.01)
    assert m.summary["twist"].mean == pytest.approx(twist, rel=0.03)
    assert "3 of 3 frames show a bent yarn" in m.reason
    assert measure_json(m)["flag"] == ["BENT"] * 3


@pytest.mark.parametrize("hairs", [0.0, 6.0])
@pytest.mark.parametrize("angle", [10.0, 100.0])
def test_a_straight_yarn_has_no_bend(angle, hairs):
    m, _ = measured(2, angle=angle, hairs=hairs)
    assert np.all(m.flag == 0)
    assert np.all(m.sagitta == 0)
    assert np.all(m.unevenness < 0.04)


@pytest.mark.parametrize(("amplitude", "wave"), [(0.1, 60.0), (0.1, 4.0), (0.2, 10.0)])
def test_an_uneven_yarn_has_the_mean_of_its_diameters(amplitude, wave):
    """A taper (the longest wave) tilted the axis by up to 0.2°, and the mixture of widths was up to 5 % too wide."""
    m, twist = measured(3, angle=20.0, tan_beta=0.3, material={"thickness": (amplitude, wave)})
    length = find_axis(yarn(3, shape=SHAPE, tan_beta=0.3, angle=20.0, diameter=32.0)[0]).length
    along = np.linspace(-length / 2, length / 2, 1001)
    widths = np.array([1 + amplitude * np.sin(2 * math.pi / (32 * wave) * (along - 40.0 * i)) for i in range(3)])
    assert np.abs(off(m, 20.0)).max() < 0.05
    np.testing.assert_allclose(m.diameter, 32.0 * widths.mean(axis=1), rtol=0.015)
    np.testing.assert_allclose(m.unevenness, widths.std(axis=1), atol=0.02)
    assert m.summary["twist"].mean == pytest.approx(twist, rel=0.03)


@pytest.mark.parametrize("degrees", [0, 20, 45, 90, 150])
def test_a_bent_uneven_body_is_unrolled_along_its_axis(degrees):
    """The level is the distance from the parabola over the local half width: the same all along each row."""
    rows, columns = np.indices(SHAPE)
    angle, bend, taper = math.radians(degrees), 2e-4, 1e-3
    c, s = math.cos(angle), math.sin(angle)
    along = (columns - 200) * c - (rows - 150) * s
    across = (columns - 200) * s + (rows - 150) * c
    image = (100 * (across - 0.5 * bend * along**2) / (1 + taper * along)).astype(np.float32)
    q = step_across(angle)
    count = 21
    form = 1 + taper * (np.arange(count) - (count - 1) / 2) * 8 / q
    places = np.array([-12.0, 0.0, 7.5])
    found = unrolled(image, 200.0, 150.0, angle, bend, form, places, 161)
    np.testing.assert_allclose(found, np.broadcast_to(100 * places[:, None], found.shape), atol=40)
    np.testing.assert_allclose(found.mean(axis=1), 100 * places, atol=3)
