"""What may be wrong with the samples of a tension log. Flags run parallel to the data and never edit it.

| flag | set where |
|---|---|
| MISSING | there is no reading (the reader sets SATURATED instead where the file says overload) |
| SATURATED | the reading is at or above full scale |
| NEGATIVE | the reading is below minus one step of the instrument |
| STUCK | the same value is repeated for too long to be noise (`stuck_runs`) |
| SPIKE | the reading stands out from its neighbours (`spikes`) |
| TIME_BACKWARD_OR_DUPLICATE | leaving out these, the fewest possible samples, makes the time stamps increase |
| AFTER_GAP | the stamp comes more than 1.5 sampling intervals late |
"""

import math
from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, percentile_filter

from pipeline.records import Array, Flags, TensionFlag

GAP_RATIO = 1.5
"""A gap is longer than this many sampling intervals: half-way between an even spacing and one lost sample."""
SPIKE_SCALE_WINDOW = 101
"""Samples over which the ordinary difference between a reading and its neighbours is taken."""
SPIKE_THRESHOLD = 6.0
"""A spike differs by more than this many robust standard deviations."""
SPIKE_MINIMUM = 21
"""Logs with fewer readings are not searched for spikes."""
STUCK_CHANCE = 1e-3
"""Accepted chance that noise alone makes one run in a whole log as long as the yardstick."""
STUCK_MARGIN = 3.0
"""A stuck run is longer than the yardstick by this factor, since smooth signals linger at their turning points."""
STUCK_YARDSTICK = 30
"""Number of shorter runs needed to know what is ordinary."""
STUCK_CONSTANT = 100
"""A log of one single value is called stuck from this many readings on."""

_QUARTILE = 1.1503  # |z| exceeded by a quarter of a normal distribution


def flag_tension(time: Array, tension: Array, *, resolution: float, full_scale: float) -> Flags:
    """Flag every sample of a log.

    Parameters
    ----------
    time : time stamps in file order [s], shape (n,), finite.
    tension : readings [N], shape (n,), NaN where there is none.
    resolution, full_scale : step and range of the instrument [N]; NaN where not stated. Without a step the smallest
        difference between two readings stands for it; without a range nothing is called saturated.

    Returns
    -------
    bits of `TensionFlag`, shape (n,).
    """
    saturated = np.zeros(time.size, bool) if math.isnan(full_scale) else tension >= full_scale * (1 - 1e-9)
    unsaturated = np.where(saturated, np.nan, tension)
    step = _observed_step(tension) if math.isnan(resolution) else resolution
    increasing = _increasing(time)
    flag = np.zeros(time.size, np.uint16)
    for bit, where in (
        (TensionFlag.MISSING, np.isnan(tension)),
        (TensionFlag.SATURATED, saturated),
        (TensionFlag.NEGATIVE, tension < -step * (1 + 1e-9)),
        (TensionFlag.STUCK, stuck_runs(unsaturated)),
        (TensionFlag.SPIKE, spikes(unsaturated, step)),
        (TensionFlag.TIME_BACKWARD_OR_DUPLICATE, ~increasing),
    ):
        flag[where] |= np.uint16(bit)
    kept = np.flatnonzero(increasing)
    if kept.size > 1:
        late = np.diff(time[kept]) > GAP_RATIO * sampling_interval(time, flag) * np.diff(kept)
        flag[kept[1:][late]] |= np.uint16(TensionFlag.AFTER_GAP)
    return flag


def sampling_interval(time: Array, flag: Flags) -> float:
    """Median time from one row to the next [s] over the stamps that increase; NaN where there are fewer than two.

    Rows left out in between count, so that a doubled or jumbled stamp does not look like a lost sample.
    """
    kept = np.flatnonzero(flag & TensionFlag.TIME_BACKWARD_OR_DUPLICATE == 0)
    return float(np.median(np.diff(time[kept]) / np.diff(kept))) if kept.size > 1 else math.nan


