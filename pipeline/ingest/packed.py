"""Pixels packed without gaps, most significant bits first: 4 of 10 bits in 5 bytes, 2 of 12 bits in 3 bytes.

OpenCV takes the bytes apart and puts the pixels together, because numpy is several times slower on strided arrays.
"""

import cv2
import numpy as np
from numpy.typing import NDArray


def unpack_10(packed: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Pixels of 10 bits: shape (5n,) to (4n,)."""
    a, b, c, d, e = (part.astype(np.uint16) for part in cv2.split(packed.reshape(1, -1, 5)))
    return _joined(a << 2 | b >> 6, (b & 63) << 4 | c >> 4, (c & 15) << 6 | d >> 2, (d & 3) << 8 | e)


def unpack_12(packed: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Pixels of 12 bits: shape (3n,) to (2n,)."""
    a, b, c = (part.astype(np.uint16) for part in cv2.split(packed.reshape(1, -1, 3)))
    return _joined(a << 4 | b >> 4, (b & 15) << 8 | c)


def _joined(*parts: NDArray[np.integer]) -> NDArray[np.uint16]:
    """Interleave 16-bit arrays of shape (1, n)."""
    return cv2.merge(parts).astype(np.uint16, copy=False).reshape(-1)
