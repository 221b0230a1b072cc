"""Straight edges across a whole frame, in every direction.

The gradient of the smoothed, reduced frame is projected on each direction and averaged along lines (a Radon transform
of the directional derivative): a straight edge is a peak, positive where the frame gets brighter to the line's right.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.records import Array

REDUCED = 240
"""Longer side of the reduced frame [px]."""
SMOOTHING = 1.5
"""Standard deviation of the smoothing [reduced px]."""
WEAKEST = 0.25
"""Least strength of an edge over that of the strongest one in the frame."""

Image = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class EdgeLines:
    """Mean gradient across each line of a frame; places are reduced pixels to the right of the frame's centre."""

    angles: Array
    """Directions of the lines [rad], shape (n,)."""
    lines: Array
    """Shape (n, 2 half + 1), 0 where a line only cuts a corner."""
    half: int
    shrink: float
    """Reduced pixels per pixel."""

    def peaks(self, i: int) -> NDArray[np.intp]:
        """Indices of the edges in direction i that are not weak."""
        strength = np.abs(self.lines[i])
        limit = WEAKEST * float(np.abs(self.lines).max())
        high = (strength[1:-1] >= limit) & (strength[1:-1] >= np.maximum(strength[:-2], strength[2:]))
        return np.flatnonzero(high & (strength[1:-1] > 0)) + 1


def edge_lines(image: Image, directions: int) -> EdgeLines:
    """Find the edges of a frame, shape (rows, columns), in this many directions over half a turn."""
    shrink = min(1.0, REDUCED / max(image.shape))
    small = cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), SMOOTHING, borderType=cv2.BORDER_REPLICATE)
    down, right = np.gradient(small)
    y, x = np.indices(small.shape)
    y, x = y - (small.shape[0] - 1) / 2, x - (small.shape[1] - 1) / 2
    half = math.ceil(math.hypot(*small.shape) / 2)
    angles = np.arange(directions, dtype=np.float64) * (math.pi / directions)
    lines = np.zeros((directions, 2 * half + 1))
    for i, angle in enumerate(angles):
        c, s = math.cos(angle), math.sin(angle)
        place = np.round(x * s + y * c).astype(int).ravel() + half
        count = np.bincount(place, minlength=2 * half + 1)
        total = np.bincount(place, (right * s + down * c).ravel(), minlength=2 * half + 1)
        lines[i] = np.where(count >= 0.5 * min(small.shape), total / np.maximum(count, 1), 0.0)
    return EdgeLines(angles, lines, half, shrink)


WIDEST = 0.3
"""Largest width of a band over the frame's shorter side."""
BAND_DIRECTIONS = 90


def bands(image: Image, count: int) -> list[tuple[float, float, float, float]]:
    """Return the bands with the strongest two edges: a point (x, y), the angle and half the width [px].

    Parameters
    ----------
    image : shape (rows, columns).
    count : how many at most; none lies within another's width and 10° of its direction.
    """
    edges = edge_lines(image, BAND_DIRECTIONS)
    widest = WIDEST * min(image.shape) * edges.shrink
    found: list[tuple[float, float, float, float]] = []
    for i, angle in enumerate(edges.angles.tolist()):
        line, peaks = edges.lines[i], edges.peaks(i)
        for k, low in enumerate(peaks[:-1].tolist()):
            for high in peaks[k + 1 :].tolist():
                if high - low > widest:
                    break
                if line[low] * line[high] < 0:
                    strength = min(abs(line[low]), abs(line[high]))
                    found.append((strength, angle, (low + high) / 2 - edges.half, (high - low) / 2))
    chosen: list[tuple[float, float, float, float]] = []
    for _, angle, place, radius in sorted(found, reverse=True):
        if len(chosen) == count:
            break
        apart = [
            abs(math.remainder(angle - other[1], math.pi)) > math.radians(10) or abs(place - other[2]) > 2 * radius
            for other in chosen
        ]
        if all(apart):
            chosen.append((0.0, angle, place, radius))
    x, y = (image.shape[1] - 1) / 2, (image.shape[0] - 1) / 2
    return [
        (
            x + place / edges.shrink * math.sin(angle),
            y + place / edges.shrink * math.cos(angle),
            angle,
            radius / edges.shrink,
        )
        for _, angle, place, radius in chosen
    ]
