"""From dimensionless fields to a `Solution` in SI, the same for every model."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from models.boundary_value import Array
from models.newton import NewtonStatus
from models.outcome import Ends, Outcome, Profile, Solution, Stats
from models.scene import Dimensionless, Scene

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
    w: float
    """n₁ / v."""
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

    @property
    def ends(self) -> Array:
        """p₃AB, T_AB, θ_B."""
        return np.array([self.tension[0], self.twist[0], self.theta[0]])


def relative_change(ends: Array, other: Array) -> float:
    """Largest change of p₃AB, T_AB, θ_B, relative to its size (twist: to 1 turn per circumference at least)."""
    size = np.array([ends[0], max(abs(ends[1]), 1 / (2 * np.pi)), ends[2]])
    return float(np.max(np.abs(ends - other) / np.abs(size)))


def solution(scene: Scene, model: str, fields: Fields, error: Array, stats: Stats, *, others: str = "") -> Solution:
    """Build the solution in SI, or the lift-off outcome where the normal force is not positive.

    Parameters
    ----------
    error : estimated absolute errors of `fields.ends`, shape (3,).
    others : what is known of other solutions of the scene; empty where there are none.
    """
    force, length = scene.force_unit, scene.cylinder_radius
    normal = fields.normal_force * force / length
    lowest = int(np.argmin(normal))
    if normal[lowest] <= 0:
        where = math.degrees(fields.psi[lowest])
        return failed(
            scene,
            model,
            Outcome.LIFT_OFF,
            f"{Outcome.LIFT_OFF.value} (N = {normal[lowest]:.3g} N/m at ψ = {where:.1f}°)",
            stats=stats,
            normal_force_min=float(normal[lowest]),
        )
    cotangent = 1 / np.tan(fields.theta)
    profile = Profile(
        psi=fields.psi,
        theta=fields.theta,
        tension=fields.tension * force,
        twist=fields.twist / length,
        normal_force=normal,
        bending_moment=fields.scene.bending_rigidity * fields.curvature * scene.moment_unit,
        torsional_moment=fields.tau * scene.moment_unit,
        z=CubicSpline(fields.psi, cotangent).antiderivative()(fields.psi) * length,
    )
    to_si = np.array([force, 1 / length, 1.0])
    return Solution(
        scene=scene,
        model=model,
        outcome=Outcome.SEVERAL_SOLUTIONS if others else Outcome.CONVERGED,
        message=f"{Outcome.SEVERAL_SOLUTIONS.value} ({others})" if others else "",
        ends=Ends(*map(float, fields.ends * to_si)),
        u_num=Ends(*map(float, np.abs(error) * to_si)),
        theta_C=float(fields.theta[-1]),
        rotation=fields.w * scene.delivery_speed / length,
        normal_force_min=float(normal[lowest]),
        profile=profile,
        stats=stats,
    )


def newton_outcome(status: NewtonStatus) -> tuple[Outcome, str]:
    """The outcome and the message for a Newton iteration that did not converge."""
    outcome = Outcome.SINGULAR if status is NewtonStatus.SINGULAR else Outcome.NOT_CONVERGED
    return outcome, f"{outcome.value} ({status.text})"


def failed(
    scene: Scene,
    model: str,
    outcome: Outcome,
    message: str,
    *,
    stats: Stats | None = None,
    normal_force_min: float = math.nan,
) -> Solution:
    """A solution whose numbers are NaN, with the reason."""
    return Solution(
        scene=scene,
        model=model,
        outcome=outcome,
        message=message,
        stats=stats or Stats(),
        normal_force_min=normal_force_min,
    )
