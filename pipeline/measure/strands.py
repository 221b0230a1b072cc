"""The picture of n round strands that touch: what a camera sees of a plied yarn, in a strip along it.

The strands, of radius r, lie about the axis at h = r/sin(π/n), the least distance at which they touch; strand k stands
at θ = 2π(T·x + k/n) + φ, so across the axis at h·sinθ and towards the camera at h·cosθ. The diameter is that of the
circle around them, D = 2(r + h). The silhouette is narrower nearly everywhere: its mean width over the helix is the
perimeter of the strands' hull over π (Cauchy), r(2 + 2n/π), which is 18, 9 and 6 % less than D for n = 2, 3, 4.

Each strand shows where no nearer one hides it, lit as `lit.py` says (ambient light, and Lambert's law for one lamp with
the attached shadow), blurred by a Gaussian both ways, on a linear background, under light that changes linearly along
the yarn. A picture is computed over θ, of which one period is 2π/n, and the place across the axis; a pixel of a strip
takes its level and the derivatives from there.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from models.compiled import compiled, inner
from pipeline.records import Array

PHASES = 48
"""Steps of φ over the distance of two strands that a picture is computed at; between them it is interpolated."""
STEP = 0.5
"""Step of a picture across the axis [px]."""
NEAR = (0.005, 0.05, 0.03, 0.02)
"""Change of ln r, ln σ, the lamp's direction [rad] and T (relative) up to which a picture is taken to first order."""
REACH = 6.0
"""Distance in standard deviations from which on the blur is taken for 0."""


def mean_width(plies: int) -> float:
    """Return the silhouette's mean width over a strand's radius: the perimeter of the strands' hull over π."""
    return 2 + 2 * plies / math.pi


@lru_cache(maxsize=16)
def _legendre(count: int) -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(count)


def _nodes(radius: float) -> tuple[Array, Array]:
    """Return nodes for the integral over a strand's face, closer than the narrowest usual blur, and their weights."""
    return _legendre(8 * math.ceil(max(3 * radius, 8) / 8))


@dataclass(frozen=True, slots=True)
class Pictures:
    """A picture and its derivatives by ln r, ln σ and the lamp's direction: good near where they were computed."""

    at: Array
    """ln r, ln σ, direction of the lamp and T, shape (4,)."""
    values: Array
    """Shape (4, 2, PHASES + 1, places), see `strands`."""

    def serve(self, at: Array, places: int, tolerance: float) -> bool:
        """Say whether a `Picture`'s parameters are within `tolerance` times `NEAR`, and the places as many."""
        moved = np.abs(at[[2, 5, 6, 4]] - self.at)
        moved[3] /= abs(self.at[3])
        return self.values.shape[3] == places and bool(np.all(moved <= tolerance * np.array(NEAR)))

    def moved_to(self, at: Array) -> Array:
        """Return the picture at a `Picture`'s parameters to first order, with the derivatives."""
        values = self.values.copy()
        values[0] += np.tensordot(at[[2, 5, 6]] - self.at[:3], self.values[1:], axes=1)
        return values


def pictures(plies: int, at: Array, reach: float, last: Pictures | None, tolerance: float) -> Pictures:
    """Return the pictures at a `Picture`'s parameters, the last ones if they serve.

    Parameters
    ----------
    reach : how far from the axis [px].
    tolerance : see `Pictures.serve`.
    """
    if last is not None and last.serve(at, places_within(reach), tolerance):
        return last
    twist, small = float(at[4]), 1e-3
    radius, blur, light = math.exp(at[2]), math.exp(at[5]), float(at[6])
    base = strands(plies, radius, blur, light, twist, reach)
    moved = (
        strands(plies, radius * (1 + small), blur, light, twist, reach),
        strands(plies, radius, blur * (1 + small), light, twist, reach),
        strands(plies, radius, blur, light + small, twist, reach),
    )
    return Pictures(at[[2, 5, 6, 4]], np.stack([base, *((picture - base) / small for picture in moved)]))


@compiled
def places_within(reach: float) -> int:
    """Return how many places a picture has that reaches so far to each side [px]."""
    return 2 * math.ceil(reach / STEP) + 1


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
    places = places_within(reach)
    picture = np.zeros((2, PHASES, places))
    helix, pitch = radius / math.sin(math.pi / plies), STEP / blur
    factor = math.exp(-pitch * pitch)
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
                # the Gaussian place by place: the ratio of neighbours falls by the same factor
                z = (top - place) * pitch
                value, ratio = term * math.exp(-0.5 * z * z), math.exp(-pitch * (z + 0.5 * pitch))
                for i in range(top, min(places, math.floor(place + near / STEP) + 1)):
                    picture[1, p, i] += value
                    value *= ratio
                    ratio *= factor
    return picture


def strands(plies: int, radius: float, blur: float, light: float, twist: float, reach: float) -> Array:
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
def set_design(
    pictures: Array, plies: int, at: Array, levels: Array, half: int, length: int, every: int, design: Array
) -> None:
    """Fill the derivatives of each pixel's level by the seven levels and the seven parameters, see `Picture`.

    Parameters
    ----------
    pictures : as `pictures` returns them.
    half, length : of the strip.
    every : one of so many columns is filled in.
    design : shape (14, columns·(2 half + 1)), the pixels column by column.
    """
    places, n = pictures.shape[3], 0
    values = np.empty((4, 2))
    for column in range(0, length, every):
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
