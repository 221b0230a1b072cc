"""All solutions of the flexible yarn by its scalar equation for n₁: thresholds in closed form, branches, sticking."""

import math
from itertools import pairwise

import pytest
from scenes import scene, table_1

from models.flexible import find, integration_matrices, solve_flexible
from models.outcome import Outcome
from models.scene import Scene
from models.self_consistency import find_roots


def at_rest(feedback_ratio: float) -> Scene:
    """Cylinder at rest, no twist from D; Γ is the given multiple of 1 + η R₀ μφ, where the pitchfork is."""
    mu_phi, radius = 0.8 * math.pi / 3, 0.03
    tension = feedback_ratio * (1 + radius * mu_phi) / (radius**2 * -math.expm1(-mu_phi))
    return scene(cylinder_speed_ratio=0.0, twist_CD=0.0, tension_CD=tension)


def test_the_root_is_the_collocated_solution() -> None:
    for problem in (scene(), table_1(1), table_1(2), table_1(3)):
        vector = problem.dimensionless().vector
        roots = find_roots(vector)
        assert roots.w == pytest.approx([find(vector, integration_matrices()).w], rel=1e-10)
        assert roots.settled == roots.w[0]
        assert not roots.sticking


def test_a_second_solution_begins_where_theory_says() -> None:
    # G'(0) = 1 − Γ + η R₀ μφ changes its sign: one solution below, three above, two of them mirror images.
    assert find_roots(at_rest(0.99).dimensionless().vector).w == pytest.approx([0.0], abs=1e-9)
    low, middle, high = find_roots(at_rest(1.01).dimensionless().vector).w
    assert middle == pytest.approx(0.0, abs=1e-9)
    assert high == pytest.approx(-low, rel=1e-6)
    assert high > 0.1


def test_one_of_several_solutions_is_taken_and_the_others_can_be_had() -> None:
    problem = scene(cylinder_speed_ratio=0.2, tension_CD=6000.0)
    taken = solve_flexible(problem)
    assert taken.outcome is Outcome.SEVERAL_SOLUTIONS
    assert taken.outcome.ok
    roots = find_roots(problem.dimensionless().vector)
    assert taken.rotation == pytest.approx(roots.settled)
    for w in roots.w:
        other = solve_flexible(problem, rotation=w)
        assert other.rotation == pytest.approx(w, rel=1e-9)
        assert f"{w:.6g}" in taken.message
        assert "ask for n₁ near one of them" in other.message


def test_raising_the_friction_leads_to_the_settled_solution() -> None:
    # The branch from no friction, in small steps of μ, each from its own solve: no jump.
    values = [
        solve_flexible(scene(cylinder_speed_ratio=0.2, tension_CD=6000.0, friction=0.8 * k / 40)).rotation
        for k in range(1, 41)
    ]
    steps = [abs(b - a) for a, b in pairwise(values)]
    assert max(steps) < 0.25 * max(map(abs, values))


def test_a_yarn_that_must_stick_is_told_so() -> None:
    # η < 0: G jumps over zero where the yarn rests on the surface.
    problem = scene(
        wrap_angle=3.82, friction=0.851, cylinder_speed_ratio=7.65, twist_CD=0.0, tension_CD=690.0, yarn_radius=0.296,
        twist_trapping=0.311, twist_congestion=-1.42, span_ratio=5.94,
    )  # fmt: skip
    roots = find_roots(problem.dimensionless().vector)
    assert roots.sticking
    assert not roots.w
    solution = solve_flexible(problem)
    assert solution.outcome is Outcome.STICKING
    assert math.isnan(solution.ends.tension_AB)
