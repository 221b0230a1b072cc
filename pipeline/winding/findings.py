"""What the runs say of the paper's three findings: reproduced, reproduced only if, or not; each computed from the rows.

The paper's measured curves are not published, so that its findings are held against trends, not against its errors.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import groupby, pairwise

import numpy as np

from pipeline.winding.run import Row

RISE = 0.02
"""Least change of the tension, in fractions of the end tension, that counts as a rise or as higher."""
LAYERS = 4
"""Fewest complete layers that have an inner and an outer half worth the name."""
WEAK = 0.8
"""Largest T/T₀ of an inner half that counts as weak."""
DIFFERENCE = 0.2
"""Least difference of T/T₀ between outer and inner half that counts as strong beside weak."""


class Verdict(StrEnum):
    """What became of a finding."""

    REPRODUCED = "reproduced"
    ONLY_IF = "reproduced only if"
    NOT_REPRODUCED = "not reproduced"
    NOT_ASKED = "not asked"


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding of the paper, what became of it, and why."""

    claim: str
    verdict: Verdict
    why: str


def findings(rows: Sequence[Row]) -> tuple[Finding, ...]:
    """The three, in the paper's order, from the cases and their variants that were solved."""
    solved = [row for row in rows if row.ok]
    return rise(solved), fineness(solved), layers(solved)


def rise(rows: Sequence[Row]) -> Finding:
    """Whether the span tension rises with time, as the paper's experiment does and its simulation is said to follow.

    The rise is the least-squares slope over the settled span times its length. It counts where it is above `RISE` of
    the end tension and above twice its standard uncertainty.
    """
    claim = "The tension rises during the winding (Fig. 7)"

    def rises(row: Row) -> bool:
        span = row.span
        change = span.slope * span.length
        return change > RISE * row.end_tension and span.slope > 2 * span.slope_u

    def said(several: Sequence[Row]) -> str:
        return f"{_range([100 * row.span.slope * row.span.length for row in several], '+.2f')} cN over the run"

    return _verdict(claim, rows, rises, said)


def layers(rows: Sequence[Row]) -> Finding:
    """Whether the inner loops are weak and the outer ones strong: mean T/T₀ of the inner and of the outer half."""
    claim = "Inner loops are weak, outer ones strong (Fig. 9)"
    known = [row for row in rows if np.isfinite(row.layers).sum() >= LAYERS]

    def said(several: Sequence[Row]) -> str:
        inner, outer = zip(*map(halves, several), strict=True)
        return f"inner half at {_range(inner, '.2f')} T₀, outer half at {_range(outer, '.2f')} T₀"

    return _verdict(claim, known, weak_inside, said)


def weak_inside(row: Row) -> bool:
    """Whether a run's inner layers are weak and its outer ones strong."""
    inner, outer = halves(row)
    return bool(np.isfinite(row.layers).sum() >= LAYERS and inner <= WEAK and outer - inner >= DIFFERENCE)


def halves(row: Row) -> tuple[float, float]:
    """Mean T/T₀ of the inner and of the outer half of the layers; the middle one of an odd number is in neither."""
    known = row.layers[np.isfinite(row.layers)]
    half = known.size // 2
    if not half:
        return math.nan, math.nan
    return float(known[:half].mean()), float(known[-half:].mean())


def fineness(rows: Sequence[Row]) -> Finding:
    """Whether coarser yarn has the higher tension at equal speed.

    Neighbours in fineness are compared at each speed. Where the end tension differs it decides, because it is an input;
    the finding is about yarn only where it is equal.
    """
    claim = "Coarser yarn has higher tension at equal speed (Fig. 8)"
    base = [row for row in rows if not row.variant]
    by_speed = groupby(sorted(base, key=lambda row: (row.speed, row.tex)), key=lambda row: row.speed)
    pairs = [pair for _, group in by_speed for pair in pairwise(group) if pair[0].tex < pair[1].tex]
    if not pairs:
        return Finding(claim, Verdict.NOT_ASKED, "no two cases differ in fineness at one speed")
    equal = [pair for pair in pairs if math.isclose(pair[0].end_tension, pair[1].end_tension)]
    given = [pair for pair in pairs if pair not in equal]
    if not equal:
        return Finding(claim, Verdict.NOT_ASKED, "the end tension, an input, differs wherever the fineness does")

    def change(fine: Row, coarse: Row) -> float:
        return (coarse.span.mean - fine.span.mean) / fine.end_tension

    shift = [change(*pair) for pair in equal]
    spread = [coarse.span.sd / fine.span.sd for fine, coarse in equal]
    why = f"At equal end tension the mean changes by {_range([100 * s for s in shift], '+.2f')} % of it"
    if min(shift) >= RISE:
        return Finding(claim, Verdict.REPRODUCED, f"{why}.")
    conditions = []
    if given and min(change(*pair) for pair in given) >= RISE:
        conditions.append("the end tension, an input, is higher too")
    if min(spread) > 1:
        conditions.append(
            f"one reads the fluctuation: its standard deviation is {_range(spread, '.2f')} times that of the finer yarn"
        )
    if conditions:
        return Finding(claim, Verdict.ONLY_IF, f"{' or '.join(conditions)}. {why}: the mean is the end tension.")
    return Finding(claim, Verdict.NOT_REPRODUCED, f"{why}.")


def _verdict(
    claim: str, rows: Sequence[Row], holds: Callable[[Row], bool], said: Callable[[Sequence[Row]], str]
) -> Finding:
    """Reproduced if all cases hold, only if some case or variant does, and which; `said` tells the numbers of rows."""
    base = [row for row in rows if not row.variant]
    if not base:
        return Finding(claim, Verdict.NOT_ASKED, "no case with the numbers that this needs was completed")
    held = [row for row in rows if holds(row)]
    rest = [row for row in base if not holds(row)]
    if not rest:
        return Finding(claim, Verdict.REPRODUCED, f"in {_all(len(base))}: {said(base)}.")
    if not held:
        return Finding(claim, Verdict.NOT_REPRODUCED, f"in {_all(len(base), none=True)}: {said(base)}.")
    where = "; ".join(f"{row.name}, {row.result.mode} mode ({said([row])})" for row in held)
    without = f"{len(rest)} of {len(base)} cases" if len(base) > 1 else "the case itself"
    return Finding(claim, Verdict.ONLY_IF, f"{where}. Not in {without}: {said(rest)}.")


def _all(count: int, *, none: bool = False) -> str:
    if count == 1:
        return "the one case"
    return f"any of {count} cases" if none else f"all {count} cases"


def _range(values: Sequence[float], form: str) -> str:
    low, high = f"{min(values):{form}}", f"{max(values):{form}}"
    return (low if low == high else f"{low} to {high}").replace("-", "−")
