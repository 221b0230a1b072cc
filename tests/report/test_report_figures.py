"""What the figures plot: the numbers of the tree, not the pixels."""

import math
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import report_study
from matplotlib.colors import to_hex
from scenes import table_1

from models.solve import MODELS
from pipeline import store
from pipeline.case import load_study
from pipeline.records import Quantity
from pipeline.report import figures
from pipeline.run import evaluate


def line(axes, label):
    (found,) = [one for one in axes.get_lines() if one.get_label() == label]
    return found


@pytest.mark.parametrize("quantity", list(Quantity))
def test_figure_13_plots_the_tree(tree, quantity):
    figure = figures.measured_against_models(tree, quantity)
    (axes,) = figure.axes
    index = list(Quantity).index(quantity)
    (bars,) = axes.containers
    measured, _, (segments,) = bars
    np.testing.assert_array_equal(measured.get_ydata(), [values[index] for values in report_study.MEASURED.values()])
    u_D = tree[f"comparison/{quantity}"]["u_D"].values
    for segment, mean, u in zip(segments.get_segments(), measured.get_ydata(), u_D, strict=True):
        if math.isfinite(u):
            assert segment[:, 1].tolist() == [mean - u, mean + u]
        else:
            assert segment.size == 0
    for model in report_study.MODELS:
        expected = [report_study.SIMULATED.get((case, model), [math.nan] * 3)[index] for case in report_study.MEASURED]
        np.testing.assert_array_equal(line(axes, model).get_ydata(), expected)
    published = [(9.6, 1020.0, 73.1)[index], math.nan]
    np.testing.assert_array_equal(line(axes, "the paper's simulation").get_ydata(), published)
    assert quantity.unit in axes.get_ylabel()
    assert "No solution: cosserat in raw-1." in figure.get_label()
    assert ("No uncertainty is known for published-1" in figure.get_label()) == (quantity is Quantity.THETA_B)


def test_profiles_are_in_the_units_of_their_titles(tree):
    figure = figures.profiles(tree, "published-1")
    stored = tree["profiles/published-1/kirchhoff"]
    scales = {"tension": 100, "twist": 1, "theta": math.degrees(1), "bending_moment": 1e6, "torsional_moment": 1e6}
    assert len(figure.axes) == len(scales)
    for axes, (name, scale) in zip(figure.axes, scales.items(), strict=True):
        np.testing.assert_allclose(line(axes, "kirchhoff").get_ydata(), stored[name] * scale, rtol=1e-14)
        np.testing.assert_allclose(line(axes, "kirchhoff").get_xdata(), np.degrees(stored["psi"]), rtol=1e-14)


def test_a_failed_model_has_no_profile(tree):
    labels = {one.get_label() for one in figures.profiles(tree, "raw-1").axes[0].get_lines()}
    assert labels == {"capstan", "flexible", "kirchhoff"}


def test_the_path_lies_on_the_cylinder(tree):
    (axes,) = figures.path(tree, "published-1").axes
    x, y, z = line(axes, "cosserat").get_data_3d()
    np.testing.assert_allclose(np.hypot(x, y), 3.0, rtol=1e-14)
    np.testing.assert_array_equal(z, tree["profiles/published-1/cosserat"]["z"].values * 1e3)


def test_error_against_speed_plots_every_model_and_quantity(tree):
    (axes,) = figures.error_against_speed(tree).axes
    points = {(float(one.get_xdata()[0]), round(float(one.get_ydata()[0]), 9)) for one in axes.get_lines()}
    assert len(points) == 12
    assert (3.0, 5.0) in points  # cosserat, tension: the one case that it solved


def test_a_model_has_one_colour_everywhere(tree):
    (axes,) = figures.measured_against_models(tree, "T_AB_tpm").axes
    panels = figures.profiles(tree, "published-1").axes
    (solid,) = figures.path(tree, "published-1").axes
    for model in report_study.MODELS:
        colours = {to_hex(line(where, model).get_color()) for where in (axes, panels[0], panels[4], solid)}
        assert len(colours) == 1


def test_the_tension_trace_shows_the_log_and_its_flags(tree, results):
    raw = results.measured[1].tension[0].raw
    figure = figures.tension_trace(tree, "raw-1", 0)
    top, below = figure.axes
    np.testing.assert_array_equal(top.get_lines()[0].get_ydata(), raw.tension * 100)
    lanes = dict(zip((text.get_text() for text in below.get_yticklabels()), below.get_lines(), strict=True))
    assert set(lanes) == {"missing", "spike", "stuck"}
    assert lanes["spike"].get_xdata().tolist() == [7.0]
    assert (lanes["stuck"].get_xdata().min(), lanes["stuck"].get_xdata().max()) == (
        10.0,
        pytest.approx(10.99, abs=0.02),
    )
    assert "missing 10, stuck 100, spike 1" in figure.get_label()


