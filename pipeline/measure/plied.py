"""A plied yarn in one frame: its axis, its diameter and its twist from the picture of its strands.

One lit cylinder, which `axis.py` fits, finds neither the circle around the strands nor its mean silhouette, and less
than a turn in view tilts it. So the yarn is straightened along the largest elongated thing or along what `axis.py`
found, and the picture of n strands (`strands.py`) is fitted to the strip (`strands_fit.py`). The outline must have the
period of n strands (`outline.py`), which says from which twist the fit starts; what is inclined on the face says of
which hand: strands that differ, or show their fibres, are no picture of strands, and another count or the other hand
may fit as well. Where the face tells no hand the picture must, or `pitch.py`; where too few strands are in view for a
period of the outline, the picture must explain more. Its strands must be as steep as what is seen on the face. Here it
is decided whether the fit is credible.

The diameter is that of this geometry. Strands that are flattened where they touch have a smaller circle than r says.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipeline.measure.axis import YarnAxis, straighten
from pipeline.measure.find import find_line
from pipeline.measure.lines import Image, Pixels, span
from pipeline.measure.outline import MIN_PERIODS as MIN_SCALLOPS
from pipeline.measure.outline import MIN_SHARE, outline, scallops, steep_as, why_not_of
from pipeline.measure.pitch import ply_twist
from pipeline.measure.strands import mean_width
from pipeline.measure.strands_fit import MIN_PERIODS, Picture, best_fit, fit
from pipeline.measure.twist import FrameTwist, strand_slope

ALIGNED = 1.0
"""Tilt over the length from which the strip is cut anew [px]."""
MIN_EXPLAINED, MIN_EXPLAINED_ALONE = 0.2, 0.5
"""Share of what varies along the yarn, noise apart, that the picture explains: with the outline's period, without."""
MIN_FOLLOWING = 0.8
"""Share of the pixels that follow the picture."""
MAX_BLUR = 0.45
"""Blur over a strand's radius from which its edge is not seen."""
MAX_U = 0.005
"""Formal relative uncertainty of the radius from which the edges do not show, as in the dark."""
MIN_CONTRAST = 0.05
"""Share of the other hand's squares that the best picture must save; below, `ply_twist` must know the hand."""
AGREEMENT = 0.02
"""Relative difference up to which the picture's twist and that of `ply_twist` are the same."""
MAX_TURN = math.radians(1)
"""Angle between the axis and the largest elongated thing from which on one of them is not the yarn's."""


@dataclass(frozen=True, slots=True)
class YarnFound:
    """What one frame says of a yarn whose axis was found."""

    axis: YarnAxis | None
    """A plied yarn's has the diameter of the circle around the strands; where there is `doubt` it is the one that was
    given, None where that is not the yarn's."""
    twist: FrameTwist
    doubt: str
    """Why the diameter is not credible; empty where it is."""
    picture: Picture | None = None
    """Where the next frame's fit may start; None where there is `doubt`."""


def plied_yarn(image: Image | Pixels, axis: YarnAxis, plies: int, before: Picture | None = None) -> YarnFound:
    """Measure the plied yarn near an axis of a frame.

    Parameters
    ----------
    image : shape (rows, columns), rows top-down.
    axis : as `find_axis` finds it; its diameter and tilt may be wrong.
    plies : strands n, at least 2.
    before : the picture in the frame before. It only saves time.

    Returns
    -------
    Without the strands `doubt` says why, and the twist is that of `ply_twist`.
    """
    given = *axis.centre, axis.angle, axis.diameter / 2
    line = find_line(image)
    doubt = ""
    slope = strand_slope(image, axis)
    for start in (given,) if line is None else (line, given):
        found = _follow(image, start, plies, before, axis.blur, slope)
        if isinstance(found, YarnFound):
            return found
        doubt = doubt or found
    twist = ply_twist(image, axis, plies)
    if line is not None and abs(math.remainder(line[2] - axis.angle, math.pi)) > MAX_TURN:
        return YarnFound(None, twist, doubt)
    return YarnFound(axis, twist, doubt)


def followed_plied(image: Image | Pixels, axis: YarnAxis, plies: int, before: Picture) -> YarnFound | None:
    """Measure the plied yarn where it is expected after the frame before; None where that picture is not seen there.

    Parameters
    ----------
    image : shape (rows, columns), rows top-down.
    axis : where the yarn is expected.
    plies, before : see `plied_yarn`.
    """
    width = mean_width(plies) * math.exp(before.at[2]) / 2
    start, slope = (*axis.centre, axis.angle, width), strand_slope(image, axis)
    found = _follow(image, start, plies, before, axis.blur, slope)
    return found if isinstance(found, YarnFound) else None


