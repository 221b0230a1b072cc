"""Continuation around folds, against folds with known parameter values."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scenes import scene

from models import kirchhoff
from models.continuation import End, Family, collocated_family, follow
from models.discretisation import chebyshev_collocation
from models.flexible import integration_matrices
from models.scene import FRICTION
from models.slow_manifold import ORDERS, collocation_matrices, find

BRATU_FOLD = 3.513830719125162
"""u'' + λ eᵘ = 0, u(0) = u(1) = 0: λ = 8 (s / cosh s)² at its maximum over s, s tanh s = 1."""


def bratu(values: np.ndarray, second: np.ndarray) -> Family:
    """The Bratu problem from the matrices that evaluate u and u'' at the inner points."""
    ends = np.eye(values.shape[1])[[0, -1]]

    def family(u: np.ndarray, parameter: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        with np.errstate(over="ignore"):
            source = np.exp(values @ u)
        value = np.append(second @ u + parameter * source, ends @ u)
        jacobian = np.vstack([second + parameter * source[:, None] * values, ends])
        return value, jacobian, np.append(source, [0.0, 0.0])

    return family


def bratu_collocation(degree: int) -> Family:
    matrices = chebyshev_collocation(degree, 1.0).nodal_derivatives
    return bratu(matrices[0][1:-1], matrices[2][1:-1])


def bratu_differences(intervals: int) -> Family:
    inner = np.eye(intervals + 1)[1:-1]
    second = (np.roll(inner, 1, axis=1) - 2 * inner + np.roll(inner, -1, axis=1)) * intervals**2
    return bratu(inner, second)


def parabola(x: np.ndarray, parameter: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """λ = 1 − x²: a branch from x = −1 that turns back at λ = 1."""
    return np.array([x[0] ** 2 + parameter - 1]), np.array([[2 * x[0]]]), np.array([1.0])


def s_curve(x: np.ndarray, parameter: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """λ = x³ − 3x: folds at (−1, 2) and (1, −2), and a branch that goes on beyond both."""
    return np.array([x[0] ** 3 - 3 * x[0] - parameter]), np.array([[3 * x[0] ** 2 - 3]]), np.array([-1.0])


def test_a_scalar_fold_is_where_it_is_known_to_be() -> None:
    branch = follow(parabola, np.array([-1.0]), 0.0, 2.0)
    assert branch.end is End.TURNED
    assert branch.folds[0].parameter == pytest.approx(1.0, abs=1e-12)
    assert branch.folds[0].x[0] == pytest.approx(0.0, abs=1e-6)


def test_a_branch_that_turns_twice_reaches_the_target() -> None:
    branch = follow(s_curve, np.array([-2.1]), -2.961, 3.0)
    assert branch.end is End.REACHED
    assert [fold.parameter for fold in branch.folds] == pytest.approx([2.0, -2.0], abs=1e-12)
    assert branch.x[0] ** 3 - 3 * branch.x[0] == pytest.approx(3.0, abs=1e-12)
    assert branch.x[0] > 1


def test_without_a_fold_no_arc_is_needed() -> None:
    branch = follow(parabola, np.array([-1.0]), 0.0, -8.0)
    assert branch.end is End.REACHED
    assert not branch.folds
    assert branch.x[0] == pytest.approx(-3.0, abs=1e-14)


def test_the_bratu_fold_is_found_to_twelve_digits() -> None:
    branch = follow(bratu_collocation(24), np.zeros(25), 0.0, 5.0)
    assert branch.folds[0].parameter == pytest.approx(BRATU_FOLD, abs=1e-11)


def test_the_bratu_fold_converges_exponentially_by_collocation() -> None:
    errors = [
        abs(follow(bratu_collocation(n), np.zeros(n + 1), 0.0, 5.0).folds[0].parameter - BRATU_FOLD)
        for n in (8, 12, 16)
    ]
    assert all(later < earlier / 100 for earlier, later in pairwise(errors)), errors


def test_the_bratu_fold_converges_with_order_2_by_differences() -> None:
    errors = [
        abs(follow(bratu_differences(n), np.zeros(n + 1), 0.0, 5.0).folds[0].parameter - BRATU_FOLD)
        for n in (10, 20, 40)
    ]
    orders = [math.log2(earlier / later) for earlier, later in pairwise(errors)]
    assert orders == pytest.approx([2, 2], abs=0.02)


def test_values_that_are_not_finite_end_in_words_not_in_an_exception() -> None:
    def broken(x: np.ndarray, parameter: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        value, jacobian, slope = parabola(x, parameter)
        return (value, jacobian, slope) if parameter < 0.5 else (value * np.nan, jacobian, slope)

    branch = follow(broken, np.array([-1.0]), 0.0, 2.0)
    assert branch.end is End.STALLED
    assert 0.4 < branch.parameter < 0.5


def test_a_collocated_problem_in_its_friction_reaches_the_direct_solution() -> None:
    problem = scene().dimensionless()
    direct = find(kirchhoff.Consistent(problem.vector), integration_matrices(), collocation_matrices())
    degree = direct.degree
    grid = chebyshev_collocation(degree, problem.wrap_angle)
    circle = np.outer([np.pi / 2, 1.0, 2 * np.pi * problem.twist_CD], np.ones(degree + 1))
    start = np.append(circle, problem.twist_rotation(problem.twist_CD))
    family = collocated_family(kirchhoff.Consistent, problem.vector, FRICTION, ORDERS, grid)
    branch = follow(family, start, 0.0, problem.friction)
    assert branch.end is End.REACHED
    np.testing.assert_allclose(branch.x, np.append(direct.fields, direct.w), atol=1e-8)
    h = 1e-6
    difference = (family(start, 0.3 + h)[0] - family(start, 0.3 - h)[0]) / (2 * h)
    np.testing.assert_allclose(family(start, 0.3)[2], difference, atol=1e-8)
