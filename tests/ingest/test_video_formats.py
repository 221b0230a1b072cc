"""Every format gives back the pixels that were written, at full depth, in any order, whatever the length."""

import tempfile
import tracemalloc
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from video_files import KINDS, random_frames, write_clip, write_container, write_sequence

from pipeline.errors import InputError
from pipeline.ingest.video import open_video

CASES = [(kind, bits) for kind, depths in KINDS.items() for bits in depths]


def assert_same(video, frames):
    assert len(video.frames) == len(frames)
    for i, frame in enumerate(frames):
        image = video.frames.frame(i)
        assert image.dtype == frame.dtype
        assert image.flags.c_contiguous
        np.testing.assert_array_equal(image, frame)


@pytest.mark.parametrize(("kind", "bits"), CASES, ids=str)
def test_round_trip_is_exact(tmp_path, kind, bits):
    frames = random_frames(7, 12, 22, 34, bits)
    video = open_video(write_clip(tmp_path, kind, frames, bits), fps=1024.0)
    assert_same(video, frames)
    assert (video.bits, video.shape, video.rate) == (bits, (22, 34), 1024.0)
    np.testing.assert_array_equal(video.time, np.arange(12) / 1024)
    assert "assumed" not in video.metadata["bits"] or (bits > 8 and not kind.startswith("cine"))
    for i in (11, 0, 5, 5, 6, 2, 10):
        np.testing.assert_array_equal(video.frames.frame(i), frames[i])


@given(st.data())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_shape_any_depth_any_order(data):
    kind, bits = data.draw(st.sampled_from(CASES))
    n, rows, columns = data.draw(st.tuples(st.integers(2, 9), st.integers(16, 40), st.integers(8, 20)))
    frames = random_frames(data.draw(st.integers(0, 2**32)), n, rows, 2 * columns, bits)
    order = data.draw(st.lists(st.integers(0, n - 1), min_size=1, max_size=12))
    with tempfile.TemporaryDirectory() as folder:
        video = open_video(write_clip(Path(folder), kind, frames, bits), fps=1024.0)
        for i in order:
            np.testing.assert_array_equal(video.frames.frame(i), frames[i])


@pytest.mark.parametrize("rate", [25, 1200, 3000])
@pytest.mark.parametrize("gop", ["1", "12"])
def test_matroska_times_too_coarse_for_the_rate(tmp_path, rate, gop):
    """At 3000 1/s three frames share each time stamp of 1 ms; count and order must not suffer."""
    frames = random_frames(3, 50, 16, 16, 12)
    path = tmp_path / "clip.mkv"
    write_container(path, frames, "gray12le", rate=rate, g=gop)
    video = open_video(path, fps=1.0)
    assert len(video.frames) == 50
    for i in [*range(50), *np.random.default_rng(0).integers(0, 50, 40), *range(49, -1, -1)]:
        np.testing.assert_array_equal(video.frames.frame(int(i)), frames[i])


def test_h264_with_reordered_frames_comes_in_shown_order(tmp_path):
    """Uniform frames, each 4 levels lighter: a frame out of place would be off by more than a level."""
    levels = np.arange(40) * 4 + 20
    planar = np.full((40, 96, 64), 128, np.uint8)
    planar[:, :64] = levels[:, None, None]
    path = tmp_path / "clip.mp4"
    write_yuv(path, planar)
    video = open_video(path, fps=1.0)
    assert video.metadata["levels"].startswith("limited range")
    for i in [*range(40), 3, 38, 17, 16, 0]:
        assert abs(float(video.frames.frame(i).mean()) - levels[i]) < 1


