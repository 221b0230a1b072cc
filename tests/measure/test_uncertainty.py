"""Uncertainty of means against theory: white noise, AR(1), coverage, and combination of several means."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from pipeline.measure.uncertainty import combine, effective_count, mean_estimate
from pipeline.records import Estimate


def autoregressive(a, n, count, seed):
    """`count` stationary AR(1) series of unit variance, shape (count, n)."""
    noise = np.random.default_rng(seed).standard_normal((count, n + 500)) * math.sqrt(1 - a * a)
    return lfilter([1], [1, -a], noise, axis=1)[:, 500:]


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_effective_count_of_ar1_is_the_theory(a):
    # Var(mean) of AR(1) tends to σ²/n · (1 + a)/(1 − a); the mean over 40 series of 4000 is known to a few per cent.
    n = 4000
    found = np.mean([n / effective_count(x) for x in autoregressive(a, n, 40, seed=7)])
    assert found == pytest.approx((1 + a) / (1 - a), rel=0.08)


def test_effective_count_is_bounded():
    alternating = np.tile([1.0, -1.0], 50)
    assert effective_count(alternating) == 100
    assert 1 <= effective_count(np.arange(100.0)) < 5
    assert effective_count(np.array([1.0, 2.0])) == 2


def test_effective_count_of_a_constant_does_not_depend_on_rounding():
    # The mean of n times 0.1 is not 0.1 in floating point.
    assert effective_count(np.full(1000, 0.1)) == 1000


@pytest.mark.parametrize("a", [0.0, 0.9])
def test_u_covers_the_true_mean(a):
    """The interval ±1.96 u should hold the true mean in about 95 % of trials; 500 trials know that to 1 %."""
    estimates = [mean_estimate(x) for x in autoregressive(a, 1000, 500, seed=11)]
    covered = np.mean([abs(e.mean) <= 1.96 * e.u for e in estimates])
    assert 0.91 <= covered <= 0.98


def test_mean_estimate_terms():
    samples = np.array([1.0, 2.0, np.nan, 4.0, 3.0])
    e = mean_estimate(samples, extra_u={"a": 0.3, "b": math.nan, "c": 0.4}, reason="why")
    plain = mean_estimate(samples)
    assert (e.mean, e.n, e.reason) == (2.5, 4, "why")
    assert e.cv == pytest.approx(math.sqrt(5 / 3) / 2.5)
    assert e.u**2 == pytest.approx(plain.u**2 + 0.25)
    assert plain.u**2 == pytest.approx(5 / 3 / plain.n_eff)


def test_mean_estimate_without_samples_says_why():
    none, one = mean_estimate(np.array([np.nan])), mean_estimate(np.array([2.0]))
    assert math.isnan(none.mean)
    assert none.n == 0
    assert one.mean == 2.0
    assert math.isnan(one.u)
    assert "at least 2" in none.reason
    assert "at least 2" in one.reason


def test_combine_is_inverse_variance_for_means_that_agree():
    c = combine([Estimate(10.0, 0.1, 0.05, 100, 50.0), Estimate(10.1, 0.2, 0.07, 200, 80.0)])
    assert c.mean == pytest.approx((10.0 / 0.01 + 10.1 / 0.04) / (1 / 0.01 + 1 / 0.04))
    assert c.u == pytest.approx(1 / math.sqrt(1 / 0.01 + 1 / 0.04))
    assert c.cv == pytest.approx(math.sqrt((0.05**2 + 0.07**2) / 2))
    assert (c.n, c.n_eff) == (300, 130.0)


def test_combine_widens_by_the_birge_ratio_for_means_that_disagree():
    # Two means 10 u apart: χ² = 2 · 5², one degree of freedom, so u = u/√2 · √50 = 5 u: half their distance.
    c = combine([Estimate(10.0, 0.1), Estimate(11.0, 0.1)])
    assert c.mean == pytest.approx(10.5)
    assert c.u == pytest.approx(0.5)


def test_combine_leaves_out_what_was_not_measured():
    lost = Estimate(math.nan, reason="no light")
    good = Estimate(10.0, 0.1)
    assert combine([lost, good]) is good
    assert combine([lost]) is lost
    assert math.isnan(combine([]).mean)
    assert combine([]).reason


def test_combine_without_every_u_is_a_plain_mean_that_says_so():
    c = combine([Estimate(10.0, 0.1, reason="a"), Estimate(12.0, reason="b")])
    assert c.mean == 11.0
    assert math.isnan(c.u)
    assert c.reason.startswith("a; b; plain mean")
