"""The folder of a winding study: one page, figures, tables, results.nc, written whole or not at all."""

import csv
import platform
from collections.abc import Sequence
from dataclasses import asdict
from html import escape
from importlib.metadata import version
from itertools import groupby
from operator import itemgetter
from pathlib import Path

from pipeline.atomic import whole_folder
from pipeline.ingest.source import source
from pipeline.report import winding_figures as figures
from pipeline.report import winding_tables as tables
from pipeline.report.page import Page
from pipeline.report.tables import to_json
from pipeline.report.winding_animation import animation_html, write_animation
from pipeline.store import write_tree
from pipeline.winding.calibration import CalibratedStudy
from pipeline.winding.findings import DIFFERENCE, RISE, WEAK, Finding, findings, weak_inside
from pipeline.winding.metric import COLLISION, EXTREME, SENSOR, SPACING
from pipeline.winding.run import Row
from pipeline.winding.sensitivity import LAYER_LIMIT, SPAN_LIMIT, Sensitivity, sensitivities
from pipeline.winding.store import to_tree
from pipeline.winding.study import WindingStudy

CONTENTS = frozenset(
    {"wind.html", "runs.csv", "layers.csv", "sensitivity.csv", "figures", "results.nc", "provenance.json"}
)
PACKAGES = ("yarnval", "numpy", "scipy", "numba", "xarray", "matplotlib", "nbconvert")
_METHOD = f"""\
The bobbin draws the yarn through the traversing guide and lays it down in layers, one a guide cycle. The **reference**
mode integrates the motion of the yarn's nodes explicitly, with axial and bending stiffness, relaxation (Prony), contact
of yarn with bobbin and yarn with friction, and a guide that the yarn slides through. The **fast** mode takes the path
on the bobbin as given and computes the span's tension from longitudinal waves, T = T₀ + ρc(u − ū), and one radial
freedom for each laid node. Each scene, with every assumed value, is in the file named below.

The span is settled after the first guide cycle; mean, standard deviation and slope are over what follows. The error is
the paper's: samples {SPACING:g} s apart (Eq. 13 turns its stress into tension; our tension is one already), the
relative error |S − M|/M of each (Eq. 14), averaged. A sample is the mean over {1e3 * SENSOR:g} ms, the interval of the
paper's sensor of 100 Hz. The paper removes "the extreme stress points caused by the yarn guide collision" without
saying what it calls extreme: here, points within {1e3 * COLLISION:g} ms of a turn of the guide and more than
{EXTREME:g} robust standard deviations (1.4826 times the median absolute deviation) from the median of the run."""


_FINDINGS = f"""\
Each held against the runs below; nothing was tuned for it. A rise counts from {100 * RISE:g} % of the end tension over
the run, and above twice its uncertainty; so does a higher mean from yarn to yarn. Inner loops count as weak from
{WEAK:g} T₀ down, outer ones as strong from {DIFFERENCE:g} T₀ above them, by halves of the layers."""
_CALIBRATION = {
    "layers": "Least squares of T/T₀ of the layers. u is linearised at the fit and takes the fast mode for right.",
    "span": "Least squares of the quantiles of the tension between guide and bobbin, because the log's phase against "
    "the guide is not known. A span knows little of the yarn on the bobbin: what it does not determine has no u.",
}


def write_winding(study: WindingStudy, rows: Sequence[Row], folder: Path, fit: CalibratedStudy | None = None) -> None:
    """Write page, figures, tables and results.nc to `folder`, whole or not at all; `fit` is how the scene was fitted.

    Raises
    ------
    InputError
        If `folder` holds something that is not a winding report, or cannot be written.
    """
    found = findings(rows)
    made = provenance(study, fit)
    with whole_folder(folder, CONTENTS.__contains__, "a winding report") as part:
        write_tree(to_tree(study, rows, found, made), part / "results.nc")
        (part / "provenance.json").write_text(to_json(made), encoding="utf-8")
        _write_csv(part / "runs.csv", tables.runs_table(rows))
        _write_csv(part / "layers.csv", tables.layers_table(rows))
        changes = sensitivities(rows)
        if changes:
            _write_csv(part / "sensitivity.csv", [c.as_record() for c in changes])
        page = Page(study.title, part)
        _compose(page, part, study, rows, found, changes, fit)
        page.heading(2, "method", "Method", _METHOD)
        page.heading(2, "provenance", "Provenance", "Which files went in, with which versions, and every scene in SI.")
        page.html(tables.provenance_html(made))
        (part / "wind.html").write_text(page.to_html(), encoding="utf-8")


