"""XML headers that camera software writes beside or before the pixels."""

import xml.etree.ElementTree as ET
from pathlib import Path

from pipeline.errors import InputError

MAX_BYTES = 1 << 26
"""Longer headers are taken for something else; a PCC header holds about 150 bytes a frame."""


def parse_header(path: Path, root: str) -> ET.Element | None:
    """Return the element `root` of a file that may hold bytes before and after it; None if there is none.

    Raises
    ------
    InputError
        If the file cannot be read, or the element is cut short or damaged.
    """
    right = "copy it again from the camera's computer"
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", right) from None
    start, end = data.find(b"<%s>" % root.encode()), data.rfind(b"</%s>" % root.encode())
    if start < 0:
        return None
    if end < start:
        raise InputError(path, f"cut short: no end of <{root}>", right)
    try:
        return ET.fromstring(data[start : end + len(root) + 3])
    except ET.ParseError as error:
        raise InputError(path, f"a damaged header ({error})", right) from None
