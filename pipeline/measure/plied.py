"""A plied yarn in one frame: its axis, its diameter and its twist from the picture of n round strands that touch.

The strands, of radius r, lie about the axis at h = r/sin(π/n), the least distance at which they touch; strand k stands
at θ = 2π(T·x + k/n) + φ, so across the axis at h·sinθ and towards the camera at h·cosθ. The diameter is that of the
circle around them, D = 2(r + h). The silhouette is narrower nearly everywhere: its mean width over the helix is the
perimeter of the strands' hull over π (Cauchy), r(2 + 2n/π), which is 18, 12 and 10 % less than D for n = 2, 3, 4. One
lit cylinder, which `axis.py` fits, finds neither, and less than a turn in view tilts it.

So the whole straightened strip is fitted, not its mean profile: each strand where no nearer one hides it, lit as
`lit.py` says (ambient light, and Lambert's law for one lamp with the attached shadow), blurred by a Gaussian both ways,
on a linear background, under light that changes linearly along the yarn. Unknown are the axis' place and tilt, r, φ, T,
the blur and the lamp's direction; the levels are linear. The silhouette is part of that picture, so any part of a turn
in view does: its harmonics are those of the helix, and no mean over whole periods is needed.

Gauss–Newton with iterated weights. A pixel weighs by its noise and by the texture, which grows with the level, both
from the residuals' medians: texture in the body must not outweigh the edges. Tukey's biweight leaves hairs out.
The fit starts from the best of a scan over T of both hands, φ, place and lamp. Both hands are fitted; only what lies
inside the silhouette tells them apart.

The diameter is that of this geometry. Strands that are flattened where they touch have a smaller circle than r says.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from models.compiled import compiled, inner
from pipeline.measure.axis import YarnAxis, find_line, straighten
from pipeline.measure.lines import Image, Pixels, span
from pipeline.measure.pitch import SLOPES, ply_twist
from pipeline.measure.twist import FrameTwist
from pipeline.records import Array

PHASES = 48
"""Steps of φ over the distance of two strands that a picture is computed at; between them it is interpolated."""
STEP = 0.5
"""Step of a picture across the axis [px]."""
REACH = 6.0
"""Distance in standard deviations from which on the blur is taken for 0."""
LIGHTS = (-0.9, 0.0, 0.9)
"""Directions of the lamp that the scan tries [rad]."""
PLACES = (-0.4, 0.0, 0.4)
"""Places of the axis that are tried once T is known, off the strip's middle [radii of a strand]."""
SCALES = (0.8, 0.9, 1.0, 1.12, 1.25)
"""Radii that are tried, over that of a strand in a silhouette of the width found."""
TURNS = 8
"""Phases that the scan tries, over the distance of two strands."""
FIRST_BLUR = 1.3
"""[px]"""
FINENESS = 0.25
"""Step of the scanned twists: strand periods in the length in view."""
CHANGE = 0.3
"""Relative change of the twist from the frame before that is looked at first."""
AS_BEFORE = 1.3
"""Misfit over that of the frame before up to which the same hand and lamp need not be looked for again."""
LARGEST_STEP = (2.0, 2.0, 0.1, 0.3, 0.1, 0.4, 0.4)
"""Largest step of the place [px], the tilt over the length [px], ln r, φ, T times the length, ln σ, the lamp."""
SETTLED = 0.01
"""Last step over the largest one."""
STEPS = 20
BIWEIGHT = 4.685
HAIR = 0.3
"""Residual over the picture's height from which on it counts as this much."""
ALIGNED = 1.0
"""Tilt over the length from which the strip is cut anew [px]."""
FARTHEST = 1.55
"""Largest direction of the lamp [rad]."""

