"""Tension logs read as a layout says, every number held against it, flagged and never altered."""

import csv
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pipeline.errors import InputError, nearest
from pipeline.ingest.labview import lvm_text, tdms_text
from pipeline.ingest.layouts import NEWTONS, Layout, newtons_per
from pipeline.ingest.log_text import LogText, plain_text
from pipeline.ingest.source import source
from pipeline.ingest.tension_flags import flag_tension
from pipeline.ingest.workbook import workbook_text
from pipeline.records import Array, RawTension, TensionFlag

_SECONDS = {"seconds": 1.0, "milliseconds": 1e-3, "excel-days": 86400.0}
_READERS: dict[str, Callable[[Path, Layout, str], LogText]] = {
    "text": lambda path, layout, _: plain_text(path, layout),
    "lvm": lvm_text,
    "tdms": tdms_text,
    "xlsx": lambda path, layout, _: workbook_text(path, layout),
}


def read_tension(path: Path, layout: Layout, *, root: Path | None = None, channel: str | None = None) -> RawTension:
    """Read a tension log.

    Time counts from the first row. A last line that was cut off (a truncated file) is kept and flagged MISSING; if its
    time stamp was cut too, one sampling interval after the row above stands for it. Blank lines are skipped. The lines
    before the header go to `metadata` as ``key: value`` pairs.

    Parameters
    ----------
    path : the log.
    layout : how it is laid out.
    root : folder that the file's name is given relative to.
    channel : name of the tension column, where not the layout's.

    Raises
    ------
    pipeline.errors.InputError
        If the file is empty, in another encoding, without the header, columns, unit or range that the layout needs,
        holds text where a number belongs, or holds no reading at all. Nothing is guessed around.
    """
    origin = source(path, root)
    wanted = channel or layout.tension_column
    as_text = _READERS[layout.format](path, layout, wanted)
    layout = as_text.layout
    log = _Log(path, layout, wanted, as_text.text.split("\n"), as_text.unit)
    header, header_line = _header(log)
    table = _split(log, header, header_line + 1 + layout.units_row)

    readings, overload = _readings(log, table)
    if np.isnan(readings).all():
        raise InputError(f"{path} column '{log.wanted}'", "no reading in any row", "give a log with readings")
    factor, unit_in_file = _unit(log, table, readings, header, header_line)
    tension = readings * factor
    if layout.rate_Hz is None:
        time, metadata = _time(log, table)
    else:
        time, metadata = np.arange(len(table.lines)) / layout.rate_Hz, {}

    resolution = _resolution(layout)
    full_scale = math.nan if layout.full_scale_cN is None else layout.full_scale_cN / 100
    flag = flag_tension(time, tension, resolution=resolution, full_scale=full_scale)
    flag[overload] ^= np.uint16(TensionFlag.MISSING | TensionFlag.SATURATED)
    percent = layout.calibration_u_percent
    preamble = log.lines[: header_line if layout.columns else header_line - 1]
    return RawTension(
        source=origin,
        layout=layout.name,
        unit_in_file=unit_in_file,
        time=time,
        tension=tension,
        flag=flag,
        resolution=resolution,
        calibration_u=math.nan if percent is None else percent / 100,
        metadata={**_pairs(preamble, layout), **as_text.metadata, **metadata, "channel": log.wanted},
    )


@dataclass(frozen=True)
class _Log:
    """A log as text: what it is read as, which column is wanted, its lines without line ends."""

    path: Path
    layout: Layout
    wanted: str
    lines: list[str]
    unit: str
    """Of the wanted column, where the file states it elsewhere than in the table."""


@dataclass(frozen=True)
class _Table:
    """The columns that are needed, as text, and the line that each row stands on."""

    lines: list[int]
    cells: Mapping[str, list[str]]
    cut: frozenset[str]
    """Columns whose field in the last row is lost, or may have been cut short, by a truncation of the file."""


def _fields(line: str, layout: Layout) -> list[str]:
    """Fields of a line before the data; one that csv refuses (a binary file) is one field."""
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=layout.delimiter), [])]
    except csv.Error:
        return [line]


def _header(log: _Log) -> tuple[list[str], int]:
    """Column names, and the number of the line they stand on (of the line before the data where there is none)."""
    path, layout, lines = log.path, log.layout, log.lines
    needed = [name for name in (layout.time_column, log.wanted, layout.unit_column) if name]
    number = layout.skip_lines or 0
    if layout.columns:
        header = list(layout.columns)
    elif layout.skip_lines is None:
        header, number = _find_header(log, needed)
    elif number < len(lines):
        number += 1
        header = _fields(lines[number - 1], layout)
    else:
        raise InputError(path, f"the file has {len(lines)} lines", f"the layout puts the header on line {number + 1}")
    while header and not header[-1]:
        header.pop()
    for name in needed:
        if name not in header:
            right = nearest(name, [field for field in header if field])
            raise InputError(f"{path} line {number}", f"no column '{name}'", right)
        if header.count(name) > 1:
            found = f"{header.count(name)} columns '{name}'"
            raise InputError(f"{path} line {number}", found, "give each column its own name")
    return header, number


