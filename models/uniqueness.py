"""A proof, by bounds, that the flexible yarn of a scene has one solution only.

With w = n₁/v a solution is a fixed point of H(w) = η (T_AB(w) − k T_CD) (self_consistency.py). There is one only if an
interval that holds all of them has H' < 1 on it. Both are bounded here; K = μφ, b = v_b/v, l = l_AB/l_CD.

The interval. Given bounds of cosα, the turn q_C − q_B = ∫ μ cosα dψ is bounded by K times them and, through the spans'
geometry, so is θ: it rises or falls all the way from θ_B to θ_C, on different sides of 90°. Bounds of θ and w bound the
slip across, b sinθ + 2πR₀(w − T_CD), and along, b cosθ + 1, and so the direction of friction. With
m₋ ≤ sinα sinθ ≤ m₊ the tension obeys p₃/p₃CD ≤ exp(−m₋ μ(φ − ψ)), so that J = ∫ μ cosα sinθ p₃/p₃CD dψ is at most
max(cosα sinθ) W(m₋), W(m) = (1 − e^{−mK})/m, and bounded from below alike. That bounds T_AB, and so w. Each round
starts from the bounds of the last one.

The derivative. y = ∂q/∂w obeys y' = μ(κ + g y) with κ = ∂cosα/∂w = 2πR₀ sin²α/slip ≥ 0 and g = ∂cosα/∂q,
|g| ≤ |b sinα|/slip, and the geometry makes l sin²θ_B y_B = −sin²θ_C y_C. So y rises from y_B ≤ 0 to y_C ≥ 0 through one
zero, from which on either |g| or the solution cosα of the equation without κ bounds its growth:

    |y| ≤ U = κ min((e^{|g|K} − 1)/|g|, K max cosα / min cosα)
    |∂ ln p₃/∂w| ≤ μ(φ − ψ) N,   N = 2πR₀ |sinα cosα|/slip + (|b cosα|/slip + |sinα cosθ|) U
    |∂J/∂w| ≤ W(m₋) (κ + (|g| + |cosα cosθ|) U) + |cosα| N ∫₀ᴷ x e^{−m₋ x} dx

each with the largest value of every factor and the smallest slip. In 2πT_AB = 2πT_CD + sinθ_C cosθ_C − sinθ_B cosθ_B +
R₀p₃CD J the ends add at most 2U max(cos²θ − sin²θ, 0) to the derivative and take at most 2U away. Derived for this
project. The bound is infinite where some angle may have no slip; it proves nothing there, nor where it is 1 or more.
"""

from typing import NamedTuple

import numpy as np

from models.boundary_value import Array
from models.compiled import compiled, inner
from models.friction import angles_at_ends
from models.scene import (
    CYLINDER_SPEED,
    FRICTION,
    SPAN_RATIO,
    TENSION_CD,
    TWIST_CD,
    TWIST_CONGESTION,
    TWIST_TRAPPING,
    WRAP_ANGLE,
    YARN_RADIUS,
)

ROUNDS = 6
"""Of the enclosure; more hardly prove more."""
FLAT = 1e-3
"""Exponent below which the last integral is replaced by a bound, for which its closed form cancels."""
HALF_RIGHT = np.sqrt(0.5)
"""|cosθ| up to which sinθ cosθ rises with cosθ."""


@inner
def turn(scene: Array) -> float:
    """K = μφ."""
    return scene[FRICTION] * scene[WRAP_ANGLE]


@inner
def nearest(low: float, high: float) -> float:
    """Smallest |x| of an interval."""
    return max(0.0, low, -high)


@inner
def product(low: float, high: float, other_low: float, other_high: float) -> tuple[float, float]:
    """The interval of products of two intervals."""
    a, b, c, d = low * other_low, low * other_high, high * other_low, high * other_high
    return min(a, b, c, d), max(a, b, c, d)


@inner
def share(low: float, high: float, other_low: float, other_high: float) -> tuple[float, float]:
    """The interval of x/√(x² + y²) over a box without the origin."""
    near = nearest(other_low, other_high)
    far = max(abs(other_low), abs(other_high))
    return low / np.hypot(low, far if low > 0 else near), high / np.hypot(high, near if high > 0 else far)


@inner
def weight(m: float, K: float) -> float:
    """W(m) = ∫₀ᴷ e^{−mx} dx."""
    return K if m == 0.0 else -np.expm1(-m * K) / m


@inner
def bent(cosine: float) -> float:
    """sinθ cosθ."""
    return cosine * np.sqrt(1 - cosine * cosine)


class Enclosure(NamedTuple):
    """Bounds of all solutions along their contact."""

    slip: float
    """Smallest slip in v; the rest means nothing where it is 0."""
    cos_low: float
    """Smallest and largest cosα."""
    cos_high: float
    sine: float
    """Largest |sinα|."""
    cosine: float
    """Largest |cosθ|."""
    m: float
    """Smallest sinα sinθ."""


