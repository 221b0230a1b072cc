"""The object scale and the cylinder's axis from a cylinder of known diameter in view: its two parallel edges.

1. *Find.* Straight edges are looked for in every direction (`edges.py`); the cylinder is the widest pair of opposite
   ones, because a yarn in front of it is thinner.
2. *Follow.* The frame is straightened along the pair. In blocks along each edge the steepest place of the right sign
   is found to a fraction of a pixel, and a line is fitted to them robustly: blocks that a yarn crosses drop out.
3. *Correct.* The mean profile across each edge, followed along its line, is fitted with a step and terms in sinγ
   and cosγ (w = R sinγ: Lambert's law towards the cylinder's limb), blurred by a Gaussian, on a linear background: a
   lit cylinder's steepest place lies inside of its edge.

The diameter in pixels is the distance of the two lines; its uncertainty has the scatter of the blocks about the lines,
half the change of the distance over the view (perspective, distortion), and the method's own share.

The scale holds in the plane of the cylinder's axis. Seen by an ordinary lens, yarn on the near side is closer by the
radius r₀ and appears larger by r₀ over the working distance (3 % for 3 mm at 100 mm; nothing for a telecentric lens):
the working distance is not known here, so that is not corrected and not in the uncertainty; `REMARK` says so.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares
from scipy.stats import theilslopes

from pipeline.errors import InputError
from pipeline.measure.axis import straighten
from pipeline.measure.edges import edge_lines
from pipeline.records import Array, CylinderAxis, Frames, Scale

REMARK = (
    "the scale holds at the cylinder's axis: yarn on its near side appears larger by r0 / working distance, and the "
    "stated diameter is taken as exact"
)

DIRECTIONS = 180
AS_WIDE = 12
"""Pairs narrower than the widest by less than this are the same cylinder at a slightly wrong angle [reduced px]."""
SEARCH = 12
"""Distance from the edge as first found within which it is looked for and fitted [px]."""
BLOCK = 6
"""Length of edge that is located at once [px]."""
MIN_BLOCKS = 10
MIN_DIAMETER = 100.0
"""Thinner things may be yarn, and give no scale worth having [px]."""
MAX_TAPER = math.tan(math.radians(1))
OVERSAMPLING = 8
METHOD_U = 0.001
"""Relative standard uncertainty of the method: the size of its errors on rendered cylinders, see
tests/measure/test_scale.py."""

Image = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A cylinder in a frame, in pixels of the frame."""

    axis: CylinderAxis
    """Direction of its axis, in [0, π)."""
    diameter: float
    """[px]"""
    u_diameter: float
    """Standard uncertainty of the diameter [px]."""

    def scale(self, diameter: float) -> Scale:
        """Return the object scale if the cylinder's diameter is `diameter` [m]."""
        return Scale(diameter / self.diameter, self.u_diameter / self.diameter)


@dataclass(frozen=True, slots=True)
class _Edge:
    """A line along an edge: its distance across from the frame's centre is place + slope · position along."""

    place: float
    slope: float
    u_place: float
    u_slope: float


def cylinder_in(frames: Frames, where: str | Path) -> Cylinder:
    """Find the cylinder in the first frame that can be read.

    Raises
    ------
    InputError
        If no frame can be read, or if no cylinder's two edges are in it.
    """
    for index in range(len(frames)):
        try:
            frame = frames.frame(index)
        except InputError:
            continue
        if (cylinder := find_cylinder(frame)) is not None:
            return cylinder
        right = f"both edges in view, parallel and {MIN_DIAMETER:g} px apart or more, or another --scale-image"
        raise InputError(f"{where}: frame {index}", "no cylinder's two edges were found", right)
    raise InputError(where, "no frame can be read", "copy the clip again")


