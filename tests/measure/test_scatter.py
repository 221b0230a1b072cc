"""The stated scatter of a few fibres against that of the twist over yarns with other fibres. Textures are synthetic."""

import math

import numpy as np
import pytest

from pipeline.measure import twist
from pipeline.measure.scatter import Face, slope_scatter, turn_scatter

RADIUS, STEP, TWIST = 20.0, 2.0, 1 / 220
ROWS, COLUMNS = 37, 200


def texture(seed, lean, missed=math.nan):
    """Unrolled fibres that lean off the helix by `lean` (deviation of the logarithm of T); shape (rows, columns).

    They return a turn on, unless `missed` is NaN, off their place by that deviation [rad].
    """
    rng = np.random.default_rng(seed)
    gamma = (np.arange(ROWS) - ROWS // 2)[:, None] / RADIUS
    x = (np.arange(COLUMNS) - COLUMNS / 2) * STEP
    u = gamma - 2 * math.pi * TWIST * x
    image = np.zeros(u.shape)
    for start in np.arange(-9, 9, 0.25):
        here = start + rng.uniform(-0.1, 0.1)
        off = 2 * math.pi * TWIST * lean * rng.standard_normal() * (x + here / (2 * math.pi * TWIST))
        away = u - here - off
        shade, again = rng.standard_normal(2)
        image += shade * np.exp(-0.5 * (away / 0.08) ** 2)
        if math.isfinite(missed):
            image += shade * np.exp(-0.5 * ((away + 2 * math.pi - missed * again) / 0.08) ** 2)
    image -= image.mean(axis=1, keepdims=True)
    return (image / image.std(axis=1, keepdims=True)).astype(np.float32)


def slope(image):
    lags = twist._lags(40)
    spectra = twist._spectra(image, lags)
    found, *_ = twist._ridge(image, spectra, *twist._harmonics(spectra.shape[1], 40), lags, STEP)
    return found / (2 * math.pi * RADIUS * TWIST) - 1


@pytest.mark.parametrize("lean", [0.03, 0.1])
def test_the_scatter_is_that_of_yarns_with_other_fibres(lean):
    images = [texture(seed, lean) for seed in range(40)]
    off = [slope(image) for image in images]
    stated = [slope_scatter([Face(image, STEP, RADIUS, TWIST)]) for image in images]
    # other fibres that are alike by chance count as scatter, too
    assert 0.8 * np.std(off) < np.median(stated) < 2 * np.std(off)
    assert np.mean(np.abs(off) < 2 * np.array(stated)) > 0.85


def test_straight_fibres_do_not_scatter_and_few_rows_say_nothing():
    assert slope_scatter([Face(texture(0, 0.0), STEP, RADIUS, TWIST)]) < 0.005
    assert math.isnan(slope_scatter([Face(texture(0, 0.0)[:2, :6], STEP, RADIUS, TWIST)]))
    assert math.isnan(slope_scatter([]))


def test_a_full_turn_scatters_by_how_far_fibres_miss_it():
    exact, missed = (
        np.mean([turn_scatter([Face(texture(i, 0.0, by), STEP, RADIUS, TWIST)], 1 / TWIST, [8]) for i in range(10)])
        for by in (0.0, 0.06)
    )
    # four fibres a radian, over the 0.82 turns that are seen twice; normal shades weigh by squares: a third counts
    alone = 0.06 / (2 * math.pi) / math.sqrt(4 * 0.82 * 2 * math.pi / 3)
    assert missed == pytest.approx(math.hypot(exact, alone), rel=0.3)
    assert exact < 0.7 * missed
