"""The figures of a sweep: its rows in, a matplotlib Figure out, as in figures.py.

Colour tells the value of the parameter, dashes the set of k and η; everything is of the sweep's `source_model`.
"""

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator

from models.outcome import Solution
from pipeline.keys import ParameterKeys
from pipeline.records import Array
from pipeline.report.figures import FLAGGED, MEASURED, captioned, draw_cylinder, styled
from pipeline.sweep import QuotedRow, Sweep, SweepRow, dimensionless_profile

LABELS = {
    "p3": ("tension p₃", "K/r₀²"),
    "T": ("twist T", "1/r₀"),
    "theta": ("angle θ", "°"),
    "bending": ("bending moment", "K/r₀"),
    "torsion": ("torsional moment", "K/r₀"),
}
"""Name and unit by the first part of a result's name."""
_PARTS = {"B": "at B", "C": "at C", "mean": "mean", "arc_mean": "mean over arc length"}
_PARAMETERS = {
    "phi_deg": ("φ", "°"),
    "mu": ("μ", ""),
    "vb_over_v": ("v_b/v", ""),
    "R0_bar": ("R₀/r₀", ""),
    "T_CD_bar": ("T_CD r₀", ""),
    "p3_CD_bar": ("p₃CD r₀²/K", ""),
    "lAB_over_lCD": ("l_AB/l_CD", ""),
    "B_over_K": ("B/K", ""),
}
_DASHES = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)))
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")


def quantity_label(result: str) -> str:
    """A result's name in words, with its unit: 'bending_mean_bar' is 'mean bending moment (K/r₀)'."""
    profile, _, rest = result.partition("_")
    name, unit = LABELS[profile]
    part = rest.rpartition("_")[0]
    return f"{_PARTS[part]} {name} ({unit})" if "mean" in part else f"{name} {_PARTS[part]} ({unit})"


def setting(parameter: str, value: float) -> str:
    """A parameter and its value: 'φ = 30°'. A key with a unit in its name stands as it is."""
    symbol, unit = _PARAMETERS.get(parameter, (parameter, ""))
    return f"{symbol} = {value:g}{unit}"


def _dashes(sweep: Sweep) -> dict[str, Any]:
    return {pair.name: _DASHES[index % len(_DASHES)] for index, pair in enumerate(sweep.sets)}


def _colours(study: ParameterKeys) -> dict[float, Any]:
    shades = matplotlib.colormaps["viridis"](np.linspace(0, 0.82, len(study.values)))
    return dict(zip(study.values, map(tuple, shades), strict=True))


def drawn(sweep: Sweep, rows: Sequence[SweepRow], study: ParameterKeys) -> list[tuple[SweepRow, Solution]]:
    """The rows of a study that its figures show: solved ones of the source's model."""
    return [
        (row, row.solution)
        for row in rows
        if row.study.name == study.name and row.model == sweep.source_model and row.ok and row.solution is not None
    ]


def _absent(sweep: Sweep, rows: Sequence[SweepRow], study: ParameterKeys) -> str:
    missing = [
        f"{setting(study.parameter, row.value)}, {row.pair.name}"
        for row in rows
        if row.study.name == study.name and row.model == sweep.source_model and not row.ok
    ]
    return f" No solution: {'; '.join(missing)}." if missing else ""


def _legend(figure: Figure, sweep: Sweep, study: ParameterKeys) -> None:
    handles = [Line2D([], [], color=c, label=setting(study.parameter, value)) for value, c in _colours(study).items()]
    handles += [Line2D([], [], color="#444444", linestyle=d, label=name) for name, d in _dashes(sweep).items()]
    figure.legend(handles=handles, loc="outside upper left", ncols=2)


@styled
def effects(sweep: Sweep, rows: Sequence[SweepRow], study: ParameterKeys) -> Figure:
    """Tension, twist, angle and both moments along the contact, a colour a value and dashes for k and η."""
    colours, dashes = _colours(study), _dashes(sweep)
    caption = (
        f"Effect of {study.name}, by {sweep.source_model}, along the contact from B (ψ = 0) to C (ψ = φ)."
        f"{_absent(sweep, rows, study)}"
    )
    figure = captioned(caption, height=6.8)
    grid = figure.subplots(3, 2).ravel()
    for row, solution in drawn(sweep, rows, study):
        assert solution.profile is not None  # a converged solution has one
        profile = dimensionless_profile(solution.profile, solution.scene)
        for axes, name in zip(grid, LABELS, strict=False):
            axes.plot(profile["psi"], profile[name], color=colours[row.value], linestyle=dashes[row.pair.name])
    for axes, (name, unit) in zip(grid, LABELS.values(), strict=False):
        axes.set_title(f"{name} ({unit})", loc="left", fontsize=10)
        axes.xaxis.set_major_locator(MaxNLocator(4))
    for axes in grid[3:5]:
        axes.set_xlabel("ψ (°)")
    grid[5].remove()
    _legend(figure, sweep, study)
    return figure


