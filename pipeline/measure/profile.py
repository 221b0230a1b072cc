"""The mean cross profile of a straightened yarn: where its middle is, and the body that is fitted to it.

The body of radius R has a brightness that is a combination of 1, sin γ and cos γ (w = R sin γ: ambient light and
Lambert's law from any side), is blurred by a Gaussian and stands on a linear background; `pipeline.measure.axis` says
why. Compiled: on the 70 rows of a profile nearly all the time would be Python's.
"""

import math

import numpy as np

from models.compiled import inner, spliced, summing
from models.newton import lu_factor, lu_solve
from pipeline.measure.lines import Image
from pipeline.records import Array

TRUSTED = 0.1
"""Least spread that a row's values are taken to have, over the step of the profile near it. Without it sharp frames of
little noise had diameters up to 8 % too large."""
STEP_SEEN = 8
"""Rows on each side in which a step counts as near."""
SETTLED = 0.02
"""Last step of the profile's fit [px, and in the logarithm of the blur]; the next would be some ten times smaller."""
INNER = 0.5
"""Share of the radius inside of which the profile says nothing of the edges and is left out of the fit."""
FOOT = 0.3
"""Height of a foot over that of the profile."""
INSIDE = 0.8
"""Share of the radius inside of which a body's edges do not show."""
FINE = 0.9
"""Nodes of the integral over γ for each standard deviation of the blur on the surface that faces the camera."""
SHARPER = 0.8
"""Share of the blur that nodes were chosen for from which on finer ones are needed."""
NARROWEST = 0.35
"""Smallest blur that nodes are chosen for [px]: the pixels' own."""
FAR = 6.0
"""Distance in standard deviations from which on the blur is taken for 0."""


@inner
def background(profile: Array) -> tuple[float, float]:
    """Return the levels beside the yarn, at the first and the last row of a profile, shape (2h + 1,)."""
    return profile[:3].mean(), profile[-3:].mean()


@inner
def middle(profile: Array) -> float:
    """Return how far from the middle row the body is, half way between its outermost half heights [px].

    Parameters
    ----------
    profile : shape (2h + 1,).
    """
    level = profile.mean()
    first_end, last_end = background(profile)
    ground = first_end if abs(first_end - level) >= abs(last_end - level) else last_end
    height = np.abs(profile - ground)
    height /= max(height.max(), 1e-9) / 2
    top = np.flatnonzero(height >= 1)
    i, j = top[0], top[-1]
    first, last = float(i), float(j)
    if i > 0 and j < profile.size - 1:
        first -= (height[i] - 1) / (height[i] - height[i - 1])
        last += (height[j] - 1) / (height[j] - height[j + 1])
    return (first + last - (profile.size - 1)) / 2


@inner
def feet(profile: Array) -> tuple[float, float]:
    """Return half way between a body's feet, from the middle row, and half of what is between them [rows].

    A foot is where the profile has risen to `FOOT` of its height above the ground on that side: low, so that an edge in
    the shade, or beside a face that shines, is one.

    Parameters
    ----------
    profile : shape (2h + 1,), not flat.
    """
    places = np.empty(2)
    for side in range(2):
        rows = profile if side == 0 else profile[::-1]
        height = np.abs(rows - rows[:3].mean())
        limit = FOOT * height.max()
        at = 1
        while at < rows.size - 1 and height[at] < limit:
            at += 1
        places[side] = at - min(max((height[at] - limit) / max(height[at] - height[at - 1], 1e-9), 0.0), 1.0)
    first, last = places[0], profile.size - 1 - places[1]
    return (first + last - (profile.size - 1)) / 2, (last - first) / 2


@inner
def groove(profile: Array, offset: float, radius: float) -> float:
    """Return how deep a groove a body has inside or beside it, over the profile's range.

    Inside of a body light from one side, or from behind, leaves at most a shallow one, and beside it there is the
    ground. Two bodies have a deep one between them, whether both were taken for one or not.

    Parameters
    ----------
    profile : shape (2h + 1,).
    offset, radius : of the body, from the middle row [rows].
    """
    middle, size = profile.size // 2 + offset, profile.size
    first, past = max(0, math.ceil(middle - INSIDE * radius)), min(size, math.floor(middle + INSIDE * radius) + 1)
    top, bottom = max(0, math.ceil(middle - radius)), min(size, math.floor(middle + radius) + 1)
    if past - first < 3:
        return 0.0
    first_end, last_end = background(profile)
    above = 2 * profile[first:past].mean() > first_end + last_end
    beside = profile if above else -profile
    deepest = max(_rise(beside[bottom:]), _rise(beside[:top][::-1]))
    inside, left = profile[first:past], profile[first]
    right = inside.copy()
    for i in range(inside.size - 2, -1, -1):
        right[i] = max(right[i], right[i + 1])
    for i in range(inside.size):
        left = max(left, inside[i])
        deepest = max(deepest, min(left, right[i]) - inside[i])
    return deepest / max(profile.max() - profile.min(), 1e-9)


