"""The figures of a winding study: its rows in, a matplotlib Figure out, as in figures.py."""

import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from models.winding.calibrate import QUANTILES
from models.winding.result import Integers, Snapshot, WindingResult
from models.winding.scene import WindingScene
from pipeline.records import Array
from pipeline.report.figures import FLAGGED, MEASURED, captioned, styled
from pipeline.report.package_picture import Bobbin, draw_bobbin, draw_yarn, project
from pipeline.winding.calibration import CalibratedStudy
from pipeline.winding.keys import written
from pipeline.winding.metric import SENSOR, SPACING
from pipeline.winding.run import Row

SPAN = "#0072B2"
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_FRAMES = 6
_ACROSS = 3
_END_TENSION: dict[str, Any] = {"color": "#6e6e6e", "linewidth": 0.9, "linestyle": (0, (4, 2))}
_POINTS_PER_INCH = 72
_PANEL = 2.6
"""Width of a picture of the package [inch]."""


def sensed(time: Array, tension: Array) -> tuple[Array, Array]:
    """The series as a sensor of 100 Hz reads it: means over its interval; time [s] at their middles."""
    step = max(1, round(SENSOR / float(np.median(np.diff(time))))) if time.size > 1 else 1
    whole = time.size // step * step
    return time[:whole].reshape(-1, step).mean(axis=1), tension[:whole].reshape(-1, step).mean(axis=1)


@styled
def tension_in_time(rows: Sequence[Row]) -> Figure:
    """Tension between guide and bobbin against time, a panel a case (the paper's Fig. 7)."""
    measured = any(row.case.log for row in rows)
    caption = (
        "Tension between guide and bobbin against time, as in the paper's Fig. 7: thin, means over 1 ms; thick, over "
        f"10 ms, as a sensor of 100 Hz reads it; dots, the samples {SPACING:g} s apart that the error is over; "
        "crosses, extremes of the guide's collision, which are left out; dashed, the end tension T₀. "
        + ("Black: the measured log." if measured else "The paper's measured curves are not published.")
    )
    across = min(_ACROSS, len(rows))
    down = math.ceil(len(rows) / across)
    figure = captioned(caption, height=1.0 + 1.75 * down)
    grid = np.atleast_1d(figure.subplots(down, across, sharex=True, sharey="row", squeeze=False)).ravel()
    for axes, row in zip(grid, rows, strict=False):
        _trace(axes, row)
        axes.set_title(row.case.name, fontsize=10)
        axes.xaxis.set_major_locator(MaxNLocator(3))
    for axes in grid[len(rows) :]:
        axes.remove()
    figure.supxlabel("time (s)", fontsize=11)
    figure.supylabel("tension (cN)", fontsize=11)
    return figure


def _trace(axes: Axes, row: Row) -> None:
    time, tension = row.result.time, 100 * row.result.span_tension
    if not time.size:
        axes.text(0.5, 0.5, "no result", transform=axes.transAxes, ha="center", color=FLAGGED)
        return
    axes.plot(time, tension, color=SPAN, linewidth=0.5, alpha=0.45, rasterized=True)
    axes.plot(*sensed(time, tension), color=SPAN, linewidth=1.2)
    scene = row.case.scene
    ends = np.array([0.0, scene.duration])
    axes.plot(ends, 100 * (scene.tension + scene.tension_slope * ends), **_END_TENSION)
    axes.plot(row.sample_time, 100 * row.samples, ".", color="#D55E00", markersize=4)
    axes.plot(time[row.extremes], tension[row.extremes], "x", color=FLAGGED, markersize=2.5, markeredgewidth=0.6)
    if row.case.log:
        log = row.case.log
        at = log.raw.time - log.start
        inside = (at >= 0) & (at <= scene.duration)
        axes.plot(at[inside], 100 * log.raw.tension[inside], color=MEASURED, linewidth=0.9)


