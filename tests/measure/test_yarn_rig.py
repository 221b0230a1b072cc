"""The synthetic study's files, as a user's are read, against the truth that is stored apart."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
import study_folders as studies
import tifffile

from pipeline.case import load_case
from pipeline.ingest.raw import read_raw
from pipeline.ingest.video import open_video
from pipeline.measure.case import measure_case
from pipeline.measure.yarn import measure_yarn
from pipeline.records import CylinderAxis, Scale
from pipeline.synthetic import FRAME_RATE, RIG

ROOT = Path(__file__).parents[2]
RIG_FOLDER = ROOT / "data_samples" / "rig"


def truth(case):
    with (ROOT / "tests" / "truth" / "rig.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["case"] == case]
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0] if key != "case"}


@pytest.mark.parametrize("case", RIG, ids=lambda case: case.name)
def test_the_rig_measures_as_its_truth(case):
    video = open_video(RIG_FOLDER / case.name / case.video, fps=FRAME_RATE, bits=12, root=RIG_FOLDER)
    m = measure_yarn(video, Scale(case.micrometres_per_pixel * 1e-6, 0.003), cylinder_axis=CylinderAxis(math.pi / 2))
    known = truth(case.name)
    assert len(m.flag) == case.frames
    assert not np.any(m.flag)
    assert m.handedness == "Z"
    error = np.mod(np.degrees(m.axis_angle) - known["axis_angle_deg"] + 90, 180) - 90
    assert np.abs(error).max() < 0.1
    np.testing.assert_allclose(np.degrees(m.theta), known["theta_B_deg"], atol=0.1)
    np.testing.assert_allclose(m.diameter * 1e3, known["diameter_mm"], rtol=0.02)
    assert np.mean(m.twist / known["twist_tpm"]) == pytest.approx(1, abs=0.02)
    assert m.summary["twist"].mean == pytest.approx(case.twist[0], rel=0.02)
    assert m.summary["twist"].cv == pytest.approx(case.twist[1], abs=0.01)
    # each frame's fibres are held against its own twist, which varies by 14 % in case1
    assert m.summary["twist"].u_terms["fibres"] < 0.03 * case.twist[0]
    assert math.degrees(m.summary["theta_B"].mean) == pytest.approx(case.theta[0], abs=0.1)
    assert m.summary["theta_B"].cv == pytest.approx(case.theta[1], abs=0.001)


def test_a_case_takes_its_scale_from_the_cylinder_in_another_image(tmp_path):
    """A synthetic cylinder of 6 mm and 1200 px: 5 µm per pixel, as the clip was made with."""
    folder = studies.raw(tmp_path / "study", frames=3) / "only"
    given = "scale_um_per_px = { value = 5.0, cv_percent = 0.3 }"
    studies.edit(folder / "case.toml", given, 'scale_from_diameter_mm = 6\nscale_image = "cylinder.tif"')
    image = np.full((600, 1600), 300, np.uint16)
    image[:, 200:1400] = 2500
    tifffile.imwrite(folder / "cylinder.tif", image)
    case = load_case(folder / "case.toml")
    measured = measure_case(case, *read_raw(case.raw, folder))
    assert measured.diameter.mean == pytest.approx(0.16e-3, rel=0.01)
    assert 0 < measured.diameter.u_terms["scale"] < 0.003 * 0.16e-3
    assert "rotation" in measured.yarn[0].summary


def test_a_case_states_its_axis_its_tilt_and_its_slope_ratio(tmp_path):
    folder = studies.raw(tmp_path / "study", frames=3) / "only"
    stated = "axis_deg = { value = 90, u = 0.2 }\ntilt_u_deg = 3\nslope_ratio = { value = 0.95, u = 0.019 }"
    studies.edit(folder / "case.toml", "axis_deg = 90", stated)
    case = load_case(folder / "case.toml")
    clip = measure_case(case, *read_raw(case.raw, folder)).yarn[0]
    assert clip.summary["theta_B"].u_terms["axis"] == pytest.approx(math.radians(0.2))
    assert clip.summary["twist"].u_terms["tilt"] == pytest.approx(0.00237 * clip.summary["twist"].mean, rel=0.01)
    assert clip.summary["twist"].u_terms["depth"] == pytest.approx(0.02 * clip.summary["twist"].mean)
