"""The cross profile of a round, matt yarn in the light of one lamp and its surroundings, with its own shadow.

At w = R sinγ from the axis the yarn shows the level

    I(γ) = a + b·max(cos(γ − α), 0),

ambient light and Lambert's law for a lamp that stands at α around the axis, 0 towards the camera; the surface beyond
γ = α ∓ π/2 is turned away from the lamp (attached shadow). The profile is I over −π/2 < γ < π/2, blurred by a Gaussian,
on a linear background. Without the shadow, which `axis.py` leaves out where the lamp stands near the camera, the
radius is wrong by 0.4 % at α = 11°, 4 % at 23° and a third at 63°.

Separable least squares: Levenberg's steps in offset, R, blur and α, the four levels linear. With the lamp far to the
side there are several minima, so the fit starts from several α on either side; the edge that faces the lamp is seen
well, so each start keeps that edge.
"""

import math
from typing import NamedTuple

import numpy as np

from models.compiled import compiled, inner, spliced
from models.newton import lu_factor, lu_solve
from pipeline.measure.profile import SHARPER, background, even, left, products, weights
from pipeline.records import Array

STARTS = (0.2, 0.5, 0.8, 1.1, 1.4)
"""Directions of the lamp that the fit starts from, on either side [rad]."""
FARTHEST = 1.55
"""Largest α: beyond, the lamp stands behind the yarn [rad]."""
NO_BODY = 0.1
"""Misfit from which on there is nothing but noise in the profile."""
FOOT = 0.2
"""Height of the profile, over its maximum, that the bright side is taken to begin at."""
NODES_SHOWN, SHARES_SHOWN = np.polynomial.legendre.leggauss(64)
"""Of the integral over γ that tells which surface shows at a place."""
FAR = 6.0
"""Distance in standard deviations from which on the blur is taken for 0."""
STEPS = 30
SETTLED = 1e-3
"""Relative fall of the squares in the last step."""


class LitProfile(NamedTuple):
    """A fitted profile, lengths in its rows or in pixels."""

    offset: float
    """Place of the axis, from the middle row."""
    radius: float
    """0 where no fit is credible."""
    blur: float
    """Standard deviation."""
    light: float
    """α [rad]."""
    ambient: float
    """a, above the background [counts]."""
    lamp: float
    """b [counts]."""
    squares: float
    """Weighted sum of the squared residuals."""
    misfit: float
    """Root mean square of the residuals over the range of the profile."""


