"""Mechanics of the fast mode's package: forces against its energy, rest against wound rings, cost against depth."""

import math

import numpy as np
import pytest
from winding_scenes import winding_scene

from models.compiled import borrowing, compiled
from models.winding.assembly import HELD, Room, arrange, assemble, loosen, multiply, new_room
from models.winding.contact import hardening
from models.winding.crossings import NEIGHBOURS, find_crossings
from models.winding.package import (
    NEAR,
    NODE,
    PRESSED,
    Laying,
    Package,
    Yarn,
    element_lengths,
    length_of,
    pair_up,
    put_on_top,
)
from models.winding.settle import settle
from models.winding.solve import wind

RADIUS, T0 = 0.03, 0.5
BENDING, SURFACE = 3.5e-6, 2.4e7
"""B [N m²], K_t [N/m²]."""


def stack(rings: int, nodes: int, crossings: int, places: np.ndarray, contact: float, angle_step: float) -> Package:
    """One yarn of `rings` · `nodes` nodes; element e of each ring crosses element e of the ring below at `places`."""
    n = rings * nodes
    above = np.repeat(np.arange(nodes, n - 1), crossings)
    at = np.tile(places, above.size // places.size + 1)[: above.size]
    first, crossing = pair_up(above - nodes, above, at, at, n)
    crossing["stiffness"] = contact
    node = np.zeros(n, NODE)
    node["radius"] = RADIUS
    node["surface"] = SURFACE * RADIUS * angle_step
    near = np.zeros(n, NEAR)
    near["low"], near["high"] = first[:-1], first[1:]
    return Package(2 * (1 - math.cos(angle_step)), np.zeros(n), node, first, crossing, near)


@borrowing
def _linearise(p: Package, yarn: Yarn, now: Laying, room: Room, loose: np.ndarray) -> None:
    for k in loose:
        loosen(room, k)
    arrange(room)
    assemble(p, yarn, room, now)


@compiled
def linearise(p: Package, yarn: Yarn, now: Laying, room: Room, loose: np.ndarray) -> None:
    """Forces on the nodes `loose` and their stiffness, into a new room."""
    _linearise(p, yarn, now, room, loose)


@borrowing
def _product(room: Room, x: np.ndarray) -> None:
    for k in range(x.size):
        if room.place[k] > 0:
            room.direction[room.place[k]] = x[k]
    multiply(room)


@compiled
def product(room: Room, x: np.ndarray) -> None:
    """Image ← stiffness · x, x given by nodes."""
    _product(room, x)


def by_node(room: Room, values: np.ndarray) -> np.ndarray:
    """`values` at places, by nodes; NaN where a node is held."""
    place = room.place[:-2]
    return np.where(place == HELD, np.nan, values[place])


def forces(p: Package, yarn: Yarn, now: Laying) -> np.ndarray:
    room = new_room(p)
    linearise(p, yarn, now, room, np.arange(1, now.laid))
    return by_node(room, room.force)


def energy(p: Package, yarn: Yarn, now: Laying) -> float:
    """As the module says, written once more for whole arrays."""
    h, node = p.height[: now.laid], p.node[: now.laid]
    length = element_lengths(p, 0, now.laid - 1)
    held = node["hold"][:-1] > 0
    natural = yarn.axial / node["hold"][:-1][held]
    strain = length[held] / natural - 1 - node["relaxed"][:-1][held]
    sum_ = yarn.axial / 2 * float(natural @ strain**2) + now.pull * length[~held].sum()
    sum_ += float(node["bending"][1:-1] @ np.diff(h, 2) ** 2) / 2
    sum_ += 0.5 * float(node["surface"] @ np.minimum(h, 0) ** 2)
    element = np.repeat(np.arange(p.height.size), np.diff(p.first))
    for e, c in zip(element, p.crossing, strict=True):
        if c["other"] < e < now.laid - 1:
            i, s, t = c["other"], c["other_at"], c["own_at"]
            depth = yarn.diameter + (1 - s) * h[i] + s * h[i + 1] - (1 - t) * h[e] - t * h[e + 1]
            sum_ += c["stiffness"] * yarn.diameter**2 * hardening(max(depth, 0.0) / yarn.diameter)[1]
    return sum_


YARN = Yarn(axial=315.0, diameter=0.42e-3, sunk=1.0)


def disordered(strain: tuple[float, float]) -> tuple[Package, Laying]:
    """Four rings on each other, nothing at rest; elements of the first three held at a `strain` within limits."""
    random = np.random.default_rng(1)
    angle_step = 0.06
    p = stack(4, 12, 2, random.uniform(0, 1, 14), 1.0e4, angle_step)
    now = Laying(laid=44, pull=T0)
    n = p.height.size
    p.node["radius"] += random.uniform(0, 1e-3, n)
    p.node["rise"] = random.uniform(3e-4, 5e-4, n) ** 2
    p.node["bending"] = BENDING / (p.node["radius"] * angle_step) ** 3
    p.height[:] = np.repeat(np.arange(4), 12) * 0.8 * YARN.diameter + random.uniform(-2e-5, 2e-5, n)
    p.node["hold"][:39] = YARN.axial / element_lengths(p, 0, 39) * (1 + random.uniform(*strain, 39))
    p.node["relaxed"][:39] = random.uniform(0, 1e-4, 39)
    return p, now


def test_forces_are_the_gradient_of_the_energy_that_is_stated():
    p, now = disordered((-0.002, 0.005))
    computed = forces(p, YARN, now)
    shift = 1e-9
    for k in range(1, now.laid):
        p.height[k] += shift
        high = energy(p, YARN, now)
        p.height[k] -= 2 * shift
        low = energy(p, YARN, now)
        p.height[k] += shift
        assert computed[k] == pytest.approx(-(high - low) / (2 * shift), rel=1e-5, abs=2e-5), k


def test_the_stiffness_is_the_gradient_of_the_forces():
    """Of yarn that is nowhere slack, for which the stiffness is softened."""
    p, now = disordered((0.001, 0.005))
    room = new_room(p)
    linearise(p, YARN, now, room, np.arange(1, now.laid))
    x = np.zeros(p.height.size)
    x[1 : now.laid] = np.random.default_rng(2).normal(size=now.laid - 1)
    product(room, x)
    shift = 1e-10
    p.height[:] += shift * x
    high = forces(p, YARN, now)
    p.height[:] -= 2 * shift * x
    change = (forces(p, YARN, now) - high) / (2 * shift)
    scale = np.nanmax(np.abs(change))
    np.testing.assert_allclose(by_node(room, room.image)[1 : now.laid], change[1 : now.laid], atol=1e-5 * scale)


@pytest.mark.parametrize("seed", range(40))
def test_held_nodes_change_neither_forces_nor_stiffness_of_loose_ones(seed: int):
    """Runs of loose nodes of any length and distance, with crossings between them and of held yarn."""
    p, now = disordered((0.001, 0.005))
    random = np.random.default_rng(seed)
    chosen = np.flatnonzero(random.uniform(size=now.laid) < random.uniform(0.1, 0.9))
    chosen = random.permutation(chosen[chosen > 0])
    every, some = new_room(p), new_room(p)
    linearise(p, YARN, now, every, np.arange(1, now.laid))
    linearise(p, YARN, now, some, chosen)
    loose = np.flatnonzero(some.place[:-2] != HELD)
    single = [k for k in range(2, now.laid - 1) if {k - 1, k + 1} <= {*chosen}]
    assert {*loose} == {*chosen, *single}
    x = np.zeros(p.height.size)
    x[loose] = random.normal(size=loose.size)
    product(every, x)
    product(some, x)
    for name in ("force", "yielding", "image"):
        whole, part = by_node(every, getattr(every, name)), by_node(some, getattr(some, name))
        np.testing.assert_allclose(part[loose], whole[loose], rtol=1e-9, atol=1e-9 * np.nanmax(np.abs(whole)))


def test_crossings_are_those_of_all_pairs_of_elements():
    """Of a guide that goes forth and back over a bobbin of 31.4 steps around; the mirrored path has the same."""
    per_turn, k = 31.4, np.arange(500)
    z = 40 * np.abs((k / 97.3) % 2 - 1) + 0.3 * np.sin(k)
    found = find_crossings(z, per_turn)
    expected = []
    for high in range(k.size - 1):
        for low in range(high - NEIGHBOURS):
            offset = low - high - per_turn * round((low - high) / per_turn)
            steeper = (z[high + 1] - z[high]) - (z[low + 1] - z[low])
            t = (z[low] - z[high] - offset * (z[low + 1] - z[low])) / steeper
            if 0 <= t < 1 and 0 <= t - offset < 1:
                expected.append((low, high, t - offset, t))
    assert len(expected) > 30
    order = np.lexsort((found[0], found[1]))
    for own, other in zip(found, np.array(expected).T, strict=True):
        np.testing.assert_allclose(own[order], other, atol=1e-9)
    for own, other in zip(found, find_crossings(-z, per_turn), strict=True):
        np.testing.assert_array_equal(np.sort(own), np.sort(other))
    assert find_crossings(z, 1e12)[0].size == 0  # without a cell for every step around


BUMP = 1e-3


def over_a_bump(n: int, angle_step: float, stop: int) -> Package:
    """A thread from node 20 to its free end at `stop` − 1; element 40 crosses yarn that holds it up by `BUMP`."""
    first, crossing = pair_up(np.array([0]), np.array([40]), np.zeros(1), np.zeros(1), n)
    p = stack(1, n, 1, np.zeros(1), 0.0, angle_step)._replace(first=first, crossing=crossing)
    diameter = 0.4e-3
    p.height[:10] = BUMP - (1 - PRESSED) * diameter
    put_on_top(p, diameter, 20, stop)
    return p


def test_new_yarn_is_drawn_taut_over_what_it_crosses():
    """A bump of height b holds a straight line off a circle of radius R for √(2 R b) on either side."""
    angle_step, n = 0.02, 60
    p = over_a_bump(n, angle_step, n)
    step = RADIUS * angle_step
    away = step * np.abs(np.arange(20, n) - 40.5)
    reach = math.sqrt(2 * RADIUS * BUMP)
    assert p.height[40] == p.height[41] == pytest.approx(BUMP)
    assert np.all(p.height[20:][away > reach + 2 * step] == 0.0)
    tangent = (reach - away + step / 2) ** 2 / (2 * RADIUS)  # the rise of the line above the point where it leaves
    slope = (away < reach - step) & (away > step)
    assert p.height[20:][slope] == pytest.approx(tangent[slope], abs=3e-5)
    radius = RADIUS + p.height[20:]
    around = angle_step * np.arange(20, n)
    points = np.column_stack([radius * np.cos(around), radius * np.sin(around)])
    before, after = np.diff(points[:-1], axis=0), np.diff(points[1:], axis=0)
    assert np.min(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]) > -1e-12  # bent inwards nowhere


