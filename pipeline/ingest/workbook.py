"""Logs in Excel workbooks (.xlsx): one sheet as a table of text, its rows as lines."""

import datetime
from pathlib import Path
from typing import Any

from openpyxl import load_workbook

from pipeline.errors import InputError, nearest
from pipeline.ingest.layouts import Layout
from pipeline.ingest.log_text import LogText, as_text


def workbook_text(path: Path, layout: Layout) -> LogText:
    """Read the sheet that the layout names, or the only one; formulas count as what was last computed.

    Raises
    ------
    pipeline.errors.InputError
        If it cannot be read, has no such sheet, or several and the layout names none.
    """
    try:
        with path.open("rb") as stream:
            book = load_workbook(stream, read_only=True, data_only=True)
            rows = [_fields(row, layout) for row in _sheet(path, book, layout).iter_rows(values_only=True)]
    except InputError:
        raise
    except Exception as error:  # whatever damaged bytes lead openpyxl, zipfile and the XML parser to
        why = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(path, f"it cannot be read as a workbook ({why})", "give a whole .xlsx file") from None
    width = max(map(len, rows), default=0)
    return LogText(as_text((row + [""] * (width - len(row)) for row in rows), layout), layout)


def _sheet(path: Path, book: Any, layout: Layout) -> Any:
    names: list[str] = [sheet.title for sheet in book.worksheets]
    if layout.table and layout.table not in names:
        raise InputError(path, f"no sheet '{layout.table}'", nearest(layout.table, names))
    if not layout.table and len(names) != 1:
        raise InputError(path, f"{len(names)} sheets: {', '.join(names)}", "set table to one of them in the layout")
    sheet = book[layout.table or names[0]]
    sheet.reset_dimensions()  # some programs write wrong ones, which would cut rows off
    return sheet


def _fields(row: tuple[Any, ...], layout: Layout) -> list[str]:
    return [_field(value, layout) for value in row]


def _field(value: Any, layout: Layout) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return repr(value).replace(".", layout.decimal)
    if isinstance(value, datetime.timedelta):
        return repr(value.total_seconds()).replace(".", layout.decimal)
    if isinstance(value, datetime.datetime | datetime.time):
        return value.isoformat()
    return str(value)
