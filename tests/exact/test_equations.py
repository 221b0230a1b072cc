"""The pointwise equations against symbolic or geometric truth, apart from any solver."""

import numpy as np
from scenes import scene

from models.boundary_value import assemble
from models.cosserat import CosseratProblem
from models.discretisation import chebyshev_collocation
from models.flexible import FlexibleProblem
from models.kirchhoff import KirchhoffProblem

PSI = np.linspace(0.1, 0.9, 7)


def smooth_fields() -> list[list[np.ndarray]]:
    """θ, p₃/p₃CD and τ as known functions with their exact derivatives."""
    theta = [1.5 + 0.3 * np.sin(PSI), 0.3 * np.cos(PSI), -0.3 * np.sin(PSI), -0.3 * np.cos(PSI)]
    tension = [1 + 0.2 * PSI**2, 0.4 * PSI]
    tau = [7 + np.cos(2 * PSI), -2 * np.sin(2 * PSI)]
    return [theta, tension, tau]


def test_shear_and_its_derivative_match_differences_of_the_curvature() -> None:
    # κ', κ'' in the code are expanded by hand; here they come from central differences of κ alone.
    problem = CosseratProblem(scene().dimensionless())
    p1 = problem.balance(smooth_fields(), np.array(1.2))[2]

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
    _, normal, *_ = CosseratProblem(d).balance(smooth_fields(), np.array(1.2))
    np.testing.assert_allclose(normal, sine / S * X + d1 / S * Y, rtol=1e-7)


def test_a_twisted_ring_presses_with_tension_over_radius() -> None:
    # Planar circle θ = 90°: N = p₃/r₀ whatever the twist, exactly, for the consistent rod.
    flat = [[np.full(5, np.pi / 2), *[np.zeros(5)] * 3], [np.ones(5), np.zeros(5)], [np.full(5, 9.0), np.zeros(5)]]
    normal = KirchhoffProblem(scene().dimensionless()).normal_force(flat, 1.0)
    np.testing.assert_allclose(normal, 600.0, rtol=1e-14)


def test_the_printed_model_adds_a_twist_term_to_the_ring() -> None:
    # The same ring in the printed equations: N = p₃ + (B − K) τ², the term that physics.md section 5 names.
    flat = [[np.full(5, np.pi / 2), *[np.zeros(5)] * 3], [np.ones(5), np.zeros(5)], [np.full(5, 9.0), np.zeros(5)]]
    normal = CosseratProblem(scene().dimensionless()).normal_force(flat, 1.0)
    np.testing.assert_allclose(normal, 600.0 + 0.3 * 81.0, rtol=1e-14)


def test_jacobians_are_exact() -> None:
    rng = np.random.default_rng(7)
    grid = chebyshev_collocation(6, 1.0)
    for problem in (
        FlexibleProblem(scene().dimensionless()),
        CosseratProblem(scene().dimensionless()),
        KirchhoffProblem(scene().dimensionless()),
    ):
        fields = np.array([1.4 + 0.2 * grid.nodes, 1 + 0.1 * grid.nodes, 7 + grid.nodes**2])
        _, jacobian = assemble(problem, grid, fields, 1.1)
        direction = rng.standard_normal(fields.size + 1)
        h = 1e-6

        def along(step: float, problem=problem, fields=fields, direction=direction) -> np.ndarray:
            moved = fields + step * direction[:-1].reshape(fields.shape)
            return assemble(problem, grid, moved, 1.1 + step * direction[-1])[0]

        difference = (along(h) - along(-h)) / (2 * h)
        np.testing.assert_allclose(jacobian @ direction, difference, rtol=1e-5, atol=1e-6)