def write_yuv(path, planar):
    """H.264 from the planes of yuv420p below each other, shape (n, 96, 64) for frames of 64 × 64."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"bf": "3", "g": "15"})
        stream.height, stream.width, stream.pix_fmt = 64, 64, "yuv420p"
        for i, image in enumerate(planar):
            frame = av.VideoFrame.from_ndarray(image, format="yuv420p")
            frame.pts = i
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def test_uncompressed_bitmaps_in_avi_are_upright(tmp_path):
    """AVI stores RGB bitmaps bottom-up; a flip would swap S and Z."""
    gray = random_frames(1, 3, 16, 24, 8)
    path = tmp_path / "clip.avi"
    write_container(path, np.repeat(gray[..., None], 3, axis=3), "bgr24", codec="rawvideo")
    assert_same(open_video(path, fps=1.0), gray)


def test_the_playback_rate_is_not_the_recording_rate(tmp_path):
    path = write_clip(tmp_path, "mkv", random_frames(1, 3, 16, 16, 8), 8)
    with pytest.raises(InputError, match=r"25 1/s is for playback.*give the recording rate: --fps or fps in case.toml"):
        open_video(path)


@pytest.mark.parametrize("fps", [0.0, -5.0, float("nan"), float("inf")])
def test_a_rate_that_is_none(tmp_path, fps):
    path = write_clip(tmp_path, "tif", random_frames(1, 3, 16, 16, 8), 8)
    with pytest.raises(InputError, match="recording rate"):
        open_video(path, fps=fps)


@pytest.mark.parametrize(
    ("peak", "given", "bits", "origin"),
    [(1023, None, 10, "assumed"), (1024, None, 12, "assumed"), (4095, 14, 14, "as given"), (4095, None, 12, "assumed")],
)
def test_significant_bits_of_a_16_bit_container(tmp_path, peak, given, bits, origin):
    frames = np.tile(np.arange(256, dtype=np.uint16).reshape(16, 16), (2, 1, 1))
    frames[1, 3, 3] = peak
    path = write_clip(tmp_path, "tif", frames, 16)
    video = open_video(path, fps=1.0, bits=given)
    assert video.bits == bits
    assert origin in video.metadata["bits"]


def test_left_justified_pixels_are_full_scale_of_the_container(tmp_path):
    frames = (random_frames(1, 2, 16, 16, 8).astype(np.uint16) // 8) << 8
    video = open_video(write_clip(tmp_path, "tif", frames, 16), fps=1.0)
    assert video.bits == 16
    assert "left-justified, the lowest 8 bits" in video.metadata["bits"]


def test_bits_that_the_pixels_exceed(tmp_path):
    path = write_clip(tmp_path, "tif", random_frames(1, 2, 16, 16, 12), 12)
    with pytest.raises(InputError, match="a pixel of 4095 does not go with 10 significant bits"):
        open_video(path, fps=1.0, bits=10)


def test_bits_stated_by_the_file_win(tmp_path):
    video = open_video(write_clip(tmp_path, "mkv", random_frames(1, 2, 16, 16, 12), 12), fps=1.0, bits=14)
    assert video.bits == 12
    assert "the given 14 contradicts it and is not used" in video.metadata["bits"]


def test_folder_is_sorted_by_number_and_a_gap_keeps_its_time(tmp_path):
    frames = random_frames(2, 12, 16, 16, 12)
    files = write_sequence(tmp_path / "frames", frames, ".png", start=5)
    files[4].unlink()
    (tmp_path / "frames" / "notes.txt").write_text("not a frame")
    video = open_video(tmp_path / "frames", fps=100.0)
    assert len(video.frames) == 12
    assert video.metadata["gaps"] == "1 missing: 9; kept as unreadable frames"
    with pytest.raises(InputError, match="frame 4: missing"):
        video.frames.frame(4)
    np.testing.assert_array_equal(video.frames.frame(11), frames[11])


def test_folder_numbered_in_steps_has_no_gap(tmp_path):
    frames = random_frames(2, 4, 16, 16, 8)
    for i, file in reversed(list(enumerate(write_sequence(tmp_path / "frames", frames, ".bmp")))):
        file.rename(file.with_name(f"img_{10 * i}.bmp"))
    video = open_video(tmp_path / "frames", fps=100.0)
    assert "gaps" not in video.metadata
    assert "in steps of 10" in video.metadata["numbers"]
    assert_same(video, frames)


def test_folder_with_a_clock_in_the_names(tmp_path):
    frames = random_frames(2, 4, 16, 16, 8)
    clock = (120001, 120002, 123000, 130501)
    for number, file in zip(clock, write_sequence(tmp_path / "frames", frames, ".png"), strict=True):
        file.rename(file.with_name(f"img_{number}.png"))
    video = open_video(tmp_path / "frames", fps=100.0)
    assert "too irregular" in video.metadata["numbers"]
    assert_same(video, frames)


def test_folder_is_identified_by_its_images(tmp_path):
    frames = random_frames(2, 3, 16, 16, 8)
    files = write_sequence(tmp_path / "f", frames, ".png")
    before = open_video(files[0].parent, fps=1.0, root=tmp_path).source
    assert before.size == sum(file.stat().st_size for file in files)
    files[1].write_bytes(files[0].read_bytes())
    after = open_video(files[0].parent, fps=1.0, root=tmp_path).source
    assert before.name == after.name == "f"
    assert before.sha256 != after.sha256


def test_single_images(tmp_path):
    frame = random_frames(4, 1, 16, 20, 12)[0]
    cv2.imwrite(str(tmp_path / "a.png"), frame)
    assert_same(open_video(tmp_path / "a.png", fps=1.0), frame[None])
    tifffile.imwrite(tmp_path / "a.tif", frame)
    assert_same(open_video(tmp_path / "a.tif", fps=1.0), frame[None])


def test_imagej_stack_with_one_description(tmp_path):
    """ImageJ writes one page, then all frames, if a stack is large; without its other pages a small one is the same."""
    frames = random_frames(4, 5, 16, 20, 12)
    path = tmp_path / "stack.tif"
    tifffile.imwrite(path, frames, imagej=True)
    with tifffile.TiffFile(path) as file:
        next_page_at = file.pages[0].offset + 2 + 12 * len(file.pages[0].tags)
        order = "little" if file.byteorder == "<" else "big"
    data = bytearray(path.read_bytes())
    assert int.from_bytes(data[next_page_at : next_page_at + 4], order) > 0
    data[next_page_at : next_page_at + 4] = bytes(4)
    path.write_bytes(data)
    assert_same(open_video(path, fps=1.0), frames)


@pytest.mark.parametrize("kind", ["cine", "tif", "mkv", "folder .png"])
def test_memory_does_not_grow_with_the_clip(tmp_path, kind):
    """160 frames of 64 KiB are 10 MiB; reading them all may hold a few at a time."""
    frames = random_frames(5, 160, 128, 256, 12)
    path = write_clip(tmp_path, kind, frames, 12)
    tracemalloc.start()
    try:
        video = open_video(path, fps=1.0)
        checksum = sum(int(video.frames.frame(i)[5, 5]) for i in range(len(video.frames)))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert checksum == int(frames[:, 5, 5].sum())
    assert peak < 2 * 2**20


def test_index_beyond_the_clip_is_a_programming_error(tmp_path):
    video = open_video(write_clip(tmp_path, "tif", random_frames(1, 3, 16, 16, 8), 8), fps=1.0)
    for index in (3, -1):
        with pytest.raises(IndexError):
            video.frames.frame(index)


def test_gray_frames_stored_as_colour_are_as_many_as_there_are(tmp_path):
    frames = np.arange(3 * 20 * 30, dtype=np.uint8).reshape(3, 20, 30)
    tifffile.imwrite(tmp_path / "c.tif", np.repeat(frames[..., None], 3, axis=3), photometric="rgb")
    video = open_video(tmp_path / "c.tif", fps=1.0)
    assert len(video.frames) == 3
    assert np.array_equal(video.frames.frame(2), frames[2])
