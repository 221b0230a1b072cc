"""JPEG: gray, or the stored luma of a colour picture; whole files only."""

import math
import os
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import InputError
from pipeline.ingest.jpeg import read_jpeg
from pipeline.ingest.video import open_video

PROGRESSIVE = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
FORMS = {
    "4:2:0": (),
    "4:4:4": (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),
    "4:2:2": (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422),
    "4:4:0": (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_440),
    "4:1:1": (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411),
    "restarts": (cv2.IMWRITE_JPEG_RST_INTERVAL, 3),
    "own tables": (cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    "progressive": PROGRESSIVE,
    "progressive, restarts": (*PROGRESSIVE, cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
}
HERE = Path("a.jpg")


def picture(seed, rows=60, columns=84, blur=2.0):
    noise = np.random.default_rng(seed).standard_normal((rows, columns, 3))
    smooth = cv2.GaussianBlur(noise, (0, 0), blur) if blur else noise
    return np.clip(128 + 50 * smooth / smooth.std(), 0, 255).astype(np.uint8)


def jpeg(image, quality=90, form="4:2:0"):
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality, *FORMS[form]])[1].tobytes()


def with_exif(data, order, orientation):
    exif = b"Exif\0\0" + (b"MM" if order == ">" else b"II")
    exif += struct.pack(f"{order}HIHHHIHHI", 42, 8, 1, 274, 3, 1, orientation, 0, 0)
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:]


@given(st.data())
@settings(max_examples=80, deadline=None)
def test_every_whole_file_is_read(data):
    """Of any size, sampling, quality and order of the coefficients: nothing whole is taken for damaged."""
    rows, columns = data.draw(st.integers(1, 70)), data.draw(st.integers(1, 70))
    image = picture(data.draw(st.integers(0, 2**32)), rows, columns, data.draw(st.sampled_from([0.0, 1.0, 4.0])))
    if data.draw(st.booleans()):
        image = image[..., 0]
    coded = jpeg(image, data.draw(st.integers(1, 100)), data.draw(st.sampled_from(sorted(FORMS))))
    found = read_jpeg(HERE, coded)
    assert found.shape == (rows, columns)
    np.testing.assert_array_equal(found, cv2.imdecode(np.frombuffer(coded, np.uint8), cv2.IMREAD_GRAYSCALE))


@pytest.mark.parametrize("form", FORMS)
def test_colour_is_its_luma(tmp_path, form):
    """At the highest quality, where only rounding is left of the loss."""
    image = picture(1)
    (tmp_path / "a.jpg").write_bytes(jpeg(image, 100, form))
    video = open_video(tmp_path / "a.jpg", fps=1.0)
    assert video.metadata["compression"] == "JPEG: lossy, in blocks of 8 × 8 pixels"
    assert "measured on the luma" in video.metadata["colour"]
    luma = image @ np.array([0.114, 0.587, 0.299])
    assert np.max(np.abs(video.frames.frame(0) - luma)) < 2


def test_the_colour_of_a_gray_jpeg_makes_no_difference():
    """Coded with neutral chroma or without any, the same luma."""
    gray = picture(2)[..., 0]
    coded = jpeg(np.repeat(gray[..., None], 3, axis=2), 75)
    np.testing.assert_array_equal(read_jpeg(HERE, coded), read_jpeg(HERE, jpeg(gray, 75)))


def test_a_folder_of_jpegs(tmp_path):
    images = [picture(seed) for seed in range(3)]
    for i, image in enumerate(images):
        (tmp_path / f"yarn_{i}.JPG").write_bytes(jpeg(image))
    video = open_video(tmp_path, fps=10.0)
    assert video.metadata["format"] == "folder of .jpg"
    assert video.metadata["compression"].startswith("JPEG: lossy")
    for i, image in enumerate(images):
        np.testing.assert_array_equal(video.frames.frame(i), read_jpeg(HERE, jpeg(image)))
    cv2.imwrite(str(tmp_path / "yarn_3.png"), images[0])
    with pytest.raises(InputError, match=r"several kinds \(\.jpg, \.png\)"):
        open_video(tmp_path, fps=10.0)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_is_shown_as_it_was_held(orientation):
    """The corners that EXIF names: the first stored row is at the shown top, right …, the first column at …."""
    first_row, first_column = {
        1: ("top", "left"), 2: ("top", "right"), 3: ("bottom", "right"), 4: ("bottom", "left"),
        5: ("left", "top"), 6: ("right", "top"), 7: ("right", "bottom"), 8: ("left", "bottom"),
    }[orientation]  # fmt: skip
    stored = np.full((32, 48), 100, np.uint8)
    stored[:8], stored[:, :8] = 160, 40
    shown = read_jpeg(HERE, with_exif(jpeg(stored, 100), "<" if orientation % 2 else ">", orientation)).astype(int)
    side = {"top": shown[0], "bottom": shown[-1], "left": shown[:, 0], "right": shown[:, -1]}
    assert np.median(side[first_row]) == pytest.approx(160, abs=2)
    assert np.median(side[first_column]) == pytest.approx(40, abs=2)
    assert shown.shape == ((32, 48) if orientation <= 4 else (48, 32))


