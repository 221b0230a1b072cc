"""Following the yarn from frame to frame: it saves time and must change nothing else. Frames are synthetic."""

import math

import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.measure import yarn
from pipeline.measure.axis import find_axis
from pipeline.measure.yarn import CHUNK, measure_yarn
from pipeline.records import CylinderAxis, FrameFlag, RawVideo, Scale, Source
from pipeline.synthetic import Material, render_frame

SHAPE = (256, 400)
DIAMETER = 30.0
TWIST = 0.006


class Repeated:
    """Frames in memory, over and over; None cannot be read."""

    def __init__(self, images, count):
        self.images, self.count = images, count

    def __len__(self):
        return self.count

    def frame(self, index):
        image = self.images[index % len(self.images)]
        if image is None:
            raise InputError("stack", f"frame {index} is truncated", "a whole frame")
        return image


def render(seed, angle, offset, *, material=None):
    rng = np.random.default_rng(seed)
    return render_frame(
        material or Material.draw(np.random.default_rng(0), fibre_length=3),
        rng,
        shape=SHAPE,
        axis_angle=math.radians(angle),
        diameter=DIAMETER,
        twist=TWIST,
        offset=offset,
        phase=0.7 * seed,
        travel=11.0 * seed,
    )


@pytest.fixture(scope="module")
def steady():
    """One yarn that swings slowly: angle [°] and frames."""
    angles = 30 + 4 * np.sin(np.arange(40) / 6)
    material = Material.draw(np.random.default_rng(0), fibre_length=3)
    return angles, [render(i, angle, 6 * math.sin(i / 4), material=material) for i, angle in enumerate(angles.tolist())]


def measured(images, count=None, **kwargs):
    count = count or len(images)
    video = RawVideo(Source("stack", "", 0), Repeated(images, count), np.arange(count) / 1200, 1200.0, 12, SHAPE)
    return measure_yarn(video, Scale(5e-6, 0.002), cylinder_axis=CylinderAxis(math.pi / 2), **kwargs)


def test_a_followed_axis_is_the_one_that_a_search_finds(steady):
    """Two cuttings of one frame differ by the scatter of hairs and pixels, not on average."""
    angles, images = steady
    before, ratios = None, []
    for angle, image in zip(angles, images, strict=True):
        pixels = image.astype(np.float32)
        alone, before = find_axis(pixels), find_axis(pixels, before)
        assert math.degrees(before.angle) == pytest.approx(angle, abs=0.1)
        assert before.angle == pytest.approx(alone.angle, abs=math.radians(0.02))
        x, y = before.centre[0] - alone.centre[0], before.centre[1] - alone.centre[1]
        assert abs(x * math.sin(before.angle) + y * math.cos(before.angle)) < 0.1
        ratios.append(before.diameter / alone.diameter)
    np.testing.assert_allclose(ratios, 1, atol=0.01)
    assert np.mean(ratios) == pytest.approx(1, abs=0.001)


def test_following_recovers_after_a_blank_frame_a_broken_one_and_a_jump(steady):
    angles, images = steady
    blank = np.full(SHAPE, 250, np.uint16)
    noise = np.random.default_rng(1).normal(250, 8, SHAPE).round().astype(np.uint16)
    far, farther = render(50, 120, 30), render(51, 32, -70)
    clip = [*images[:3], blank, images[3], None, images[4], noise, images[5], far, images[6], farther, images[7]]
    m = measured(clip)
    no_yarn, unreadable = FrameFlag.NO_YARN, FrameFlag.UNREADABLE
    assert list(m.flag) == [0, 0, 0, no_yarn, 0, unreadable, 0, no_yarn, 0, 0, 0, 0, 0]
    seen = np.degrees(m.axis_angle[m.flag == 0])
    np.testing.assert_allclose(seen, [*angles[:6], 120, angles[6], 32, angles[7]], atol=0.1)
    np.testing.assert_allclose(m.diameter[m.flag == 0], 150e-6, rtol=0.02)


