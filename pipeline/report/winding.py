"""The folder of a winding study: one page, figures, tables, results.nc, written whole or not at all."""

import csv
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from importlib.metadata import version
from itertools import groupby
from pathlib import Path

import nbformat
import numpy as np
from matplotlib.figure import Figure
from nbformat.notebooknode import NotebookNode

from pipeline.atomic import whole_folder
from pipeline.ingest.source import source
from pipeline.records import Array
from pipeline.report import winding_figures as figures
from pipeline.report.figures import save
from pipeline.report.notebook import heading_cell, to_html
from pipeline.report.tables import html_table, number, remark, to_json
from pipeline.store import write_tree
from pipeline.winding.findings import Finding, findings
from pipeline.winding.keys import written
from pipeline.winding.metric import COLLISION, EXTREME, SENSOR, SPACING
from pipeline.winding.run import Row
from pipeline.winding.sensitivity import LAYER_LIMIT, SPAN_LIMIT, Sensitivity, sensitivities
from pipeline.winding.store import run_numbers, to_tree
from pipeline.winding.study import WindingStudy

CONTENTS = frozenset(
    {"wind.html", "runs.csv", "layers.csv", "sensitivity.csv", "figures", "results.nc", "provenance.json"}
)
PACKAGES = ("yarnval", "numpy", "scipy", "numba", "xarray", "matplotlib", "nbconvert")
PAPER_HOURS = 45
"""What the paper's run of 9 m of 131.2 tex at 1000 r/min took."""
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


def write_winding(study: WindingStudy, rows: Sequence[Row], folder: Path) -> None:
    """Write page, figures, tables and results.nc to `folder`, whole or not at all.

    Raises
    ------
    InputError
        If `folder` holds something that is not a winding report, or cannot be written.
    """
    found = findings(rows)
    made = provenance(study)
    with whole_folder(folder, CONTENTS.__contains__, "a winding report") as part:
        write_tree(to_tree(study, rows, found, made), part / "results.nc")
        (part / "provenance.json").write_text(to_json(made), encoding="utf-8")
        _write_csv(part / "runs.csv", runs_table(rows))
        _write_csv(part / "layers.csv", layers_table(rows))
        changes = sensitivities(rows)
        if changes:
            _write_csv(part / "sensitivity.csv", [c.as_record() for c in changes])
        page = to_html(_page(study, rows, found, changes, made, part))
        (part / "wind.html").write_text(page, encoding="utf-8")


def provenance(study: WindingStudy) -> dict[str, object]:
    """What went in, by content, and what it was worked with. No paths of this machine, no times."""
    given = source(study.path, study.path.parent)
    logs = [case.log.raw for case in study.cases if case.log]
    return {
        "study": study.name,
        "inputs_sha256": {given.name: given.sha256} | {log.source.name: log.source.sha256 for log in logs},
        "layouts": {log.source.name: log.layout for log in logs},
        "scenes": {case.label: asdict(case.scene) for case in study.cases},
        "versions": {name: version(name) for name in PACKAGES} | {"python": platform.python_version()},
    }


def runs_table(rows: Sequence[Row]) -> list[dict[str, object]]:
    """One record a run: its numbers in edge units (NaN where there are none), outcome and reason."""
    return [
        {
            "case": row.case.name,
            "parameter": row.case.variant.group.parameter if row.case.variant else "",
            "value": written(row.case.variant.value) if row.case.variant else "",
            "mode": row.result.mode,
            **_with_units(run_numbers(row)),
            "error_against": row.errors.reference,
            "samples": row.errors.count,
            "extremes_removed": int(np.count_nonzero(row.extremes)),
            "outcome": row.result.outcome.name.lower(),
            "message": row.result.message,
        }
        for row in rows
    ]


