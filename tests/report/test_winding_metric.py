"""The paper's metric on series whose samples, extremes and slope are known."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.records import RawTension, Source, TensionFlag
from pipeline.winding import metric

TIME = np.arange(1, 1501) / 1000
RAMP = TIME - 0.0005  # the mean of t over each millisecond, as the models give it


def log(time, tension, flag=None):
    flags = np.zeros(time.size, np.uint16) if flag is None else flag
    return RawTension(Source("log.csv", "0" * 64, 1), "plain-csv", "cN", time, tension, flags, math.nan, math.nan)


def test_thirty_samples_of_the_sensors_interval():
    times = metric.sample_times(1.5)
    assert times == pytest.approx(0.05 * np.arange(1, 31))
    assert metric.sample_times(0.12) == pytest.approx([0.05, 0.1])
    assert metric.sample_times(4.0).size == 30
    samples = metric.sampled(TIME, RAMP, np.ones(TIME.size, bool), times)
    assert samples[:-1] == pytest.approx(times[:-1])  # the mean of a ramp over an interval is its middle
    assert samples[-1] == pytest.approx(1.4975)  # the last interval is cut by the end


def test_extremes_are_left_out_only_where_the_guide_turns():
    tension = 0.5 + 0.01 * np.sin(400 * TIME)
    tension[[200, 204, 300]] = 5.0
    turns = np.array([0.2, 0.6])
    extremes = metric.collision_extremes(TIME, tension, turns)
    assert list(np.flatnonzero(extremes)) == [200, 204]  # 0.301 s is far from any turn
    samples = metric.sampled(TIME, tension, ~extremes, np.array([0.2]))
    assert samples[0] == pytest.approx(0.5, abs=0.011)
    assert not metric.collision_extremes(TIME, tension, np.empty(0)).any()
    assert list(np.flatnonzero(metric.collision_extremes(TIME, tension, turns[:1]))) == [200, 204]


def test_a_sample_without_any_point_left_is_missing():
    kept = np.ones(TIME.size, bool)
    kept[40:60] = False
    samples = metric.sampled(TIME, RAMP, kept, np.array([0.05, 0.1]))
    assert math.isnan(samples[0])
    errors = metric.errors(samples, np.array([1.0, 0.2]), "made up")
    assert (errors.count, errors.mean_percent, errors.max_percent) == (1, pytest.approx(50), pytest.approx(50))
    assert metric.errors(samples, np.array([1.0, 0.0]), "a machine at rest").count == 0
    nothing = metric.errors(np.array([math.nan]), np.array([1.0]), "made up")
    assert nothing.count == 0
    assert math.isnan(nothing.mean_percent)
    assert math.isnan(nothing.max_percent)


@given(st.lists(st.floats(0.1, 10), min_size=1, max_size=30), st.floats(0.1, 10), st.floats(-0.9, 2))
def test_the_error_does_not_depend_on_the_unit(measured, unit, off):
    """Eq. 14: S = M (1 + off) has the error |off| in any unit."""
    reference = unit * np.array(measured)
    errors = metric.errors(reference * (1 + off), reference, "made up")
    assert errors.mean_percent == pytest.approx(100 * abs(off), abs=1e-9)
    assert errors.max_percent == pytest.approx(100 * abs(off), abs=1e-9)


def test_a_log_is_read_where_it_has_samples_on_both_sides():
    time = np.arange(0, 2, 0.01)
    tension = 0.3 + 0.1 * time
    flag = np.zeros(time.size, np.uint16)
    flag[100:104] = TensionFlag.MISSING
    tension[100:104] = math.nan
    found = metric.measured_at(log(time, tension, flag), np.array([0.25, 0.52, 0.9]), start=0.5)
    assert found[0] == pytest.approx(0.375)
    assert math.isnan(found[1])  # 1.02 s is in the gap
    assert found[2] == pytest.approx(0.44)
    assert np.isnan(metric.measured_at(log(time, tension, flag), np.array([1.6]), start=0.5)).all()
    all_bad = np.full(time.size, int(TensionFlag.SATURATED), np.uint16)
    assert np.isnan(metric.measured_at(log(time, tension, all_bad), np.array([0.3]), start=0.0)).all()


def test_the_span_has_the_slope_and_mean_of_a_line():
    generator = np.random.default_rng(5)
    noise = generator.normal(0, 0.01, TIME.size)
    tension = np.where(TIME < 0.2, 0.0, 0.4 + 0.2 * TIME + noise)
    span = metric.span_statistics(TIME, tension, 0.2)
    assert span.slope == pytest.approx(0.2, abs=3 * span.slope_u)
    assert span.slope_u == pytest.approx(0.01 * math.sqrt(12 / 1301) / 1.3, rel=0.2)  # white noise: the closed form
    assert span.mean == pytest.approx(0.4 + 0.2 * 0.85, abs=3 * 0.01 / math.sqrt(1301))
    assert span.length == pytest.approx(1.3)
    assert math.isnan(metric.span_statistics(TIME, tension, 1.4985).mean)
