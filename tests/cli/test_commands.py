"""Every command as the contract says it: output, exit code, JSON."""

import csv
import io
import json
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np
import pytest
import study_folders as studies
import tifffile
from yarn_frames import yarn

DATA = Path(__file__).parents[2] / "data_samples"


def test_predict_case_prints_one_row_per_model(yarnval):
    ran = yarnval("predict", DATA / "yin2020/case1/case.toml", "--model", "flexible,cosserat")
    assert ran.code == 0
    assert ran.err == ""
    rows = list(csv.DictReader(io.StringIO(ran.out)))
    assert [(row["case"], row["model"]) for row in rows] == [("case1", "flexible"), ("case1", "cosserat")]
    assert list(rows[0]) == [
        "case", "model", "p3_AB_cN", "T_AB_tpm", "theta_B_deg", "theta_C_deg", "n1_per_s", "N_min_N_per_m", "outcome",
        "message", "u_num_p3_AB_cN", "u_num_T_AB_tpm", "u_num_theta_B_deg", "iterations", "wall_s",
    ]  # fmt: skip
    assert float(rows[1]["p3_AB_cN"]) == pytest.approx(9.528, rel=1e-4)
    assert float(rows[1]["theta_B_deg"]) + float(rows[1]["theta_C_deg"]) == pytest.approx(180)
    # n₁ = (T_AB − k T_CD) η v
    assert float(rows[1]["n1_per_s"]) == pytest.approx((float(rows[1]["T_AB_tpm"]) - 902) * 0.16)


TABLE = """\
case,phi_deg,r0_mm,d_mm,mu,T_CD_tpm,p3_CD_cN,K_Nm2,v_m_s,vb_over_v
good,50,3,0.16,0.81,902,16.53,4.87e-9,0.16,2
flat,0,3,0.16,0.81,902,16.53,4.87e-9,0.16,2
word,50,3,thin,0.81,902,16.53,4.87e-9,0.16,2
nan,50,3,0.16,nan,902,16.53,4.87e-9,0.16,2
short,50,3,0.16
slack,2,3,0.16,0.81,902,0.5,4.87e-9,0.16,2
s-twist,50,3,0.16,0.81,-902,16.53,4.87e-9,0.16,-2
"""


def test_predict_table_keeps_failed_rows(yarnval, tmp_path):
    table = tmp_path / "table.csv"
    table.write_text(TABLE)
    out = tmp_path / "out.csv"
    ran = yarnval("predict", table, "--model", "cosserat", "--out", out)
    assert ran.code == 1
    rows = {row["case"]: row for row in csv.DictReader(io.StringIO(out.read_text()))}
    assert list(rows) == ["good", "flat", "word", "nan", "short", "slack", "s-twist"]
    assert rows["good"]["outcome"] == rows["s-twist"]["outcome"] == "converged"
    assert float(rows["s-twist"]["T_AB_tpm"]) == pytest.approx(-float(rows["good"]["T_AB_tpm"]), rel=1e-6)
    for case, where in (("flat", "phi_deg = 0"), ("word", "'thin'"), ("nan", "mu"), ("short", "4 cells")):
        assert rows[case]["outcome"] == "bad_input"
        assert where in rows[case]["message"]
        assert math.isnan(float(rows[case]["p3_AB_cN"]))
    assert rows["slack"]["outcome"] != "converged"
    assert rows["slack"]["message"]
    assert len(ran.err.splitlines()) == 5
    assert all(str(table) in line for line in ran.err.splitlines())


def test_predict_json_is_one_document(yarnval, tmp_path):
    table = tmp_path / "table.csv"
    table.write_text(TABLE)
    ran = yarnval("predict", table, "--model", "flexible", "--json")
    rows = json.loads(ran.out)
    assert rows[1]["p3_AB_cN"] is None
    assert rows[0]["model"] == "flexible"


def test_tension_json(yarnval):
    ran = yarnval("tension", DATA / "rig/case1/tension_1.txt", "--profile", "german-semicolon", "--json")
    assert ran.code == 0
    found = json.loads(ran.out)
    assert found["mean_cN"] == pytest.approx(10.61, abs=0.01)
    assert found["unit_in_file"] == "cN"
    assert {"n", "rate_Hz", "cv_percent", "u_cN", "n_eff", "drift_cN_per_s", "flags", "gaps"} <= set(found)


def test_tension_window(yarnval):
    log = DATA / "rig/case1/tension_2.csv"
    whole = json.loads(yarnval("tension", log, "--json").out)
    part = json.loads(yarnval("tension", log, "--window", "5:10", "--json").out)
    assert part["n"] == pytest.approx(whole["n"] / 6, abs=2)


