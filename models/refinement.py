"""What a search over polynomial degrees ends with, as compiled code returns it, and what that means.

One record for all models that are solved by collocation or quadrature of rising degree, so that a single solve and a
batch share the same code and the same words.
"""

import math
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import inner
from models.newton import NewtonStatus
from models.outcome import Outcome, Stats
from models.scene import Scene

Array = NDArray[np.float64]


class Ending(IntEnum):
    """Why a search over degrees ended."""

    SETTLED = 0
    """The ends changed by less than the precision, or by as little as they ever will."""
    NEWTON_FAILED = 1
    """No degree was solved; `Refined.status` says why."""
    UNRESOLVED = 2
    """Still changing at the highest degree."""
    ILL_CONDITIONED = 3
    """Fast modes are in the discrete problem from the lowest degrees on."""
    DRIFTING = 4
    """The ends never changed by little enough from one degree to the next."""
    START_FAILED = 5
    """The flexible yarn, from which the rods start, was not solved."""


SETTLED, NEWTON_FAILED, UNRESOLVED, ILL_CONDITIONED, DRIFTING, START_FAILED = map(int, Ending)
"""The endings as compiled code knows them."""


class Refined(NamedTuple):
    """The best solution of a search, dimensionless, or the last attempt."""

    ending: int
    """`Ending`."""
    status: int
    """`NewtonStatus` at the last degree that was tried."""
    degree: int
    fields: Array
    """At the Lobatto nodes from B to C, shape (3, degree + 1): q, ln(p₃/p₃CD), τ (flexible) or θ, p₃/p₃CD, τ."""
    w: float
    """n₁/v."""
    ends: Array
    """p₃AB, T_AB and θ_B, shape (3,)."""
    change: Array
    """Their change from the degree before, shape (3,)."""
    size: float
    """The same relative to the ends, the largest of the three."""
    theta_C: float
    normal_min: float
    """Smallest N in K/r₀³ at nodes and collocation points."""
    psi_min: float
    """Where, in radians from B."""
    iterations: int
    step: float
    residual: float
    boundary_residual: float
    condition: float


ROW = np.dtype(
    [
        ("ending", np.int64), ("status", np.int64), ("degree", np.int64), ("iterations", np.int64),
        ("tension_AB", np.float64), ("twist_AB", np.float64), ("theta_B", np.float64),
        ("u_tension_AB", np.float64), ("u_twist_AB", np.float64), ("u_theta_B", np.float64),
        ("theta_C", np.float64), ("w", np.float64), ("normal_min", np.float64), ("psi_min", np.float64),
        ("size", np.float64), ("step", np.float64), ("residual", np.float64), ("boundary_residual", np.float64),
        ("condition", np.float64),
    ]
)  # fmt: skip
"""A `Refined` without its fields, as a row of a table."""


def relative_change(ends: Array, other: Array) -> float:
    """Largest change of p₃AB, T_AB, θ_B, relative to its size (twist: to 1 turn per circumference at least)."""
    tension = abs((ends[0] - other[0]) / ends[0])
    twist = abs(ends[1] - other[1]) / max(abs(ends[1]), 1 / (2 * np.pi))
    change = max(tension, twist, abs((ends[2] - other[2]) / ends[2]))
    return change if np.isfinite(tension + twist) else np.inf


compiled_relative_change = inner(relative_change)


@inner
def record(found: Refined, row: Any) -> None:
    """Write to a row of type ROW."""
    row.ending, row.status, row.degree, row.iterations = found.ending, found.status, found.degree, found.iterations
    row.tension_AB, row.twist_AB, row.theta_B = found.ends[0], found.ends[1], found.ends[2]
    row.u_tension_AB, row.u_twist_AB, row.u_theta_B = abs(found.change[0]), abs(found.change[1]), abs(found.change[2])
    row.theta_C, row.w, row.normal_min, row.psi_min = found.theta_C, found.w, found.normal_min, found.psi_min
    row.size, row.step, row.condition = found.size, found.step, found.condition
    row.residual, row.boundary_residual = found.residual, found.boundary_residual


def outcome(found: Refined, scene: Scene) -> tuple[Outcome, str]:
    """The outcome of a solution in words that advise."""
    match Ending(found.ending):
        case Ending.SETTLED if found.normal_min > 0:
            return Outcome.CONVERGED, ""
        case Ending.SETTLED:
            lowest, where = found.normal_min * scene.force_unit / scene.cylinder_radius, math.degrees(found.psi_min)
            result, detail = Outcome.LIFT_OFF, f"N = {lowest:.3g} N/m at ψ = {where:.1f}°"
        case Ending.NEWTON_FAILED:
            reason = NewtonStatus(found.status)
            result = Outcome.SINGULAR if reason is NewtonStatus.SINGULAR else Outcome.NOT_CONVERGED
            detail = reason.text
        case Ending.START_FAILED:
            result, detail = Outcome.NOT_CONVERGED, f"the flexible start: {NewtonStatus(found.status).text}"
        case Ending.UNRESOLVED:
            result, detail = Outcome.UNRESOLVED, f"degree {found.degree}"
        case Ending.ILL_CONDITIONED:
            detail = f"condition number {found.condition:.1e} at the lowest degrees"
            result = Outcome.NO_SCALE_SEPARATION
        case Ending.DRIFTING:
            result, detail = Outcome.NO_SCALE_SEPARATION, f"the ends change by {found.size:.1e} between degrees"
    return result, f"{result.value} ({detail})"


def stats(found: Refined) -> Stats:
    """The evidence of the solve."""
    return Stats(
        found.iterations, found.residual, found.boundary_residual, found.step, found.degree + 1, found.condition
    )