def find_cylinder(frame: NDArray[np.uint8] | NDArray[np.uint16]) -> Cylinder | None:
    """Find the widest pair of parallel edges in a frame, or None where there is none.

    Parameters
    ----------
    frame : shape (rows, columns), rows top-down.
    """
    image = frame.astype(np.float32)
    pair = _find_pair(image)
    if pair is None:
        return None
    angle, low, high, sign = pair
    if high - low < MIN_DIAMETER:
        return None
    radius = (high - low) / 2
    near, far = _follow(image, angle, low, sign, radius), _follow(image, angle + math.pi, -high, sign, radius)
    if near is None or far is None:
        return None
    # Turned by half a turn, place and position change sign, so the far edge's slope keeps its own.
    taper = far.slope - near.slope
    if abs(taper) > MAX_TAPER:
        return None
    tilt = math.atan((near.slope + far.slope) / 2)
    diameter = (-far.place - near.place) * math.cos(tilt)
    reach = math.hypot(*image.shape) / 2
    terms = (near.u_place, far.u_place, abs(taper) * reach / math.sqrt(3), METHOD_U * diameter)
    u_axis = math.hypot(near.u_slope / 2, far.u_slope / 2, taper / math.sqrt(12))
    return Cylinder(CylinderAxis((angle - tilt) % math.pi, u_axis), diameter, math.hypot(*terms))


def _find_pair(image: Image) -> tuple[float, float, float, int] | None:
    """Return direction, the two edges' distances from the frame's centre [px], and 1 if it is brighter inside."""
    edges = edge_lines(image, DIRECTIONS)
    half, shrink = edges.half, edges.shrink
    found: list[tuple[float, float, float, float, int]] = []
    for i, (angle, line) in enumerate(zip(edges.angles, edges.lines, strict=True)):
        strength, peaks = np.abs(line), edges.peaks(i)
        for sign in (1, -1):
            rising, falling = peaks[sign * line[peaks] > 0], peaks[sign * line[peaks] < 0]
            if rising.size and falling.size and falling[-1] > rising[0]:
                low, high = int(rising[0]), int(falling[-1])
                found.append((high - low, min(strength[low], strength[high]), float(angle), float(low - half), sign))
    if not found:
        return None
    widest = max(found)[0]
    width, _, angle, low, sign = max((pair for pair in found if pair[0] > widest - AS_WIDE), key=lambda pair: pair[1])
    return angle, low / shrink, (low + width) / shrink, sign


def _follow(image: Image, angle: float, place: float, sign: int, radius: float) -> _Edge | None:
    """Follow the edge at distance `place` to the right of the frame's centre; the cylinder lies further right.

    Parameters
    ----------
    image : shape (rows, columns).
    angle : direction of the edge [rad].
    place : as first found [px].
    sign : 1 where the cylinder is brighter than the background.
    radius : of the cylinder, for the shade at its limb [px].
    """
    slope = u_place = u_slope = 0.0
    for _ in range(2):
        strip, along = _strip(image, angle - math.atan(slope), place * math.cos(math.atan(slope)))
        count = strip.shape[1] // BLOCK
        if count < MIN_BLOCKS:
            return None
        position = along[: count * BLOCK].reshape(count, BLOCK).mean(axis=1)
        blocks = strip[:, : count * BLOCK].reshape(strip.shape[0], count, BLOCK).mean(axis=2)
        steepness = sign * np.gradient(gaussian_filter1d(blocks.astype(float), 1.0, axis=0), axis=0)
        shift, strength = _peaks(steepness)
        usable = strength > 0.4 * np.median(strength)
        if np.count_nonzero(usable) < MIN_BLOCKS:
            return None
        line = _robust_line(position[usable], shift[usable])
        if line is None:
            return None
        moved, turned, u_place, u_slope = line
        tilt = math.atan(slope)
        place = place + moved / math.cos(tilt)
        slope += turned
    strip, _ = _strip(image, angle - math.atan(slope), place * math.cos(math.atan(slope)))
    ordered = np.sort(strip, axis=1)
    quarter = strip.shape[1] // 4
    profile = ordered[:, quarter : strip.shape[1] - quarter].mean(axis=1, dtype=np.float64)
    return _Edge(place + _correction(profile, radius), slope, u_place, u_slope)