@styled
def paths(sweep: Sweep, rows: Sequence[SweepRow], study: ParameterKeys) -> Figure:
    """The yarn on the cylinder for each value, lengths in r₀."""
    dashes, colours = _dashes(sweep), _colours(study)
    shown = drawn(sweep, rows, study)
    caption = (
        f"Path of the yarn over the cylinder, by {sweep.source_model}; lengths in cylinder radii r₀; the surface moves "
        f"along z.{_absent(sweep, rows, study)}"
    )
    values = list(dict.fromkeys(row.value for row, _ in shown))
    figure = captioned(caption, height=0.8 + 2.8 * max(1, len(values)))
    # One cylinder and one view for all values, so that the eye compares the paths.
    wrap = max((solution.scene.wrap_angle for _, solution in shown), default=1.0)
    heights = [z for _, solution in shown for z in _path(solution)[2]]
    for place, value in enumerate(values, 1):
        axes = figure.add_subplot(len(values), 1, place, projection="3d")
        axes.set_proj_type("ortho")
        for row, solution in shown:
            if row.value == value:
                axes.plot(*_path(solution), color=colours[value], linestyle=dashes[row.pair.name], zorder=5)
        draw_cylinder(axes, 1.0, wrap, (min(heights), max(heights)), "r₀")
        axes.set_title(setting(study.parameter, value), fontsize=11)
    _legend(figure, sweep, study)
    return figure


def _path(solution: Solution) -> tuple[Array, Array, Array]:
    """x, y, z of the yarn in r₀."""
    assert solution.profile is not None  # a converged solution has one
    z = dimensionless_profile(solution.profile, solution.scene)["z"]
    return np.cos(solution.profile.psi), np.sin(solution.profile.psi), z


@styled
def relation(sweep: Sweep, rows: Sequence[SweepRow]) -> Figure:
    """Mean bending over mean torsional moment against the mean twist, with the closed form of a yarn across the axis.

    At θ = 90° the curvature is 1/r₀ and τ = 2πT, so that the moments' ratio is B/(2πK T r₀).
    """
    pair = sweep.sets[0]
    solved = [(study, drawn(sweep, rows, study)) for study in sweep.studies]
    ratios = {solution.scene.rigidity_ratio for _, found in solved for _, solution in found}
    caption = (
        f"Mean bending over mean torsional moment against the mean twist, by {sweep.source_model} with {pair.name}. "
        "Line: a yarn that lies across the cylinder's axis, B/(2πK T r₀). Left of the cross, where both moments are "
        "equal, bending is the larger one."
    )
    figure = captioned(caption, height=4.4)
    axes = figure.subplots()
    if not ratios:
        axes.text(0.5, 0.5, "no solution", transform=axes.transAxes, ha="center", color=FLAGGED)
        return figure
    twist = np.geomspace(0.1, 5, 50)
    for ratio in sorted(ratios):
        axes.plot(
            twist, ratio / (2 * np.pi * twist), color=MEASURED, linewidth=1, label=f"across the axis, B = {ratio:g} K"
        )
        axes.plot(ratio / (2 * np.pi), 1, "x", color=MEASURED)
    for (study, found), marker in zip(solved, cycle(_MARKERS), strict=False):
        points = [row.numbers for row, _ in found if row.pair.name == pair.name and row.numbers["torsion_mean_bar"]]
        axes.plot(
            [abs(p["T_mean_bar"]) for p in points],
            [abs(p["bending_mean_bar"] / p["torsion_mean_bar"]) for p in points],
            marker, fillstyle="none", label=study.name,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.minorticks_off()
    axes.set_xlabel("mean twist T (1/r₀)")
    axes.set_ylabel("bending over torsional moment")
    figure.legend(loc="outside upper left", ncols=2)
    return figure


@styled
def differences(sweep: Sweep, quoted: Sequence[QuotedRow]) -> Figure:
    """Each quoted number's difference from ours in %, a mark a set."""
    here = [row for row in quoted if row.model == sweep.source_model]
    parameters = {study.name: study.parameter for study in sweep.studies}
    caption = (
        f"Difference of our numbers ({sweep.source_model}) from those quoted in the source, in % of the latter. "
        "A mark on the line agrees."
    )
    figure = captioned(caption, height=1.6 + 0.36 * len(sweep.quoted))
    axes = figure.subplots()
    axes.axvline(0, color=MEASURED, linewidth=1)
    place = np.arange(len(sweep.quoted))[::-1]
    for index, pair in enumerate(sweep.sets):
        values = [row.difference_percent for row in here if row.pair.name == pair.name]
        colour = ("#D55E00", "#0072B2", "#009E73", "#CC79A7")[index % 4]
        axes.plot(values, place, _MARKERS[index % len(_MARKERS)], color=colour, label=pair.name)
    names = [
        f"{quantity_label(q.quantity).rpartition(' (')[0]}, {setting(parameters[q.study], q.value)}"
        for q in sweep.quoted
    ]
    axes.set_yticks(place, names, fontsize=9)
    axes.set_xlabel("difference (%)")
    figure.legend(loc="outside upper left", ncols=2)
    return figure
