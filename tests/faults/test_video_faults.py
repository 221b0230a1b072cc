"""Damaged, cut, mislabelled and foreign clips: one clear error, or the frames that are left; never anything else."""

import time

import av
import cv2
import numpy as np
import pytest
import tifffile
from video_files import KINDS, random_frames, write_clip, write_container, write_sequence

from pipeline.errors import InputError
from pipeline.ingest.video import open_video


def readable(video):
    """The frames that can be read, by index."""
    frames, errors = {}, {}
    for i in range(len(video.frames)):
        try:
            frames[i] = video.frames.frame(i)
        except InputError as error:
            errors[i] = str(error)
    assert all(f"frame {i}:" in message for i, message in errors.items())
    return frames


@pytest.mark.parametrize("kind", ["cine", "cine P12L", "mraw", "mraw packed", "tif", "mkv", "avi"])
def test_a_cut_tail_leaves_the_frames_before_it(tmp_path, kind):
    frames = random_frames(6, 20, 32, 32, 12)
    path = write_clip(tmp_path, kind, frames, 12)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])
    video = open_video(path, fps=1024.0)
    assert len(video.frames) == len(video.time) == 20
    left = readable(video)
    assert 8 <= len(left) <= 12
    assert list(left) == list(range(len(left)))
    for i, frame in left.items():
        np.testing.assert_array_equal(frame, frames[i])


def test_a_cut_compressed_tiff_keeps_its_whole_pages(tmp_path):
    frames = random_frames(6, 20, 32, 32, 12)
    path = write_clip(tmp_path, "tif deflate", frames, 12)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])
    left = readable(open_video(path, fps=1.0))
    assert 8 <= len(left) <= 12
    for i, frame in left.items():
        np.testing.assert_array_equal(frame, frames[i])


def test_a_cut_mp4_has_no_index(tmp_path):
    path = write_clip(tmp_path, "mp4", random_frames(6, 20, 32, 32, 12), 12)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])
    with pytest.raises(InputError, match="not a readable video"):
        open_video(path, fps=1.0)


@pytest.mark.parametrize(("gop", "lost"), [("1", {7}), ("5", {7, 8, 9})])
def test_a_damaged_ffv1_frame_is_not_guessed(tmp_path, gop, lost):
    """FFmpeg conceals it; the checksum in the stream tells. Frames that build on it are lost with it, up to a key."""
    frames = random_frames(6, 20, 32, 32, 12)
    path = tmp_path / "clip.mkv"
    write_container(path, frames, "gray12le", g=gop, level="3", slicecrc="1")
    with av.open(str(path)) as container:
        packets = [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size]
    data = bytearray(path.read_bytes())
    middle = packets[7][0] + packets[7][1] // 2
    data[middle : middle + 8] = bytes(b ^ 0x55 for b in data[middle : middle + 8])
    path.write_bytes(data)
    video = open_video(path, fps=1.0)
    for _ in range(2):
        left = readable(video)
        assert set(range(20)) - set(left) == lost
        for i, frame in left.items():
            np.testing.assert_array_equal(frame, frames[i])


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif"])
def test_a_damaged_image_in_a_folder(tmp_path, suffix):
    frames = random_frames(6, 5, 32, 32, 8)
    files = write_sequence(tmp_path / "frames", frames, suffix)
    files[2].write_bytes(files[2].read_bytes()[:600])
    files[3].write_bytes(b"")
    left = readable(open_video(tmp_path / "frames", fps=1.0))
    assert set(left) == {0, 1, 4}


def test_an_image_of_another_shape(tmp_path):
    frames = random_frames(6, 3, 32, 32, 8)
    files = write_sequence(tmp_path / "frames", frames, ".png")
    cv2.imwrite(str(files[1]), frames[1][:16])
    video = open_video(tmp_path / "frames", fps=1.0)
    with pytest.raises(InputError, match=r"frame 1: 32 × 16 pixels, uint8; 32 × 32 pixels, uint8, as the first frame"):
        video.frames.frame(1)


@pytest.mark.parametrize("suffix", [".cine", ".tif", ".mkv", ".avi", ".mp4", ".png", ".bmp"])
def test_empty_and_missing_files(tmp_path, suffix):
    path = tmp_path / f"clip{suffix}"
    with pytest.raises(InputError, match="cannot be read"):
        open_video(path, fps=1.0)
    path.write_bytes(b"")
    with pytest.raises(InputError, match="empty file"):
        open_video(path, fps=1.0)
    path.write_bytes(b"this is a text about yarn, and not a clip")
    with pytest.raises(InputError, match=r"readable are Phantom \.cine"):
        open_video(path, fps=1.0)


