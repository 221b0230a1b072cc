"""Every solution of the flexible yarn, by one scalar equation for the rotation n₁; the proof where there is none.

With w = n₁/v given, the angle decouples: q' = μ cosα(q, w) for q = ln tan(θ/2). The flow q_B → q_C is monotone, so the
geometry of the spans has exactly one root q_B, between −μφ and μφ; p₃ and τ follow by quadrature, and what is left is

    G(w) = w − η (T_AB(w) − k T_CD) = 0.

T_AB is bounded, so G runs from −∞ to ∞, and it is continuous wherever the yarn slides. It can jump only at the one w
for which some angle has no slip at all, across = along = 0: cosθ* = −v/v_b, 2πR₀(w − T_CD) = −(v_b/v) sinθ*. That
point attracts the yarn, which then rests on the moving surface over a part of the contact, and the friction there has
no direction. For η > 0 the geometry of the spans lets G only fall there, with rising w: to reach θ* the yarn comes from
the side that makes T_AB rise. So for η ≥ 0 a sliding solution always exists, with G' ≥ 0; for η < 0 the sign of G may
change at the jump and nowhere else, and then there is none. Where a bound proves that there is one solution only
(uniqueness.py) nothing needs to be scanned; elsewhere a scan, on both sides of the jump, finds roots, but cannot prove
that two close ones were not overlooked.

What couples twist back to itself is Γ = η R₀² p₃CD (1 − exp(−μφ)) in units of K: more twist in AB turns the friction
across the yarn, which twists it more. For a cylinder at rest, T_CD = 0 and l_AB = l_CD, w = 0 is a solution with
G' = 1 − Γ + η (R₀/r₀) μφ: where that vanishes is a pitchfork, and the yarn starts to roll one way or the other. Roots
with G' > 0 are stable if n₁ follows the twist in AB. Derived for this project; the quadratures are the flexible yarn's.

Integration: Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19, order 5(4), with step control.
"""

import math
from dataclasses import dataclass

import numpy as np

from models.boundary_value import Array
from models.compiled import compiled, inner
from models.friction import friction_direction
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

SCAN_POINTS = 160
SCAN_TOLERANCE = 1e-7
TOLERANCE = 1e-13
"""Of the step control, absolute, for q, ln p₃ and the integral of the friction couple."""
ROOT_TOLERANCE = 1e-5
"""Of G relative to 1 + |w|, where w is exact to rounding: above it G jumps instead of passing through zero."""
MAX_STEPS = 20_000
FRICTION_STEPS = 16
BESIDE_JUMP = np.array([1e-6, 1e-5, 1e-4])
"""How near to the jump of G it is evaluated, relative to 1 + |w|: solutions can be as near to it as 1e-5.

The nearer, the more often a yarn that is all but at rest makes an integration run out of steps: of 338 values in random
scenes half, 15 % and none."""


@dataclass(frozen=True, slots=True)
class Roots:
    """The solutions of a scene by their w = n₁/v."""

    w: tuple[float, ...]
    """All that were found, ascending."""
    settled: float
    """The one that the yarn settles on while the friction is raised from zero; NaN if it comes to rest instead."""
    sticking: bool
    """Whether G changes its sign at its jump, where the yarn rests on the surface."""


def feedback(scenes: Array) -> Array:
    """Γ, by which the twist acts on itself, from the numbers of `Dimensionless.vector`, in the last axis."""
    coupling = scenes[..., TWIST_CONGESTION] * scenes[..., YARN_RADIUS] ** 2 * scenes[..., TENSION_CD]
    return np.asarray(coupling * -np.expm1(-scenes[..., FRICTION] * scenes[..., WRAP_ANGLE]), dtype=np.float64)


def find_roots(scene: Array) -> Roots:
    """All solutions of the scene with the numbers `Dimensionless.vector`, and the one that it settles on."""
    trials = _trials(scene)
    values = scan(scene, trials)
    known = np.isfinite(values)  # not where an integration ran out of steps, beside the jump
    trials, above = trials[known], values[known] > 0
    roots: list[float] = []
    sticking = False
    for i in np.flatnonzero(above[1:] != above[:-1]):
        w, left = refine(scene, float(trials[i]), float(trials[i + 1]), TOLERANCE)
        if left <= ROOT_TOLERANCE * (1 + abs(w)):
            roots.append(w)
        else:
            sticking = True
    settled = math.nan
    if roots:
        reached = settle(scene, FRICTION_STEPS)
        nearest = min(roots, key=lambda w: abs(w - reached))
        if abs(nearest - reached) <= 1e-3 * (1 + abs(nearest)):
            settled = nearest
    return Roots(tuple(roots), settled, sticking)


