"""The report folder: written whole or not at all."""

import json
import shutil
from pathlib import Path

import nbformat

from pipeline import store
from pipeline.atomic import whole_folder
from pipeline.records import Results
from pipeline.report import notebook, tables

CONTENTS = frozenset(
    {"report.html", "report.ipynb", "table2.csv", "errors.json", "figures", "results.nc", "provenance.json"}
)


def write_report(results: Results, folder: Path) -> None:
    """Write the report of a study to `folder`, whole or not at all.

    Raises
    ------
    InputError
        If `folder` holds something that is not a report, or cannot be written.
    """
    with whole_folder(folder, CONTENTS.__contains__, "a report") as part:
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
