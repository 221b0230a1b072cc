"""What became of a solve: an outcome whose text advises, and the solution with its evidence."""

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from models.scene import Scene

Array = NDArray[np.float64]


class Outcome(Enum):
    """How a solve ended; the value is the text that tells the user what it means and what to do."""

    CONVERGED = "converged"
    SEVERAL_SOLUTIONS = (
        "the twist acts back on itself so strongly that the scene has several solutions; unless another is asked for, "
        "the one is taken that the yarn settles on while the friction is raised from zero"
    )
    NOT_CONVERGED = (
        "Newton's method did not reach a small residual: start from a nearer solution, or approach this scene in "
        "steps from one that converges"
    )
    SINGULAR = "the linear system of a Newton step is singular: the scene may be at a fold, where two solutions meet"
    FOLD = (
        "two solutions meet at a fold and vanish: on the branch that starts at the frictionless yarn there is no "
        "solution beyond it"
    )
    STICKING = (
        "the yarn comes to rest on the moving surface over a part of the contact, where friction has no direction: "
        "there is no sliding solution"
    )
    NO_SCALE_SEPARATION = (
        "the end layers are no faster than the solution between them, so the equations with four boundary conditions "
        "do not determine a solution: use the flexible model, or raise the tension"
    )
    UNRESOLVED = "the solution is steeper than a polynomial of the highest degree can follow"
    LIFT_OFF = "the normal force is not positive everywhere: the yarn lifts off the cylinder and contact is lost"
    BAD_INPUT = "the row is no valid scene"

    @property
    def ok(self) -> bool:
        """Whether the numbers are a solution of the model."""
        return self in (Outcome.CONVERGED, Outcome.SEVERAL_SOLUTIONS)


SOLVED = frozenset(outcome.name.lower() for outcome in Outcome if outcome.ok)
"""Names, as tables hold them, of the outcomes whose numbers are a solution."""


class SolveError(RuntimeError):
    """Raised on request when a solve ends without numbers; carries the solution."""

    def __init__(self, solution: "Solution"):
        super().__init__(f"{solution.model}: {solution.outcome.name.lower()}: {solution.message}")
        self.solution = solution


@dataclass(frozen=True, slots=True)
class Profile:
    """A solution along the contact, all arrays of shape (n,), in SI, ordered from B (ψ = 0) to C (ψ = φ)."""

    psi: Array
    """Angle around the cylinder [rad]."""
    theta: Array
    """Angle between yarn and cylinder axis [rad]."""
    tension: Array
    """p₃ [N]."""
    twist: Array
    """T, inserted twist [1/m]."""
    normal_force: Array
    """N, force of the cylinder on the yarn per length [N/m]."""
    bending_moment: Array
    """Bκ [N m]."""
    torsional_moment: Array
    """Kτ [N m]."""
    z: Array
    """Position along the cylinder axis [m], 0 at B."""


@dataclass(frozen=True, slots=True)
class Ends:
    """The numbers that are compared with a measurement, in SI; also used for their numerical uncertainties."""

    tension_AB: float = math.nan
    """p₃AB [N]."""
    twist_AB: float = math.nan
    """T_AB [1/m]."""
    theta_B: float = math.nan
    """θ_B [rad]."""


@dataclass(frozen=True, slots=True)
class Stats:
    """Evidence of a solve. Residuals are maximum norms of the dimensionless discrete equations."""

    iterations: int = 0
    residual: float = math.nan
    boundary_residual: float = math.nan
    step: float = math.nan
    nodes: int = 0
    condition: float = math.nan
    """Condition number of the last Jacobian, where it was computed."""


@dataclass(frozen=True, slots=True)
class Solution:
    """The solution of `scene` by `model`. A failed solve keeps scene, outcome and reason; its numbers are NaN."""

    scene: Scene
    model: str
    outcome: Outcome
    message: str
    ends: Ends = field(default_factory=Ends)
    u_num: Ends = field(default_factory=Ends)
    """Estimated numerical (discretisation) error of `ends`."""
    theta_C: float = math.nan
    """θ at the end of contact [rad]."""
    rotation: float = math.nan
    """n₁, rotation of the yarn by the cylinder [1/s]."""
    normal_force_min: float = math.nan
    """Smallest N along the contact [N/m]."""
    profile: Profile | None = None
    stats: Stats = field(default_factory=Stats)

    def require(self) -> "Solution":
        """Return self, or raise `SolveError` if the solve failed."""
        if not self.outcome.ok:
            raise SolveError(self)
        return self
