"""The report's figures: the results tree in, a matplotlib Figure out. The figure's label (`get_label`) is its caption.

The palette is Okabe and Ito's, which colour-blind readers can tell apart; markers and dashes differ as well.
"""

import io
import math
import re
from pathlib import Path
from xml.sax.saxutils import quoteattr

import matplotlib
import matplotlib.style
import numpy as np
import xarray as xr
from IPython.display import display
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator
from mpl_toolkits.mplot3d import Axes3D

from pipeline.records import Array, Quantity
from pipeline.report import tables

_STYLE = str(Path(__file__).with_name("yarnval.mplstyle"))
styled = matplotlib.rc_context(fname=_STYLE)

MEASURED = "#000000"
PAPER = "#6e6e6e"
FLAGGED = "#c0392b"
_LOOK = {
    "capstan": ("#CC79A7", "v", ":"),
    "flexible": ("#0072B2", "s", "--"),
    "cosserat": ("#D55E00", "o", "-"),
    "cosserat-fd": ("#E69F00", "P", "-."),
    "kirchhoff": ("#009E73", "^", (0, (6, 1.5))),
}
_OTHER = ("#56B4E9", "X", (0, (1, 1)))
_TRACE_BINS = 1000
_SHOTS = 12


def _look(model: str) -> tuple[str, str, object]:
    """Colour, marker and dashes of a model, the same in every figure."""
    return _LOOK.get(model, _OTHER)


def captioned(caption: str, *, height: float = 3.8) -> Figure:
    """An empty figure of the page's width."""
    figure = Figure(figsize=(5.4, height))
    figure.set_label(caption)
    return figure


def _figure(tree: xr.DataTree, caption: str, *, height: float = 3.8) -> Figure:
    figure = captioned(caption, height=height)
    if tree.attrs["synthetic"]:
        # A figure travels without its page: the word travels with it.
        figure.suptitle("SYNTHETIC DATA", x=0.99, ha="right", fontsize=10, color=FLAGGED, weight="bold")
    return figure


@styled
def measured_against_models(tree: xr.DataTree, quantity: str) -> Figure:
    """Figure 13: per case the measured mean with its uncertainty, each model, and the source's own simulation."""
    q = Quantity(quantity)
    data = tree[f"comparison/{q}"].to_dataset()
    paper = tree[f"published/{q}"].to_dataset()["S"].values
    cases, models = tables.cases(tree), tables.models(tree)
    M, u_D = data["M"].values, data["u_D"].values
    figure = _figure(tree, _comparison_caption(q, cases, models, data), height=4.4)
    axes = figure.subplots()
    series = len(models) + 1 + bool(np.isfinite(paper).any())
    place = np.arange(len(cases))
    offset = np.linspace(-0.3, 0.3, series)
    for x, mean in zip(place, M, strict=True):
        axes.plot([x - 0.36, x + 0.36], [mean, mean], color=MEASURED, linewidth=0.8, alpha=0.5)
    shown = [axes.errorbar(place + offset[0], M, yerr=u_D, fmt="D", color=MEASURED, label="measured ± u_D")]
    for index, model in enumerate(models):
        colour, marker, _ = _look(model)
        shown += axes.plot(place + offset[index + 1], data["S"].values[:, index], marker, color=colour, label=model)
    if np.isfinite(paper).any():
        shown += axes.plot(
            place + offset[-1], paper, "D", color=PAPER, fillstyle="none", label="the paper's simulation"
        )
    axes.set_xticks(place, cases, rotation=0 if len(cases) <= 4 else 90)
    axes.set_xlim(-0.5, len(cases) - 0.5)
    axes.grid(visible=False, axis="x")
    axes.set_xlabel("case")
    axes.set_ylabel(f"{tables.NAMES[q]} {q.symbol} ({q.unit})")
    figure.legend(handles=shown, loc="outside upper left", ncols=2)
    return figure


