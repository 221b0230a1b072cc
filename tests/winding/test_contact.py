"""Energy of contacts: what friction and dashpots take, and what a contact loses whose nearest points jump."""

import math

import numpy as np
import pytest

from models.winding.contact import Bobbin, Crossing, Pairs, bobbin_contact, new_grip, new_pairs, pair_contact
from models.winding.rod import Rod, new_rod

YARN = Crossing(diameter=0.42e-3, surface=2.4e7, element=2e-3, mass=2.6e-7, damping=0.0, static=0.3, dynamic=0.25)
UPPER, LOWER = 9, 0
"""Two elements of one yarn, far enough apart along it to touch."""


def pair() -> tuple[Rod, Pairs]:
    rod, pairs = new_rod(12, 1), new_pairs(1)
    pairs.first[0], pairs.second[0] = UPPER, LOWER
    return rod, pairs


def place(rod: Rod, element: int, middle: tuple[float, float, float], angle: float) -> None:
    """Lay an element through `middle` [m], turned by `angle` from the x axis in a plane of constant z."""
    along = np.array([math.cos(angle), math.sin(angle), 0.0])
    for node, sign in ((element, -1), (element + 1, 1)):
        rod.x[node], rod.y[node], rod.z[node] = np.array(middle) + sign * YARN.element / 2 * along
    rod.tx[element], rod.ty[element], rod.tz[element] = along
    rod.length[element] = YARN.element


def touch(rod: Rod, pairs: Pairs, dt: float) -> tuple[float, float, float, float]:
    """Energies [J] rubbed away, handed on and stored, and the force of the lower yarn on the upper one along x [N]."""
    rod.fx[:] = 0.0
    _, _, rubbed, handed, stored, _ = pair_contact(rod, pairs, 1, YARN, 1.0, 0.0, 0.0, dt)
    return rubbed, handed, stored, float(rod.fx[UPPER] + rod.fx[UPPER + 1])


@pytest.mark.parametrize("steps", [50, 400])
def test_friction_rubs_away_its_force_times_the_way_whatever_the_time_step(steps: int):
    rod, pairs = pair()
    way, speed = 0.5e-3, 0.2
    place(rod, LOWER, (0.0, 0.0, 0.0), 0.0)
    rod.vx[UPPER : UPPER + 2] = speed
    lost, work, before, start, stored = 0.0, 0.0, 0.0, 0.0, 0.0
    for step in range(steps + 1):
        place(rod, UPPER, (way * (step / steps - 0.5), 0.0, 0.9 * YARN.diameter), math.pi / 2)
        rubbed, _, stored, force = touch(rod, pairs, way / steps / speed)
        if step > 0:
            lost += rubbed
            work -= (before + force) / 2 * way / steps
        else:
            start = stored
        before = force
    assert pairs.slides[0] == 1.0
    # Yarns at right angles touch over a diameter; each gives way by half of a tenth of it, hardened by 1/(1 − 0.1).
    press = YARN.surface / 2 * YARN.diameter * 0.1 * YARN.diameter / 0.9
    assert before == pytest.approx(-YARN.dynamic * press, rel=1e-9)
    assert lost == pytest.approx(work - (stored - start), rel=1e-9)
    assert lost == pytest.approx(YARN.dynamic * press * way, rel=0.05)  # the yarns hold each other at first


def test_yarn_that_comes_to_lie_side_by_side_hands_its_energy_on():
    rod, pairs = pair()
    place(rod, LOWER, (0.5e-3, 0.0, 0.0), 0.0)
    stored = []
    for change in (1e-4, -1e-4):  # across the angle below which the middle of the upper element counts
        place(rod, UPPER, (0.5e-3, 0.05e-3, 0.85 * YARN.diameter), math.asin(0.1) + change)
        _, handed, now, _ = touch(rod, pairs, 1e-6)
        stored.append(now)
    assert abs(stored[1] - stored[0]) > 0.05 * stored[0]
    assert handed == pytest.approx(stored[0] - stored[1], rel=1e-6)


RATES = np.array([0.03, -0.02, 0.01, 0.015, -0.005])
"""Velocities before each step [m/s]."""


def test_a_dashpot_takes_its_force_times_the_mean_of_the_velocities_before_and_after():
    rod, pairs = pair()
    yarn = YARN._replace(damping=0.01)
    place(rod, LOWER, (0.0, 0.0, 0.0), 0.0)
    place(rod, UPPER, (0.0, 0.0, 0.9 * YARN.diameter), math.pi / 2)
    taken = []
    for rate in RATES:
        rod.vz[UPPER : UPPER + 2] = rate
        taken.append(pair_contact(rod, pairs, 1, yarn, 1.0, 0.0, 0.0, 1e-6)[1])
    damping = 2 * yarn.damping * math.sqrt(YARN.surface / 2 * YARN.diameter * YARN.mass)
    between = damping * RATES[:-1] * (RATES[:-1] + RATES[1:]) / 2
    last = damping * RATES[-1] ** 2 / 2  # the other half is entered with the next step
    assert sum(taken) == pytest.approx(between.sum() + last, rel=1e-9)


def test_the_bobbins_dashpots_take_their_force_times_the_mean_velocity_too():
    rod, grip = new_rod(3, 1), new_grip(3)
    bobbin = Bobbin(radius=0.03, taper=0.0, stiffness=5e4, damping=0.01, grip=7e4, grip_damping=0.02)
    rod.y[1] = bobbin.radius - 1e-5
    taken = []
    for rate in RATES:
        rod.vx[1], rod.vy[1] = rate, rate / 2
        taken.append(bobbin_contact(rod, grip, bobbin, 2, 1.0, 0.0, 0.0)[1])
    squares = np.array([RATES[:-1] * (RATES[:-1] + RATES[1:]) / 2]).sum() + RATES[-1] ** 2 / 2
    assert sum(taken) == pytest.approx((bobbin.grip_damping + bobbin.damping / 4) * squares, rel=1e-9)
