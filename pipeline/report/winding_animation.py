"""The winding as a short animation: its first layers in slow motion, then the package layer by layer."""

import base64
import math
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.figure import Figure

from pipeline.records import Array
from pipeline.report.figures import styled
from pipeline.report.winding_figures import frame
from pipeline.winding.run import Row

SLOW_LAYERS = 2
SLOW_FRAMES = 32
"""Of these layers: the guide then crosses in eight frames."""
HELD = 6
"""Frames for which the end is held."""
PER_SECOND = 10
_SIZE, _DPI = (4.0, 2.5), 90
"""[inch], dots per inch."""


def moments(row: Row) -> Array:
    """Times of the frames [s]: even ones over the first layers, then the ends of layers, then the end."""
    result = row.result
    end = float(result.time[-1])
    cycles = float(result.guide_phase[-1])
    slow = float(np.interp(SLOW_LAYERS, result.guide_phase, result.time))
    later = np.interp(np.arange(SLOW_LAYERS + 1, math.ceil(cycles)), result.guide_phase, result.time)
    return np.concatenate([slow * np.arange(1, SLOW_FRAMES + 1) / SLOW_FRAMES, later, np.full(HELD, end)])


@styled
def write_animation(row: Row, path: Path) -> None:
    """Write the animation of a completed run to `path`, a GIF."""
    figure = Figure(figsize=_SIZE)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0.0, 0.0, 1.0, 0.9))
    writer = PillowWriter(fps=PER_SECOND)
    writer.setup(figure, str(path), _DPI)
    for moment in moments(row):
        axes.clear()
        frame(axes, row.result, float(moment))
        layer = math.floor(float(np.interp(moment, row.result.time, row.result.guide_phase))) + 1
        axes.set_title(f"{moment:.2f} s, layer {layer}", fontsize=10)
        writer.grab_frame()
    writer.finish()


def animation_html(path: Path, row: Row) -> str:
    """The animation for the page: closed until the reader opens it, so that nothing moves unasked."""
    words = (
        f"The winding, {row.name}: the first {SLOW_LAYERS} layers in slow motion, then the package layer by layer. The "
        "guide goes to and fro while the bobbin turns and draws the yarn onto itself; the last layer is orange."
    )
    picture = base64.b64encode(path.read_bytes()).decode("ascii")
    return (
        f"<details><summary>Show the winding as an animation</summary>\n<figure>"
        f'<img src="data:image/gif;base64,{picture}" alt="{escape(words)}">'
        f"<figcaption>{escape(words)}</figcaption></figure></details>"
    )
