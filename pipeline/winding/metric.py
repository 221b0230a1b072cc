"""The tension between guide and bobbin as the paper samples it, and its relative error (its Eqs 13 and 14).

The paper takes 30 samples 0.05 s apart, after "the extreme stress points caused by the yarn guide collision were
removed", beside a sensor that reads 100 times a second. It does not say what it calls extreme. Here a point is removed
where both hold: the guide turns round within `COLLISION`, and the tension is beyond `EXTREME` robust standard
deviations of the whole series from its median. A sample is then the mean over the sensor's interval, because a sensor
of 100 Hz cannot tell what happens inside it.

[1] Yarn winding with three-dimensional beam elements: section "Comparison between simulation results and experimental
    data on yarn tension".
[2] F. R. Hampel, The influence curve and its role in robust estimation, J. Am. Stat. Assoc. 69 (1974): the median
    absolute deviation as a measure of spread.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.measure.tension import EXCLUDED
from pipeline.measure.uncertainty import effective_count, mean_estimate
from pipeline.records import Array, Estimate, RawTension

SAMPLES = 30
SPACING = 0.05
"""Time between samples [s]."""
SENSOR = 0.01
"""Sampling interval of the sensor [s]."""
COLLISION = 0.01
"""Largest distance in time of an extreme from a turn of the guide [s]: one reading of the sensor."""
EXTREME = 3.0
"""Robust standard deviations beyond which a point is extreme."""
_MAD_PER_SIGMA = 1.4826
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Span:
    """Statistics of the tension between guide and bobbin once it has settled, SI."""

    estimate: Estimate
    """Mean [N], with u for its correlated points."""
    slope: float
    """Of the least-squares line [N/s]."""
    slope_u: float
    peak: float
    """The largest tension [N]."""
    length: float
    """Length in time of what all this is over [s]."""

    @property
    def mean(self) -> float:
        """[N]."""
        return self.estimate.mean

    @property
    def sd(self) -> float:
        """Standard deviation [N]."""
        return self.estimate.cv * self.estimate.mean


@dataclass(frozen=True, slots=True)
class Errors:
    """Relative errors of the samples (Eq. 14) against what `reference` says."""

    reference: str
    percent: Array
    """|S − M| / M in %, shape (samples,); NaN where either is missing."""

    @property
    def count(self) -> int:
        """How many samples have both values."""
        return int(np.count_nonzero(np.isfinite(self.percent)))

    @property
    def mean_percent(self) -> float:
        """Mean over the samples, as the paper's Table 6; NaN without any."""
        return float(np.nanmean(self.percent)) if self.count else math.nan

    @property
    def max_percent(self) -> float:
        """The largest; NaN without any."""
        return float(np.nanmax(self.percent)) if self.count else math.nan


def span_statistics(time: Array, tension: Array, settled: float) -> Span:
    """Statistics of all points from the time `settled` [s] on, extremes too; NaN where there are fewer than three.

    u of the slope is that of independent points, widened by √(n/n_eff) of the residuals.

    Parameters
    ----------
    time, tension : the series [s, N], shape (n,), evenly spaced in time.
    """
    used = time >= settled
    if np.count_nonzero(used) < 3:
        return Span(Estimate(math.nan, n=int(np.count_nonzero(used))), math.nan, math.nan, math.nan, 0.0)
    t, y = time[used] - time[used].mean(), tension[used]
    slope = float(t @ y / (t @ t))
    rest = y - y.mean() - slope * t
    u = math.sqrt(float(rest @ rest) / (t.size - 2) / float(t @ t) * t.size / effective_count(rest))
    return Span(mean_estimate(y), slope, u, float(y.max()), float(np.ptp(time[used])))


def sample_times(duration: float) -> Array:
    """0.05, 0.10, … s: 30 of them, or as many as fit in `duration` [s]."""
    return SPACING * np.arange(1.0, 1.0 + min(SAMPLES, math.floor(duration / SPACING + _ROUNDING)), dtype=np.float64)


def collision_extremes(time: Array, tension: Array, turns: Array) -> NDArray[np.bool_]:
    """Which points are extremes that the guide's collision caused.

    Parameters
    ----------
    time, tension : the series [s, N], shape (n,).
    turns : times at which the guide turns round [s], increasing.
    """
    if not turns.size:
        return np.zeros(time.size, dtype=bool)
    after = np.clip(np.searchsorted(turns, time), 1, turns.size - 1) if turns.size > 1 else np.zeros(time.size, int)
    distance = np.minimum(np.abs(time - turns[after]), np.abs(time - turns[np.maximum(after - 1, 0)]))
    centre = np.median(tension)
    spread = _MAD_PER_SIGMA * np.median(np.abs(tension - centre))
    return (distance <= COLLISION) & (np.abs(tension - centre) > EXTREME * spread)


def sampled(time: Array, tension: Array, kept: NDArray[np.bool_], at: Array) -> Array:
    """Mean of the kept points over the sensor's interval about each time of `at` [N]; NaN where none is left.

    A point stands for the time since the one before it, so that those in (t − 5 ms, t + 5 ms] are the interval.
    """
    found = np.full(at.size, math.nan)
    for index, moment in enumerate(at):
        near = kept & (time > moment - SENSOR / 2 + _ROUNDING) & (time <= moment + SENSOR / 2 + _ROUNDING)
        if near.any():
            found[index] = tension[near].mean()
    return found


def measured_at(log: RawTension, at: Array, start: float) -> Array:
    """The log's tension [N] at `start` + `at`, between its two neighbouring usable samples; NaN where one is missing.

    Usable are the samples that `yarnval tension` counts; a neighbour further than two sampling intervals is none.

    Parameters
    ----------
    start : time of the log [s] at which the winding starts.
    """
    usable = (log.flag & EXCLUDED == 0) & np.isfinite(log.tension)
    time, tension = log.time[usable], log.tension[usable]
    if time.size < 2:
        return np.full(at.size, math.nan)
    found = np.interp(at + start, time, tension, left=math.nan, right=math.nan)
    after = np.clip(np.searchsorted(time, at + start), 1, time.size - 1)
    found[time[after] - time[after - 1] > 2 * float(np.median(np.diff(log.time))) * (1 + 1e-9)] = math.nan
    return found


def errors(samples: Array, reference: Array, said: str) -> Errors:
    """Eq. 14 for each sample; NaN where the reference is not above 0. `said` names the reference."""
    return Errors(said, 100 * np.abs(samples - reference) / np.where(reference > 0, reference, math.nan))
