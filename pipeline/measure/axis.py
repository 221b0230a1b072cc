"""The yarn in one frame: its axis and its diameter, to a fraction of a pixel.

Three steps, none of which needs a threshold from the user. Where the frame before is known, its axis stands in for the
first, as long as what is then found is the same yarn: only a strip around the yarn is looked at.

1. *Find.* The largest elongated thing that deviates from a smooth background is measured (`find.py`). Where that is no
   round body (a broad cylinder behind the yarn, a second thing, a background as bright as the yarn, a yarn that fills
   the frame), all other bands are: those between two opposite straight edges (`edges.py`), those brighter or darker
   than a level, and both kinds in parts of the frame. Of the round bodies among them, stripes of a broader one left
   out, the yarn is the one whose face shows the most texture: a cylinder or a wire is smooth.
2. *Align.* The line is turned and moved until it runs along the yarn (`align.py`).
3. *Diameter.* A lit cylinder is darker towards its edges, so the width at half of its peak is too small (13 % for
   Lambert's law from the front). The edge is half way between the background and the body *at the edge*: the profile
   is fitted with a body of radius R whose brightness is a combination of 1, sinγ and cosγ (w = R sinγ: ambient light
   and Lambert's law from any side), blurred by a Gaussian, on a linear background. Symmetric blur moves no edge. The
   profile is the mean of the middle half of the blocks' values at each w, which leaves hairs out.
"""

import math
import threading
from itertools import chain
from typing import NamedTuple

import cv2
import numpy as np

from models.compiled import compiled, inner, spliced
from pipeline.measure.align import MIN_ASPECT, Aligned, Cut, Registered, about, align, cut, register
from pipeline.measure.edges import bands
from pipeline.measure.find import SMALLEST, Line, find_line, level_lines, part_lines
from pipeline.measure.lines import Image, Pixels
from pipeline.measure.lit import NO_BODY, NOT_FITTED, LitProfile, bright_side, fit_lit, scaled, side_starts
from pipeline.measure.profile import feet, fit_profile, groove, relief
from pipeline.records import Array

MIN_DIAMETER = 4.0
"""Thinner things are not measured [px]."""
NEAR = 4
"""Distance from a strip within which interpolation uses pixels [px]: 2 for the bicubic one, and some."""
SAME_DIAMETER = 0.05
"""Relative change of the diameter from one frame to the next up to which it is the same yarn."""
SAME_AGREEMENT = 0.8
"""Least share of the blocks that agree for an axis that was followed rather than found."""
SAME_DIRECTION = 0.1
"""Turn from one frame to the next up to which an axis is followed [rad]: beyond, the yarn leaves the strip early."""
BANDS = 3
"""Bands between two edges that are tried where the largest thing is no round body."""
MIN_AGREEMENT = 0.7
"""Least share of the blocks that agree about a round body."""
MAX_MISFIT = 0.03
"""Misfit of the profile, over its range, above which its edges are not those of a round body."""
MIN_RELIEF = 0.45
"""Least height of a body above the ground on both of its sides, or depth below it, over the profile's range. That of
rendered yarn is above 0.5 in any light, that of an edge of something broader is not above 0: an edge would fit as a
thin yarn with light from the side."""
MAX_GROOVE = 0.2
"""Depth of a groove along the yarn, over the profile's range, from which on there are two yarns. Rendered single
ones in any light have at most 0.05, two of about one brightness that touch or overlap 0.3 and more; a fainter one makes
the profile unlike that of a round body."""
ALONG = 0.25
"""Angle between two bodies up to which one runs along the other [rad]."""
BROADER = 1.25
"""Ratio of diameters from which on they are those of two bodies."""
ASIDE, BESIDE = 3.5, 1.4
"""How far from a body, and from where on, there has to be ground [radii]."""
UNEVEN_GROUND = 0.4
"""Largest change of the ground's level there, over the body's contrast with it."""
MOST = 0.95
"""Share of the length of yarn on the best line that another line has to have."""
PATCH, FACE = 0.125, 0.6
"""Size of the patches that texture is looked for in, and of the face that faces the camera [diameters]."""
FRONTAL = 0.1
"""Direction of the light up to which the yarn's own shadow does not show [rad]."""
FLAT = 0.2
"""Lamp over the ambient light up to which its direction means nothing: both edges show, as those of a silhouette."""
EDGE_SEEN = 0.5
"""Level at the far edge over the ambient light from which on that edge is seen."""
SIDEWAYS = 0.5
"""Direction of the light from which on half heights say little of where the yarn ends [rad]."""
NO_MISFIT = 0.01
"""Misfit of the profile up to which its fit is as good as texture lets it be."""


