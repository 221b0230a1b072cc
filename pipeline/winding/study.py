"""Winding files: a name, cases that share a scene, and parameters varied about a case, checked and in SI."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from models.winding.scene import WindingScene
from pipeline.errors import InputError, refuse_unknown
from pipeline.ingest.layouts import load_layout
from pipeline.ingest.tension import read_tension
from pipeline.keys import read_toml, validated
from pipeline.records import RawTension
from pipeline.winding.keys import LogKeys, VaryKeys, WindCaseKeys, WindFileKeys, WindKeys, written

_FILE = "give a winding file, like data_samples/winding/*.toml"


@dataclass(frozen=True, slots=True)
class Variant:
    """What sets a variant apart from its case."""

    group: VaryKeys
    value: Any

    @property
    def label(self) -> str:
        """'element_mm = 4'."""
        return f"{self.group.parameter} = {written(self.value)}"


@dataclass(frozen=True, slots=True)
class MeasuredLog:
    """A measured tension of a case."""

    raw: RawTension
    start: float
    """Time of the log [s] at which the winding starts."""


@dataclass(frozen=True, slots=True)
class WindingCase:
    """One scene to wind, as written and in SI."""

    name: str
    """Of the case that it is, or that it is a variant of."""
    keys: WindCaseKeys
    scene: WindingScene
    log: MeasuredLog | None = None
    variant: Variant | None = None

    @property
    def label(self) -> str:
        """Name, with what is varied."""
        return f"{self.name}, {self.variant.label}" if self.variant else self.name


@dataclass(frozen=True, slots=True)
class WindingStudy:
    """A winding file, checked."""

    name: str
    title: str
    path: Path
    source: str
    notes: tuple[str, ...]
    cases: tuple[WindingCase, ...]
    """The cases as given, then their variants."""
    package_case: str


def load_winding(file: Path, *, only: str | None = None, mode: str | None = None) -> WindingStudy:
    """Read and check a winding file and the logs that it names.

    Parameters
    ----------
    only : the one case to keep, with its variants.
    mode : goes before the modes in the file.

    Raises
    ------
    InputError
        If it is missing or not TOML, a key, case or parameter is unknown, missing, double or of the wrong kind, a scene
        has no meaning, or a log cannot be read.
    """
    keys = validated(WindFileKeys, read_toml(file, _FILE), file)
    for key in keys.scene:
        refuse_unknown(f"{file}: [scene]", "key", key, list(WindKeys.model_fields))
    cases: dict[str, WindingCase] = {}
    given: dict[str, dict[str, Any]] = {}
    for number, table in enumerate(keys.cases, 1):
        merged = {**keys.scene, **table} | ({"mode": mode} if mode else {})
        case = _case(file, merged, f"{file}: [[cases]] number {number}")
        if case.name in cases:
            raise InputError(file, f"the case '{case.name}' is named twice", "name each once")
        cases[case.name], given[case.name] = case, merged
    names = list(cases)
    package_case = keys.package_case or names[-1]
    refuse_unknown(file, "package_case", package_case, names)
    if only is not None:
        refuse_unknown("--case", "case", only, names)
    variants = [
        _variant(file, group, value, given[group.case])
        for group in _groups(file, keys, names)
        for value in group.values
        if only in (None, group.case)
    ]
    chosen = [case for case in cases.values() if only in (None, case.name)]
    return WindingStudy(
        name=keys.name,
        title=keys.title,
        path=file,
        source=keys.source,
        notes=keys.notes,
        cases=(*chosen, *variants),
        package_case=only or package_case,
    )


def _groups(file: Path, keys: WindFileKeys, cases: list[str]) -> tuple[VaryKeys, ...]:
    known = [key for key in WindKeys.model_fields if key != "drum_rpm"]
    for number, group in enumerate(keys.vary, 1):
        where = f"{file}: [[vary]] number {number}"
        refuse_unknown(where, "case", group.case, cases)
        refuse_unknown(where, "parameter", group.parameter, known)
        for value in group.values:
            if group.values.count(value) > 1:
                raise InputError(where, f"{value} is given twice", "give each value once")
        if any(group is not other and (group.case, group.parameter) == (other.case, other.parameter)
               for other in keys.vary[: number - 1]):  # fmt: skip
            raise InputError(where, f"'{group.parameter}' of '{group.case}' is varied twice", "put its values together")
    return keys.vary


def _case(file: Path, given: dict[str, Any], where: str, variant: Variant | None = None) -> WindingCase:
    keys = validated(WindCaseKeys, given, where)
    try:
        scene = keys.scene()
    except ValueError as error:
        raise InputError(where, *str(error).split(": ", 1)) from None
    return WindingCase(keys.name, keys, scene, _log(file, where, keys.log) if keys.log else None, variant)


def _variant(file: Path, group: VaryKeys, value: Any, given: dict[str, Any]) -> WindingCase:
    variant = Variant(group, value)
    where = f"{file}: case '{group.case}', {variant.label}"
    return _case(file, {**given, group.parameter: value}, where, variant)


def _log(file: Path, where: str, keys: LogKeys) -> MeasuredLog:
    path = file.parent / keys.file
    if not path.is_file():
        raise InputError(f"{where}, log", f"'{keys.file}' is not there", "name the log relative to this file")
    return read_log(path, keys.profile, root=file.parent, channel=keys.channel, start=keys.start_s)


def read_log(
    path: Path, profile: str, *, root: Path | None = None, channel: str | None = None, start: float = 0.0
) -> MeasuredLog:
    """Read a tension log by a layout, a packaged one or one beside the log.

    Raises
    ------
    InputError
        As `pipeline.ingest.tension.read_tension`.
    """
    layout = load_layout(profile, root if root is not None else path.parent)
    return MeasuredLog(read_tension(path, layout, root=root, channel=channel), start)


def with_logs(study: WindingStudy, given: Sequence[str], profile: str) -> WindingStudy:
    """The study with the logs of the command line in place of those of the file.

    Parameters
    ----------
    given : each 'CASE=FILE', or 'FILE' where the study has one case.
    profile : the layout that reads them all.

    Raises
    ------
    InputError
        If a case is unknown or named twice, or a log cannot be read.
    """
    names = [case.name for case in study.cases if case.variant is None]
    logs: dict[str, MeasuredLog] = {}
    for text in given:
        name, _, file = text.rpartition("=")
        if not name and len(names) > 1:
            raise InputError("--log", f"'{text}' names no case of {len(names)}", "give CASE=FILE, or --case")
        name = name or names[0]
        refuse_unknown("--log", "case", name, names)
        if name in logs:
            raise InputError("--log", f"two logs for the case '{name}'", "give one for each case")
        logs[name] = read_log(Path(file), profile)
    cases = tuple(replace(case, log=logs.get(case.name, case.log)) for case in study.cases)
    return replace(study, cases=cases)
