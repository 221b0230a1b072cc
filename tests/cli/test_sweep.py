"""`yarnval sweep`: the folder, the tables, the figures' data, failed rows, bad inputs."""

import csv
import json
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from pipeline.report import sweep as page
from pipeline.report import sweep_figures
from pipeline.sweep import RESULTS, load_sweep, run_sweep

DATA = Path(__file__).parents[2] / "data_samples"
SMALL = """\
name = "small"
title = "A <small> sweep"
source = "made up"
models = ["flexible", "cosserat"]
source_model = "cosserat"
relation_figure = "fig06"

[dimensionless]
phi_deg = 60
mu = 0.8
R0_bar = 0.03
T_CD_bar = 1
p3_CD_bar = 600
vb_over_v = 1

[[sets]]
name = "plain"
k = 1
eta = 1
note = "not fitted"

[[studies]]
name = "wrap angle"
parameter = "phi_deg"
values = [30, 60]
figure = "fig07"
paths = true

[[quoted]]
study = "wrap angle"
value = 30
quantity = "bending_mean_bar"
published = 1.51
where = "section 3.1"
"""
SI = """\
[scene]
phi_deg = 60
r0_mm = 3
d_mm = 0.18
mu = 0.8
T_CD_tpm = 333.3333333333333
p3_CD_cN = { value = 20, cv_percent = 5 }
K_Nm2 = 3e-9
v_m_s = 0.2
vb_over_v = 1
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    file = tmp_path / "small.toml"
    file.write_text(SMALL, encoding="utf-8")
    return file


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")


def read(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_the_folder_is_whole_and_its_numbers_agree(yarnval, small, tmp_path):
    ran = yarnval("sweep", small, "--out", tmp_path / "out", "--json")
    assert ran.code == 0
    assert ran.err == ""
    folder = tmp_path / "out/small"
    assert {path.name for path in folder.iterdir()} == page.CONTENTS
    assert {path.name for path in folder.parent.iterdir()} == {"small"}
    names = {"fig06", "fig07", "fig07_paths", "quoted"}
    assert {path.stem for path in (folder / "figures").iterdir()} == names
    for path in (folder / "figures").iterdir():
        ET.parse(path)
    document, rows = json.loads(ran.out), read(folder / "sweep.csv")
    assert [(r["value"], r["model"]) for r in rows] == [
        ("30.0", "flexible"), ("30.0", "cosserat"), ("60.0", "flexible"), ("60.0", "cosserat"),
    ]  # fmt: skip
    for row, other in zip(rows, document["rows"], strict=True):
        assert all(float(row[name]) == other[name] for name in RESULTS)
    assert float(rows[3]["p3_B_bar"]) == pytest.approx(321.2447, rel=2e-6)  # physics: the reference solution
    assert float(rows[3]["T_C_bar"]) == pytest.approx(1)
    quoted = {row["model"]: row for row in read(folder / "quoted.csv")}
    ours = float(rows[1]["bending_mean_bar"])
    assert float(quoted["cosserat"]["ours"]) == ours
    assert float(quoted["cosserat"]["difference_percent"]) == pytest.approx((ours / 1.51 - 1) * 100)
    html = (folder / "sweep.html").read_text(encoding="utf-8")
    assert f'<data value="{ours!r}">' in html
    assert "A &lt;small&gt; sweep" in html
    assert html.count("<figure>") == 4
    assert "<script" not in html
    assert str(tmp_path) not in html


def test_figures_show_the_table(small):
    sweep = load_sweep(small)
    rows = run_sweep(sweep)
    figure = sweep_figures.effects(sweep, rows, sweep.studies[0])
    drawn = [row for row in rows if row.model == "cosserat"]
    for axes, profile in zip(figure.axes, sweep_figures.LABELS, strict=True):
        lines = axes.get_lines()
        assert len(lines) == len(drawn)
        unit = "deg" if profile == "theta" else "bar"
        for line, row in zip(lines, drawn, strict=True):
            psi, y = line.get_data()
            assert psi[-1] == pytest.approx(row.value)
            assert (y[0], y[-1]) == (row.numbers[f"{profile}_B_{unit}"], row.numbers[f"{profile}_C_{unit}"])
    closed, _, points = sweep_figures.relation(sweep, rows).axes[0].get_lines()
    x, y = closed.get_data()
    assert y * x == pytest.approx(1.3 / (2 * math.pi))
    ratios = [row.numbers["bending_mean_bar"] / row.numbers["torsion_mean_bar"] for row in drawn]
    assert list(points.get_ydata()) == ratios
    paths = sweep_figures.paths(sweep, rows, sweep.studies[0])
    assert len(paths.axes) == 2


def test_si_keys_give_the_same_numbers(small):
    """The base scene in SI units, with the same normalised numbers."""
    expected = run_sweep(load_sweep(small))
    text = SMALL[: SMALL.index("[dimensionless]")] + SI + SMALL[SMALL.index("[[sets]]") :]
    small.write_text(text, encoding="utf-8")
    for row, other in zip(run_sweep(load_sweep(small)), expected, strict=True):
        assert row.numbers == pytest.approx(other.numbers, rel=1e-6)


def test_a_failed_row_keeps_its_reason(yarnval, small, tmp_path):
    edit(small, "values = [30, 60]", "values = [0, 30, 60]")
    ran = yarnval("sweep", small, "--out", tmp_path / "out")
    assert ran.code == 1
    assert len(ran.err.splitlines()) == 2
    assert "phi_deg = 0: must be greater than 0" in ran.err
    rows = read(tmp_path / "out/small/sweep.csv")
    assert [row["outcome"] for row in rows] == ["bad_input"] * 2 + ["converged"] * 4
    assert all(math.isnan(float(row[name])) for row in rows[:2] for name in RESULTS)
    assert "No solution: φ = 0°, plain." in (tmp_path / "out/small/sweep.html").read_text(encoding="utf-8")


def test_a_quoted_number_without_a_solution_stays_visible(yarnval, small, tmp_path):
    edit(small, "values = [30, 60]", "values = [0, 60]")
    edit(small, "value = 30", "value = 0")
    ran = yarnval("sweep", small, "--out", tmp_path / "out", "--json")
    assert ran.code == 1
    assert [row["ours"] for row in json.loads(ran.out)["quoted"]] == [None, None]
    assert [(a["known"], a["total"]) for a in json.loads(ran.out)["agreement"]] == [(0, 1)] * 2


def test_nothing_solved_and_nothing_quoted_is_a_page_too(yarnval, small, tmp_path):
    edit(small, "values = [30, 60]", "values = [0]")
    edit(small, SMALL[SMALL.index("[[quoted]]") :], "")
    ran = yarnval("sweep", small, "--out", tmp_path / "out")
    assert ran.code == 1
    folder = tmp_path / "out/small"
    assert {path.name for path in folder.iterdir()} == page.CONTENTS - {"quoted.csv"}
    assert "phi_deg = 0: must be greater than 0" in (folder / "sweep.html").read_text(encoding="utf-8")


BAD = [
    ('parameter = "phi_deg"', 'parameter = "phi_degrees"', ("wrap angle", "phi_degrees", "did you mean 'phi_deg'?")),
    ('parameter = "phi_deg"', 'parameter = "k"', ("unknown parameter 'k'",)),
    ("values = [30, 60]", "values = []", ("studies.0.values", "at least 1")),
    ("values = [30, 60]", 'values = [30, "60"]', ("studies.0.values.1", "'60'", "valid number")),
    ("values = [30, 60]", "values = [30, nan]", ("studies.0.values.1", "finite")),
    ("values = [30, 60]", "values = [30, 60, 30]", ("30 is given twice",)),
    ("mu = 0.8", "mue = 0.8", ("[dimensionless]", "unknown key 'mue'", "did you mean 'mu'?")),
    ("mu = 0.8", "mu = -1", ("[dimensionless]", "mu = -1", "must be 0 or greater")),
    ("mu = 0.8", 'mu = "0.8"', ("[dimensionless]", "'mu' is '0.8'")),
    ("mu = 0.8", "mu = 0.8\nk = 2", ("[dimensionless]", "'k'", "[[sets]]")),
    ("[dimensionless]", "[scene]", ("unknown key 'R0_bar'",)),
    ("[[sets]]", SI + "[[sets]]", ("[scene]", "[dimensionless]", "not both")),
    ("eta = 1", "ita = 1", ("sets.0.ita", "did you mean 'eta'?")),
    ('source_model = "cosserat"', 'source_model = "cosserrat"', ("did you mean 'cosserat'?",)),
    ('source_model = "cosserat"', 'source_model = "kirchhoff"', ("unknown source_model 'kirchhoff'",)),
    ('figure = "fig07"', 'figure = "fig06"', ("figure 'fig06' is named twice",)),
    ('figure = "fig07"', 'figure = "../fig07"', ("studies.0.figure",)),
    ('quantity = "bending_mean_bar"', 'quantity = "bending_mean"', ("number 1", "did you mean 'bending_mean_bar'?")),
    ("value = 30", "value = 31", ("value 31 is not in study 'wrap angle'", "30, 60")),
    ("published = 1.51", "published = 0", ("published = 0",)),
    ('name = "small"', 'name = "small', ("not TOML",)),
]


@pytest.mark.parametrize(("old", "new", "words"), BAD, ids=range(len(BAD)))
def test_bad_input_is_one_line_and_writes_nothing(yarnval, small, tmp_path, old, new, words):
    edit(small, old, new)
    ran = yarnval("sweep", small, "--out", tmp_path / "out")
    assert ran.code == 2
    assert "small.toml" in ran.line
    assert all(word in ran.line for word in words), ran.line
    assert not (tmp_path / "out").exists()


def test_missing_file(yarnval, tmp_path):
    ran = yarnval("sweep", tmp_path / "none.toml")
    assert ran.code == 2
    assert "no such file; give a sweep file" in ran.line


def test_a_folder_with_other_files_is_not_replaced(yarnval, small, tmp_path):
    thesis = tmp_path / "out/small/thesis.docx"
    thesis.parent.mkdir(parents=True)
    thesis.write_text("years of work")
    ran = yarnval("sweep", small, "--out", tmp_path / "out")
    assert ran.code == 2
    assert "'thesis.docx', which is not part of a sweep" in ran.line
    assert [path.name for path in thesis.parent.iterdir()] == ["thesis.docx"]


def test_a_failing_step_leaves_the_earlier_sweep(small, tmp_path, monkeypatch):
    sweep = load_sweep(small)
    rows = run_sweep(sweep)
    page.write_sweep(sweep, rows, tmp_path / "small")
    before = (tmp_path / "small/sweep.csv").read_bytes()
    monkeypatch.setattr(page.Page, "to_html", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        page.write_sweep(sweep, rows[::-1], tmp_path / "small")
    assert (tmp_path / "small/sweep.csv").read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {"small", "small.toml"}


def test_the_sweeps_are_no_studies():
    from pipeline.case import find_studies

    assert [folder.name for folder in find_studies([DATA])] == ["rig", "yin2020"]