class YarnAxis(NamedTuple):
    """Where the yarn is in a frame, in pixels of the frame, pixel centres at whole numbers."""

    centre: tuple[float, float]
    """A point (x, y) on the axis, rows top-down."""
    angle: float
    """[rad] in [0, π), counter-clockwise from +x as displayed."""
    diameter: float
    """[px]"""
    blur: float
    """Standard deviation of the edges' blur, pixel and interpolation included [px]."""
    length: int
    """Length of yarn whose full width is in view, centred at `centre` [px]."""
    agreement: float
    """Share of the yarn's length in view that follows the line: 1 where no hair or second object disturbs it."""
    lean: float
    """Distance from half way between the profile's half heights to the axis, which light from one side causes [px]."""
    light: float
    """Direction of the light around the axis, to its right if positive, 0 from the camera [rad]."""
    shade: tuple[float, float]
    """Level of the surface that faces the lamp, and in the shadow, texture aside [counts]; see `lit.py`."""
    misfit: float
    """Root mean square of what the profile's fit leaves, over the profile's range."""
    groove: float
    """Depth of the deepest groove along it, inside or beside, over the profile's range: two yarns have one."""
    bend: float = 0.0
    """Curvature of the axis, to the right of its direction at `centre` [1/px]."""
    uneven: float = math.nan
    """Coefficient of variation of the diameter along the yarn in view; NaN where it was not looked at."""
    form: Array = np.empty(0)
    """Diameter along the yarn over the mean, see `lines.unrolled`; empty where it does not vary enough to matter."""


NO_YARN = YarnAxis((0.0, 0.0), 0.0, 0.0, 0.0, 0, 0.0, 0.0, 0.0, (0.0, 0.0), 0.0, 0.0)