_EDGE_UNITS = {
    "speed": "speed_m_s", "end_tension": "T0_cN", "span_mean": "span_mean_cN", "span_u": "span_u_cN",
    "span_sd": "span_sd_cN", "span_slope": "span_slope_cN_per_s", "span_slope_u": "span_slope_u_cN_per_s",
    "span_peak": "span_peak_cN", "error_mean": "error_mean_percent", "error_max": "error_max_percent",
    "error_all_mean": "error_all_mean_percent", "penetration_max": "penetration_max_m", "time_step": "time_step_s",
    "time_step_limit": "time_step_limit_s", "wall": "wall_s",
}  # fmt: skip
"""Name → column, where the name has no unit of its own."""


def _with_units(numbers: Mapping[str, float]) -> dict[str, float]:
    return {_EDGE_UNITS.get(name, name): value for name, value in numbers.items()}


def layers_table(rows: Sequence[Row]) -> list[dict[str, object]]:
    """One record a complete layer of each run."""
    return [
        {"run": row.name, "layer": layer, "T_over_T0": float(value)}
        for row in rows
        for layer, value in enumerate(row.layers, 1)
    ]


def document(rows: Sequence[Row]) -> dict[str, object]:
    """What `yarnval wind --json` prints; null where there is no number."""
    return {
        "cases": [_entry(row) for row in rows if not row.variant],
        "variants": [
            _entry(row) | {"parameter": row.case.variant.group.parameter, "value": row.case.variant.value}
            for row in rows
            if row.case.variant
        ],
        "findings": [asdict(finding) for finding in findings(rows)],
    }


