"""A tension log as the table of text that `tension.py` reads, whatever file it comes in."""

import codecs
import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.errors import InputError
from pipeline.ingest.layouts import Layout

_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_BINARY = {
    b"PK\x03\x04": ("a workbook", 'base = "excel"'),
    b"\xd0\xcf\x11\xe0": ("a workbook of the old kind (.xls)", 'save it as .xlsx, which base = "excel" reads'),
    b"TDSm": ("a TDMS file", 'base = "labview-tdms"'),
}
"""How files begin that are no text, and what reads them."""


@dataclass(frozen=True, slots=True)
class LogText:
    """A log as a table of text."""

    text: str
    """Lines of fields, ended by ``\\n``."""
    layout: Layout
    """How they are laid out: as the given layout says, but where the file itself says otherwise."""
    unit: str = ""
    """Unit of the wanted column, where the file states it elsewhere than in the table."""
    metadata: Mapping[str, str] = field(default_factory=dict[str, str])
    """What the file says besides the table."""


def plain_text(path: Path, layout: Layout) -> LogText:
    """Decode a text file.

    Raises
    ------
    pipeline.errors.InputError
        If it is empty, no text, or in another encoding than the layout says.
    """
    data = path.read_bytes()
    if not data.strip():
        raise InputError(path, "the file is empty", "give a log with a header and samples")
    for beginning, (kind, right) in _BINARY.items():
        if data.startswith(beginning):
            raise InputError(path, f"it is {kind}, the layout reads text", f"write a layout with {right}")
    for mark, encoding in _MARKS.items():
        if data.startswith(mark) and codecs.lookup(layout.encoding).name != encoding:
            found = f"it starts with the byte-order mark of {encoding}, the layout says {layout.encoding}"
            raise InputError(path, found, f'set encoding = "{encoding}"')
    try:
        # An incremental decoder leaves out a character cut in half at the end: a truncated file is still read.
        text = codecs.getincrementaldecoder(layout.encoding)().decode(data)
    except UnicodeError as error:
        at = error.start if isinstance(error, UnicodeDecodeError) else 0
        line = data[:at].count(b"\n") + 1
        right = 'set the layout\'s encoding, such as "cp1252" or "utf-16"'
        raise InputError(f"{path} line {line}", f"byte 0x{data[at]:02x} is not {layout.encoding}", right) from None
    return LogText(text.replace("\r\n", "\n").replace("\r", "\n"), layout)


def as_text(rows: Iterable[Iterable[str]], layout: Layout) -> str:
    """Write rows of fields as lines; what has line breaks of its own is written on one."""
    text = io.StringIO()
    writer = csv.writer(text, delimiter=layout.delimiter, lineterminator="\n")
    writer.writerows([" ".join(field.splitlines()) for field in row] for row in rows)
    return text.getvalue()
