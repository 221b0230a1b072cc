"""`yarnval bench` and the options of `predict` for the model auto."""

import csv
import json
from pathlib import Path

import pytest

from pipeline import bench
from pipeline.peers import HAVE_CASADI
from pipeline.report.bench_figures import bench_figure, outcome_map

CASE = Path(__file__).parents[2] / "data_samples" / "yin2020" / "case1" / "case.toml"


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "SECONDS", 0.0)


def test_the_tables_and_the_figure_are_written(yarnval, tmp_path, quick) -> None:
    out = tmp_path / "bench"
    ran = yarnval("bench", "--out", out, "--scenes", "3", "--rows", "20", "--json")
    assert ran.code == 0
    document = json.loads(ran.out)
    costs = document["costs"]
    assert {cost["method"] for cost in costs} == {
        "capstan", "flexible", "cosserat", "kirchhoff", "cosserat-fd", bench.BVP, bench.SHOOTING,
        *([bench.CASADI] if HAVE_CASADI else []),
    }  # fmt: skip
    # Each method's best setting is right: to 1e-8, or what its kind can reach.
    best = {c["method"]: min(d["relative_error_p3_AB"] for d in costs if d["method"] == c["method"]) for c in costs}
    assert best.pop("capstan") < 1e-2
    assert best.pop("cosserat-fd") < 1e-4
    assert all(error < 1e-8 for error in best.values()), best
    assert all(cost["seconds_per_solve"] > 0 for cost in costs)
    for fate in document["fates"]:
        assert fate["solved"] + fate["explained"] + fate["unexplained"] == pytest.approx(1)
    assert {rate["model"] for rate in document["rates"]} == {"capstan", "flexible", "cosserat", "kirchhoff"}
    with (out / "work_precision.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == len(costs)
    assert (out / "work_precision.svg").read_text(encoding="utf-8").startswith("<?xml")
    with (out / "outcomes.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 3 * 4
    page = (out / "bench.html").read_text(encoding="utf-8")
    assert page.count("<figure") == 2
    assert "Hard cases" in page


def test_a_folder_that_cannot_be_made_is_refused_first(yarnval, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    ran = yarnval("bench", "--out", tmp_path / "file" / "bench")
    assert ran.code == 2
    assert "cannot be made" in ran.line


def test_the_figure_shows_the_shares() -> None:
    costs = [
        bench.Cost("a", "x", 5, 1e-3, 1e-4),
        bench.Cost("a", "y", 9, 1e-6, 2e-4),
        bench.Cost("b", "x", 1, 1e-2, 1e-5),
    ]
    figure = bench_figure(costs, [bench.Fate("a", 10, 0.7, 0.2, 0.1)])
    widths = [patch.get_width() for patch in figure.axes[2].patches]
    assert widths == pytest.approx([70, 20, 10])
    assert figure.axes[0].get_lines()[0].get_xdata().tolist() == pytest.approx([0.1, 0.2])


def test_the_map_counts_outcomes_and_shows_each_in_its_place() -> None:
    found = [
        bench.Ending("a", 0, 10.0, 0.5, "converged"),
        bench.Ending("a", 1, 20.0, 0.0, "fold"),
        bench.Ending("b", 0, 10.0, 0.5, "converged"),
    ]
    axes = outcome_map(found, ["a", "b"]).axes
    assert [text.get_text() for text in axes[0].get_legend().get_texts()] == ["converged (1)", "fold (1)"]
    assert axes[0].collections[1].get_offsets().tolist() == [[20.0, 1e-4]]  # Γ = 0 stands at the lower edge
    assert [text.get_text() for text in axes[1].get_legend().get_texts()] == ["converged (1)"]
    assert [f.solved for f in bench.fates(found)] == [0.5, 1.0]


def test_auto_says_what_it_chose(yarnval) -> None:
    ran = yarnval("predict", CASE, "--model", "auto", "--tol", "0.02", "--json")
    assert ran.code == 0
    (row,) = json.loads(ran.out)
    assert row["model"] == "auto"
    assert row["message"].startswith("by flexible: ")


@pytest.mark.parametrize(
    ("option", "value", "found"),
    [("--tol", "0", "found 0.0"), ("--tol", "nan", "found nan"), ("--quantity", "p3_AB", "unknown quantity 'p3_AB'")],
)
def test_wrong_options_are_one_line(yarnval, option: str, value: str, found: str) -> None:
    ran = yarnval("predict", CASE, "--model", "auto", option, value)
    assert ran.code == 2
    assert not ran.out
    assert found in ran.line
