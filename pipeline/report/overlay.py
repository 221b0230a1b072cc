"""What was measured, drawn on the frames: a user sees at a glance where the tool has measured a hair."""

import math
import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.atomic import refuse_strangers, whole_folder
from pipeline.errors import InputError
from pipeline.records import FrameFlag, Scale, YarnMeasurement

FRAMES = 24
"""Most frames that are drawn: all of a shorter clip, else so many evenly spaced, the first and the last among them."""
WHAT = "an overlay"
SHEET = "contact_sheet.png"
SHEET_COLUMNS = 4
TILE_WIDTH = 400
"""Width of a frame on the contact sheet [px]."""
HELIX_SPACING = 2.0
"""Distance between the drawn fibre lines along the yarn [diameters]."""

Picture = NDArray[np.uint8]
AXIS, EDGE, FIBRE, GOOD, BAD = (0, 220, 255), (255, 200, 0), (255, 80, 255), (235, 235, 235), (80, 80, 255)
"""Colours as blue, green, red: yellow, light blue, magenta, white, red."""
SHIFT = 4
"""Fractional bits of drawn coordinates."""
LINE_HEIGHT = 18
MARGIN = 6


def write_overlay(measured: YarnMeasurement, scale: Scale, folder: Path) -> list[int]:
    """Write annotated frames and a contact sheet of them as PNG to `folder`, whole or not at all.

    Yellow is the yarn's axis, blue its edges, magenta the way that fibres of the measured twist take over the near
    face; a frame with a flag has its text in red. Values are those of the measurement; the axis' place, which it does
    not keep, is found again in the frame.

    Parameters
    ----------
    measured : a clip's measurement, n frames.
    scale : the object scale that it was made with.
    folder : an earlier overlay in it is replaced.

    Returns
    -------
    The numbers of the frames that were drawn, at most `FRAMES`.

    Raises
    ------
    InputError
        If `folder` holds anything but an overlay, or cannot be written.
    """
    n = len(measured.flag)
    chosen = sorted(set(np.linspace(0, n - 1, min(n, FRAMES)).round().astype(int).tolist()))
    digits = len(str(n - 1))
    with whole_folder(folder, _is_ours, WHAT) as part:
        tiles = []
        for index in chosen:
            picture = annotated(measured, scale, index)
            _write(part / f"frame_{index:0{digits}d}.png", picture, folder)
            size = (TILE_WIDTH, max(1, round(picture.shape[0] * TILE_WIDTH / picture.shape[1])))
            tiles.append(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
        _write(part / SHEET, _sheet(tiles), folder)
    return chosen


def check_folder(folder: Path) -> None:
    """Raise the `InputError` of `write_overlay` for a folder that holds anything but an overlay, before the work."""
    refuse_strangers(folder, _is_ours, WHAT)


def annotated(measured: YarnMeasurement, scale: Scale, index: int) -> Picture:
    """One frame, stretched to 8 bits, with what was measured in it; shape (rows + text, columns, 3), BGR.

    A frame that cannot be read is black.
    """
    try:
        frame = measured.raw.frames.frame(index)
    except InputError:
        frame = np.zeros(measured.raw.shape, np.uint8)
    dark, bright = np.percentile(frame, (0.5, 99.8))
    gray = np.clip((frame - dark) * (255 / max(bright - dark, 1.0)), 0, 255).astype(np.uint8)
    picture = cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)
    angle, diameter = float(measured.axis_angle[index]), float(measured.diameter[index]) / scale.metres_per_pixel
    if math.isfinite(angle):
        x, y = map(float, measured.centre[index])
        twist = float(measured.twist[index]) * scale.metres_per_pixel
        _draw(picture, (x, y), angle, diameter, twist)
    return _with_text(picture, _text(measured, index), BAD if measured.flag[index] else GOOD)