def find_axis(image: Image | Pixels, before: YarnAxis | None = None) -> YarnAxis | None:
    """Find the yarn in a frame, or None where there is none.

    Parameters
    ----------
    image : the frame, shape (rows, columns), rows top-down.
    before : the yarn in the frame before, or as it is `expected`. It only saves time: the yarn is looked for in the
        whole frame where it is not near that place, not as wide, turned or disturbed.

    Returns
    -------
    A round body if there is one, else what is most like one, which may be a plied yarn.
    """
    if before is not None:
        x, y = before.centre
        axis = _measure(
            image, x, y, before.angle, before.bend, before.diameter / 2, before.blur, before.lean, before.light
        )
        if (
            axis.agreement >= SAME_AGREEMENT
            and abs(axis.diameter - before.diameter) <= SAME_DIAMETER * before.diameter
            and abs(math.remainder(axis.angle - before.angle, math.pi)) <= SAME_DIRECTION
        ):
            return axis
    if min(image.shape) < SMALLEST:
        return None
    line = find_line(image)
    first = NO_YARN if line is None else _measure_from(image, line)
    if _is_round(first) and _is_alone(image, first):
        return first
    lines = bands(image.astype(np.float32), BANDS), level_lines(image), part_lines(image)
    bodies = [first, *(_measure_from(image, line) for line in chain(*lines))]
    bodies = [body for body in bodies if body.agreement >= MIN_AGREEMENT]
    whole = [body for body in bodies if not any(_within(body, other) for other in bodies)]
    alone = [body for body in whole if _is_alone(image, body)]
    round_bodies = [body for body in alone if _is_round(body)]
    if not round_bodies:
        if first.diameter and _is_alone(image, first):
            return first
        return min(alone, key=lambda body: body.misfit, default=None)
    yarn = max(round_bodies, key=lambda body: _texture(image, body))
    # the same yarn on several lines: of those that most of it lies on the one with the middle diameter
    same = [body for body in round_bodies if _is_along(body, yarn) and body.diameter < BROADER * yarn.diameter]
    most = max(body.agreement * body.length for body in same)
    same = [body for body in same if body.agreement * body.length >= MOST * most]
    return sorted(same, key=lambda body: body.diameter)[(len(same) - 1) // 2]


def _is_round(body: YarnAxis) -> bool:
    """Say whether what was measured is one straight, round body."""
    straight = body.diameter > 0 and body.agreement >= MIN_AGREEMENT
    return straight and body.misfit <= MAX_MISFIT and body.groove <= MAX_GROOVE


def _is_alone(image: Image | Pixels, body: YarnAxis) -> bool:
    """Say whether there is but ground on both sides of a body: beside a stripe of a yarn's face is the rest of it."""
    radius, (x, y) = body.diameter / 2, body.centre
    half = math.ceil(ASIDE * radius)
    strip = straighten(image, (x, y), body.angle, half, body.length)
    right = np.arange(-half, half + 1)
    inside = x + right * math.sin(body.angle), y + right * math.cos(body.angle)
    seen = (inside[0] >= 0) & (inside[0] <= image.shape[1] - 1) & (inside[1] >= 0) & (inside[1] <= image.shape[0] - 1)
    level = np.median(strip, axis=1)
    middle = level[np.abs(right) < 0.5 * radius].mean()
    for beside in (right < -BESIDE * radius, right > BESIDE * radius):
        ground = level[beside & seen]
        if ground.size and np.ptp(ground) > UNEVEN_GROUND * np.abs(middle - ground).max():
            return False
    return True


def _within(body: YarnAxis, other: YarnAxis) -> bool:
    """Say whether one body is a part of a broader one: a bright or dark stripe of its face, along it."""
    return _is_along(body, other) and BROADER * body.diameter < other.diameter


def _is_along(body: YarnAxis, other: YarnAxis) -> bool:
    """Say whether the middle of a body lies on another one, and its axis along that."""
    (x, y), (c, s) = other.centre, (math.cos(other.angle), math.sin(other.angle))
    apart = abs((body.centre[0] - x) * s + (body.centre[1] - y) * c)
    return abs(math.remainder(body.angle - other.angle, math.pi)) < ALONG and apart < other.diameter / 2


def _texture(image: Image | Pixels, body: YarnAxis) -> float:
    """Return how much the level of a body's face changes along it from patch to patch, over its contrast.

    Fibres make it so for yarn; a cylinder, a wire or a shadow is smooth. The median leaves out what lies across it.
    """
    size = max(1, round(PATCH * body.diameter))
    half = max(1, round(FACE * body.diameter / 2 / size)) * size
    strip = straighten(image, body.centre, body.angle, half, body.length // size * size)[1:]
    patches = strip.reshape(2 * half // size, size, -1, size).mean(axis=(1, 3))
    return float(np.median(np.abs(np.diff(patches)))) / max(abs(body.shade[0] - body.shade[1]), 1.0)


def _measure_from(image: Image | Pixels, line: Line) -> YarnAxis:
    """Measure the yarn on a line that was found, of which no more is known."""
    x, y, angle, half = line
    return _measure(image, x, y, angle, 0.0, half, 1.0, 0.0, 0.0)


def expected(last: YarnAxis, before: YarnAxis) -> YarnAxis:
    """Return where the yarn is next if it moves on and turns on as from the frame before to the last one.

    A yarn that swings then mostly needs one strip a frame instead of two: that it turned by more than `align.ALIGNED`
    over its length from one frame to the next no longer counts, only how much faster or slower.
    """
    x, y = (2 * now - then for now, then in zip(last.centre, before.centre, strict=True))
    turned = math.remainder(last.angle - before.angle, math.pi)
    return last._replace(centre=(x, y), angle=last.angle + turned)


@compiled
def _measure(
    image: Image | Pixels,
    x: float,
    y: float,
    angle: float,
    bend: float,
    radius: float,
    blur: float,
    lean: float,
    light: float,
) -> YarnAxis:
    """Align a line with the yarn on it, and measure the diameter: 0 where there is no yarn.

    Parameters
    ----------
    image : shape (rows, columns).
    x, y, angle, bend, radius : a point of the line, its angle, its curvature to the right, half of the width.
    blur, lean, light : where the fit starts, see `YarnAxis`.
    """
    aligned = align(image, x, y, angle, bend, radius)
    if not aligned.cut.length:
        return NO_YARN
    bend = aligned.bend
    angle, shift = aligned.angle, aligned.registered.shift * aligned.cut.step
    start = np.array([shift + lean, radius, blur, light])
    start[:3] /= aligned.cut.step
    found, registered, body = _fit(image, aligned, start)
    if not body.radius or body.misfit >= NO_BODY:
        return NO_YARN
    half, length, agreement = registered.profile.size // 2, found.length, aligned.registered.agreement
    first, last = registered.beside
    dark = first + (last - first) * (body.offset + half) / (2 * half)
    if relief(registered.profile) < MIN_RELIEF:
        return NO_YARN
    depth = groove(registered.profile, body.offset, body.radius)
    body = scaled(body, found.step)
    # the profile was taken square to the tangent, and about a line that is straighter than the axis by the last bend
    offset = body.offset - registered.bend * found.step**3 * length**2 / 24
    radius = body.radius * (1 - (bend * length) ** 2 / 24)
    if 2 * radius < MIN_DIAMETER or length < MIN_ASPECT * 2 * radius or half * found.step < radius + 2:
        return NO_YARN
    x, y = found.x + offset * math.sin(angle), found.y + offset * math.cos(angle)
    lean = body.offset - shift
    form = registered.form
    tilt, bent = about(form, body.offset / found.step - feet(registered.profile)[0])
    angle, bend = angle - tilt * found.step**2, bend + bent * found.step**3
    light, lamp = _lamp(body)
    if math.floor(angle / math.pi) % 2:  # the axis' direction, and with it left and right, is turned round
        lean, light, bend, form = -lean, -light, -bend, form[::-1].copy()
    shade = (dark + body.ambient + lamp, dark + body.ambient)
    angle %= math.pi
    return YarnAxis(
        (x, y), angle, 2 * radius, body.blur, length, agreement, lean, light, shade, body.misfit, depth, bend,
        registered.uneven, form,
    )  # fmt: skip


@inner
def _lamp(body: LitProfile) -> tuple[float, float]:
    """Return direction and level of the lamp, where there is one to speak of."""
    light, lamp = body.light, body.lamp
    far = body.ambient - math.copysign(lamp * math.sin(light), body.ambient * math.sin(light))  # level at the far edge
    if abs(light) > math.pi / 2 and far * body.ambient > EDGE_SEEN * body.ambient**2:
        # both edges stand out more than the middle: no lamp does that, but a back light or shining fibres
        light, lamp = light - math.copysign(math.pi, light), -lamp
    return 0.0 if abs(lamp) < FLAT * abs(body.ambient) else light, lamp


@spliced
def _fit(image: Image | Pixels, aligned: Aligned, start: Array) -> tuple[Cut, Registered, LitProfile]:
    """Fit the profile, with its shadow if it shows; the yarn is cut wider where that needs it.

    Parameters
    ----------
    image : shape (rows, columns).
    aligned : the cut yarn.
    start : where the fit starts, see `fit_lit`; its light is 0 where there is no frame before. Its lengths, and those
        of what is returned, are the cut's rows.

    Returns
    -------
    The cut whose profile was fitted, what it has, and the fit, `NOT_FITTED` where none is credible.
    """
    found, registered = aligned.cut, aligned.registered
    if abs(start[3]) > FRONTAL:
        body = fit_lit(registered.profile, registered.spread, start.reshape(1, 4))
        if body.radius and body.misfit <= NO_MISFIT and FRONTAL < abs(body.light) <= SIDEWAYS:
            return found, registered, body
    plain = LitProfile(*fit_profile(registered.profile, registered.spread, start[0], start[1], start[2]))
    if plain.radius and abs(plain.light) <= FRONTAL and plain.misfit <= NO_MISFIT:
        return found, registered, plain
    return _fit_shadow(image, aligned, plain, start)


@spliced
def _fit_shadow(
    image: Image | Pixels, aligned: Aligned, plain: LitProfile, start: Array
) -> tuple[Cut, Registered, LitProfile]:
    """Fit the profile with its shadow, if it fits, else take the one without, `plain`; see `_fit`."""
    found, registered, angle, bend = aligned
    if not plain.radius or plain.misfit > NO_MISFIT or abs(plain.light) > SIDEWAYS or abs(start[3]) > SIDEWAYS:
        # much of the yarn may be dark: room for it on the side where it is, the same middle so that the offset stays
        first, last = bright_side(registered.profile)
        half = 1.3 * (last - first) + 6 / found.step
        if half > registered.profile.size // 2:
            shortest = MIN_ASPECT * (last - first) * found.step
            wider = cut(image, found.x, found.y, angle, bend, half * found.step, shortest)
            if wider.length:
                found, registered = wider, register(wider.blocks, bend / wider.step**3)
    near = np.array([[plain.offset, plain.radius, plain.blur, plain.light]])
    body = (
        fit_lit(registered.profile, registered.spread, start.reshape(1, 4)) if abs(start[3]) > FRONTAL else NOT_FITTED
    )
    if not body.radius and plain.radius and abs(plain.light) <= SIDEWAYS:
        # little of the yarn is dark: there is one minimum
        body = fit_lit(registered.profile, registered.spread, near)
    if not body.radius or body.misfit > NO_MISFIT:
        starts = side_starts(registered.profile, start[2])
        if plain.radius:
            starts = np.concatenate((starts, near))
        body = fit_lit(registered.profile, registered.spread, starts)
    if not body.radius or (plain.radius and body.misfit > max(NO_MISFIT, plain.misfit)):
        body = plain
    return found, registered, body


def straighten(image: Image | Pixels, centre: tuple[float, float], angle: float, half: int, length: int) -> Image:
    """Resample a frame along an axis by linear interpolation at the frame's own pixel pitch.

    Parameters
    ----------
    image : shape (rows, columns).
    centre : point (x, y) of the axis that becomes the strip's centre [px].
    angle : [rad], counter-clockwise from +x as displayed.
    half : rows on each side of the axis.
    length : columns of the strip.

    Returns
    -------
    Shape (2 half + 1, length); columns run along the axis, rows to the right of it.
    """
    c, s = math.cos(angle), math.sin(angle)
    start = -(length - 1) / 2
    matrix = np.array(
        [[c, s, centre[0] + start * c - half * s], [-s, c, centre[1] - start * s - half * c]], dtype=np.float64
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = (length, 2 * half + 1)
    pixels = floats_around(image, centre, angle, half, length)
    return cv2.warpAffine(pixels, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)  # pyright: ignore[reportReturnType]


def floats_around(image: Image | Pixels, centre: tuple[float, float], angle: float, half: float, length: int) -> Image:
    """Return a frame in single precision of which only the pixels in and near a strip have their value.

    A yarn covers a tenth of a frame: converting the rest would take longer than cutting the strip. All pixels have
    their value if the strip is not wholly inside the frame. The next call in the same thread overwrites them.

    Parameters
    ----------
    image : shape (rows, columns); returned as it is if in single precision.
    centre, angle, half, length : see `straighten`.
    """
    if image.dtype == np.float32:
        return image  # pyright: ignore[reportReturnType]
    kept: Image | None = getattr(_scratch, "floats", None)
    if kept is None or kept.shape != image.shape:
        kept = _scratch.floats = np.empty(image.shape, np.float32)
    _set_band(image, centre[0], centre[1], angle, float(half + NEAR), length / 2 + NEAR, kept)
    return kept


_scratch = threading.local()
"""Each thread's last `floats_around`: fresh memory for every strip would cost more than setting it."""


@compiled
def _set_band(
    frame: Image | Pixels, x: float, y: float, angle: float, half: float, reach: float, floats: Image
) -> None:
    """Set `floats` to the frame's pixels within ±half across and ±reach along an axis."""
    rows, columns = frame.shape
    c, s = math.cos(angle), math.sin(angle)
    wide, high = abs(reach * c) + abs(half * s) - 2 * NEAR, abs(reach * s) + abs(half * c) - 2 * NEAR
    whole = x - wide < 0 or y - high < 0 or x + wide > columns - 1 or y + high > rows - 1
    for i in range(rows):
        low, top = 0.0, columns - 1.0
        if not whole:
            # the columns where |(x' − x) s + (y' − y) c| ≤ half and |(x' − x) c − (y' − y) s| ≤ reach
            for slope, offset, limit in ((s, (i - y) * c, half), (c, (y - i) * s, reach)):
                if abs(slope) > 1e-9:
                    a, b = x + (-limit - offset) / slope, x + (limit - offset) / slope
                    low, top = max(low, min(a, b)), min(top, max(a, b))
                elif abs(offset) > limit:
                    top = -1.0
        first, past = math.floor(low), math.ceil(top) + 1
        if first < past:
            source, target = frame[i, first:past], floats[i, first:past]
            for j in range(past - first):
                target[j] = source[j]
