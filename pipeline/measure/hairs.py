"""Hairiness of the yarn in one frame: hairs that cross a line beside it, as hair counters count them.

On either side a line runs along the yarn, `BEYOND` diameters from its edge. What is narrower along it than `WIDEST`
diameters and stands out of the background by `SIGMAS` robust standard deviations, and by `FAINTEST` of the yarn's own
level, is one crossing of a hair. The index is crossings per length of yarn, both sides together. It depends on light
and focus as every optical hairiness does: compare it between clips of one set-up only.
"""

import math

import cv2
import numpy as np
from scipy.ndimage import median_filter

from pipeline.measure.axis import YarnAxis
from pipeline.measure.lines import Image, Pixels

BEYOND = 0.5
WIDEST = 0.7
SIGMAS = 5.0
FAINTEST = 0.05
"""Least contrast of a hair over that of the yarn: fainter ones are clouds."""


def hairiness(image: Image | Pixels, axis: YarnAxis) -> float:
    """Return crossings per length of yarn [1/px]; NaN where the lines leave the frame.

    Parameters
    ----------
    image : shape (rows, columns).
    axis : where the yarn is.
    """
    radius, rows, columns = axis.diameter / 2, *image.shape
    along = np.arange(axis.length) - (axis.length - 1) / 2
    c, s = math.cos(axis.angle), math.sin(axis.angle)
    crossings, seen = 0, 0
    for side in (-1.0, 1.0):
        place = side * (radius + max(BEYOND * axis.diameter, 4 * axis.blur)) + 0.5 * axis.bend * along**2
        x = (axis.centre[0] + s * place + c * along).astype(np.float32)
        y = (axis.centre[1] + c * place - s * along).astype(np.float32)
        inside = (x >= 0) & (x <= columns - 1) & (y >= 0) & (y <= rows - 1)
        if np.count_nonzero(inside) < 2 * axis.diameter:
            continue
        line = cv2.remap(image, x[None, inside], y[None, inside], cv2.INTER_LINEAR)[0].astype(float)
        rest = line - median_filter(line, 2 * round(WIDEST * axis.diameter) + 1, mode="nearest")
        noise = 1.4826 * float(np.median(np.abs(rest)))
        contrast = abs(axis.shade[0] - float(np.median(line)))
        out = np.abs(rest) > max(SIGMAS * noise, FAINTEST * contrast)
        crossings += int(np.count_nonzero(out[1:] & ~out[:-1])) + int(out[0])
        seen += line.size
    return 2 * crossings / seen if seen else math.nan
