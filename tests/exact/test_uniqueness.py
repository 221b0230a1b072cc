"""The proof that a flexible yarn has one solution only: its bounds hold, and it proves no scene that has several."""

import numpy as np
import pytest
from scenes import scene, table_1

from models.flexible import solve_flexible
from models.outcome import Outcome
from models.scene import Scene
from models.self_consistency import TOLERANCE, find_roots, mismatch
from models.uniqueness import Enclosure, enclosure, feedback_bounds, perhaps_several
from pipeline.bench import random_scenes

SCENES = 150


def vectors(scenes: list[Scene]) -> np.ndarray:
    return np.array([problem.dimensionless().vector for problem in scenes])


def measured_slope(vector: np.ndarray, w: float) -> float:
    """H'(w) = 1 − G'(w) by a central difference."""
    step = 1e-5 * (1 + abs(w))
    above, below = (mismatch(vector, w + sign * step, 0.0, TOLERANCE)[0] for sign in (1, -1))
    return 1 - (above - below) / (2 * step)


def test_the_published_cases_are_proven() -> None:
    assert not any(perhaps_several(table_1(case).dimensionless().vector) for case in (1, 2, 3))


def test_a_scene_with_several_solutions_is_never_proven() -> None:
    scenes = random_scenes(SCENES)
    found = vectors(scenes)
    proven = feedback_bounds(found) < 1
    assert 0.3 * SCENES < np.sum(proven) < 0.7 * SCENES
    counts = np.array([len(find_roots(vector).w) for vector in found])
    assert np.all(counts[proven] == 1)
    assert np.sum(counts > 1) > 10  # so that the line above is no accident


def test_the_bound_is_above_the_slope_at_every_solution() -> None:
    found = vectors(random_scenes(SCENES))
    bounds = feedback_bounds(found)
    ratios = []
    for vector, bound in zip(found, bounds, strict=True):
        for w in find_roots(vector).w if np.isfinite(bound) else ():
            slope = measured_slope(vector, w)
            assert slope <= bound + 1e-6
            ratios.append(bound / max(slope, 1e-6))
    assert len(ratios) > 30
    assert min(ratios) < 3  # nor is it far above everywhere


def test_the_bound_nears_the_threshold_of_the_pitchfork() -> None:
    # Cylinder at rest, no twist from D, small μφ: H'(0) = Γ − η R₀ μφ, and the bound comes down to it with μφ.
    for friction in (0.1, 0.01):
        problem = scene(cylinder_speed_ratio=0.0, twist_CD=0.0, friction=friction)
        vector = problem.dimensionless().vector
        turn, radius = friction * problem.wrap_angle, 0.03
        slope = radius**2 * 600 * -np.expm1(-turn) - radius * turn
        assert measured_slope(vector, 0.0) == pytest.approx(slope, rel=1e-4)
        assert slope <= feedback_bounds(vector[None])[0] <= slope * (1 + 3 * turn) + 2 * radius * turn


def test_solutions_lie_in_their_enclosure() -> None:
    narrow = 0
    for problem in random_scenes(SCENES):
        found, d = solve_flexible(problem), problem.dimensionless()
        bounds = Enclosure(*enclosure(d.vector))
        assert found.profile is not None
        if bounds.slip == 0:
            continue
        theta, w = found.profile.theta, found.rotation * problem.cylinder_radius / problem.delivery_speed
        across = d.cylinder_speed * np.sin(theta) + 2 * np.pi * d.yarn_radius * (w - d.twist_CD)
        along = d.cylinder_speed * np.cos(theta) + 1
        slip, tiny = np.hypot(across, along), 1e-9
        assert np.min(slip) >= bounds.slip - tiny
        assert bounds.cos_low - tiny <= np.min(across / slip)
        assert np.max(across / slip) <= bounds.cos_high + tiny
        assert np.max(np.abs(along / slip)) <= bounds.sine + tiny
        assert np.max(np.abs(np.cos(theta))) <= bounds.cosine + tiny
        assert np.min(along / slip * np.sin(theta)) >= bounds.m - tiny
        narrow += bounds.cos_high - bounds.cos_low < 0.2
    assert narrow > 20


def test_more_feedback_ends_the_proof_before_solutions_split() -> None:
    proven, several = [], []
    for tension in np.geomspace(60, 60_000, 25):
        problem = scene(cylinder_speed_ratio=0.2, tension_CD=float(tension))
        proven.append(not perhaps_several(problem.dimensionless().vector))
        several.append(solve_flexible(problem, profile=False).outcome is Outcome.SEVERAL_SOLUTIONS)
    assert proven[0]
    assert several[-1]
    assert not any(a and b for a, b in zip(proven, several, strict=True))
