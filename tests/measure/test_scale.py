"""The cylinder's two edges: scale and axis on rendered (synthetic) cylinders of known diameter and direction."""

import math

import cv2
import numpy as np
import pytest

from pipeline.errors import InputError
from pipeline.measure.scale import cylinder_in, find_cylinder
from pipeline.synthetic import Material, render_frame

SHAPE = (300, 400)


def cylinder(
    seed=0, *, angle=37.0, diameter=180.3, offset=3.3, ambient=0.5, light=0.3, levels=(0.6, 0.08), blur=1.0, yarn=False
):
    """A lit cylinder by Lambert's law, crossed by a brighter thread if there is to be a yarn; 12 bit."""
    rng = np.random.default_rng(seed)
    k = 4
    x = (np.arange(SHAPE[1] * k) + 0.5) / k - SHAPE[1] / 2
    y = (SHAPE[0] / 2 - (np.arange(SHAPE[0] * k) + 0.5) / k)[:, None]
    across = x * math.sin(math.radians(angle)) - y * math.cos(math.radians(angle)) - offset
    around = np.arcsin(np.clip(2 * across / diameter, -1, 1))
    shade = ambient + (1 - ambient) * np.maximum(np.cos(around - light), 0)
    image = np.where(np.abs(across) < diameter / 2, levels[0] * shade, levels[1])
    if yarn:
        turned = math.radians(angle + 75)
        place = (x * math.sin(turned) - y * math.cos(turned)) / 10
        image = np.where(np.abs(place) < 1, 0.9 * np.sqrt(1 - np.clip(place, -1, 1) ** 2), image)
    image = cv2.GaussianBlur(image.astype(np.float32), (0, 0), blur * k)
    image = cv2.resize(image, SHAPE[::-1], interpolation=cv2.INTER_AREA)
    return np.clip(np.round(4095 * image + 15 * rng.standard_normal(SHAPE)), 0, 4095).astype(np.uint16)


class Stack:
    """Frames in memory; an entry that is None cannot be read."""

    def __init__(self, *images):
        self.images = images

    def __len__(self):
        return len(self.images)

    def frame(self, index):
        if self.images[index] is None:
            raise InputError("stack", "truncated", "a whole frame")
        return self.images[index]


def off(found, angle):
    """Difference of directions of axes [°]."""
    return (math.degrees(found.axis.angle) - angle + 90) % 180 - 90


@pytest.mark.parametrize("angle", [0.0, 37.0, 90.0, 135.5, 179.8])
@pytest.mark.parametrize("levels", [(0.6, 0.08), (0.06, 0.7)], ids=["lit", "silhouette"])
def test_diameter_and_axis(angle, levels):
    found = find_cylinder(cylinder(angle=angle, levels=levels, yarn=angle in (37.0, 90.0)))
    assert found is not None
    assert found.diameter == pytest.approx(180.3, rel=0.002)
    assert abs(off(found, angle)) < 0.02


def test_the_stated_uncertainty_covers_the_error():
    rng = np.random.default_rng(7)
    errors, u, turned = [], [], []
    for seed in range(16):
        angle, diameter = rng.uniform(0, 180), rng.uniform(110, 230)
        scene = {"ambient": rng.uniform(0.4, 1), "light": rng.uniform(-0.5, 0.5), "blur": rng.uniform(0.6, 2)}
        found = find_cylinder(cylinder(seed, angle=angle, diameter=diameter, yarn=bool(seed % 2), **scene))
        assert found is not None, (seed, angle, diameter, scene)
        errors.append(found.diameter / diameter - 1)
        u.append(found.u_diameter / diameter)
        turned.append(abs(off(found, angle)))
    assert abs(np.mean(errors)) < 5e-4
    assert np.mean(np.abs(errors) < 2 * np.array(u)) >= 0.9
    assert max(turned) < 0.01


def test_the_scale_carries_the_uncertainty():
    found = find_cylinder(cylinder())
    assert found is not None
    scale = found.scale(6e-3)
    assert scale.metres_per_pixel == pytest.approx(6e-3 / 180.3, rel=0.002)
    assert scale.relative_u == found.u_diameter / found.diameter
    assert 0.0005 < scale.relative_u < 0.003


def test_yarn_alone_noise_and_an_empty_frame_give_no_cylinder():
    rng = np.random.default_rng(1)
    yarn = render_frame(Material.draw(rng), rng, shape=SHAPE, axis_angle=0.3, diameter=40, twist=0.004)
    noise = rng.integers(0, 4096, SHAPE).astype(np.uint16)
    one_edge = np.zeros(SHAPE, np.uint16)
    one_edge[:, 200:] = 3000
    for frame in (yarn, noise, one_edge, np.full(SHAPE, 7, np.uint16)):
        assert find_cylinder(frame) is None


def test_a_taper_is_no_cylinder():
    y, x = np.indices(SHAPE)
    wedge = (np.abs(y - 150) < 60 + 0.1 * x).astype(np.uint16) * 3000
    assert find_cylinder(wedge) is None


def test_the_first_readable_frame_counts():
    good = cylinder()
    assert cylinder_in(Stack(None, good), "clip").diameter == pytest.approx(180.3, rel=0.002)
    with pytest.raises(InputError, match=r"clip: frame 1: no cylinder's two edges were found"):
        cylinder_in(Stack(None, np.zeros(SHAPE, np.uint8), good), "clip")
    with pytest.raises(InputError, match="no frame can be read"):
        cylinder_in(Stack(None), "clip")
