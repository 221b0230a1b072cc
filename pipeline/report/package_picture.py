"""A wound package in space, by an orthographic projection: the bobbin, and the yarn on it coloured by a value.

Drawn as projected lines in the order of their depth, not by mplot3d, which sorts whole collections only and would show
the yarn through the bobbin.
"""

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize

from pipeline.records import Array

_AZIMUTH, _ELEVATION = math.radians(28), math.radians(16)
_TOWARDS = np.array(
    [-math.cos(_ELEVATION) * math.cos(_AZIMUTH), math.sin(_ELEVATION), math.cos(_ELEVATION) * math.sin(_AZIMUTH)]
)
_RIGHT = np.array([math.sin(_AZIMUTH), 0.0, math.cos(_AZIMUTH)])
_UP = np.cross(_TOWARDS, _RIGHT)
"""The view: from the feed's side (−x), a little from above and from the end of larger z; z points to the right."""
_STRIPS = 48


@dataclass(frozen=True, slots=True)
class Bobbin:
    """What the yarn lies on: a cone's stump with its axis along z; lengths in the unit of the picture."""

    radius: tuple[float, float]
    """At the two ends."""
    z: tuple[float, float]

    @property
    def slope(self) -> float:
        """Radius per length along z."""
        return (self.radius[1] - self.radius[0]) / (self.z[1] - self.z[0])


def project(points: Array) -> Array:
    """Points (n, 3) → (n, 2): to the right and up."""
    return points @ np.column_stack([_RIGHT, _UP])


def draw_bobbin(axes: Axes, bobbin: Bobbin, margin: float) -> None:
    """The bobbin's mantle, shaded, and the end that can be seen; `margin` is its length beyond z at both ends."""
    (z0, z1), slope = bobbin.z, bobbin.slope
    ends = np.array([z0 - margin, z1 + margin])
    radii = np.array([bobbin.radius[0] - slope * margin, bobbin.radius[1] + slope * margin])
    around = np.linspace(-math.pi, math.pi, _STRIPS + 1)
    rim = np.stack([np.cos(around), np.sin(around)], axis=-1)
    circles = [np.column_stack([radius * rim, np.full(around.size, z)]) for radius, z in zip(radii, ends, strict=True)]
    strips = np.stack([circles[0][:-1], circles[0][1:], circles[1][1:], circles[1][:-1]], axis=1)
    facing = _facing(strips.mean(axis=1), bobbin)
    order = np.argsort(facing)[np.sort(facing) > -0.2]  # what lies behind the edge is painted over by what does not
    body = PolyCollection(
        [project(strips[index]) for index in order], facecolors=[(g, g, g) for g in 0.7 + 0.25 * facing[order]],
        edgecolors="face", linewidths=0.5, zorder=1, rasterized=True,
    )  # fmt: skip
    axes.add_collection(body, autolim=False)
    end = project(circles[1])
    axes.fill(end[:, 0], end[:, 1], facecolor="#fafafa", edgecolor="#777777", linewidth=0.8, zorder=2)
    corners = project(np.concatenate(circles))
    for limits, place in ((axes.set_xlim, corners[:, 0]), (axes.set_ylim, corners[:, 1])):
        room = 0.04 * np.ptp(place)
        limits(place.min() - room, place.max() + room)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _facing(points: Array, bobbin: Bobbin) -> Array:
    """Cosine between the mantle's outward normal below each of the points (n, 3) and the view, shape (n,)."""
    radius = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-12)
    normal = np.column_stack([points[:, :2] / radius[:, None], np.full(radius.size, -bobbin.slope)])
    return normal @ _TOWARDS / math.hypot(1.0, bobbin.slope)


def draw_yarn(axes: Axes, points: Array, value: Array, bobbin: Bobbin, norm: Normalize, width: float) -> LineCollection:
    """The yarn, one line from point to point, coloured by the mean of `value` at both; outer turns over inner ones.

    Parameters
    ----------
    points : (n, 3), in order along the yarn.
    value : (n,); where it is NaN nothing is drawn.
    width : line width in points.
    """
    middle = (points[:-1] + points[1:]) / 2
    shade = (value[:-1] + value[1:]) / 2
    drawn = (_facing(middle, bobbin) > -0.02) & np.isfinite(shade)
    height = np.hypot(middle[:, 0], middle[:, 1]) - bobbin.slope * middle[:, 2]
    order = np.flatnonzero(drawn)[np.argsort(height[drawn], kind="stable")]
    flat = project(points)
    lines = LineCollection(
        list(np.stack([flat[order], flat[order + 1]], axis=1)), array=shade[order], cmap="viridis", norm=norm,
        linewidths=width, capstyle="round", zorder=3, rasterized=True,
    )  # fmt: skip
    axes.add_collection(lines, autolim=False)
    return lines
