"""Pixels packed without gaps, most significant bits first: 4 of 10 bits in 5 bytes, 2 of 12 bits in 3 bytes.

Compiled: numpy needs a pass over memory for every shift, which takes several times as long.
"""

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled


@compiled
def unpack_10(packed: NDArray[np.uint8], levels: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Pixels of 10 bits, each replaced by its level: shape (5n,) to (4n,).

    Parameters
    ----------
    packed : the bytes.
    levels : the level of each code, shape (1024,).
    """
    groups = packed.size // 5
    pixels = np.empty(4 * groups, np.uint16)
    for i in range(groups):
        a, b, c, d, e = packed[5 * i], packed[5 * i + 1], packed[5 * i + 2], packed[5 * i + 3], packed[5 * i + 4]
        pixels[4 * i] = levels[a << 2 | b >> 6]
        pixels[4 * i + 1] = levels[(b & 63) << 4 | c >> 4]
        pixels[4 * i + 2] = levels[(c & 15) << 6 | d >> 2]
        pixels[4 * i + 3] = levels[(d & 3) << 8 | e]
    return pixels


@compiled
def unpack_12(packed: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Pixels of 12 bits: shape (3n,) to (2n,)."""
    groups = packed.size // 3
    pixels = np.empty(2 * groups, np.uint16)
    for i in range(groups):
        a, b, c = np.uint16(packed[3 * i]), np.uint16(packed[3 * i + 1]), np.uint16(packed[3 * i + 2])
        pixels[2 * i] = a << 4 | b >> 4
        pixels[2 * i + 1] = (b & 15) << 8 | c
    return pixels
