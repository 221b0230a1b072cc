"""Arithmetic for derivatives by a complex step (Squire and Trapp, SIAM Review 40 (1998) 110). Knows no yarn.

A number that carries COMPLEX_STEP times a derivative in its imaginary part has an imaginary part so small that terms of
second order vanish in double precision. So sine, root and reciprocal need only real functions of the real part; the
complex ones take several times as long. Compiled code picks the real or the complex form by type.
"""

from typing import Any

import numpy as np

from models.compiled import implement_complex

COMPLEX_STEP = 1e-40


def sine_cosine(x: Any) -> tuple[Any, Any]:
    """Sin x and cos x."""
    return np.sin(x), np.cos(x)


def square_root(x: Any) -> Any:
    """√x for a positive real part."""
    return np.sqrt(x)


def reciprocal(x: Any) -> Any:
    """1/x."""
    return 1 / x


def _sine_cosine(x: Any) -> tuple[Any, Any]:
    sine, cosine = np.sin(x.real), np.cos(x.real)
    return complex(sine, cosine * x.imag), complex(cosine, -sine * x.imag)


def _square_root(x: Any) -> Any:
    root = np.sqrt(x.real)
    return complex(root, 0.5 * x.imag / root)


def _reciprocal(x: Any) -> Any:
    inverse = 1 / x.real
    return complex(inverse, -x.imag * inverse * inverse)


implement_complex(sine_cosine, _sine_cosine)
implement_complex(square_root, _square_root)
implement_complex(reciprocal, _reciprocal)