def _comparison_caption(q: Quantity, cases: list[str], models: list[str], data: xr.Dataset) -> str:
    text = (
        f"Measured and simulated {tables.NAMES[q]} {q.symbol}. Error bars: the standard uncertainty u_D of the "
        "measured value; the thin line carries the measured mean across the case."
    )
    bare = [case for case, u in zip(cases, data["u_D"].values, strict=True) if not math.isfinite(u)]
    if bare:
        text += f" No uncertainty is known for {', '.join(bare)}: no bar is drawn."
    absent = np.argwhere((data["outcome"].values != "") & ~np.isfinite(data["S"].values))
    if absent.size:
        text += f" No solution: {', '.join(f'{models[j]} in {cases[i]}' for i, j in absent)}."
    return text


FRAME_TERM_MODELS = ("flexible", "kirchhoff", "cosserat")


@styled
def frame_term(tree: xr.DataTree) -> Figure:
    """What bending and what the printed model's mixing of frames add to the flexible yarn, per case and quantity.

    From `flexible` to `kirchhoff` is bending and torsion with consistent frames; from `kirchhoff` to `cosserat` the
    frame term (B − K)τ², the only difference between the two rods.
    """
    cases, models = tables.cases(tree), tables.models(tree)
    base, rod, printed = (models.index(model) for model in FRAME_TERM_MODELS)
    figure = _figure(
        tree,
        "Difference from the flexible yarn in per cent of its value: by bending and torsion (the consistent rod), and "
        "by the frame term that the printed model adds: it takes the material's twist for the torsion of the path.",
        height=3.2,
    )
    place = np.arange(len(cases))
    panels = figure.subplots(1, len(Quantity), squeeze=False).ravel()
    for axes, q in zip(panels, Quantity, strict=True):
        values = tree[f"comparison/{q}"].to_dataset()["S"].values
        bending = 100 * (values[:, rod] / values[:, base] - 1)
        frame = 100 * (values[:, printed] - values[:, rod]) / values[:, base]
        axes.bar(place - 0.2, bending, 0.4, color=_look("kirchhoff")[0], label="bending and torsion")
        axes.bar(place + 0.2, frame, 0.4, color=_look("cosserat")[0], label="frame term (B − K)τ²")
        axes.axhline(0.0, color=MEASURED, linewidth=0.8)
        axes.set_xticks(place, cases, rotation=30 if len(cases) <= 4 else 90)
        axes.set_title(q.symbol)
    panels[0].set_ylabel("change of the flexible value (%)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left")  # one column: room for the mark of synthetic data
    return figure


@styled
def profiles(tree: xr.DataTree, case: str) -> Figure:
    """Tension, twist, angle and moments along the contact of one case, a line a model."""
    panels = (
        ("tension", "tension p₃ (cN)", 100.0),
        ("twist", "twist T (tpm)", 1.0),
        ("theta", "angle θ (°)", math.degrees(1)),
        ("bending_moment", "bending Bκ (µN m)", 1e6),
        ("torsional_moment", "torsion Kτ (µN m)", 1e6),
    )
    solved = _solved(tree, case)
    caption = f"{case}: from B, where the contact starts (ψ = 0), to C, where it ends, by {', '.join(solved)}."
    if "flexible" in solved:
        caption += " The flexible model has no bending: its line is the moment that its path would take."
    figure = _figure(tree, caption, height=6.6)
    grid = figure.subplots(3, 2).ravel()
    for axes, (name, label, scale) in zip(grid, panels, strict=False):
        for model, data in solved.items():
            colour, _, dashes = _look(model)
            axes.plot(np.degrees(data["psi"]), data[name] * scale, color=colour, linestyle=dashes, label=model)
        axes.set_title(label, loc="left", fontsize=10)
        axes.xaxis.set_major_locator(MaxNLocator(4))
    for axes in grid[3:5]:
        axes.set_xlabel("ψ (°)")
    grid[5].remove()
    figure.legend(handles=grid[0].get_lines(), loc="outside upper left", ncols=2)
    return figure


def _solved(tree: xr.DataTree, case: str) -> dict[str, xr.Dataset]:
    """Profiles of the models that solved this case, by model, in the study's order."""
    group = tree[f"profiles/{case}"]
    return {m: group[m].to_dataset() for m in tables.models(tree) if m in group.children and "theta" in group[m]}