def _trials(scene: Array) -> Array:
    """Ascending w that enclose all roots, dense where slip across the yarn is of the size of that along it.

    |∫ μ cosα sinθ dψ| = |θ_C − θ_B| < π bounds T_AB; p₃ rises above p₃CD only where the yarn is faster than v.
    """
    speed = abs(scene[CYLINDER_SPEED])
    rise = scene[FRICTION] * scene[WRAP_ANGLE] if speed > 1 else 0.0
    gained = scene[YARN_RADIUS] * scene[TENSION_CD] * np.pi * np.exp(rise) + 1.0
    twist = abs(scene[TWIST_CD]) * (1 + abs(scene[TWIST_TRAPPING])) + gained / (2 * np.pi)
    spin = 2 * np.pi * scene[YARN_RADIUS]
    farthest = spin * (abs(scene[TWIST_CONGESTION]) * twist + abs(scene[TWIST_CD]) + 1.0)
    unit = (1 + speed) / 4
    even = np.linspace(-1.0, 1.0, SCAN_POINTS) * np.arcsinh(farthest / unit)
    trials = scene[TWIST_CD] + unit * np.sinh(even) / spin
    if speed > 1:
        jump = scene[TWIST_CD] - scene[CYLINDER_SPEED] / spin * math.sqrt(1 - 1 / speed**2)
        beside = BESIDE_JUMP * (1 + abs(jump))
        if trials[0] < jump < trials[-1]:
            trials = np.sort(np.concatenate([trials, jump - beside, jump + beside]))
    return np.asarray(trials, dtype=np.float64)


@inner
def _slopes(scene: Array, w: float, y: Array, out: Array) -> None:
    """Derivatives by ψ of q, of L = ln p₃ and of J = ∫ μ cosα sinθ exp(L − L_B) dψ."""
    sine, cosine = 1 / np.cosh(y[0]), -np.tanh(y[0])
    cos_alpha, sin_alpha = friction_direction(scene, sine, cosine, w)
    out[0] = scene[FRICTION] * cos_alpha
    out[1] = scene[FRICTION] * sin_alpha * sine
    out[2] = scene[FRICTION] * cos_alpha * sine * np.exp(y[1])


@inner
def _integrate(scene: Array, w: float, y: Array, length: float, tolerance: float) -> bool:
    """Advance y by `length` in place; False if the number of steps ran out."""
    k = np.empty((7, 3))
    stage, trial = np.empty(3), np.empty(3)
    done, step = 0.0, min(length, 0.05)
    _slopes(scene, w, y, k[0])
    for _ in range(MAX_STEPS):
        step = min(step, length - done)
        stage[:] = y + step * k[0] / 5
        _slopes(scene, w, stage, k[1])
        stage[:] = y + step * (3 * k[0] + 9 * k[1]) / 40
        _slopes(scene, w, stage, k[2])
        stage[:] = y + step * (44 / 45 * k[0] - 56 / 15 * k[1] + 32 / 9 * k[2])
        _slopes(scene, w, stage, k[3])
        stage[:] = y + step * (19372 * k[0] - 76080 * k[1] + 64448 * k[2] - 1908 * k[3]) / 6561
        _slopes(scene, w, stage, k[4])
        stage[:] = y + step * (
            9017 / 3168 * k[0] - 355 / 33 * k[1] + 46732 / 5247 * k[2] + 49 / 176 * k[3] - 5103 / 18656 * k[4]
        )
        _slopes(scene, w, stage, k[5])
        trial[:] = y + step * (
            35 / 384 * k[0] + 500 / 1113 * k[2] + 125 / 192 * k[3] - 2187 / 6784 * k[4] + 11 / 84 * k[5]
        )
        _slopes(scene, w, trial, k[6])
        error = 0.0
        for i in range(3):
            local = step * (
                71 / 57600 * k[0, i]
                - 71 / 16695 * k[2, i]
                + 71 / 1920 * k[3, i]
                - 17253 / 339200 * k[4, i]
                + 22 / 525 * k[5, i]
                - k[6, i] / 40
            )
            error = max(error, abs(local) / (tolerance * (1 + abs(trial[i]))))
        if error <= 1:
            done += step
            y[:] = trial
            k[0] = k[6]
            if done >= length * (1 - 1e-15):
                return True
        step *= min(5.0, max(0.2, 0.9 * max(error, 1e-10) ** -0.2))
    return False


@inner
def _start_angle(scene: Array, w: float, guess: float, tolerance: float, y: Array) -> float:
    """q_B that fits the geometry of the spans; y is left at C. NaN if an integration gave up.

    Newton, kept in a bracket: for an autonomous equation dq_C/dq_B is the ratio of the slopes at C and B.
    """
    bound = scene[FRICTION] * scene[WRAP_ANGLE] + 1e-12
    low, high = -bound, bound
    q = min(max(guess, low), high)
    slope_B, slope_C = np.empty(3), np.empty(3)
    for _ in range(100):
        y[0], y[1], y[2] = q, 0.0, 0.0
        _slopes(scene, w, y, slope_B)
        if not _integrate(scene, w, y, scene[WRAP_ANGLE], tolerance):
            return np.nan
        _slopes(scene, w, y, slope_C)
        mismatch = scene[SPAN_RATIO] * np.tanh(q) + np.tanh(y[0])  # rises with q
        if mismatch > 0:
            high = q
        else:
            low = q
        stretch = slope_C[0] / slope_B[0] if slope_B[0] != 0.0 else 1.0
        rise = scene[SPAN_RATIO] / np.cosh(q) ** 2 + max(stretch, 0.0) / np.cosh(y[0]) ** 2
        trial = q - mismatch / rise
        if not (low < trial < high):
            trial = 0.5 * (low + high)
        if abs(trial - q) <= 10 * tolerance * (1 + abs(q)):
            return q
        q = trial
    return q