def test_measure_json(yarnval, tmp_path):
    clip = studies.raw(tmp_path / "study", frames=4) / "only/clip.mkv"
    call = ("measure", clip, "--scale-um-per-px", 5, "--fps", 1200)
    found = json.loads(yarnval(*call, "--axis-deg", 90, "--json").out)
    assert found["frames"] == len(found["time_s"]) == len(found["twist_tpm"]) == 4
    assert found["handedness"] == "Z"
    assert found["summary"]["diameter_mm"]["mean"] == pytest.approx(0.16, rel=0.02)
    assert "theta_B_deg" in found["summary"]
    without_axis = json.loads(yarnval(*call, "--json").out)
    assert "theta_B_deg" not in without_axis["summary"]


def test_check_passes_and_writes_junit(yarnval, tmp_path):
    study = studies.published(tmp_path / "study")
    ran = yarnval("check", study, "--junit", tmp_path / "junit.xml")
    assert ran.code == 0, ran.err
    assert "3 of 3 bounds hold" in ran.out
    suite = ET.parse(tmp_path / "junit.xml").getroot().find("testsuite")
    assert suite is not None
    assert suite.attrib == {"name": "small", "tests": "3", "failures": "0"}


def test_check_names_what_exceeds_a_tightened_bound(yarnval, tmp_path):
    study = studies.published(tmp_path / "study")
    studies.edit(study / "study.toml", "p3_AB_cN = 15", "p3_AB_cN = 1")
    ran = yarnval("check", study, "--junit", tmp_path / "junit.xml")
    assert ran.code == 1
    assert ran.line == "small: only p3_AB_cN cosserat: error 10.20 % EXCEEDS bound 1 %"
    failure = ET.parse(tmp_path / "junit.xml").getroot().find("testsuite/testcase/failure")
    assert failure is not None
    assert "10.20 %" in failure.attrib["message"]


def test_check_fails_where_the_error_is_missing(yarnval, tmp_path):
    study = studies.published(tmp_path / "study")
    studies.edit(study / "only/case.toml", "theta_B_deg = { mean = 77.9 }", "")
    ran = yarnval("check", study)
    assert ran.code == 1
    assert "theta_B_deg" in ran.line
    assert "not measured" in ran.line


def test_check_json(yarnval, tmp_path):
    ran = yarnval("check", studies.published(tmp_path / "study"), "--json")
    document = json.loads(ran.out)
    assert document["passed"] is True
    assert {row["quantity"] for row in document["studies"]["small"]} == {"p3_AB_cN", "T_AB_tpm", "theta_B_deg"}


def test_report_then_check_reads_it(yarnval, tmp_path):
    study = studies.raw(tmp_path / "study", models=("flexible", "cosserat"))
    studies.edit(study / "study.toml", "T_AB_tpm = 15", "T_AB_tpm = 0.001")
    ran = yarnval("report", study, "--out", tmp_path / "reports")
    assert ran.code == 0, ran.err
    folder = tmp_path / "reports/small"
    assert ran.out.strip() == str(folder / "report.html")
    inputs = json.loads((folder / "provenance.json").read_text())["inputs_sha256"]
    assert {"study.toml", "only/case.toml", "only/log.txt", "only/clip.mkv"} <= set(inputs)
    read = yarnval("check", folder)
    assert read.code == 1
    anew = yarnval("check", study)
    assert read.line == anew.line
    assert "T_AB_tpm" in read.line


def test_report_keeps_a_case_that_fails(yarnval, tmp_path):
    study = studies.published(tmp_path / "study", models=("flexible", "cosserat"))
    studies.edit(study / "only/case.toml", "value = 16.53", "value = 0.5")
    studies.edit(study / "only/case.toml", "phi_deg = 50", "phi_deg = 2")
    ran = yarnval("report", study, "--out", tmp_path / "reports")
    assert ran.code == 1
    assert "only cosserat: " in ran.line
    rows = json.loads((tmp_path / "reports/small/errors.json").read_text())["rows"]
    failed = [row for row in rows if row["model"] == "cosserat"]
    assert len(failed) == 3
    assert all(row["S"] is None and row["outcome"] != "converged" and row["message"] for row in failed)
    assert yarnval("check", study).code == 1


@pytest.mark.parametrize("command", ["report", "check", "predict", "sweep", "measure", "tension"])
def test_help_has_an_example(yarnval, command):
    ran = yarnval(command, "--help")
    assert ran.code == 0
    assert f"yarnval {command} data_samples" in " ".join(ran.out.split())


