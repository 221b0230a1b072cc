"""Phantom .cine: real files against the vendor's export and pims, and files of known stamps and pixels."""

import numpy as np
import pytest
import tifffile
from pims.cine import Cine
from video_files import SAMPLES, cine_bytes, random_frames

from pipeline.errors import InputError
from pipeline.ingest.cine import p10_levels
from pipeline.ingest.video import open_video

STEP = (1 << 32) // 1000


def sample(name):
    if not SAMPLES.is_dir():
        pytest.skip("the cine samples folder is missing (../shared/samples/cine)")
    return SAMPLES / name


def correlation(a, b):
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def test_orientation_is_that_of_the_vendors_export():
    """The export has other levels (brightness −4 applied, shifted to 16 bit) but the same picture."""
    ours = open_video(sample("8bpp.cine")).frames.frame(0).astype(float)
    vendor = tifffile.imread(sample("8bpp.tif")).astype(float)
    assert correlation(ours, vendor) > 0.999
    for turned in (ours[::-1], ours[:, ::-1], ours[::-1, ::-1]):
        assert correlation(turned, vendor) < 0.8


def test_times_come_from_the_stamps_not_from_the_nominal_rate():
    video = open_video(sample("cine_781.cine"), fps=500.0)
    assert video.rate == pytest.approx(9003.2, abs=0.1)
    assert video.time[0] == 0
    np.testing.assert_allclose(np.diff(video.time), 1 / 9003.2, rtol=2e-5)
    assert video.metadata["nominal_rate"] == "90000"
    assert "the nominal rate of 90000 1/s contradicts" in video.metadata["rate"]
    assert "the given rate of 500 1/s contradicts" in video.metadata["rate"]


def test_true_and_nominal_rate_agree_in_the_other_file():
    video = open_video(sample("8bpp.cine"))
    assert len(video.frames) == 202
    assert (video.bits, video.shape) == (8, (16, 128))
    assert video.rate == pytest.approx(10000, rel=1e-4)
    assert "contradicts" not in video.metadata["rate"]


def test_first_stamp_is_the_one_in_the_vendors_xml():
    """The .xml beside the file: trigger at …32.338 196.00 s, frame −100 at …32.328 240.68 s (in ns steps of 10)."""
    video = open_video(sample("8bpp.cine"))
    assert video.metadata["first_image"] == "-100"
    assert video.metadata["trigger_utc"] == "2019-08-24T18:53:32.338196Z"
    assert float(video.metadata["first_frame_from_trigger_s"]) == pytest.approx(0.32824068 - 0.338196, abs=1.1e-8)


def test_twelve_bits_in_sixteen():
    video = open_video(sample("cine_781.cine"))
    assert (video.bits, video.shape) == (12, (256, 256))
    peak = max(int(video.frames.frame(i).max()) for i in range(15))
    assert 255 < peak < 4096
    assert "flipped upside down" in video.metadata["orientation"]


def test_packed_equals_unpacked():
    packed, plain = (open_video(sample(n)) for n in ("synthetic_12L_from_781.cine", "cine_781.cine"))
    assert packed.metadata["format"] == "cine, P12L"
    for i in range(15):
        np.testing.assert_array_equal(packed.frames.frame(i), plain.frames.frame(i))


def test_p10_goes_through_its_table(tmp_path):
    """A real clip, re-packed: each pixel becomes the nearest level that P10 can hold, and reads back as that level."""
    levels = p10_levels()
    plain = open_video(sample("cine_781.cine"))
    frames = np.stack([plain.frames.frame(i) for i in range(3)])
    codes = np.abs(frames[..., None] - levels.astype(np.int32)).argmin(axis=-1)
    path = tmp_path / "a.cine"
    path.write_bytes(cine_bytes(codes, 12, [i * STEP for i in range(3)], packing="P10"))
    video = open_video(path)
    assert (video.metadata["format"], video.bits) == ("cine, P10", 12)
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(video.frames.frame(i), levels[codes[i]])
        # half of the table's widest step between two levels
        assert np.abs(video.frames.frame(i).astype(int) - frame)[frame < 4064].max() <= 5


def test_the_p10_table_is_smooth():
    """A wrong digit in it would stand out by more than the rounding: a line up to code 158, then a power law."""
    levels = p10_levels().astype(float)
    assert levels.shape == (1024,)
    codes = np.arange(1024.0)
    assert np.abs(0.938386 * codes + 4.36428 - levels)[1:158].max() < 0.7
    assert np.abs((0.0400753 * codes + 1.22083) ** 2.221114 + 64.083 - levels)[165:1015].max() < 0.85
    assert np.all(levels[1015:] == 4095)


@pytest.mark.parametrize("name", ["8bpp.cine", "cine_781.cine", "synthetic_12L_from_781.cine"])
def test_pims_reads_the_same_pixels(name):
    path = sample(name)
    theirs, ours = Cine(str(path)), open_video(path)
    assert len(theirs) == len(ours.frames)
    for i in range(len(theirs)):
        np.testing.assert_array_equal(np.asarray(theirs[i]), ours.frames.frame(i))
    theirs.close()


def test_stamps_are_subtracted_as_integers(tmp_path):
    """One tick of 2⁻³² s at the time of today: lost by floats of POSIX seconds, which step by 2⁻²² s."""
    start = (1_700_000_000 << 32) + 12345
    path = tmp_path / "a.cine"
    path.write_bytes(cine_bytes(random_frames(0, 3, 8, 8, 12), 12, [start, start + STEP + 1, start + 2 * STEP]))
    np.testing.assert_array_equal(open_video(path).time, np.array([0, STEP + 1, 2 * STEP]) / 2**32)


def test_irregular_stamps_are_named(tmp_path):
    stamps = [(1 << 40) + STEP * i for i in (0, 1, 2, 5, 6, 7, 7)]
    path = tmp_path / "a.cine"
    path.write_bytes(cine_bytes(random_frames(0, 7, 8, 8, 12), 12, stamps))
    video = open_video(path)
    assert video.rate == pytest.approx(1000, rel=1e-6)
    assert "1 stamps do not advance" in video.metadata["rate"]
    assert "1 intervals are longer than 1.5" in video.metadata["rate"]


def test_without_stamps_the_nominal_rate_is_not_believed(tmp_path):
    path = tmp_path / "a.cine"
    path.write_bytes(cine_bytes(random_frames(0, 3, 8, 8, 12), 12, []))
    with pytest.raises(InputError, match="give the recording rate"):
        open_video(path)
    assert open_video(path, fps=250.0).rate == 250.0


@pytest.mark.parametrize(
    ("at", "value", "message"),
    [
        (44 + 16, 1, "compressed"),
        (4, 2, "compressed"),
        (84 + 808, 3, "colour"),
        (44 + 14, 24, "colour"),
        (44 + 14, 12, "12 bits per pixel"),
        (84 + 896, 10, "does not go with 10 significant bits"),
        (44 + 8, 0, "8 × 0 pixels"),
        (20, 0, "0 frames"),
    ],
)
def test_what_cannot_be_decoded_is_refused(tmp_path, at, value, message):
    data = bytearray(cine_bytes(random_frames(0, 3, 8, 8, 12), 12, [1 << 40, (1 << 40) + STEP, (1 << 40) + 2 * STEP]))
    width = 2 if at in (4, 44 + 14) else 4
    data[at : at + width] = value.to_bytes(width, "little")
    path = tmp_path / "a.cine"
    path.write_bytes(data)
    with pytest.raises(InputError, match=message):
        open_video(path)
