"""Check: hold errors against bounds, for a CI job; and write them as JUnit XML."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

from pipeline.atomic import whole_file
from pipeline.records import Comparison


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
