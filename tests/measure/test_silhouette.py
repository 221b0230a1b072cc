"""A yarn in front of a lit background: no lamp, and both edges are seen."""

import math

import numpy as np
import pytest

from pipeline.measure.axis import find_axis
from pipeline.measure.yarn import FARTHEST_LIGHT
from pipeline.synthetic import Material, Optics, render_frame


@pytest.mark.parametrize("yarn", [0.01, 0.15, 0.4])
@pytest.mark.parametrize("seed", range(3))
def test_a_back_lit_yarn_has_a_diameter(yarn: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = render_frame(
        Material.draw(rng), rng, shape=(300, 400), axis_angle=1.2, diameter=40.0, twist=1 / 200,
        optics=Optics(background=0.85, yarn=yarn, ambient=1.0),
    )  # fmt: skip
    axis = find_axis(image)
    assert axis is not None
    assert abs(axis.light) <= FARTHEST_LIGHT
    assert axis.diameter == pytest.approx(40.0, rel=0.01)
    assert math.degrees(axis.angle) == pytest.approx(math.degrees(1.2), abs=0.1)
