"""Bad inputs: exit 2, one line that names the place and the remedy, and nothing left behind; or a flagged row."""

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
import study_folders as studies


@pytest.fixture
def study(tmp_path: Path) -> Path:
    return studies.raw(tmp_path / "study", frames=6)


def refused(yarnval, study: Path, *words: str) -> None:
    """The report is refused in one line that holds the words, and leaves no folder."""
    out = study.parent / "reports"
    ran = yarnval("report", study, "--out", out)
    assert ran.code == 2
    assert all(word in ran.line for word in words), ran.line
    assert not out.exists() or not os.listdir(out)


def test_missing_scale(yarnval, study):
    studies.edit(study / "only/case.toml", "scale_um_per_px = { value = 5.0, cv_percent = 0.3 }", "")
    refused(yarnval, study, "case.toml", "scale_um_per_px", "no mm and no tpm")


def test_missing_rate(yarnval, study):
    studies.edit(study / "only/case.toml", "fps = 1200", "")
    refused(yarnval, study, "clip.mkv", "recording rate", "fps")


def test_wrong_unit(yarnval, study):
    layout = 'base = "german-semicolon"\nunit = "bar"\n'
    (study / "only/ours.toml").write_text(layout)
    studies.edit(study / "only/case.toml", "german-semicolon", "ours.toml")
    refused(yarnval, study, "ours.toml", "'bar'", "cN")


def test_unknown_key(yarnval, study):
    studies.edit(study / "only/case.toml", "phi_deg", "phi_degrees")
    refused(yarnval, study, "case.toml", "'phi_degrees'", "did you mean 'phi_deg'?")


def test_unknown_key_in_a_table(yarnval, study):
    studies.edit(study / "only/case.toml", "axis_deg", "axis_degg")
    refused(yarnval, study, "case.toml", "'raw.axis_degg'", "did you mean 'axis_deg'?")


def test_missing_key(yarnval, study):
    studies.edit(study / "only/case.toml", "mu = 0.81", "")
    refused(yarnval, study, "case.toml", "'mu' is missing")


def test_empty_log(yarnval, study):
    (study / "only/log.txt").write_bytes(b"")
    refused(yarnval, study, "log.txt", "empty")


def test_text_in_a_number_column(yarnval, study):
    file = study / "only/log.txt"
    lines = file.read_text(encoding="cp1252").splitlines()
    number = len(lines) // 2
    lines[number] = lines[number].split(";")[0] + ";lots"
    file.write_text("\n".join(lines), encoding="cp1252")
    refused(yarnval, study, "log.txt", f"line {number + 1}", "'lots'")


def test_zero_wrap_angle(yarnval, study):
    studies.edit(study / "only/case.toml", "phi_deg = 50", "phi_deg = 0")
    refused(yarnval, study, "case.toml", "phi_deg = 0", "greater than 0")


def test_nan(yarnval, study):
    studies.edit(study / "only/case.toml", "mu = 0.81", "mu = nan")
    refused(yarnval, study, "case.toml", "'mu", "finite")


def test_not_toml(yarnval, study):
    studies.edit(study / "only/case.toml", "mu = 0.81", "mu = = 0.81")
    refused(yarnval, study, "case.toml", "not TOML", "line 4")


def test_missing_file(yarnval, study):
    (study / "only/clip.mkv").unlink()
    refused(yarnval, study, "case.toml", "'clip.mkv'")


def test_unknown_model(yarnval, study):
    studies.edit(study / "study.toml", '["cosserat"]', '["coserat"]')
    refused(yarnval, study, "study.toml", "'coserat'", "did you mean 'cosserat'?")


