"""Flexible yarn on the moving cylinder: tension and twist, no bending (Feng et al. 2012; paper's baseline).

    θ' = μ cosα sinθ        p₃' = μ sinα sinθ p₃        τ' = −μ cosα sinθ R₀ p₃        N = p₃ sin²θ

with ' = d/dψ, lengths in r₀, forces in K/r₀². For q = ln tan(θ/2) the first is q' = μ cosα with sinθ = 1/cosh q and
cosθ = −tanh q: an equation for q alone, given the twist rotation w = n₁/v, and ln p₃ and τ are quadratures along it:

    q(ψ) = q_C − ∫ μ cosα        ln(p₃/p₃CD) = −∫ μ sinα sinθ        τ = τ_C + ∫ μ cosα sinθ R₀ p₃       (∫ from ψ to φ)

The unknowns are q at Lobatto nodes and w. Boundary conditions: p₃(φ) = p₃CD and T(φ) = T_CD are built in;
l_AB cosθ(0) + l_CD cosθ(φ) = 0 and n₁ = η v (T_AB − k T_CD) are two equations. The integrals are spectral
(Clenshaw and Curtis, Numer. Math. 2 (1960) 197); the degree is raised until the ends stop changing, near machine
precision: equations of the second kind stay well conditioned at any degree.

Limits: no bending or torsional stiffness in the force balance, inextensible, weightless, steady, contact everywhere.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, implement, inner
from models.complex_step import exponential, reciprocal
from models.discretisation import Integrals, chebyshev_collocation, integrals, interpolation, polynomial, resample
from models.friction import end_conditions, friction_direction, friction_slopes
from models.newton import CONVERGED, assign, jacobian, largest, newton, residual
from models.outcome import Outcome, Solution
from models.refinement import (
    NEWTON_FAILED,
    SETTLED,
    UNRESOLVED,
    Refined,
    compiled_relative_change,
    record,
    relative_change,
)
from models.scene import (
    FRICTION,
    SPAN_RATIO,
    TENSION_CD,
    TWIST_CD,
    TWIST_CONGESTION,
    TWIST_TRAPPING,
    WRAP_ANGLE,
    YARN_RADIUS,
    Dimensionless,
    Scene,
)
from models.self_consistency import TOLERANCE as ROOT_PRECISION
from models.self_consistency import Roots, find_roots, path_values
from models.solution import PROFILE_POINTS, Fields, failed, solution
from models.uniqueness import perhaps_several

Array = NDArray[np.float64]
Values = NDArray[Any]

NAME = "flexible"
DEGREES = (8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
PRECISION = 1e-10
"""Change of the ends between neighbouring degrees at which the refinement ends."""
TOLERANCES = (1e-11, 1e-9)
"""Of Newton's correction and of its residuals."""
MAX_ITERATIONS = 60
SAME_ROOT = 1e-6
"""Relative difference of w below which two ways to a solution mean the same one."""


class Flexible(NamedTuple):
    """The problem of the flexible yarn at one degree."""

    scene: Values
    """`Dimensionless.vector`."""
    integration: Values
    """∫ from each Lobatto node on [0, φ] to C, shape (n + 1, n + 1)."""


@inner
def direction(q: Any) -> tuple[Any, Any]:
    """sinθ and cosθ."""
    tangent = exponential(q)  # tan(θ/2)
    share = reciprocal(1 + tangent * tangent)
    return 2 * tangent * share, (1 - tangent * tangent) * share


@inner
def flow(scene: Values, q: Any, w: Any) -> tuple[Any, Any, Any]:
    """q', (ln p₃)' and −τ'/p₃ with p₃ in units of p₃CD."""
    sine, cosine = direction(q)
    cos_alpha, sin_alpha = friction_direction(scene, sine, cosine, w)
    along = scene[FRICTION] * cos_alpha
    return along, scene[FRICTION] * sin_alpha * sine, along * sine * scene[YARN_RADIUS] * scene[TENSION_CD]


