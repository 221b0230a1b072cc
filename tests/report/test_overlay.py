"""The overlay: lines where the yarn is, the frames that it says, whole or not at all."""

import math

import cv2
import numpy as np
import pytest
from yarn_frames import clip as clip_of

from pipeline.errors import InputError
from pipeline.measure.yarn import measure_yarn
from pipeline.records import CylinderAxis, FrameFlag, Scale
from pipeline.report import overlay
from pipeline.synthetic import Material, render_frame

SCALE = Scale(4e-6, 0.002)
SHAPE = (200, 320)
DIAMETER = 40.0


def measured(images):
    return measure_yarn(clip_of(images), SCALE, cylinder_axis=CylinderAxis(0.0))


@pytest.fixture(scope="module")
def images():
    """Synthetic: a Z yarn upright in the middle, the same mirrored, one frame that cannot be read."""
    rng = np.random.default_rng(1)
    material = Material.draw(rng, fibre_length=3, hairs_per_diameter=0.5)
    frame = render_frame(
        material, rng, shape=SHAPE, axis_angle=math.pi / 2, diameter=DIAMETER, twist=900 * SCALE.metres_per_pixel
    )
    return [frame, np.ascontiguousarray(frame[:, ::-1]), None]


def mean_place(picture, colour):
    """Mean column in each row of the pixels nearly of a colour, NaN where there are none."""
    near = np.abs(picture[: SHAPE[0]].astype(int) - colour).max(axis=2) < 90
    with np.errstate(invalid="ignore"):
        return near, (near @ np.arange(SHAPE[1])) / near.sum(axis=1)


def test_lines_lie_on_the_yarn(images):
    clip = measured(images)
    picture = overlay.annotated(clip, SCALE, 0)
    centre = (SHAPE[1] - 1) / 2
    _, axis = mean_place(picture, overlay.AXIS)
    assert np.nanmedian(axis) == pytest.approx(centre, abs=1)
    edges, _ = mean_place(picture, overlay.EDGE)
    columns = np.flatnonzero(edges.sum(axis=0) > 0.8 * SHAPE[0])
    assert columns.min() == pytest.approx(centre - DIAMETER / 2, abs=1.5)
    assert columns.max() == pytest.approx(centre + DIAMETER / 2, abs=1.5)


def test_fibre_lines_run_like_the_letter(images):
    """Z, upright: lower left to upper right, with tan β = π d T at the middle; mirrored it is S."""
    z, s = (measured([image]) for image in images[:2])
    assert (z.twist[0] > 0, s.twist[0] < 0) == (True, True)
    slopes = []
    for clip in (z, s):
        near, _ = mean_place(overlay.annotated(clip, SCALE, 0), overlay.FIBRE)
        middle = near[:, SHAPE[1] // 2 - 6 : SHAPE[1] // 2 + 6]
        count, labels = cv2.connectedComponents(middle.astype(np.uint8), connectivity=8)
        points = [np.argwhere(labels == i) for i in range(1, count)]
        slopes.append(np.median([np.polyfit(p[:, 0], p[:, 1], 1)[0] for p in points if np.ptp(p[:, 0]) > 8]))
    expected = math.pi * 900 * DIAMETER * SCALE.metres_per_pixel
    assert slopes[0] == pytest.approx(-expected, rel=0.25)  # rows count downwards
    assert slopes[1] == pytest.approx(expected, rel=0.25)


def test_an_unreadable_frame_says_so_in_red(images):
    clip = measured([images[0], images[2]])
    assert clip.flag[1] == FrameFlag.UNREADABLE
    picture = overlay.annotated(clip, SCALE, 1)
    assert not picture[: SHAPE[0]].any()
    band = picture[SHAPE[0] :].astype(int)
    assert np.any(band[..., 2] - band[..., 0] > 100)
    good = overlay.annotated(clip, SCALE, 0)[SHAPE[0] :].astype(int)
    assert not np.any(good[..., 2] - good[..., 0] > 100)


def test_few_frames_are_all_drawn_many_evenly(images, tmp_path, monkeypatch):
    clip = measured(images)
    assert overlay.write_overlay(clip, SCALE, tmp_path / "few") == [0, 1, 2]
    assert sorted(p.name for p in (tmp_path / "few").iterdir()) == [
        "contact_sheet.png", "frame_0.png", "frame_1.png", "frame_2.png",
    ]  # fmt: skip
    long = measured([images[0], *[images[2]] * 99])
    drawn = overlay.write_overlay(long, SCALE, tmp_path / "few")
    assert len(drawn) == 24
    assert (drawn[0], drawn[-1]) == (0, 99)
    assert set(np.diff(drawn)) == {4, 5}
    assert len(list((tmp_path / "few").iterdir())) == 25
    sheet = cv2.imread(str(tmp_path / "few" / "contact_sheet.png"))
    assert sheet is not None
    assert sheet.shape[1] == 4 * 400 + 3 * 6


def test_whole_or_not_at_all(images, tmp_path, monkeypatch):
    clip = measured(images[:1])
    folder = tmp_path / "overlay"
    overlay.write_overlay(clip, SCALE, folder)
    before = {p.name: p.read_bytes() for p in folder.iterdir()}

    def fail(_):
        raise RuntimeError("no more")

    monkeypatch.setattr(overlay, "_sheet", fail)
    with pytest.raises(RuntimeError, match="no more"):
        overlay.write_overlay(clip, SCALE, folder)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["overlay"]
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"holds 'notes\.txt', which is not part of an overlay"):
        overlay.check_folder(folder)
