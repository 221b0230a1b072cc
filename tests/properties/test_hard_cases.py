"""A part of the benchmark's random scenes: every row ends in a right answer or a true outcome."""

import math
from collections import Counter
from dataclasses import replace

import pytest
from hard_cases import LARGEST_ERROR, check
from scenes import scene

from models.cosserat import solve_cosserat
from models.outcome import Outcome
from models.solve import MODELS
from pipeline.bench import random_scenes

SCENES = 40


@pytest.mark.parametrize(("model", "unknown"), [("flexible", 0), ("cosserat", 1), ("kirchhoff", 1)])
def test_every_scene_ends_in_a_right_answer_or_a_true_outcome(model: str, unknown: int) -> None:
    outcomes: Counter[Outcome] = Counter()
    for problem in random_scenes(SCENES):
        solution = MODELS[model](problem)
        outcomes[solution.outcome] += 1
        if solution.outcome.ok:
            assert check(solution) <= LARGEST_ERROR[model], problem
        else:
            assert math.isnan(solution.ends.tension_AB)
            assert len(solution.message) > 40
    assert outcomes[Outcome.NOT_CONVERGED] + outcomes[Outcome.SINGULAR] <= unknown, outcomes
    if model == "flexible":
        assert sum(n for outcome, n in outcomes.items() if outcome.ok) == SCENES


def test_the_check_notices_a_wrong_solution() -> None:
    for model in ("flexible", "cosserat", "kirchhoff"):
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