@inner
def relief(profile: Array) -> float:
    """Return by how much a profile is higher between its ends than at both of them, or lower, over its range.

    Not above 0 for an edge: what rises all the way from one end to the other is the boundary of something broader.

    Parameters
    ----------
    profile : shape (2h + 1,).
    """
    first, last = background(profile)
    between = profile[3:-3]
    most = max(between.max() - max(first, last), min(first, last) - between.min())
    return most / max(profile.max() - profile.min(), 1e-9)


@inner
def _rise(levels: Array) -> float:
    """Return by how much levels rise again, at most."""
    lowest, rise = math.inf, 0.0
    for level in levels:
        lowest = min(lowest, level)
        rise = max(rise, level - lowest)
    return rise


@inner
def even(radius: float, blur: float) -> tuple[Array, Array]:
    """Return evenly spaced nodes over (−1, 1), `FINE` for a blur's σ on a face of π·`radius`, and their weights.

    Integrands over γ that are blurred by a Gaussian are smooth, and fall to 0 at both ends; there evenly spaced nodes
    miss a share of 2·exp(−2π²(σ/h)²) and what the slope at the ends adds, which the first and last weight put right.
    Gauss–Legendre nodes are 1.6 times further apart in the middle: as many of them left ripples of 2 % at σ = 0.8 px.

    Parameters
    ----------
    radius, blur : in one unit; the blur may turn out to be down to `SHARPER` of it.
    """
    count = 16 * math.ceil(FINE * math.pi * radius / max(blur, NARROWEST) / 16)
    shares = np.full(count, 2 / count)
    shares[0] *= 11 / 12
    shares[-1] *= 11 / 12
    return (2 * np.arange(count) + 1) / count - 1, shares


@inner
def _body(across: Array, offset: float, radius: float, blur: float, sine: Array, share: Array) -> Array:
    """Return the blurred body with the shades 1, sin γ and cos γ, and what its derivatives are made of.

    Parameters
    ----------
    across : w, shape (n,) [px].
    sine, share : sin γ at nodes over (−π/2, π/2), and weights for dw/R.

    Returns
    -------
    Shape (4, 3, n): the integral over γ of shade times G, z·G, z²·G, z·sin γ·G for each of the shades; G is the blur's
    Gaussian of z = (w − offset − R sin γ)/blur.
    """
    integrals = np.zeros((4, 3, across.size))
    height = radius / (blur * math.sqrt(2 * math.pi))
    shade = np.ones(3)
    for j in range(sine.size):
        shade[1], shade[2] = sine[j], math.sqrt(1 - sine[j] * sine[j])
        for i in range(across.size):
            z = (across[i] - offset - radius * sine[j]) / blur
            if abs(z) > FAR:
                continue
            term = height * share[j] * math.exp(-0.5 * z * z)
            for k in range(3):
                shaded = term * shade[k]
                integrals[0, k, i] += shaded
                integrals[1, k, i] += shaded * z
                integrals[2, k, i] += shaded * z * z
                integrals[3, k, i] += shaded * z * sine[j]
    return integrals


@summing
def dot(first: Array | Image, second: Array | Image) -> float:
    """Return the sum of the products of two arrays of shape (n,)."""
    total = first[0] * second[0]
    for k in range(1, first.size):
        total += first[k] * second[k]
    return total


@summing
def total(values: Array | Image) -> float:
    """Return the sum of an array of shape (n,)."""
    result = values[0]
    for k in range(1, values.size):
        result += values[k]
    return result


@inner
def products(first: Array, second: Array | Image) -> Array:
    """Return first · secondᵀ of shapes (m, n) and (k, n): written out, because calling BLAS for it costs more."""
    products = np.empty((first.shape[0], second.shape[0]))
    for i in range(first.shape[0]):
        for j in range(second.shape[0]):
            products[i, j] = dot(first[i], second[j])
    return products


@inner
def left(basis: Array, columns: Array) -> Array:
    """Take from each of the columns, shape (m, n), its best fit by the basis, (k, n); return coefficients, (m, k)."""
    count = basis.shape[0]
    normal = products(basis, basis)
    scale = np.sqrt(np.diag(normal)) + 1e-300
    for i in range(count):
        for j in range(count):
            normal[i, j] /= scale[i] * scale[j]
        normal[i, i] += 1e-10
    pivots = np.empty(count, np.int64)
    lu_factor(normal, pivots)
    coefficients = products(columns, basis)
    for i in range(columns.shape[0]):
        coefficients[i] = lu_solve(normal, pivots, coefficients[i] / scale) / scale
        for k in range(count):
            columns[i] -= coefficients[i, k] * basis[k]
    return coefficients


