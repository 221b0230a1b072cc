"""What a parameter changes: span and layers of each variant beside its case."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from pipeline.winding.keys import written
from pipeline.winding.run import Row

SPAN_LIMIT = 0.02
"""Largest change of the mean span tension, in fractions of it, that is called robust."""
LAYER_LIMIT = 0.05
"""Largest change of any layer's T/T₀ that is called robust."""


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """One variant's changes against its case; NaN where either was not completed."""

    case: str
    name: str
    parameter: str
    value: str
    own: str
    """The value of the case itself."""
    span_percent: float
    """Change of the mean span tension in % of it."""
    sd_percent: float
    """Change of its standard deviation in % of it."""
    first_layer: float
    """Change of T/T₀ of the innermost layer."""
    last_layer: float
    """Change of T/T₀ of the outermost layer that both have."""
    largest_layer: float
    """Largest magnitude of a change of T/T₀ over the layers that both have."""
    unused: bool
    """Whether nothing at all has changed, to the last bit: the mode does not use the parameter."""

    @property
    def span_said(self) -> str:
        """Robust or not, in words."""
        return self._said(abs(self.span_percent) / 100, SPAN_LIMIT)

    @property
    def layers_said(self) -> str:
        """Robust or not, in words."""
        return self._said(self.largest_layer, LAYER_LIMIT)

    def _said(self, change: float, limit: float) -> str:
        if self.unused:
            return "no part of this mode"
        return "not known" if math.isnan(change) else "robust" if change <= limit else "not robust"

    def as_record(self) -> dict[str, object]:
        """Fields and judgements, for a table."""
        return {**asdict(self), "span": self.span_said, "layers": self.layers_said}


def sensitivities(rows: Sequence[Row]) -> list[Sensitivity]:
    """One for each variant, in their order."""
    base = {row.case.name: row for row in rows if not row.variant}
    return [_change(base[row.case.name], row) for row in rows if row.variant]


def _change(base: Row, row: Row) -> Sensitivity:
    assert row.case.variant is not None  # only variants come here
    group = row.case.variant.group
    both = min(base.layers.size, row.layers.size) if base.ok and row.ok else 0
    layers = row.layers[:both] - base.layers[:both]
    return Sensitivity(
        case=base.case.name,
        name=group.name,
        parameter=group.parameter,
        value=written(row.case.variant.value),
        own=written(base.case.keys.value(group.parameter)),
        span_percent=100 * (row.span.mean / base.span.mean - 1),
        sd_percent=100 * (row.span.sd / base.span.sd - 1) if base.span.sd > 0 else math.nan,
        first_layer=float(layers[0]) if both else math.nan,
        last_layer=float(layers[-1]) if both else math.nan,
        largest_layer=float(np.max(np.abs(layers))) if both else math.nan,
        unused=all(
            np.array_equal(getattr(row.result, name), getattr(base.result, name))
            for name in ("span_tension", "layers_T_over_T0", "guide_position")
        ),
    )
