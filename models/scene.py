"""The false-twist scene: a twisted yarn dragged over a moving cylinder, in SI and dimensionless form.

The yarn runs A (rollers) → B (contact starts, ψ = 0) → C (contact ends, ψ = φ) → D (guide) over a cylinder of
radius r₀ whose surface moves along its own axis e_z. Source: Yin, Tao, Jasper, Cellulose 2020, section 2.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

POSITIVE = (
    "wrap_angle", "cylinder_radius", "yarn_radius", "tension_CD", "torsional_rigidity", "delivery_speed", "span_ratio",
    "rigidity_ratio",
)  # fmt: skip
"""Fields of `Scene` that must be greater than 0."""
LARGEST_WRAP_ANGLE = 2 * math.pi


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """One steady-state scene in SI units. Twist is signed, Z > 0, and counted in turns per metre.

    Raises
    ------
    ValueError
        If a value is not finite or outside the range in which the scene has a meaning; the message names the
        field, the value and the range.
    """

    wrap_angle: float
    """φ, contact angle on the cylinder [rad], 0 < φ ≤ 2π."""
    cylinder_radius: float
    """r₀ [m]."""
    yarn_radius: float
    """R₀ [m]."""
    friction: float
    """μ, yarn on cylinder, ≥ 0."""
    twist_CD: float
    """T_CD, inserted twist in the span CD [1/m]."""
    tension_CD: float
    """p₃CD, yarn tension in the span CD [N]."""
    torsional_rigidity: float
    """K [N m²]."""
    delivery_speed: float
    """v [m/s]."""
    cylinder_speed_ratio: float
    """v_b / v, signed."""
    twist_trapping: float = 1.0
    """k, propagation coefficient of twist trapping."""
    twist_congestion: float = 1.0
    """η, propagation coefficient of twist congestion."""
    span_ratio: float = 1.0
    """l_AB / l_CD."""
    rigidity_ratio: float = 1.3
    """B / K, bending over torsional rigidity."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value):
                raise ValueError(f"{field.name} = {value}: must be a finite number")
        for name in POSITIVE:
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} = {getattr(self, name)}: must be greater than 0")
        if self.wrap_angle > LARGEST_WRAP_ANGLE:
            raise ValueError(f"wrap_angle = {self.wrap_angle}: must be at most one full turn, 2π rad (360°)")
        if self.friction < 0:
            raise ValueError(f"friction = {self.friction}: must be 0 or greater")

    @property
    def force_unit(self) -> float:
        """K / r₀² [N], the force that dimensionless forces are multiples of."""
        return self.torsional_rigidity / self.cylinder_radius**2

    @property
    def twist_unit(self) -> float:
        """1 / (2πr₀) [1/m], one turn per circumference: the smallest twist that relative errors refer to."""
        return 1 / (2 * math.pi * self.cylinder_radius)

    @property
    def moment_unit(self) -> float:
        """K / r₀ [N m], the moment that dimensionless moments are multiples of."""
        return self.torsional_rigidity / self.cylinder_radius

    def dimensionless(self) -> "Dimensionless":
        """Normalise lengths by r₀, forces by K/r₀², moments by K/r₀ and speeds by v (paper, Eq. 17)."""
        return Dimensionless(**normalised(self))


def valid_rows(values: Mapping[str, NDArray[np.float64]]) -> NDArray[np.bool_]:
    """Which rows `Scene` accepts, from an array of shape (n,) for each of its fields."""
    valid = np.logical_and.reduce([np.isfinite(column) for column in values.values()])
    valid &= np.logical_and.reduce([values[name] > 0 for name in POSITIVE])
    return valid & (values["wrap_angle"] <= LARGEST_WRAP_ANGLE) & (values["friction"] >= 0)


def normalised(scene: Any) -> dict[str, Any]:
    """The fields of `Dimensionless` from an object with the fields of `Scene`, real or complex."""
    radius = scene.cylinder_radius
    return {
        "wrap_angle": scene.wrap_angle,
        "tension_CD": scene.tension_CD * radius**2 / scene.torsional_rigidity,
        "twist_CD": scene.twist_CD * radius,
        "yarn_radius": scene.yarn_radius / radius,
        "friction": scene.friction,
        "cylinder_speed": scene.cylinder_speed_ratio,
        "twist_trapping": scene.twist_trapping,
        "twist_congestion": scene.twist_congestion,
        "span_ratio": scene.span_ratio,
        "bending_rigidity": scene.rigidity_ratio,
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Dimensionless:
    """The same scene with r₀ = K = v = 1. Only these ten numbers decide the shape of the solution."""

    wrap_angle: float
    tension_CD: float
    twist_CD: float
    yarn_radius: float
    friction: float
    cylinder_speed: float
    twist_trapping: float = 1.0
    twist_congestion: float = 1.0
    span_ratio: float = 1.0
    bending_rigidity: float = 1.3

    @property
    def vector(self) -> NDArray[np.float64]:
        """The ten numbers in the order of the fields, as compiled functions take them (indices below)."""
        return np.array(
            [
                self.wrap_angle,
                self.tension_CD,
                self.twist_CD,
                self.yarn_radius,
                self.friction,
                self.cylinder_speed,
                self.twist_trapping,
                self.twist_congestion,
                self.span_ratio,
                self.bending_rigidity,
            ]
        )

    def twist_rotation(self, twist_AB: float) -> float:
        """Rotation of the yarn by the cylinder, n₁ / v = η (T_AB − k T_CD) (paper, Eq. 16)."""
        return self.twist_congestion * (twist_AB - self.twist_trapping * self.twist_CD)


(
    WRAP_ANGLE,
    TENSION_CD,
    TWIST_CD,
    YARN_RADIUS,
    FRICTION,
    CYLINDER_SPEED,
    TWIST_TRAPPING,
    TWIST_CONGESTION,
    SPAN_RATIO,
    BENDING_RIGIDITY,
) = range(10)
"""Places in `Dimensionless.vector`."""
