"""Wind: choose the mode, run it."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from models.winding.fast import wind_fast
from models.winding.result import Progress, WindingResult
from models.winding.scene import WindingScene

State = dict[str, NDArray[np.float64] | NDArray[np.int64]]
"""Everything that a reference run needs to go on, by name; as it comes from `numpy.load`."""


class Checkpoint(Protocol):
    """Where a reference run keeps its state; models know no files, so the caller says how."""

    def load(self) -> State | None:
        """The state to go on from, or None to start anew."""
        ...

    def save(self, state: State) -> None:
        """Keep `state`, replacing the one before."""
        ...


def wind(
    scene: WindingScene, *, progress: Progress | None = None, checkpoint: Checkpoint | None = None
) -> WindingResult:
    """Wind `scene`.

    Parameters
    ----------
    progress : told the share of the work done; the time left follows from it.
    checkpoint : asked for a state to go on from, and given one about every 20 s of a reference run.

    Returns
    -------
    WindingResult
        Never raises for what the physics or the time step does: see its outcome.
    """
    if scene.mode == "reference":
        raise NotImplementedError  # follows in the next commits
    return wind_fast(scene, "asked for", progress)
