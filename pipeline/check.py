"""Check: hold errors against bounds, for a CI job; and write them as JUnit XML."""

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from pipeline.atomic import whole_file
from pipeline.errors import InputError
from pipeline.records import Comparison, Quantity


def verdict(row: Comparison) -> str:
    """One line that says what was held against which bound, and whether it holds."""
    name = f"{row.case} {row.quantity.value} {row.model}"
    if math.isnan(row.E_percent):
        found = f"no error to check ({row.outcome}: {row.message})" if row.message else f"no error ({row.outcome})"
    else:
        found = f"error {row.E_percent:.2f} %"
    sign = "within" if row.within else "EXCEEDS"
    line = f"{name}: {found} {sign} bound {row.bound_percent:g} %"
    return f"{line} (exception: {row.bound_reason})" if row.bound_reason else line


def read_errors(report: Path) -> tuple[str, tuple[Comparison, ...]]:
    """The study's name and its comparison rows from `errors.json` of a report folder.

    Raises
    ------
    InputError
        If the file is missing, truncated or not one of ours.
    """
    file = report / "errors.json"
    right = "make the report again with `yarnval report`"
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        rows = [{f.name: row[f.name] for f in fields(Comparison)} for row in document["rows"]]
        return str(document["study"]), tuple(_comparison(row) for row in rows)
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})", right) from None
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(file, f"truncated or not errors.json of a report ({error})", right) from None


def _comparison(row: dict[str, Any]) -> Comparison:
    known: dict[str, Any] = {name: math.nan if value is None else value for name, value in row.items()}
    known |= {"quantity": Quantity(row["quantity"]), "missing_u": tuple(row["missing_u"])}
    return Comparison(**known)


def as_json(row: Comparison) -> dict[str, object]:
    """What was held against which bound, with null where no error is known."""
    return {
        "case": row.case,
        "quantity": row.quantity.value,
        "model": row.model,
        "E_percent": None if math.isnan(row.E_percent) else row.E_percent,
        "bound_percent": row.bound_percent,
        "within": row.within,
        "bound_reason": row.bound_reason,
        "outcome": row.outcome,
        "message": row.message,
    }


def write_junit(studies: Mapping[str, Sequence[Comparison]], file: Path) -> None:
    """Write one test suite per study and one test case per bounded row.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    root = ET.Element("testsuites", name="yarnval check")
    for study, rows in studies.items():
        failures = sum(not row.within for row in rows)
        suite = ET.SubElement(root, "testsuite", name=study, tests=str(len(rows)), failures=str(failures))
        for row in rows:
            name = f"{row.case}.{row.quantity.value}.{row.model}"
            case = ET.SubElement(suite, "testcase", classname=study, name=name)
            if not row.within:
                ET.SubElement(case, "failure", message=verdict(row))
    ET.indent(root)
    with whole_file(file) as handle:
        handle.write('<?xml version="1.0" encoding="utf-8"?>\n')
        handle.write(ET.tostring(root, encoding="unicode") + "\n")
