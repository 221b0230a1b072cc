"""Standard uncertainty of a fitted parameter under white and under correlated noise, against its scatter."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from pipeline.measure.coloured import coloured_u

ROWS, COLUMNS = 40, 200


def noise(count, length):
    """`count` pictures of noise of unit variance that is correlated along x over about `length`; white for 0."""
    white = np.random.default_rng(11).standard_normal((count, ROWS, COLUMNS + 200))
    smooth = gaussian_filter1d(white, length, axis=2)[..., 100:-100] if length else white[..., 100:-100]
    return smooth / smooth.std()


@pytest.mark.parametrize("length", [0.0, 3.0, 10.0])
def test_u_is_the_scatter_of_the_parameter(length):
    x = np.arange(COLUMNS) - (COLUMNS - 1) / 2
    influence = np.tile(x * np.cos(2 * math.pi * x / 60), (ROWS, 1)) / COLUMNS
    drawn = noise(150, length)
    scatter = float(np.sum(influence * drawn, axis=(1, 2)).std())
    stated = math.sqrt(np.mean([coloured_u(influence, one) ** 2 for one in drawn]))
    assert stated == pytest.approx(scatter, rel=0.15)
    independent = math.sqrt(float(np.sum(influence**2)))
    assert (stated > 2 * independent) == (length > 0)


def test_nothing_that_is_fitted_has_no_uncertainty():
    assert coloured_u(np.zeros((3, 5)), np.ones((3, 5))) == 0