MIN_PERIODS = 1.0
"""Strand periods in view (of which a turn has n)."""
MIN_EXPLAINED = 0.5
"""Share of what varies along the yarn, noise apart, that the picture explains."""
MIN_SHARE = 0.8
"""Share of the pixels that follow the picture."""
MAX_BLUR = 0.45
"""Blur over a strand's radius from which its edge is not seen."""
MAX_U = 0.005
"""Formal relative uncertainty of the radius from which the edges do not show, as in the dark."""
MIN_CONTRAST = 0.05
"""Share of the other hand's squares that the best picture must save; below, `ply_twist` must know the hand."""
AGREEMENT = 0.02
"""Relative difference up to which the picture's twist and that of `ply_twist` are the same."""
MAX_TURN = math.radians(1)
"""Angle between the axis and the largest elongated thing from which on one of them is not the yarn's."""


@dataclass(frozen=True, slots=True)
class YarnFound:
    """What one frame says of a yarn whose axis was found."""

    axis: YarnAxis | None
    """A plied yarn's has the diameter of the circle around the strands; where there is `doubt` it is the one that was
    given, None where that is not the yarn's."""
    twist: FrameTwist
    doubt: str
    """Why the diameter is not credible; empty where it is."""
    picture: "Picture | None" = None
    """Where the next frame's fit may start; None where there is `doubt`."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A fitted picture of the strands in a strip; lengths in pixels."""

    at: Array
    """Place and tilt of the axis in the strip, ln r, φ, T, ln σ, direction of the lamp, shape (7,)."""
    levels: Array
    """Background, its slopes across and along, ambient light, lamp, and both along, shape (7,)."""
    squares: float
    """Mean square of what is left, over the square of the picture's height; that of hairs is limited."""
    explained: float
    """Share of what varies along the yarn, noise apart."""
    share: float
    """Share of the pixels that follow the picture."""
    misfit: float
    """Root mean square over the rows of what is left in the mean, over the picture's height."""
    u_radius: float
    """Formal relative uncertainty of r; NaN where the fit did not settle."""


def plied_yarn(image: Image | Pixels, axis: YarnAxis, plies: int, before: Picture | None = None) -> YarnFound:
    """Measure the plied yarn near an axis of a frame.

    Parameters
    ----------
    image : shape (rows, columns), rows top-down.
    axis : as `find_axis` finds it; its diameter and tilt may be wrong.
    plies : strands n, at least 2.
    before : the picture in the frame before. It only saves time.

    Returns
    -------
    Without the strands `doubt` says why, and the twist is that of `ply_twist`.
    """
    given = *axis.centre, axis.angle, axis.diameter / 2
    line = find_line(image)
    doubt = ""
    for start in (given,) if line is None else (line, given):
        found = _follow(image, start, plies, before)
        if isinstance(found, YarnFound):
            return found
        doubt = doubt or found
    twist = ply_twist(image, axis, plies)
    if line is not None and abs(math.remainder(line[2] - axis.angle, math.pi)) > MAX_TURN:
        return YarnFound(None, twist, doubt)
    return YarnFound(axis, twist, doubt)


def _follow(
    image: Image | Pixels, line: tuple[float, float, float, float], plies: int, before: Picture | None
) -> YarnFound | str:
    """Fit the strands along a line (a point x, y, the angle, half the silhouette's width), or say why they do not."""
    x, y, angle, width = line
    centre, half, length = _cut(image, x, y, angle, width)
    if length < 2 * width:
        return "less of the yarn is in view than it is wide"
    strip = straighten(image, centre, angle, half, length)
    picture, other = _first(strip, plies, width, before)
    reason = _doubt(picture, plies, length)
    if not reason and abs(picture.at[1]) * length > ALIGNED:
        (x, y), angle = _moved(picture, centre, angle)
        first = centre
        centre, half, length = _cut(image, x, y, angle, width)
        along = (centre[0] - first[0]) * math.cos(angle) - (centre[1] - first[1]) * math.sin(angle)
        at = picture.at.copy()
        at[:2] = 0
        at[3] += 2 * math.pi * at[4] * along
        strip = straighten(image, centre, angle, half, max(length, 1))
        picture = _fit(strip, plies, at, picture.levels)
        reason = _doubt(picture, plies, length)
    if reason:
        return reason
    axis = _axis(picture, *_moved(picture, centre, angle), length, plies)
    twist = float(picture.at[4])
    contrast = 1 - picture.squares / other
    reason = ""
    if contrast < MIN_CONTRAST:
        period = ply_twist(image, axis, plies).per_pixel
        same = abs(abs(period) - abs(twist)) <= AGREEMENT * abs(twist)
        twist = math.copysign(twist, period) if same else math.nan
        reason = "" if same else "Z and S explain the strands about as well"
    return YarnFound(axis, FrameTwist(twist, picture.explained, contrast, reason), "", picture)


