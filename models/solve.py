"""The models by name."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from models import capstan, cosserat, cosserat_fd, flexible, kirchhoff, kirchhoff_spans
from models.outcome import Solution
from models.scene import Scene

MODELS: Mapping[str, Callable[[Scene], Solution]] = MappingProxyType(
    {
        capstan.NAME: capstan.solve_capstan,
        flexible.NAME: flexible.solve_flexible,
        cosserat.NAME: cosserat.solve_cosserat,
        cosserat_fd.NAME: cosserat_fd.solve_cosserat_fd,
        kirchhoff.NAME: kirchhoff.solve_kirchhoff,
        kirchhoff_spans.NAME: kirchhoff_spans.solve_kirchhoff_spans,
    }
)
"""Solvers by the name that users give; each takes a scene and never raises for a hard one."""