def test_the_free_end_of_new_yarn_is_at_right_angles_to_the_radius():
    """Where the next bump, or the bobbin, is not reached before the end: the shortest thread."""
    angle_step, stop = 0.02, 48
    p = over_a_bump(60, angle_step, stop)
    beyond = np.arange(41, stop)
    foot = (RADIUS + p.height[beyond]) * np.cos(angle_step * (stop - 1 - beyond))
    np.testing.assert_allclose(foot, foot[-1], atol=1e-5)
    assert 0 < p.height[stop - 1] < p.height[41]


def test_what_cannot_come_to_rest_says_so_and_leaves_no_trace():
    p, now = disordered((0.001, 0.005))
    room = new_room(p)
    rests, _ = settle(p, YARN, room, 0, now, 0.0, 0.0)
    assert not rests
    assert np.all(room.place == HELD)
    assert room.counts[0] == 0


@pytest.mark.parametrize("start", [0, 30])
def test_at_rest_no_force_is_left_and_the_energy_is_least(start: int):
    p, now = disordered((0.001, 0.005))
    room, random = new_room(p), np.random.default_rng(3)
    rests, _ = settle(p, YARN, room, 0, now, 1e-11, 0.0)
    assert rests
    p.height[start or 1 : now.laid] += random.normal(0, 1e-5, now.laid - (start or 1))
    rests, _ = settle(p, YARN, room, start, now, 1e-11, 0.0)
    assert rests
    linearise(p, YARN, now, room, np.arange(1, now.laid))
    assert np.nanmax(np.abs(by_node(room, room.force * room.yielding)[1 : now.laid])) < 2e-11
    least, rest = energy(p, YARN, now), p.height.copy()
    for _ in range(20):
        p.height[1 : now.laid] = rest[1 : now.laid] + random.normal(0, 1e-6, now.laid - 1)
        assert energy(p, YARN, now) > least