def _cut(image: Image | Pixels, x: float, y: float, angle: float, width: float) -> tuple[tuple[float, float], int, int]:
    """Return the centre, half the width and the length of a strip along a line, see `straighten`."""
    half = math.ceil(1.5 * width + 6)
    low, high = span(image.shape[0], image.shape[1], x, y, angle, float(half))
    middle = (low + high) / 2
    return (x + middle * math.cos(angle), y - middle * math.sin(angle)), half, math.floor(high - low)


def _moved(picture: Picture, centre: tuple[float, float], angle: float) -> tuple[tuple[float, float], float]:
    """Return the point and the angle of the axis that a picture in a strip has."""
    offset, tilt = picture.at[:2].tolist()
    angle -= math.atan(tilt)
    return (centre[0] + offset * math.sin(angle), centre[1] + offset * math.cos(angle)), angle


def _doubt(picture: Picture, plies: int, length: int) -> str:
    """Say why a picture is not credible; empty where it is."""
    if math.isnan(picture.u_radius):
        return "the strands' picture does not settle"
    periods = plies * abs(float(picture.at[4])) * length
    blur = math.exp(picture.at[5] - picture.at[2])
    for refused, why in (
        (
            periods < MIN_PERIODS,
            f"{periods:.2f} periods of the strands are in view: at least {MIN_PERIODS:g} is needed",
        ),
        (
            picture.explained < MIN_EXPLAINED,
            f"strands explain {picture.explained:.2f} of what varies along the yarn: {MIN_EXPLAINED} is needed",
        ),
        (
            picture.share < MIN_SHARE,
            f"{100 * picture.share:.0f} % of the pixels follow the strands: {100 * MIN_SHARE:.0f} % is needed",
        ),
        (blur > MAX_BLUR, f"the edges are blurred over {blur:.2f} of a strand's radius: {MAX_BLUR} is too much"),
        (picture.u_radius > MAX_U, "the strands' edges hardly stand out from the background"),
    ):
        if refused:
            return why
    return ""


def _axis(picture: Picture, centre: tuple[float, float], angle: float, length: int, plies: int) -> YarnAxis:
    radius, blur, light = math.exp(picture.at[2]), math.exp(picture.at[5]), float(picture.at[6])
    if math.floor(angle / math.pi) % 2:  # the axis' direction, and with it left and right, is turned round
        light = -light
    dark = float(picture.levels[0] + picture.levels[3])
    return YarnAxis(
        centre=centre,
        angle=angle % math.pi,
        diameter=2 * radius * (1 + 1 / math.sin(math.pi / plies)),
        blur=blur,
        length=length,
        agreement=picture.share,
        lean=0.0,
        light=light,
        shade=(dark + float(picture.levels[4]), dark),
        misfit=picture.misfit,
    )


def _width(plies: int) -> float:
    """Return the silhouette's mean width over a strand's radius: the perimeter of the strands' hull over π."""
    return 2 + 2 * plies / math.pi


