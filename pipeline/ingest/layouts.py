"""Layouts of tension logs: a few lines of TOML that say how a file is to be read.

Nothing is sniffed and nothing about units is assumed: the layout decides, and its name is stored with the result.
A new layout is a TOML file with the keys of `Layout`, for example ::

    note = "Meter X, export of its PC program 3.1"
    encoding = "cp1252"
    delimiter = ";"
    decimal = ","
    time_column = "Zeit [s]"
    tension_column = "Kraft [cN]"
    unit = "cN"
    full_scale_cN = 100
    resolution_cN = 0.1
    missing = ["---"]

or a packaged one with some keys changed (``base`` takes the packaged one's keys; ``verified`` is not inherited) ::

    base = "eltex-th"
    tension_column = "Sensor 3"
    full_scale_cN = 50
"""

import codecs
import tomllib
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, model_validator

from pipeline.errors import InputError, nearest

NEWTONS = {"cN": 1e-2, "N": 1.0, "mN": 1e-3, "gf": 9.80665e-3, "g": 9.80665e-3, "kgf": 9.80665, "Newtons": 1.0}
"""Newtons per unit of tension. Standard gravity is 9.80665 m/s² exactly (CGPM 1901), so 1 gf = 0.980665 cN; a meter
that shows "g" means gf."""

_PACKAGED = resources.files("pipeline.ingest") / "layouts"