def test_what_is_no_jpeg_that_can_be_read(tmp_path):
    good = jpeg(picture(3))
    frame = good.index(b"\xff\xc0")
    adobe = good[:2] + b"\xff\xee\0\x0eAdobe" + bytes([0, 100, 0, 0, 0, 0, 2]) + good[2:]
    twelve, cmyk, lossless = bytearray(good), bytearray(good), bytearray(good)
    twelve[frame + 4] = 12
    cmyk[frame + 2 : frame + 10] = struct.pack(">HBHHB", 20, 8, 60, 84, 4)
    cmyk[frame + 19 : frame + 19] = b"\x04\x11\0"
    lossless[frame + 1] = 0xC3
    for data, message in (
        (bytes(twelve), "12 bits a sample; export as JPEG of 8 bits"),
        (bytes(cmyk), r"4 colour components \(CMYK\); export in gray or RGB"),
        (bytes(lossless), "lossless, hierarchical or arithmetic-coded JPEG"),
        (adobe, r"colours of an unknown kind \(2\)"),
        (with_exif(good, ">", 9), "an orientation of 9"),
        (with_exif(good, ">", 6).replace(b"MM\0*", b"XX\0*"), "damaged EXIF"),
    ):
        (tmp_path / "a.jpg").write_bytes(data)
        with pytest.raises(InputError, match=message):
            open_video(tmp_path / "a.jpg", fps=1.0)
    (tmp_path / "a.png").write_bytes(good)
    with pytest.raises(InputError, match=r"the name ends in \.png but the content is JPEG"):
        open_video(tmp_path / "a.png", fps=1.0)
    cv2.imwrite(str(tmp_path / "b.png"), picture(3))
    (tmp_path / "b.png").rename(tmp_path / "b.jpg")
    with pytest.raises(InputError, match=r"the name ends in \.jpg but the content is PNG"):
        open_video(tmp_path / "b.jpg", fps=1.0)
    (tmp_path / "c.jpg").write_bytes(b"")
    with pytest.raises(InputError, match="empty file"):
        open_video(tmp_path / "c.jpg", fps=1.0)


@pytest.mark.parametrize("form", ["4:2:0", "restarts", "progressive"])
def test_every_cut_is_seen(form):
    """Also where an end marker was put behind the cut, which decoders take for a whole picture."""
    good = jpeg(picture(4), 90, form)
    first_code = good.index(b"\xff\xda") + 14
    for end in range(0, len(good) - 1, 7):
        with pytest.raises(InputError):
            read_jpeg(HERE, good[:end])
        if form != "progressive" and first_code < end < len(good) - 4:
            with pytest.raises(InputError):
                read_jpeg(HERE, good[:end] + b"\xff\xd9")


def test_what_follows_the_end_marker_does_not_matter():
    """Phones append a second picture or a film."""
    good = jpeg(picture(4))
    np.testing.assert_array_equal(read_jpeg(HERE, good + b"\xff\xd8 a film"), read_jpeg(HERE, good))


@pytest.mark.parametrize(("form", "least"), [("4:2:0", 0.95), ("progressive", 0.8)])
def test_a_lost_sector_is_seen(form, least):
    """512 bytes that read as zero. There is no checksum: what still makes up the right number of blocks passes."""
    good = jpeg(picture(5, 240, 320), 90, form)
    rng = np.random.default_rng(6)
    seen = 0
    for at in rng.integers(good.index(b"\xff\xda") + 14, len(good) - 514, 100):
        data = bytearray(good)
        data[at : at + 512] = bytes(512)
        try:
            read_jpeg(HERE, bytes(data))
        except InputError:
            seen += 1
    assert seen / 100 >= least


def test_damaged_jpegs_in_a_folder_are_frames_that_cannot_be_read(tmp_path):
    good = jpeg(picture(7))
    for i, data in enumerate([good, good[: len(good) // 2], b"", good[:300] + bytes(200) + good[500:], good]):
        (tmp_path / f"f{i}.jpg").write_bytes(data)
    video = open_video(tmp_path, fps=1.0)
    np.testing.assert_array_equal(video.frames.frame(4), video.frames.frame(0))
    for i in (1, 2, 3):
        with pytest.raises(InputError, match=rf"frame {i}: unreadable image"):
            video.frames.frame(i)


FUZZ = """
import sys, numpy as np
from pathlib import Path
from pipeline.errors import InputError
from pipeline.ingest.video import open_video
path, outcomes = Path(sys.argv[1]), [0, 0]
rng = np.random.default_rng(8)
for good in [file.read_bytes() for file in sorted(path.parent.glob("good*"))]:
    for _ in range(250):
        data = bytearray(good)
        for at in rng.integers(2, len(data), rng.integers(1, 4)):
            data[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        try:
            image = open_video(path, fps=1.0).frames.frame(0)
            outcomes[0] += 1
        except InputError:
            outcomes[1] += 1
print(*outcomes)
"""


def test_flipped_bits_end_in_a_picture_or_in_one_error_and_silence():
    """Decoders write their warnings past Python, so another process is listened to."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for i, form in enumerate(["4:2:0", "restarts", "progressive"]):
            (folder / f"good{i}").write_bytes(jpeg(picture(9, 40, 48), 75, form))
        environment = {**os.environ, "PYTHONWARNINGS": "error"}
        call = [sys.executable, "-c", FUZZ, str(folder / "a.jpg")]
        ran = subprocess.run(call, capture_output=True, text=True, env=environment, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    read, refused = map(int, ran.stdout.split())
    assert read + refused == 750
    assert refused > 200


def test_a_still_needs_no_recording_rate_and_two_images_do(tmp_path):
    for i in range(2):
        (tmp_path / f"{i}.jpg").write_bytes(jpeg(picture(i)))
    video = open_video(tmp_path / "0.jpg")
    assert list(video.time) == [0.0]
    assert math.isnan(video.rate)
    assert video.metadata["rate"] == "none: one frame"
    with pytest.raises(InputError, match="give the recording rate: --fps"):
        open_video(tmp_path)
