"""Where the path of the yarn on the bobbin crosses itself, known before anything is laid."""

import math

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

FLATTEST = 0.02
"""Least height of the cells in which elements are searched [steps]."""
CELLS = 16
"""Most cells per element."""
NEIGHBOURS = 8
"""Elements this close by number do not cross."""


@compiled
def find_crossings(z: Array, per_turn: float) -> tuple[Integers, Integers, Array, Array]:
    """Crossings of the path with itself on the unrolled bobbin.

    Parameters
    ----------
    z : along the axis, in steps of the nodes along the circumference, shape (n,).
    per_turn : steps per turn.

    Returns
    -------
    Element below and element above, ordered by the latter, and the places of the crossing on them, 0 to 1.
    """
    n = z.shape[0] - 1
    # Cells as long and as high as an element may be, and larger where most of them would be empty.
    columns = max(min(int(per_turn), n), 3)
    width, height = per_turn / columns, FLATTEST
    lowest, highest = z[0], z[0]
    for k in range(n):
        height = max(height, abs(z[k + 1] - z[k]))
        lowest, highest = min(lowest, z[k + 1]), max(highest, z[k + 1])
    height = max(height, (highest - lowest) * columns / (CELLS * n))
    rows = int((highest - lowest) / height) + 1
    head = np.full(columns * rows, -1)
    following = np.full(n, -1)
    low, high = [0][:0], [0][:0]
    low_at, high_at = [0.0][:0], [0.0][:0]
    for k in range(n):
        column = min(int((k + 0.5) % per_turn / width), columns - 1)
        row = int(((z[k] + z[k + 1]) / 2 - lowest) / height)
        for dc in range(-1, 2):
            for dr in range(-1, 2):
                if row + dr < 0 or row + dr >= rows:
                    continue
                i = int(head[((column + dc) % columns) * rows + row + dr])
                while i >= 0:
                    offset = i - k + 0.0
                    offset -= per_turn * math.floor(offset / per_turn + 0.5)
                    # element k: (t, z_k + t dz_k); element i: (offset + s, z_i + s dz_i), both one step long
                    slope_k, slope_i = z[k + 1] - z[k], z[i + 1] - z[i]
                    if slope_k != slope_i and k - i > NEIGHBOURS:
                        t = (z[i] - z[k] - offset * slope_i) / (slope_k - slope_i)
                        s = t - offset
                        if 0 <= t < 1 and 0 <= s < 1:
                            low.append(i)
                            high.append(k)
                            low_at.append(s)
                            high_at.append(t)
                    i = int(following[i])
        place = column * rows + row
        following[k] = head[place]
        head[place] = k
    return np.array(low), np.array(high), np.array(low_at), np.array(high_at)
