"""JPEG (ITU-T T.81) of 8 bits: gray, or the luma of a colour picture.

libjpeg-turbo decodes, and stops at the first thing that is not as it should be, where other decoders make up what a
damaged file does not hold. JPEG has no checksum: a bit that only changes the value of a coefficient is not seen.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.ingest.clip import check_size
from pipeline.ingest.orientation import exif_orientation, upright

SOS, APP1, APP14 = 0xDA, 0xE1, 0xEE
FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
"""Markers of frame headers."""
READ = {0xC0, 0xC1, 0xC2}
"""Those that are read: baseline, extended and progressive, with Huffman's codes."""
EXIF, ADOBE = b"Exif\0\0", b"Adobe"
ADOBE_KINDS = {0, 1}
"""What Adobe's segment may say of three components: RGB, or luma and chroma."""
MAX_SCANS = 256
"""More scans are taken for damage: encoders write about ten."""
RIGHT = "copy or export it again"


def read_jpeg(path: Path, data: bytes) -> NDArray[np.generic]:
    """Decode a JPEG: gray levels, or the luma Y′ that a colour picture is stored as; upright, shape (rows, columns).

    Raises
    ------
    InputError
        If the file is no JPEG, damaged or cut short, or if it is of a kind that is not read: 12 bits, CMYK, lossless
        or arithmetic coding.
    """
    if not data.startswith(b"\xff\xd8\xff"):
        raise InputError(path, "not a JPEG, whatever its name says", "name it by its content, or export it again")
    orientation, framed = 1, False
    for marker, segment in _headers(path, data):
        if marker in FRAMES:
            _check_frame(path, marker, segment)
            framed = True
        elif marker == APP1 and segment.startswith(EXIF):
            orientation = exif_orientation(segment[len(EXIF) :], path)
        elif marker == APP14 and segment.startswith(ADOBE):
            kind = int.from_bytes(segment[11:12])
            if kind not in ADOBE_KINDS:
                raise InputError(path, f"damaged: colours of an unknown kind ({kind})", RIGHT)
    if not framed or data.count(bytes((0xFF, SOS))) > MAX_SCANS:
        raise InputError(path, "damaged: no frame header, or too many scans", RIGHT)
    try:
        image = simplejpeg.decode_jpeg(data, "GRAY", strict=True)[..., 0]
    except ValueError as error:
        raise InputError(path, f"cut short or damaged ({error})", RIGHT) from error
    return upright(image, orientation, path)


def _headers(path: Path, data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the marker and the content of each segment before the first scan."""
    at = 2
    while True:
        while data[at : at + 2] == b"\xff\xff":  # fill bytes
            at += 1
        size = int.from_bytes(data[at + 2 : at + 4])
        if data[at : at + 1] != b"\xff" or size < 2 or at + 2 + size > len(data):
            raise InputError(path, f"cut short or damaged: no whole segment at byte {at}", RIGHT)
        marker = data[at + 1]
        if marker == SOS:
            return
        yield marker, data[at + 4 : at + 2 + size]
        at += 2 + size


def _check_frame(path: Path, marker: int, segment: bytes) -> None:
    """Refuse what a frame header (T.81, B.2.2) states that is not read, before memory is taken for it."""
    if marker not in READ:
        found = f"a lossless, hierarchical or arithmetic-coded JPEG (marker FF{marker:X})"
        raise InputError(path, found, "export as baseline JPEG, PNG or TIFF")
    if len(segment) < 6:
        raise InputError(path, "damaged: a frame header of the wrong size", RIGHT)
    bits, rows, columns, count = segment[0], int.from_bytes(segment[1:3]), int.from_bytes(segment[3:5]), segment[5]
    if bits != 8:
        raise InputError(path, f"JPEG of {bits} bits a sample", "export as JPEG of 8 bits, or as PNG or TIFF of 16")
    if count not in (1, 3):
        kind = " (CMYK)" if count == 4 else ""
        raise InputError(path, f"JPEG of {count} colour components{kind}", "export in gray or RGB")
    check_size(rows, columns, path)
