"""`yarnval wind`: a fast scene end to end, logs, checkpoints, bad inputs."""

import base64
import csv
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import winding_study

from pipeline import store
from pipeline.errors import InputError
from pipeline.report import winding as page
from pipeline.winding.checkpoint import FileCheckpoint, checkpoints
from pipeline.winding.run import run_winding
from pipeline.winding.store import FORMAT
from pipeline.winding.study import load_winding

DATA = Path(__file__).parents[2] / "data_samples/winding"


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return winding_study.write(tmp_path)


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")


def log_of(folder: Path) -> Path:
    """A synthetic log at 100 Hz, one second long: 49 cN and a ripple, 0 at the multiples of 50 ms."""
    file = folder / "meter.csv"
    rows = "".join(f"{i / 100:g},{49 + (0, 0.2, 0.1, -0.1, -0.2)[i % 5]:g}\n" for i in range(101))
    file.write_text(f"time_s,tension_cN\n{rows}", encoding="utf-8")
    return file


def test_the_folder_is_whole_and_its_numbers_agree(yarnval, small, tmp_path):
    log = log_of(tmp_path)
    ran = yarnval("wind", small, "--out", tmp_path / "out", "--json", "--log", f"fine={log}")
    assert ran.code == 0
    assert ran.err == ""
    folder = tmp_path / "out/small"
    assert {path.name for path in folder.iterdir()} == page.CONTENTS
    assert {path.name for path in folder.parent.iterdir()} == {"small"}
    for path in (folder / "figures").glob("*.svg"):
        ET.parse(path)
    document = json.loads(ran.out)
    fine, coarse = document["cases"]
    assert (fine["case"], fine["tex"], fine["rpm"], fine["mode"]) == ("fine", 60, 1000, "fast")
    assert (coarse["T0_cN"], coarse["outcome"], coarse["energy_residual"]) == (50, "completed", None)
    for case in document["cases"]:
        assert case["span"]["mean_cN"] == pytest.approx(50, rel=0.02)  # the end tension: the guide is smooth
        assert len(case["span"]["samples_30_cN"]) == 8
        assert len(case["layers_T_over_T0"]) == 3  # 6 m/s, 0.4 s, 0.59 m a layer
    assert coarse["span"]["sd_cN"] > fine["span"]["sd_cN"]  # ρcV
    assert [(v["parameter"], v["value"]) for v in document["variants"]] == [
        ("transverse_stiffness_N_per_mm2", 0.4), ("transverse_stiffness_N_per_mm2", 4),
    ]  # fmt: skip
    soft, stiff = (v["layers_T_over_T0"][0] for v in document["variants"])
    assert soft < stiff < coarse["layers_T_over_T0"][0]
    assert len(document["findings"]) == 3

    # Against the log, and by Eq. 14.
    samples = np.array(fine["span"]["samples_30_cN"], dtype=float)
    assert fine["error"]["against"] == "meter.csv"
    assert fine["error"]["mean_percent"] == pytest.approx(np.nanmean(100 * np.abs(samples - 49) / 49))
    assert coarse["error"]["against"] == "T₀"

    with (folder / "runs.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["span_mean_cN"]) for row in rows[:2]] == [c["span"]["mean_cN"] for c in document["cases"]]
    tree = store.read_tree(folder / "results.nc", FORMAT)
    assert list(tree["runs"]["span_mean"].values) == [float(row["span_mean_cN"]) for row in rows]
    provenance = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    assert set(provenance["inputs_sha256"]) == {"small.toml", "meter.csv"}
    html = (folder / "wind.html").read_text(encoding="utf-8")
    assert "A &lt;small&gt; winding" in html
    assert "Lengths &amp; speeds" in html
    assert f'<data value="{fine["span"]["mean_cN"]!r}">' in html
    assert html.count("<figure>") == 7  # with the animation, which moves only when opened
    animation = (folder / "figures/winding.gif").read_bytes()
    assert f'src="data:image/gif;base64,{base64.b64encode(animation).decode()}"' in html
    assert 'alt="The winding, ' in html
    assert "<script" not in html
    assert str(tmp_path) not in html + json.dumps(provenance)


def test_one_case_and_its_mode(small):
    study = load_winding(small, only="fine", mode="auto")
    assert [case.label for case in study.cases] == ["fine"]
    assert study.package_case == "fine"
    (row,) = run_winding(study)
    assert row.result.mode == "fast"
    assert row.result.mode_reason


def test_progress_tells_the_share_and_the_time_left(small):
    told = []
    run_winding(load_winding(small, only="fine"), progress=lambda share, left: told.append((share, left)))
    assert told
    assert all(0 < share <= 1 and left >= 0 for share, left in told)
    assert told[-1][0] == 1


def test_a_log_in_the_file(small, tmp_path):
    log_of(tmp_path)
    edit(small, 'name = "fine"\n', 'name = "fine"\nlog = { file = "meter.csv", start_s = 0.5 }\n')
    case = load_winding(small).cases[0]
    assert case.log is not None
    assert (case.log.raw.tension.size, case.log.start) == (101, 0.5)


@pytest.mark.parametrize("name", ["nine_cases", "sensitivity", "sensitivity_reference"])
def test_the_shipped_files_are_scenes_of_the_paper(name):
    study = load_winding(DATA / f"{name}.toml")
    for case in study.cases:
        assert case.keys.tex in (32.8, 65.6, 131.2)
        assert case.scene.diameter <= 0.037e-3 * case.keys.tex**0.5 * (1 + 1e-12)
    nine = [case for case in study.cases if case.variant is None]
    if name == "nine_cases":
        assert len({(case.keys.tex, case.keys.drum_rpm) for case in nine}) == len(nine) == 9
        assert {(case.keys.tex, round(100 * case.scene.tension)) for case in nine} == {
            (32.8, 30), (65.6, 50), (131.2, 50),
        }  # fmt: skip
        longest = next(case for case in nine if case.name == study.package_case)
        assert longest.scene.wound_length == pytest.approx(9.0, rel=0.02)


BAD = [
    ("tex = 60", "text = 60", ("number 1", "unknown key 'text'", "did you mean 'tex'?")),
    ("tex = 60\n", "", ("number 1", "'tex' is missing")),
    ("tex = 60", "tex = -60", ("'tex' is -60", "greater than 0")),
    ("tex = 60", 'tex = "60"', ("'tex' is '60'", "number")),
    ("speed_m_s = 6", "speed_m_s = 0", ("speed_m_s = 0", "must be greater than 0")),
    ("bobbin_diameter_mm = 40", "bobbin_diameter_mm = -40", ("bobbin_diameter_mm = -40", "greater than 0")),
    ("element_mm = 4", "element_mm = 40", ("element_mm = 40", "guide_distance")),
    ("duration_s = 0.4", "duration_s = nan", ("'duration_s' is nan", "finite")),
    ("duration_s = 0.4", "duration_s = 1e9", ("duration_s = 1e+09", "0.001 to 3600 s")),
    ("duration_s = 0.4", "duration_s = 3000", ("duration_s = 3000", "elements of yarn, at most 100000")),
    ("duration_s = 0.4", "duration_s = 0.0005", ("duration_s = 0.0005", "0.001 to 3600 s")),
    ("bobbin_diameter_mm = 40", "bobbin_diameter_mm = 10", ("element_mm = 4", "quarter of the bobbin's radius")),
    ("element_mm = 4", "grip_length_mm = 0", ("grip_length_mm = 0", "greater than 0")),
    ("element_mm = 4", "tension_slope_cN_per_s = -1000", ("tension_slope_cN_per_s = -1000", "to the end of the run")),
    ("element_mm = 4", "grip_length_mm = 1e12", ("grip_length_mm = 1e+12", "1e-05 to 1 m")),
    ("modulus_N_per_tex = 2.5", "modulus_N_per_tex = 1e200", ("modulus_N_per_tex = 1e+200", "EA", "1e+06 N")),
    ("tension_cN = 50", "tension_cN = 0.2", ("tension_cN = 0.2", "must exceed ρV² = 0.00216 N")),
    ("element_mm = 4", "winding_angle_deg = 60", ("winding_angle_deg = 60", "45°")),
    ("element_mm = 4", "prony_weights = [0.123, 924.09]", ("prony_weights = 0.123, 924.09", "sum < 1")),
    ("element_mm = 4", "elements_mm = 4", ("[scene]", "unknown key 'elements_mm'", "did you mean 'element_mm'?")),
    ('mode = "fast"', 'mode = "quick"', ("'mode' is 'quick'", "'fast'")),
    ('name = "fine"\n', "", ("number 1", "'name' is missing")),
    ('name = "fine"', 'name = "coarse, 1000 r/min"', ("named twice",)),
    ('name = "fine"\n', 'name = "fine"\nlog = "none.csv"\n', ("log: 'none.csv' is not there",)),
    (
        'case = "coarse, 1000 r/min"',
        'case = "coarse"',
        ("[[vary]] number 1", "unknown case 'coarse'", "known: coarse, 1000 r/min, fine"),
    ),
    ("transverse_stiffness_N_per_mm2", "transverse_stiffness", ("unknown parameter", "did you mean")),
    ("values = [0.4, 4]", "values = [0.4, 0.4]", ("0.4 is given twice",)),
    ("values = [0.4, 4]", "values = [-1]", ("transverse_stiffness_N_per_mm2 = -1", "greater than 0")),
    ("values = [0.4, 4]", "values = []", ("'vary.0.values'",)),
    ('name = "small"', 'name = "small', ("not TOML",)),
]


@pytest.mark.parametrize(("old", "new", "words"), BAD, ids=range(len(BAD)))
def test_bad_input_is_one_line_and_writes_nothing(yarnval, small, tmp_path, old, new, words):
    edit(small, old, new)
    ran = yarnval("wind", small, "--out", tmp_path / "out")
    assert ran.code == 2
    assert "small.toml" in ran.line
    assert all(word in ran.line for word in words), ran.line
    assert not (tmp_path / "out").exists()


CALLS = [
    (["--case", "coarse"], "--case: unknown case 'coarse'; known: coarse, 1000 r/min, fine"),
    (["--mode", "quick"], "--mode: unknown mode 'quick'"),
    (["--log", "meter.csv"], "--log: 'meter.csv' names no case of 2"),
    (["--log", "fin=meter.csv"], "--log: unknown case 'fin'; did you mean 'fine'?"),
    (["--log", "fine=none.csv"], "none.csv: cannot be read"),
    (["--log", "fine=meter.csv", "--profile", "eltex"], "no such layout"),
    (["--log", "fine=meter.csv", "--log", "fine=meter.csv"], "--log: two logs for the case 'fine'"),
    (["--checkpoint", "none/state.npz"], "none/state.npz: no such folder"),
    (["--checkpoint", "."], ".: a folder; give a file in it"),
]


@pytest.mark.parametrize(("options", "line"), CALLS, ids=range(len(CALLS)))
def test_a_wrong_call_is_one_line_and_writes_nothing(yarnval, small, tmp_path, monkeypatch, options, line):
    monkeypatch.chdir(tmp_path)
    log_of(tmp_path)
    ran = yarnval("wind", small, "--out", tmp_path / "out", *options)
    assert ran.code == 2
    assert line in ran.line
    assert not (tmp_path / "out").exists()


def test_missing_file(yarnval, tmp_path):
    ran = yarnval("wind", tmp_path / "none.toml")
    assert ran.code == 2
    assert "no such file; give a winding file" in ran.line


def test_a_folder_with_other_files_is_refused_before_the_work(yarnval, small, tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.winding.run.run_winding", lambda *_, **__: 1 / 0)
    thesis = tmp_path / "out/small/thesis.docx"
    thesis.parent.mkdir(parents=True)
    thesis.write_text("years of work")
    ran = yarnval("wind", small, "--out", tmp_path / "out")
    assert ran.code == 2
    assert "'thesis.docx', which is not part of a winding report" in ran.line


def test_a_checkpoint_goes_on_only_with_its_own_scene(small, tmp_path):
    fine, coarse, *_ = load_winding(small).cases
    path = tmp_path / "state.npz"
    state = {"position": np.arange(6.0), "step": np.array([7])}
    new = FileCheckpoint(path, fine.scene)
    assert new.load() is None
    new.save(state)
    again = FileCheckpoint(path, fine.scene).load()
    assert again is not None
    assert {name: list(values) for name, values in again.items()} == {n: list(v) for n, v in state.items()}
    with pytest.raises(InputError, match="the state of another scene"):
        FileCheckpoint(path, coarse.scene)
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", b"tension,time\n1,2\n"):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"not a whole \.npz file"):
            FileCheckpoint(path, fine.scene)
    np.savez(path, other=np.arange(3))
    with pytest.raises(InputError, match="no state of a winding run"):
        FileCheckpoint(path, fine.scene)


def test_each_run_gets_its_own_checkpoint_and_ends_when_another_fails(small, tmp_path, monkeypatch):
    study = load_winding(small)
    kept = checkpoints(tmp_path / "state.npz", study.cases)
    given = {}

    def wind(scene, *, progress, checkpoint):
        given[scene.linear_density, scene.transverse_stiffness] = checkpoint
        if len(given) == 2:
            raise InputError("state.npz", "the disk is full", "make room")
        while True:  # a long run: it ends only by being stopped
            progress(0.5)

    monkeypatch.setattr("pipeline.winding.run.wind", wind)
    with pytest.raises(InputError, match="the disk is full"):
        run_winding(study, checkpoints=kept)
    first = list(given.values())[:2]  # a third run may begin before it hears that another failed
    assert {checkpoint.path for checkpoint in first} == {kept[case.label].path for case in study.cases[:2]}


def test_every_case_has_its_own_checkpoint(small, tmp_path):
    cases = load_winding(small).cases
    kept = checkpoints(tmp_path / "state.npz", cases)
    names = [kept[case.label].path.name for case in cases]
    assert len(set(names)) == len(cases) == len(kept)
    assert all(re.fullmatch(r"state-[0-9A-Za-z.-]+\.npz", name) for name in names)
    assert checkpoints(tmp_path / "state.npz", cases[:1])["fine"].path.name == "state.npz"


def test_a_finished_reference_run_is_read_back_for_its_page(yarnval, small, tmp_path):
    edit(small, "duration_s = 0.4", "duration_s = 0.2")
    call = ("wind", small, "--mode", "reference", "--case", "fine", "--checkpoint", tmp_path / "state.npz")
    assert yarnval(*call, "--out", tmp_path / "first").code == 0
    study = load_winding(small, only="fine", mode="reference")
    told: list[float] = []
    kept = checkpoints(tmp_path / "state.npz", study.cases)
    run_winding(study, checkpoints=kept, progress=lambda share, _: told.append(share))
    assert told in ([], [1.0])  # nothing left to be wound
    assert yarnval(*call, "--out", tmp_path / "again").code == 0
    first, again = ((tmp_path / name / "small" / "layers.csv").read_bytes() for name in ("first", "again"))
    assert first == again
    tension = [
        store.read_tree(tmp_path / name / "small" / "results.nc", FORMAT)["runs/run_0/span_tension"].values
        for name in ("first", "again")
    ]
    assert np.array_equal(*tension)


@pytest.mark.parametrize("mode", ["fast", "reference"])
def test_a_run_too_short_to_lay_a_layer_has_its_page(yarnval, small, tmp_path, mode):
    edit(small, "duration_s = 0.4", "duration_s = 0.01")
    assert yarnval("wind", small, "--mode", mode, "--case", "fine", "--out", tmp_path / "out").code == 0
    text = (tmp_path / "out" / "small" / "wind.html").read_text(encoding="utf-8")
    assert "layers.svg" not in text
    assert "Figure 7" in text
