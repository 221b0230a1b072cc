"""The consistent rod with elastic free spans: limits, convergence and its conditions at lift-off."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scenes import scene, table_1

from models.boundary_value import solve
from models.discretisation import chebyshev_collocation
from models.flexible import solve_flexible
from models.kirchhoff_spans import ORDERS, Spans, find, solve_kirchhoff_spans
from models.outcome import Outcome
from models.refinement import Refined
from models.scene import Scene
from models.self_consistency import find_roots
from pipeline.bench import random_scenes


def found(problem: Scene) -> Refined:
    """The five fields of a scene that has a solution."""
    result, _ = find(problem)
    assert isinstance(result, Refined)
    return result


def test_without_friction_the_yarn_is_a_circle() -> None:
    circle = solve_kirchhoff_spans(scene(friction=0.0)).require()
    assert circle.ends.tension_AB == pytest.approx(600.0, rel=1e-12)
    assert circle.ends.theta_B == pytest.approx(math.pi / 2, abs=1e-12)
    assert circle.normal_force_min == pytest.approx(600.0, rel=1e-11)


def test_high_tension_recovers_the_flexible_yarn() -> None:
    # The layer at B turns the yarn by about λ θ', so that θ_B differs as p₃^(−1/2), the far-field angle less.
    differences = []
    for tension in (1e3, 1e4, 1e5):
        problem = scene(tension_CD=tension, yarn_radius=18 / tension)
        rod, yarn = solve_kirchhoff_spans(problem).require().ends, solve_flexible(problem).require().ends
        differences.append([abs(rod.theta_B - yarn.theta_B), abs(rod.tension_AB / yarn.tension_AB - 1)])
    orders = np.diff(np.log10(differences), axis=0)
    assert orders[:, 0] == pytest.approx([-0.5, -0.5], abs=0.15)
    assert np.all(orders[:, 1] < -0.5)


def test_collocation_converges_exponentially_once_the_layers_are_resolved() -> None:
    problem = scene().dimensionless()
    exact = found(scene())
    errors = []
    for n in (12, 16, 20, 24):
        grid = chebyshev_collocation(n, problem.wrap_angle)
        start = np.polynomial.chebyshev.chebfit(
            chebyshev_collocation(exact.degree, problem.wrap_angle).nodes * 2 / problem.wrap_angle - 1,
            exact.fields.T,
            n,
        )
        fields = np.polynomial.chebyshev.chebval(grid.nodes * 2 / problem.wrap_angle - 1, start)
        trial = solve(Spans(problem.vector), ORDERS, grid, fields, exact.w)
        errors.append(float(np.max(np.abs(trial.fields[[0, 3, 4], 0] - exact.fields[[0, 3, 4], 0]))))
    assert all(later < earlier / 10 for earlier, later in pairwise(errors)), errors


@pytest.mark.parametrize("case", [1, 2, 3])
def test_the_spans_conditions_hold_at_table_1(case: int) -> None:
    problem = table_1(case)
    d = problem.dimensionless()
    result = found(problem)
    theta, theta_s, theta_ss, tension, _ = result.fields[:, [0, -1]]
    length = np.sqrt(d.bending_rigidity / (d.tension_CD * tension))
    assert theta_ss * length == pytest.approx(theta_s * [1, -1], abs=1e-10)
    far = theta - [1, -1] * length * theta_s
    assert np.sum(np.cos(far)) == pytest.approx(0.0, abs=1e-12)
    # Layers change the ends little: within 1 % in tension and twist of the yarn without bending.
    yarn, rod = solve_flexible(problem).ends, solve_kirchhoff_spans(problem).require().ends
    assert rod.tension_AB == pytest.approx(yarn.tension_AB, rel=0.01)
    assert rod.twist_AB == pytest.approx(yarn.twist_AB, rel=0.01)


def test_a_soft_rod_ends_at_a_fold_in_the_friction() -> None:
    # λ is half the contact here: what friction turns is not held by tension.
    problem = random_scenes(78)[77]
    found = solve_kirchhoff_spans(problem)
    assert found.outcome is Outcome.FOLD
    fold = float(found.message.split("μ = ")[1].split(",")[0])
    assert fold < problem.friction
    assert solve_kirchhoff_spans(replace(problem, friction=0.97 * fold)).outcome.ok


def test_layers_too_thin_for_the_polynomials_are_told() -> None:
    found = solve_kirchhoff_spans(random_scenes(47)[46])
    assert found.outcome is Outcome.UNRESOLVED
    assert "kirchhoff leaves layers out" in found.message


def test_each_of_several_solutions_can_be_had() -> None:
    problem = scene(cylinder_speed_ratio=0.2, tension_CD=6000.0)
    taken = solve_kirchhoff_spans(problem)
    assert taken.outcome is Outcome.SEVERAL_SOLUTIONS
    unit = problem.delivery_speed / problem.cylinder_radius
    rotations = [w * unit for w in find_roots(problem.dimensionless().vector).w]
    found = [solve_kirchhoff_spans(problem, rotation=rotation).require().rotation for rotation in rotations]
    assert found == pytest.approx(rotations, rel=0.05, abs=0.05 * max(map(abs, rotations)))
    assert len({f"{rotation:.6g}" for rotation in found}) == len(rotations)
