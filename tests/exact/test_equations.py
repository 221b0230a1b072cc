"""The pointwise equations against symbolic or geometric truth, apart from any solver."""

import numpy as np
import pytest
from scenes import scene

from models import cosserat, flexible, kirchhoff
from models.boundary_value import Collocated, evaluated, linearised
from models.compiled import compiled
from models.complex_step import COMPLEX_STEP, reciprocal, sine_cosine, square_root
from models.discretisation import chebyshev_collocation, chebyshev_integration
from models.slow_manifold import ORDERS, normal_forces

PSI = np.linspace(0.1, 0.9, 7)


RING = np.array([[np.pi / 2, 0, 0, 0, 1, 0, 9, 0]])
"""A point of a planar ring: θ = 90°, p₃ = p₃CD, τ = 9."""


def smooth_fields() -> np.ndarray:
    """θ, p₃/p₃CD and τ as known functions with their exact derivatives, shape (8, 7)."""
    theta = [1.5 + 0.3 * np.sin(PSI), 0.3 * np.cos(PSI), -0.3 * np.sin(PSI), -0.3 * np.cos(PSI)]
    tension = [1 + 0.2 * PSI**2, 0.4 * PSI]
    tau = [7 + np.cos(2 * PSI), -2 * np.sin(2 * PSI)]
    return np.array([*theta, *tension, *tau])


def test_shear_and_its_derivative_match_differences_of_the_curvature() -> None:
    # κ', κ'' in the code are expanded by hand; here they come from central differences of κ alone.
    p1 = cosserat.balance(scene().dimensionless().vector, smooth_fields())[2]

    def kappa(psi: np.ndarray) -> np.ndarray:
        theta, slope = 1.5 + 0.3 * np.sin(psi), 0.3 * np.cos(psi)
        return np.sin(theta) * np.sqrt(slope**2 + np.sin(theta) ** 2)

    h = 1e-5
    dkappa = (kappa(PSI + h) - kappa(PSI - h)) / (2 * h)
    np.testing.assert_allclose(p1, -1.3 * np.sin(1.5 + 0.3 * np.sin(PSI)) * dkappa / 600, rtol=1e-8)


def test_balance_of_the_printed_model_matches_differences() -> None:
    # N and E1 rebuilt from p₁, p₂ as functions of ψ, differentiated numerically.
    d = scene().dimensionless()
    B, unit = d.bending_rigidity, 1 / d.tension_CD

    def shears(psi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        theta = 1.5 + 0.3 * np.sin(psi)
        d1, d2 = 0.3 * np.cos(psi), -0.3 * np.sin(psi)
        sine, cosine = np.sin(theta), np.cos(theta)
        S = np.sqrt(d1**2 + sine**2)
        dkappa = d1 * (d2 * sine + d1**2 * cosine + 2 * sine**2 * cosine) / S
        return -unit * B * sine * dkappa, -unit * (B - 1) * sine * S * (7 + np.cos(2 * psi)), sine, S

    h = 1e-5
    dp1, dp2 = ((shears(PSI + h)[k] - shears(PSI - h)[k]) / (2 * h) for k in (0, 1))
    p1, p2, sine, S = shears(PSI)
    tau, tension, d1 = 7 + np.cos(2 * PSI), 1 + 0.2 * PSI**2, 0.3 * np.cos(PSI)
    X, Y = sine * dp1 - p2 * tau + tension * sine * S, sine * dp2 + p1 * tau
    across, normal, *_ = cosserat.balance(d.vector, smooth_fields())
    np.testing.assert_allclose(normal, sine / S * X + d1 / S * Y, rtol=1e-7)
    np.testing.assert_allclose(across, -d1 / S * X + sine / S * Y, rtol=1e-7, atol=1e-9)


def test_a_twisted_ring_presses_with_tension_over_radius() -> None:
    # Planar circle θ = 90°: N = p₃/r₀ whatever the twist, exactly, for the consistent rod.
    normal = normal_forces(kirchhoff.Consistent(scene().dimensionless().vector), RING)
    np.testing.assert_allclose(normal, 600.0, rtol=1e-14)


def test_the_printed_model_adds_a_twist_term_to_the_ring() -> None:
    # The same ring in the printed equations: N = p₃ + (B − K) τ², the term that physics.md section 5 names.
    normal = normal_forces(cosserat.Printed(scene().dimensionless().vector), RING)
    np.testing.assert_allclose(normal, 600.0 + 0.3 * 81.0, rtol=1e-14)


def check_jacobian(matrix: np.ndarray, residual, x: np.ndarray) -> None:
    direction = np.random.default_rng(7).standard_normal(x.size)
    h = 1e-6
    difference = (residual(x + h * direction) - residual(x - h * direction)) / (2 * h)
    np.testing.assert_allclose(matrix @ direction, difference, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("problem", [cosserat.Printed, kirchhoff.Consistent])
def test_jacobians_of_the_rods_are_exact(problem) -> None:
    grid = chebyshev_collocation(6, 1.0)
    fields = np.array([1.4 + 0.2 * grid.nodes, 1 + 0.1 * grid.nodes, 7 + grid.nodes**2])
    x = np.append(fields, 1.1)
    collocated = Collocated(problem(scene().dimensionless().vector), ORDERS, grid.derivatives)
    check_jacobian(evaluated(collocated, x)[1], lambda x: evaluated(collocated, x)[0], x)


@pytest.mark.parametrize(("model", "problem"), [(cosserat, cosserat.Printed), (kirchhoff, kirchhoff.Consistent)])
def test_slopes_at_a_point_are_those_of_one_argument_at_a_time(model, problem) -> None:
    given, w = problem(scene().dimensionless().vector), 1.1
    point = np.array([1.3, 0.2, -0.4, 0.3, 0.9, -0.2, 7.0, 0.6])
    values, slopes = linearised(given, point[None], w, 3)
    np.testing.assert_allclose(values[0], model.equations(given, point, w), rtol=1e-14)
    for a in range(point.size):
        moved = point + 1j * COMPLEX_STEP * (np.arange(point.size) == a)
        one = np.array(model.equations(given, moved, complex(w))).imag / COMPLEX_STEP
        np.testing.assert_allclose(slopes[0, :, a], one, rtol=1e-13, atol=1e-14)


def test_jacobian_of_the_flexible_yarn_is_exact() -> None:
    problem = flexible.Flexible(scene().dimensionless().vector, chebyshev_integration(8) / 2)
    x = np.append(np.linspace(-0.4, 0.5, 9), 1.1)
    check_jacobian(evaluated(problem, x)[1], lambda x: evaluated(problem, x)[0], x)


@compiled
def first_order(x):
    """Sine, cosine, root and reciprocal as compiled code picks them by type."""
    sine, cosine = sine_cosine(x)
    return sine, cosine, square_root(x), reciprocal(x)


@pytest.mark.parametrize("x", [0.3, 1.7, 25.0])
def test_first_order_arithmetic_is_that_of_complex_numbers(x: float) -> None:
    moved = x + 3j * COMPLEX_STEP
    with np.errstate(under="ignore"):
        right = np.array([np.sin(moved), np.cos(moved), np.sqrt(moved), 1 / moved])
    found = np.array(first_order(moved))
    np.testing.assert_allclose(found.real, right.real, rtol=1e-15)
    np.testing.assert_allclose(found.imag, right.imag, rtol=1e-15)
    np.testing.assert_array_equal(first_order(x), [np.sin(x), np.cos(x), np.sqrt(x), 1 / x])
