"""Observed orders of convergence and the plateau of the slow manifold."""

from itertools import pairwise

import numpy as np
import pytest
from scenes import scene, table_1

from models import flexible
from models.boundary_value import solve
from models.cosserat import Printed, solve_cosserat
from models.cosserat_fd import INTERVALS, solve_cosserat_fd
from models.discretisation import chebyshev_collocation, finite_differences, integrals, interpolation
from models.outcome import Solution
from models.scene import Scene
from models.slow_manifold import ORDERS


def ends(found: Solution) -> np.ndarray:
    e = found.require().ends
    return np.array([e.tension_AB, e.twist_AB, e.theta_B])


def test_finite_differences_converge_with_order_2() -> None:
    reference = ends(solve_cosserat(scene()))
    grids = [10, 20, 40, 80]
    errors = np.array([np.abs(ends(solve_cosserat_fd(scene(), n)) - reference) for n in grids])
    slopes = np.polyfit(np.log(grids), np.log(errors), 1)[0]
    np.testing.assert_allclose(slopes, -2, atol=0.15)


@pytest.mark.parametrize("case", [1, 2, 3])
def test_finite_differences_converge_with_order_2_on_table_1(case: int) -> None:
    reference = ends(solve_cosserat(table_1(case)))
    errors = [np.abs(ends(solve_cosserat_fd(table_1(case), n)) - reference) for n in (10, 20, 40)]
    orders = np.log2(errors[0] / errors[2]) / 2
    assert np.all(orders[:2] > 1.7), orders  # tension and twist; the angle is within 1e-4 from the start
    assert errors[1][2] < 1e-4
    assert errors[2][2] < errors[1][2]


def test_finite_difference_error_estimate_covers_the_error() -> None:
    for case in (1, 2, 3):
        fd, reference = solve_cosserat_fd(table_1(case)), solve_cosserat(table_1(case))
        error = np.abs(ends(fd) - ends(reference))
        stated = np.array([fd.u_num.tension_AB, fd.u_num.twist_AB, fd.u_num.theta_B])
        assert np.all(error < 3 * stated), (error, stated)
    assert INTERVALS == 40


def test_flexible_quadratures_converge_exponentially() -> None:
    vector = scene().dimensionless().vector
    reference = flexible.find(vector, flexible.integration_matrices()).ends
    errors = []
    for degree in (4, 8, 12, 16):
        # Every rung of the search has the same degree: it settles at the second.
        found = flexible.find(vector, integrals((degree, degree)))
        assert found.degree == degree
        errors.append(np.max(np.abs(found.ends / reference - 1)))
    # Each four degrees more gain at least a factor of 50 until rounding.
    assert all(later < max(earlier / 50, 1e-13) for earlier, later in pairwise(errors)), errors


@pytest.mark.parametrize("problem", [scene(), table_1(1), table_1(2), table_1(3)])
def test_slow_manifold_converges_to_a_plateau(problem: Scene) -> None:
    found = solve_cosserat(problem).require()
    relative = np.array([found.u_num.tension_AB, found.u_num.twist_AB, found.u_num.theta_B]) / ends(found)
    assert np.all(relative < 1e-7)
    assert found.stats.residual < 1e-9
    assert found.stats.boundary_residual < 1e-12


def test_more_nodes_are_not_more_accuracy() -> None:
    # The trap: past the plateau the layers enter and the Jacobian's condition number explodes.
    problem = table_1(1)
    d = problem.dimensionless()
    yarn = flexible.find(d.vector, flexible.integration_matrices())
    nodal = np.array([2 * np.arctan(np.exp(yarn.fields[0])), np.exp(yarn.fields[1]), yarn.fields[2]])
    condition = {}
    for degree in (8, 30):
        grid = chebyshev_collocation(degree, problem.wrap_angle)
        start = nodal @ interpolation(yarn.degree, degree).T
        found = solve(Printed(d.vector), ORDERS, grid, start, yarn.w)
        condition[degree] = found.condition
    assert condition[8] < 1e6
    assert condition[30] > 1e12


@pytest.mark.parametrize("closed_at_start", [True, False])
def test_difference_matrices_have_second_order(closed_at_start: bool) -> None:
    errors = []
    for n in (40, 80):
        grid = finite_differences(n, 2.0, closed_at_start=closed_at_start)
        error = [np.max(np.abs(grid.derivatives[k] @ np.exp(grid.nodes) - np.exp(grid.points))) for k in (1, 2, 3)]
        errors.append(error)
    orders = np.log2(np.array(errors[0]) / np.array(errors[1]))
    np.testing.assert_allclose(orders, 2, atol=0.2)