@styled
def path(tree: xr.DataTree, case: str) -> Figure:
    """The yarn on the cylinder in three dimensions, in mm, a line a model."""
    solved = _solved(tree, case)
    figure = _figure(tree, f"{case}: path of the yarn over the cylinder, whose surface moves along z.", height=4.6)
    axes = figure.add_subplot(projection="3d")
    axes.set_proj_type("ortho")
    for model, data in solved.items():
        colour, _, dashes = _look(model)
        radius = data.attrs["scene_cylinder_radius"] * 1e3
        psi, z = data["psi"].values, data["z"].values * 1e3
        axes.plot(radius * np.cos(psi), radius * np.sin(psi), z, color=colour, linestyle=dashes, label=model, zorder=5)
    some = next(iter(solved.values())).attrs
    radius, wrap = some["scene_cylinder_radius"] * 1e3, some["scene_wrap_angle"]
    heights = [float(h) * 1e3 for data in solved.values() for h in (data["z"].min(), data["z"].max())]
    draw_cylinder(axes, radius, wrap, (min(heights), max(heights)), "mm")
    figure.legend(loc="outside upper left", ncols=2)
    return figure


def draw_cylinder(axes: Axes3D, radius: float, wrap: float, heights: tuple[float, float], unit: str) -> None:
    """The cylinder's surface a little beyond the contact, and axes of equal scale.

    Parameters
    ----------
    wrap : contact angle [rad].
    heights : lowest and highest z of what lies on it, in `unit` like `radius`.
    """
    low, high = heights[0] - 0.25 * radius, heights[1] + 0.25 * radius
    around, along = np.meshgrid(np.linspace(-0.4, wrap + 0.4, 33), [low, high])
    x, y = radius * np.cos(around), radius * np.sin(around)
    axes.plot_surface(x, y, along, color="#cfcfcf", alpha=0.35, linewidth=0, shade=False)
    axes.set_aspect("equal")
    axes.view_init(elev=22, azim=math.degrees(wrap / 2) + 20)
    for axis, name in ((axes.xaxis, "x"), (axes.yaxis, "y"), (axes.zaxis, "z")):
        axis.set_major_locator(MaxNLocator(4))
        axis.set_label_text(f"{name} ({unit})")
        axis.labelpad = 8


@styled
def error_against_speed(tree: xr.DataTree) -> Figure:
    """RMS error of each model and quantity against its median time per solve."""
    table = tables.speed_against_error(tree)
    figure = _figure(
        tree,
        "Root-mean-square error over the cases that were solved, against the median time of one solve. Down and to the "
        "left is better.",
        height=4.4,
    )
    axes = figure.subplots()
    shapes = dict(zip((q.value for q in Quantity), ("o", "s", "^"), strict=True))
    for row in table.to_dict(orient="records"):
        axes.plot(row["wall_ms"], row["rms_E_percent"], shapes[row["quantity"]], color=_look(row["model"])[0])
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.minorticks_off()
    axes.set_ylim(bottom=0)
    axes.set_xlabel("median time of one solve (ms)")
    axes.set_ylabel("RMS of |E| / M (%)")
    models = [Line2D([], [], color=_look(m)[0], marker="o", linestyle="", label=m) for m in tables.models(tree)]
    quantities = [
        Line2D(
            [], [], color="#444444", marker=shape, linestyle="", markerfacecolor="none", label=tables.NAMES[Quantity(q)]
        )
        for q, shape in shapes.items()
    ]
    figure.legend(handles=models + quantities, loc="outside upper left", ncols=3, columnspacing=1.0)
    return figure


