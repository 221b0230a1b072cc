"""A part of the benchmark's random scenes: every row ends in a right answer or a true outcome."""

import math
from collections import Counter
from dataclasses import replace

import pytest
from hard_cases import LARGEST_ERROR, bvp_outcome, check
from scenes import scene

from models.cosserat import solve_cosserat
from models.flexible import solve_flexible
from models.outcome import Outcome
from models.solve import MODELS
from pipeline.bench import random_scenes

SCENES = 40


@pytest.mark.parametrize(
    ("model", "scenes", "unknown"),
    [("flexible", SCENES, 0), ("cosserat", SCENES, 1), ("kirchhoff", SCENES, 1), ("kirchhoff-spans", 15, 0)],
)
def test_every_scene_ends_in_a_right_answer_or_a_true_outcome(model: str, scenes: int, unknown: int) -> None:
    outcomes: Counter[Outcome] = Counter()
    for problem in random_scenes(scenes):
        solution = MODELS[model](problem)
        outcomes[solution.outcome] += 1
        if solution.outcome.ok:
            assert check(solution) <= LARGEST_ERROR[model], problem
        else:
            assert math.isnan(solution.ends.tension_AB)
            assert len(solution.message) > 40
    assert outcomes[Outcome.NOT_CONVERGED] + outcomes[Outcome.SINGULAR] <= unknown, outcomes
    if model == "flexible":
        assert sum(n for outcome, n in outcomes.items() if outcome.ok) == scenes


def test_the_check_notices_a_wrong_solution() -> None:
    for model in LARGEST_ERROR:
        right = MODELS[model](scene()).require()
        assert check(right) < 1e-8
        profile = right.profile
        assert profile is not None
        wrong = replace(right, profile=replace(profile, theta=profile.theta + 1e-2 * profile.psi * (1 - profile.psi)))
        assert check(wrong) > LARGEST_ERROR[model]


def test_the_printed_models_fold_is_where_solutions_end() -> None:
    # More twist makes more extra tension, (B − K) τ², which makes more twist: beyond some friction there is no balance.
    problem = random_scenes(71)[70]
    found = solve_cosserat(problem)
    assert found.outcome is Outcome.FOLD
    fold = float(found.message.split("μ = ")[1].split(",")[0])
    assert fold < problem.friction
    assert solve_cosserat(replace(problem, friction=0.97 * fold)).outcome.ok
    assert solve_cosserat(replace(problem, friction=1.03 * fold)).outcome is Outcome.FOLD
    # Without the frame term (B = K) the same scene has a solution.
    assert solve_cosserat(replace(problem, rigidity_ratio=1.0)).outcome.ok


def test_what_solve_bvp_finds_is_held_against_all_solutions() -> None:
    scenes = random_scenes(7)
    assert bvp_outcome(scenes[0], solve_flexible(scenes[0])) == "converged"
    # To every tolerance it solves this one by a yarn that has turned past the axis, sinθ < 0.
    assert bvp_outcome(scenes[6], solve_flexible(scenes[6])) == "wrong"


def test_a_branch_through_yarn_under_compression_is_not_taken_for_the_solution() -> None:
    # At degree 12 the polynomial passes the fold, to a solution with p₃ < 0 that no degree settles on.
    found = solve_cosserat(random_scenes(191)[190])
    assert found.outcome is Outcome.FOLD


@pytest.mark.parametrize("index", [376, 417, 988])
def test_a_badly_settled_search_climbs_further(index: int) -> None:
    # At low degrees these settle to 1e-5 … 1e-4 only, with forces of 0.2 to 0.5 % of the tension left over.
    problem = random_scenes(index + 1)[index]
    found = solve_cosserat(problem)
    if index == 376:
        assert found.outcome is Outcome.FOLD
    else:
        assert check(found.require()) < 1e-6


def test_a_layer_and_the_solution_in_one_conjugate_pair_are_not_separated() -> None:
    found = solve_cosserat(random_scenes(220)[219])
    assert found.outcome is Outcome.NO_SCALE_SEPARATION
    assert "R = 1 on the solution" in found.message


@pytest.mark.parametrize("twist", [0.2, 0.3, 0.4, 0.5, 1.0])
def test_the_printed_model_lifts_off_where_its_frame_term_pulls_more_than_tension_presses(twist: float) -> None:
    # Without friction the yarn is a circle of constant tension and twist: N = p₃ + (B − K) τ², for B < K negative.
    found = solve_cosserat(scene(friction=0.0, rigidity_ratio=0.5, twist_CD=twist, tension_CD=2.0))
    normal = 2.0 - 0.5 * (2 * math.pi * twist) ** 2
    assert found.normal_force_min == pytest.approx(normal, rel=1e-9)
    assert found.outcome is (Outcome.CONVERGED if normal > 0 else Outcome.LIFT_OFF)
