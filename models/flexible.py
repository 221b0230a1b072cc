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

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, implement, inner
from models.complex_step import COMPLEX_STEP
from models.discretisation import chebyshev_collocation, chebyshev_integration, interpolation, resample
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
from models.self_consistency import STRONG_FEEDBACK, Roots, feedback, find_roots, path_values
from models.self_consistency import TOLERANCE as ROOT_PRECISION
from models.solution import PROFILE_POINTS, Fields, failed, solution

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
SMALLEST_FRICTION_STEP = 1e-3
"""Share of μ below which the continuation from the frictionless yarn gives up."""


class Flexible(NamedTuple):
    """The problem of the flexible yarn at one degree."""

    scene: Values
    """`Dimensionless.vector`."""
    integration: Values
    """∫ from each Lobatto node on [0, φ] to C, shape (n + 1, n + 1)."""


@inner
def direction(q: Any) -> tuple[Any, Any]:
    """sinθ and cosθ."""
    tangent = np.exp(q)  # tan(θ/2)
    share = 1 / (1 + tangent * tangent)
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
        turn[j] *= np.exp(log_p[j])
    sine, cosine = direction(q[-1])
    tau_C = 2 * np.pi * scene[TWIST_CD] + sine * cosine
    for i in range(size):
        tau[i] = tau_C
        for j in range(size):
            tau[i] += integration[i, j] * turn[j]


@inner
def residuals(problem: Flexible, q: Values, w: Any, value: Values) -> tuple[Any, Any]:
    """Fill all residuals, shape (n + 2,), real or complex as `value` is; returns ln(p₃/p₃CD) and τ at B."""
    size = q.shape[0]
    log_p, turn, tau = np.empty(size, value.dtype), np.empty(size, value.dtype), np.empty(size, value.dtype)
    quadratures(problem, q, w, value[:size], log_p, turn, tau)  # the last is 0 = 0: the conditions below take its place
    conditions = np.empty(4, value.dtype)
    end_conditions(problem.scene, (*direction(q[0]), *direction(q[-1])), tau[0], tau[-1], w, conditions)
    value[size - 1], value[size] = conditions[0], conditions[3]
    return log_p[0], tau[0]


def fill_residual(problem: Flexible, x: Array, value: Array) -> None:
    """F(x), shape (n + 2,); x holds q at the nodes, then w."""
    residuals(problem, x[:-1], x[-1], value)


def fill_jacobian(problem: Flexible, x: Array, matrix: Array) -> None:
    """∂F/∂x: the slopes of `flow` at each node, chained with the quadratures."""
    scene, integration = problem.scene, problem.integration
    size, step = x.shape[0] - 1, 1j * COMPLEX_STEP
    q, w = x[:-1], x[-1]
    excess, log_p, turn, tau = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    quadratures(problem, q, w, excess, log_p, turn, tau)
    by_q, by_w = np.empty((3, size)), np.empty((3, size))
    mu, couple = scene[FRICTION], scene[FRICTION] * scene[YARN_RADIUS] * scene[TENSION_CD]
    for j in range(size):
        sine, cosine = direction(q[j])
        cos_alpha, sin_alpha, alpha_q, alpha_w = friction_slopes(scene, sine, cosine, w)
        pull = couple * sine * np.exp(log_p[j])
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
    tau_B_by_q, tau_B_by_w = np.zeros(size), 0.0
    for j in range(size):
        weight = integration[0, j]
        tau_B_by_q[j] += weight * by_q[2, j]
        tau_B_by_w += weight * by_w[2, j]
        for k in range(size):
            tau_B_by_q[k] -= weight * turn[j] * integration[j, k] * by_q[1, k]
            tau_B_by_w -= weight * turn[j] * integration[j, k] * by_w[1, k]
    sine, cosine = direction(q[-1] + step)
    tau_B_by_q[-1] += (sine * cosine).imag / COMPLEX_STEP
    conditions = np.empty(4, np.complex128)
    for column in range(4):
        q_B = q[0] + (step if column == 0 else 0j)
        q_C = q[-1] + (step if column == 1 else 0j)
        tau_B = tau[0] + (step if column == 2 else 0j)
        rotation = w + (step if column == 3 else 0j)
        end_conditions(scene, (*direction(q_B), *direction(q_C)), tau_B, tau[-1] + 0j, rotation, conditions)
        for row, condition in ((size - 1, 0), (size, 3)):
            slope = conditions[condition].imag / COMPLEX_STEP
            if column == 2:
                for j in range(size):
                    matrix[row, j] += slope * tau_B_by_q[j]
                matrix[row, size] += slope * tau_B_by_w
            else:
                matrix[row, 0 if column == 0 else (size - 1 if column == 1 else size)] += slope


implement(residual, Flexible, fill_residual)
implement(jacobian, Flexible, fill_jacobian)


@inner
def on_contact(scene: Array, matrix: Array) -> Array:
    """The integration matrix for [0, φ] from that for [−1, 1]."""
    result = np.empty_like(matrix)
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            result[i, j] = matrix[i, j] * scene[WRAP_ANGLE] / 2
    return result


@inner
def frictionless(scene: Array, degree: int) -> Array:
    """The unknowns of the yarn without friction: a circle at constant tension and twist."""
    x = np.zeros(degree + 2)
    x[-1] = scene[TWIST_CONGESTION] * (1 - scene[TWIST_TRAPPING]) * scene[TWIST_CD]
    return x