@styled
def tension_trace(tree: xr.DataTree, case: str, log: int) -> Figure:
    """One tension log: the trace, the window of the statistics, the mean, and a lane of marks for each flag."""
    data = tree[f"measured/{case}/tension_{log}"].to_dataset()
    time, value = data["time"].values, data["tension"].values * 100
    flag = data["flag"].values
    lanes = _lanes(data["flag"], time)
    window, mean = data["window"].values, float(data["mean"]) * 100
    u = data["mean"].attrs["standard_uncertainty"] * 100
    counts = ", ".join(
        f"{name.replace('_', ' ')} {int(np.sum(flag & mask != 0))}" for name, mask in _masks(data["flag"])
    )
    caption = (
        f"{data.attrs['name']}: {time.size} samples; mean {mean:.2f} cN, u = {u:.2g} cN, over the window between "
        f"the dotted lines. Flagged samples are marked below the trace and left out of the mean: {counts or 'none'}."
    )
    if time.size > 2 * _TRACE_BINS:
        caption += f" Drawn as the extremes of {_TRACE_BINS} stretches."
    figure = _figure(tree, caption, height=3.6 + 0.25 * len(lanes))
    heights = [8, max(0.1, 0.8 * len(lanes))]
    top, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": heights})
    top.plot(*_extremes(time, value), color=MEASURED, linewidth=0.7)
    top.axhline(mean, color="#0072B2", linewidth=1.2)
    for edge in window:
        top.axvline(edge, color="#555555", linestyle=":", linewidth=1.2)
    top.set_ylabel("tension (cN)")
    for height, when in enumerate(lanes.values()):
        below.plot(when, np.full(when.size, height), "|", color=FLAGGED, markersize=9)
    below.set_yticks(range(len(lanes)), list(lanes))
    below.set_ylim(-0.6, max(0.1, len(lanes) - 0.4))
    below.grid(visible=False)
    below.set_xlabel("time (s)")
    return figure


def _masks(flag: xr.DataArray) -> list[tuple[str, int]]:
    """Names and masks of the flags that occur."""
    present = int(np.bitwise_or.reduce(flag.values, initial=0))
    pairs = zip(flag.attrs["flag_meanings"].split(), np.atleast_1d(flag.attrs["flag_masks"]), strict=True)
    return [(name, int(mask)) for name, mask in pairs if present & int(mask)]


def _lanes(flag: xr.DataArray, time: Array) -> dict[str, Array]:
    """Times of the flagged samples by flag, at most one in each stretch that the eye can tell apart."""
    stretch = np.arange(time.size) * _TRACE_BINS // max(1, time.size)
    lanes = {}
    for name, mask in _masks(flag):
        where = np.flatnonzero(flag.values & mask)
        _, first = np.unique(stretch[where], return_index=True)
        lanes[name.replace("_", " ")] = time[where[first]]
    return lanes


def _extremes(time: Array, value: Array) -> tuple[Array, Array]:
    """The series itself if short, else the extremes of each of `_TRACE_BINS` stretches; gaps stay gaps."""
    if time.size <= 2 * _TRACE_BINS:
        return time, value
    kept = []
    for part in np.array_split(np.arange(time.size), _TRACE_BINS):
        good = part[np.isfinite(value[part])]
        kept += (
            sorted({int(good[value[good].argmin()]), int(good[value[good].argmax()])}) if good.size else [int(part[0])]
        )
    return time[kept], value[kept]


@styled
def clip_series(tree: xr.DataTree, case: str, clip: int) -> Figure:
    """Angle, twist, diameter, hairs and the helix' rotation in every frame of one clip, and their distributions."""
    data = tree[f"measured/{case}/yarn_{clip}"].to_dataset()
    angle = "theta" if np.isfinite(data["theta"]).any() else "axis_angle"
    panels = (
        (angle, f"summary_{'theta_B' if angle == 'theta' else angle}", "angle θ_B (°)", math.degrees(1)),
        ("twist", "summary_twist", "twist (tpm)", 1.0),
        ("diameter", "summary_diameter", "diameter (mm)", 1e3),
        ("hairiness", "summary_hairiness", "hairs (1/mm)", 1e-3),
        ("helix_rotation", "summary_helix_rotation", "helix turns (1/s)", 1.0),
    )
    counts = ", ".join(
        f"{name.replace('_', ' ')} {int(np.sum(data['flag'].values & mask != 0))}"
        for name, mask in _masks(data["flag"])
    )
    caption = (
        f"{data.attrs['name']}: {data.sizes['frame']} frames by the method '{data.attrs['method']}'; right, how often "
        f"each value occurs; blue, the mean. Flagged frames: {counts or 'none'}."
    )
    if data.attrs["reason"]:
        caption += f" Not given: {data.attrs['reason']}."
    figure = _figure(tree, caption, height=9.0)
    grid = figure.subplots(len(panels), 2, sharex="col", sharey="row", gridspec_kw={"width_ratios": [3, 1]})
    for (left, right), (name, summary, label, scale) in zip(grid, panels, strict=True):
        values = data[name].values * scale
        good = values[np.isfinite(values)]
        left.set_ylabel(label if name != "axis_angle" else "yarn axis (°)")
        if good.size == 0:
            left.text(0.5, 0.5, "not credible", transform=left.transAxes, ha="center", va="center", color=FLAGGED)
            left.set_yticks([])
            continue
        left.plot(data["time"].values * 1e3, values, ".", color=MEASURED, markersize=4)
        left.axhline(float(data[summary]) * scale, color="#0072B2", linewidth=1.2)
        right.hist(good, bins="sturges", orientation="horizontal", color="#8a8a8a")
    grid[-1, 0].set_xlabel("time (ms)")
    grid[-1, 1].set_xlabel("frames")
    return figure