def wind_rings(rings: int, ring: float, contact: float, core: float, sunk: float) -> np.ndarray:
    """Tension left in rings wound one by one at T₀ on a core, N: the thin-ring model of a wound roll.

    A ring resists a radial shift u by `ring` · u, the ring below by `contact`, the core by `core` [N/m]. A ring sinks
    at constant tension while it is wound, the first by the share `sunk` of what the core yields before it is held, and
    loses tension in proportion to its further shift. Linear, so that the shifts of all windings add.
    """
    shift = np.zeros(rings)
    pressure = 1.0  # cancels
    for last in range(rings):
        count = last + 1
        stiffness = np.diag(np.full(count, ring))
        stiffness[last, last] = 0.0  # still a string of constant tension
        stiffness[0, 0] += core
        for k in range(last):
            stiffness[k : k + 2, k : k + 2] += contact * np.array([[1, -1], [-1, 1]])
        found = np.linalg.solve(stiffness, pressure * np.eye(count)[last])
        shift[:last] += found[:last]
        if last == 0:
            shift[0] = (pressure - core * sunk * found[0]) / (core + ring)  # from where it is held on
    return 1 - shift * ring / pressure


@compiled
def hold(p: Package, yarn: Yarn, start: int, stop: int) -> None:
    """The bobbin takes hold of elements start … stop − 1 at T₀."""
    for k in range(start, stop):
        p.node[k].hold = (yarn.axial + T0) / length_of(p, k, yarn.sunk)


