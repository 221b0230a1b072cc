"""Colour clips come as their luma, exact to the level; gray ones in three channels as they are."""

import struct
import zlib

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from video_files import write_container

from pipeline.errors import InputError
from pipeline.ingest.clip import luma
from pipeline.ingest.video import open_video


def random_colours(seed, n, rows, columns, kind):
    return np.random.default_rng(seed).integers(0, np.iinfo(kind).max + 1, (n, rows, columns, 3)).astype(kind)


def expected(rgb):
    """BT.601 in whole numbers of Python, rounded to the nearest level, a half upwards."""
    flat = [(299 * r + 587 * g + 114 * b + 500) // 1000 for r, g, b in rgb.reshape(-1, 3).tolist()]
    return np.array(flat, rgb.dtype).reshape(rgb.shape[:-1])


def png(path, image, colour_type, *more):
    """A PNG of any colour type, rows unfiltered; `more` are chunks before the pixels."""
    rows, columns = image.shape[:2]
    lines = image.astype(image.dtype.newbyteorder(">")).reshape(rows, -1)
    data = zlib.compress(b"".join(b"\0" + line.tobytes() for line in lines))
    header = struct.pack(">IIBBBBB", columns, rows, 8 * image.itemsize, colour_type, 0, 0, 0)
    chunks = [(b"IHDR", header), *more, (b"IDAT", data), (b"IEND", b"")]
    body = [struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(body))
    return path


@given(st.integers(0, 2**32), st.sampled_from([np.uint8, np.uint16]))
@settings(max_examples=40, deadline=None)
def test_luma_is_exact(seed, kind):
    rgb = random_colours(seed, 1, 7, 9, kind)[0]
    gray = luma(rgb)
    assert gray.dtype == kind
    np.testing.assert_array_equal(gray, expected(rgb))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_luma_of_gray_is_every_level_itself(kind):
    levels = np.arange(np.iinfo(kind).max + 1).astype(kind).reshape(-1, 16)
    np.testing.assert_array_equal(luma(np.repeat(levels[..., None], 3, axis=2)), levels)


@pytest.mark.parametrize("form", ["png", "png 16", "bmp", "tif", "tif 16", "tif big-endian", "avi", "mov"])
def test_colour_is_measured_on_its_luma(tmp_path, form):
    rgb = random_colours(3, 3, 18, 22, np.uint16 if "16" in form or "big" in form else np.uint8)
    path = tmp_path / f"clip.{form.split()[0]}"
    if form.startswith("tif"):
        tifffile.imwrite(path, rgb, photometric="rgb", byteorder=">" if "big" in form else "<")
    elif form == "avi":
        write_container(path, rgb[..., ::-1], "bgr24", codec="rawvideo")
    elif form == "mov":
        write_container(path, rgb, "rgb24", codec="png")
    else:
        rgb = rgb[:1]
        cv2.imwrite(str(path), rgb[0, ..., ::-1])
    video = open_video(path, fps=1.0)
    assert video.metadata["colour"] == "measured on its luma (BT.601)"
    assert video.shape == (18, 22)
    for i, frame in enumerate(rgb):
        image = video.frames.frame(i)
        assert image.dtype == rgb.dtype
        assert image.flags.c_contiguous
        np.testing.assert_array_equal(image, expected(frame))


def test_a_bitmap_with_a_palette_of_colours(tmp_path):
    palette = random_colours(1, 1, 1, 256, np.uint8)[0, 0]
    index = np.random.default_rng(2).integers(0, 256, (5, 8)).astype(np.uint8)
    table = np.column_stack([palette[:, ::-1], np.zeros(256, np.uint8)])
    info = struct.pack("<IiiHHIIiiII", 40, 8, -5, 1, 8, 0, 40, 0, 0, 256, 0)
    head = struct.pack("<2sIHHI", b"BM", 54 + 1024 + 40, 0, 0, 54 + 1024)
    (tmp_path / "a.bmp").write_bytes(head + info + table.tobytes() + index.tobytes())
    np.testing.assert_array_equal(open_video(tmp_path / "a.bmp", fps=1.0).frames.frame(0), expected(palette[index]))


@pytest.mark.parametrize(("pixels", "bits"), [("yuv420p", 8), ("yuv420p10le", 10)])
def test_colour_video_is_its_y_plane(tmp_path, pixels, bits):
    """Lossless FFV1, so that the stream's own Y′ is known; chroma is anything."""
    planes = np.random.default_rng(4).integers(0, 1 << bits, (4, 48, 32))
    planes = planes.astype(np.uint8 if bits == 8 else np.uint16)
    write_container(tmp_path / "clip.mkv", planes, pixels, rows=32)
    video = open_video(tmp_path / "clip.mkv", fps=1.0)
    assert (video.bits, video.shape) == (bits, (32, 32))
    assert "luma Y′ that is stored" in video.metadata["colour"]
    assert video.metadata["levels"].startswith("limited")
    for i in (0, 3, 1):
        np.testing.assert_array_equal(video.frames.frame(i), planes[i, :32])


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_an_opaque_alpha_channel_is_dropped_any_other_refused(tmp_path, kind):
    rgb = random_colours(5, 1, 6, 7, kind)[0]
    alpha = np.full((6, 7, 1), np.iinfo(kind).max, kind)
    rgba = np.concatenate([rgb, alpha], axis=2)
    gray = np.concatenate([rgb[..., :1], alpha], axis=2)
    png(tmp_path / "c.png", rgba, 6)
    png(tmp_path / "g.png", gray, 4)
    tifffile.imwrite(tmp_path / "c.tif", rgba, photometric="rgb", extrasamples=["unassalpha"])
    for name, right in (("c.png", expected(rgb)), ("g.png", rgb[..., 0]), ("c.tif", expected(rgb))):
        np.testing.assert_array_equal(open_video(tmp_path / name, fps=1.0).frames.frame(0), right)
    rgba[3, 4, 3] -= 1
    gray[3, 4, 1] -= 1
    png(tmp_path / "c.png", rgba, 6)
    png(tmp_path / "g.png", gray, 4)
    tifffile.imwrite(tmp_path / "c.tif", rgba, photometric="rgb", extrasamples=["unassalpha"])
    for name in ("c.png", "g.png", "c.tif"):
        with pytest.raises(InputError, match="an alpha channel that is not opaque"):
            open_video(tmp_path / name, fps=1.0)


def test_a_folder_of_gray_and_colour(tmp_path):
    """Programs that write PNG may store a frame without colour as gray."""
    rgb = random_colours(6, 3, 8, 9, np.uint8)
    for i, frame in enumerate(rgb):
        cv2.imwrite(str(tmp_path / f"f{i}.png"), frame[..., 0] if i == 1 else frame[..., ::-1])
    video = open_video(tmp_path, fps=1.0)
    assert "colour" in video.metadata
    for i, right in enumerate([expected(rgb[0]), rgb[1, ..., 0], expected(rgb[2])]):
        np.testing.assert_array_equal(video.frames.frame(i), right)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_of_a_png_and_of_a_tiff_is_applied(tmp_path, orientation):
    """Stored is what these steps undo: as shown by any viewer, all eight look alike."""
    shown = np.arange(35, dtype=np.uint8).reshape(5, 7)
    stored = {
        1: shown, 2: shown[:, ::-1], 3: shown[::-1, ::-1], 4: shown[::-1],
        5: shown.T, 6: np.rot90(shown), 7: shown[::-1, ::-1].T, 8: np.rot90(shown, -1),
    }[orientation]  # fmt: skip
    tifffile.imwrite(tmp_path / "a.tif", stored, extratags=[(274, "H", 1, orientation, True)])
    exif = struct.pack(">2sHIHHHIHH", b"MM", 42, 8, 1, 274, 3, 1, orientation, 0)
    png(tmp_path / "a.png", stored, 0, (b"eXIf", exif))
    for name in ("a.tif", "a.png"):
        np.testing.assert_array_equal(open_video(tmp_path / name, fps=1.0).frames.frame(0), shown)
