"""A yarn of nodes with axial and bending stiffness: internal forces and stored energy, compiled.

Elements of natural length L₀ join the nodes; element i runs from node i to node i + 1, with unit vector tᵢ and length
lᵢ. Energy: ½ EA L₀ [(1 − Σ g_k) e² + Σ g_k (e − v_k)²] per element, e = l/L₀ − 1, v_k the strain of the dashpot of
Prony branch k, and (B/L₀)(1 − tᵢ₋₁ · tᵢ) per inner node, which is B κ² L₀ / 2 to second order in the angle. The force
of element i on node i + 1, and its negative on node i, then is

    −Tᵢ tᵢ + (B/L₀)/lᵢ [tᵢ₋₁ + tᵢ₊₁ − (tᵢ₋₁·tᵢ + tᵢ·tᵢ₊₁) tᵢ].
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import compiled, inner

Array = NDArray[np.float64]


class Rod(NamedTuple):
    """Nodes and elements; arrays have room for more nodes than there are. SI."""

    x: Array
    y: Array
    z: Array
    vx: Array
    vy: Array
    vz: Array
    tx: Array
    """Unit vector of each element."""
    ty: Array
    tz: Array
    length: Array
    tension: Array
    """With bulk viscosity [N]."""
    rate: Array
    """Rate of lengthening of each element [m/s]."""
    dashpots: Array
    """v_k, strains of the Prony dashpots, shape (branches, room)."""
    relaxed: Array
    """Σ g_k v_k."""
    fx: Array
    """Force on each node."""
    fy: Array
    fz: Array


class Material(NamedTuple):
    """Constants of the elements, SI."""

    natural: float
    """L₀."""
    axial: float
    """EA, instantaneous."""
    bending: float
    """B."""
    viscosity: float
    """Bulk viscosity: tension per rate of lengthening [N s/m]."""


def new_rod(room: int, branches: int) -> Rod:
    """An empty rod with `room` for nodes, at rest."""
    names = {name: np.zeros(room) for name in Rod._fields}
    return Rod(**{**names, "dashpots": np.zeros((branches, room))})


@inner
def stretch(rod: Rod, m: Material, n: int, dt: float) -> float:
    """Directions, lengths and tensions of the elements between n nodes; energy lost to bulk viscosity in a step [J]."""
    lost = 0.0
    for i in range(n - 1):
        dx, dy, dz = rod.x[i + 1] - rod.x[i], rod.y[i + 1] - rod.y[i], rod.z[i + 1] - rod.z[i]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        inverse = 1.0 / length
        dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
        rod.tx[i], rod.ty[i], rod.tz[i], rod.length[i] = dx, dy, dz, length
        rate = (rod.vx[i + 1] - rod.vx[i]) * dx + (rod.vy[i + 1] - rod.vy[i]) * dy + (rod.vz[i + 1] - rod.vz[i]) * dz
        # The force of the last step acted while the rate went from the old to the new value.
        lost += m.viscosity * rod.rate[i] * (rod.rate[i] + rate)
        rod.rate[i] = rate
        rod.tension[i] = m.axial * (length / m.natural - 1.0 - rod.relaxed[i]) + m.viscosity * rate
    return lost * dt / 2


@inner
def internal_forces(rod: Rod, m: Material, n: int) -> None:
    """Fill fx, fy, fz of n nodes with the forces of the elements (call `stretch` first)."""
    stiffness = m.bending / m.natural
    px, py, pz = 0.0, 0.0, 0.0
    before = 0.0
    for i in range(n - 1):
        tx, ty, tz = rod.tx[i], rod.ty[i], rod.tz[i]
        bx, by, bz, cosines = 0.0, 0.0, 0.0, 0.0
        if i > 0:
            bx, by, bz, cosines = rod.tx[i - 1], rod.ty[i - 1], rod.tz[i - 1], before
        if i < n - 2:
            before = tx * rod.tx[i + 1] + ty * rod.ty[i + 1] + tz * rod.tz[i + 1]
            bx, by, bz, cosines = bx + rod.tx[i + 1], by + rod.ty[i + 1], bz + rod.tz[i + 1], cosines + before
        q = stiffness / rod.length[i]
        along = rod.tension[i] + q * cosines
        qx, qy, qz = q * bx - along * tx, q * by - along * ty, q * bz - along * tz
        rod.fx[i], rod.fy[i], rod.fz[i] = px - qx, py - qy, pz - qz
        px, py, pz = qx, qy, qz
    rod.fx[n - 1], rod.fy[n - 1], rod.fz[n - 1] = px, py, pz


@inner
def relax(rod: Rod, m: Material, n: int, weights: Array, shares: Array) -> float:
    """Let the Prony dashpots creep by `shares` = 1 − exp(−Δt/τ_k), shape (branches,); the energy lost [J]."""
    lost = 0.0
    for i in range(n - 1):
        strain = rod.length[i] / m.natural - 1.0
        rod.relaxed[i] = 0.0
        for k in range(weights.shape[0]):
            open_ = strain - rod.dashpots[k, i]
            rod.dashpots[k, i] += shares[k] * open_
            rod.relaxed[i] += weights[k] * rod.dashpots[k, i]
            lost += weights[k] * open_ * open_ * shares[k] * (2.0 - shares[k])
    return m.axial * m.natural / 2 * lost


@inner
def strain_energy(rod: Rod, m: Material, weights: Array, n: int) -> float:
    """Axial energy with that of the Prony springs [J]."""
    total = 0.0
    for i in range(n - 1):
        strain = rod.length[i] / m.natural - 1.0
        square, rest = 0.0, 1.0
        for k in range(weights.shape[0]):
            square += weights[k] * (strain - rod.dashpots[k, i]) ** 2
            rest -= weights[k]
        total += square + rest * strain * strain
    return m.axial * m.natural / 2 * total


@inner
def bending_energy(rod: Rod, m: Material, n: int) -> float:
    """Bending energy [J]."""
    total = 0.0
    for i in range(n - 2):
        # 1 − cos = |difference of the unit vectors|² / 2, without cancellation
        dx, dy, dz = rod.tx[i + 1] - rod.tx[i], rod.ty[i + 1] - rod.ty[i], rod.tz[i + 1] - rod.tz[i]
        total += dx * dx + dy * dy + dz * dz
    return m.bending / m.natural / 2 * total


@inner
def kinetic_energy(rod: Rod, mass: float, n: int) -> float:
    """Kinetic energy of n nodes of `mass` [J]."""
    total = 0.0
    for i in range(n):
        total += rod.vx[i] ** 2 + rod.vy[i] ** 2 + rod.vz[i] ** 2
    return mass / 2 * total


@inner
def push(rod: Rod, first: int, n: int, mass: float, dt: float) -> None:
    """Move nodes first … n − 1 by a step: velocities by the forces, positions by the new velocities."""
    gain = dt / mass
    for i in range(first, n):
        rod.vx[i] += gain * rod.fx[i]
        rod.vy[i] += gain * rod.fy[i]
        rod.vz[i] += gain * rod.fz[i]
        rod.x[i] += dt * rod.vx[i]
        rod.y[i] += dt * rod.vy[i]
        rod.z[i] += dt * rod.vz[i]


@compiled
def elastic_state(rod: Rod, m: Material, weights: Array, n: int) -> tuple[float, float]:
    """Forces and tensions of n nodes as they are, and the axial and the bending energy [J]."""
    stretch(rod, m, n, 0.0)
    internal_forces(rod, m, n)
    return strain_energy(rod, m, weights, n), bending_energy(rod, m, n)


@compiled
def swing(rod: Rod, m: Material, n: int, mass: float, dt: float, steps: int, fixed: int) -> None:
    """Explicit motion of a free rod of n nodes of `mass` [kg], the first `fixed` held, for `steps` of `dt` [s]."""
    for _ in range(steps):
        stretch(rod, m, n, dt)
        internal_forces(rod, m, n)
        push(rod, fixed, n, mass, dt)