def _find_header(log: _Log, needed: list[str]) -> tuple[list[str], int]:
    """Find the first line with all the needed names, failing that the one with most of them (to be refused by name)."""
    best: tuple[int, list[str], int] = (0, [], 0)
    for number, line in enumerate(log.lines, start=1):
        if any(name in line for name in needed):
            fields = _fields(line, log.layout)
            hits = sum(name in fields for name in needed)
            if hits > best[0]:
                best = (hits, fields, number)
            if hits == len(needed):
                break
    if best[0]:
        return best[1], best[2]
    names = " and ".join(f"'{name}'" for name in needed)
    fields = max((_fields(line, log.layout) for line in log.lines[:200]), key=len)
    found = f"no header row with {names} in {len(log.lines)} lines split at '{log.layout.delimiter}'"
    right = (
        f"check the layout's delimiter and column names ({nearest(needed[-1], [field for field in fields if field])})"
    )
    raise InputError(log.path, found, right)


def _split(log: _Log, header: list[str], first: int) -> _Table:
    """Split the data from line `first` on into the needed columns; blank lines are left out.

    Not done with pandas.read_csv: it fills up short lines and takes surplus fields for an index, both silently.
    """
    path, layout, lines = log.path, log.layout, log.lines
    needed = {name: header.index(name) for name in (layout.time_column, log.wanted, layout.unit_column) if name}
    width = len(header)
    numbers: list[int] = []
    cells: dict[str, list[str]] = {name: [] for name in needed}
    short = 0
    number, fields = first - 1, list[str]()
    reader = csv.reader(lines[first - 1 :], delimiter=layout.delimiter)
    for row in _rows(log, reader):
        number, before = first + reader.line_num - 1, number
        if not any(field.strip() for field in row):
            continue
        if short:
            found = f"{len(fields)} fields, the header has {width}"
            raise InputError(f"{path} line {short}", found, "complete or remove this line")
        if number > before + 1:
            raise InputError(
                f"{path} line {before + 1}", "a quote is opened and not closed", "close it on the same line"
            )
        fields = row
        if any(row[width:]):
            hint = "is ',' the decimal mark here too?" if layout.delimiter == "," else "check the delimiter"
            raise InputError(f"{path} line {number}", f"{len(row)} fields, the header has {width}", hint)
        short = number if len(row) < width else 0
        numbers.append(number)
        for name, column in needed.items():
            cells[name].append(row[column].strip() if column < len(row) else "")
    if not numbers:
        raise InputError(path, f"no data after line {first - 1}", "give a log with at least one sample")
    if short:
        cut = {*header[len(fields) - 1 :], log.wanted}
    elif numbers[-1] == len(lines) and _looks_cut(cells.get(header[-1], []), layout):
        cut = {header[-1]}
    else:
        cut = set[str]()
    return _Table(numbers, cells, frozenset(cut))


def _rows(log: _Log, reader: Iterable[list[str]]) -> Iterator[list[str]]:
    try:
        yield from reader
    except csv.Error as error:
        raise InputError(log.path, f"cannot be split into fields ({error})", "check quotes and delimiter") from None


def _looks_cut(cells: list[str], layout: Layout) -> bool:
    """Whether a last field without a line end after it is no number or has fewer decimals than the one above."""
    if len(cells) < 2 or cells[-1] in (*layout.missing, *layout.overload):
        return False
    above, last = (len(cell.partition(layout.decimal)[2]) for cell in cells[-2:])
    return last < above or not _number(layout.decimal).fullmatch(cells[-1])


def _number(decimal: str) -> re.Pattern[str]:
    mark = re.escape(decimal)
    return re.compile(rf"[+-]?(?:[0-9]+(?:{mark}[0-9]*)?|{mark}[0-9]+)(?:[eE][+-]?[0-9]+)?")


def _numbers(log: _Log, table: _Table, name: str, rows: Sequence[int]) -> Array:
    """The numbers in some rows of a column; anything else is refused by line, column and text."""
    cells, mark = table.cells[name], log.layout.decimal
    number = _number(mark)
    values = np.empty(len(rows))
    for index, row in enumerate(rows):
        value = float(cells[row].replace(mark, ".")) if number.fullmatch(cells[row]) else math.nan
        if not math.isfinite(value):  # also a number too large for a float
            _refuse_number(log, table, name, row)
        values[index] = value
    return values


def _refuse_number(log: _Log, table: _Table, name: str, row: int) -> NoReturn:
    text, mark = table.cells[name][row], log.layout.decimal
    other = "," if mark == "." else "."
    if _number(other).fullmatch(text):
        right = f"the layout says decimal = '{mark}', did you mean '{other}'?"
    elif re.fullmatch(r"[+-]?[0-9]+([., '][0-9]{3})*[.,][0-9]+", text):
        right = "thousands separators are not read: export the log without them"
    elif name == log.layout.time_column:
        right = f"give a number with decimal mark '{mark}', or set time_kind"
    else:
        right = f"give a number with decimal mark '{mark}', or list this text under missing or overload in the layout"
    raise InputError(f"{log.path} line {table.lines[row]} column '{name}'", f"'{text}' is not a number", right)


