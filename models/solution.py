"""From a dimensionless result to a `Solution` in SI, the same for every model."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.outcome import Ends, Outcome, Profile, Solution, Stats
from models.refinement import Refined, outcome, stats
from models.scene import Dimensionless, Scene

Array = NDArray[np.float64]

PROFILE_POINTS = 121


@dataclass(frozen=True, slots=True)
class Fields:
    """Dimensionless solution on an ascending grid over the contact, all arrays of shape (n,)."""

    scene: Dimensionless
    psi: Array
    theta: Array
    theta_slope: Array
    """dθ/dψ."""
    tension: Array
    tau: Array
    """τ = 2πT + sinθ cosθ."""
    normal_force: Array

    @property
    def twist(self) -> Array:
        """Inserted twist T in 1/r₀, shape (n,)."""
        return (self.tau - np.sin(self.theta) * np.cos(self.theta)) / (2 * np.pi)

    @property
    def curvature(self) -> Array:
        """κ = sinθ √(θ'² + sin²θ) in 1/r₀, shape (n,)."""
        sine = np.sin(self.theta)
        return sine * np.sqrt(self.theta_slope**2 + sine**2)


def solution(
    scene: Scene, model: str, found: Refined, fields: Callable[[], Fields] | None, *, others: str = ""
) -> Solution:
    """Build the solution in SI; its numbers are NaN and the outcome says why where there is none.

    Parameters
    ----------
    fields : evaluates the solution along the contact; None where only the numbers are asked for.
    others : what is known of other solutions of the scene; empty where there are none.
    """
    result, message = outcome(found, scene)
    lowest = found.normal_min * scene.force_unit / scene.cylinder_radius
    if not result.ok:
        return failed(scene, model, result, message, found, lowest if result is Outcome.LIFT_OFF else math.nan)
    if others:
        result, message = Outcome.SEVERAL_SOLUTIONS, f"{Outcome.SEVERAL_SOLUTIONS.value} ({others})"
    to_si = np.array([scene.force_unit, 1 / scene.cylinder_radius, 1.0])
    return Solution(
        scene=scene,
        model=model,
        outcome=result,
        message=message,
        ends=Ends(*map(float, found.ends * to_si)),
        u_num=Ends(*map(float, np.abs(found.change) * to_si)),
        theta_C=float(found.theta_C),
        rotation=float(found.w) * scene.delivery_speed / scene.cylinder_radius,
        normal_force_min=float(lowest),
        profile=_profile(scene, fields()) if fields else None,
        stats=stats(found),
    )


def failed(
    scene: Scene,
    model: str,
    result: Outcome,
    message: str,
    found: Refined | None = None,
    normal_force_min: float = math.nan,
) -> Solution:
    """A solution whose numbers are NaN, with the reason."""
    return Solution(
        scene=scene,
        model=model,
        outcome=result,
        message=message,
        normal_force_min=normal_force_min,
        stats=stats(found) if found else Stats(),
    )


def _profile(scene: Scene, fields: Fields) -> Profile:
    force, length = scene.force_unit, scene.cylinder_radius
    return Profile(
        psi=fields.psi,
        theta=fields.theta,
        tension=fields.tension * force,
        twist=fields.twist / length,
        normal_force=fields.normal_force * force / length,
        bending_moment=fields.scene.bending_rigidity * fields.curvature * scene.moment_unit,
        torsional_moment=fields.tau * scene.moment_unit,
        z=_axial_position(fields) * length,
    )


def _axial_position(fields: Fields) -> Array:
    """∫ cotθ dψ from B in r₀, shape (n,), by cubic Hermite pieces."""
    value, slope = 1 / np.tan(fields.theta), -fields.theta_slope / np.sin(fields.theta) ** 2
    step = np.diff(fields.psi)
    pieces = step / 2 * (value[1:] + value[:-1]) - step**2 / 12 * np.diff(slope)
    return np.concatenate([[0.0], np.cumsum(pieces)])
