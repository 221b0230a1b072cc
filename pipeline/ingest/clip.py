"""What every video reader hands to `open_video`, and the checks that all of them share."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.records import Array, Frames

Pixels = NDArray[np.uint8] | NDArray[np.uint16]

MAX_PIXELS = 1 << 28
"""Larger frames are taken for a damaged header: no high-speed camera comes near it."""

MAX_FRAMES = 1 << 24
"""Longer clips are taken for a damaged header: over an hour at 4000 1/s."""

LUMA = (299, 587, 114)
"""Weights of red, green and blue in the luma, in thousandths."""

OWN_LUMA = "measured on its luma (BT.601)"
HELD_LUMA = "where there is any, measured on the luma Y′ that is stored"
"""What `metadata['colour']` says of frames in RGB, and of those whose format keeps the luma apart, coloured or not."""


@dataclass(frozen=True, slots=True)
class Clip:
    """A clip as one format's reader sees it."""

    frames: Frames
    """As stored: a frame is (rows, columns), or (rows, columns, 3) of red, green and blue (see `luma`)."""
    metadata: Mapping[str, str]
    bits: int | None = None
    """Significant bits of a pixel where the file states them."""
    stamps: Array = field(default_factory=lambda: np.empty(0))
    """Time stamps from the first frame [s], shape (n,); empty where the file has none."""
    rate: float = math.nan
    """Recording rate that the header states [1/s], where the format has no time stamps; NaN where it does not."""
    sequential: bool = False
    """Whether a frame takes long to read unless it is the next one."""
    beside: tuple[Path, ...] = ()
    """Files beside the named one that the clip was read from, too."""


def frame_error(path: Path, index: int, found: str) -> InputError:
    """One frame that cannot be read, counted from 0."""
    return InputError(f"{path}: frame {index}", found, "copy the clip again from the camera, or go without this frame")


def read_pixels(file: FileIO, size: int) -> NDArray[np.uint8]:
    """Read `size` bytes from where a file stands, or those that are left, without a copy between file and array."""
    data = np.empty(size, np.uint8)
    return data[: file.readinto(data.data)]


def as_pixels(image: NDArray[np.generic], where: str | Path) -> Pixels:
    """Unsigned pixels, C-contiguous and in the machine's byte order, (rows, columns) or (rows, columns, 3).

    Parameters
    ----------
    image : shape (rows, columns), or (rows, columns, channels): gray and alpha, RGB, or RGB and alpha. An alpha channel
        that is opaque everywhere is dropped.
    where : the place to name in an error.

    Raises
    ------
    InputError
        If the image has an alpha channel that is not opaque, or other channels, or if its pixels are not 8 or 16 bit
        unsigned integers.
    """
    if image.dtype.kind != "u" or image.dtype.itemsize > 2:
        raise InputError(where, f"{image.dtype.name} pixels", "export as 8 or 16 bit unsigned integers")
    if image.ndim == 3 and image.shape[2] in (2, 4):
        if np.any(image[..., -1] != (1 << 8 * image.dtype.itemsize) - 1):
            raise InputError(where, "an alpha channel that is not opaque", "export without transparency")
        image = image[..., 0] if image.shape[2] == 2 else image[..., :3]
    if image.ndim != 2 and image.shape[2:] != (3,):
        raise InputError(where, f"an image of shape {image.shape}", "export in gray or RGB")
    if image.dtype.itemsize == 1:
        return np.ascontiguousarray(image, dtype=np.uint8)
    return np.ascontiguousarray(image, dtype=np.uint16)


def luma(pixels: Pixels) -> Pixels:
    """Gray levels of a frame: its luma, Y′ = 0.299 R′ + 0.587 G′ + 0.114 B′ of the stored values (ITU-R BT.601, 2.5.1).

    Rounded to the nearest level, a half upwards; where the three are equal, exactly their value.

    Parameters
    ----------
    pixels : shape (rows, columns), which is returned as it is, or (rows, columns, 3): red, green, blue.
    """
    if pixels.ndim == 2:
        return pixels
    red, green, blue = (pixels[..., i] * np.uint32(weight) for i, weight in enumerate(LUMA))
    red += green
    red += blue
    red += np.uint32(500)
    red //= np.uint32(1000)
    return red.astype(np.uint8) if pixels.dtype == np.uint8 else red.astype(np.uint16)


def count_frames(found: int, promised: int) -> int:
    """Frames of a clip: those that its header promises, so that missing ones are seen, unless it cannot be believed."""
    return promised if found < promised <= min(MAX_FRAMES, 1000 * found) else found


def check_size(rows: int, columns: int, where: str | Path) -> None:
    """Refuse a size that only a damaged header can state, before memory is taken for it."""
    if not (rows > 0 and columns > 0 and rows * columns <= MAX_PIXELS):
        raise InputError(where, f"a frame of {columns} × {rows} pixels", "a damaged header: copy the clip again")
