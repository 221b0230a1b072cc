"""Mechanics of the fast mode's package: forces against its energy, rest against wound rings, cost against depth."""

import math

import numpy as np
import pytest
from winding_scenes import winding_scene

from models.compiled import compiled
from models.winding.contact import hardening
from models.winding.package import SUNK, Laying, Package, Yarn, across, along, element_lengths, put_on_top
from models.winding.settle import new_room, settle
from models.winding.solve import wind

RADIUS, T0 = 0.03, 0.5


def stack(rings: int, nodes: int, crossings: int, places: np.ndarray, contact: float, angle_step: float) -> Package:
    """One yarn of `rings` · `nodes` nodes; element e of each ring crosses element e of the ring below at `places`."""
    n = rings * nodes
    above = np.repeat(np.arange(nodes, n - 1), crossings)
    below = above - nodes
    order = np.argsort(below, kind="stable")
    edges = np.arange(n + 1)
    at = np.tile(places, above.size // places.size + 1)[: above.size]
    return Package(
        angle_step=angle_step,
        cosine=math.cos(angle_step),
        radius=np.full(n, RADIUS),
        z=np.zeros(n),
        height=np.zeros(n),
        natural=np.zeros(n),
        relaxed=np.zeros(n),
        below=below,
        above=above,
        below_at=at,
        above_at=at,
        stiffness=np.full(above.size, contact),
        first_above=np.searchsorted(above, edges),
        order_below=order,
        first_below=np.searchsorted(below[order], edges),
    )


@compiled
def forces(p: Package, yarn: Yarn, now: Laying) -> np.ndarray:
    total = np.zeros(now.laid)
    for k in range(now.laid):
        total[k] = along(p, yarn, now, k)[0] + across(p, yarn, now, k)[0]
    return total


def energy(p: Package, yarn: Yarn, now: Laying) -> float:
    """As the module says, written once more for whole arrays."""
    h = p.height[: now.laid]
    length = element_lengths(p, 0, now.laid - 1)
    natural = p.natural[: now.laid - 1]
    held = natural > 0
    strain = length[held] / natural[held] - 1 - p.relaxed[: now.laid - 1][held]
    sum_ = yarn.axial / 2 * float(natural[held] @ strain**2) + now.pull * length[~held].sum()
    step = p.radius[: now.laid] * p.angle_step
    sum_ += yarn.bending / 2 * float(np.sum(np.diff(h, 2) ** 2 / step[1:-1] ** 3))
    surface = yarn.surface * step / np.where(np.arange(now.laid) >= now.fresh, SUNK, 1.0)
    sum_ += 0.5 * float(surface @ np.minimum(h, 0) ** 2)
    for c in np.flatnonzero(p.above + 1 < now.laid):
        i, k, s, t = p.below[c], p.above[c], p.below_at[c], p.above_at[c]
        depth = yarn.diameter + (1 - s) * h[i] + s * h[i + 1] - (1 - t) * h[k] - t * h[k + 1]
        sum_ += p.stiffness[c] * yarn.diameter**2 * hardening(max(depth, 0.0) / yarn.diameter)[1]
    return sum_


def test_forces_are_the_gradient_of_the_energy_that_is_stated():
    random = np.random.default_rng(1)
    p = stack(4, 12, 2, random.uniform(0, 1, 14), 1.0e4, 0.06)
    yarn = Yarn(axial=315.0, bending=3.5e-6, diameter=0.42e-3, surface=2.4e7)
    now = Laying(laid=44, fresh=40, pull=T0)
    p.radius[:] = RADIUS + random.uniform(0, 1e-3, p.radius.size)
    p.z[:] = np.cumsum(random.uniform(3e-4, 5e-4, p.z.size))
    p.height[:] = np.repeat(np.arange(4), 12) * 0.8 * yarn.diameter + random.uniform(-2e-5, 2e-5, p.height.size)
    p.natural[:39] = element_lengths(p, 0, 39) * random.uniform(0.995, 1.002, 39)
    p.relaxed[:39] = random.uniform(0, 1e-4, 39)
    computed = forces(p, yarn, now)
    shift = 1e-9
    for k in range(now.laid):
        p.height[k] += shift
        high = energy(p, yarn, now)
        p.height[k] -= 2 * shift
        low = energy(p, yarn, now)
        p.height[k] += shift
        assert computed[k] == pytest.approx(-(high - low) / (2 * shift), rel=1e-5, abs=2e-5), k


def wind_rings(rings: int, ring: float, contact: float, core: float) -> np.ndarray:
    """Tension left in rings wound one by one at T₀ on a core, N: the thin-ring model of a wound roll.

    A ring resists a radial shift u by `ring` · u, the ring below by `contact`, the core by `core` [N/m]. A ring sinks
    at constant tension while it is wound, in the core by `SUNK` of what the core yields, and loses tension in
    proportion to its further shift. Linear, so that the shifts of all windings add.
    """
    shift = np.zeros(rings)
    pressure = 1.0  # cancels
    for last in range(rings):
        count = last + 1
        stiffness = np.diag(np.full(count, ring))
        stiffness[last, last] = 0.0  # still a string of constant tension
        stiffness[0, 0] += core if last else core / SUNK
        for k in range(last):
            stiffness[k : k + 2, k : k + 2] += contact * np.array([[1, -1], [-1, 1]])
        found = np.linalg.solve(stiffness, pressure * np.eye(count)[last])
        shift[:last] += found[:last]
        if last == 0:
            shift[0] = (pressure - core * found[0]) / (core + ring)  # from where it is held on
    return 1 - shift * ring / pressure


def test_layers_keep_the_tension_of_wound_rings():
    """A yarn that crosses itself at every node is a stack of rings.

    Far from the core the ring below n others keeps ρⁿ of its tension, ρ the share of a shift that a ring passes on to
    the next: the middle of a high package is slack.
    """
    rings, nodes, angle_step, contact = 24, 60, 0.065, 3.0e3
    yarn = Yarn(axial=315.0, bending=0.0, diameter=1e-3, surface=2.4e7)
    p = stack(rings, nodes, 1, np.zeros(1), contact, angle_step)
    room = new_room(p)
    n = rings * nodes
    p.radius[:] -= np.repeat(np.arange(rings), nodes) * yarn.diameter  # rings of one radius, as in the thin-ring model
    for ring in range(rings):
        start, stop = ring * nodes, (ring + 1) * nodes
        put_on_top(p, yarn.diameter, start, stop)
        settle(p, yarn, room, start, Laying(stop, start, T0), 1e-10, 0.0)
        first = max(start - 1, 0)
        p.natural[first : stop - 1] = element_lengths(p, first, stop - 1) / (1 + T0 / yarn.axial)
        settle(p, yarn, room, 0, Laying(stop, stop, 0.0), 1e-10, 0.0)
    tension = yarn.axial * (element_lengths(p, 0, n - 1) / p.natural[: n - 1] - 1)
    left = tension[nodes // 2 :: nodes] / T0
    inwards = 2 * math.sin(angle_step / 2)  # force on a node over the tension
    ring, core = yarn.axial * inwards / RADIUS, yarn.surface * RADIUS * angle_step
    np.testing.assert_allclose(left, wind_rings(rings, ring, contact, core), atol=0.01)
    below = ring / 2 + math.sqrt(ring**2 / 4 + ring * contact)  # stiffness of all rings from one on downwards
    passed = contact / (contact + below)
    np.testing.assert_allclose(left[:11:-1], passed ** np.arange(12), atol=0.01)


def test_deep_layers_do_not_make_new_ones_costlier():
    """Visits to nodes per metre: 120 layers of a short package against 60. Node by node it was about four times."""
    cost = []
    for layers in (60, 120):
        result = wind(winding_scene(turns_per_cycle=1.55, element_length=4e-3, duration=layers * 0.0498, mode="fast"))
        cost.append(result.element_steps / result.scene.wound_length)
    assert cost[1] < 1.4 * cost[0]
