"""Logs that LabVIEW wrote: measurement files in text (.lvm), and TDMS files.

.lvm: a header of ``key, value`` lines names the separator and the decimal mark; a second one, of the one block of data,
holds a field per channel: ``Y_Unit_Label``, ``X0``, ``Delta_X``. Then come the column names, the first is ``X_Value``,
and the rows; a last column ``Comment`` is there where somebody commented (National Instruments, "Specification for the
LabVIEW measurement file", 2009). Without X columns the places of X are left empty.

TDMS: channels in groups, each with properties; ``wf_start_offset`` and ``wf_increment`` space the samples of a
waveform, ``unit_string`` or ``NI_UnitDescription`` is its unit (National Instruments, "TDMS file format internal
structure"). npTDMS decodes it, applies the scales that the file holds, and turns stamps since 1904 into dates.
"""

import logging
import math
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from nptdms import TdmsFile
from nptdms.log import log_manager

from pipeline.errors import InputError, nearest
from pipeline.ingest.layouts import Layout
from pipeline.ingest.log_text import LogText, as_text, plain_text

_END = "***End_of_Header***"
_X, _COMMENT = "X_Value", "Comment"
_TDMS = b"TDSm"

log_manager.set_level(logging.ERROR)  # else npTDMS writes what is damaged, byte by byte, to the user's screen


def lvm_text(path: Path, layout: Layout, wanted: str) -> LogText:
    """Read a measurement file in text; its lines keep their numbers.

    Parameters
    ----------
    path : the file.
    layout : says the encoding; delimiter and decimal mark are those that the file states.
    wanted : the channel whose unit and spacing count.

    Raises
    ------
    pipeline.errors.InputError
        If it is no such file, holds several blocks of data or X columns, or does not say how samples are spaced.
    """
    lines = plain_text(path, layout).text.split("\n")
    if not lines[0].startswith("LabVIEW Measurement"):
        raise InputError(f"{path} line 1", "no 'LabVIEW Measurement'", "give a measurement file in text (.lvm)")
    separator = next((line[9:10] for line in lines if line.startswith("Separator")), "") or "\t"
    rows = [line.split(separator) for line in lines]
    ends = [index for index, row in enumerate(rows) if row[0] == _END]
    if len(ends) < 2 or len(rows) <= ends[1] + 1:
        raise InputError(path, f"{len(ends)} lines {_END} and no data after them", "give a log with samples")
    if len(ends) > 2:
        found = f"{len(ends) - 1} blocks of data"
        raise InputError(f"{path} line {ends[2] + 1}", found, "save each recording as a file of its own")
    first = ends[1] + 2
    names = rows[first - 1]
    if names[0] != _X:
        raise InputError(f"{path} line {first}", f"'{names[0]}'", f"the column names begin with {_X}")
    names = names[: names.index(_COMMENT)] if _COMMENT in names else names
    about = {row[0]: row[1] for row in rows[: ends[0]] if len(row) > 1}
    columns = {row[0]: (index + 1, row) for index, row in enumerate(rows[: ends[1]]) if index > ends[0]}
    if about.get("X_Columns") == "Multi":
        raise InputError(path, "each channel has X values of its own", "save it with one X column, or none")
    column = names.index(wanted) if wanted in names else 0
    mark = about.get("Decimal_Separator", ".")
    if mark not in (".", ","):
        raise InputError(path, f"Decimal_Separator is '{mark}'", "it should be '.' or ','")
    start, step = (
        (_spacing(path, columns, key, column, mark) for key in ("X0", "Delta_X"))
        if about.get("X_Columns") == "No" and column
        else (0.0, 0.0)
    )

    table = [*lines[: first - 1], separator.join(names)]
    count = 0
    for row in rows[first:]:
        fields = row[: len(names)]
        if step and any(fields):
            fields[0] = repr(start + count * step).replace(".", mark)
            count += 1
        table.append(separator.join(fields))
    _, units = columns.get("Y_Unit_Label", (0, []))
    unit = units[column] if 0 < column < len(units) else ""
    return LogText("\n".join(table), layout.model_copy(update={"delimiter": separator, "decimal": mark}), unit)


