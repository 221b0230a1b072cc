"""Rendered frames of yarn as clips in memory, for tests of what is measured in them."""

import math
from dataclasses import replace

import numpy as np

from pipeline.errors import InputError
from pipeline.records import RawVideo, Source
from pipeline.synthetic import Material, render_frame


class Stack:
    """Frames in memory; an entry that is None cannot be read."""

    def __init__(self, images):
        self.images = images

    def __len__(self):
        return len(self.images)

    def frame(self, index):
        if self.images[index] is None:
            raise InputError("stack", f"frame {index} is truncated", "a whole frame")
        return self.images[index]


def clip(images, bits=12):
    """The frames as a clip of 1200 a second; one of them at least can be read."""
    shape = next(image.shape for image in images if image is not None)
    return RawVideo(Source("stack", "", 0), Stack(images), np.arange(len(images)) / 1200, 1200.0, bits, shape)


def yarn(seed, *, shape, tan_beta, angle, diameter, hairs=1.5, material=None, **scene):
    """One frame of a yarn, and its twist [1/px]; angle [°], diameter [px].

    `material` changes fields of the one that is drawn, `scene` is passed on to `render_frame`.
    """
    rng = np.random.default_rng(seed)
    drawn = Material.draw(rng, fibre_length=0.5 * math.pi / abs(tan_beta), hairs_per_diameter=hairs)
    twist = tan_beta / (math.pi * diameter)
    image = render_frame(
        replace(drawn, **(material or {})), rng, shape=shape, axis_angle=math.radians(angle), diameter=diameter,
        twist=twist, **scene,
    )  # fmt: skip
    return image, twist