@inner
def quadratures(problem: Flexible, q: Values, w: Any, excess: Values, log_p: Values, turn: Values, tau: Values) -> None:
    """Fill q − q_C + ∫ q', ln(p₃/p₃CD), −τ' and τ at the nodes, shape (n + 1,) each."""
    scene, integration = problem.scene, problem.integration
    size = q.shape[0]
    slope, pull = np.empty_like(excess), np.empty_like(excess)
    for j in range(size):
        slope[j], pull[j], turn[j] = flow(scene, q[j], w)
    for i in range(size):
        excess[i] = q[i] - q[-1]
        log_p[i] = 0.0
        for j in range(size):
            excess[i] += integration[i, j] * slope[j]
            log_p[i] -= integration[i, j] * pull[j]
    for j in range(size):
        turn[j] *= exponential(log_p[j])
    sine, cosine = direction(q[-1])
    tau_C = 2 * np.pi * scene[TWIST_CD] + sine * cosine
    for i in range(size):
        tau[i] = tau_C
        for j in range(size):
            tau[i] += integration[i, j] * turn[j]


def fill_residual(problem: Flexible, x: Values, value: Values) -> None:
    """F(x), shape (n + 2,); x holds q at the nodes, then w, real or complex as `value` is."""
    q, w = x[:-1], x[-1]
    size = q.shape[0]
    log_p, turn, tau, conditions = np.empty_like(q), np.empty_like(q), np.empty_like(q), np.empty(4, q.dtype)
    quadratures(problem, q, w, value[:size], log_p, turn, tau)  # the last is 0 = 0: the conditions below take its place
    end_conditions(problem.scene, (*direction(q[0]), *direction(q[-1])), tau[0], tau[-1], w, conditions)
    value[size - 1], value[size] = conditions[0], conditions[3]


def fill_jacobian(problem: Flexible, x: Array, matrix: Array) -> None:
    """∂F/∂x: the slopes of `flow` at each node, chained with the quadratures."""
    scene, integration = problem.scene, problem.integration
    size, q, w = x.shape[0] - 1, x[:-1], x[-1]
    excess, log_p, turn, tau = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    quadratures(problem, q, w, excess, log_p, turn, tau)
    by_q, by_w = np.empty((3, size)), np.empty((3, size))
    mu, couple = scene[FRICTION], scene[FRICTION] * scene[YARN_RADIUS] * scene[TENSION_CD]
    for j in range(size):
        sine, cosine = direction(q[j])
        cos_alpha, sin_alpha, alpha_q, alpha_w = friction_slopes(scene, sine, cosine, w)
        pull = couple * sine * exponential(log_p[j])
        by_q[0, j], by_w[0, j] = -mu * sin_alpha * alpha_q, -mu * sin_alpha * alpha_w
        by_q[1, j] = mu * sine * (cos_alpha * alpha_q + sin_alpha * cosine)
        by_w[1, j] = mu * sine * cos_alpha * alpha_w
        by_q[2, j] = pull * (cos_alpha * cosine - sin_alpha * alpha_q)
        by_w[2, j] = -pull * sin_alpha * alpha_w
    matrix.fill(0.0)
    for i in range(size - 1):
        matrix[i, i] = 1.0
        matrix[i, size - 1] = -1.0
        for j in range(size):
            matrix[i, j] += integration[i, j] * by_q[0, j]
            matrix[i, size] += integration[i, j] * by_w[0, j]
    # The conditions at the ends: d sinθ/dq = sinθ cosθ, d cosθ/dq = −sin²θ, so that d(sinθ cosθ)/dq = bent.
    sine_B, cosine_B = direction(q[0])
    sine_C, cosine_C = direction(q[-1])
    bent_B = sine_B * (cosine_B * cosine_B - sine_B * sine_B)
    bent_C = sine_C * (cosine_C * cosine_C - sine_C * sine_C)
    matrix[size - 1, 0] = -scene[SPAN_RATIO] * sine_B * sine_B
    matrix[size - 1, size - 1] = -sine_C * sine_C
    by_tau = -scene[TWIST_CONGESTION] / (2 * np.pi)  # of w − η (T_AB − k T_CD), with T_AB = (τ_B − sinθ_B cosθ_B)/2π
    matrix[size, 0] = -by_tau * bent_B
    matrix[size, size - 1] += by_tau * bent_C
    matrix[size, size] = 1.0
    for j in range(size):
        weight = by_tau * integration[0, j]
        matrix[size, j] += weight * by_q[2, j]
        matrix[size, size] += weight * by_w[2, j]
        for k in range(size):
            matrix[size, k] -= weight * turn[j] * integration[j, k] * by_q[1, k]
            matrix[size, size] -= weight * turn[j] * integration[j, k] * by_w[1, k]


