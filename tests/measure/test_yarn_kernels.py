"""The compiled steps of the yarn's measurement against plain formulas and other libraries. Frames are synthetic."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import spline_filter1d

from pipeline.measure import axis, find, twist
from pipeline.measure.align import register
from pipeline.measure.axis import find_axis, straighten
from pipeline.measure.lines import block_means, share_above, step_across, unrolled
from pipeline.measure.twist import surface_twist, unroll
from pipeline.synthetic import Material, render_frame

SHAPE = (256, 400)


@pytest.fixture(scope="module")
def frame():
    rng = np.random.default_rng(3)
    return render_frame(
        Material.draw(rng, fibre_length=3), rng, shape=SHAPE, axis_angle=math.radians(40), diameter=30.0, twist=0.006
    )


def noise(seed, shape=SHAPE):
    return np.random.default_rng(seed).integers(0, 4096, shape).astype(np.uint16)


@settings(max_examples=60, deadline=None)
@given(
    x=st.floats(-20, 420), y=st.floats(-20, 276), angle=st.floats(0, math.pi), half=st.integers(1, 40),
    length=st.integers(2, 500),
)  # fmt: skip
def test_a_strip_of_a_frame_of_integers_is_that_of_the_whole_frame_in_floating_point(x, y, angle, half, length):
    """Only the pixels near a strip are converted: those of the strip before must not shine through."""
    axis.floats_around(noise(0), (200.0, 128.0), 0.3, 128, 500)
    pixels = noise(1)
    expected = straighten(pixels.astype(np.float32), (x, y), angle, half, length)
    np.testing.assert_array_equal(straighten(pixels, (x, y), angle, half, length), expected)


def test_frames_of_integers_and_of_floats_give_the_same_numbers(frame):
    floats = frame.astype(np.float32)
    found = find_axis(frame)
    np.testing.assert_equal(found, find_axis(floats))
    assert surface_twist(frame, found) == surface_twist(floats, found)
    assert math.isfinite(surface_twist(frame, found).per_pixel)


@pytest.mark.parametrize(("shape", "kind"), [((256, 400), np.uint16), ((61, 83), np.uint8)])
def test_the_reduced_frame_is_the_mean_of_its_pixels(shape, kind):
    pixels = (noise(2, shape) % np.iinfo(kind).max).astype(kind)
    rows, columns = shape[0] // 4, shape[1] // 4
    expected = pixels[: 4 * rows, : 4 * columns].reshape(rows, 4, columns, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(find._reduced(pixels), expected, rtol=1e-7)


def test_the_background_is_a_quadratic_that_bright_things_do_not_bend():
    v, u = np.meshgrid(np.linspace(-1, 1, 64), np.linspace(-1, 1, 100), indexing="ij")
    image = 300 + 40 * u - 25 * v + 12 * u * u - 9 * u * v + 5 * v * v
    noisy = image + np.random.default_rng(4).normal(0, 1, image.shape)
    noisy[:, 45:52] += 1000
    deviation = find._deviation(noisy.astype(np.float32))
    np.testing.assert_allclose(deviation, np.abs(noisy - image), atol=1.0)


def test_the_correlation_is_pearson_s_coefficient_of_all_pairs_in_view(frame):
    """In double precision, by its definition: the transforms round at the seventh digit of the largest value."""
    texture = np.ascontiguousarray(unroll(frame, find_axis(frame))[:, :200])
    rows, columns = texture.shape
    lags, reach = twist._lags(24), 3 * rows // 4
    spectra = twist._spectra(texture, lags)
    found = twist._correlation(texture, spectra, *twist._harmonics(spectra.shape[1], 24), lags)
    assert found.shape == (2 * reach + 1, lags.size)
    exact = texture.astype(float)
    for i, shift in enumerate(range(-reach, reach + 1)):
        low, high = max(0, -shift), min(rows, rows - shift)
        for j, lag in enumerate(lags):
            one, other = exact[low:high, : columns - lag], exact[low + shift : high + shift, lag:]
            one, other = one - one.mean(axis=1, keepdims=True), other - other.mean(axis=1, keepdims=True)
            coefficient = np.sum(one * other) / math.sqrt(np.sum(one**2) * np.sum(other**2))
            assert found[i, j] == pytest.approx(coefficient, abs=2e-6)


def test_the_spline_s_coefficients_are_scipy_s():
    values = np.random.default_rng(5).normal(size=(55, 7))
    np.testing.assert_allclose(twist._spline(values), spline_filter1d(values, axis=0), atol=1e-12)


@pytest.mark.parametrize("count", [4, 5, 17, 30, 32])
def test_blocks_give_profile_and_spread_as_percentiles_do(frame, count):
    found = find_axis(frame)
    blocks = block_means(frame, *found.centre, found.angle, 0.0, 24, count, 8)
    profile, spread, *_ = register(blocks, 0.0)
    quarter = count // 4
    ordered = np.sort(blocks.astype(float), axis=0)[quarter : count - quarter]
    np.testing.assert_allclose(profile, ordered.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(spread, np.ptp(ordered, axis=0), rtol=1e-6)


def level(x, y):
    """What cubic convolution gives exactly: a quadratic."""
    return 300 + 3 * x + 2 * y + 0.01 * x * y - 0.004 * x * x + 0.006 * y * y


def place(centre, angle, across, along):
    """Where in a frame distances from an axis, to its right, and along it lie; see `straighten`."""
    c, s = math.cos(angle), math.sin(angle)
    return centre[0] + along * c + across[:, None] * s, centre[1] - along * s + across[:, None] * c


@pytest.mark.parametrize("degrees", [-60, -20, 0, 5, 30, 44, 46, 80, 90, 120, 134, 136, 170, 180])
def test_lines_of_a_frame_give_the_surface_square_to_the_axis(degrees):
    """Rows or columns, in either direction: exact where the level is a quadratic."""
    rows, columns = np.indices(SHAPE)
    image, centre, angle = level(columns, rows).astype(np.float32), (200.3, 127.8), math.radians(degrees)
    across, count = np.array([-12.3, -5.0, 0.0, 3.3, 14.2]), 101
    along = (np.arange(count) - (count - 1) / 2) / step_across(angle)
    found = unrolled(image, *centre, angle, 0.0, np.empty(0), across, count)
    np.testing.assert_allclose(found, level(*place(centre, angle, across, along)), atol=2e-3)


@pytest.mark.parametrize("degrees", [-60, -20, 0, 44, 46, 90, 134, 136, 180])
def test_blocks_are_means_square_to_the_axis(degrees):
    """To two lines along it: which halves of four lines belong to a block is rounded."""
    rows, columns = np.indices(SHAPE)
    image, centre, angle = (3.0 * columns + 2.0 * rows).astype(np.float32), (200.3, 127.8), math.radians(degrees)
    step = step_across(angle)
    found = block_means(image, *centre, angle, 0.0, 14, 9, 8)
    x, y = place(centre, angle, (np.arange(29) - 14) * step, (np.arange(9) - 4) * 8 / step)
    along = abs(3 * math.cos(angle) - 2 * math.sin(angle)) / step
    np.testing.assert_allclose(found.T, 3 * x + 2 * y, atol=2.01 * along + 1e-3)


@pytest.mark.parametrize("degrees", [0, 30, 60, 90, 150])
def test_the_share_of_bright_pixels_is_that_of_the_band(degrees):
    """Half of the yarn's width is at the level: 0 to 10 px to the right of the axis, of -10 to 10."""
    rows, columns = np.indices(SHAPE)
    angle = math.radians(degrees)
    right = (columns - 200) * math.sin(angle) + (rows - 128) * math.cos(angle)
    image = np.where(right > 0, 4095, 4094).astype(np.uint16)
    assert share_above(image, 200.0, 128.0, angle, 0.0, 10.0, 150.0, 4095) == pytest.approx(0.5, abs=0.03)
    assert share_above(image, 200.0, 128.0, angle, 0.0, 10.0, 150.0, 4096) == 0


def test_a_strip_s_pixels_are_where_they_should_be_within_a_hundredth_of_a_pixel():
    """How finely positions are rounded is OpenCV's, and not the same in each of its versions."""
    rows, columns = np.indices(SHAPE)
    plane = (3.0 * columns + 2.0 * rows).astype(np.float32)
    centre, angle, length = (200.3, 127.8), math.radians(40), 201
    along, across = np.arange(length) - 100.0, np.arange(-20, 21)[:, None]
    x = centre[0] + along * math.cos(angle) + across * math.sin(angle)
    y = centre[1] - along * math.sin(angle) + across * math.cos(angle)
    np.testing.assert_allclose(straighten(plane, centre, angle, 20, length), 3 * x + 2 * y, atol=0.03)
