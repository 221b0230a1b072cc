"""A yarn that lands on a yielding bobbin: limits in closed form, and the reference mode."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from winding_scenes import winding_scene

from models.winding.landing import kept_share, sunk_share
from models.winding.reference import Run
from models.winding.stepping import GOING, LAID, time_step_limit

TENSION, AXIAL, RADIUS = 0.5, 315.0, 0.03


@pytest.mark.parametrize("surface", [4e5, 2e6, 2.4e7])
def test_a_soft_grip_keeps_all_tension_and_a_rigid_one_only_what_sinking_leaves(surface: float):
    softness = AXIAL / (RADIUS**2 * surface)
    assert kept_share(TENSION, AXIAL, 0.0, surface, RADIUS, 1.0) == pytest.approx(1, abs=1e-3)
    # Held at first touch a yarn loses its sinking, and the square of the slope at which it touched.
    slope = math.sqrt(TENSION / (surface * (1 + softness))) / RADIUS
    left = (1 - AXIAL / TENSION * slope**2 / 2) / (1 + softness)
    assert kept_share(TENSION, AXIAL, 0.0, surface, RADIUS, 1e-6) == pytest.approx(left, abs=2e-3)


def test_between_them_a_string_keeps_what_its_sinking_beyond_the_grip_leaves():
    """On stiff ground τ is no load: w = δ (1 − e^{−s/ℓ}), ℓ = √(T/K), whose part before the grip is λ/(λ + ℓ)."""
    surface, grip = 2.4e8, 4e-4
    length = math.sqrt(TENSION / surface)
    softness = AXIAL / (RADIUS**2 * surface)
    square = (length / RADIUS) ** 2 / 2 / (1 + 2 * grip / length)
    lost = softness * length / (grip + length) + AXIAL / TENSION * square
    assert 1 - kept_share(TENSION, AXIAL, 0.0, surface, RADIUS, grip) == pytest.approx(lost, rel=0.03)


def integrated(surface: float, grip: float, bending: float, square: float) -> float:
    """T/T₀ by collocation of the stated equations, with `square` times the slope's square."""
    straight = math.sqrt(bending / TENSION)

    def rates(_s: np.ndarray, y: np.ndarray, stretch: np.ndarray) -> np.ndarray:
        w, slope, bend, shear, u, extra = y
        load = (TENSION + extra) / RADIUS + TENSION * bend - surface * w
        drawn = stretch[0] + extra / AXIAL + w / RADIUS - square * slope**2 / 2
        return np.array([slope, bend, shear, load / bending, drawn, AXIAL * u / grip**2])

    def ends(touch: np.ndarray, far: np.ndarray, _stretch: np.ndarray) -> np.ndarray:
        no_jump = touch[3] * straight - touch[2] - 1 / RADIUS
        return np.array([touch[0], touch[4], touch[5], no_jump, far[1], far[2], far[4]])

    s = np.linspace(0, 10 * max(grip, straight, math.sqrt(TENSION / surface)), 200)
    found = solve_bvp(rates, ends, s, np.zeros((6, s.size)), np.zeros(1), tol=1e-5, max_nodes=20_000)
    assert found.success
    return float(1 + found.y[5, -1] / TENSION)


@pytest.mark.parametrize(("surface", "grip"), [(3.9e5, 4e-3), (3.9e5, 1e-3), (2.4e7, 4e-3)])
def test_the_closed_form_is_the_solution_of_the_stated_equations(surface: float, grip: float):
    """To first order in the slope's square, whose second order is small even for soft yarn."""
    bending, part = 3.5e-6, 0.02
    none, little, full = (integrated(surface, grip, bending, square) for square in (0.0, part, 1.0))
    kept = kept_share(TENSION, AXIAL, bending, surface, RADIUS, grip)
    assert kept == pytest.approx(none + (little - none) / part, abs=3e-4)
    assert kept == pytest.approx(full, abs=0.01)


def test_a_share_of_the_sinking_stands_for_the_tension_that_is_kept():
    scene = winding_scene(transverse_stiffness=3.9e5)
    radius = scene.bobbin_radius / math.cos(scene.winding_angle) ** 2
    softness = scene.axial_stiffness / (radius**2 * scene.transverse_stiffness)
    kept = kept_share(
        scene.tension, scene.axial_stiffness, scene.bending_stiffness, scene.transverse_stiffness, radius, 4e-3
    )
    assert (1 + sunk_share(scene) * softness) / (1 + softness) == pytest.approx(kept)
    assert sunk_share(replace(scene, bending_stiffness=0.0)) < sunk_share(scene) < 1


def test_the_reference_mode_keeps_as_much():
    """On 1 mm elements, soft, without relaxation: tension of yarn that nothing lies on yet, over that of the span."""
    scene = winding_scene(
        transverse_stiffness=3.9e5,
        element_length=1e-3,
        prony_weights=(0.0, 0.0),
        speed_rise=0.02,
        feed_length=0.06,
        duration=0.05,
    )
    run = Run(scene, math.ceil(1e-3 / (0.9 * time_step_limit(scene))))
    landed = [1]
    while run.time < 0.048:
        assert run.sample() == GOING
        landed.append(int(run.state.counts[LAID]))
    span = np.interp(np.arange(landed[-1]), landed, [scene.tension, *run.span])
    shot = run.snapshot()
    steep = np.abs(np.gradient(shot.position[:, 2], scene.element_length))
    radius = np.hypot(shot.position[:, 0], shot.position[:, 1])
    place = np.arange(landed[-1])
    alone = (steep < math.sin(scene.winding_angle) * 1.05) & (place > 40) & (place < landed[-1] - 30)
    alone &= radius < scene.bobbin_radius + scene.diameter / 2
    assert np.count_nonzero(alone) > 100
    kept = kept_share(
        scene.tension,
        scene.axial_stiffness,
        scene.bending_stiffness,
        scene.transverse_stiffness,
        scene.bobbin_radius / math.cos(scene.winding_angle) ** 2,
        scene.grip_length,
    )
    assert np.median(shot.tension[alone] / span[alone]) == pytest.approx(kept, abs=0.03)