NOT_FITTED = LitProfile(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inner
def scaled(body: LitProfile, factor: float) -> LitProfile:
    """Return the same in another unit of length."""
    return LitProfile(
        body.offset * factor,
        body.radius * factor,
        body.blur * factor,
        body.light,
        body.ambient,
        body.lamp,
        body.squares,
        body.misfit,
    )


@inner
def fit_lit(profile: Array, spread: Array, starts: Array) -> LitProfile:
    """Fit the profile from each start and return the best fit, `NOT_FITTED` where none stays inside of its bounds.

    Parameters
    ----------
    profile, spread : see `align.Registered`, shape (2h + 1,), the middle row at w = 0.
    starts : offset, radius, blur and light to start from, lengths in rows, shape (n, 4).
    """
    while True:
        narrowest = starts[:, 2].min()
        nodes, shares = even(starts[:, 1].max(), narrowest)
        best = NOT_FITTED
        for i in range(starts.shape[0]):
            found = _fit(profile, spread, starts[i], nodes, shares)
            if found.radius and (not best.radius or found.squares < best.squares):
                best = found
        if not best.radius or best.blur >= SHARPER * narrowest:
            return best
        starts = np.array([[best.offset, best.radius, best.blur, best.light]])


@inner
def bright_side(profile: Array) -> tuple[float, float]:
    """Return where the profile falls to `FOOT` of its height above the brighter end, from the middle row [px]."""
    first, last = background(profile)
    ground = max(first, last)
    bright = np.flatnonzero(profile - ground >= FOOT * (profile.max() - ground))
    return float(bright[0] - profile.size // 2), float(bright[-1] - profile.size // 2)


@inner
def side_starts(profile: Array, blur: float) -> Array:
    """Starts with the lamp on either side: R(1 + cos α) of the width is bright, from the edge that faces the lamp.

    Returns
    -------
    Shape (n, 4), see `fit_lit`.
    """
    first, last = bright_side(profile)
    starts = np.empty((2 * len(STARTS), 4))
    for i in range(len(STARTS)):
        light = STARTS[i]
        radius = max(last - first, 2.0) / (1 + math.cos(light))
        starts[2 * i] = last - radius, radius, blur, light
        starts[2 * i + 1] = first + radius, radius, blur, -light
    return starts


@compiled
def level(gamma: Array, light: float, shade: tuple[float, float]) -> Array:
    """Return the surface's level at γ; `shade` is that facing the lamp and that in the shadow, see `YarnAxis`."""
    return shade[1] + (shade[0] - shade[1]) * np.maximum(np.cos(gamma - light), 0)


@compiled
def places_of(gamma: Array, radius: float, blur: float, light: float, shade: tuple[float, float]) -> Array:
    """Return the distances w from the axis [px] at which the surface at each γ shows, shape (n,).

    A pixel mixes the surface around it by the blur, and brighter surface counts more: at w shows the mean of γ weighted
    by I(γ) and by the Gaussian of (w − R sinγ). Without blur w is R sinγ.
    """
    surface = NODES_SHOWN * (math.pi / 2)
    sine = radius * np.sin(surface)
    bright = np.maximum(level(surface, light, shade), 1e-3 * max(abs(shade[0]), 1e-9))
    weight = SHARES_SHOWN * np.cos(surface) * bright
    across = np.linspace(-1, 1, 65) * radius
    shown = np.arcsin(np.linspace(-1, 1, 65))
    # no narrower than the nodes lie apart; the shift grows with the square of the blur
    near = max(blur, 0.05 * radius)
    share = min(1.0, (blur / (0.05 * radius)) ** 2)
    for i in range(across.size):
        total, mean = 0.0, 0.0
        for j in range(sine.size):
            z = (across[i] - sine[j]) / near
            if abs(z) < FAR:
                part = math.exp(-0.5 * z * z) * weight[j]
                total += part
                mean += part * surface[j]
        shown[i] += share * (mean / total - shown[i])
    return np.interp(gamma, shown, across)


@inner
def _bodies(at: Array, rows: int, nodes: Array, shares: Array) -> tuple[Array, Array]:
    """Return the flat and the lamp-lit body at w = −h … h, (2, rows), and their derivatives by `at`, (2, 4, rows).

    With G the blur's Gaussian of z = (w − offset − R sinγ)/σ, both are sums over γ of a term times G.
    """
    offset, radius, blur, light = at[0], at[1], math.exp(at[2]), at[3]
    height = radius / (blur * math.sqrt(2 * math.pi))
    start, end = max(-math.pi / 2, light - math.pi / 2), min(math.pi / 2, light + math.pi / 2)
    bodies, slopes = np.zeros((2, rows)), np.zeros((2, 4, rows))
    pitch = 1 / blur
    factor = math.exp(-pitch * pitch)
    for kind in range(2):
        first_gamma, last_gamma = (-math.pi / 2, math.pi / 2) if kind == 0 else (start, end)
        middle, reach = (first_gamma + last_gamma) / 2, (last_gamma - first_gamma) / 2
        for j in range(nodes.size):
            gamma = middle + nodes[j] * reach
            sine = math.sin(gamma)
            term, turned = height * shares[j] * reach * math.cos(gamma), 0.0
            if kind == 1:  # Lambert's law; where the shadow begins it is 0, so only the law changes with the light
                turned = term * math.sin(gamma - light)
                term *= math.cos(gamma - light)
            place = offset + radius * sine + rows // 2
            first = max(0, math.ceil(place - FAR * blur))
            # The Gaussian row by row: the ratio of neighbours falls by the same factor, which saves their exponentials.
            z = (first - place) * pitch
            gauss, ratio = math.exp(-0.5 * z * z), math.exp(-pitch * (z + 0.5 * pitch))
            for i in range(first, min(rows, math.floor(place + FAR * blur) + 1)):
                value = term * gauss
                bodies[kind, i] += value
                slopes[kind, 0, i] += value * z * pitch
                slopes[kind, 1, i] += value * (z * sine * pitch + 1 / radius)
                slopes[kind, 2, i] += value * (z * z - 1)
                slopes[kind, 3, i] += turned * gauss
                gauss *= ratio
                ratio *= factor
                z += pitch
    return bodies, slopes


@inner
def _rest(
    at: Array, profile: Array, weight: Array, nodes: Array, shares: Array, levels: Array, jacobian: Array
) -> Array:
    """Return the weighted residuals, (rows,), with the best levels; fill these, (4,), and the Jacobian, (4, rows).

    The Jacobian is that of what the best levels leave (Kaufman, BIT 15, 1975).
    """
    rows = profile.size
    bodies, slopes = _bodies(at, rows, nodes, shares)
    basis, columns = np.empty((4, rows)), np.empty((5, rows))
    for i in range(rows):
        basis[0, i], basis[1, i] = weight[i], weight[i] * (i - rows // 2) / rows
        basis[2, i], basis[3, i] = weight[i] * bodies[0, i], weight[i] * bodies[1, i]
    columns[0] = weight * profile
    levels[:] = left(basis, columns[:1])[0]
    for k in range(4):  # by what the residuals change
        columns[1 + k] = -weight * (levels[2] * slopes[0, k] + levels[3] * slopes[1, k])
    left(basis, columns[1:])
    jacobian[:] = columns[1:]
    return columns[0]


@spliced
def _fit(profile: Array, spread: Array, start: Array, nodes: Array, shares: Array) -> LitProfile:
    """Fit the profile from one start."""
    rows = profile.size
    half, weight = rows // 2, weights(profile, spread)
    low, high = np.array([-half, 1.5, math.log(0.3), -FARTHEST]), np.array([half, half - 1.0, math.log(half), FARTHEST])
    at = start.copy()
    at[2] = math.log(at[2])
    at = np.minimum(np.maximum(at, low), high)
    levels, trial_levels = np.zeros(4), np.zeros(4)
    jacobian, trial_jacobian = np.empty((4, rows)), np.empty((4, rows))
    rest = _rest(at, profile, weight, nodes, shares, levels, jacobian)
    squares, damping, pivots = np.sum(rest * rest), 1e-3, np.empty(4, np.int64)
    for _ in range(STEPS):
        normal, slope = products(jacobian, jacobian), products(jacobian, rest.reshape(1, -1))[:, 0]
        before = squares
        for _ in range(8):
            damped = normal.copy()
            for k in range(4):
                damped[k, k] += damping * normal[k, k] + 1e-12
            lu_factor(damped, pivots)
            trial = np.minimum(np.maximum(at - lu_solve(damped, pivots, slope), low), high)
            trial_rest = _rest(trial, profile, weight, nodes, shares, trial_levels, trial_jacobian)
            total = np.sum(trial_rest * trial_rest)
            if total < squares:
                at[:], rest, squares = trial, trial_rest, total
                levels, trial_levels = trial_levels, levels
                jacobian, trial_jacobian = trial_jacobian, jacobian
                damping *= 0.1
                break
            damping *= 10
        if before - squares < SETTLED * squares:
            break
    misfit = math.sqrt(np.mean((rest / weight) ** 2)) / max(np.max(profile) - np.min(profile), 1e-9)
    inside = np.all((at[:3] > low[:3]) & (at[:3] < high[:3]))
    # a lamp that takes light away is none
    if not (inside and levels[3] > 0 and math.isfinite(squares) and misfit < NO_BODY):
        return NOT_FITTED
    return LitProfile(at[0], at[1], math.exp(at[2]), at[3], levels[2], levels[3], squares, misfit)