@inner
def enclosure(scene: Array) -> Enclosure:
    """Bounds of all solutions of `Dimensionless.vector`."""
    twist, speed, ratio = scene[TWIST_CD], scene[CYLINDER_SPEED], scene[SPAN_RATIO]
    couple, spin, K = scene[TENSION_CD] * scene[YARN_RADIUS], 2 * np.pi * scene[YARN_RADIUS], turn(scene)
    # Before anything is known: |θ_C − θ_B| < π, and p₃ rises above p₃CD only where the yarn is faster than v.
    fast = 1.0 if abs(speed) > 1 else 0.0
    J_high = min(np.pi * np.exp(fast * K), weight(-fast, K))
    J_low, bent_low, bent_high, cos_low, cos_high = -J_high, -1.0, 1.0, -1.0, 1.0
    w_low, w_high, slip, sine, cosine, m = -np.inf, np.inf, 0.0, 0.0, 0.0, 0.0
    for _ in range(ROUNDS):
        kept = (1 - scene[TWIST_TRAPPING]) * twist
        low, high = kept + (bent_low + couple * J_low) / (2 * np.pi), kept + (bent_high + couple * J_high) / (2 * np.pi)
        low, high = product(scene[TWIST_CONGESTION], scene[TWIST_CONGESTION], low, high)
        w_low, w_high = max(w_low, low), min(w_high, high)
        B_low, C_high = angles_at_ends(np.tanh(K * cos_low), ratio)
        B_high, C_low = angles_at_ends(np.tanh(K * cos_high), ratio)
        if abs(C_low) <= HALF_RIGHT and abs(C_high) <= HALF_RIGHT and max(abs(B_low), abs(B_high)) <= HALF_RIGHT:
            bent_low, bent_high = bent(C_low) - bent(B_high), bent(C_high) - bent(B_low)
        theta_low, theta_high = min(B_low, C_low), max(B_high, C_high)  # of cosθ
        cosine = max(-theta_low, theta_high)
        least = np.sqrt(1 - cosine * cosine)
        low, high = product(speed, speed, least, 1.0)
        across_low, across_high = low + spin * (w_low - twist), high + spin * (w_high - twist)
        low, high = product(speed, speed, theta_low, theta_high)
        along_low, along_high = 1 + low, 1 + high
        slip = np.hypot(nearest(across_low, across_high), nearest(along_low, along_high))
        if slip == 0.0:
            break
        low, high = share(across_low, across_high, along_low, along_high)
        cos_low, cos_high = max(cos_low, low), min(cos_high, high)
        low, high = share(along_low, along_high, across_low, across_high)
        sine = max(-low, high)
        m, most = product(low, high, least, 1.0)
        low, high = product(cos_low, cos_high, least, 1.0)
        low, high = product(low, high, weight(most, K), weight(m, K))
        J_low, J_high = max(J_low, low), min(J_high, high)
    return Enclosure(slip, cos_low, cos_high, sine, cosine, m)


@inner
def feedback_bound(scene: Array) -> float:
    """An upper bound of H' where the solutions are; infinite where it finds none."""
    slip, cos_low, cos_high, sine, cosine, m = enclosure(scene)
    if slip == 0.0:
        return np.inf
    speed, K, spin = abs(scene[CYLINDER_SPEED]), turn(scene), 2 * np.pi * scene[YARN_RADIUS]
    along = max(-cos_low, cos_high)
    kappa, g = spin * sine * sine / slip, speed * sine / slip
    y = kappa * weight(-g, K)
    if cos_low * cos_high > 0:
        y = min(y, kappa * K * max(cos_high / cos_low, cos_low / cos_high))
    N = spin * sine * along / slip + (speed * along / slip + sine * cosine) * y
    moment = K * K / 2 * np.exp(max(0.0, -m * K)) if abs(m) * K < FLAT else (1 - (1 + m * K) * np.exp(-m * K)) / (m * m)
    J = weight(m, K) * (kappa + (g + along * cosine) * y) + along * N * moment
    at_ends = 2 * y * (max(2 * cosine * cosine - 1, 0.0) if scene[TWIST_CONGESTION] >= 0 else 1.0)
    return abs(scene[TWIST_CONGESTION]) * (scene[YARN_RADIUS] * scene[TENSION_CD] * J + at_ends) / (2 * np.pi)


@compiled
def feedback_bounds(scenes: Array) -> Array:
    """An upper bound of H' where the solutions of `Dimensionless.vector` in each row are, shape (n,)."""
    bounds = np.empty(scenes.shape[0])
    for i in range(scenes.shape[0]):
        bounds[i] = feedback_bound(scenes[i])
    return bounds


def perhaps_several(scene: Array) -> bool:
    """Whether the flexible yarn of `Dimensionless.vector` may have several solutions: false is proven."""
    return not feedback_bounds(scene[None])[0] < 1