def _strip(image: Image, angle: float, place: float) -> tuple[Image, Array]:
    """Straighten a band of ± SEARCH about a line; its columns' positions along from the frame's centre."""
    y, x = (image.shape[0] - 1) / 2, (image.shape[1] - 1) / 2
    c, s = math.cos(angle), math.sin(angle)
    reach = math.ceil(math.hypot(x, y))
    along = np.arange(-reach, reach + 1, dtype=np.float64)
    inside = np.ones(along.size, bool)
    for side in (place - SEARCH, place + SEARCH):
        inside &= (np.abs(along * c + side * s) <= x) & (np.abs(-along * s + side * c) <= y)
    along = along[inside]
    if not along.size:
        return np.zeros((2 * SEARCH + 1, 0), np.float32), along
    middle = float(along[0] + along[-1]) / 2
    centre = (x + middle * c + place * s, y - middle * s + place * c)
    return straighten(image, centre, angle, SEARCH, along.size), along


def _peaks(steepness: Array) -> tuple[Array, Array]:
    """Where each column is largest, by a parabola through three values, from the middle row; and how large."""
    rows = np.clip(steepness.argmax(axis=0), 1, steepness.shape[0] - 2)
    columns = np.arange(steepness.shape[1])
    before, at, after = (steepness[rows + step, columns] for step in (-1, 0, 1))
    bend = before - 2 * at + after
    shift = np.where(bend < 0, 0.5 * (before - after) / np.minimum(bend, -1e-12), 0.0)
    return rows - steepness.shape[0] // 2 + shift.clip(-1, 1), at


def _robust_line(x: Array, y: Array) -> tuple[float, float, float, float] | None:
    """Value at 0, slope and their standard uncertainties of a line through most points (Tukey's biweight)."""
    slope = float(theilslopes(y, x)[0])
    level = float(np.median(y - slope * x))
    weight, rest = np.ones_like(x), y - level - slope * x
    for _ in range(10):
        reach = 4.685 * max(1.4826 * float(np.median(np.abs(rest))), 0.02)
        weight = np.clip(1 - (rest / reach) ** 2, 0, None) ** 2
        if np.count_nonzero(weight) < MIN_BLOCKS:
            return None
        slope, level = np.polyfit(x, y, 1, w=np.sqrt(weight))
        rest = y - level - slope * x
    kept = weight > 0
    n = np.count_nonzero(kept)
    spread = float(np.sqrt(np.sum(weight * rest**2) / weight.sum()))
    u_slope = spread / float(np.std(x[kept]) * math.sqrt(n))
    return float(level), float(slope), math.hypot(spread / math.sqrt(n), u_slope * float(x[kept].mean())), u_slope


def _correction(profile: Array, radius: float) -> float:
    """Distance from the middle row to the cylinder's edge [px]; the cylinder lies at larger rows."""
    half = profile.size // 2
    fine = (np.arange((profile.size + 2 * SEARCH) * OVERSAMPLING) + 0.5) / OVERSAMPLING - half - SEARCH - 0.5
    rows = np.arange(-half, half + 1, dtype=np.float64)

    def residuals(parameters: Array) -> Array:
        edge, blur = parameters[0], math.exp(parameters[1])
        inside = np.clip((fine - edge) * OVERSAMPLING + 0.5, 0, 1)
        depth = np.clip(fine - edge, 0, radius)
        sine = 1 - depth / radius
        shades = np.column_stack([inside, inside * sine, inside * np.sqrt(1 - sine**2)])
        blurred = gaussian_filter1d(shades, blur * OVERSAMPLING, axis=0, mode="nearest")
        pixels = blurred.reshape(-1, OVERSAMPLING, 3).mean(axis=1)[SEARCH:-SEARCH]
        basis = np.column_stack([np.ones_like(rows), rows, pixels])
        coefficients = np.linalg.lstsq(basis, profile, rcond=None)[0]
        return (basis @ coefficients - profile) / max(float(np.ptp(profile)), 1e-9)

    low, high = [-4.0, math.log(0.3)], [4.0, math.log(4.0)]
    return float(least_squares(residuals, [0.0, 0.0], bounds=(low, high), diff_step=[1e-3, 1e-3]).x[0])
