"""Friction of a yarn on the moving cylinder surface: its direction, shared by every model.

The surface slides under the yarn with a component across it, v_b sinθ + 2πR₀(n₁ − n₀) (the cylinder's motion and
the yarn's own spin), and one along it, v_b cosθ + v. Paper, Eq. 8; lengths in r₀, speeds in v.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.compiled import inner, merged
from models.complex_step import reciprocal, square_root
from models.scene import CYLINDER_SPEED, SPAN_RATIO, TWIST_CD, TWIST_CONGESTION, TWIST_TRAPPING, YARN_RADIUS

Values = NDArray[Any]


@merged
def friction_direction(scene: Values, sine: Any, cosine: Any, w: Any) -> tuple[Any, Any]:
    """The friction angle as cos α and sin α, analytic in all arguments.

    Parameters
    ----------
    scene : the numbers of `Dimensionless.vector`.
    sine, cosine : of the yarn's angle θ to the cylinder axis.
    w : n₁/v, rotation of the yarn by the cylinder; n₀/v = T_CD.
    """
    across = scene[CYLINDER_SPEED] * sine + 2 * np.pi * scene[YARN_RADIUS] * (w - scene[TWIST_CD])
    along = scene[CYLINDER_SPEED] * cosine + 1.0
    inverse = reciprocal(square_root(across * across + along * along))
    return across * inverse, along * inverse


@inner
def friction_slopes(scene: Values, sine: float, cosine: float, w: float) -> tuple[float, float, float, float]:
    """Cos α and sin α, and α's derivatives by q = ln tan(θ/2) and by w; real arguments."""
    speed, spin = scene[CYLINDER_SPEED], 2 * np.pi * scene[YARN_RADIUS]
    across = speed * sine + spin * (w - scene[TWIST_CD])
    along = speed * cosine + 1.0
    slip2 = across * across + along * along
    inverse = 1 / np.sqrt(slip2)
    # d sinθ/dq = sinθ cosθ and d cosθ/dq = −sin²θ in α = atan2(along, across).
    by_q = -speed * sine * (across * sine + along * cosine) / slip2
    return across * inverse, along * inverse, by_q, -along * spin / slip2


@inner
def angles_at_ends(t: Any, ratio: Any) -> tuple[Any, Any]:
    """Cosθ_B and cosθ_C by the geometry of the spans, where tanh(q_C − q_B) = t for q = ln tan(θ/2); analytic.

    With cosθ = −tanh q it is l cosθ_B + cosθ_C = 0, l = l_AB/l_CD = `ratio`, a quadratic in cosθ_C:
    t cos²θ_C + (1 + l) cosθ_C + l t = 0. Both rise or fall with t.
    """
    cosine_C = -2 * ratio * t / ((1 + ratio) + np.sqrt((1 + ratio) * (1 + ratio) - 4 * ratio * t * t))
    return (cosine_C + t) / (1 + cosine_C * t), cosine_C


@inner
def end_conditions(scene: Values, ends: tuple[Any, ...], tau_B: Any, tau_C: Any, w: Any, out: Values) -> None:
    """Three boundary conditions that all models share (paper, Eqs 15, 16 and 19): out[0], out[2] and out[3].

    The spans' geometry l_AB cosθ_B + l_CD cosθ_C = 0, T(φ) = T_CD, and n₁ = (T_AB − k T_CD) η v.

    Parameters
    ----------
    ends : sinθ and cosθ at B, then at C.
    tau_B, tau_C : τ = 2πT + sinθ cosθ at the ends.
    """
    sine_B, cosine_B, sine_C, cosine_C = ends
    twist_AB = (tau_B - sine_B * cosine_B) / (2 * np.pi)
    out[0] = scene[SPAN_RATIO] * cosine_B + cosine_C
    out[2] = tau_C - sine_C * cosine_C - 2 * np.pi * scene[TWIST_CD]
    out[3] = w - scene[TWIST_CONGESTION] * (twist_AB - scene[TWIST_TRAPPING] * scene[TWIST_CD])
