"""Images stored turned or mirrored, by the orientation tag of TIFF and EXIF, made upright.

A camera stores what its sensor saw and states how it was held; every viewer turns the picture. Angles are counted in
the picture as displayed, and a mirrored one swaps S and Z, so the tag is applied, not passed over.
"""

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import InputError

ORIENTATION = 274
STEPS = ((1, 1), (1, -1), (-1, -1), (-1, 1))
"""Steps along rows and columns that make an image upright, for the values 1 to 4; 5 to 8 are transposed before."""
SHORT = 3


def upright(image: NDArray[np.generic], orientation: int, where: str | Path) -> NDArray[np.generic]:
    """The image as it is to be displayed.

    Parameters
    ----------
    image : shape (rows, columns) or (rows, columns, channels), as stored.
    orientation : value of the tag, 1 to 8 (TIFF 6.0, page 36).
    where : the place to name in an error.

    Raises
    ------
    InputError
        If the tag has another value.
    """
    if not 1 <= orientation <= 8:
        raise InputError(where, f"an orientation of {orientation}", "export it upright (1; the tag goes from 1 to 8)")
    down, right = STEPS[(orientation - 1) % 4]
    return (image if orientation <= 4 else image.swapaxes(0, 1))[::down, ::right]


def exif_orientation(exif: bytes, where: str | Path) -> int:
    """The orientation that a block of EXIF states, a TIFF header with its first directory; 1 where it states none.

    Raises
    ------
    InputError
        If the block ends before its directory does: how the picture is to be held is then not known.
    """
    try:
        order = {b"II": "<", b"MM": ">"}[exif[:2]]
        start = struct.unpack_from(f"{order}I", exif, 4)[0]
        for i in range(struct.unpack_from(f"{order}H", exif, start)[0]):
            tag, kind, _, value = struct.unpack_from(f"{order}HHIH", exif, start + 2 + 12 * i)
            if tag == ORIENTATION and kind == SHORT:
                return value
    except (KeyError, struct.error):
        raise InputError(where, "a damaged EXIF block: no telling how it is turned", "export it again") from None
    return 1