def stuck_runs(tension: Array) -> NDArray[np.bool_]:
    """Find values repeated for longer than the log's own noise, correlation and quantisation explain.

    A coarse step or a slow signal repeats values too, so the rest of the log is the yardstick. Run lengths of a
    quantised noisy signal have an exponential tail; its decay length τ is half the mean run length as a sample meets
    it, τ = ½ Σ L² / Σ L. A run of length L is stuck if L > 3 τ ln(n / 10⁻³), with τ from the runs shorter than L/2 (so
    that neither it nor other stuck runs set their own yardstick). These must be 30 or more, and half of the runs or
    more, so that neither a meter that refreshes more slowly than it is logged nor noise far below one step is called
    stuck. A fine step gives about 25 samples in a log of 1000. A log of one single value has no yardstick: it is called
    stuck from 100 readings on, because the tension of a running yarn varies by several per cent.

    Parameters
    ----------
    tension : shape (n,), any unit; NaN ends a run and is never stuck.
    """
    starts = np.flatnonzero(np.diff(tension, prepend=np.nan) != 0)
    lengths = np.diff(starts, append=tension.size)
    real = ~np.isnan(tension[starts])
    ordered = np.sort(lengths[real]).astype(float)
    if np.unique(tension[starts[real]]).size == 1:
        return ~np.isnan(tension) & (ordered.sum() >= STUCK_CONSTANT)
    samples, squares = (np.concatenate([[0.0], np.cumsum(power)]) for power in (ordered, ordered**2))
    shorter = np.searchsorted(ordered, lengths / 2)
    known = real & (shorter >= max(STUCK_YARDSTICK, ordered.size / 2))
    decay = squares[shorter] / np.maximum(samples[shorter], 1.0) / 2
    longest = STUCK_MARGIN * decay * math.log(max(samples[-1], 1.0) / STUCK_CHANCE)
    return np.repeat(known & (lengths > longest), lengths)


def spikes(tension: Array, step: float) -> NDArray[np.bool_]:
    """Find readings that stand out from their neighbours: a Hampel identifier.

    A reading is held against the median of its six neighbours, three on each side, so that spikes of up to three
    samples are seen. The ordinary size of that difference is its upper quartile over 101 samples as a standard
    deviation (the largest of these within 101 samples, so that a change from a quiet to a lively stretch is no spike),
    and at least half a step. A reading six times that beyond both middle neighbours (beyond one only is an edge) is a
    spike. The median without the reading itself, and the quartile rather than the median, keep this right for
    correlated and quantised readings too: fewer than one log in 100 of white or first-order autoregressive noise has a
    false one. Logs of fewer than 21 readings are too short to tell.

    Source: Davies & Gather, J. Am. Stat. Assoc. 88 (1993) 782; Pearson, Mining Imperfect Data, 2005.

    Parameters
    ----------
    tension : shape (n,), any unit, NaN where there is no reading (left out of the windows).
    step : quantisation step, same unit.
    """
    spike = np.zeros(tension.size, bool)
    present = np.flatnonzero(~np.isnan(tension))
    if present.size < SPIKE_MINIMUM:
        return spike
    values = tension[present]
    # Not scipy.ndimage.rank_filter: in one dimension it ignores the hole in a footprint (seen in 1.17).
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, 3, mode="reflect"), 7)
    lower, upper = np.sort(windows[:, [0, 1, 2, 4, 5, 6]], axis=1)[:, 2:4].T
    scale = percentile_filter(np.abs(values - (lower + upper) / 2), 75, SPIKE_SCALE_WINDOW) / _QUARTILE
    scale = np.maximum(maximum_filter1d(scale, SPIKE_SCALE_WINDOW), step / 2)
    spike[present] = np.maximum(values - upper, lower - values) > SPIKE_THRESHOLD * scale
    return spike


def _observed_step(tension: Array) -> float:
    """Smallest difference between two different readings, 0 where all are the same."""
    steps = np.diff(np.unique(tension[~np.isnan(tension)]))
    return float(steps.min()) if steps.size else 0.0


def _increasing(time: Array) -> NDArray[np.bool_]:
    """Mark a longest strictly increasing subsequence (Schensted 1961); of equal stamps the first is kept.

    One wild stamp, early or late, then costs one sample, where a running maximum would cost the rest of the log.
    """
    if np.all(np.diff(time) > 0):
        return np.ones(time.size, bool)
    stamps: list[float] = time.tolist()
    tails: list[float] = []
    tail_index: list[int] = []
    previous = [-1] * len(stamps)
    for index, stamp in enumerate(stamps):
        length = bisect_left(tails, stamp)
        previous[index] = tail_index[length - 1] if length else -1
        if length == len(tails):
            tails.append(stamp)
            tail_index.append(index)
        elif stamp < tails[length]:
            tails[length], tail_index[length] = stamp, index
    keep = np.zeros(len(stamps), bool)
    index = tail_index[-1]
    while index >= 0:
        keep[index] = True
        index = previous[index]
    return keep
