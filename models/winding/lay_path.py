"""Path of the yarn on the bobbin, and where it crosses itself; both are known before anything is laid."""

import math

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, inner
from models.winding.drive import traverse

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_traverse = inner(traverse)


@compiled
def lay_path(
    n: int,
    angle_step: float,
    bobbin_radius: float,
    taper: float,
    guide_distance: float,
    pull: float,
    clearance: float,
    stroke: float,
    turns_per_cycle: float,
    reversal: float,
) -> tuple[Array, Array]:
    """Axial position [m] of n nodes at equal steps of the bobbin's angle, and of the yarn in the eye, shape (n,) each.

    `pull` is guide distance over feed length: how much the straight yarn upstream draws the yarn in the eye to z = 0.
    """
    z, eye = np.empty(n), np.empty(n)
    place = stroke * _traverse(0.0, reversal)[0]
    for k in range(n):
        guide = stroke * _traverse(k * angle_step / (2 * math.pi * turns_per_cycle), reversal)[0]
        free = place / (1 + pull)
        eye[k] = min(max(free, guide - clearance), guide + clearance)
        z[k] = place
        step = (bobbin_radius + taper * place) * angle_step / guide_distance
        place += (eye[k] - place) * (1 - math.exp(-step))
    return z, eye


@compiled
def find_crossings(z: Array, arc: Array, per_turn: float, cell: float) -> tuple[Integers, Integers, Array, Array]:
    """Crossings of the path with itself on the unrolled bobbin: lower and upper element, and the places on them.

    `arc` is the position along the circumference in units of node steps, `per_turn` their number per turn; z is scaled
    by the same step. Elements are searched in cells of side `cell` steps.
    """
    n = z.shape[0] - 1
    columns = max(int(per_turn / cell), 3)
    width = per_turn / columns
    lowest = z.min()
    rows = int((z.max() - lowest) / cell) + 1
    head = np.full(columns * rows, -1)
    following = np.full(n, -1)
    low, high = [0][:0], [0][:0]
    low_at, high_at = [0.0][:0], [0.0][:0]
    for k in range(n):
        middle = (arc[k] + 0.5) % per_turn
        column = min(int(middle / width), columns - 1)
        row = int(((z[k] + z[k + 1]) / 2 - lowest) / cell)
        for dc in range(-1, 2):
            for dr in range(-1, 2):
                if row + dr < 0 or row + dr >= rows:
                    continue
                i = int(head[((column + dc) % columns) * rows + row + dr])
                while i >= 0:
                    offset = arc[i] - arc[k]
                    offset -= per_turn * math.floor(offset / per_turn + 0.5)
                    # element k: (t, z_k + t dz_k); element i: (offset + s, z_i + s dz_i), both of unit length in arc
                    slope_k, slope_i = z[k + 1] - z[k], z[i + 1] - z[i]
                    if slope_k != slope_i and k - i > 8:
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