implement(residual, Flexible, fill_residual)
implement(jacobian, Flexible, fill_jacobian)


@inner
def on_contact(scene: Array, packed: Array, degree: int) -> Array:
    """The integration matrix for [0, φ], from that for [−1, 1] at the beginning of `packed`."""
    size = degree + 1
    result = np.empty((size, size))
    for i in range(size):
        for j in range(size):
            result[i, j] = packed[i * size + j] * scene[WRAP_ANGLE] / 2
    return result


@inner
def straight(problem: Flexible) -> Array:
    """A first guess: q straight along the contact, with the friction direction of a yarn square to the axis."""
    scene, size = problem.scene, problem.integration.shape[0]
    length = scene[WRAP_ANGLE]
    x = np.empty(size + 1)
    x[-1] = scene[TWIST_CONGESTION] * (1 - scene[TWIST_TRAPPING]) * scene[TWIST_CD]  # without friction: T_AB = T_CD
    slope, ratio = flow(scene, 0.0, x[-1])[0], scene[SPAN_RATIO]
    for j in range(size):
        x[j] = slope * length * ((1 - np.cos(np.pi * j / (size - 1))) / 2 - 1 / (1 + ratio))
    value = np.empty(size + 1)
    residual(problem, x, value)
    x[-1] -= value[-1]  # the rotation that this twist brings
    return x


@compiled
def find(scene: Array, matrices: Integrals) -> Refined:
    """Solve one scene, `Dimensionless.vector`: raise the degree until the ends stop changing."""
    degree, first, iterations, ending = 0, 0, 0, UNRESOLVED
    x, fields = np.empty(0), np.empty((3, 0))
    at_B, change, size = np.full(3, np.nan), np.full(3, np.nan), np.inf
    status, step, value = 0, np.nan, np.empty(0)
    for degree in matrices.degrees:
        problem = Flexible(scene, on_contact(scene, matrices.matrices[first:], degree))
        first += (degree + 1) ** 2
        if iterations == 0:
            x = straight(problem)
        else:
            coarse = x
            x = np.empty(degree + 2)
            assign(x, resample(coarse[:-1], degree))
            x[-1] = coarse[-1]
        status, count, step, value, _ = newton(problem, x, TOLERANCES[0], TOLERANCES[1], MAX_ITERATIONS)
        iterations += count
        fields, unused = np.empty((3, degree + 1)), np.empty((2, degree + 1))
        assign(fields[0], x[:-1])
        quadratures(problem, fields[0], x[-1], unused[0], fields[1], unused[1], fields[2])
        if status != CONVERGED:
            ending = NEWTON_FAILED
            break
        found = compiled_ends(scene[TENSION_CD], fields[0, 0], fields[1, 0], fields[2, 0])
        change, size, at_B = found - at_B, compiled_relative_change(found, at_B), found
        if size < PRECISION:
            ending = SETTLED
            break
    lowest, normal_min = 0, np.inf
    for j in range(degree + 1):
        normal = scene[TENSION_CD] * np.exp(fields[1, j]) * direction(fields[0, j])[0] ** 2
        if normal < normal_min:
            lowest, normal_min = j, normal
    return Refined(
        ending, status, degree, fields, x[-1], at_B, change, size,
        2 * np.arctan(np.exp(x[-2])), normal_min, scene[WRAP_ANGLE] * (1 - np.cos(np.pi * lowest / degree)) / 2,
        iterations, step, largest(value[:degree]), largest(value[degree:]), np.nan,
    )  # fmt: skip