def test_layers_keep_the_tension_of_wound_rings():
    """A yarn that crosses itself at every node is a stack of rings.

    Far from the core the ring below n others keeps ρⁿ of its tension, ρ the share of a shift that a ring passes on to
    the next: the middle of a high package is slack.
    """
    rings, nodes, angle_step, contact = 24, 60, 0.065, 3.0e3
    yarn = Yarn(axial=315.0, diameter=1e-3, sunk=0.75)
    p = stack(rings, nodes, 1, np.zeros(1), contact, angle_step)
    room = new_room(p)
    n = rings * nodes
    p.node["radius"] -= (
        np.repeat(np.arange(rings), nodes) * yarn.diameter
    )  # rings of one radius, as in the thin-ring model
    for ring in range(rings):
        start, stop = ring * nodes, (ring + 1) * nodes
        put_on_top(p, yarn.diameter, start, stop)
        settle(p, yarn, room, start, Laying(stop, T0), 1e-10, 0.0)
        hold(p, yarn, max(start - 1, 0), stop - 1)
        settle(p, yarn, room, 0, Laying(stop, 0.0), 1e-10, 0.0)
    tension = element_lengths(p, 0, n - 1) * p.node["hold"][: n - 1] - yarn.axial
    left = tension[nodes // 2 :: nodes] / T0
    inwards = 2 * math.sin(angle_step / 2)  # force on a node over the tension
    ring, core = yarn.axial * inwards / RADIUS, SURFACE * RADIUS * angle_step
    np.testing.assert_allclose(left, wind_rings(rings, ring, contact, core, yarn.sunk), atol=0.01)
    below = ring / 2 + math.sqrt(ring**2 / 4 + ring * contact)  # stiffness of all rings from one on downwards
    passed = contact / (contact + below)
    np.testing.assert_allclose(left[:11:-1], passed ** np.arange(12), atol=0.01)


def test_deep_layers_do_not_make_new_ones_costlier():
    """Visits to nodes per metre, 240 layers of a short package against 120; node by node they were four times that."""
    cost = []
    for layers in (120, 240):
        result = wind(winding_scene(turns_per_cycle=1.55, element_length=4e-3, duration=layers * 0.0498, mode="fast"))
        assert result.outcome.ok
        cost.append(result.element_steps / result.scene.wound_length)
    assert cost[1] < 1.2 * cost[0]
