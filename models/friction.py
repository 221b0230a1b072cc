"""Friction of a yarn on the moving cylinder surface: its direction, shared by every model.

The surface slides under the yarn with a component across it, v_b sinθ + 2πR₀(n₁ − n₀) (the cylinder's motion and
the yarn's own spin), and one along it, v_b cosθ + v. Paper, Eq. 8; lengths in r₀, speeds in v.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.scene import Dimensionless

Values = NDArray[Any]


def friction_direction(scene: Dimensionless, sin_theta: Values, cos_theta: Values, w: Values) -> tuple[Values, Values]:
    """Cos α and sin α of the friction angle, analytic in all arguments.

    Parameters
    ----------
    sin_theta, cos_theta : of the yarn's angle to the cylinder axis.
    w : n₁/v, rotation of the yarn by the cylinder; n₀/v = T_CD.
    """
    across = scene.cylinder_speed * sin_theta + 2 * np.pi * scene.yarn_radius * (w - scene.twist_CD)
    along = scene.cylinder_speed * cos_theta + 1.0
    slip = np.sqrt(across * across + along * along)
    return across / slip, along / slip
