"""Exact first derivatives of p₃AB, T_AB and θ_B with respect to every input, by the implicit function theorem.

The discrete solution x satisfies F(x, λ) = 0, so dx/dλ = −J⁻¹ ∂F/∂λ with the Jacobian J that Newton left behind. The
way from an input in SI to the dimensionless numbers, ∂F/∂λ, and the way from x to the ends in SI are differentiated by
complex steps, so nothing is truncated: what is left is the discretisation error of the solution itself.
"""

from collections.abc import Callable, Mapping
from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models import capstan, cosserat, cosserat_fd, flexible, kirchhoff, kirchhoff_spans, slow_manifold
from models.boundary_value import Array, Collocated, evaluated, parameter_slopes
from models.complex_step import COMPLEX_STEP
from models.discretisation import chebyshev_collocation, chebyshev_integration
from models.outcome import Ends
from models.refinement import Refined, outcome
from models.scene import TENSION_CD, WRAP_ANGLE, Scene, normalised
from models.self_consistency import find_roots
from models.uniqueness import perhaps_several

Complex = NDArray[np.complex128]


def sensitivities(scene: Scene, model: str) -> Mapping[str, Ends] | None:
    """Derivatives of the ends by field name of `Scene`, each in SI units of the end per SI unit of the input.

    `cosserat-fd` shares the equations of `cosserat`, and `capstan` is an approximation of `flexible`: the derivatives
    are those of the latter. Those of `auto` are those of `kirchhoff`, which stands for the truth there. None where the
    model has no solution for the scene, or where the flexible yarn has several: the plain search may then have found
    another one than was reported.
    """
    vector = scene.dimensionless().vector
    if perhaps_several(vector) and len(find_roots(vector).w) > 1:
        return None
    if model == kirchhoff_spans.NAME:
        elastic, _ = kirchhoff_spans.find(scene)
        if not (isinstance(elastic, Refined) and outcome(elastic, scene)[0].ok):
            return None
        kind, orders, at_B = kirchhoff_spans.Spans, kirchhoff_spans.ORDERS, kirchhoff_spans.ends
        return _collocated(scene, vector, elastic, kind, orders, at_B)
    if model in (flexible.NAME, capstan.NAME):
        found = flexible.find(vector, flexible.integration_matrices())
        return _flexible(scene, vector, found) if outcome(found, scene)[0].ok else None
    rod = cosserat.ROD if model in (cosserat.NAME, cosserat_fd.NAME) else kirchhoff.ROD
    matrices = slow_manifold.collocation_matrices()
    found = slow_manifold.find(rod.problem(vector), flexible.integration_matrices(), matrices)
    if not outcome(found, scene)[0].ok:
        return None
    return _collocated(scene, vector, found, rod.problem, slow_manifold.ORDERS, _rod_ends)


def _rod_ends(tension_CD: Any, at_B: NDArray[Any]) -> NDArray[Any]:
    return slow_manifold.rod_ends(tension_CD, *at_B)


def _moved(scene: Scene) -> dict[str, tuple[float, SimpleNamespace, Complex]]:
    """For each input: its step, all inputs with this one moved by i · step, and the dimensionless numbers of these."""
    found: dict[str, tuple[float, SimpleNamespace, Complex]] = {}
    for name in (field.name for field in fields(Scene)):
        # Relative to the input's size, so that a step in 1e-9 N m² and one in 1e3 turns per metre are alike.
        step = COMPLEX_STEP * (abs(getattr(scene, name)) or 1.0)
        inputs = SimpleNamespace(**{f.name: complex(getattr(scene, f.name)) for f in fields(Scene)})
        setattr(inputs, name, getattr(inputs, name) + 1j * step)
        found[name] = step, inputs, np.array(list(normalised(inputs).values()), dtype=np.complex128)
    return found


def _ends(inputs: SimpleNamespace, dimensionless: NDArray[Any], step: float) -> Ends:
    """The slopes in SI from dimensionless ends that carry them in their imaginary part."""
    tension, twist, theta = dimensionless
    radius = inputs.cylinder_radius
    si = np.array([tension * inputs.torsional_rigidity / radius**2, twist / radius, theta], dtype=np.complex128)
    return Ends(*map(float, si.imag / step))


def _collocated(
    scene: Scene,
    vector: Array,
    found: Refined,
    make: Callable[[Any], Any],
    orders: NDArray[np.int64],
    ends: Callable[[Any, NDArray[Any]], NDArray[Any]],
) -> dict[str, Ends]:
    x = np.append(found.fields, found.w)
    grid = chebyshev_collocation(found.degree, scene.wrap_angle)
    _, matrix = evaluated(Collocated(make(vector), orders, grid.derivatives), x)
    at_B = slice(0, orders.size * (found.degree + 1), found.degree + 1)
    result: dict[str, Ends] = {}
    for name, (step, inputs, numbers) in _moved(scene).items():
        derivatives = chebyshev_collocation(found.degree, numbers[WRAP_ANGLE]).derivatives.astype(np.complex128)
        slopes = parameter_slopes(Collocated(make(numbers), orders, derivatives), x)
        direction = np.asarray(-np.linalg.solve(matrix, slopes), dtype=np.float64)
        moved = x[at_B] + 1j * COMPLEX_STEP * direction[at_B]
        result[name] = _ends(inputs, ends(numbers[TENSION_CD], moved), step)
    return result


def _flexible(scene: Scene, vector: Array, found: Refined) -> dict[str, Ends]:
    x = np.append(found.fields[0], found.w)
    integration = chebyshev_integration(found.degree)
    _, matrix = evaluated(flexible.Flexible(vector, integration * (scene.wrap_angle / 2)), x)
    result: dict[str, Ends] = {}
    for name, (step, inputs, numbers) in _moved(scene).items():
        problem = flexible.Flexible(numbers, integration * (numbers[WRAP_ANGLE] / 2))
        direction = np.asarray(-np.linalg.solve(matrix, parameter_slopes(problem, x)), dtype=np.float64)
        moved = x + 1j * COMPLEX_STEP * direction
        log_p, tau = flexible.at_B(problem, moved)
        result[name] = _ends(inputs, flexible.ends(numbers[TENSION_CD], moved[0], log_p, tau), step)
    return result
