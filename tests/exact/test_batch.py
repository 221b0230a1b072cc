"""Many scenes at once give what one scene at a time gives, and keep every row."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import scene, table_1

from models.batch import Batch, solve_many
from models.outcome import Outcome
from models.scene import Scene
from models.solve import MODELS
from pipeline.bench import random_scenes

TABLE_1 = [table_1(case) for case in (1, 2, 3)]


def inputs(scenes: list[Scene]) -> dict[str, np.ndarray]:
    return {name: np.array([getattr(s, name) for s in scenes]) for name in Scene.__slots__}


@pytest.mark.parametrize("model", list(MODELS))
def test_a_batch_gives_the_numbers_of_single_solves(model: str) -> None:
    batch = solve_many(inputs(TABLE_1), model)
    for i, single in enumerate(MODELS[model](s) for s in TABLE_1):
        assert batch.outcomes[i] is single.outcome
        assert batch.messages[i] == single.message
        found = [batch.tension_AB[i], batch.twist_AB[i], batch.theta_B[i], batch.rotation[i], batch.normal_force_min[i]]
        ends = single.ends
        expected = [ends.tension_AB, ends.twist_AB, ends.theta_B, single.rotation, single.normal_force_min]
        np.testing.assert_allclose(found, expected, rtol=1e-12)
        np.testing.assert_allclose(batch.u_theta_B[i], single.u_num.theta_B, rtol=1e-6, atol=1e-15)


@pytest.mark.parametrize("model", ["capstan", "flexible", "cosserat", "kirchhoff"])
def test_hard_rows_end_as_single_solves_do(model: str) -> None:
    scenes = random_scenes(30)
    batch = solve_many(inputs(scenes), model)
    for i, single in enumerate(MODELS[model](s, profile=False) for s in scenes):
        assert (batch.outcomes[i], batch.messages[i]) == (single.outcome, single.message)
        np.testing.assert_allclose(batch.theta_B[i], single.ends.theta_B, rtol=1e-9)


def test_single_numbers_hold_for_all_rows_and_defaults_need_not_be_given() -> None:
    given = {name: getattr(TABLE_1[0], name) for name in Scene.__slots__}
    given["friction"] = np.array([0.5, 0.81])
    del given["span_ratio"]
    batch = solve_many(given, "flexible")
    assert batch.tension_AB.shape == (2,)
    assert batch.tension_AB[1] == pytest.approx(MODELS["flexible"](TABLE_1[0]).ends.tension_AB, rel=1e-12)


def test_rows_that_are_no_scene_keep_their_place_and_say_why() -> None:
    given = inputs(TABLE_1)
    given["friction"][1] = -0.2
    given["tension_CD"][2] = math.nan
    batch = solve_many(given, "flexible")
    assert [outcome.name for outcome in batch.outcomes] == ["CONVERGED", "BAD_INPUT", "BAD_INPUT"]
    assert batch.messages[1] == "friction = -0.2: must be 0 or greater"
    assert "tension_CD" in batch.messages[2]
    assert np.all(np.isnan(batch.tension_AB[1:]))
    assert np.isfinite(batch.tension_AB[0])


def test_a_failed_row_has_no_numbers() -> None:
    folded = random_scenes(71)[70]
    batch = solve_many(inputs([folded, scene()]), "cosserat")
    assert batch.outcomes == (Outcome.FOLD, Outcome.CONVERGED)
    assert batch.messages[0] == MODELS["cosserat"](folded).message
    assert math.isnan(batch.tension_AB[0])


@settings(max_examples=10, deadline=None)
@given(st.permutations(range(40)), st.integers(1, 3))
def test_the_order_of_rows_and_the_number_of_threads_do_not_matter(order: list[int], threads: int) -> None:
    scenes = [scene(wrap_angle=0.3 + 0.03 * i, friction=0.2 + 0.02 * i) for i in range(40)]
    straight = solve_many(inputs(scenes), "flexible", threads=1)
    mixed = solve_many(inputs([scenes[i] for i in order]), "flexible", threads=threads)
    np.testing.assert_array_equal(mixed.tension_AB, straight.tension_AB[list(order)])


def test_progress_adds_up_to_the_rows() -> None:
    done: list[int] = []
    count = 1000
    given = inputs([scene()] * count)
    batch: Batch = solve_many(given, "capstan", progress=done.append)
    assert sum(done) == count
    assert len(batch.messages) == count


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frction": 1.0}, "unknown input 'frction'"),
        ({"friction": np.ones(4)}, "different lengths"),
        ({"friction": np.ones((3, 1))}, "one scene per row"),
    ],
)
def test_wrong_calls_say_what_is_wrong(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        solve_many({**inputs(TABLE_1), **change}, "flexible")


def test_a_missing_input_is_named() -> None:
    given = inputs(TABLE_1)
    del given["tension_CD"]
    with pytest.raises(ValueError, match="input 'tension_CD' is missing"):
        solve_many(given, "flexible")