@styled
def effect_of_fineness(rows: Sequence[Row]) -> Figure | None:
    """Tension of yarns of different fineness at the highest speed (the paper's Fig. 8), and means, spread and peaks.

    None where no two cases share a speed.
    """
    speeds = sorted({row.speed for row in rows})
    shared = [v for v in speeds if len({row.tex for row in rows if row.speed == v}) > 1]
    if not shared:
        return None
    fastest = sorted((row for row in rows if row.speed == shared[-1]), key=lambda row: row.tex)
    caption = (
        f"Effect of fineness. Above, tension at {shared[-1]:g} m/s as a sensor of 100 Hz reads it, as in the paper's "
        "Fig. 8. Below, over the end tension T₀, which is an input: mean with its standard deviation (the bar), and "
        "the largest value (open), at each speed."
    )
    figure = captioned(caption, height=5.6)
    above, below = figure.subplots(2, 1)
    for row, colour in zip(fastest, _COLOURS, strict=False):
        above.plot(*sensed(row.result.time, 100 * row.result.span_tension), color=colour, label=f"{row.tex:g} tex")
        above.axhline(100 * row.end_tension, **_END_TENSION)
    above.set_xlabel("time (s)")
    above.set_ylabel("tension (cN)")
    above.legend(ncols=3, loc="lower left", bbox_to_anchor=(0, 1))
    offsets = np.linspace(-0.16, 0.16, len(shared)) if len(shared) > 1 else [0.0]
    fineness = sorted({row.tex for row in rows})
    for speed, offset, colour, marker in zip(shared, offsets, _COLOURS[3:] + _COLOURS[:3], _MARKERS, strict=False):
        here = sorted((row for row in rows if row.speed == speed), key=lambda row: row.tex)
        place = np.array([fineness.index(row.tex) for row in here]) + offset
        mean = np.array([row.span.mean / row.end_tension for row in here])
        sd = np.array([row.span.sd / row.end_tension for row in here])
        peak = [row.span.peak / row.end_tension for row in here]
        below.errorbar(place, mean, yerr=sd, fmt=marker, color=colour, label=f"{speed:g} m/s", markersize=5)
        below.plot(place, peak, marker, color=colour, fillstyle="none", markersize=5)
    below.axhline(1, **_END_TENSION)
    below.set_xticks(range(len(fineness)), [f"{tex:g}" for tex in fineness])
    below.grid(visible=False, axis="x")
    below.set_xlabel("fineness (tex)")
    below.set_ylabel("tension over T₀")
    figure.legend(*below.get_legend_handles_labels(), ncols=4, loc="outside lower center")
    return figure


@styled
def package(row: Row) -> Figure:
    """The yarn on the bobbin, coloured by its tension over T₀, as the layers come on (the paper's Fig. 9)."""
    shots = row.result.snapshots
    high = max((float(np.percentile(shot.tension, 99)) for shot in shots if shot.tension.size), default=1.0)
    norm = Normalize(0, max(1.2, math.ceil(10 * high / row.end_tension) / 10), clip=True)
    caption = (
        f"Tension along the yarn on the bobbin over the end tension T₀, {row.name}, seen from the guide: the package "
        "when its layers were complete and at the end, as in the paper's Fig. 9. Dark yarn is weak. To scale, the "
        "yarn's diameter too."
    )
    figure = captioned(caption, height=0.9 + 1.85 * math.ceil(max(1, len(shots)) / 2))
    figure.get_layout_engine().set(w_pad=0, h_pad=0.02)  # pyright: ignore[reportOptionalMemberAccess, reportCallIssue]
    grid = figure.subplots(math.ceil(max(1, len(shots)) / 2), 2, squeeze=False).ravel()
    scene = row.case.scene
    for axes, shot in zip(grid, shots, strict=False):
        lines = _package(axes, scene, shot.position, shot.tension / row.end_tension, norm)
        complete = math.floor(float(np.interp(shot.time, row.result.time, row.result.guide_phase)))
        axes.set_title(f"{complete} layer{'s' if complete != 1 else ''}, {shot.time:.2f} s", fontsize=10)
        if shot is shots[-1]:
            figure.colorbar(
                lines, ax=list(grid), location="bottom", shrink=0.7, aspect=30, pad=0.02, label="tension over T₀"
            )
    for axes in grid[len(shots) :]:
        axes.remove()
    return figure


def _package(axes: Axes, scene: WindingScene, points: Array, value: Array, norm: Normalize) -> LineCollection:
    bobbin = _bobbin(scene)
    draw_bobbin(axes, bobbin, 0.12 * scene.stroke)
    return draw_yarn(axes, points, value, bobbin, norm, _line_width(axes, scene))