def test_measure_overlay(yarnval, tmp_path):
    clip = studies.raw(tmp_path / "study", frames=2) / "only/clip.mkv"
    call = ("measure", clip, "--scale-um-per-px", 5, "--fps", 1200, "--overlay")
    assert yarnval(*call, tmp_path / "look").code == 0
    assert {p.name for p in (tmp_path / "look").iterdir()} == {"contact_sheet.png", "frame_0.png", "frame_1.png"}
    ran = yarnval(*call, clip.parent)
    assert ran.code == 2
    assert "holds 'case.toml', which is not part of an overlay" in ran.line


@pytest.mark.parametrize(("quality", "frames"), [(75, 1), (90, 4)])
def test_measure_coloured_photographs(yarnval, tmp_path, quality, frames):
    """Synthetic: brown yarn on green, JPEG with chroma at half resolution; one still, and a folder."""
    gray = [
        yarn(3, shape=(300, 400), tan_beta=0.5, angle=62, diameter=40.0, phase=0.4 * i, travel=7.0 * i)[0] / 4095
        for i in range(frames)
    ]
    folder = tmp_path / "photographs"
    folder.mkdir()
    for i, level in enumerate(gray):
        bright = np.clip((level - 0.15) / 0.2, 0, 1)[..., None]
        tint = (1 - bright) * [90, 120, 40] + bright * [60, 120, 200]  # blue, green, red
        picture = level[..., None] * tint / (tint @ [0.114, 0.587, 0.299])[..., None] * 255
        options = [cv2.IMWRITE_JPEG_QUALITY, quality]
        cv2.imwrite(str(folder / f"yarn_{i}.jpg"), picture.round().clip(0, 255).astype(np.uint8), options)
    clip = folder if frames > 1 else folder / "yarn_0.jpg"
    call = ("measure", clip, "--scale-um-per-px", 4, "--fps", 10, "--overlay", tmp_path / "look", "--json")
    found = json.loads(yarnval(*call).out)
    assert found["clip"]["colour"] == "where there is any, measured on the luma Y′ that is stored"
    assert found["clip"]["compression"].startswith("JPEG: lossy")
    means = {name: part["mean"] for name, part in found["summary"].items()}
    assert means["axis_angle_deg"] == pytest.approx(62, abs=0.1)
    assert means["diameter_mm"] == pytest.approx(0.16, rel=0.01)
    assert means["twist_tpm"] == pytest.approx(0.5 / (math.pi * 0.16e-3), rel=0.05)
    assert len(list((tmp_path / "look").iterdir())) == frames + 1
    assert "clip.compression: JPEG: lossy" in yarnval(*call[:6]).out


def test_measure_takes_scale_and_axis_from_the_cylinder(yarnval, tmp_path):
    """A synthetic cylinder of 6 mm and 120 px; the clip shows it in every frame, the image for itself."""
    image = np.full((256, 320), 300, np.uint16)
    image[:, 100:220] = 2500
    tifffile.imwrite(tmp_path / "cylinder.tif", image)
    clip = studies.raw(tmp_path / "study", frames=2) / "only/clip.mkv"
    call = ("measure", clip, "--fps", 1200, "--scale-from-diameter-mm", 6, "--json")
    found = json.loads(yarnval(*call, "--scale-image", tmp_path / "cylinder.tif").out)
    assert found["scale"]["um_per_px"] == pytest.approx(50, rel=0.005)
    assert 0.05 < found["scale"]["u_percent"] < 0.5
    assert "theta_B_deg" not in found["summary"]
    in_view = json.loads(yarnval("measure", tmp_path / "cylinder.tif", *call[2:]).out)
    assert in_view["scale"]["axis_deg"] == pytest.approx(90, abs=0.05)
    ran = yarnval(*call)
    assert ran.code == 2
    assert "no cylinder's two edges were found" in ran.line


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--scale-from-diameter-mm", 6, "--scale-um-per-px", 5), "the scale is given twice"),
        (("--scale-from-diameter-mm", -6), "--scale-from-diameter-mm: found -6.0"),
        (("--scale-um-per-px", 5, "--scale-image", "x.tif"), "--scale-image: no diameter"),
    ],
)
def test_contradicting_scales(yarnval, options, message):
    ran = yarnval("measure", DATA / "rig/case1/yarn.mkv", "--fps", 1200, *options)
    assert ran.code == 2
    assert message in ran.line
