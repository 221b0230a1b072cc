"""Flags on traces built to show one fault each, and the absence of flags where only noise, correlation or steps are."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from pipeline.ingest.tension_flags import flag_tension, sampling_interval, spikes, stuck_runs
from pipeline.records import TensionFlag

RATE = 100.0
STEP = 1e-3  # 0.1 cN
FULL_SCALE = 1.0  # 100 cN


def trace(n=1000, *, seed=1, mean=0.12, sd=0.007, ar=0.6):
    """A quantised AR(1) tension of known statistics, in N, evenly spaced at 100 Hz."""
    noise = np.random.default_rng(seed).standard_normal(n + 200) * sd * math.sqrt(1 - ar**2)
    values = mean + lfilter([1], [1, -ar], noise)[200:]
    return np.arange(n) / RATE, np.round(values / STEP) * STEP


def flags(time, tension, resolution=STEP, full_scale=FULL_SCALE):
    return flag_tension(time, tension, resolution=resolution, full_scale=full_scale)


def where(flag, bit):
    return np.flatnonzero(flag & bit).tolist()


def test_a_sound_trace_has_no_flags():
    for seed in range(20):
        assert not flags(*trace(seed=seed)).any()


def test_missing_readings():
    time, tension = trace()
    tension[[0, 17, 999]] = np.nan
    flag = flags(time, tension)
    assert where(flag, TensionFlag.MISSING) == [0, 17, 999]
    assert np.count_nonzero(flag) == 3


def test_saturated_at_full_scale_only_and_not_also_stuck():
    time, tension = trace()
    tension[200:260] = 1.0
    tension[300] = 0.999
    flag = flags(time, tension)
    assert where(flag, TensionFlag.SATURATED) == list(range(200, 260))
    assert not where(flag, TensionFlag.STUCK)
    assert not where(flags(time, tension, full_scale=math.nan), TensionFlag.SATURATED)


def test_negative_beyond_one_step():
    time, tension = trace(mean=0.0, sd=0.0004)
    tension[:] = np.abs(tension)
    tension[[5, 6]] = -0.001, -0.002
    assert where(flags(time, tension), TensionFlag.NEGATIVE) == [6]


@pytest.mark.parametrize("length", [60, 400])
def test_stuck_value(length):
    time, tension = trace()
    tension[300 : 300 + length] = tension[300]
    stuck = where(flags(time, tension), TensionFlag.STUCK)
    assert set(range(300, 300 + length)) <= set(stuck)
    assert len(stuck) <= length + 2  # a neighbour may hold the same value by chance


def test_two_stuck_stretches_do_not_hide_each_other():
    time, tension = trace()
    tension[300:380] = tension[300]
    tension[600:670] = tension[600]
    stuck = set(where(flags(time, tension), TensionFlag.STUCK))
    assert set(range(300, 380)) | set(range(600, 670)) <= stuck


def test_quantisation_correlation_and_slow_refresh_are_not_stuck():
    rng = np.random.default_rng(3)
    for step in (0.02, 0.1, 0.5, 1.0):
        for ar in (0.0, 0.9, 0.99):
            values = lfilter([1], [1, -ar], rng.standard_normal(3000) * math.sqrt(1 - ar**2))
            assert not stuck_runs(np.round(values / step) * step).any(), (step, ar)
        for width in (2, 20):
            smooth = gaussian_filter1d(rng.standard_normal(5000), width)
            assert not stuck_runs(np.round(smooth / smooth.std() / step) * step).any(), (step, width)
    assert not stuck_runs(np.repeat(rng.standard_normal(60), 50)[13:]).any()
    assert not stuck_runs(np.floor(np.arange(2000) / 150)).any()


def test_a_constant_log_is_stuck_when_long():
    assert stuck_runs(np.full(100, 12.3)).all()
    assert not stuck_runs(np.full(99, 12.3)).any()
    broken = np.full(120, 12.3)
    broken[50] = np.nan
    assert np.array_equal(stuck_runs(broken), ~np.isnan(broken))
    assert not stuck_runs(np.full(5, np.nan)).any()


@pytest.mark.parametrize("width", [1, 2, 3])
def test_spikes_of_up_to_three_samples(width):
    time, tension = trace()
    tension[400 : 400 + width] += 0.1
    tension[700 : 700 + width] -= 0.1
    assert where(flags(time, tension), TensionFlag.SPIKE) == [*range(400, 400 + width), *range(700, 700 + width)]


def test_false_spikes_are_rare_in_noise():
    rng = np.random.default_rng(5)
    for ar in (0.0, 0.5, 0.9, 0.99):
        logs = lfilter([1], [1, -ar], rng.standard_normal((60, 500)), axis=1)[:, 200:]
        assert sum(spikes(log, 0.0).any() for log in logs) <= 1, ar


def test_a_start_from_rest_is_no_spike():
    time, tension = trace()
    tension[:600] = 0.0
    assert not where(flags(time, tension), TensionFlag.SPIKE)


def test_duplicate_and_backward_stamps_cost_one_sample_each():
    time, tension = trace()
    time[100] = time[99]
    time[200] = time[190]
    time[300] += 1e6  # one wild stamp, not the 699 after it
    flag = flags(time, tension)
    assert where(flag, TensionFlag.TIME_BACKWARD_OR_DUPLICATE) == [100, 200, 300]
    assert not where(flag, TensionFlag.AFTER_GAP)
    assert sampling_interval(time, flag) == pytest.approx(0.01)


def test_gap_after_lost_samples_but_not_after_jitter():
    time, tension = trace()
    time = time + np.random.default_rng(0).uniform(-0.002, 0.002, time.size)
    kept = np.r_[0:500, 501:800, 850:1000]
    assert where(flags(time[kept], tension[kept]), TensionFlag.AFTER_GAP) == [500, 799]


def test_one_and_two_samples():
    one = flags(np.array([0.0]), np.array([0.1]))
    assert not one.any()
    assert math.isnan(sampling_interval(np.array([0.0]), one))
    assert not flags(np.array([0.0, 0.01]), np.array([0.1, 0.1])).any()
