"""The elements of the winding yarn against closed forms: waves, bending, energy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root

from models.winding.rod import Material, Rod, elastic_state, new_rod, swing

NO_PRONY = np.zeros(1)


def straight(n: int, step: float) -> Rod:
    rod = new_rod(n, 1)
    rod.x[:] = step * np.arange(n)
    return rod


def test_longitudinal_waves_travel_at_the_speed_of_the_bar():
    # A smooth pulse of velocity, 60 elements long, passes two nodes 2 m apart.
    step, axial, density = 2e-3, 315.0, 131.2e-6
    speed = math.sqrt(axial / density)
    dt = 0.8 * step / speed
    rod = straight(2000, step)
    pulse = np.exp(-(((rod.x - 0.5) / 0.06) ** 2))
    rod.vx[:] = 0.1 * pulse
    rod.x[:] += 0.1 / speed * np.cumsum(-pulse) * step  # a wave towards +x alone: strain = −velocity / c
    material = Material(step, axial, 0.0, 0.0)
    passed = {500: [], 1500: []}
    for _ in range(1750):
        swing(rod, material, 2000, density * step, dt, 1, 0)
        for node, history in passed.items():
            history.append(rod.vx[node])
    history = {node: np.array(values) for node, values in passed.items()}
    centre = {node: np.sum(np.arange(1750) * v**2) / np.sum(v**2) for node, v in history.items()}
    assert 1000 * step / ((centre[1500] - centre[500]) * dt) == pytest.approx(speed, rel=0.005)


def elastica_tip(load: float) -> tuple[float, float]:
    """Tip (x, y) of a cantilever of unit length and stiffness under a transverse end load, large deflection."""

    def shoot(curvature: float) -> np.ndarray:
        def slope(_: float, s: np.ndarray) -> list[float]:
            return [s[1], -load * math.cos(s[0]), math.cos(s[0]), math.sin(s[0])]

        return solve_ivp(slope, (0, 1), [0.0, curvature, 0.0, 0.0], rtol=1e-9, atol=1e-10).y[:, -1]

    curvature = brentq(lambda k: shoot(k)[1], 0.5 * load, load)
    return tuple(shoot(curvature)[2:])


def test_a_cantilever_bends_as_the_elastica():
    elements, load = 40, 2.0
    step = 1 / (elements - 0.5)  # held at the first two nodes: clamped halfway between them
    n = elements + 1
    rod = straight(n, step)
    material = Material(step, 1e4, 1.0, 0.0)

    def imbalance(free: np.ndarray) -> np.ndarray:
        rod.x[2:], rod.y[2:] = free[: n - 2], free[n - 2 :]
        elastic_state(rod, material, NO_PRONY, n)
        force = np.concatenate([rod.fx[2:], rod.fy[2:]])
        force[-1] += load
        return force

    arc = rod.x[2:].copy()
    start = np.concatenate([arc * (1 - 0.15 * arc**2), 0.5 * arc**2])
    found = root(imbalance, start)
    assert found.success
    x, y = elastica_tip(load)
    assert rod.x[-1] - step / 2 == pytest.approx(x, rel=0.02)
    assert rod.y[-1] == pytest.approx(y, rel=0.02)


def test_a_loop_stores_the_bending_energy_of_a_circle():
    elements, radius, bending = 94, 0.03, 3.5e-6
    step = 2 * radius * math.sin(math.pi / elements)
    angle = 2 * math.pi / elements * np.arange(elements + 2)  # two more nodes close the loop's curvature
    rod = new_rod(elements + 2, 1)
    rod.x[:], rod.y[:] = radius * np.cos(angle), radius * np.sin(angle)
    _, energy = elastic_state(rod, Material(step, 315.0, bending, 0.0), NO_PRONY, elements + 2)
    assert energy == pytest.approx(bending / (2 * radius**2) * 2 * math.pi * radius, rel=0.02)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 5), st.integers(0, 2))
def test_forces_are_the_gradient_of_the_energy(seed: int, node: int, axis: int):
    rng = np.random.default_rng(seed)
    rod = straight(6, 1.0)
    for coordinate in (rod.x, rod.y, rod.z):
        coordinate[:] += rng.uniform(-0.2, 0.2, 6)
    rod.dashpots[:], rod.relaxed[:] = 0.05, 0.3 * 0.05
    material, weights = Material(1.0, 5.0, 2.0, 0.0), np.array([0.3])
    coordinate, force = ((rod.x, rod.fx), (rod.y, rod.fy), (rod.z, rod.fz))[axis]
    shift = 1e-6
    coordinate[node] += shift
    above = sum(elastic_state(rod, material, weights, 6))
    coordinate[node] -= 2 * shift
    below = sum(elastic_state(rod, material, weights, 6))
    coordinate[node] += shift
    elastic_state(rod, material, weights, 6)
    assert force[node] == pytest.approx(-(above - below) / (2 * shift), abs=1e-7)