@pytest.mark.parametrize("kind", ["cine", "tif", "mkv", "avi", "mp4"])
def test_a_name_that_contradicts_the_content(tmp_path, kind):
    path = write_clip(tmp_path, kind, random_frames(6, 2, 32, 32, 8), 8)
    wrong = path.rename(path.with_suffix(".png"))
    with pytest.raises(InputError, match=r"the name ends in \.png but the content is"):
        open_video(wrong, fps=1.0)
    with pytest.raises(InputError, match="readable are"):
        open_video(wrong.rename(path.with_suffix(".dat")), fps=1.0)


def test_folders_that_are_no_sequence(tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    with pytest.raises(InputError, match="without PNG, BMP, JPEG or TIFF images"):
        open_video(folder, fps=1.0)
    image = np.zeros((16, 16), np.uint8)
    cv2.imwrite(str(folder / "a1.png"), image)
    cv2.imwrite(str(folder / "b2.png"), image)
    with pytest.raises(InputError, match="more than one sequence"):
        open_video(folder, fps=1.0)
    (folder / "b2.png").rename(folder / "a01.png")
    with pytest.raises(InputError, match="the same number"):
        open_video(folder, fps=1.0)
    (folder / "a01.png").rename(folder / "dark.png")
    with pytest.raises(InputError, match=r"'dark\.png' has no number"):
        open_video(folder, fps=1.0)
    cv2.imwrite(str(folder / "a2.bmp"), image)
    with pytest.raises(InputError, match="several kinds"):
        open_video(folder, fps=1.0)


def test_transparent_float_and_signed_pixels_are_refused(tmp_path):
    gray = random_frames(1, 2, 32, 32, 8)
    tifffile.imwrite(tmp_path / "f.tif", gray.astype(np.float32))
    tifffile.imwrite(tmp_path / "i.tif", gray.astype(np.int16))
    tifffile.imwrite(tmp_path / "w.tif", gray, photometric="miniswhite")
    tifffile.imwrite(tmp_path / "s.tif", gray[..., :3], photometric="minisblack", planarconfig="contig")
    cv2.imwrite(str(tmp_path / "a.png"), np.dstack((gray[0], gray[0], gray[0], gray[0])))
    for name, message in (
        ("f.tif", "32 bits"),
        ("i.tif", "int16"),
        ("w.tif", "photometric"),
        ("s.tif", "3 samples"),
        ("a.png", "alpha channel"),
    ):
        with pytest.raises(InputError, match=message):
            open_video(tmp_path / name, fps=1.0)


def test_gray_in_three_equal_channels_is_gray(tmp_path):
    gray = random_frames(1, 2, 32, 32, 8)
    tifffile.imwrite(tmp_path / "c.tif", np.repeat(gray[..., None], 3, axis=3), photometric="rgb")
    video = open_video(tmp_path / "c.tif", fps=1.0)
    np.testing.assert_array_equal(video.frames.frame(1), gray[1])


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("folder .tif", "tif big-endian")])
def test_damaged_bytes_never_raise_anything_else(tmp_path, kind):
    """Seeded: a few bytes are overwritten, mostly in the header; also cuts."""
    path = write_clip(tmp_path, kind, random_frames(6, 4, 16, 16, 12 if kind != "folder .bmp" else 8), 12)
    target = next(iter(sorted(path.iterdir()))) if path.is_dir() else path
    good = target.read_bytes()
    rng = np.random.default_rng(2024)
    outcomes = {"read": 0, "refused": 0}
    slowest = 0.0
    for _ in range(60):
        data = bytearray(good)
        reach = len(data) if rng.random() < 0.3 else min(len(data), 1400)
        for at in rng.integers(4, reach, rng.integers(1, 5)):
            data[at] = rng.choice([0, 1, 127, 128, 255, int(rng.integers(256))])
        target.write_bytes(data[: rng.integers(1, len(data))] if rng.random() < 0.2 else data)
        start = time.perf_counter()
        try:
            video = open_video(path, fps=1.0)
            outcomes["read" if len(readable(video)) == len(video.frames) else "refused"] += 1
        except InputError:
            outcomes["refused"] += 1
        slowest = max(slowest, time.perf_counter() - start)
    assert outcomes["refused"] >= 3, outcomes
    assert slowest < 10