def _readings(log: _Log, table: _Table) -> tuple[Array, NDArray[np.bool_]]:
    """Readings in the file's unit, NaN where there is none, and where the file says overload."""
    cells = table.cells[log.wanted]
    overload = np.array([cell in log.layout.overload for cell in cells])
    none = {"", *log.layout.missing, *log.layout.overload}
    present = [row for row in range(len(cells) - (log.wanted in table.cut)) if cells[row] not in none]
    readings = np.full(len(cells), np.nan)
    readings[present] = _numbers(log, table, log.wanted, present)
    return readings, overload


def _unit(log: _Log, table: _Table, readings: Array, header: list[str], header_line: int) -> tuple[float | Array, str]:
    """Newtons per number in the file (one factor, or one per row), and the unit's name as it stands there."""
    path, layout, wanted = log.path, log.layout, log.wanted
    if layout.count_full_scale is not None:
        if layout.full_scale_cN is None:
            found = f"it holds counts up to {layout.count_full_scale:g} whose range is not stated"
            right = f'write a layout with base = "{layout.name}" and full_scale_cN = the range of the sensor'
            raise InputError(path, found, right)
        return layout.full_scale_cN / 100 / layout.count_full_scale, "counts"
    if layout.unit_column:
        known: dict[str, float] = {}
        factor = np.full(readings.size, np.nan)
        for row in np.flatnonzero(~np.isnan(readings)):
            unit = table.cells[layout.unit_column][row]
            if unit not in known:
                known[unit] = newtons_per(unit, f"{path} line {table.lines[row]} column '{layout.unit_column}'")
            factor[row] = known[unit]
        return factor, ", ".join(known)
    stated = [(header_line, _unit_in_name(wanted))]
    if layout.units_row:
        units = _fields(log.lines[header_line], layout)
        column = header.index(wanted)
        stated.append((header_line + 1, units[column] if column < len(units) else ""))
    if log.unit:
        stated.append((header_line, log.unit))
    unit = layout.unit or stated[-1][1]
    if not unit:
        raise InputError(f"{path} column '{wanted}'", "the file states no unit", "set the layout's unit")
    factor = newtons_per(unit, f"{path} line {stated[-1][0]} column '{wanted}'")
    for line, other in stated:
        where = f"{path} line {line} column '{wanted}'"
        if other and newtons_per(other, where) != factor:
            raise InputError(where, f"unit '{other}'", f"the layout reads it as '{unit}': change the layout's unit")
    return factor, unit.strip("[]() ")


def _unit_in_name(column: str) -> str:
    """The unit that a column name ends in, as in ``Kraft [cN]`` or ``tension_cN``; empty where there is none."""
    found = re.search(r"[\[(_ ]([A-Za-z]+)[\])]?$", column)
    return found[1] if found and found[1] in NEWTONS else ""


def _time(log: _Log, table: _Table) -> tuple[Array, dict[str, str]]:
    """Time from the first row [s], and the first stamp as it stands in the file."""
    path, layout, name = log.path, log.layout, log.layout.time_column
    cells = table.cells[name]
    whole = len(cells) - (name in table.cut)
    if not whole:
        raise InputError(
            f"{path} line {table.lines[0]}", "the only row is cut off", "give a log with at least one sample"
        )
    if layout.time_kind == "datetime":
        stamps = pd.to_datetime(pd.Series(cells[:whole]), format=layout.time_format, errors="coerce", utc=True)
        if stamps.isna().any():
            row = int(stamps.isna().to_numpy().argmax())
            where = f"{path} line {table.lines[row]} column '{name}'"
            raise InputError(
                where, f"'{cells[row]}' is not such a time", f"the layout says time_format = '{layout.time_format}'"
            )
        time = ((stamps - stamps.iloc[0]) / pd.Timedelta(seconds=1)).to_numpy(np.float64)
    else:
        values = _numbers(log, table, name, range(whole))
        time = (values - values[0]) * _SECONDS[layout.time_kind]
    if whole < len(cells):
        time = np.append(time, time[-1] + (np.median(np.diff(time)) if whole > 1 else 0.0))
    return time, {"first time stamp": cells[0]}


def _resolution(layout: Layout) -> float:
    """Step of the instrument [N]: as stated, else one count of a file of counts, else NaN."""
    if layout.resolution_cN is not None:
        return layout.resolution_cN / 100
    if layout.count_full_scale is not None and layout.full_scale_cN is not None:
        return layout.full_scale_cN / 100 / layout.count_full_scale
    return math.nan


def _pairs(preamble: list[str], layout: Layout) -> dict[str, str]:
    """Pairs in the lines before the header: two fields, or ``key: value``."""
    pairs: dict[str, str] = {}
    for line in preamble:
        fields = [field for field in _fields(line, layout) if field]
        if len(fields) == 1:
            fields = [part.strip() for part in fields[0].split(":", 1)]
        if len(fields) == 2 and fields[0]:
            pairs[fields[0].removeprefix("#").strip().removesuffix(":")] = fields[1]
    return pairs