@inner
def _twist_AB(scene: Array, q: float, at_C: Array) -> float:
    tau_C = 2 * np.pi * scene[TWIST_CD] - np.tanh(at_C[0]) / np.cosh(at_C[0])
    tau_B = tau_C + scene[YARN_RADIUS] * scene[TENSION_CD] * np.exp(-at_C[1]) * at_C[2]
    return (tau_B + np.tanh(q) / np.cosh(q)) / (2 * np.pi)


@compiled
def mismatch(scene: Array, w: float, guess: float, tolerance: float) -> tuple[float, float]:
    """G(w), and q_B to start the next one from."""
    y = np.empty(3)
    q = _start_angle(scene, w, guess, tolerance, y)
    twist = _twist_AB(scene, q, y)
    return w - scene[TWIST_CONGESTION] * (twist - scene[TWIST_TRAPPING] * scene[TWIST_CD]), q


@compiled
def scan(scene: Array, trials: Array) -> Array:
    """G at ascending w, shape (n,), to SCAN_TOLERANCE."""
    values = np.empty(trials.shape[0])
    guess = 0.0
    for i in range(trials.shape[0]):
        values[i], guess = mismatch(scene, trials[i], guess, SCAN_TOLERANCE)
        if not np.isfinite(guess):
            guess = 0.0
    return values


@compiled
def refine(scene: Array, low: float, high: float, tolerance: float) -> tuple[float, float]:
    """Root of G between two w where its sign differs, by bisection and secants (Illinois), and |G| there.

    |G| is NaN where the yarn comes to rest between the two.
    """
    at_low, guess = mismatch(scene, low, 0.0, tolerance)
    at_high, guess = mismatch(scene, high, guess, tolerance)
    w, value = low, at_low
    side = 0
    for iteration in range(200):
        w = (low * at_high - high * at_low) / (at_high - at_low) if iteration % 3 else 0.5 * (low + high)
        value, guess = mismatch(scene, w, guess, tolerance)
        if value == 0.0 or not np.isfinite(value) or high - low <= 4e-16 * (abs(low) + abs(high)):
            break
        if (value > 0) == (at_high > 0):
            high, at_high = w, value
            if side == 1:
                at_low /= 2
            side = 1
        else:
            low, at_low = w, value
            if side == -1:
                at_high /= 2
            side = -1
    return w, abs(value)


@compiled
def settle(scene: Array, steps: int) -> float:
    """The w that the yarn settles on while the friction is raised from zero, to SCAN_TOLERANCE.

    At each step w moves against G to the next change of its sign: along a stable branch, and to the next stable one
    where that ends.
    """
    moved = scene.copy()
    w = scene[TWIST_CONGESTION] * (1 - scene[TWIST_TRAPPING]) * scene[TWIST_CD]
    for k in range(1, steps + 1):
        moved[FRICTION] = scene[FRICTION] * k / steps
        value, guess = mismatch(moved, w, 0.0, SCAN_TOLERANCE)
        before, before_value = w, value
        width = 1e-3 * (1 + abs(w))
        after = w
        for _ in range(100):
            after = before - np.copysign(width, value)
            after_value, guess = mismatch(moved, after, guess, SCAN_TOLERANCE)
            if (after_value > 0) != (value > 0):
                break
            before, before_value = after, after_value
            width *= 1.5
        if before_value != 0.0:
            w = refine(moved, min(before, after), max(before, after), SCAN_TOLERANCE)[0]
    return w


@compiled
def path_values(scene: Array, w: float, psi: Array, tolerance: float) -> Array:
    """q, ln(p₃/p₃CD) and τ at ascending psi from 0 to φ, shape (3, n)."""
    y = np.empty(3)
    q = _start_angle(scene, w, 0.0, tolerance, y)
    log_C, couple = y[1], y[2]
    tau_C = 2 * np.pi * scene[TWIST_CD] - np.tanh(y[0]) / np.cosh(y[0])
    feedback = scene[YARN_RADIUS] * scene[TENSION_CD] * np.exp(-log_C)
    values = np.empty((3, psi.shape[0]))
    y[0], y[1], y[2] = q, 0.0, 0.0
    for i in range(psi.shape[0]):
        if i:
            _integrate(scene, w, y, psi[i] - psi[i - 1], tolerance)
        values[0, i], values[1, i] = y[0], y[1] - log_C
        values[2, i] = tau_C + feedback * (couple - y[2])
    return values