@inner
def straight(scene: Array, matrix: Array) -> Array:
    """A first guess: q straight along the contact, with the friction direction of a yarn square to the axis."""
    size, length = matrix.shape[0], scene[WRAP_ANGLE]
    x = frictionless(scene, size - 1)
    problem = Flexible(scene, on_contact(scene, matrix))
    slope, ratio = flow(scene, 0.0, x[-1])[0], scene[SPAN_RATIO]
    for j in range(size):
        x[j] = slope * length * ((1 - np.cos(np.pi * j / (size - 1))) / 2 - 1 / (1 + ratio))
    value = np.empty(size + 1)
    residuals(problem, x[:-1], x[-1], value)
    x[-1] -= value[-1]  # the rotation that this twist brings
    return x


@inner
def from_frictionless(problem: Flexible, x: Array) -> tuple[int, int, float, Array]:
    """Continue in friction from 0, halving the step where Newton fails; x as for `newton`.

    Returns status, all iterations, last correction and residuals.
    """
    scene = problem.scene
    friction = scene[FRICTION]
    assign(x, frictionless(scene, x.shape[0] - 2))
    reached, step, iterations = 0.0, 0.25, 0
    while True:
        part = min(1.0, reached + step)
        scene[FRICTION] = part * friction
        trial = x.copy()
        found = newton(problem, trial, TOLERANCES[0], TOLERANCES[1], MAX_ITERATIONS)
        iterations += found[1]
        if found[0] == CONVERGED:
            assign(x, trial)
            reached, step = part, 2 * step
        else:
            step /= 2
        if (part == 1.0 and found[0] == CONVERGED) or step < SMALLEST_FRICTION_STEP:
            scene[FRICTION] = friction
            return found[0], iterations, found[2], found[3]


@inner
def refine(scene: Array, matrices: tuple[Array, ...]) -> Refined:
    """Raise the degree until the ends stop changing; `matrices` holds `chebyshev_integration` for each of DEGREES."""
    degree, iterations, ending = matrices[0].shape[0] - 1, 0, UNRESOLVED
    x = straight(scene, matrices[0])
    at_B, change, size = np.full(3, np.nan), np.full(3, np.nan), np.inf
    status, step, value = 0, np.nan, np.empty(0)
    problem = Flexible(scene, matrices[0])
    for matrix in matrices:
        degree = matrix.shape[0] - 1
        if iterations > 0:
            coarse = x
            x = np.empty(degree + 2)
            assign(x[:-1], resample(coarse[:-1], degree))
            x[-1] = coarse[-1]
        problem = Flexible(scene, on_contact(scene, matrix))
        status, count, step, value, _ = newton(problem, x, TOLERANCES[0], TOLERANCES[1], MAX_ITERATIONS)
        iterations += count
        if status != CONVERGED:
            status, count, step, value = from_frictionless(problem, x)
            iterations += count
            if status != CONVERGED:
                ending = NEWTON_FAILED
                break
        log_p, tau = residuals(problem, x[:-1], x[-1], value)
        found = compiled_ends(scene[TENSION_CD], x[0], log_p, tau)
        change, size, at_B = found - at_B, compiled_relative_change(found, at_B), found
        if size < PRECISION:
            ending = SETTLED
            break
    fields, unused = np.empty((3, degree + 1)), np.empty((2, degree + 1))
    assign(fields[0], x[:-1])
    quadratures(problem, x[:-1], x[-1], unused[0], fields[1], unused[1], fields[2])
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
def find(scene: Array, matrices: tuple[Array, ...]) -> Refined:
    """Solve one scene, `Dimensionless.vector`."""
    return refine(scene, matrices)


@compiled
def jacobian_matrix(problem: Flexible, x: Array) -> Array:
    """∂F/∂x at x, shape (n + 2, n + 2)."""
    matrix = np.empty((x.shape[0], x.shape[0]))
    jacobian(problem, x, matrix)
    return matrix


@compiled
def values(problem: Flexible, x: Values) -> tuple[Values, Any, Any]:
    """F(x), shape (n + 2,), and ln(p₃/p₃CD) and τ at B, from real or complex numbers."""
    value = np.empty_like(x)
    log_p, tau = residuals(problem, x[:-1], x[-1], value)
    return value, log_p, tau


@cache
def integration_matrices() -> tuple[Array, ...]:
    """The matrices that `find` takes."""
    return tuple(chebyshev_integration(degree) for degree in DEGREES)


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
    if settled and feedback(problem.vector) < STRONG_FEEDBACK:
        return solution(scene, NAME, found, (lambda: _fields(problem, found)) if profile else None)
    roots = find_roots(problem.vector)
    w = choose(scene, roots, rotation)
    if w is None:
        return failed(scene, NAME, Outcome.STICKING, Outcome.STICKING.value, found)
    others = several(scene, roots, w)
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
        return min(roots.w, key=lambda w: abs(w - wanted))
    return roots.settled if np.isfinite(roots.settled) else roots.w[0]


def several(scene: Scene, roots: Roots, taken: float) -> str:
    """The other solutions and how to get them; empty where there are none."""
    if len(roots.w) < 2:
        return ""
    unit = scene.delivery_speed / scene.cylinder_radius
    others = ", ".join(f"{w * unit:.6g}" for w in roots.w if w != taken)
    return f"n₁ = {taken * unit:.6g} /s; others at n₁ = {others} /s: solve with rotation= near one of them"


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
def find_rows(scenes: Array, matrices: tuple[Array, ...], table: Any) -> None:
    """Solve many scenes, `Dimensionless.vector` in each row, into a table of type ROW."""
    for i in range(scenes.shape[0]):
        record(refine(scenes[i].copy(), matrices), table[i])
