"""Two yarns in view: one of them is measured, or neither, and never what is between. Frames are synthetic."""

import math

import numpy as np
import pytest
from yarn_frames import clip, yarn

from pipeline.measure.axis import find_axis
from pipeline.measure.yarn import measure_yarn
from pipeline.records import FrameFlag, Scale
from pipeline.synthetic import Optics

SHAPE = (300, 400)
DIAMETERS = (32.0, 28.0)
SLOPES = (0.6, -0.5)


def two(seed, *, angles, offsets, brightness=1.0):
    """A frame of two yarns, the first in front of the second; and their twists [1/px]."""
    optics = (Optics(), Optics(yarn=0.5 * brightness))
    (front, first), (behind, second) = (
        yarn(
            seed + 50 * i, shape=SHAPE, tan_beta=SLOPES[i], angle=angles[i],
            diameter=DIAMETERS[i], offset=offsets[i], phase=0.6 * seed, optics=optics[i],
        )
        for i in range(2)
    )  # fmt: skip
    angle = math.radians(angles[0])
    right, up = np.arange(SHAPE[1]) - (SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2 - np.arange(SHAPE[0])[:, None]
    across = np.abs(right * math.sin(angle) - up * math.cos(angle) - offsets[0])
    hidden = np.clip((DIAMETERS[0] / 2 + 2 - across) / 2, 0, 1)  # blurred as an edge is
    image = np.where(hidden > 0, hidden * front + (1 - hidden) * behind, np.maximum(front, behind))
    return np.round(image).astype(np.uint16), (first, second)


@pytest.mark.parametrize("brightness", [1.0, 1.4])
def test_of_two_crossing_yarns_one_is_measured(brightness):
    angles = (20.0, 85.0)
    frames = [two(seed, angles=angles, offsets=(0.0, 0.0), brightness=brightness) for seed in range(3)]
    m = measure_yarn(clip([image for image, _ in frames]), Scale(1.0, 0.0), cylinder_axis=None)
    which = int(abs(math.degrees(m.axis_angle[0]) - angles[1]) < 1)
    assert np.degrees(m.axis_angle) == pytest.approx(angles[which], abs=0.1)
    assert m.summary["diameter"].mean == pytest.approx(DIAMETERS[which], rel=0.02)
    assert m.summary["twist"].mean == pytest.approx(frames[0][1][which], rel=0.05)


@pytest.mark.parametrize("apart", [20.0, 25.0, 31.0, 34.0])
@pytest.mark.parametrize("brightness", [0.5, 1.0, 1.4])
def test_two_yarns_side_by_side_are_no_thick_one(apart, brightness):
    """Half hidden, touching, and 4 px apart: without looking for a groove they had a diameter of 50 to 65 px."""
    image, _ = two(1, angles=(30.0, 30.0), offsets=(0.0, apart), brightness=brightness)
    m = measure_yarn(clip([image]), Scale(1.0, 0.0), cylinder_axis=None)
    assert m.flag[0] & (FrameFlag.DIAMETER_NOT_CREDIBLE | FrameFlag.NO_YARN)
    assert math.isnan(m.diameter[0])
    assert math.isnan(m.twist[0])


@pytest.mark.parametrize("light", [-1.0, 0.0, 0.6])
@pytest.mark.parametrize("background", [0.06, 0.8])
def test_a_single_yarn_has_no_groove(light, background):
    image, _ = yarn(
        3,
        shape=SHAPE,
        tan_beta=0.15,
        angle=60.0,
        diameter=40.0,
        optics=Optics(light_angle=light, background=background),
    )
    assert find_axis(image).groove < 0.1
