"""How much tension a yarn keeps when it lands on a bobbin that yields under it and grips it.

Steady landing at T₀, s ≥ 0 the way round the bobbin from where the yarn first touches, w(s) its sinking, u(s) its
displacement along the surface from where it touched, τ(s) = T − T₀, λ the grip length:

    B w⁗ − T₀ w″ + K_t w = (T₀ + τ)/R           beam on an elastic foundation, R the radius of its path's curvature
    τ′ = EA u/λ²                                 the grip
    τ = EA [u′ − w/R + w′²/2], from its value at 0          as much material passes each s in the same time

with w = u = τ = 0 at s = 0. Before the touch the yarn is straight but for its bending, w″ + 1/R ∝ exp(s/√(B/T₀)); at 0
w′, w″ and w‴ have no jump. Without the slope's square this is linear: exponentials whose squared rates q solve
(B q² − T₀ q + K_t)(λ² q − 1) = EA/R². The slope's square is added to first order.

A rigid grip (λ → 0) holds the yarn before it sinks: it keeps 1/(1 + EA/(R² K_t)) of its tension, less the square. A
soft one lets the span draw out the slack. Left out: inertia (T₀ ≫ ρV²), the bobbin's dashpots.

Foundation as in Hetényi, Beams on Elastic Foundation (1946), chapter VI (with axial tension).
"""

import math

import numpy as np

from models.winding.scene import WindingScene

STRAIGHTEST = 1e-6
"""Least B K_t/T₀² that is computed with: without bending the equations lose their highest derivative."""


def kept_share(
    tension: float, axial: float, bending: float, surface: float, radius: float, grip_length: float
) -> float:
    """T/T₀ of a yarn that has landed.

    Parameters
    ----------
    tension : T₀ [N].
    axial, bending : EA [N], B [N m²].
    surface : K_t [N/m²].
    radius : R [m].
    grip_length : λ [m].
    """
    b = max(bending, STRAIGHTEST * tension**2 / surface)
    cubic = np.polymul([b, -tension, surface], [grip_length**2, -1.0])
    cubic[-1] -= axial / radius**2
    rates = -np.sqrt(np.roots(cubic).astype(complex))  # the principal root: these decay
    pulled = axial / (radius * (grip_length**2 * rates**2 - 1))  # τ over w in each exponential
    straight = math.sqrt(b / tension)
    # Unknown: the three exponentials in w, and w and τ far from the touch.
    matrix, given = np.zeros((5, 5), complex), np.zeros(5, complex)
    matrix[0, :4] = 1.0  # w = 0
    matrix[1, :3], given[1] = rates**2 - straight * rates**3, -1 / radius
    matrix[2, :3], matrix[2, 4] = pulled, 1.0  # τ = 0
    matrix[3, :3] = pulled * rates  # u = 0
    matrix[4, 3:], given[4] = (surface, -1 / radius), tension / radius
    first = np.linalg.solve(matrix, given)
    # The square of the slope is a sum of products of two exponentials; the same five unknowns keep the conditions at 0.
    slopes, both = first[:3] * rates, np.add.outer(rates, rates).ravel()
    yields = np.polyval([b, 0.0, -tension, 0.0, surface], both)
    pulls = -axial / 2 * np.outer(slopes, slopes).ravel()
    pulls /= grip_length**2 * both**2 - 1 - axial / radius**2 / yields
    sinks = pulls / (radius * yields)
    at_touch = [sinks.sum(), sinks @ (both**2 - straight * both**3), pulls.sum(), pulls @ both, 0.0]
    second = np.linalg.solve(matrix, -np.array(at_touch))
    return float(1 + (first[4] + second[4]).real / tension)


def sunk_share(scene: WindingScene) -> float:
    """Share of its sinking at T₀ after which a yarn that is held fast ends with the tension of `kept_share`.

    Above 1 where its bending presses it deeper than its tension while it lands, below 0 where the slope alone costs it
    more than all its sinking.
    """
    radius = scene.bobbin_radius / math.cos(scene.winding_angle) ** 2  # of a helix
    softness = scene.axial_stiffness / (radius**2 * scene.transverse_stiffness)
    kept = kept_share(
        scene.tension,
        scene.axial_stiffness,
        scene.bending_stiffness,
        scene.transverse_stiffness,
        radius,
        scene.grip_length,
    )
    return (kept * (1 + softness) - 1) / softness