def _entry(row: Row) -> dict[str, object]:
    numbers = run_numbers(row)
    return {
        "case": row.case.name,
        "tex": row.tex,
        "rpm": row.case.keys.drum_rpm,
        "mode": row.result.mode,
        "mode_reason": row.result.mode_reason,
        "T0_cN": numbers["end_tension"],
        "span": {
            "mean_cN": _known(numbers["span_mean"]),
            "u_cN": _known(numbers["span_u"]),
            "sd_cN": _known(numbers["span_sd"]),
            "slope_cN_per_s": _known(numbers["span_slope"]),
            "peak_cN": _known(numbers["span_peak"]),
            "samples_30_cN": [_known(value) for value in 100 * row.samples],
        },
        "error": {
            "against": row.errors.reference,
            "mean_percent": _known(numbers["error_mean"]),
            "max_percent": _known(numbers["error_max"]),
            "mean_percent_with_extremes": _known(numbers["error_all_mean"]),
            "samples": row.errors.count,
            "extremes_removed": int(np.count_nonzero(row.extremes)),
        },
        "layers_T_over_T0": [_known(value) for value in row.layers],
        "energy_residual": _known(numbers["energy_residual"]),
        "wall_s": _known(numbers["wall"]),
        "outcome": row.result.outcome.name.lower(),
        "message": row.result.message,
    }


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _write_csv(path: Path, records: Sequence[dict[str, object]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(records[0]) if records else [], lineterminator="\n")
        writer.writeheader()
        writer.writerows(records)


def statements(rows: Sequence[Row], found: Sequence[Finding]) -> list[str]:
    """What the page says at its top, each sentence computed from the rows."""
    said = [f"{f.claim}: {f.verdict}{':' if f.verdict == 'reproduced only if' else '.'} {f.why}" for f in found]
    base = [row for row in rows if row.ok and not row.variant]
    off = {row.name: 100 * (row.span.mean / row.end_tension - 1) for row in base if math.isfinite(row.span.mean)}
    if off:
        worst = max(off, key=lambda name: abs(off[name]))
        said.append(
            f"The mean tension between guide and bobbin is within {abs(off[worst]):.1f}\u00a0% of the end tension in "
            f"all {len(off)} cases (furthest: {worst}, {off[worst]:+.1f}\u00a0%)."
        )
    for against, group in groupby(sorted(base, key=lambda r: r.errors.reference), key=lambda r: r.errors.reference):
        means = [row.errors.mean_percent for row in group if row.errors.count]
        if means:
            said.append(
                f"The paper's error metric against {against}: {min(means):.1f} to {max(means):.1f}\u00a0%, "
                f"{np.mean(means):.1f}\u00a0% on average over {len(means)} cases. "
                + (
                    "T₀ is the end tension, not a measurement: this says how much the tension fluctuates. The paper's "
                    "14.09\u00a0% is against measured curves that are not published."
                    if against == "T₀"
                    else "The paper reports 9.39 to 17.06\u00a0%, 14.09\u00a0% on average, against its own machine."
                )
            )
    done = [row.result.wall_s for row in rows if row.ok and math.isfinite(row.result.wall_s)]
    if done:
        said.append(
            f"{len(done)} runs took {sum(done):.1f} s of computing here, the longest {max(done):.1f} s; the "
            f"paper's run of 9 m of 131.2 tex at 1000 r/min took {PAPER_HOURS} h."
        )
    return said + [f"Not completed: {row.name}: {row.result.message}" for row in rows if not row.ok]


def _page(
    study: WindingStudy,
    rows: Sequence[Row],
    found: Sequence[Finding],
    changes: Sequence[Sensitivity],
    made: Mapping[str, object],
    folder: Path,
) -> NotebookNode:
    """The page as a notebook of outputs, which the report's own template shows; figures are saved on the way."""
    cells: list[NotebookNode] = []

    def output(data: dict[str, str], metadata: dict[str, dict[str, str]] | None = None) -> None:
        shown = nbformat.v4.new_output("display_data", data=data, metadata=metadata or {})
        cells.append(nbformat.v4.new_code_cell("", id=f"output-{len(cells)}", outputs=[shown]))

    def heading(level: int, name: str, text: str, words: str = "") -> None:
        cells.append(heading_cell(level, name, text, words))

    def show(figure: Figure, name: str) -> None:
        output(*save(figure, name, folder))

    base = [row for row in rows if not row.variant]
    drawn = next(row for row in base if row.case.name == study.package_case)
    heading(1, "title", study.title)
    heading(2, "summary", "Summary")
    items = "".join(f"<li>{escape(text)}</li>" for text in statements(rows, found))
    notes = "".join(f"<p>{escape(note)}</p>" for note in study.notes)
    output({"text/html": f'<p class="source">{escape(study.source)}</p><ul class="summary">{items}</ul>{notes}'})
    heading(2, "findings", "The paper's findings", "Each held against the runs below; nothing was tuned for it.")
    output({"text/html": _findings_html(found)})
    heading(2, "tension", "Figure 7: tension in time")
    show(figures.tension_in_time(base), "fig07_tension")
    output({"text/html": _errors_html(rows)})
    fineness = figures.effect_of_fineness([row for row in base if row.ok])
    if fineness is not None:
        heading(2, "fineness", "Figure 8: effect of fineness")
        show(fineness, "fig08_fineness")
    heading(2, "package", "Figure 9: tension on the package")
    if drawn.result.snapshots:
        show(figures.package(drawn), "fig09_package")
    show(figures.layer_tension([row for row in base if row.layers.size]), "layers")
    output({"text/html": _layers_html(base)})
    heading(2, "frames", "The winding in frames")
    show(figures.frames(drawn), "frames")
    if changes:
        heading(
            2,
            "sensitivity",
            "What is robust and what is not",
            f"Robust is a span mean that changes by less than {100 * SPAN_LIMIT:g} % of itself, and a layer profile of "
            f"which no layer changes by more than {LAYER_LIMIT:g} T₀. A parameter that changes nothing, to the last "
            "bit, is no part of the mode: that says nothing about the yarn.",
        )
        output({"text/html": _sensitivity_html(changes)})
        by_group = groupby(
            [row for row in rows if row.variant], key=lambda row: row.case.variant and row.case.variant.group
        )
        for index, (group, several) in enumerate(by_group):
            assert group is not None  # a variant has one
            heading(3, f"vary-{index}", f"Effect of {group.name}", escape(group.note))
            of = next(row for row in base if row.case.name == group.case)
            show(figures.sensitivity(of, list(several)), f"sensitivity_{index}_{group.parameter}")
    heading(2, "numbers", "Numbers", "All of them: runs.csv, layers.csv and results.nc.")
    output({"text/html": _runs_html(rows)})
    heading(2, "method", "Method", _METHOD)
    heading(2, "provenance", "Provenance", "Which files went in, with which versions, and every scene in SI.")
    text = escape(to_json(made))
    output(
        {"text/html": f'<div class="scroll" role="region" tabindex="0" aria-label="Provenance"><pre>{text}</pre></div>'}
    )
    page = nbformat.v4.new_notebook(cells=cells)
    page.metadata["title"] = study.title
    return page


def _findings_html(found: Sequence[Finding]) -> str:
    cells = [
        {"Finding": escape(f.claim), "Here": f"<strong>{escape(f.verdict)}</strong>", "Why": remark(f.why)}
        for f in found
    ]
    return html_table(cells, "The paper's three findings", 1)


def _errors_html(rows: Sequence[Row]) -> str:
    cells = []
    for row in rows:
        why = row.result.message or "no sample has both values"
        cells.append(
            {
                "Run": escape(row.name),
                "Against": escape(row.errors.reference),
                "Mean error %": number(row.errors.mean_percent, 2, why_missing=why),
                "Largest %": number(row.errors.max_percent, 2, why_missing=why),
                "Mean %, extremes left in": number(row.errors_all.mean_percent, 2, why_missing=why),
                "Samples": number(float(row.errors.count), 0, why_missing=why),
                "Points left out": number(float(np.count_nonzero(row.extremes)), 0, why_missing=why),
            }
        )
    return html_table(cells, "The paper's error metric (its Table 6)", 1)


def _layers_html(rows: Sequence[Row]) -> str:
    most = max((row.layers.size for row in rows), default=0)
    cells = []
    for row in rows:
        values: Array = np.full(most, math.nan)
        values[: row.layers.size] = row.layers
        cells.append(
            {"Case": escape(row.name)}
            | {
                f"Layer {k}": number(float(value), 3, why_missing="not complete in this run")
                for k, value in enumerate(values, 1)
            }
        )
    return html_table(cells, "Mean tension of the layers at the end, over T₀", 1)


def _sensitivity_html(changes: Sequence[Sensitivity]) -> str:
    why = "not completed, or without layers"
    cells = [
        {
            "Parameter": escape(c.name),
            "Value": escape(c.value),
            "Case's own": escape(c.own),
            "Span mean, %": number(c.span_percent, 2, why_missing=why, signed=True),
            "Standard deviation, %": number(c.sd_percent, 1, why_missing=why, signed=True),
            "First layer, T₀": number(c.first_layer, 3, why_missing=why, signed=True),
            "Last layer, T₀": number(c.last_layer, 3, why_missing=why, signed=True),
            "Largest change of a layer, T₀": number(c.largest_layer, 3, why_missing=why),
            "Span mean is": escape(c.span_said),
            "Layer profile is": escape(c.layers_said),
        }
        for c in changes
    ]
    return html_table(cells, "Changes against the case itself", 2)


def _runs_html(rows: Sequence[Row]) -> str:
    cells = []
    for row in rows:
        numbers, why = run_numbers(row), row.result.message or "not part of this mode"
        cells.append(
            {
                "Run": escape(row.name),
                "Mode": escape(row.result.mode),
                "T₀, cN": number(numbers["end_tension"], 1, why_missing=why),
                "Mean, cN": number(numbers["span_mean"], 2, why_missing=why),
                "u, cN": number(numbers["span_u"], 2, why_missing=why),
                "SD, cN": number(numbers["span_sd"], 2, why_missing=why),
                "Slope, cN/s": number(numbers["span_slope"], 2, why_missing=why, signed=True),
                "Peak, cN": number(numbers["span_peak"], 1, why_missing=why),
                "Energy residual": number(numbers["energy_residual"], 5, why_missing=why),
                "Wall, s": number(numbers["wall"], 2, why_missing=why),
                "Outcome": escape(row.result.outcome.name.lower().replace("_", " ")),
                "Message": remark(row.result.message),
            }
        )
    return html_table(cells, "All runs", 1)
