"""The cheapest model whose estimated error meets a tolerance, for the quantities that are asked for.

The tiers, by cost: `capstan` (closed forms), `flexible` (no bending), `kirchhoff` (the consistent rod, which stands for
the truth here). A tier's estimated error is its discretisation error plus what it leaves out:

* capstan: it gives friction the direction that a yarn square to the cylinder axis would have, for which
  `capstan.direction_error` gives an estimate; it also leaves out bending, of the order B/(p₃r₀²).
* flexible: the first Newton correction of the rod's equations at the flexible solution, which is the effect of bending
  and torsion up to its square, for one Jacobian. It means nothing without scale separation; then the rod
  is tried and says so.

The printed model, `cosserat`, is never chosen: it costs what the consistent rod costs, and its frame term (B − K)τ²/p₃
is as large as its difference from that rod. The message gives this number, so that its users see what the choice of
rod decides.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from models import capstan, flexible, kirchhoff
from models.discretisation import derivatives
from models.outcome import Solution
from models.refinement import SETTLED, Refined
from models.scene import BENDING_RIGIDITY, Scene
from models.self_consistency import find_roots
from models.slow_manifold import CORRECTION_DEGREE, first_correction
from models.uniqueness import perhaps_several

Array = NDArray[np.float64]

NAME = "auto"
TOLERANCE = 0.01
"""Default for the largest relative error."""
ENDS = ("tension_AB", "twist_AB", "theta_B")


def bending_effect(scene: Array, yarn: Refined) -> Array:
    """Relative effect of bending and torsion on p₃AB, T_AB and θ_B, shape (3,); infinite where it means nothing."""
    return first_correction(kirchhoff.Consistent(scene), yarn, derivatives((CORRECTION_DEGREE,)))


def solve_auto(
    scene: Scene, *, profile: bool = True, tolerance: float = TOLERANCE, wanted: Sequence[str] = ENDS
) -> Solution:
    """Solve with the cheapest tier that meets `tolerance`; the message says which and why.

    Parameters
    ----------
    wanted : the ends that the tolerance is for, names of `Ends`; fewer ends may need a cheaper tier only.

    Raises
    ------
    ValueError
        If the tolerance is not positive, or a wanted name is unknown.
    """
    if not tolerance > 0:
        raise ValueError(f"tolerance = {tolerance}: must be greater than 0")
    for name in wanted:
        if name not in ENDS:
            raise ValueError(f"unknown quantity '{name}'; known: {', '.join(ENDS)}")
    asked = [ENDS.index(name) for name in wanted]
    vector = scene.dimensionless().vector
    estimates: dict[str, float] = {}

    def meets(tier: str, errors: Array) -> bool:
        estimates[tier] = float(np.max(errors[asked]))
        return estimates[tier] <= tolerance

    # Of several solutions a plain search finds any; the rod's own solve takes the one that the yarn settles on.
    alone = not perhaps_several(vector) or len(find_roots(vector).w) == 1
    simple = capstan.find(vector)
    if alone and simple.ending == SETTLED:
        bending = vector[BENDING_RIGIDITY] / float(simple.ends[0])
        if meets(capstan.NAME, capstan.direction_error(vector, simple) + bending):
            return _told(capstan.solve_capstan(scene, profile=profile), estimates, tolerance)
    yarn = flexible.find(vector, flexible.integration_matrices())
    if alone and yarn.ending == SETTLED and meets(flexible.NAME, bending_effect(vector, yarn) + yarn.size):
        return _told(flexible.solve_flexible(scene, profile=profile), estimates, tolerance)
    rod = kirchhoff.solve_kirchhoff(scene, profile=profile)
    if rod.outcome.ok:
        sizes = np.array([rod.ends.tension_AB, max(abs(rod.ends.twist_AB), scene.twist_unit), rod.ends.theta_B])
        meets(kirchhoff.NAME, np.array([rod.u_num.tension_AB, rod.u_num.twist_AB, rod.u_num.theta_B]) / sizes)
    return _told(rod, estimates, tolerance)


def _told(found: Solution, estimates: dict[str, float], tolerance: float) -> Solution:
    """The solution under the name of this module, with what was chosen and why in front of its message."""
    errors = ", ".join(f"{tier} {error:.1e}" for tier, error in estimates.items())
    reason = f"by {found.model}: estimated relative errors {errors}; asked for {tolerance:g}"
    if found.outcome.ok:
        scene, ends = found.scene, found.ends
        material_twist = 2 * np.pi * ends.twist_AB + np.sin(ends.theta_B) * np.cos(ends.theta_B) / scene.cylinder_radius
        frame_term = (scene.rigidity_ratio - 1) * scene.torsional_rigidity * material_twist**2 / ends.tension_AB
        reason += f"; frame term of the printed model (B - K)τ²/p₃ = {frame_term:.1e}"
    message = f"{found.message}; {reason}" if found.message else reason
    return replace(found, model=NAME, message=message)
