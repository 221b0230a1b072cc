"""Motion of the machine: travel of the yarn's speed over time, and the guide's traverse over its cycle."""

import math

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, inner

Array = NDArray[np.float64]


def travel(time: float, speed: float, rise: float, slope: float) -> tuple[float, float]:
    """Distance [m] and speed [m/s] at `time`: a half-cosine start of duration `rise` [s], then V + slope (t − rise)."""
    if time < rise:
        angle = math.pi * time / rise
        return speed * (time - rise / math.pi * math.sin(angle)) / 2, speed * (1 - math.cos(angle)) / 2
    run = time - rise
    return speed * (rise / 2 + run) + slope * run * run / 2, speed + slope * run


def traverse(phase: float, reversal: float) -> tuple[float, float]:
    """Guide position over the stroke, −½ to ½, and its slope per cycle, at `phase` [cycles], −½ at whole phases.

    Constant speed but for the reversals, each of which takes the share `reversal` of the cycle at constant
    acceleration.
    """
    p = phase - math.floor(phase)
    back = p > 0.5
    if back:
        p = 1 - p
    steep = 2 / (1 - reversal)
    half = reversal / 2
    if p < half:
        z, slope = -0.5 + steep * p * p / reversal, 2 * steep * p / reversal
    elif p > 0.5 - half:
        q = 0.5 - p
        z, slope = 0.5 - steep * q * q / reversal, 2 * steep * q / reversal
    else:
        z, slope = -0.5 + steep * (p - half / 2), steep
    return z, -slope if back else slope


_travel = inner(travel)
_traverse = inner(traverse)


@compiled
def travels(time: Array, speed: float, rise: float, slope: float) -> Array:
    """Distances [m] of `travel` at the times [s], shape (n,)."""
    found = np.empty(time.size)
    for i in range(time.size):
        found[i] = _travel(time[i], speed, rise, slope)[0]
    return found


@compiled
def traverses(phase: Array, reversal: float) -> Array:
    """Positions of `traverse` at the phases [cycles], shape (n,)."""
    found = np.empty(phase.size)
    for i in range(phase.size):
        found[i] = _traverse(phase[i], reversal)[0]
    return found
