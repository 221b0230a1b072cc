"""Arithmetic for derivatives by a complex step (Squire and Trapp, SIAM Review 40 (1998) 110). Knows no yarn.

A number that carries COMPLEX_STEP times a derivative in its imaginary part has an imaginary part so small that terms of
second order vanish in double precision. So sine, exponential, root and reciprocal need only real functions of the real
part; the complex ones take several times as long. Compiled code picks the real or the complex form by type.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.compiled import implement_complex, inner, merged

COMPLEX_STEP = 1e-40
VECTOR = 4
"""Numbers of double precision that a vector instruction takes."""


def sine_cosine(x: Any) -> tuple[Any, Any]:
    """Sin x and cos x."""
    return np.sin(x), np.cos(x)


def exponential(x: Any) -> Any:
    """The exponential of x."""
    return np.exp(x)


def square_root(x: Any) -> Any:
    """√x for a positive real part."""
    return np.sqrt(x)


def reciprocal(x: Any) -> Any:
    """1/x."""
    return 1 / x


def _sine_cosine(x: Any) -> tuple[Any, Any]:
    sine, cosine = np.sin(x.real), np.cos(x.real)
    return complex(sine, cosine * x.imag), complex(cosine, -sine * x.imag)


def _exponential(x: Any) -> Any:
    power = np.exp(x.real)
    return complex(power, power * x.imag)


def _square_root(x: Any) -> Any:
    root = np.sqrt(x.real)
    return complex(root, 0.5 * x.imag / root)


def _reciprocal(x: Any) -> Any:
    inverse = 1 / x.real
    return complex(inverse, -x.imag * inverse * inverse)


implement_complex(sine_cosine, _sine_cosine)
implement_complex(exponential, _exponential)
implement_complex(square_root, _square_root)
implement_complex(reciprocal, _reciprocal)


@inner
def unit_directions(count: int) -> NDArray[np.float64]:
    """COMPLEX_STEP along each of `count` arguments, shape (count, a): a is count or more, a multiple of VECTOR."""
    directions = np.zeros((count, -(-count // VECTOR) * VECTOR))
    for k in range(count):
        directions[k, k] = COMPLEX_STEP
    return directions


# Functions for a number of values that is known when they are compiled: such tuples are local variables, where arrays
# would hide from the compiler what depends on what.


Array = NDArray[np.float64]


@cache
def as_tuple(count: int) -> Callable[..., tuple[float, ...]]:
    """Compiled function (values, first) → `count` ≥ 1 of the values from place `first` on, as a tuple."""
    if count == 1:

        def one(values: Array, first: int) -> tuple[float, ...]:
            return (values[first],)

        return merged(one)
    half = count // 2
    front, back = as_tuple(half), as_tuple(count - half)

    def several(values: Array, first: int) -> tuple[float, ...]:
        return (*front(values, first), *back(values, first + half))

    return merged(several)


@cache
def in_direction(count: int) -> Callable[..., tuple[complex, ...]]:
    """Compiled function (values, directions, first, a) → the `count` ≥ 1 values with derivatives.

    The derivatives are in column a of the directions, from row `first` on.
    """
    if count == 1:

        def one(values: tuple[float, ...], directions: Array, first: int, a: int) -> tuple[complex, ...]:
            return (complex(values[0], directions[first, a]),)

        return merged(one)
    half = count // 2
    front, back = in_direction(half), in_direction(count - half)

    def several(values: tuple[float, ...], directions: Array, first: int, a: int) -> tuple[complex, ...]:
        return (*front(values[:half], directions, first, a), *back(values[half:], directions, first + half, a))

    return merged(several)
