"""True times from PCC .xml and .chd beside an export."""

import re
import shutil

import numpy as np
import pytest
import tifffile
from video_files import SAMPLES, cine_bytes, random_frames

from pipeline.errors import InputError
from pipeline.ingest.video import open_video

TIMES = ("14:53:59.999 990.12", "14:54:00.000 090.12", "14:54:00.000 190.12", "14:54:00.000 490.12")


@pytest.fixture
def clip(tmp_path):
    path = tmp_path / "clip.tif"
    tifffile.imwrite(path, random_frames(5, 4, 16, 16, 8), photometric="minisblack")
    return path


def xml(times, day="Sat Aug 24 2019"):
    """A PCC header with these times, from the real one."""
    if not SAMPLES.is_dir():
        pytest.skip("the cine samples folder is missing (../shared/samples/cine)")
    block = "".join(f'<Date frame="{i}">{day}</Date><Time frame="{i}">{t}</Time>' for i, t in enumerate(times))
    real = (SAMPLES / "8bpp.xml").read_text()
    changed = re.sub("<TIMEBLOCK>.*</TIMEBLOCK>", f"<TIMEBLOCK>{block}</TIMEBLOCK>", real, flags=re.DOTALL)
    assert changed != real
    return changed


def test_times_of_the_xml_win_over_the_given_rate(clip):
    clip.with_suffix(".xml").write_text(xml(TIMES))
    video = open_video(clip, fps=24.0)
    np.testing.assert_allclose(video.time, [0, 100e-6, 200e-6, 500e-6], rtol=0, atol=1e-13)
    assert video.rate == pytest.approx(10000)
    assert video.metadata["times"] == "from clip.xml"
    assert "the given rate of 24 1/s contradicts" in video.metadata["rate"]
    assert "nominal" not in video.metadata["rate"]
    assert video.metadata["beside"].startswith("clip.xml, SHA-256 ")


def test_days_are_counted(clip):
    text = xml(("23:59:59.999 900.00", "00:00:00.000 000.00"))
    clip.with_suffix(".xml").write_text(text.replace('<Date frame="1">Sat Aug 24', '<Date frame="1">Sun Aug 25'))
    tifffile.imwrite(clip, random_frames(5, 2, 16, 16, 8), photometric="minisblack")
    assert open_video(clip).rate == pytest.approx(10000)


def test_times_of_other_frames_are_not_used(clip):
    clip.with_suffix(".xml").write_text(xml(TIMES[:3]))
    with pytest.raises(InputError, match=r"times of 3 frames, the clip 4; give the recording rate"):
        open_video(clip)
    video = open_video(clip, fps=9000.0)
    assert video.rate == 9000.0
    assert "the nominal rate of 10000 1/s contradicts" in video.metadata["rate"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("14:54:00.000 090", "14:54:00,000 090", "frame 1: found"),
        ("Aug", "Foo", "frame 0"),
        ("</chd>", "", "cut short"),
    ],
)
def test_damaged_times_are_not_passed_over(clip, old, new, message):
    clip.with_suffix(".xml").write_text(xml(TIMES).replace(old, new))
    with pytest.raises(InputError, match=message):
        open_video(clip, fps=1.0)


def test_another_programs_xml_is_left_alone(clip):
    clip.with_suffix(".xml").write_text("<project>of an editor</project>")
    video = open_video(clip, fps=5.0)
    assert video.rate == 5.0
    assert video.metadata["times"] == "not used: clip.xml is no cine header"


def test_times_of_a_chd(clip):
    """The head of a .cine, which is what a .chd is said to be; no real one was at hand."""
    stamps = [(1 << 40) + i * (1 << 20) for i in range(4)]
    data = cine_bytes(random_frames(0, 4, 8, 8, 8), 8, stamps, nominal=4096)
    clip.with_suffix(".chd").write_bytes(data[: 84 + 1000 + 8 + 8 * 4])
    video = open_video(clip)
    np.testing.assert_array_equal(video.time, np.arange(4) / 4096)
    assert video.metadata["times"] == "from clip.chd"
    clip.with_suffix(".chd").write_bytes(data[:500])
    with pytest.raises(InputError, match="camera set-up is cut short"):
        open_video(clip)


def test_the_real_xml(tmp_path):
    """The vendor's .tif and .xml of one frame: one time tells no rate, but the nominal rate is read."""
    if not SAMPLES.is_dir():
        pytest.skip("the cine samples folder is missing (../shared/samples/cine)")
    for name in ("8bpp.tif", "8bpp.xml"):
        shutil.copy(SAMPLES / name, tmp_path)
    video = open_video(tmp_path / "8bpp.tif", fps=10000.0)
    assert video.metadata["times"] == "from 8bpp.xml"
    assert video.metadata["nominal_rate"] == "10000"