def _first(strip: Image, plies: int, width: float, before: Picture | None) -> tuple[Picture, float]:
    """Fit a strip from a scan; return the best picture and the squares of the best one of the other hand."""
    radius = 2 * width / _width(plies)
    length = strip.shape[1]
    fastest = SLOPES[1] / (math.pi * radius * (1 + 1 / math.sin(math.pi / plies)))
    all_twists = np.arange(MIN_PERIODS, max(fastest * plies * length, MIN_PERIODS + 1), FINENESS) / (plies * length)
    if before is not None:
        last = float(before.at[4])
        near = all_twists[np.abs(all_twists - abs(last)) <= max(CHANGE * abs(last), 2 * FINENESS / (plies * length))]
        if near.size:
            radius, light = math.exp(before.at[2]), (float(before.at[6]),)
            same, opposite = (
                _fit(strip, plies, *_start(strip, plies, radius, sign * near, light, (1.0,))) for sign in _hands(last)
            )
            if same.squares <= min(opposite.squares, AS_BEFORE**2 * before.squares):
                return same, opposite.squares
    found = [_fit(strip, plies, *_start(strip, plies, radius, sign * all_twists, LIGHTS, SCALES)) for sign in (1, -1)]
    found.sort(key=lambda picture: picture.squares)
    return found[0], found[1].squares


def _hands(twist: float) -> tuple[float, float]:
    return math.copysign(1, twist), -math.copysign(1, twist)


def _start(
    strip: Image, plies: int, radius: float, twists: Array, lights: tuple[float, ...], scales: tuple[float, ...]
) -> tuple[Array, Array]:
    """Return the parameters and levels, see `Picture`, that leave least of a strip: first over T, then over r."""
    rows = max(1, round(radius / 3))
    columns = max(1, round(1 / (6 * plies * float(np.abs(twists).max()))))
    best, at, levels = math.inf, np.zeros(7), np.zeros(7)
    for scale in (None, *scales):
        r, tried, places = (radius, twists, (0.0,)) if scale is None else (radius * scale, at[4:5].copy(), PLACES)
        for light in lights:
            picture = _strands(plies, r, FIRST_BLUR, light, 0.0, _reach(strip))
            for place in places:
                squares, twist, turn, three = _scan(picture, plies, tried, strip, place * radius, rows, columns)
                if squares < best:
                    best, at = (
                        squares,
                        np.array([place * radius, 0, math.log(r), turn, twist, math.log(FIRST_BLUR), light]),
                    )
                    levels = np.array([three[0], 0, 0, three[1], three[2], 0, 0])
    return at, levels


def _reach(strip: Image) -> float:
    """Return how far from the axis a picture is computed [px]: its place may be off by half the strip's half width."""
    return 0.75 * strip.shape[0]