def _draw(picture: Picture, centre: tuple[float, float], angle: float, diameter: float, twist: float) -> None:
    """Draw axis, edges and fibres; lengths in pixels, twist signed in 1/px or NaN."""
    reach = math.hypot(*picture.shape[:2])
    along, right = np.array([math.cos(angle), -math.sin(angle)]), np.array([math.sin(angle), math.cos(angle)])
    ends = np.array([[-reach], [reach]]) * along
    for offset, colour in ((0.0, AXIS), (-diameter / 2, EDGE), (diameter / 2, EDGE)):
        _line(picture, np.array(centre) + offset * right + ends, colour)
    if not math.isfinite(twist) or twist == 0:
        return
    # A fibre on the surface turns by 2πT a length: over the near face γ runs from one edge to the other.
    gamma = np.linspace(-math.pi / 2, math.pi / 2, 25)
    fibre = np.outer(gamma / (2 * math.pi * twist), along) + np.outer(diameter / 2 * np.sin(gamma), right)
    step = HELIX_SPACING * diameter
    for start in np.arange(-reach // step, reach // step + 1) * step:
        _line(picture, np.array(centre) + start * along + fibre, FIBRE)


def _line(picture: Picture, points: NDArray[np.floating], colour: tuple[int, int, int]) -> None:
    fixed = np.round(points * (1 << SHIFT)).astype(np.int32)
    cv2.polylines(picture, [fixed], False, colour, 1, cv2.LINE_AA, SHIFT)


def _text(measured: YarnMeasurement, index: int) -> list[str]:
    """Lines of ASCII, which is all that OpenCV's font has."""
    values = []
    for value, unit, name in (
        (math.degrees(measured.axis_angle[index]), "deg", "axis"),
        (math.degrees(measured.theta[index]), "deg", "theta"),
        (measured.diameter[index] * 1e3, "mm", "d"),
        (measured.twist[index], "tpm", "T"),
        (measured.hairiness[index] * 1e-3, "/mm", "hairs"),
        (measured.helix_rotation[index], "1/s", "helix"),
    ):
        values.append(f"{name} {value:.5g} {unit}" if math.isfinite(value) else f"{name} -")
    flags = " ".join(f.name or "" for f in FrameFlag if f & int(measured.flag[index]))
    when = f"frame {index}  t {measured.raw.time[index]:.6f} s  confidence {measured.confidence[index]:.2f}"
    return [when, "  ".join(values), flags or "no flag"]


def _with_text(picture: Picture, lines: list[str], colour: tuple[int, int, int]) -> Picture:
    """Add lines of text below a picture, in letters that fit its width."""
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.45
    widest = max(cv2.getTextSize(line, font, size, 1)[0][0] for line in lines)
    size *= min(1.0, 0.9 * (picture.shape[1] - 2 * MARGIN) / widest)  # OpenCV states a tenth too little at times
    band = np.full((LINE_HEIGHT * len(lines) + MARGIN, picture.shape[1], 3), 30, np.uint8)
    for i, line in enumerate(lines):
        cv2.putText(band, line, (MARGIN, LINE_HEIGHT * (i + 1) - 3), font, size, colour, 1, cv2.LINE_AA)
    return np.vstack([picture, band])


def _sheet(tiles: list[NDArray[np.generic]]) -> Picture:
    """Put equal tiles in rows of `SHEET_COLUMNS`."""
    columns = min(SHEET_COLUMNS, len(tiles))
    rows = math.ceil(len(tiles) / columns)
    high, wide = tiles[0].shape[:2]
    sheet = np.full((rows * (high + MARGIN) - MARGIN, columns * (wide + MARGIN) - MARGIN, 3), 255, np.uint8)
    for i, tile in enumerate(tiles):
        top, left = i // columns * (high + MARGIN), i % columns * (wide + MARGIN)
        sheet[top : top + high, left : left + wide] = tile
    return sheet


def _write(path: Path, picture: Picture, folder: Path) -> None:
    _, data = cv2.imencode(".png", picture)
    try:
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise InputError(folder, f"cannot be written ({error.strerror})", "a place with room for the images") from None


def _is_ours(name: str) -> bool:
    return name == SHEET or re.fullmatch(r"frame_\d+\.png", name) is not None