@styled
def contact_sheet(tree: xr.DataTree, case: str, clip: int) -> Figure:
    """Frames of one clip with the axis, the edges and the twist that were found in them."""
    data = tree[f"measured/{case}/yarn_{clip}"].to_dataset()
    shown = np.unique(np.linspace(0, data.sizes["shot"] - 1, min(_SHOTS, data.sizes["shot"])).astype(int))
    rows = -(-shown.size // 3)
    shape = data.sizes["row"] / data.sizes["column"]
    caption = f"{data.attrs['name']}: axis (solid) and edges (dashed) as found, and the twist of that frame."
    figure = _figure(tree, caption, height=0.5 + rows * (1.75 * shape + 0.35))
    grid = figure.subplots(rows, 3, squeeze=False).ravel()
    for axes in grid:
        axes.axis("off")
    for axes, index in zip(grid, shown, strict=False):
        shot = data.isel(shot=int(index))
        # An id of its own: matplotlib would give two equal images the same one.
        axes.imshow(shot["thumbnail"].values, cmap="gray", vmin=0, vmax=255, gid=f"shot-{index}")
        _found(axes, shot)
        twist = float(shot["shot_twist"])
        label = f"{twist:+.0f} tpm".replace("-", "−") if math.isfinite(twist) else "no twist"
        axes.set_title(f"#{int(shot['shot_frame'])}  {label}", fontsize=9)
    return figure


def _found(axes: Axes, shot: xr.Dataset) -> None:
    x, y = shot["shot_centre"].values
    angle, half = float(shot["shot_axis_angle"]), float(shot["shot_diameter"]) / 2
    if not np.all(np.isfinite([x, y, angle])):
        return
    # Counter-clockwise as displayed, rows top-down: y runs downwards.
    along, across = np.array([math.cos(angle), -math.sin(angle)]), np.array([math.sin(angle), math.cos(angle)])
    for shift, style in ((0.0, "-"), (-half, "--"), (half, "--")):
        if math.isfinite(shift):
            axes.axline(tuple(np.array([x, y]) + shift * across), tuple(np.array([x, y]) + shift * across + along),
                        color="#E69F00", linestyle=style, linewidth=1.2)  # fmt: skip


@styled
def to_svg(figure: Figure, name: str) -> str:
    """The figure as SVG: the same bytes for the same data, ids that start with `name`, the caption as its label."""
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": name}):
        # Not `savefig`, which draws everything twice.
        FigureCanvasSVG(figure).print_svg(buffer, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    svg = buffer.getvalue()
    svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", svg[svg.index("<svg") :])
    return svg.replace("<svg ", f'<svg role="img" aria-label={quoteattr(str(figure.get_label()))} ', 1)


def show(figure: Figure, name: str) -> None:
    """Save the figure as figures/NAME.svg beside the notebook and display it with its caption."""
    data, metadata = save(figure, name, Path())
    display(data, metadata=metadata, raw=True)


def save(figure: Figure, name: str, folder: Path) -> tuple[dict[str, str], dict[str, dict[str, str]]]:
    """Save the figure as figures/NAME.svg in `folder`; return data and metadata of the output that shows it."""
    svg = to_svg(figure, name)
    (folder / "figures").mkdir(exist_ok=True)
    path = folder / "figures" / f"{name}.svg"
    path.write_text(f'<?xml version="1.0" encoding="utf-8"?>\n{svg}', encoding="utf-8")
    return (
        {"image/svg+xml": svg, "text/plain": f"figures/{name}.svg"},
        {"image/svg+xml": {"name": name, "caption": str(figure.get_label())}},
    )