@pytest.mark.parametrize("n", [10, 2000, 2001, 54_321])
def test_a_long_trace_keeps_its_extremes(n):
    rng = np.random.default_rng(n)
    time, value = np.arange(n) / 100, rng.normal(size=n)
    value[n // 3], value[n // 2] = 50.0, -60.0
    value[: n // 10] = math.nan
    when, shown = figures._extremes(time, value)
    assert np.nanmax(shown) == 50.0
    assert np.nanmin(shown) == -60.0
    assert shown.size <= 2000 or n <= 2000
    assert np.all(np.diff(when) >= 0)
    assert set(when) <= set(time)
    assert np.isnan(shown[0])


def test_a_long_log_makes_a_small_drawing(results):
    measured = results.measured[1]
    long = replace(results, measured=(results.measured[0], replace(measured, tension=(report_study.log(200_000),))))
    figure = figures.tension_trace(store.to_tree(long), "raw-1", 0)
    assert "extremes of 1000 stretches" in figure.get_label()
    assert len(figures.to_svg(figure, "long")) < 200_000


def test_clip_series_plot_each_frame_and_say_what_is_not_credible(tree, results):
    clip = results.measured[1].yarn[0]
    angle, angles, twist, _, diameter, _, hairs, *_ = figures.clip_series(tree, "raw-1", 0).axes
    np.testing.assert_array_equal(angle.get_lines()[0].get_ydata(), np.degrees(clip.theta))
    np.testing.assert_array_equal(twist.get_lines()[0].get_ydata(), clip.twist)
    np.testing.assert_array_equal(diameter.get_lines()[0].get_ydata(), clip.diameter * 1e3)
    np.testing.assert_array_equal(hairs.get_lines()[0].get_ydata(), clip.hairiness * 1e-3)
    assert sum(bar.get_width() for bar in angles.patches) == 39
    blind = figures.clip_series(tree, "raw-1", 1)
    assert [text.get_text() for text in blind.axes[2].texts] == ["not credible"]
    assert "12 px across the yarn" in blind.get_label()


def test_the_contact_sheet_draws_the_axis_as_displayed(tree):
    figure = figures.contact_sheet(tree, "raw-1", 0)
    shown = [axes for axes in figure.axes if axes.images]
    assert [axes.get_title() for axes in shown] == ["#0  no twist", "#10  +800 tpm", "#20  +800 tpm", "#30  +800 tpm"]
    axis, upper, lower = shown[1].get_lines()
    (x1, y1), (x2, y2) = axis.get_xy1(), axis.get_xy2()
    # Rows run top-down, so a yarn that rises to the right has a falling row number.
    assert math.atan2(-(y2 - y1), x2 - x1) == pytest.approx(0.2)
    assert math.dist(upper.get_xy1(), lower.get_xy1()) == pytest.approx(30.0)


@pytest.mark.parametrize("synthetic", [True, False])
def test_a_synthetic_figure_says_so_itself(synthetic):
    tree = store.to_tree(report_study.study(synthetic=synthetic))
    svg = figures.to_svg(figures.measured_against_models(tree, "p3_AB_cN"), "f")
    assert ("SYNTHETIC DATA" in svg) == synthetic


def test_svg_is_the_same_each_time_and_its_ids_are_its_own(tree):
    first = figures.to_svg(figures.profiles(tree, "raw-1"), "one")
    assert first == figures.to_svg(figures.profiles(tree, "raw-1"), "one")
    other = figures.to_svg(figures.profiles(tree, "raw-1"), "two")
    ids = [set(re.findall(r'\bid="([^"]+)"', svg)) for svg in (first, other)]
    assert ids[0]
    assert not ids[0] & ids[1]
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', first))
    assert used
    assert used <= ids[0]
    root = ElementTree.fromstring(first)
    assert root.get("role") == "img"
    assert root.get("aria-label", "").startswith("raw-1: from B")
    assert "<text" in first


def test_the_frame_term_is_what_is_left_between_the_two_rods():
    yin2020 = Path(__file__).parents[2] / "data_samples" / "yin2020"
    figure = figures.frame_term(store.to_tree(evaluate(load_study(yin2020))))
    for axes, name in zip(figure.axes, ("tension_AB", "twist_AB", "theta_B"), strict=True):
        heights = [patch.get_height() for patch in axes.patches]
        for case in (1, 2, 3):
            yarn, rod, printed = (getattr(MODELS[m](table_1(case)).ends, name) for m in figures.FRAME_TERM_MODELS)
            assert heights[case - 1] == pytest.approx(100 * (rod / yarn - 1))
            assert heights[case + 2] == pytest.approx(100 * (printed - rod) / yarn)
    # Of the tension's drop in case 1 the frame term is all, and more.
    assert figure.axes[0].patches[0].get_height() > 0
    assert figure.axes[0].patches[3].get_height() < -15
