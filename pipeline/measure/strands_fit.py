"""The fit of the strands' picture (`strands.py`) to a straightened strip.

The whole strip is fitted, not its mean profile. Unknown are the axis' place and tilt, r, φ, T, the blur and the lamp's
direction; the levels are linear. The silhouette is part of the picture, so any part of a turn in view does: its
harmonics are those of the helix, and no mean over whole periods is needed.

Gauss–Newton with iterated weights. A pixel weighs by its noise and by the texture, which grows with the level, both
from the residuals' medians: texture in the body must not outweigh the edges. Tukey's biweight leaves hairs out.
The fit starts from the best of a scan over T of both hands, φ, place and lamp. Both hands are fitted; only what lies
inside the silhouette tells them apart.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from models.compiled import compiled
from pipeline.measure.coloured import coloured_u
from pipeline.measure.lines import Image
from pipeline.measure.pitch import SLOPES
from pipeline.measure.strands import PHASES, STEP, Pictures, mean_width, pictures, set_design, strands
from pipeline.records import Array

MIN_PERIODS = 1.0
"""Strand periods in view (of which a turn has n)."""
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
ROUGH = 2
"""Steps until the picture is about right: only then does the biweight tell hairs from what is still to be fitted."""
COARSE, FEWEST = 4, 40
"""Columns of which one is looked at until the fit has settled, and how many of these there must be."""
BIWEIGHT = 4.685
HAIR = 0.3
"""Residual over the picture's height from which on it counts as this much."""
OUTSIDE = 0.05
"""Level of the picture over its height below which a pixel shows the background."""
FARTHEST = 1.55
"""Largest direction of the lamp [rad]."""


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
    u_twist: float
    """Standard uncertainty of T by what is left, as in `coloured.py` [1/px]; NaN where `u_radius` is."""
    other: float = math.nan
    """`squares` of the best picture of the other hand, in the last frame in which it was looked for; infinite where the
    hand was known."""
    computed: Pictures | None = None
    """The pictures that the fit ended with: the next frame's need not be computed anew if they are near."""


def best_fit(
    strip: Image, plies: int, width: float, before: Picture | None, twist: float | None = None, hand: int = 0
) -> Picture:
    """Fit a strip from where the frame before was, if that still explains it, else from a scan.

    Parameters
    ----------
    strip : shape (2h + 1, length).
    plies : strands n, at least 2.
    width : half the silhouette's width, about [px].
    before : the picture in the frame before.
    twist : without its sign, about [1/px]; without it all are scanned that strands can have.
    hand : 1 for Z, -1 for S; without it both are fitted.
    """
    radius = 2 * width / mean_width(plies)
    length = strip.shape[1]
    fastest = SLOPES[1] / (math.pi * radius * (1 + 1 / math.sin(math.pi / plies)))
    twists = np.arange(MIN_PERIODS, max(fastest * plies * length, MIN_PERIODS + 1), FINENESS) / (plies * length)
    if twist is not None:
        twists = twist + FINENESS / (plies * length) * np.arange(-2.0, 3.0)
    if before is not None and hand * float(before.at[4]) >= 0:
        last = float(before.at[4])
        near = twists[np.abs(twists - abs(last)) <= max(CHANGE * abs(last), 2 * FINENESS / (plies * length))]
        if near.size:
            at, levels = _start(
                strip, plies, math.exp(before.at[2]), math.copysign(1, last) * near, (float(before.at[6]),), (1.0,)
            )
            at[5] = before.at[5]
            same = fit(strip, plies, at, levels, before.computed)
            if same.squares <= AS_BEFORE**2 * before.squares:
                return replace(same, other=math.inf if hand else before.other)
    hands = (hand,) if hand else (1, -1)
    found = [fit(strip, plies, *_start(strip, plies, radius, sign * twists, LIGHTS, SCALES)) for sign in hands]
    found.sort(key=lambda picture: picture.squares)
    return replace(found[0], other=math.inf if hand else found[1].squares)


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
            picture = strands(plies, r, FIRST_BLUR, light, 0.0, _reach(strip))
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


def fit(strip: Image, plies: int, at: Array, levels: Array, computed: Pictures | None = None) -> Picture:
    """Fit the picture of the strands to a strip from parameters, levels and pictures, see `Picture`."""
    if strip.shape[1] < FEWEST * COARSE:
        return _fit(strip, 1, plies, at, levels, computed, 0)
    coarse = _fit(strip, COARSE, plies, at, levels, computed, 0)
    return _fit(strip, 1, plies, coarse.at, coarse.levels, coarse.computed, ROUGH)


