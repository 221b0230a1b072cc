"""Ways to replace a function on [0, length] by its values at nodes. Knows no yarn.

A discretisation maps n + 1 nodal values to values and derivatives at n collocation points, so that a first-order
equation plus one boundary condition is a square system (rectangular collocation: Driscoll and Hale, IMA J. Numer.
Anal. 36 (2016) 108). Both kinds here share that shape, and the same Newton assembly serves them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from models.compiled import inner

Array = NDArray[np.float64]

HIGHEST_DERIVATIVE = 3


@dataclass(frozen=True, slots=True)
class Discretisation:
    """Nodes and the matrices that evaluate derivatives at the collocation points."""

    nodes: Array
    """Ascending, first 0, last `length`, shape (n + 1,)."""
    points: Array
    """Collocation points, shape (n,)."""
    derivatives: Array
    """derivatives[k] @ nodal values = k-th derivative at the points, shape (4, n, n + 1)."""
    nodal_derivatives: Array
    """The same at the nodes, shape (4, n + 1, n + 1)."""


@lru_cache(maxsize=64)
def chebyshev_reference(degree: int) -> tuple[Array, Array, Array, Array]:
    """Nodes, points and matrices on [−1, 1]."""
    nodes = -np.cos(np.pi * np.arange(degree + 1) / degree)
    points = -np.cos(np.pi * (np.arange(degree) + 0.5) / degree)
    # Values → Chebyshev coefficients, then coefficients → derivatives: well conditioned on Chebyshev points.
    to_coefficients = np.linalg.inv(chebyshev.chebvander(nodes, degree))
    at_points = np.empty((HIGHEST_DERIVATIVE + 1, degree, degree + 1))
    at_nodes = np.empty((HIGHEST_DERIVATIVE + 1, degree + 1, degree + 1))
    coefficients = to_coefficients
    for order in range(HIGHEST_DERIVATIVE + 1):
        if order:
            coefficients = chebyshev.chebder(coefficients)
        at_points[order] = chebyshev.chebvander(points, coefficients.shape[0] - 1) @ coefficients
        at_nodes[order] = chebyshev.chebvander(nodes, coefficients.shape[0] - 1) @ coefficients
    return nodes, points, at_points, at_nodes


def chebyshev_collocation(degree: int, length: float) -> Discretisation:
    """One polynomial of the given degree (≥ 4) on [0, length]: Lobatto nodes, Gauss collocation points."""
    nodes, points, at_points, at_nodes = chebyshev_reference(degree)
    scale = (2.0 / length) ** np.arange(HIGHEST_DERIVATIVE + 1)[:, None, None]
    return Discretisation((nodes + 1) * length / 2, (points + 1) * length / 2, at_points * scale, at_nodes * scale)


@lru_cache(maxsize=64)
def chebyshev_integration(degree: int) -> Array:
    """Matrix S on [−1, 1]: (S @ values at the Lobatto nodes)[i] is the integral from node i to 1."""
    nodes = chebyshev_reference(degree)[0]
    to_integrals = chebyshev.chebint(np.linalg.inv(chebyshev.chebvander(nodes, degree)))
    at_end, at_nodes = chebyshev.chebvander(np.ones(1), degree + 1), chebyshev.chebvander(nodes, degree + 1)
    return np.ascontiguousarray((at_end - at_nodes) @ to_integrals, dtype=np.float64)


class Integrals(NamedTuple):
    """What a search over degrees takes; in one array, because numba takes a second to compile a tuple of arrays."""

    degrees: NDArray[np.int64]
    matrices: Array
    """`chebyshev_integration` of each degree, one after another, flat."""


class Derivatives(NamedTuple):
    """The same for derivatives on [−1, 1]."""

    degrees: NDArray[np.int64]
    at_points: Array
    """At the collocation points, shape (4, n, n + 1) of each degree n, one after another, flat."""
    at_nodes: Array
    """At the nodes, (4, n + 1, n + 1)."""


@cache
def integrals(degrees: tuple[int, ...]) -> Integrals:
    """The integration matrices of so many degrees."""
    return Integrals(np.array(degrees), np.concatenate([chebyshev_integration(n).ravel() for n in degrees]))


@cache
def derivatives(degrees: tuple[int, ...]) -> Derivatives:
    """The matrices of derivatives of so many degrees."""
    references = [chebyshev_reference(degree) for degree in degrees]
    at_points, at_nodes = (np.concatenate([r[k].ravel() for r in references]) for k in (2, 3))
    return Derivatives(np.array(degrees), at_points, at_nodes)


@inner
def resample(values: Array, degree: int) -> Array:
    """Values at the degree + 1 Lobatto nodes of the polynomial through `values` at its own Lobatto nodes.

    By the second barycentric formula (Berrut and Trefethen, SIAM Review 46 (2004) 501, Eq. 5.4).
    """
    n = values.shape[0] - 1
    nodes, result = np.empty(n + 1), np.empty(degree + 1)
    for j in range(n + 1):
        nodes[j] = -np.cos(np.pi * j / n)
    for i in range(degree + 1):
        point = -np.cos(np.pi * i / degree)
        above, below = 0.0, 0.0
        for j in range(n + 1):
            distance = point - nodes[j]
            if abs(distance) < 1e-14:
                above, below = values[j], 1.0
                break
            weight = (0.5 if j in (0, n) else 1.0) * (1 - 2 * (j % 2)) / distance
            above += weight * values[j]
            below += weight
        result[i] = above / below
    return result


@lru_cache(maxsize=256)
def interpolation(degree: int, to: int, *, even: bool = False) -> Array:
    """Matrix from values at degree + 1 Lobatto nodes to values at to + 1 Lobatto or evenly spaced points."""
    nodes = chebyshev_reference(degree)[0]
    points = np.linspace(-1.0, 1.0, to + 1) if even else chebyshev_reference(to)[0]
    from_coefficients = chebyshev.chebvander(points, degree)
    return np.asarray(np.linalg.solve(chebyshev.chebvander(nodes, degree).T, from_coefficients.T).T, dtype=np.float64)


def polynomial(nodal: Array, length: float) -> Callable[[Array], Array]:
    """The polynomials through values at the Lobatto nodes on [0, length], shape (m, n + 1): (k,) points to (m, k)."""
    nodes = chebyshev_reference(nodal.shape[1] - 1)[0]
    coefficients = np.linalg.solve(chebyshev.chebvander(nodes, nodal.shape[1] - 1), nodal.T)
    return lambda points: np.asarray(chebyshev.chebval(2 * points / length - 1, coefficients), dtype=np.float64)


@lru_cache(maxsize=32)
def finite_differences(intervals: int, length: float, *, closed_at_start: bool = True) -> Discretisation:
    """Uniform grid, every derivative to second order at every node (intervals ≥ 5).

    Central stencils of three nodes (five for the third derivative), one-sided ones of up to five at the ends. The
    equations hold at every node but one end node: with `closed_at_start` they hold at the first and not at the last.
    Where an equation has a fast mode, the closed end must be the one where that mode is largest, as for upwinding;
    closed at the other end the matrix is as ill-conditioned as the mode is fast.
    """
    h = length / intervals
    nodes = np.linspace(0.0, length, intervals + 1)
    matrices = np.zeros((HIGHEST_DERIVATIVE + 1, intervals + 1, intervals + 1))
    matrices[0] = np.eye(intervals + 1)
    for order, central, one_sided in ((1, 3, 3), (2, 3, 4), (3, 5, 5)):
        half = central // 2
        for i in range(intervals + 1):
            if half <= i <= intervals - half:
                stencil = np.arange(i - half, i + half + 1)
            else:
                first = 0 if i < half else intervals + 1 - one_sided
                stencil = np.arange(first, first + one_sided)
            matrices[order, i, stencil] = _weights(stencil - i, order) / h**order
    rows = slice(0, intervals) if closed_at_start else slice(1, intervals + 1)
    return Discretisation(nodes, nodes[rows], np.ascontiguousarray(matrices[:, rows]), matrices)


def _weights(offsets: NDArray[np.int_], order: int) -> Array:
    """Weights of a derivative at offset 0 from values at integer offsets, exact for the polynomials they carry."""
    powers = np.arange(offsets.size)
    right = np.zeros(offsets.size)
    right[order] = math.factorial(order)
    taylor = offsets[None, :].astype(np.float64) ** powers[:, None]
    return np.asarray(np.linalg.solve(taylor, right), dtype=np.float64)
