"""Findings, sensitivities, figures and store of a winding study, on results of known numbers (synthetic)."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import winding_study
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from models.winding.result import WindingOutcome
from pipeline import store
from pipeline.report import package_picture, winding_animation, winding_figures
from pipeline.report import winding as page
from pipeline.report import winding_tables as tables
from pipeline.winding.findings import Verdict, findings, fineness, layers, rise
from pipeline.winding.run import row, turns
from pipeline.winding.sensitivity import sensitivities
from pipeline.winding.store import FORMAT, to_tree

WEAK_INSIDE = (0.5, 0.6, 1.0, 1.1)


@pytest.fixture
def study(tmp_path):
    return winding_study.small(tmp_path)


def test_a_rise_is_found_by_its_slope(study):
    rows = winding_study.made_up(study, rise=0.1)
    assert rise(rows).verdict is Verdict.REPRODUCED
    level = winding_study.made_up(study)
    assert rise(level).verdict is Verdict.NOT_REPRODUCED
    mixed = rise([*level[:3], rows[3]])
    assert mixed.verdict is Verdict.ONLY_IF
    assert "transverse_stiffness_N_per_mm2 = 4" in mixed.why
    assert "2 of 2 cases" in mixed.why
    assert rise([]).verdict is Verdict.NOT_ASKED


def test_weak_inside_and_strong_outside(study):
    weak = winding_study.made_up(study, layers=WEAK_INSIDE)
    assert layers(weak).verdict is Verdict.REPRODUCED
    even = winding_study.made_up(study, layers=(0.9, 0.9, 0.95, 1.0))
    assert layers(even).verdict is Verdict.NOT_REPRODUCED
    mixed = layers([*even[:2], weak[2], even[3]])
    assert mixed.verdict is Verdict.ONLY_IF
    assert "transverse_stiffness_N_per_mm2 = 0.4, fast mode (inner half at 0.55 T₀, outer half at 1.05 T₀)" in mixed.why
    few = winding_study.made_up(study, layers=(0.2, 1.0, 1.2))
    assert layers(few).verdict is Verdict.NOT_ASKED


def test_fineness_counts_only_at_equal_end_tension(study, tmp_path):
    fine, coarse, *_ = winding_study.made_up(study)
    assert fineness([fine, coarse]).verdict is Verdict.NOT_REPRODUCED
    _, higher, *_ = winding_study.made_up(study, mean=0.52)
    assert fineness([fine, higher]).verdict is Verdict.REPRODUCED
    shaken = row(coarse.case, replace(coarse.result, span_tension=2 * coarse.result.span_tension - 0.5))
    only = fineness([fine, shaken])
    assert only.verdict is Verdict.ONLY_IF
    assert "2.00 times" in only.why
    text = winding_study.SMALL.replace("tex = 60\n", "tex = 60\ntension_cN = 30\n")
    other = winding_study.made_up(winding_study.small(tmp_path, text))
    assert fineness(other).verdict is Verdict.NOT_ASKED
    assert "input" in fineness(other).why
    assert fineness([fine]).verdict is Verdict.NOT_ASKED


def test_sensitivities_are_changes_against_the_case(study):
    base = winding_study.made_up(study, layers=(0.8, 0.9))
    soft = winding_study.made_up(study, mean=0.505, layers=(0.7, 0.88, 1.0))
    first, second = sensitivities([*base[:2], soft[2], base[3]])
    assert first.value == "0.4"
    assert first.own == "24"  # what the scene takes where the file says nothing
    assert first.span_percent == pytest.approx(1, rel=1e-3)
    assert (first.first_layer, first.last_layer, first.largest_layer) == pytest.approx((-0.1, -0.02, 0.1))
    assert (first.span_said, first.layers_said) == ("robust", "not robust")
    assert second.span_said == second.layers_said == "no part of this mode"


def test_a_failed_run_keeps_its_row(study, tmp_path):
    rows = winding_study.made_up(study, layers=WEAK_INSIDE)[:2]
    failed = replace(
        rows[0].result,
        outcome=WindingOutcome.DIVERGED, message="the motion is no longer finite",
        time=np.empty(0), span_tension=np.empty(0), guide_phase=np.empty(0), guide_position=np.empty(0),
        layers_T_over_T0=np.empty(0), snapshots=(),
    )  # fmt: skip
    rows[0] = row(rows[0].case, failed)
    page.write_winding(study, rows, tmp_path / "out")
    html = (tmp_path / "out/wind.html").read_text(encoding="utf-8")
    assert "Not completed: fine: the motion is no longer finite" in html
    document = tables.document(rows)
    first = document["cases"][0]  # pyright: ignore[reportIndexIssue]
    assert first["outcome"] == "diverged"
    assert first["span"]["mean_cN"] is None
    assert first["span"]["samples_30_cN"] == [None] * 8
    json.dumps(document, allow_nan=False)


def test_figures_show_the_rows(study):
    rows = winding_study.made_up(study, layers=WEAK_INSIDE)
    base = rows[:2]
    figure = winding_figures.tension_in_time(base)
    for axes, shown in zip(figure.axes, base, strict=True):
        thin, thick, end, dots, crosses = axes.get_lines()
        assert np.array_equal(thin.get_ydata(), 100 * shown.result.span_tension)
        assert np.asarray(thick.get_ydata())[0] == pytest.approx(100 * shown.result.span_tension[:10].mean())
        assert list(end.get_ydata()) == [50, 50]
        assert np.array_equal(dots.get_ydata(), 100 * shown.samples)
        assert len(np.asarray(crosses.get_xdata())) == np.count_nonzero(shown.extremes)
    profile = winding_figures.layer_tension(base).axes[0].get_lines()
    assert [tuple(line.get_ydata()) for line in profile[:2]] == [WEAK_INSIDE] * 2
    fineness_figure = winding_figures.effect_of_fineness(base)
    assert fineness_figure is not None
    below = fineness_figure.axes[1]
    means = next(c for c in below.containers).lines[0].get_ydata()
    assert list(means) == [r.span.mean / r.end_tension for r in base]
    assert winding_figures.effect_of_fineness(base[:1]) is None
    left, right = winding_figures.sensitivity(rows[1], rows[2:]).axes
    assert [c.lines[0].get_ydata()[0] for c in left.containers] == [100 * r.span.mean for r in rows[1:]]
    assert len(right.get_lines()) == 4


def test_the_package_is_coloured_by_tension_over_the_end_tension(study):
    shown = winding_study.made_up(study)[1]
    figure = winding_figures.package(shown)
    last = shown.result.snapshots[-1]
    lines = figure.axes[1].collections[-1]
    values = np.asarray(lines.get_array())
    middle = (last.tension[:-1] + last.tension[1:]) / 2 / shown.end_tension
    assert 0 < values.size < middle.size  # the far side is hidden
    assert set(values) <= set(middle)
    assert figure.axes[1].get_title() == "4 layers, 0.40 s"


def test_the_view_hides_what_the_bobbin_covers():
    """Seen from −x: the near side is drawn, the far side is not, and the outer turn lies over the inner one."""
    bobbin = package_picture.Bobbin((1.0, 1.0), (-2.0, 2.0))
    axes = Figure().subplots()
    near = np.array([[-1.0, 0.0, z] for z in (-1.0, 0.0, 1.0)])
    far = near * [-1, 1, 1]
    outer = 1.1 * near
    points = np.concatenate([outer, near, far])
    value = np.array([5.0, 5.0, math.nan, 1.0, 1.0, math.nan, 9.0, 9.0, 9.0])  # NaN: not joined
    drawn = package_picture.draw_yarn(axes, points, value, bobbin, Normalize(0, 9), 1.0)
    shades = list(np.asarray(drawn.get_array()))
    assert shades == [1.0, 5.0]  # what is painted later lies on top
    right = package_picture.project(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]))
    assert right[0, 0] > 0
    assert right[1, 1] > 0


def test_frames_hold_what_was_laid_by_then(study):
    shown = winding_study.made_up(study)[1]
    shots = shown.result.snapshots
    laid = winding_figures.laid_by(shots, 0.3)
    assert laid is not None
    assert laid[0].shape == (75, 3)  # half way from 50 nodes at 0.2 s to 100 at 0.4 s
    assert np.array_equal(laid[0], shots[1].position[:75])
    assert winding_figures.laid_by(shots, 0.0) is None
    assert len(winding_figures.frames(shown).axes) == 6


def test_the_animation_is_small_and_the_same_again(study, tmp_path):
    shown = winding_study.made_up(study)[1]
    moments = winding_animation.moments(shown)
    assert np.all(np.diff(moments) >= 0)
    assert moments[winding_animation.SLOW_FRAMES - 1] == pytest.approx(0.2)  # two layers of 0.1 s
    assert moments[-1] == shown.result.time[-1]
    for name in ("once.gif", "twice.gif"):
        winding_animation.write_animation(shown, tmp_path / name)
    once = (tmp_path / "once.gif").read_bytes()
    assert once == (tmp_path / "twice.gif").read_bytes()
    assert once.startswith(b"GIF89a")
    assert len(once) < 1e6
    html = winding_animation.animation_html(tmp_path / "once.gif", shown)
    assert html.startswith("<details>")
    assert 'alt="The winding, coarse, 1000 r/min:' in html


def test_turns_of_the_guide(study):
    shown = winding_study.made_up(study)[0]
    assert turns(shown.result) == pytest.approx(np.arange(0.05, 0.41, 0.05))


def test_the_tree_holds_the_rows_and_survives_its_file(study, tmp_path):
    rows = winding_study.made_up(study, layers=WEAK_INSIDE)
    tree = to_tree(study, rows, findings(rows), {"study": "small"})
    store.write_tree(tree, tmp_path / "results.nc")
    read = store.read_tree(tmp_path / "results.nc", FORMAT)
    assert read.identical(tree)
    runs = read["runs"].to_dataset()
    assert list(runs["name"].values) == [r.name for r in rows]
    assert runs["span_mean"].attrs["units"] == "cN"
    assert runs["span_mean"].values == pytest.approx([100 * r.span.mean for r in rows], rel=1e-15)
    run = read["runs/run_1"].to_dataset()
    assert np.array_equal(run["span_tension"].values, rows[1].result.span_tension)
    assert list(run["layers_T_over_T0"].values) == list(WEAK_INSIDE)
    assert np.array_equal(read["runs/run_1/snapshot_1/position"].values, rows[1].result.snapshots[1].position)
    assert math.isclose(run.attrs["scene_tension"], 0.5)
    with pytest.raises(store.InputError, match="format"):
        store.read_tree(tmp_path / "results.nc")
