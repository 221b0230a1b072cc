"""Tension statistics against traces of known truth, and the JSON document."""

import json
import math

import numpy as np
import pytest
from scipy.signal import lfilter

from pipeline.errors import InputError
from pipeline.ingest.tension_flags import flag_tension
from pipeline.measure.tension import measure_tension, tension_json
from pipeline.records import RawTension, Source, TensionFlag

STEP = 1e-3


def log(tension, *, time=None, resolution=STEP, calibration_u=math.nan, full_scale=1.0):
    tension = np.asarray(tension, float)
    time = np.arange(tension.size) / 100 if time is None else time
    flag = flag_tension(time, tension, resolution=resolution, full_scale=full_scale)
    source = Source("synthetic.csv", "0" * 64, 0)
    return RawTension(source, "test", "cN", time, tension, flag, resolution, calibration_u)


def ar1(n, a, seed, *, mean=0.12, sd=0.007, step=STEP):
    noise = np.random.default_rng(seed).standard_normal(n + 300) * math.sqrt(1 - a * a)
    return np.round((mean + sd * lfilter([1], [1, -a], noise)[300:]) / step) * step


@pytest.mark.parametrize("a", [0.0, 0.8])
def test_u_covers_the_true_mean_of_correlated_readings(a):
    """±1.96 u holds the true mean in about 95 % of 300 seeded trials, which know that to 1.3 %."""
    # A fine step: where noise covers many steps the resolution term only adds to u, and coverage is higher.
    found = [measure_tension(log(ar1(600, a, seed, step=1e-5), resolution=1e-5)).estimate for seed in range(300)]
    covered = np.mean([abs(e.mean - 0.12) <= 1.96 * e.u for e in found])
    assert 0.90 <= covered <= 0.985
    assert np.mean([e.n_eff for e in found]) == pytest.approx(600 * (1 - a) / (1 + a), rel=0.15)
    assert np.mean([e.cv for e in found]) == pytest.approx(0.007 / 0.12, rel=0.03)


def test_u_holds_noise_resolution_and_calibration():
    tension = ar1(500, 0.0, 1)
    bare = measure_tension(log(tension, resolution=math.nan)).estimate
    full = measure_tension(log(tension, resolution=0.02, calibration_u=0.03)).estimate
    assert full.u**2 == pytest.approx(bare.u**2 + 0.02**2 / 12 + (0.03 * tension.mean()) ** 2)
    assert bare.reason == "calibration uncertainty not stated and not in u; resolution not stated and not in u"
    assert full.reason == ""


def test_a_drift_is_found():
    time = np.arange(1000) / 100
    m = measure_tension(log(np.round(0.10 + 0.002 * time, 6), resolution=1e-6))
    assert m.drift == pytest.approx(0.002, rel=1e-3)
    assert m.rate == pytest.approx(100.0)


def test_each_exclusion():
    tension = ar1(1000, 0.5, 2)
    clean = measure_tension(log(tension)).estimate
    bad = tension.copy()
    time = np.arange(1000) / 100
    bad[100] = np.nan
    bad[200] = 0.9
    bad[300:360] = 0.3
    time[500] = time[499]
    m = measure_tension(log(bad, time=time))
    assert m.flag_counts == {
        "missing": 1,
        "saturated": 0,
        "negative": 0,
        "stuck": 60,
        "spike": 1,
        "time_backward_or_duplicate": 1,
        "after_gap": 0,
    }
    assert m.estimate.n == 1000 - 63
    assert abs(m.estimate.mean - clean.mean) < clean.u


def test_saturation_is_said_to_bias_the_mean():
    tension = ar1(1000, 0.0, 3)
    raw = log(tension, full_scale=0.12)
    m = measure_tension(raw)
    count = int(np.count_nonzero(tension >= 0.12 * (1 - 1e-9)))
    assert m.flag_counts["saturated"] == count
    assert m.estimate.mean < tension.mean()
    assert f"{count} of 1000 samples saturated and left out: the mean is biased low" in m.estimate.reason


def test_negative_readings_stay_in():
    tension = ar1(1000, 0.0, 4, mean=0.0, sd=0.005)
    m = measure_tension(log(tension))
    assert m.flag_counts["negative"] > 100
    assert m.estimate.mean == pytest.approx(tension.mean())


def test_window_and_gaps():
    keep = np.r_[0:200, 250:1000]
    raw = log(ar1(1000, 0.0, 5)[keep], time=np.arange(1000)[keep] / 100)
    whole = measure_tension(raw)
    assert whole.window == (0.0, 9.99)
    assert whole.gaps == ((1.99, 2.5),)
    part = measure_tension(raw, (5.0, None))
    assert part.window == (5.0, 9.99)
    assert part.estimate.n == 500
    assert part.gaps == ()
    assert measure_tension(raw, (None, 1.0)).estimate.n == 101


@pytest.mark.parametrize("window", [(20.0, 30.0), (3.0, 2.0), (None, -1.0)])
def test_an_empty_window_is_refused_with_the_span(window):
    with pytest.raises(InputError, match=r"synthetic\.csv: no sample in the window .* the log spans 0 to 9\.99 s"):
        measure_tension(log(ar1(1000, 0.0, 6)), window)


def test_json_keys_and_values():
    document = tension_json(measure_tension(log(ar1(800, 0.0, 7), calibration_u=0.01)))
    fixed = [
        "n",
        "rate_Hz",
        "mean_cN",
        "cv_percent",
        "u_cN",
        "n_eff",
        "drift_cN_per_s",
        "flags",
        "gaps",
        "unit_in_file",
    ]
    assert list(document)[: len(fixed)] == fixed
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["n"] == 800
    assert document["mean_cN"] == pytest.approx(12.0, abs=0.1)
    assert document["cv_percent"] == pytest.approx(5.83, abs=0.5)
    assert document["flags"] == {str(bit.name).lower(): 0 for bit in TensionFlag}
    assert (document["unit_in_file"], document["layout"], document["reason"]) == ("cN", "test", "")


def test_json_has_null_where_nothing_can_be_known():
    document = tension_json(measure_tension(log(np.full(300, 0.12))))
    json.dumps(document, allow_nan=False)
    assert [document[key] for key in ("n", "mean_cN", "u_cN", "cv_percent", "drift_cN_per_s")] == [
        0,
        None,
        None,
        None,
        None,
    ]
    assert "0 usable samples of 300" in str(document["reason"])