def test_both_summary_and_files(yarnval, study):
    with (study / "only/case.toml").open("a") as file:
        file.write(studies.MEASURED)
    refused(yarnval, study, "case.toml", "not both")


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("study.toml", 'name = "small"', 'name = "../small"', ["'name'", "'../small'"]),
        ("study.toml", "p3_AB_cN = 15", "p3_AB_cN = -1", ["bounds.cosserat.p3_AB_cN", "greater than 0"]),
        ("study.toml", "p3_AB_cN = 15", "p3_AB_N = 15", ["p3_AB_N", "did you mean 'p3_AB_cN'?"]),
        ("study.toml", '["only"]', '["only", "only"]', ["'only' is named twice"]),
        ("study.toml", '["only"]', '["only", "other"]', ["other/case.toml", "no such file"]),
        ("only/case.toml", "mu = 0.81", 'mu = "rough"', ["'mu' is 'rough'", "give a number"]),
        ("only/case.toml", "mu = 0.81", "mu = { value = 0.8, u = 0.1, cv_percent = 3 }", ["'mu'", "give one"]),
        ("only/case.toml", "mu = 0.81", "mu = { valu = 0.8 }", ["'mu.valu'", "did you mean 'value'?"]),
        ("only/case.toml", "value = 5.0", "value = -5.0", ["scale_um_per_px", "greater than 0"]),
        ("only/case.toml", "[raw]", "[raw]\nplies = 2", ["plies", "method"]),
        ("only/case.toml", "[raw]", "[raw]\nscale_from_diameter_mm = 6", ["given twice"]),
        ("only/case.toml", "[raw]", "[raw]\nscale_image = 'x.tif'", ["scale_from_diameter_mm"]),
        ("only/case.toml", "[raw]", "[raw]\ntilt_u_deg = -1", ["raw.tilt_u_deg"]),
        ("only/case.toml", "[raw]", "[raw]\nslope_ratio = 0.9", ["slope_ratio", "{value, u}"]),
        (
            "only/case.toml",
            "[raw]",
            "[raw]\nmethod = 'ply'\nplies = 2\nslope_ratio = { value = 0.9, u = 0.01 }",
            ["slope_ratio", "leave it out"],
        ),
        ("only/case.toml", "axis_deg = 90", "axis_deg = { value = 90, u = -1 }", ["raw.axis_deg.u"]),
        ("only/case.toml", "axis_deg = 90", "", ["axis_deg", "direction of the cylinder axis"]),
    ],
)
def test_wrong_keys(yarnval, study, file, old, new, words):
    studies.edit(study / file, old, new)
    refused(yarnval, study, Path(file).name, *words)


def test_two_studies_of_one_name(yarnval, study):
    other = studies.published(study.parent / "other")
    out = study.parent / "reports"
    ran = yarnval("report", study, other, "--out", out)
    assert ran.code == 2
    assert "name 'small' is also that of" in ran.line
    assert not out.exists()


def test_a_folder_with_other_files_is_not_replaced(yarnval, tmp_path):
    study = studies.published(tmp_path / "study")
    mine = tmp_path / "reports/small/mine.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("keep me")
    ran = yarnval("report", study, "--out", tmp_path / "reports")
    assert ran.code == 2
    assert "mine.txt" in ran.line
    assert mine.read_text() == "keep me"


def test_no_study(yarnval, tmp_path):
    refused(yarnval, tmp_path / "nowhere", "nowhere", "no such folder")
    (tmp_path / "empty").mkdir()
    refused(yarnval, tmp_path / "empty", "no study.toml")


def test_second_study_bad_leaves_no_part_of_its_report(yarnval, study):
    other = studies.published(study.parent / "other")
    studies.edit(other / "study.toml", '"small"', '"other"')
    studies.edit(other / "only/case.toml", "phi_deg = 50", "phi_deg = -3")
    out = study.parent / "reports"
    ran = yarnval("report", study, other, "--out", out)
    assert ran.code == 2
    assert "phi_deg = -3" in ran.line
    assert not out.exists() or not any(name.startswith(("other", ".")) for name in os.listdir(out))


def test_truncated_clip_is_flagged_and_the_rest_used(yarnval, tmp_path):
    study = studies.raw(tmp_path / "study", frames=20)
    clip = study / "only/clip.mkv"
    clip.write_bytes(clip.read_bytes()[: int(clip.stat().st_size * 0.7)])
    call = ("measure", clip, "--scale-um-per-px", 5, "--fps", 1200, "--json")
    ran = yarnval(*call)
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert 0 < found["flag"].count("UNREADABLE") < found["frames"]
    assert "cannot be read" in found["reason"]
    report = yarnval("report", study, "--out", study.parent / "reports")
    assert report.code == 0, report.err
    rows = json.loads((study.parent / "reports/small/errors.json").read_text())["rows"]
    assert any("cannot be read" in row["message"] for row in rows if row["quantity"] == "T_AB_tpm")