Names = Annotated[tuple[str, ...], Strict(False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


def newtons_per(unit: str, where: str) -> float:
    """Newtons per unit of tension, the unit given by name with or without brackets, as in ``[cN]``.

    Raises
    ------
    pipeline.errors.InputError
        If the unit is not known; the message lists the known ones.
    """
    try:
        return NEWTONS[unit.strip().strip("[]()").strip()]
    except KeyError:
        known = ", ".join(NEWTONS)
        raise InputError(where, f"'{unit}' is not a known unit of tension", f"known: {known}") from None


class Layout(BaseModel):
    """How a tension log is laid out. Needed: `decimal`, `time_column` or `rate_Hz`, `tension_column`, and a unit."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    name: str
    """Packaged name, or the TOML file; set by `load_layout`, not a key of the file."""
    note: str = ""
    """Which instrument and program wrote such files, and where the description comes from."""
    verified: bool = False
    """Whether the layout was checked against a real file of that instrument."""

    format: Literal["text", "lvm", "tdms", "xlsx"] = "text"
    """What the file is: a table of text, LabVIEW's measurement file in text (which states its own delimiter and decimal
    mark) or its TDMS file, or an Excel workbook. The last two are turned into a table of text."""
    table: str = ""
    """The group of channels (tdms) or the sheet (xlsx) that holds the columns; empty where only one can be meant."""
    encoding: str = "utf-8-sig"
    """Python's name of the text encoding; ``utf-8-sig`` reads UTF-8 with and without a byte-order mark."""
    delimiter: str = Field(default=",", min_length=1, max_length=1)
    """The one character between fields (``"\\t"`` for a tab)."""
    decimal: Literal[".", ","]
    """Decimal mark. Thousands separators are never read."""

    columns: Names = ()
    """Column names of a file without a header row; empty where the file has one."""
    skip_lines: int | None = Field(default=None, ge=0)
    """Lines before the header row (or before the data, with `columns`). Not given: the header row is the first line
    that has the time column and the tension column among its fields."""
    units_row: bool = False
    """Whether the line after the header row holds units; with `unit` given too, the two must agree."""

    time_column: str = ""
    """Name of the time column; empty where there is none and `rate_Hz` spaces the samples."""
    time_kind: Literal["seconds", "milliseconds", "excel-days", "datetime"] = "seconds"
    """What the time column holds; ``excel-days`` are serial days with a fraction, ``datetime`` is a wall clock."""
    time_format: str = "ISO8601"
    """strptime format of a ``datetime`` column, such as ``"%d.%m.%Y %H:%M:%S,%f"``."""
    rate_Hz: Positive | None = None
    """Sampling rate of a file without a time column."""

    tension_column: str
    """Name of the tension column; a call may choose another channel."""
    unit: str = ""
    """Unit of the tension column: cN, N, mN, gf, g or kgf. Not given: it must come from `units_row`, `unit_column` or
    `count_full_scale`, or from the file itself (lvm, tdms)."""
    unit_column: str = ""
    """Name of a column that holds each row's unit."""
    count_full_scale: Positive | None = None
    """Raw count that stands for `full_scale_cN`, where the file holds counts (zero stands for 0 cN)."""
    full_scale_cN: Positive | None = None
    """Range of the instrument [cN]: readings at or above it are saturated."""
    resolution_cN: Positive | None = None
    """Step of the instrument [cN]; one count where the file holds counts and nothing is given."""
    calibration_u_percent: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Relative standard uncertainty (k = 1) of the calibration [%]."""

    missing: Names = ()
    """Texts in the tension column that mean "no reading", such as ``"---"``. An empty field always means that."""
    overload: Names = ()
    """Texts in the tension column that mean "above full scale", such as ``"OVERLOAD"``."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        try:
            codecs.lookup(self.encoding)
        except LookupError:
            raise ValueError(
                f"encoding = '{self.encoding}' is not known; try 'utf-8-sig', 'cp1252' or 'utf-16'"
            ) from None
        if self.delimiter == self.decimal:
            raise ValueError("delimiter and decimal are the same character; give two different ones")
        if bool(self.time_column) == (self.rate_Hz is not None):
            raise ValueError("time must come from one place; give either time_column or rate_Hz")
        if self.unit:
            newtons_per(self.unit, f"layout {self.name} key 'unit'")
        if self.table and self.format in ("text", "lvm"):
            raise ValueError(f"table = '{self.table}', but a {self.format} log has one; leave it out")
        places = [bool(self.unit) or self.units_row, bool(self.unit_column), self.count_full_scale is not None]
        if sum(places) > 1 or not (any(places) or self.format in ("lvm", "tdms")):
            raise ValueError(
                "the unit must come from one place; give unit (or units_row), unit_column or count_full_scale"
            )
        if self.columns:
            for key in ("time_column", "tension_column", "unit_column"):
                name = getattr(self, key)
                if name and name not in self.columns:
                    raise ValueError(f"{key} = '{name}' is not among columns; {nearest(name, list(self.columns))}")
            if self.units_row:
                raise ValueError("units_row follows a header row, but columns says there is none; give one of them")
        return self


def packaged_layouts() -> list[str]:
    """Names of the packaged layouts, sorted."""
    return sorted(entry.name.removesuffix(".toml") for entry in _PACKAGED.iterdir() if entry.name.endswith(".toml"))


def load_layout(name_or_path: str, root: Path) -> Layout:
    """Read a layout: a packaged one by its name, or a TOML file.

    Parameters
    ----------
    name_or_path : packaged name, or path of a ``.toml`` file relative to `root`.
    root : folder of the study, or the working directory.

    Raises
    ------
    pipeline.errors.InputError
        If there is no such layout, or a key or value in it is wrong.
    """
    known = packaged_layouts()
    if name_or_path in known:
        return _layout(name_or_path, _packaged(name_or_path), f"layout {name_or_path}")
    if not name_or_path.endswith(".toml"):
        listed = ", ".join(known)
        raise InputError(f"layout '{name_or_path}'", "no such layout", f"give a .toml file or one of: {listed}")
    path = root / name_or_path
    try:
        keys = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "give an existing layout file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, f"not a TOML file in UTF-8 ({error})", "write `key = value` lines") from None
    base = keys.pop("base", None)
    if base is not None:
        if base not in known:
            raise InputError(f"{path} key 'base'", f"'{base}' is not a packaged layout", nearest(str(base), known))
        keys = {key: value for key, value in _packaged(base).items() if key not in ("note", "verified")} | keys
    return _layout(name_or_path, keys, str(path))


def _packaged(name: str) -> dict[str, object]:
    return tomllib.loads((_PACKAGED / f"{name}.toml").read_text(encoding="utf-8"))


def _layout(name: str, keys: dict[str, object], where: str) -> Layout:
    allowed = [*Layout.model_fields, "base"]
    allowed.remove("name")
    for key in keys:
        if key not in allowed:
            raise InputError(f"{where} key '{key}'", "unknown key", nearest(key, allowed))
    try:
        return Layout.model_validate({"name": name, **keys})
    except ValidationError as error:
        first = error.errors()[0]
        if first["type"] == "value_error":
            found, _, right = first["msg"].removeprefix("Value error, ").partition("; ")
            raise InputError(where, found, right) from None
        key = ".".join(str(part) for part in first["loc"])
        found = "is missing" if first["type"] == "missing" else f"is {first['input']!r}"
        raise InputError(f"{where} key '{key}'", found, first["msg"].replace("Input should", "it should")) from None
