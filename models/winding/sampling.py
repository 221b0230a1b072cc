"""What both modes report in the same way: sample times, means over windows, means of the layers."""

import math

import numpy as np
from numpy.typing import NDArray

from models.winding.scene import WindingScene

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SAMPLE_INTERVAL = 1e-3
"""[s]."""
SHOWN_LAYERS = (1, 3, 5, 7, 9)
"""Layers after which a snapshot is taken, as in the paper's Fig. 9."""


def sample_times(scene: WindingScene) -> Array:
    """Ends of the sample windows [s], shape (m,)."""
    count = math.floor(scene.duration / SAMPLE_INTERVAL + 1e-9)
    return SAMPLE_INTERVAL * np.arange(1, count + 1, dtype=np.float64)


def window_means(time: Array, value: Array, ends: Array) -> Array:
    """Means of `value`, linear between its points at `time`, over the windows that end at `ends`; shape of `ends`."""
    area = np.concatenate([[0.0], np.cumsum(np.diff(time) * (value[1:] + value[:-1]) / 2)])
    grid = np.concatenate([[ends[0] - SAMPLE_INTERVAL], ends])
    # The integral of a piecewise linear function, evaluated exactly between its points.
    index = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, len(time) - 2)
    part = grid - time[index]
    slope = (value[index + 1] - value[index]) / (time[index + 1] - time[index])
    integral = area[index] + part * (value[index] + slope * part / 2)
    return np.asarray(np.diff(integral) / np.diff(grid), dtype=np.float64)


def layer_means(layer: Integers, relative_tension: Array, complete: int) -> Array:
    """Mean of `relative_tension`, shape (n,), over the nodes of each complete layer, shape (complete,)."""
    return np.array([relative_tension[layer == k].mean() for k in range(1, complete + 1)])