def _fit(strip: Image, plies: int, at: Array, levels: Array) -> Picture:
    """Fit the picture of the strands to a strip from parameters and levels, see `Picture`."""
    length = strip.shape[1]
    target = strip.T.ravel().astype(float)
    design = np.empty((14, target.size))
    largest = np.array(LARGEST_STEP)
    largest[[1, 4]] /= length
    settled, scale, damped = False, np.ones(14), np.eye(14)
    rest, weight, noise, height = target, np.ones(target.size), 0.0, 1.0
    for i in range(STEPS):
        _design(_pictures(strip, plies, at), plies, at, levels, strip.shape[0] // 2, length, design)
        rest = target - levels @ design[:7]
        above = np.abs(levels[3:] @ design[3:7])
        height = max(float(above.max()), 1e-9)
        noise, spread = _spread(rest, above, height)
        score = rest / spread
        # the biweight forgets what is far off, so only once the picture is about right
        weight = np.maximum(1 - (score / BIWEIGHT) ** 2, 0) ** 2 if i > 1 else 1 / np.maximum(1, np.abs(score) / 2)
        weighted = design * (weight / spread**2)
        normal = weighted @ design.T
        scale = np.sqrt(np.diag(normal)) + 1e-300
        damped = normal / np.outer(scale, scale) + 1e-9 * np.eye(14)
        step = np.linalg.solve(damped, (weighted @ rest) / scale) / scale
        moved = float(np.max(np.abs(step[7:]) / largest))
        if not math.isfinite(moved):
            break
        settled = i > 2 and moved < SETTLED
        if settled:
            break
        step /= max(1.0, moved)
        at, levels = at + step[7:], levels + step[:7]
        at[5] = np.clip(at[5], math.log(FIRST_BLUR / 4), max(at[2], 0.0))
        at[6] = np.clip(at[6], -FARTHEST, FARTHEST)
    limited = np.minimum(np.abs(rest), HAIR * height).reshape(length, -1)
    mean = (rest * weight).reshape(length, -1).sum(axis=0) / np.maximum(weight.reshape(length, -1).sum(axis=0), 1e-9)
    return Picture(
        at,
        levels,
        squares=float(np.mean(limited**2)) / height**2,
        explained=_explained(strip, limited, noise),
        share=float(np.mean(weight > 0.2)),
        misfit=math.sqrt(float(np.mean(mean**2))) / height,
        u_radius=math.sqrt(float(np.linalg.inv(damped)[9, 9])) / float(scale[9]) if settled else math.nan,
    )


def _spread(rest: Array, above: Array, height: float) -> tuple[float, Array]:
    """Return the noise and each pixel's standard deviation: noise, and texture that grows with the level `above`."""
    outside, inside = above < 0.05 * height, above > 0.5 * height
    noise = 1.4826 * float(np.median(np.abs(rest[outside]))) if np.any(outside) else 0.0
    noise = max(noise, 1e-3 * height)
    body = 1.4826 * float(np.median(np.abs(rest[inside])))
    texture = math.sqrt(max(body**2 - noise**2, 0)) / float(np.median(above[inside]))
    return noise, np.sqrt(noise**2 + (texture * above) ** 2)


def _explained(strip: Image, limited: Array, noise: float) -> float:
    """Return the share of what varies along the yarn, noise apart, that a fit with these residuals explains."""
    varies = float(np.sum((strip - strip.mean(axis=1, keepdims=True)) ** 2))
    return min(
        1.0, (varies - float(np.sum(limited**2))) / max(varies - noise**2 * limited.size, 1e-9 * varies + 1e-300)
    )


@lru_cache(maxsize=16)
def _legendre(count: int) -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(count)


def _nodes(radius: float) -> tuple[Array, Array]:
    """Return nodes for the integral over a strand's face, closer than the narrowest usual blur, and their weights."""
    return _legendre(8 * math.ceil(max(3 * radius, 8) / 8))


def _pictures(strip: Image, plies: int, at: Array) -> Array:
    """Return the picture at the parameters and its derivatives by ln r, ln σ and the lamp, shape (4, 2, …)."""
    reach, twist, small = _reach(strip), float(at[4]), 1e-3
    radius, blur, light = math.exp(at[2]), math.exp(at[5]), float(at[6])
    base = _strands(plies, radius, blur, light, twist, reach)
    moved = (
        _strands(plies, radius * (1 + small), blur, light, twist, reach),
        _strands(plies, radius, blur * (1 + small), light, twist, reach),
        _strands(plies, radius, blur, light + small, twist, reach),
    )
    return np.stack([base, *((picture - base) / small for picture in moved)])


@inner
def _ramp(z: float) -> float:
    return 0.5 * math.erf(z / math.sqrt(2.0))


@inner
def _face(plies: int, number: int, turn: float, radius: float, helix: float) -> tuple[float, float]:
    """Return from where to where a strand is not hidden by nearer ones [px]; the first is not below the last if it is.

    Strands do not cross, so of two whose pictures overlap the one whose middle is nearer hides the other.
    """
    angle = turn + 2 * math.pi * number / plies
    middle, depth = helix * math.sin(angle), math.cos(angle)
    first, last = middle - radius, middle + radius
    for k in range(plies):
        other = turn + 2 * math.pi * k / plies
        if math.cos(other) > depth + 1e-12:
            place = helix * math.sin(other)
            if place <= middle:
                first = max(first, place + radius)
            else:
                last = min(last, place - radius)
    return first, last


@compiled
def _faces(plies: int, radius: float, blur: float, light: float, reach: float, nodes: Array, shares: Array) -> Array:
    """Return the strands' picture, blurred across only, under ambient light and under the lamp, each of level 1.

    Parameters
    ----------
    radius, blur : r and σ [px].
    light : direction of the lamp around the axis, to its right if positive [rad].
    reach : how far from the axis [px].
    nodes, shares : of the Gauss–Legendre rule over (−1, 1).

    Returns
    -------
    Shape (2, PHASES, places): θ over 2π/n, and places `STEP` apart, the axis in the middle.
    """
    places = 2 * math.ceil(reach / STEP) + 1
    picture = np.zeros((2, PHASES, places))
    helix = radius / math.sin(math.pi / plies)
    for p in range(PHASES):
        turn = 2 * math.pi * p / PHASES / plies
        for k in range(plies):
            first, last = _face(plies, k, turn, radius, helix)
            if last <= first:
                continue
            angle = turn + 2 * math.pi * k / plies
            middle = helix * math.sin(angle)
            near = REACH * blur
            top = max(0, math.ceil((first - near) / STEP) + places // 2)
            bottom = min(places, math.floor((last + near) / STEP) + places // 2 + 1)
            for i in range(top, bottom):
                w = (i - places // 2) * STEP
                picture[0, p, i] += _ramp((w - first) / blur) - _ramp((w - last) / blur)
            # what faces the lamp
            start = max(light - math.pi / 2, math.asin(max(-1.0, (first - middle) / radius)))
            end = min(light + math.pi / 2, math.asin(min(1.0, (last - middle) / radius)))
            if end <= start:
                continue
            height = radius * (end - start) / 2 / (blur * math.sqrt(2 * math.pi))
            for m in range(nodes.size):
                gamma = (start + end) / 2 + nodes[m] * (end - start) / 2
                term = height * shares[m] * math.cos(gamma) * math.cos(gamma - light)
                place = (middle + radius * math.sin(gamma)) / STEP + places // 2
                top = max(0, math.ceil(place - near / STEP))
                for i in range(top, min(places, math.floor(place + near / STEP) + 1)):
                    z = (i - place) * STEP / blur
                    picture[1, p, i] += term * math.exp(-0.5 * z * z)
    return picture


def _strands(plies: int, radius: float, blur: float, light: float, twist: float, reach: float) -> Array:
    """Return the strands' picture under ambient light and under the lamp, each of level 1.

    Along the yarn it is θ that changes, so the blur along it is one over θ, which is periodic. Left out, it would make
    the diameter 0.4 % too small: it takes off the crests what it puts into the narrow hollows between them.

    Parameters
    ----------
    radius, blur : r and σ [px].
    light : direction of the lamp around the axis, to its right if positive [rad].
    twist : T [1/px]; at 0 the picture is blurred across only.
    reach : how far from the axis [px].

    Returns
    -------
    Shape (2, PHASES + 1, places): θ over 2π/n, both ends, and places `STEP` apart, the axis in the middle.
    """
    picture = _faces(plies, radius, blur, light, reach, *_nodes(radius))
    if twist:
        damping = np.exp(-2 * (math.pi * np.arange(PHASES // 2 + 1) * blur * plies * twist) ** 2)
        picture = np.fft.irfft(np.fft.rfft(picture, axis=1) * damping[:, None], PHASES, axis=1)
    return np.concatenate([picture, picture[:, :1]], axis=1)


@compiled
def _scan(
    picture: Array, plies: int, twists: Array, strip: Image, place: float, rows: int, columns: int
) -> tuple[float, float, float, Array]:
    """Return the least squares over T and φ, that T and φ, and the levels of background, ambient light and lamp.

    Parameters
    ----------
    picture : as `_strands` returns it.
    twists : shape (n,) [1/px].
    strip : shape (2h + 1, length).
    place : of the axis, from the strip's middle row [px].
    rows, columns : steps between the pixels that are looked at.
    """
    places, half, length = picture.shape[2], strip.shape[0] // 2, strip.shape[1]
    best, best_twist, best_turn, best_levels = math.inf, twists[0], 0.0, np.zeros(3)
    normal, right = np.empty((3, 3)), np.empty(3)
    basis = np.ones(3)
    for twist in twists:
        for q in range(TURNS):
            normal[:], right[:], total = 0, 0, 0.0
            for column in range(columns // 2, length, columns):
                turn = q / TURNS + twist * plies * (column - (length - 1) / 2)
                p = int((turn - math.floor(turn)) * PHASES)
                for i in range(0, 2 * half + 1, rows):
                    r = min(max(int((i - half - place) / STEP + places // 2 + 0.5), 0), places - 1)
                    basis[1], basis[2], value = picture[0, p, r], picture[1, p, r], strip[i, column]
                    for k in range(3):
                        right[k] += basis[k] * value
                        for m in range(k + 1):
                            normal[k, m] += basis[k] * basis[m]
                    total += value * value
            for k in range(3):
                normal[k, k] = normal[k, k] * (1 + 1e-9) + 1e-300
                for m in range(k):
                    normal[m, k] = normal[k, m]
            levels: Array = np.linalg.solve(normal, right)  # pyright: ignore[reportAssignmentType]
            squares = total - np.sum(levels * right)
            if squares < best:
                best, best_twist, best_turn, best_levels = squares, twist, 2 * math.pi * q / TURNS / plies, levels
    return best, best_twist, best_turn, best_levels


@compiled
def _design(pictures: Array, plies: int, at: Array, levels: Array, half: int, length: int, design: Array) -> None:
    """Fill the derivatives of each pixel's level by the seven levels and the seven parameters, see `Picture`.

    Parameters
    ----------
    pictures : as `_pictures` returns them.
    half, length : of the strip.
    design : shape (14, length·(2 half + 1)), the pixels column by column.
    """
    places, n = pictures.shape[3], 0
    values = np.empty((4, 2))
    for column in range(length):
        x = column - (length - 1) / 2
        turn = (at[3] + 2 * math.pi * at[4] * x) * plies / (2 * math.pi)
        turn = (turn - math.floor(turn)) * PHASES
        p = min(int(turn), PHASES - 1)
        fp = turn - p
        shares = (levels[3] + levels[5] * x / length, levels[4] + levels[6] * x / length)
        for i in range(2 * half + 1):
            w = i - half - at[0] - at[1] * x
            place = min(max(w / STEP + places // 2, 0.0), places - 1.001)
            r = int(place)
            fr = place - r
            across, around = 0.0, 0.0
            for g in range(2):
                for kind in range(4):
                    near, far = pictures[kind, g, p], pictures[kind, g, p + 1]
                    here, there = (1 - fr) * near[r] + fr * near[r + 1], (1 - fr) * far[r] + fr * far[r + 1]
                    values[kind, g] = (1 - fp) * here + fp * there
                    if kind == 0:
                        around += shares[g] * (there - here)
                        across += shares[g] * ((1 - fp) * (near[r + 1] - near[r]) + fp * (far[r + 1] - far[r]))
            across /= STEP
            around *= PHASES * plies / (2 * math.pi)
            design[0, n], design[1, n], design[2, n] = 1.0, w / half, x / length
            for g in range(2):
                design[3 + g, n], design[5 + g, n] = values[0, g], values[0, g] * x / length
            design[7, n], design[8, n] = -across, -across * x
            design[9, n] = shares[0] * values[1, 0] + shares[1] * values[1, 1]
            design[10, n], design[11, n] = around, around * 2 * math.pi * x
            design[12, n] = shares[0] * values[2, 0] + shares[1] * values[2, 1]
            design[13, n] = shares[1] * values[3, 1]
            n += 1
