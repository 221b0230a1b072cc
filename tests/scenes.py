"""Scenes that several tests solve."""

import math

from models.scene import Scene


def scene(**changes: float) -> Scene:
    """The base scene of the paper's section 3 (r₀ = K = v = 1), with changes."""
    base: dict[str, float] = {
        "wrap_angle": math.radians(60),
        "cylinder_radius": 1.0,
        "yarn_radius": 0.03,
        "friction": 0.8,
        "twist_CD": 1.0,
        "tension_CD": 600.0,
        "torsional_rigidity": 1.0,
        "delivery_speed": 1.0,
        "cylinder_speed_ratio": 1.0,
    }
    return Scene(**(base | changes))


def table_1(case: int) -> Scene:
    """Case 1, 2 or 3 of Table 1 (Yin, Tao, Jasper 2020)."""
    twist, tension, rigidity, speed = {
        1: (902, 16.53, 4.87e-9, 0.16),
        2: (563, 14.20, 2.51e-9, 0.25),
        3: (562, 19.82, 2.73e-9, 0.25),
    }[case]
    return Scene(
        wrap_angle=math.radians(50),
        cylinder_radius=3e-3,
        yarn_radius=0.08e-3,
        friction=0.81,
        twist_CD=twist,
        tension_CD=tension / 100,
        torsional_rigidity=rigidity,
        delivery_speed=speed,
        cylinder_speed_ratio=2,
    )