def _follow(
    image: Image | Pixels,
    line: tuple[float, float, float, float],
    plies: int,
    before: Picture | None,
    blur: float,
    slope: float,
) -> YarnFound | str:
    """Fit the strands along a line (a point x, y, the angle, half the silhouette's width), or say why they do not.

    `blur` [px] is about that of the edges; for `slope` see `strand_slope`.
    """
    x, y, angle, width = line
    centre, half, length = _cut(image, x, y, angle, width)
    if length < 2 * width:
        return "less of the yarn is in view than it is wide"
    strip = straighten(image, centre, angle, half, length)
    seen = scallops(outline(strip, width), width, blur)
    unlike = why_not_of(seen, plies, slope)
    if seen is not None and unlike and seen.share >= MIN_SHARE:
        return unlike
    period = seen.frequency / plies if seen is not None and not unlike else None
    picture = best_fit(strip, plies, width, before, period, int(np.sign(slope)))
    reason = _doubt(picture, plies, length, unlike, slope)
    if not reason and abs(picture.at[1]) * length > ALIGNED:
        (x, y), angle = _moved(picture, centre, angle)
        first = centre
        centre, half, length = _cut(image, x, y, angle, width)
        along = (centre[0] - first[0]) * math.cos(angle) - (centre[1] - first[1]) * math.sin(angle)
        at = picture.at.copy()
        at[:2] = 0
        at[3] += 2 * math.pi * at[4] * along
        strip = straighten(image, centre, angle, half, max(length, 1))
        picture = replace(fit(strip, plies, at, picture.levels, picture.computed), other=picture.other)
        reason = _doubt(picture, plies, length, unlike, slope)
    if reason:
        return reason
    axis = _axis(picture, *_moved(picture, centre, angle), length, plies)
    twist = float(picture.at[4])
    contrast = 1 - picture.squares / picture.other
    reason = ""
    if contrast < MIN_CONTRAST:
        period = ply_twist(image, axis, plies).per_pixel
        same = abs(abs(period) - abs(twist)) <= AGREEMENT * abs(twist)
        twist = math.copysign(twist, period) if same else math.nan
        reason = "" if same else "Z and S explain the strands about as well"
    return YarnFound(axis, FrameTwist(twist, picture.explained, contrast, reason, picture.u_twist), "", picture)


def _cut(image: Image | Pixels, x: float, y: float, angle: float, width: float) -> tuple[tuple[float, float], int, int]:
    """Return the centre, half the width and the length of a strip along a line, see `straighten`."""
    half = math.ceil(1.5 * width + 6)
    low, high = span(image.shape[0], image.shape[1], x, y, angle, float(half))
    middle = (low + high) / 2
    return (x + middle * math.cos(angle), y - middle * math.sin(angle)), half, math.floor(high - low)


def _moved(picture: Picture, centre: tuple[float, float], angle: float) -> tuple[tuple[float, float], float]:
    """Return the point and the angle of the axis that a picture in a strip has."""
    offset, tilt = picture.at[:2].tolist()
    angle -= math.atan(tilt)
    return (centre[0] + offset * math.sin(angle), centre[1] + offset * math.cos(angle)), angle


def _doubt(picture: Picture, plies: int, length: int, unlike: str, slope: float) -> str:
    """Say why a picture is not credible; empty where it is.

    `unlike` says why the outline is not that of strands; for `slope` see `strand_slope`.
    """
    if math.isnan(picture.u_radius):
        return "the strands' picture does not settle"
    periods = plies * abs(float(picture.at[4])) * length
    blur = math.exp(picture.at[5] - picture.at[2])
    explained = MIN_EXPLAINED_ALONE if unlike else MIN_EXPLAINED
    for refused, why in (
        (periods >= MIN_SCALLOPS and unlike, unlike),
        (
            periods < MIN_PERIODS,
            f"{periods:.2f} periods of the strands are in view: at least {MIN_PERIODS:g} is needed",
        ),
        (
            # along an axis that is not the yarn's own a strand that hardly turns looks as tilted as the yarn
            not steep_as(plies, float(picture.at[4]), slope),
            "what is seen on the face is not as steep as the strands",
        ),
        (
            picture.explained < explained,
            f"strands explain {picture.explained:.2f} of what varies along the yarn: {explained} is needed",
        ),
        (
            picture.share < MIN_FOLLOWING,
            f"{100 * picture.share:.0f} % of the pixels follow the strands: {100 * MIN_FOLLOWING:.0f} % is needed",
        ),
        (blur > MAX_BLUR, f"the edges are blurred over {blur:.2f} of a strand's radius: {MAX_BLUR} is too much"),
        (picture.u_radius > MAX_U, "the strands' edges hardly stand out from the background"),
    ):
        if refused:
            return why
    return ""


def _axis(picture: Picture, centre: tuple[float, float], angle: float, length: int, plies: int) -> YarnAxis:
    radius, blur, light = math.exp(picture.at[2]), math.exp(picture.at[5]), float(picture.at[6])
    if math.floor(angle / math.pi) % 2:  # the axis' direction, and with it left and right, is turned round
        light = -light
    dark = float(picture.levels[0] + picture.levels[3])
    return YarnAxis(
        centre=centre,
        angle=angle % math.pi,
        diameter=2 * radius * (1 + 1 / math.sin(math.pi / plies)),
        blur=blur,
        length=length,
        agreement=picture.share,
        lean=0.0,
        light=light,
        shade=(dark + float(picture.levels[4]), dark),
        misfit=picture.misfit,
        groove=0.0,
    )