def test_a_yarn_that_turns_far_between_frames_is_searched_for():
    """Turned by 22.5° the yarn still crosses the old strip, and a line through half of it can be fitted there."""
    material = Material.draw(np.random.default_rng(5), fibre_length=10)
    angles = np.arange(0, 180, 22.5) + 19
    images = [render(60 + i, angle, 5 - i, material=material) for i, angle in enumerate(angles.tolist())]
    m = measured([*images, *images[::-1]])
    np.testing.assert_allclose(np.degrees(m.axis_angle), [*angles, *angles[::-1]], atol=0.1)


def render_narrow():
    """A bright line of 12 px on the axis of the first steady frame."""
    rows, columns = np.indices(SHAPE)
    across = (columns + 0.5 - 200) * math.sin(math.radians(30)) + (rows + 0.5 - 128) * math.cos(math.radians(30))
    return np.where(np.abs(across) < 6, 2000, 250).astype(np.float32)


def test_an_axis_is_not_followed_onto_something_else(steady):
    """The yarn leaves; where it was stands a line of half its width, which a search would not call the same yarn."""
    _, images = steady
    before = find_axis(images[0].astype(np.float32))
    narrow = render_narrow()
    found = find_axis(narrow, before)
    alone = find_axis(narrow)
    assert (found is None) == (alone is None)
    assert found is None or found[:-1] == alone[:-1]


def test_numbers_do_not_depend_on_the_number_of_threads(steady):
    _, images = steady
    count = 2 * CHUNK + 5
    one, three = measured(images, count, threads=1), measured(images, count, threads=3)
    for name in ("axis_angle", "twist", "diameter", "confidence", "flag"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))
    assert one.summary == three.summary


@pytest.mark.parametrize("sequential", [False, True])
def test_only_a_few_chunks_are_read_ahead(steady, monkeypatch, sequential):
    """Whatever the clip's length: one chunk for each thread, one that waits and one that is being read."""
    _, images = steady
    ahead, done = [], 0

    class Watched(Repeated):
        def frame(self, index):
            ahead.append(index + 1 - done)
            return super().frame(index)

    def measure_chunk(frames, *rest):
        nonlocal done
        found = original(frames, *rest)
        done += len(found)
        return found

    original = yarn._measure_chunk
    monkeypatch.setattr(yarn, "_measure_chunk", measure_chunk)
    count = 8 * CHUNK
    time = np.arange(count) / 1200
    video = RawVideo(Source("s", "", 0), Watched(images, count), time, 1200.0, 12, SHAPE, sequential=sequential)
    measure_yarn(video, Scale(5e-6), cylinder_axis=None, threads=2)
    assert max(ahead) <= (2 + 2) * CHUNK


def with_cylinder(images):
    """A brighter half plane, the cylinder's face, whose edge crosses the frame at 82°."""
    rows, columns = np.indices(SHAPE)
    beyond = (columns - 250) * math.sin(math.radians(82)) + (rows - 128) * math.cos(math.radians(82)) > 0
    return [np.where(beyond, np.maximum(image, 700), image) for image in images]


def with_thin_yarn(images):
    """A second yarn, as bright and 9 px wide, which crosses nothing and runs at 100°."""
    rows, columns = np.indices(SHAPE)
    across = (columns - 60) * math.sin(math.radians(100)) + (rows - 128) * math.cos(math.radians(100))
    return [np.where(np.abs(across) < 4.5, 2000, image).astype(np.uint16) for image in images]


@pytest.mark.parametrize("disturbed", [with_cylinder, with_thin_yarn])
def test_the_cylinder_s_edge_or_a_second_thin_yarn_does_not_capture_the_axis(steady, disturbed):
    angles, images = steady
    m = measured(disturbed(images[:18]))
    np.testing.assert_allclose(np.degrees(m.axis_angle), angles[:18], atol=0.15)
    np.testing.assert_allclose(m.diameter, 150e-6, rtol=0.03)