def _line_width(axes: Axes, scene: WindingScene) -> float:
    """The yarn's diameter in points, but enough to be seen."""
    return max(0.5, scene.diameter / float(np.ptp(axes.get_xlim())) * _PANEL * _POINTS_PER_INCH)


def _bobbin(scene: WindingScene) -> Bobbin:
    half, grow = scene.stroke / 2, math.tan(scene.cone_angle)
    return Bobbin((scene.bobbin_radius - grow * half, scene.bobbin_radius + grow * half), (-half, half))


@styled
def frames(row: Row) -> Figure:
    """Six moments of the winding: bobbin, laid yarn, guide and the yarn between them, as seen by one who stands by."""
    result, scene = row.result, row.case.scene
    caption = (
        f"The winding, {row.name}, seen from the guide's side: the bobbin as it has turned, the yarn laid so far (the "
        "last layer orange), the guide (black) and the yarn between them."
    )
    figure = captioned(caption, height=0.4 + 2.1 * _FRAMES / 2)
    figure.get_layout_engine().set(w_pad=0, h_pad=0.02)  # pyright: ignore[reportOptionalMemberAccess, reportCallIssue]
    moments = scene.duration * np.arange(1, _FRAMES + 1) / _FRAMES
    for axes, moment in zip(figure.subplots(_FRAMES // 2, 2).ravel(), moments, strict=True):
        frame(axes, result, float(moment))
        axes.set_title(f"{moment:.2f} s", fontsize=10)
    return figure


def frame(axes: Axes, result: WindingResult, moment: float) -> None:
    """Bobbin, laid yarn, guide and the yarn between them at one moment [s]."""
    scene = result.scene
    laid = laid_by(result.snapshots, moment)
    bobbin = _bobbin(scene)
    draw_bobbin(axes, bobbin, 0.12 * scene.stroke)
    if laid is None:
        return
    points, layer = laid
    # The yarn's last laid point is where the yarn touches: turn the bobbin until it is on top.
    turn = math.pi / 2 - math.atan2(points[-1, 1], points[-1, 0])
    points = points @ _about_z(turn).T
    colours = ListedColormap(["#56789a", "#D55E00"])
    lines = draw_yarn(
        axes, points, (layer == layer[-1]).astype(float), bobbin, Normalize(0, 1), _line_width(axes, scene)
    )
    lines.set_cmap(colours)
    eye = np.array([-scene.guide_distance, scene.bobbin_radius + scene.diameter / 2, 0.0])
    behind = eye - np.array([0.35 * scene.guide_distance, 0.0, 0.0])
    guide = np.array([0.0, 0.0, np.interp(moment, result.time, result.guide_position)])
    end = np.array([0.0, 0.0, scene.stroke / 2])
    free = project(np.stack([points[-1], eye + guide, behind + guide]))
    axes.plot(free[:, 0], free[:, 1], color="#D55E00", linewidth=0.9, zorder=4)
    axes.plot(*free[1], "o", color=MEASURED, markersize=4, zorder=5)
    # One view for all frames: wherever the guide goes.
    reach = project(np.stack([behind - end, eye + end]))
    low, high = axes.get_xlim()
    axes.set_xlim(min(low, float(reach[:, 0].min())), max(high, float(reach[:, 0].max())))


def laid_by(snapshots: Sequence[Snapshot], moment: float) -> tuple[Array, Integers] | None:
    """Positions (n, 3) and layers (n,) of what was laid by a time [s]; None where fewer than two nodes were.

    The nodes lie in order, so that their number at a time between two snapshots follows from the two numbers there.
    """
    times = [0.0, *(shot.time for shot in snapshots)]
    counts = [0, *(shot.layer.size for shot in snapshots)]
    count = round(float(np.interp(moment, times, counts)))
    after = next((shot for shot in snapshots if shot.layer.size >= count), None)
    if after is None or count < 2:
        return None
    return after.position[:count], after.layer[:count]


def _about_z(angle: float) -> Array:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


@styled
def layer_tension(rows: Sequence[Row]) -> Figure:
    """Mean tension of each complete layer at the end over T₀, a line a case."""
    caption = (
        "Mean tension of the complete layers at the end over the end tension T₀, innermost first. On the dashed line a "
        "layer has kept the tension that it was laid with."
    )
    figure = captioned(caption, height=4.6)
    axes = figure.subplots()
    shades = matplotlib.colormaps["viridis"](np.linspace(0, 0.85, len(rows)))
    for row, shade, marker in zip(rows, shades, _cycled(_MARKERS, len(rows)), strict=True):
        place = np.arange(1, row.layers.size + 1)
        axes.plot(place, row.layers, marker=marker, markersize=4, color=tuple(shade), label=row.name)
    axes.axhline(1, **_END_TENSION)
    axes.set_xlabel("layer, from the bobbin outwards")
    axes.set_ylabel("tension over T₀")
    low, high = axes.get_ylim()
    axes.set_ylim(min(0.0, low), max(1.05, high))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.legend(loc="outside upper left", ncols=2)
    return figure


def _cycled(items: Sequence[str], count: int) -> list[str]:
    return [items[index % len(items)] for index in range(count)]


@styled
def calibration(fit: CalibratedStudy, row: Row) -> Figure:
    """What was measured, and the same from the scene before and after the fit; from the page's own run too."""
    found = fit.calibration
    layered = fit.kind == "layers"
    caption = f"Calibration to {fit.origin.name}: " + (
        "tension of the layers over T₀, innermost first."
        if layered
        else "quantiles of the tension between guide and bobbin."
    )
    figure = captioned(caption, height=3.6)
    axes = figure.subplots()
    place, scale = (np.arange(1, found.measured.size + 1), 1.0) if layered else (100 * QUANTILES, 100.0)
    axes.plot(place, scale * found.measured, "D", color=MEASURED, markersize=5, label="measured")
    axes.plot(place, scale * found.before, "--", color="#6e6e6e", label="as given")
    axes.plot(place, scale * found.after, color=SPAN, label="fitted, fast mode")
    if layered:
        run = row.layers[: found.measured.size]
        axes.plot(place[: run.size], run, "x", color="#D55E00", label=f"this run, {row.result.mode} mode")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("layer, from the bobbin outwards" if layered else "quantile (%)")
    axes.set_ylabel("tension over T₀" if layered else "tension (cN)")
    figure.legend(loc="outside upper left", ncols=2)
    return figure


@styled
def sensitivity(base: Row, variants: Sequence[Row]) -> Figure:
    """What one parameter does: mean tension of the span, and the layers' profile, beside those of the case itself."""
    first = variants[0].case.variant
    assert first is not None  # a variant has one
    caption = (
        f"Effect of {first.group.name} ({first.group.parameter}) on {base.case.name}. Left, mean tension between guide "
        "and bobbin, the bar its standard deviation; right, tension of the layers. Black: the case itself."
    )
    figure = captioned(caption, height=3.4)
    left, right = figure.subplots(1, 2)
    shades = matplotlib.colormaps["viridis"](np.linspace(0, 0.85, len(variants)))
    names = ["case", *(written(row.case.variant.value) for row in variants if row.case.variant)]
    for place, row in enumerate([base, *variants]):
        colour = MEASURED if row is base else tuple(shades[place - 1])
        left.errorbar(place, 100 * row.span.mean, yerr=100 * row.span.sd, fmt="o", color=colour, markersize=5)
        right.plot(np.arange(1, row.layers.size + 1), row.layers, color=colour, marker=".", linewidth=1.3)
    left.axhline(100 * base.end_tension, **_END_TENSION)
    right.axhline(1, **_END_TENSION)
    left.set_xticks(range(len(names)), names, rotation=45 if max(map(len, names)) > 4 else 0, fontsize=9)
    left.set_xlim(-0.5, len(names) - 0.5)
    left.grid(visible=False, axis="x")
    left.set_ylabel("mean tension (cN)")
    right.set_xlabel("layer")
    right.set_ylabel("tension over T₀")
    right.xaxis.set_major_locator(MaxNLocator(integer=True))
    handles = [
        Line2D([], [], color=MEASURED if row is base else tuple(shades[i - 1]), label=name)
        for i, (row, name) in enumerate(zip([base, *variants], names, strict=True))
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=4)
    return figure