def _fit(
    strip: Image, every: int, plies: int, at: Array, levels: Array, computed: Pictures | None, first: int
) -> Picture:
    """Fit to one column of `every` so many, from step number `first` on: up to `ROUGH` the start is a rough one.

    What is fitted to few columns is a start for what is fitted to all: its pictures may be less exact.
    """
    length, looked_at = strip.shape[1], strip[:, ::every]
    target = looked_at.T.ravel().astype(float)
    design = np.empty((14, target.size))
    largest = np.array(LARGEST_STEP)
    largest[[1, 4]] /= length
    settled, scale, damped = False, np.ones(14), np.eye(14)
    rest, weight, noise, height = target, np.ones(target.size), 0.0, 1.0
    above, spread = np.zeros(target.size), np.ones(target.size)
    for i in range(first, STEPS):
        computed = pictures(plies, at, _reach(strip), computed, tolerance=every)
        shown = computed.moved_to(at)
        set_design(shown, plies, at, levels, strip.shape[0] // 2, length, every, design)
        rest = target - levels @ design[:7]
        above = np.abs(levels[3:] @ design[3:7])
        height = max(float(above.max()), 1e-9)
        noise, spread = _spread(rest, above, height)
        score = rest / spread
        weight = np.maximum(1 - (score / BIWEIGHT) ** 2, 0) ** 2 if i >= ROUGH else 1 / np.maximum(1, np.abs(score) / 2)
        weighted = design * (weight / spread**2)
        normal = weighted @ design.T
        scale = np.sqrt(np.diag(normal)) + 1e-300
        damped = normal / np.outer(scale, scale) + 1e-9 * np.eye(14)
        step = np.linalg.solve(damped, (weighted @ rest) / scale) / scale
        moved = float(np.max(np.abs(step[7:]) / largest))
        if not math.isfinite(moved):
            break
        settled = i > ROUGH and moved < SETTLED
        if settled:
            break
        step /= max(1.0, moved)
        at, levels = at + step[7:], levels + step[:7]
        at[5] = np.clip(at[5], math.log(FIRST_BLUR / 4), max(at[2], 0.0))
        at[6] = np.clip(at[6], -FARTHEST, FARTHEST)
    rows = strip.shape[0]
    limited, weight = np.minimum(np.abs(rest), HAIR * height), weight.reshape(-1, rows)
    mean = (rest.reshape(-1, rows) * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-9)
    u_radius, u_twist = math.nan, math.nan
    if settled:
        inverse = np.linalg.inv(damped) / np.outer(scale, scale)
        u_radius = math.sqrt(float(inverse[9, 9]))
        influence, left = inverse[11] @ design / spread, weight.ravel() * rest / spread
        # a parameter moves the sum of ψ by less than if the weights were held (Huber, Robust Statistics, 1981, 7.6)
        square = np.minimum((rest / spread / BIWEIGHT) ** 2, 1)
        held = float(influence**2 @ (1 - square) ** 2)
        influence *= held / max(float(influence**2 @ ((1 - square) * (1 - 5 * square))), 0.1 * held)
        # what fibres leave, and what the background does, are correlated over lengths of their own
        body = above > OUTSIDE * height
        parts = ((influence * part, left * part) for part in (body, ~body))
        u_twist = math.hypot(*(coloured_u(a.reshape(-1, rows), r.reshape(-1, rows)) for a, r in parts))
    return Picture(
        at,
        levels,
        squares=float(np.mean(limited**2)) / height**2,
        explained=_explained(looked_at, limited, noise),
        share=float(np.mean(weight > 0.2)),
        misfit=math.sqrt(float(np.mean(mean**2))) / height,
        u_radius=u_radius,
        u_twist=u_twist,
        computed=computed,
    )


def _spread(rest: Array, above: Array, height: float) -> tuple[float, Array]:
    """Return the noise and each pixel's standard deviation: noise, and texture that grows with the level `above`."""
    outside, inside = above < OUTSIDE * height, above > 0.5 * height
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


@compiled
def _scan(
    picture: Array, plies: int, twists: Array, strip: Image, place: float, rows: int, columns: int
) -> tuple[float, float, float, Array]:
    """Return the least squares over T and φ, that T and φ, and the levels of background, ambient light and lamp.

    Parameters
    ----------
    picture : as `strands` returns it.
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
