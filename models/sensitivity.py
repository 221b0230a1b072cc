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

from models import capstan, cosserat, flexible, kirchhoff, kirchhoff_spans, slow_manifold
from models.boundary_value import COMPLEX_STEP, Array, BoundaryValueResult, Collocated, parameter_slopes
from models.discretisation import chebyshev_collocation
from models.newton import NewtonStatus
from models.outcome import Ends
from models.scene import Scene, normalised
from models.self_consistency import STRONG_FEEDBACK, feedback, find_roots
from models.slow_manifold import Rod

Complex = NDArray[np.complex128]


def sensitivities(scene: Scene, model: str) -> Mapping[str, Ends] | None:
    """Derivatives of the ends by field name of `Scene`, each in SI units of the end per SI unit of the input.

    `cosserat-fd` shares the equations of `cosserat`, and `capstan` is an approximation of `flexible`: the derivatives
    are those of the latter. None where the model has no solution for the scene, or where the flexible yarn has several:
    the plain search may then have found another one than was reported.
    """
    problem = scene.dimensionless()
    if feedback(problem.vector) >= STRONG_FEEDBACK and len(find_roots(problem.vector).w) > 1:
        return None
    if model in (flexible.NAME, capstan.NAME):
        result, degree, error, _ = flexible.solve_fields(problem)
        solved = error is not None and result.status is NewtonStatus.CONVERGED
        kind, orders = flexible.Flexible, flexible.ORDERS
        return _sensitivities(scene, result, degree, orders, kind, flexible.ends) if solved else None
    if model == kirchhoff_spans.NAME:
        elastic, degree, error, _ = kirchhoff_spans.solve_fields(problem)
        kind, orders = kirchhoff_spans.Spans, kirchhoff_spans.ORDERS
        if elastic is not None and error is not None:
            return _sensitivities(scene, elastic, degree, orders, kind, kirchhoff_spans.ends)
        return None
    rod: Rod = kirchhoff.ROD if model == kirchhoff.NAME else cosserat.ROD
    found = slow_manifold.search(problem, rod)
    if found.error is None or found.result is None:
        return None
    return _sensitivities(scene, found.result, found.degree, slow_manifold.ORDERS, rod.problem, slow_manifold.rod_ends)


def _sensitivities(
    scene: Scene,
    result: BoundaryValueResult,
    degree: int,
    orders: NDArray[np.int64],
    make: Callable[[Complex], Any],
    dimensionless_ends: Callable[[Any, Complex], NDArray[Any]],
) -> dict[str, Ends]:
    x = np.append(result.fields, result.w)
    m, size = result.fields.shape
    moved: dict[str, tuple[SimpleNamespace, dict[str, Any]]] = {}
    columns: list[Array] = []
    for name in (field.name for field in fields(Scene)):
        inputs = SimpleNamespace(**{f.name: complex(getattr(scene, f.name)) for f in fields(Scene)})
        # Relative to the input's size, so that a step in 1e-9 N m² and one in 1e3 turns per metre are alike.
        step = 1j * COMPLEX_STEP * (abs(getattr(scene, name)) or 1.0)
        setattr(inputs, name, getattr(inputs, name) + step)
        numbers = normalised(inputs)
        vector = np.array(list(numbers.values()), dtype=np.complex128)
        matrices = chebyshev_collocation(degree, numbers["wrap_angle"]).derivatives.astype(np.complex128)
        columns.append(parameter_slopes(Collocated(make(vector), orders, matrices), x))
        moved[name] = inputs, numbers
    slopes = np.asarray(-np.linalg.solve(result.jacobian, np.array(columns).T), dtype=np.float64)
    found: dict[str, Ends] = {}
    for j, (name, (inputs, numbers)) in enumerate(moved.items()):
        slope: Array = slopes[:, j]
        at_B = result.fields[:, 0] + 1j * COMPLEX_STEP * slope[: m * size : size]
        tension, twist, theta = dimensionless_ends(numbers["tension_CD"], at_B)
        radius = inputs.cylinder_radius
        ends = np.array([tension * inputs.torsional_rigidity / radius**2, twist / radius, theta], dtype=np.complex128)
        unit = COMPLEX_STEP * (abs(getattr(scene, name)) or 1.0)
        found[name] = Ends(*map(float, ends.imag / unit))
    return found
