"""What the frames of one clip must have in common before it has numbers. Frames are synthetic."""

import math

import cv2
import numpy as np
import pytest
from yarn_frames import clip, yarn

from pipeline.measure.yarn import measure_yarn
from pipeline.records import FrameFlag, Scale
from pipeline.synthetic import Material, Optics, render_frame

SHAPE = (220, 280)


def measured(hands):
    rng = np.random.default_rng(3)
    material = Material.draw(rng)
    images = [
        render_frame(material, rng, shape=SHAPE, axis_angle=0.5, diameter=36.0, twist=hand / 150, phase=0.3 * i)
        for i, hand in enumerate(hands)
    ]
    return measure_yarn(clip(images), Scale(1.0, 0.0), cylinder_axis=None)


def test_a_few_frames_that_tell_the_other_hand_do_not_count():
    found = measured([1, 1, 1, -1, 1, 1, 1, 1])
    assert found.handedness == "Z"
    assert found.summary["twist"].mean == pytest.approx(1 / 150, rel=0.03)
    assert found.summary["twist"].n == 7
    assert math.isnan(found.twist[3])
    assert found.flag[3] & FrameFlag.TWIST_NOT_CREDIBLE
    assert "7 frames tell Z and 1 tell S" in found.reason


def test_a_clip_of_both_hands_has_no_twist():
    found = measured([1, -1, 1, -1, 1])
    assert found.handedness == ""
    assert np.all(np.isnan(found.twist))
    assert np.all(found.flag & FrameFlag.TWIST_NOT_CREDIBLE)
    assert "3 frames tell Z and 2 tell S" in found.reason


@pytest.mark.parametrize("seed", range(4))
def test_clouds_have_no_angle(seed):
    noise = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal((300, 400)), (0, 0), 3.0 + 2 * seed)
    image = np.clip(2000 + 500 * noise / noise.std(), 0, 4095).astype(np.uint16)
    found = measure_yarn(clip([image] * 3), Scale(1.0, 0.0), cylinder_axis=None)
    assert np.all(found.flag & FrameFlag.NO_YARN)
    assert math.isnan(found.summary["axis_angle"].mean)


@pytest.mark.parametrize(("sharp", "given"), [(1, False), (2, True)])
def test_a_diameter_in_few_of_the_frames_is_chance(sharp, given):
    images = [
        yarn(i, shape=SHAPE, tan_beta=0.4, angle=40, diameter=36.0, optics=Optics(defocus=0.0 if i < sharp else 6.0))[0]
        for i in range(5)
    ]
    found = measure_yarn(clip(images), Scale(1.0, 0.0), cylinder_axis=None)
    assert np.count_nonzero(found.flag & FrameFlag.DIAMETER_NOT_CREDIBLE) == (5 - sharp if given else 5)
    assert math.isfinite(found.summary["diameter"].mean) == given
