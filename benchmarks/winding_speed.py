"""How many element-steps per second, beside PyElastica on the same free rod, in one run and one thread.

    python benchmarks/winding_speed.py

PyElastica is no dependency of this project: `pip install pyelastica` into an environment of its own that also has this
repository on its path. Its Cosserat rod carries more per element (shear, torsion, directors), so that the two rates
compare what a step costs, not equal models. Both are called in turns and the best of the turns is printed.
"""

import math
from time import thread_time

import elastica
import numpy as np

from models.winding.rod import Material, new_rod, swing

ELEMENTS, STEPS, TURNS = 2000, 2000, 5
LENGTH, DIAMETER, DENSITY, AXIAL = 2e-3, 0.424e-3, 131.2e-6, 315.0


def own() -> float:
    """Element-steps per second of `models.winding.rod`."""
    n = ELEMENTS + 1
    rod = new_rod(n, 1)
    rod.x[:] = LENGTH * np.arange(n)
    rod.vy[:] = 0.1 * np.sin(np.arange(n) / 50)
    material = Material(LENGTH, AXIAL, AXIAL * DIAMETER**2 / 16, 0.0)
    dt = 0.8 * LENGTH * math.sqrt(DENSITY / AXIAL)
    begin = thread_time()
    swing(rod, material, n, DENSITY * LENGTH, dt, STEPS, 0)
    return ELEMENTS * STEPS / (thread_time() - begin)


def pyelastica() -> float:
    """Element-steps per second of a `CosseratRod` by position Verlet."""
    area = math.pi * DIAMETER**2 / 4
    rod = elastica.CosseratRod.straight_rod(
        ELEMENTS,
        np.zeros(3),
        np.array([1.0, 0.0, 0.0]),
        np.array([0.0, 1.0, 0.0]),
        ELEMENTS * LENGTH,
        DIAMETER / 2,
        DENSITY / area,
        youngs_modulus=AXIAL / area,
        shear_modulus=AXIAL / area / 2.6,
    )
    rod.velocity_collection[1] = 0.1 * np.sin(np.arange(ELEMENTS + 1) / 50)

    class Alone(elastica.BaseSystemCollection):
        pass

    system = Alone()
    system.append(rod)
    system.finalize()
    stepper = elastica.PositionVerlet()
    begin = thread_time()
    elastica.integrate(stepper, system, STEPS * 1e-7, STEPS, progress_bar=False)
    return ELEMENTS * STEPS / (thread_time() - begin)


def main() -> None:
    """Print both rates."""
    own(), pyelastica()  # compile
    rates = np.array([(own(), pyelastica()) for _ in range(TURNS)]).max(axis=0)
    print(f"own rod {rates[0]:.3g}, PyElastica {rates[1]:.3g} element-steps/s, ratio {rates[0] / rates[1]:.2f}")


if __name__ == "__main__":
    main()
