"""Winding scenes that several tests run."""

import math
from typing import Any

from models.winding.scene import WindingScene


def winding_scene(**changes: Any) -> WindingScene:
    """131.2 tex at 6 m/s (1000 r/min), T₀ = 50 cN, short, with changes."""
    tex = 131.2
    diameter, axial = 0.037e-3 * math.sqrt(tex), 2.4 * tex
    base: dict[str, Any] = {
        "linear_density": tex * 1e-6,
        "diameter": diameter,
        "axial_stiffness": axial,
        "bending_stiffness": axial * diameter**2 / 16,
        "speed": 6.0,
        "tension": 0.5,
        "duration": 0.02,
    }
    return WindingScene(**(base | changes))
