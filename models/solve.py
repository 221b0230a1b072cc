"""The models by name."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from models import auto, capstan, cosserat, cosserat_fd, flexible, kirchhoff, kirchhoff_spans
from models.outcome import Solution
from models.scene import Scene


class Solver(Protocol):
    """Solves one scene and never raises for a hard one; without `profile` only the numbers, at a lower cost."""

    def __call__(self, scene: Scene, *, profile: bool = True) -> Solution:
        """Solve `scene`."""
        ...


MODELS: Mapping[str, Solver] = MappingProxyType(
    {
        capstan.NAME: capstan.solve_capstan,
        flexible.NAME: flexible.solve_flexible,
        cosserat.NAME: cosserat.solve_cosserat,
        cosserat_fd.NAME: cosserat_fd.solve_cosserat_fd,
        kirchhoff.NAME: kirchhoff.solve_kirchhoff,
        kirchhoff_spans.NAME: kirchhoff_spans.solve_kirchhoff_spans,
        auto.NAME: auto.solve_auto,
    }
)
"""Solvers by the name that users give."""

ROWS: Mapping[str, Callable[[NDArray[np.float64], Any], None]] = MappingProxyType(
    {
        capstan.NAME: capstan.solve_rows,
        flexible.NAME: flexible.solve_rows,
        cosserat.NAME: cosserat.solve_rows,
        kirchhoff.NAME: kirchhoff.solve_rows,
    }
)
"""Compiled solvers of many scenes, for the models that have one; they hold no lock of the interpreter."""