def ends(tension_CD: Any, q: Any, log_p: Any, tau: Any) -> Values:
    """p₃AB, T_AB and θ_B, dimensionless, shape (3,), from q, ln(p₃/p₃CD) and τ at B; analytic."""
    twist = (tau + np.tanh(q) / np.cosh(q)) / (2 * np.pi)
    return np.array([tension_CD * np.exp(log_p), twist, 2 * np.arctan(np.exp(q))])


compiled_ends = inner(ends)


@compiled
def at_B(problem: Flexible, x: Values) -> tuple[Any, Any]:
    """ln(p₃/p₃CD) and τ at B, real or complex."""
    size = x.shape[0] - 1
    unused, log_p, tau = np.empty((2, size), x.dtype), np.empty(size, x.dtype), np.empty(size, x.dtype)
    quadratures(problem, x[:-1], x[-1], unused[0], log_p, unused[1], tau)
    return log_p[0], tau[0]


def integration_matrices() -> Integrals:
    """The matrices that `find` takes."""
    return integrals(DEGREES)


def solve_rows(scenes: Array, table: Any) -> None:
    """Solve many scenes, `Dimensionless.vector` in each row, into a table of type ROW."""
    find_rows(scenes, integration_matrices(), table)


def solve_flexible(scene: Scene, *, profile: bool = True, rotation: float | None = None) -> Solution:
    """Solve the flexible yarn; without `profile` its numbers only. Never raises for a hard scene: see the outcome.

    Parameters
    ----------
    rotation : n₁ [1/s] near which a solution is wanted, for a scene with several; without it, the one that the yarn
        settles on while the friction is raised from zero.
    """
    problem = scene.dimensionless()
    found = find(problem.vector, integration_matrices())
    settled = found.ending == SETTLED
    if settled and not perhaps_several(problem.vector):
        return solution(scene, NAME, found, (lambda: _fields(problem, found)) if profile else None)
    roots = find_roots(problem.vector)
    w = choose(scene, roots, rotation)
    if w is None:
        return failed(scene, NAME, Outcome.STICKING, Outcome.STICKING.value, found)
    others = several(scene, roots.w, w)
    if settled and abs(found.w - w) <= SAME_ROOT * (1 + abs(w)):
        return solution(scene, NAME, found, (lambda: _fields(problem, found)) if profile else None, others=others)
    exact = _on_path(problem, w)
    return solution(scene, NAME, exact, (lambda: _path_fields(problem, w)) if profile else None, others=others)


def choose(scene: Scene, roots: Roots, rotation: float | None = None) -> float | None:
    """The w of the solution to take: nearest to a wanted n₁ [1/s], else the one that the yarn settles on."""
    if not roots.w:
        return None
    if rotation is not None:
        wanted = rotation * scene.cylinder_radius / scene.delivery_speed
        return nearest(roots.w, wanted)
    return roots.settled if np.isfinite(roots.settled) else roots.w[0]


def several(scene: Scene, roots: Sequence[float], taken: float, whose: str = "") -> str:
    """What of several solutions was taken, and how to get the others; empty where there are none.

    Parameters
    ----------
    roots : w of all solutions of the flexible yarn.
    taken : w of the solution that was taken, of this model or another one.
    whose : words for the others, if they are another model's.
    """
    if len(roots) < 2:
        return ""
    unit = scene.delivery_speed / scene.cylinder_radius
    same = nearest(roots, taken)
    others = ", ".join(f"{w * unit:.6g}" for w in roots if w != same)
    return f"taken: n₁ = {taken * unit:.6g} /s; others{whose}: n₁ = {others} /s; ask for n₁ near one of them to get it"


def nearest(roots: Sequence[float], w: float) -> float:
    """The root next to w."""
    return min(roots, key=lambda root: abs(root - w))


@dataclass(frozen=True, slots=True)
class Guess:
    """The flexible yarn as a first guess for a rod."""

    at: Callable[[Array], Array]
    """θ, p₃/p₃CD and τ at ascending ψ [rad], shape (3, n)."""
    w: float
    roots: tuple[float, ...]
    """w of all solutions of the flexible yarn."""


