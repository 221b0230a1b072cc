"""Photron .mraw with .cihx: the real sample against pyMRAW, and files of known pixels."""

import hashlib
import shutil

import numpy as np
import pytest
from video_files import SAMPLES, random_frames, write_mraw

from pipeline.errors import InputError
from pipeline.ingest.video import open_video

PYMRAW_SHA256 = "72e92de42669032f6b77b6ff301a4e466c466ef9c1c465bcd46f8f4ce0907a2e"
"""Of the sample's 15 frames as little-endian 16-bit pixels, as pyMRAW 0.33.0 reads them."""


@pytest.fixture
def ball():
    folder = SAMPLES.parent / "mraw"
    if not folder.is_dir():
        pytest.skip("the Photron sample is missing (../shared/samples/mraw)")
    return folder / "ball_12bit.mraw"


@pytest.mark.parametrize("suffix", [".mraw", ".cihx"])
def test_the_sample_by_either_name(ball, suffix):
    video = open_video(ball.with_suffix(suffix))
    assert (len(video.frames), video.shape, video.bits, video.rate) == (15, (384, 384), 12, 30000.0)
    digest = hashlib.sha256()
    for i in range(15):
        digest.update(video.frames.frame(i).astype("<u2").tobytes())
    assert digest.hexdigest() == PYMRAW_SHA256
    assert float(video.metadata["exposure_s"]) == pytest.approx(1 / 50000)
    other = {".mraw": ".cihx", ".cihx": ".mraw"}[suffix]
    assert video.metadata["beside"].startswith(f"ball_12bit{other}, SHA-256 ")


def test_rows_are_top_down(ball):
    """A dark ball falls towards a textured floor on a bright background, under which it is dark."""
    frames = open_video(ball).frames
    first, last = (frames.frame(i)[:300].astype(float) for i in (0, 14))
    rows = np.arange(300)
    heights = [float(rows @ (4095 - image).sum(axis=1) / (4095 - image).sum()) for image in (first, last)]
    assert heights[1] > heights[0] + 20
    assert frames.frame(0)[-8:].mean() < 0.1 * frames.frame(0)[:8].mean()


def test_a_contradicting_rate_is_named(ball):
    video = open_video(ball, fps=25.0)
    assert video.rate == 30000.0
    assert "the given rate of 25 1/s contradicts" in video.metadata["rate"]


@pytest.mark.parametrize("suffix", [".mraw", ".cihx"])
def test_a_missing_partner_is_named(ball, tmp_path, suffix):
    path = shutil.copy(ball.with_suffix(suffix), tmp_path)
    other = {".mraw": "'ball_12bit.cihx' or 'ball_12bit.cih'", ".cihx": "'ball_12bit.mraw'"}[suffix]
    with pytest.raises(InputError, match=f"{other} is not beside it"):
        open_video(tmp_path / path)


@pytest.mark.parametrize(("stated", "seconds"), [("50000", 1 / 50000), ("1/800000", 1 / 800000)])
def test_shutter_and_saved_steps_of_the_older_header(tmp_path, stated, seconds):
    frames = random_frames(3, 4, 8, 16, 12)
    write_mraw(tmp_path / "a.mraw", frames, 16, 12).unlink()
    keys = {
        "Record Rate(fps)": 60000, "Shutter Speed(s)": stated, "Total Frame": 4, "Save Step": 36, "Image Width": 16,
        "Image Height": 8, "Color Type": "Mono", "Color Bit": 16, "File Format": "MRaw", "EffectiveBit Depth": 12,
        "EffectiveBit Side": "Lower", "Comment Text": "",
    }  # fmt: skip
    text = "#Camera Information Header\n" + "".join(f"{key} : {value}\n" for key, value in keys.items())
    (tmp_path / "a.cih").write_text(text + "\n#Device Information:\nColor Bit : 99\n")
    video = open_video(tmp_path / "a.mraw")
    assert video.rate == pytest.approx(60000 / 36)
    assert video.bits == 12
    assert float(video.metadata["exposure_s"]) == pytest.approx(seconds)
    np.testing.assert_array_equal(video.frames.frame(3), frames[3])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<type>Raw", "<type>Color", "colour"),
        ("<bit>12<", "<bit>36<", "36 bits per pixel"),
        ("<width>16<", "<width>x<", "resolution/width: found 'x'"),
        ("<width>16<", "<width>900000<", "where one frame needs"),
        ("Mraw<", "Avi<", "file format 'Avi'"),
        ("</cih>", "", "cut short"),
        ("</recordInfo>", "", "damaged header"),
        ("<cih>", "", r"no <cih> element"),
        ("<recordRate>1024<", "<recordRate>0<", "give the recording rate"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path, old, new, message):
    header = write_mraw(tmp_path / "a.mraw", random_frames(0, 3, 8, 16, 12), 12, 12)
    text = header.read_text()
    assert old in text
    header.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message):
        open_video(tmp_path / "a.mraw")


def test_more_pixels_than_the_header_says(tmp_path):
    frames = random_frames(0, 5, 8, 16, 12)
    header = write_mraw(tmp_path / "a.mraw", frames, 12, 12)
    header.write_text(header.read_text().replace("<totalFrame>5", "<totalFrame>3"))
    video = open_video(header)
    assert len(video.frames) == 3
    assert video.metadata["frames"] == "the header states 3 frames, the file holds 5"