def _spacing(path: Path, columns: dict[str, tuple[int, list[str]]], key: str, column: int, mark: str) -> float:
    """The number that a header line holds for a column; a step must be above 0."""
    line, row = columns.get(key, (0, []))
    text = row[column] if column < len(row) else ""
    try:
        value = float(text.replace(mark, "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or (key == "Delta_X" and value <= 0):
        where = f"{path} line {line}" if line else path
        raise InputError(where, f"{key} is '{text}'", "a file without X column says with it how samples are spaced")
    return value


def tdms_text(path: Path, layout: Layout, wanted: str) -> LogText:
    """Read a channel of a TDMS file, and its time: a channel named as the layout says, else from its spacing.

    Parameters
    ----------
    path : the file.
    layout : says the group, the time channel, and how the table is to be written.
    wanted : the channel.

    Raises
    ------
    pipeline.errors.InputError
        If it cannot be read, has no such channel or several, or does not say how samples are spaced.
    """
    right = "give a whole TDMS file"
    try:
        with path.open("rb") as stream:
            if stream.read(len(_TDMS)) != _TDMS:
                raise InputError(path, "it is no TDMS file: the first bytes are others", right)
            stream.seek(0)
            file = TdmsFile.open(stream)
            channel, times = _channels(path, file, layout, wanted)
            for one in (channel, times):
                if one is not None and len(one) > path.stat().st_size:  # a damaged header: spare the memory
                    raise InputError(path, f"it promises {len(one)} samples, more than it has bytes", right)
            values = channel[:]
            time = None if times is None else times[:]
            about: dict[str, Any] = {**file.properties, **channel.properties}
            if file.file_status.incomplete_final_segment:
                about["incomplete"] = "the file was cut off, or not closed by the program that wrote it"
    except InputError:
        raise
    except Exception as error:  # whatever damaged bytes lead npTDMS to
        why = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(path, f"it cannot be read as TDMS ({why})", right) from None
    if not len(values):
        raise InputError(f"{path} channel '{wanted}'", "it has no samples", "give a log with at least one sample")
    columns = {"": [str(index) for index in range(len(values))], wanted: _fields(values, layout)}  # no row is blank
    if time is not None:
        if len(time) != len(values):
            found = f"{len(time)} samples, '{wanted}' has {len(values)}"
            right = f"set time_column to the time of '{wanted}'"
            raise InputError(f"{path} channel '{layout.time_column}'", found, right)
        columns = {layout.time_column: _fields(time, layout), **columns}
    elif layout.time_column:
        step, start = _number(about.get("wf_increment")), _number(about.get("wf_start_offset", 0.0))
        if not (0 < step < math.inf and math.isfinite(start)):
            found = f"no channel '{layout.time_column}', and wf_increment is {about.get('wf_increment')}"
            right = "set time_column to the channel that holds the time, or rate_Hz"
            raise InputError(f"{path} channel '{wanted}'", found, right)
        columns = {layout.time_column: _fields(start + step * np.arange(len(values)), layout), **columns}
    unit = str(about.get("unit_string") or about.get("NI_UnitDescription") or "")
    text = as_text((columns, *zip(*columns.values(), strict=True)), layout)
    return LogText(text, layout, unit, {key: str(value) for key, value in about.items() if str(value)})


def _channels(path: Path, file: Any, layout: Layout, wanted: str) -> tuple[Any, Any]:
    """The wanted channel, and the one that holds its time (None where there is none)."""
    groups: dict[str, Any] = {group.name: group for group in file.groups()}
    if layout.table and layout.table not in groups:
        raise InputError(path, f"no group '{layout.table}'", nearest(layout.table, [*groups]))
    chosen = [layout.table] if layout.table else [*groups]
    channels = {name: {one.name: one for one in groups[name].channels()} for name in chosen}
    having = [name for name, among in channels.items() if wanted in among]
    if not having:
        known = sorted({name for among in channels.values() for name in among})
        right = nearest(wanted, known) if known else "give a file with channels"
        raise InputError(path, f"no channel '{wanted}'", right)
    if len(having) > 1:
        found = f"a channel '{wanted}' in each of the groups {', '.join(map(repr, having))}"
        raise InputError(path, found, "set table to one of them in the layout")
    among = channels[having[0]]
    return among[wanted], among.get(layout.time_column) if layout.time_column else None


def _number(value: Any) -> float:
    return float(value) if isinstance(value, Real) else math.nan


def _fields(values: Any, layout: Layout) -> list[str]:
    """Numbers as text that gives them back exactly, times as ISO 8601; empty where there is none."""
    if np.issubdtype(values.dtype, np.datetime64):
        return [str(value) for value in values]
    if np.issubdtype(values.dtype, np.floating):
        return ["" if math.isnan(value) else repr(value).replace(".", layout.decimal) for value in values.tolist()]
    return [str(value) for value in values.tolist()]