def first_guess(scene: Scene, rotation: float | None = None) -> Guess | None:
    """The solution that `solve_flexible` would take; None where there is none."""
    problem = scene.dimensionless()
    yarn = find(problem.vector, integration_matrices())
    if yarn.ending == SETTLED and not perhaps_several(problem.vector):
        w = float(yarn.w)
        return Guess(polynomial(rod_values(yarn.fields), problem.wrap_angle), w, (w,))
    roots = find_roots(problem.vector)
    w = choose(scene, roots, rotation)
    if w is None:
        return None
    return Guess(lambda psi: rod_values(path_values(problem.vector, w, psi, ROOT_PRECISION)), w, roots.w)


@inner
def rod_values(yarn: Array) -> Array:
    """A rod's fields θ, p₃/p₃CD and τ from the flexible yarn's q, ln(p₃/p₃CD) and τ, shape (3, n)."""
    fields = np.empty((3, yarn.shape[1]))
    for j in range(yarn.shape[1]):
        fields[0, j] = 2 * np.arctan(np.exp(yarn[0, j]))
        fields[1, j] = np.exp(yarn[1, j])
        fields[2, j] = yarn[2, j]
    return fields


def _path_fields(scene: Dimensionless, w: float) -> Fields:
    """The solution with a known w along the contact, by adaptive quadrature."""
    psi = np.linspace(0.0, scene.wrap_angle, PROFILE_POINTS)
    q, log_p, tau = path_values(scene.vector, w, psi, ROOT_PRECISION)
    sine, cosine = 1 / np.cosh(q), -np.tanh(q)
    spin = 2 * np.pi * scene.yarn_radius * (w - scene.twist_CD)
    across, along = scene.cylinder_speed * sine + spin, scene.cylinder_speed * cosine + 1
    slope = scene.friction * across / np.hypot(across, along) * sine
    theta, tension = 2 * np.arctan(np.exp(q)), scene.tension_CD * np.exp(log_p)
    return Fields(scene, psi, theta, slope, tension, tau, tension * sine**2)


def _on_path(scene: Dimensionless, w: float) -> Refined:
    """The solution with a known w, and its error as the change by a hundredfold tolerance."""
    fields = _path_fields(scene, w)
    coarse = path_values(scene.vector, w, fields.psi[[0, -1]], 100 * ROOT_PRECISION)[:, 0]
    at_B = np.array([fields.tension[0], fields.twist[0], fields.theta[0]])
    change = at_B - ends(scene.tension_CD, *coarse)
    lowest = int(np.argmin(fields.normal_force))
    return Refined(
        SETTLED, CONVERGED, 0, np.empty((3, 0)), w, at_B, change, relative_change(at_B, at_B - change),
        float(fields.theta[-1]), float(fields.normal_force[lowest]), float(fields.psi[lowest]), 0, np.nan, np.nan,
        np.nan, np.nan,
    )  # fmt: skip


def _fields(scene: Dimensionless, found: Refined) -> Fields:
    psi = np.linspace(0.0, scene.wrap_angle, PROFILE_POINTS)
    to_profile = interpolation(found.degree, PROFILE_POINTS - 1, even=True)
    q, log_p, tau = found.fields @ to_profile.T
    theta = 2 * np.arctan(np.exp(q))
    slope = to_profile @ (chebyshev_collocation(found.degree, scene.wrap_angle).nodal_derivatives[1] @ found.fields[0])
    tension = scene.tension_CD * np.exp(log_p)
    return Fields(scene, psi, theta, slope * np.sin(theta), tension, tau, tension * np.sin(theta) ** 2)


@compiled
def find_rows(scenes: Array, matrices: Integrals, table: Any) -> None:
    """Solve many scenes, `Dimensionless.vector` in each row, into a table of type ROW."""
    for i in range(scenes.shape[0]):
        record(find(scenes[i].copy(), matrices), table[i])
