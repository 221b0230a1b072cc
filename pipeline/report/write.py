"""The report folder: written whole or not at all."""

import ctypes
import json
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import nbformat

from pipeline import store
from pipeline.errors import InputError
from pipeline.records import Results
from pipeline.report import notebook, tables

CONTENTS = frozenset(
    {"report.html", "report.ipynb", "table2.csv", "errors.json", "figures", "results.nc", "provenance.json"}
)
_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


def write_report(results: Results, folder: Path) -> None:
    """Write the report of a study to `folder`, whole or not at all.

    It is made in a hidden folder beside `folder`, which then takes its place; an earlier report stays as it was until
    then, also if the process is killed. What a killed process left is removed by the next report to the same place.

    Raises
    ------
    InputError
        If `folder` holds something that is not a report, or cannot be written.
    """
    with _replacing(folder) as part:
        tree = store.to_tree(results)
        store.write_tree(tree, part / "results.nc")
        tables.table2(tree).to_csv(part / "table2.csv", index=False, lineterminator="\n")
        (part / "errors.json").write_text(tables.to_json(tables.errors(tree)), encoding="utf-8")
        provenance = json.loads(tree.attrs["provenance"])
        (part / "provenance.json").write_text(tables.to_json(provenance), encoding="utf-8")
        report = notebook.build(tree)
        notebook.execute(report, part)
        shutil.rmtree(part / ".ipython", ignore_errors=True)
        nbformat.write(report, part / "report.ipynb")
        (part / "report.html").write_text(notebook.to_html(report), encoding="utf-8")


@contextmanager
def _replacing(folder: Path) -> Iterator[Path]:
    """Give an empty folder beside `folder`, which takes the place of `folder` if the block ends well."""
    folder = Path(os.path.abspath(folder))
    _refuse_strangers(folder)
    part = folder.with_name(f".{folder.name}.part-{os.getpid()}")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        _clear_leftovers(folder)
        part.mkdir()
    except OSError as error:
        right = "a place where a folder can be made is needed: see --out"
        raise InputError(folder, f"cannot be written ({error.strerror})", right) from error
    try:
        yield part
        _refuse_strangers(folder)
        if folder.exists():
            _exchange(part, folder)
        else:
            part.rename(folder)
    finally:
        # What lies here now is the earlier report, or an unfinished one.
        shutil.rmtree(part, ignore_errors=True)


def _refuse_strangers(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "a file, not a folder", "a report folder, or a new one, is needed")
    strangers = sorted(p.name for p in folder.glob("*") if p.name not in CONTENTS)
    if strangers:
        right = "a new or empty folder, or one that holds a report only, is needed: it is replaced whole"
        raise InputError(folder, f"holds {strangers[0]!r}, which is not part of a report", right)


def _clear_leftovers(folder: Path) -> None:
    """Remove the unfinished reports of processes that are no more; put back an earlier one that they had set aside."""
    aside = folder.with_name(f".{folder.name}.earlier")
    if aside.exists() and not folder.exists():
        aside.rename(folder)
    shutil.rmtree(aside, ignore_errors=True)
    for left in folder.parent.glob(f".{folder.name}.part-*"):
        if not _alive(int(left.name.rpartition("-")[2])):
            shutil.rmtree(left, ignore_errors=True)


def _alive(process: int) -> bool:
    if process == os.getpid():
        return False  # a folder of this number is a namesake's
    with suppress(ProcessLookupError):
        os.kill(process, 0)
        return True
    return False


def _exchange(part: Path, folder: Path) -> None:
    """Let the two folders change places."""
    if sys.platform == "linux":
        # One step for the file system, so that no moment is without a report: renameat2(2).
        libc = ctypes.CDLL(None, use_errno=True)
        if hasattr(libc, "renameat2") and not libc.renameat2(
            _AT_FDCWD, os.fsencode(part), _AT_FDCWD, os.fsencode(folder), _RENAME_EXCHANGE
        ):
            return
    # Two steps elsewhere; `_clear_leftovers` mends a stop between them.
    aside = folder.with_name(f".{folder.name}.earlier")
    folder.rename(aside)
    part.rename(folder)
    shutil.rmtree(aside, ignore_errors=True)