@inner
def _residuals(
    at: Array, across: Array, weight: Array, target: Array, sine: Array, share: Array, jacobian: Array
) -> tuple[Array, Array]:
    """Return the residuals, shape (n,), and the linear coefficients, shape (5,); fill the Jacobian, shape (3, n).

    The coefficients of background and shades are the best for the offset, the radius and the blur's logarithm in `at`;
    the Jacobian is that of what they leave (Kaufman, BIT 15, 1975).
    """
    radius, blur = at[1], math.exp(at[2])
    integrals = _body(across, at[0], radius, blur, sine, share) * weight
    basis = np.empty((5, across.size))
    basis[0], basis[1], basis[2:] = weight, across * weight, integrals[0]
    rest = target.copy().reshape(1, -1)
    coefficients = left(basis, rest)[0]
    jacobian[:] = 0
    for k in range(3):
        c = coefficients[2 + k]
        jacobian[0] -= c * integrals[1, k] / blur
        jacobian[1] -= c * (integrals[3, k] / blur + integrals[0, k] / radius)
        jacobian[2] -= c * (integrals[2, k] - integrals[0, k])
    left(basis, jacobian)
    return rest[0], coefficients


@inner
def weights(profile: Array, spread: Array) -> Array:
    """Return each row's weight, the inverse of its values' spread: texture in the body must not outweigh the edges.

    Nor must an even background next to an edge, by where the blur is not a Gaussian: near a step no row is trusted
    beyond a share of that step. A faint edge, in the shade, so keeps its weight.
    """
    height = max(profile.max() - profile.min(), 1e-9)
    weight = np.empty(profile.size)
    for i in range(profile.size):
        low, high = max(0, i - STEP_SEEN), min(profile.size, i + STEP_SEEN + 1)
        step = np.max(profile[low:high]) - np.min(profile[low:high])
        weight[i] = 1 / max(spread[i], TRUSTED * step, 1e-3 * height)
    return weight


@inner
def fit_profile(
    profile: Array, spread: Array, offset: float, radius: float, blur: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Fit the blurred, shaded body without a shadow to a profile: the fields of `LitProfile`, zeros without contrast.

    Rows weigh by the spread of their values, so texture in the body does not outweigh the edges. Separable least
    squares: Levenberg's steps in offset, radius and blur, all else linear.

    Parameters
    ----------
    profile, spread : mean and interquartile range of the strip's rows, shape (2h + 1,).
    offset, radius, blur : where to start from [px].
    """
    while True:
        nodes, shares = even(radius, blur)
        gamma = nodes * (math.pi / 2)
        found = _fit(profile, spread, offset, radius, blur, np.sin(gamma), shares * (math.pi / 2) * np.cos(gamma))
        if not found[1] or found[2] >= SHARPER * blur:
            return found
        offset, radius, blur = found[:3]


@spliced
def _fit(
    profile: Array, spread: Array, offset: float, radius: float, blur: float, sine: Array, share: Array
) -> tuple[float, float, float, float, float, float, float, float]:
    """Fit with nodes that are fine enough for a blur not below `SHARPER` of the one to start from."""
    half = profile.size // 2
    across = np.arange(-half, half + 1).astype(np.float64)
    outer = np.abs(across) > INNER * radius
    across = across[outer]
    weight = weights(profile, spread)[outer]
    target = profile[outer] * weight
    low = np.array([-radius, 0.6 * radius, math.log(0.3)])
    high = np.array([radius, min(1.4 * radius, half - 1.0), math.log(max(radius / 2, 1.0))])
    at = np.minimum(np.maximum(np.array([offset, radius, math.log(blur)]), low), high)
    jacobian, trial_jacobian = np.empty((3, across.size)), np.empty((3, across.size))
    pivots = np.empty(3, np.int64)
    damping = 1e-3
    rest, coefficients = _residuals(at, across, weight, target, sine, share, jacobian)
    for _ in range(20):
        normal = products(jacobian, jacobian)
        for i in range(3):
            normal[i, i] += damping * normal[i, i] + 1e-12
        slope = products(jacobian, rest.reshape(1, -1))[:, 0]
        lu_factor(normal, pivots)
        trial = np.minimum(np.maximum(at - lu_solve(normal, pivots, slope), low), high)
        trial_rest, trial_coefficients = _residuals(trial, across, weight, target, sine, share, trial_jacobian)
        moved = np.abs(trial - at).max()
        if np.sum(trial_rest * trial_rest) < np.sum(rest * rest):
            at, rest, coefficients = trial, trial_rest, trial_coefficients
            jacobian, trial_jacobian = trial_jacobian, jacobian
            damping *= 0.1
        else:
            damping *= 10
        if moved < SETTLED or damping > 1e3:
            break
    contrast = abs(coefficients[2] + coefficients[4] * math.pi / 4)
    if contrast < 5 * np.std(rest / weight) or not low[1] < at[1] < high[1]:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    right, front = coefficients[3], coefficients[4]
    misfit = math.sqrt(np.mean((rest / weight) ** 2)) / max(profile.max() - profile.min(), 1e-9)
    light, lamp = math.atan2(right, front), math.hypot(right, front)
    return at[0], at[1], math.exp(at[2]), light, coefficients[2], lamp, np.sum(rest * rest), misfit
