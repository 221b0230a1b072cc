"""The yarn is found where it fills the frame, and before what is brighter and darker than it. Frames are synthetic."""

import math

import numpy as np
import pytest
from yarn_frames import clip, yarn

from pipeline.measure.align import align
from pipeline.measure.axis import find_axis
from pipeline.measure.profile import relief
from pipeline.measure.yarn import measure_yarn
from pipeline.records import Scale
from pipeline.synthetic import Optics, bar

VIEW = (300, 400)


@pytest.mark.parametrize(
    ("shape", "diameter"), [((48, 400), 20.0), ((64, 400), 32.0), ((96, 400), 50.0), (VIEW, 150.0)]
)
def test_a_yarn_of_up_to_half_of_the_frame_is_measured(shape, diameter):
    """Its own edge had been taken for a thin yarn, or nothing had been found."""
    for seed in range(4):
        image, _ = yarn(seed, shape=shape, tan_beta=0.2, angle=1.0, diameter=diameter)
        found = find_axis(image)
        assert math.degrees(found.angle) == pytest.approx(1.0, abs=0.25)
        assert found.diameter == pytest.approx(diameter, rel=0.015)


def test_a_yarn_a_third_as_wide_as_the_frame_at_a_slant_is_measured():
    """Room for a dark side, that this light does not leave, had taken its whole length out of view."""
    image, _ = yarn(1, shape=(256, 256), tan_beta=0.35, angle=169.0, diameter=81.0, optics=Optics(light_angle=0.2))
    found = find_axis(image)
    assert math.degrees(found.angle) == pytest.approx(169.0, abs=0.25)
    assert found.diameter == pytest.approx(81.0, rel=0.02)


@pytest.mark.parametrize("light", [0.0, 0.6, 1.3])
@pytest.mark.parametrize("background", [0.06, 0.3, 0.8])
def test_yarn_stands_out_on_both_sides_in_any_light(light, background):
    for seed in range(3):
        optics = Optics(light_angle=light, background=background)
        image, _ = yarn(seed, shape=VIEW, tan_beta=0.2, angle=70.0, diameter=32.0, optics=optics)
        aligned = align(image, 199.5, 149.5, math.radians(70.0), 0.0, 16.0)
        assert relief(aligned.registered.profile) > 0.5


@pytest.mark.parametrize("angle", [20.0, 90.0, 152.0])
@pytest.mark.parametrize("shade", ["flat", "round"])
def test_the_edge_of_a_broad_thing_is_no_yarn(angle, shade):
    rng = np.random.default_rng(5)
    right, up = np.arange(VIEW[1]) - 199.5, 149.5 - np.arange(VIEW[0])[:, None]
    broad = bar(math.radians(angle), 250.0, 500.0, 0.6, lit=shade == "round")(right, up)
    image = np.round(4095 * (0.06 + broad) + rng.normal(0, 8, VIEW)).astype(np.uint16)
    assert find_axis(image) is None


@pytest.mark.parametrize("level", [0.2, 0.35])
@pytest.mark.parametrize("across", [60.0, 90.0, 120.0])
def test_a_yarn_darker_than_the_cylinder_and_brighter_than_what_is_behind_is_measured(level, across):
    """Both of the cylinder's edges are in view. It is round and smooth, too: the yarn is the thinner body."""
    frames = [
        yarn(
            seed, shape=VIEW, tan_beta=0.25, angle=40.0, diameter=32.0, optics=Optics(yarn=level),
            backdrop=bar(math.radians(40.0 + across), 10.0, 120.0, 0.7, lit=True),
        )[0]
        for seed in range(3)
    ]  # fmt: skip
    m = measure_yarn(clip(frames), Scale(1.0, 0.0), cylinder_axis=None)
    np.testing.assert_allclose(np.degrees(m.axis_angle), 40.0, atol=0.3)
    np.testing.assert_allclose(m.diameter, 32.0, rtol=0.04)


@pytest.mark.parametrize("edge", [-60.0, 0.0, 60.0])
def test_a_yarn_before_a_dark_and_a_bright_half_is_measured_on_one_of_them(edge):
    backdrop = bar(math.radians(80.0), edge + 400.0, 800.0, 0.7)
    for seed in range(3):
        image, _ = yarn(seed, shape=VIEW, tan_beta=0.25, angle=10.0, diameter=32.0, backdrop=backdrop)
        found = find_axis(image)
        assert math.degrees(found.angle) == pytest.approx(10.0, abs=0.2)
        assert found.diameter == pytest.approx(32.0, rel=0.03)


@pytest.mark.parametrize("background", [0.35, 0.4])
def test_a_stripe_of_the_face_of_a_yarn_as_bright_as_the_ground_is_not_taken_for_it(background):
    """Its bright middle is a round body with a quarter of the diameter, but has the rest of the yarn beside it."""
    for seed in (1, 2, 4):
        optics = Optics(background=background, light_angle=0.5)
        image, _ = yarn(seed, shape=VIEW, tan_beta=0.3, angle=20.0, diameter=100.0, optics=optics)
        m = measure_yarn(clip([image]), Scale(1.0, 0.0), cylinder_axis=None)
        assert math.isnan(m.diameter[0]) or m.diameter[0] == pytest.approx(100.0, rel=0.05)


def test_blur_counts_by_what_it_is_of_the_yarn_where_pixels_are_fine():
    """As in a photograph: twice as many pixels each way, twice the blur, the same numbers."""
    for size in (1, 2):
        image, twist = yarn(
            0, shape=(300 * size, 400 * size), tan_beta=0.25, angle=25.0, diameter=60.0 * size,
            optics=Optics(blur=2.1 * size),
        )  # fmt: skip
        m = measure_yarn(clip([image]), Scale(1.0, 0.0), cylinder_axis=None)
        assert m.diameter[0] == pytest.approx(60.0 * size, rel=0.01)
        assert m.twist[0] == pytest.approx(twist, rel=0.03)