def provenance(study: WindingStudy, fit: CalibratedStudy | None = None) -> dict[str, object]:
    """What went in, by content, and what it was worked with. No paths of this machine, no times."""
    given = source(study.path, study.path.parent)
    logs = [case.log.raw for case in study.cases if case.log]
    files = [given, *(log.source for log in logs), *([fit.origin] if fit else [])]
    return {
        "study": study.name,
        "inputs_sha256": {file.name: file.sha256 for file in files},
        "fitted_to": fit.origin.name if fit else None,
        "layouts": {log.source.name: log.layout for log in logs},
        "scenes": {case.label: asdict(case.scene) for case in study.cases},
        "versions": {name: version(name) for name in PACKAGES} | {"python": platform.python_version()},
    }


def _write_csv(path: Path, records: Sequence[dict[str, object]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(records[0]) if records else [], lineterminator="\n")
        writer.writeheader()
        writer.writerows(records)


def _compose(
    page: Page,
    folder: Path,
    study: WindingStudy,
    rows: Sequence[Row],
    found: Sequence[Finding],
    changes: Sequence[Sensitivity],
    fit: CalibratedStudy | None,
) -> None:
    base = [row for row in rows if not row.variant]
    drawn = next(row for row in base if row.case.name == study.package_case)
    page.heading(1, "title", study.title)
    page.heading(2, "summary", "Summary")
    page.html(tables.summary_html(study, rows, found))
    page.heading(2, "findings", "The paper's findings", _FINDINGS)
    page.html(tables.findings_html(found))
    if fit is not None:
        page.heading(2, "calibration", "Calibration", _CALIBRATION[fit.kind])
        page.html(tables.calibration_html(fit, drawn))
        page.show(figures.calibration(fit, drawn), "calibration")
    page.heading(2, "tension", "Figure 7: tension in time")
    page.show(figures.tension_in_time(base), "fig07_tension")
    page.html(tables.errors_html(rows))
    fineness = figures.effect_of_fineness([row for row in base if row.ok])
    if fineness is not None:
        page.heading(2, "fineness", "Figure 8: effect of fineness")
        page.show(fineness, "fig08_fineness")
    page.heading(2, "package", "Figure 9: tension on the package")
    if drawn.result.snapshots:
        page.show(figures.package(drawn), "fig09_package")
    weak = next((row for row in rows if row.variant and row.case.name == drawn.case.name and weak_inside(row)), None)
    if weak is not None and not weak_inside(drawn):
        page.show(figures.package(weak), "fig09_package_weak_inside")
    layered = [row for row in base if row.layers.size]
    if layered:
        page.show(figures.layer_tension(layered), "layers")
        page.html(tables.layers_html(base))
    page.heading(2, "frames", "The winding in frames")
    page.show(figures.frames(drawn), "frames")
    if drawn.result.snapshots:
        animation = folder / "figures" / "winding.gif"
        write_animation(drawn, animation)
        page.html(animation_html(animation, drawn))
    if changes:
        _sensitivity(page, rows, changes)
    page.heading(2, "numbers", "Numbers", "All of them: runs.csv, layers.csv and results.nc.")
    page.html(tables.runs_html(rows))


def _sensitivity(page: Page, rows: Sequence[Row], changes: Sequence[Sensitivity]) -> None:
    page.heading(
        2,
        "sensitivity",
        "What is robust and what is not",
        f"Robust is a span mean that changes by less than {100 * SPAN_LIMIT:g} % of itself, and a layer profile of "
        f"which no layer changes by more than {LAYER_LIMIT:g} T₀. A parameter that changes nothing, to the last bit, "
        "is no part of the mode: that says nothing about the yarn.",
    )
    page.html(tables.sensitivity_html(changes))
    variants = [(row.case.variant.group, row) for row in rows if row.case.variant]
    for index, (group, several) in enumerate(groupby(variants, key=itemgetter(0))):
        page.heading(3, f"vary-{index}", f"Effect of {group.name}", escape(group.note))
        of = next(row for row in rows if row.case.name == group.case and not row.variant)
        page.show(figures.sensitivity(of, [row for _, row in several]), f"sensitivity_{index}_{group.parameter}")