def test_8_bit_clip_is_flagged(yarnval, study, tmp_path):
    from pipeline.ingest.video import open_video

    deep = open_video(study / "only/clip.mkv", fps=1200)
    (tmp_path / "shallow").mkdir()
    for i in range(len(deep.frames)):
        cv2.imwrite(str(tmp_path / f"shallow/{i:03}.png"), (deep.frames.frame(i) >> 4).astype(np.uint8))
    ran = yarnval("measure", tmp_path / "shallow", "--scale-um-per-px", 5, "--fps", 1200, "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert all("REDUCED_DEPTH" in flag for flag in found["flag"])
    assert "8 bits" in found["reason"]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (["predict", "nothing.csv"], ["nothing.csv", "cannot be read"]),
        (["predict", "nothing.csv", "--model", "cosserrat"], ["cosserrat", "did you mean 'cosserat'?"]),
        (["predict", "nothing.csv", "--model", "flexible,auto,flexible"], ["--model", "'flexible' stands twice"]),
        (["measure", "nothing.mkv", "--fps", "1200"], ["--scale-um-per-px", "no mm and no tpm"]),
        (["measure", "nothing.mkv", "--fps", "x", "--scale-um-per-px", "5"], ["--fps"]),
        (["measure", "nothing.mkv", "--fps", "-1", "--scale-um-per-px", "5"], ["--fps", "greater than 0"]),
        (["measure", "nothing.mkv", "--fps", "9", "--scale-um-per-px", "5", "--method", "x"], ["method", "surface"]),
        (["measure", "nothing.mkv", "--scale-um-per-px", "5", "--axis-deg", "inf"], ["--axis-deg"]),
        (["measure", "nothing.mkv", "--scale-um-per-px", "5", "--slope-ratio", "0.9"], ["--slope-ratio", "give both"]),
        (["measure", "nothing.mkv", "--scale-um-per-px", "5", "--axis-u-deg", "1"], ["--axis-u-deg", "give the axis"]),
        (["measure", "nothing.mkv", "--scale-um-per-px", "5", "--tilt-u-deg", "nan"], ["--tilt-u-deg", "below 45"]),
        (["measure", "nothing.mkv", "--scale-um-per-px", "5", "--method", "ply"], ["--plies", "2 or more"]),
        (["measure", "nothing.mkv", "--scale-um-per-px", "5", "--plies", "2"], ["--plies", "--method ply"]),
        (["measure", "nothing.mkv", "--scale-um-per-px", "5", "--yarn-speed-m-s", "nan"], ["--yarn-speed-m-s"]),
        (["measure", "nothing.mkv", "--scale-um-per-px", "5", "--scale-u-um-per-px", "-1"], ["--scale-u-um-per-px"]),
        (["measure", "nothing.mkv", "--scale-from-diameter-mm", "6", "--scale-u-um-per-px", "1"], ["give the scale"]),
        (["check", ".", "--junit", "nowhere/junit.xml"], ["no study.toml"]),
        (["tension", "nothing.csv"], ["nothing.csv"]),
        (["tension", "nothing.csv", "--profile", "plain-cvs"], ["plain-cvs", "plain-csv"]),
        (["tension", "nothing.csv", "--window", "a:b"], ["a:b", "A:B"]),
        (["report", "--outt", "x"], ["--outt"]),
        (["nothing"], ["nothing"]),
    ],
)
def test_wrong_calls(yarnval, call, words):
    ran = yarnval(*call)
    assert ran.code == 2
    assert all(word in ran.line for word in words), ran.line
    assert ran.out == ""


def test_a_folder_as_output_file(yarnval, tmp_path):
    case = Path(__file__).parents[2] / "data_samples" / "yin2020" / "case1" / "case.toml"
    (tmp_path / "folder").mkdir()
    before = set(tmp_path.iterdir())
    ran = yarnval("predict", case, "--model", "flexible", "--out", tmp_path / "folder")
    assert ran.code == 2
    assert "is a folder; give a path of a file" in ran.line
    assert set(tmp_path.iterdir()) == before


def test_a_column_name_with_an_unseen_character_shows_it(yarnval, tmp_path):
    table = tmp_path / "table.csv"
    table.write_text("case,phi_deg\x00\n1,2\n")
    ran = yarnval("predict", table)
    assert ran.code == 2
    assert r"unknown column 'phi_deg\x00'" in ran.line
