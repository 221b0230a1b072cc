"""Pixels packed without gaps, most significant bits first: 4 of 10 bits in 5 bytes, 2 of 12 bits in 3 bytes."""

import numpy as np
from numpy.typing import NDArray


def unpack_10(packed: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Pixels of 10 bits: shape (5n,) to (4n,)."""
    a, b, c, d, e = packed.reshape(-1, 5).T.astype(np.uint16)
    pixels = np.empty((len(a), 4), np.uint16)
    pixels[:, 0] = a << 2 | b >> 6
    pixels[:, 1] = (b & 63) << 4 | c >> 4
    pixels[:, 2] = (c & 15) << 6 | d >> 2
    pixels[:, 3] = (d & 3) << 8 | e
    return pixels.reshape(-1)


def unpack_12(packed: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Pixels of 12 bits: shape (3n,) to (2n,)."""
    a, b, c = packed.reshape(-1, 3).T.astype(np.uint16)
    pixels = np.empty((len(a), 2), np.uint16)
    pixels[:, 0] = a << 4 | b >> 4
    pixels[:, 1] = (b & 15) << 8 | c
    return pixels.reshape(-1)
