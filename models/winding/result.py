"""What became of a winding run: outcome, tension of the span and of the layers, the package, the energy."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from models.winding.scene import WindingScene

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Progress = Callable[[float], None]
"""Called now and then with the share of the work that is done, 0 to 1."""
Kept = dict[str, NDArray[Any]]
"""Everything that a reference run needs to go on, by name; `numpy.savez` and `numpy.load` keep it exactly."""


class Checkpoint(Protocol):
    """Where a reference run keeps its state; models know no files, so the caller says how."""

    def load(self) -> Kept | None:
        """The state to go on from, or None to start anew."""
        ...

    def save(self, kept: Kept) -> None:
        """Keep `kept`, replacing the one before."""
        ...


GIVING = 0.05
"""Approach over the diameter above which a completed run says that its contacts give way."""


class WindingOutcome(Enum):
    """How a run ended; the value is the text that tells the user what it means and what to do."""

    COMPLETED = "completed"
    TIME_STEP = "the time step is above the limit of stability: choose a smaller one, or leave it out"
    DIVERGED = "the motion is no longer finite: raise the tension, soften the contact, or shorten the step"
    RESTLESS = "the package did not come to rest: check diameter, tension and transverse stiffness"
    TAIL_SPENT = "the tail of yarn is used up before the end: lengthen it, or shorten the run"

    @property
    def ok(self) -> bool:
        """Whether the numbers are a solution of the model."""
        return self is WindingOutcome.COMPLETED


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The laid yarn at one time, in the frame that turns with the bobbin; n nodes from the yarn's head on."""

    time: float
    """[s]."""
    layer: Integers
    """Layer of each node, from 1, shape (n,). A layer is one guide cycle."""
    position: Array
    """(x, y, z) of the yarn's centre line [m], shape (n, 3); e_z is the axis, z = 0 the middle of the stroke."""
    tension: Array
    """Mean tension of the elements before and after each node [N], shape (n,)."""


@dataclass(frozen=True, slots=True)
class EnergyLedger:
    """Energies [J] at sample times, each of shape (m,). Stored ones are values, the others sums since the start."""

    time: Array
    """[s]."""
    kinetic: Array
    strain: Array
    """Axial, with the springs of the Prony branches."""
    bending: Array
    contact: Array
    """Springs of the contacts: bobbin, its grip, guide, yarn on yarn."""
    bobbin_work: Array
    """Work of the bobbin on the yarn."""
    guide_work: Array
    """Work of the moving guide on the yarn."""
    feed_work: Array
    """Work of the feed on the yarn, with the energy of the yarn that it delivers."""
    viscous: Array
    """Dissipated by bulk viscosity and relaxation."""
    contact_damping: Array
    """Dissipated by the dashpots of the contacts and by grips let go."""
    friction: Array
    """Dissipated by friction: yarn on yarn and on the guide."""
    handed_on: Array
    """Lost, or gained where negative, by springs between yarns that pass from one element to the next or come to lie
    side by side: an error of the mesh, none of the physics."""

    @property
    def throughput(self) -> Array:
        """Sum of the magnitudes of all work done on the yarn [J], shape (m,)."""
        return np.abs(self.bobbin_work) + np.abs(self.guide_work) + np.abs(self.feed_work)

    @property
    def residual(self) -> float:
        """Largest imbalance over the largest throughput."""
        stored = self.kinetic + self.strain + self.bending + self.contact
        lost = self.viscous + self.contact_damping + self.friction + self.handed_on
        work = self.bobbin_work + self.guide_work + self.feed_work
        imbalance = stored - stored[0] + lost - work
        return float(np.max(np.abs(imbalance)) / np.max(self.throughput))


def _none() -> Array:
    return np.empty(0)


@dataclass(frozen=True, slots=True)
class WindingResult:
    """The result of winding `scene`. A failed run keeps scene, outcome and reason; its numbers end where it failed."""

    scene: WindingScene
    mode: Literal["fast", "reference"]
    mode_reason: str
    """Why this mode."""
    outcome: WindingOutcome
    message: str
    """Why it failed; of a completed run, what its numbers rest on and a reader may not expect."""
    time: Array = field(default_factory=_none)
    """Sample times [s], shape (m,), 1 ms apart; each sample is the mean since the one before, so nothing aliases."""
    span_tension: Array = field(default_factory=_none)
    """Tension between guide and bobbin [N], shape (m,), mean over the elements of the span."""
    guide_phase: Array = field(default_factory=_none)
    """Guide cycles since the start, shape (m,); whole numbers at the reversal on the side of −e_z."""
    guide_position: Array = field(default_factory=_none)
    """z of the guide [m], shape (m,)."""
    layers_T_over_T0: Array = field(default_factory=_none)
    """Mean tension of each complete layer at the end over T₀ when it was laid, innermost first, shape (k,)."""
    snapshots: tuple[Snapshot, ...] = ()
    """The package when layers 1, 3, 5, 7, 9 were complete, and at the end."""
    energy: EnergyLedger | None = None
    """Reference mode only."""
    penetration_max: float = math.nan
    """Largest approach of the contacts beyond touching [m], at the end: what the scene's transverse stiffness makes."""
    time_step: float = math.nan
    """[s]; NaN in the fast mode, which takes no time steps."""
    time_step_limit: float = math.nan
    """Limit of stability [s]; NaN in the fast mode."""
    element_steps: int = 0
    """Elements times time steps computed; in the fast mode visits to nodes."""
    wall_s: float = math.nan
    """Elapsed time of the computation [s], without compilation where it was compiled before."""


def giving_said(scene: WindingScene, penetration: float) -> str:
    """What a completed run says where its contacts approach by more than `GIVING`: the compliance is a declared one."""
    share = penetration / scene.diameter
    if not share > GIVING:
        return ""
    return (
        f"the yarn gives way by {100 * share:.1f} % of its diameter where it is pressed hardest: that is the declared "
        f"transverse stiffness, {scene.transverse_stiffness * 1e-6:g} N/mm²"
    )
