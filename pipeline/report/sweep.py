"""The folder of a sweep: tables, figures and one page, written whole or not at all."""

import csv
import math
from collections.abc import Iterable, Sequence
from html import escape
from importlib.metadata import version
from pathlib import Path

from pipeline.atomic import whole_folder
from pipeline.ingest.source import source
from pipeline.report import sweep_figures as figures
from pipeline.report.page import Page
from pipeline.report.tables import html_table, number
from pipeline.sweep import Agreement, QuotedRow, Sweep, SweepRow, agreements, quoted_rows

CONTENTS = frozenset({"sweep.html", "sweep.csv", "quoted.csv", "figures"})
_DECIMALS = {"p3": 2, "T": 3, "theta": 2, "bending": 3, "torsion": 3}
_SHOWN = ("p3_B_bar", "p3_mean_bar", "T_B_bar", "T_mean_bar", "theta_B_deg", "bending_mean_bar", "torsion_mean_bar")
_CHANGES = ("p3_B_bar", "T_B_bar", "theta_B_deg", "bending_mean_bar", "torsion_mean_bar")
_METHOD = """\
Lengths are in cylinder radii r₀, forces in K/r₀², moments in K/r₀ and twist in turns per r₀, as in the paper; K is the
torsional rigidity. B is where the contact starts, C where it ends, so that the twist at B is T_AB, the tension at B
p₃AB. The bending moment is Bκ, the torsional one Kτ. The flexible model has no bending: its bending moment is the one
that its path would take.

A mean is taken over the angle ψ: it is what the mean over the nodes of a grid uniform in ψ, the paper's, tends to. The
paper does not say which mean it quotes; the mean over arc length stands beside it in sweep.csv and quoted.csv.

Every solve has its row in sweep.csv; one that failed keeps it, with its reason."""


def write_sweep(sweep: Sweep, rows: Sequence[SweepRow], folder: Path) -> None:
    """Write sweep.csv, quoted.csv (where numbers are quoted), figures and sweep.html to `folder`, whole or not at all.

    Raises
    ------
    InputError
        If `folder` holds something that is not a sweep, or cannot be written.
    """
    quoted = quoted_rows(sweep, rows)
    with whole_folder(folder, CONTENTS.__contains__, "a sweep") as part:
        _write_csv(part / "sweep.csv", sweep_table(rows))
        if quoted:
            _write_csv(part / "quoted.csv", quoted_table(quoted))
        (part / "sweep.html").write_text(_page(sweep, rows, quoted, part), encoding="utf-8")


def sweep_table(rows: Iterable[SweepRow]) -> list[dict[str, object]]:
    """One record a row: where it belongs, its numbers (NaN where there are none), outcome and reason."""
    return [
        {
            "study": row.study.name,
            "parameter": row.study.parameter,
            "value": row.value,
            "set": row.pair.name,
            "k": row.pair.k,
            "eta": row.pair.eta,
            "model": row.model,
            **row.numbers,
            "outcome": row.outcome,
            "message": row.message,
        }
        for row in rows
    ]


def quoted_table(quoted: Iterable[QuotedRow]) -> list[dict[str, object]]:
    """One record a quoted number, model and set."""
    return [
        {
            "study": row.quoted.study,
            "value": row.quoted.value,
            "quantity": row.quoted.quantity,
            "where": row.quoted.where,
            "paper": row.quoted.published,
            "model": row.model,
            "set": row.pair.name,
            "k": row.pair.k,
            "eta": row.pair.eta,
            "ours": row.ours,
            "difference_percent": row.difference_percent,
            "ours_arc_mean": row.arc_mean,
            "arc_difference_percent": row.arc_difference_percent,
            "message": row.message,
        }
        for row in quoted
    ]


def document(sweep: Sweep, rows: Sequence[SweepRow]) -> dict[str, object]:
    """Everything that the tables hold, for JSON: null where there is no number."""
    quoted = quoted_rows(sweep, rows)
    return {
        "sweep": sweep.name,
        "rows": [_nulls(row) for row in sweep_table(rows)],
        "quoted": [_nulls(row) for row in quoted_table(quoted)],
        "agreement": [
            _nulls(
                {
                    "model": a.model,
                    "set": a.pair.name,
                    "rms_percent": a.rms_percent,
                    "max_percent": a.max_percent,
                    "arc_rms_percent": a.arc_rms_percent,
                    "known": a.known,
                    "total": a.total,
                }
            )
            for a in (agreements(sweep, quoted) if quoted else ())
        ],
    }


def _nulls(record: dict[str, object]) -> dict[str, object]:
    return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in record.items()}


def _write_csv(path: Path, records: Sequence[dict[str, object]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(records[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(records)


def statements(sweep: Sweep, rows: Sequence[SweepRow], quoted: Sequence[QuotedRow]) -> list[str]:
    """What the page says at its top, each sentence computed from the rows."""
    said = []
    parameters = {study.name: study.parameter for study in sweep.studies}
    for agreement in agreements(sweep, quoted) if quoted else ():
        if agreement.model != sweep.source_model or not agreement.known:
            continue
        here = [row for row in quoted if (row.model, row.pair) == (agreement.model, agreement.pair)]
        worst = max((r for r in here if math.isfinite(r.ours)), key=lambda row: abs(row.difference_percent))
        q = worst.quoted
        of = f"the {agreement.total}"
        if agreement.known < agreement.total:
            of = f"{agreement.known} (the others have no solution) of the {agreement.total}"
        said.append(
            f"With {agreement.pair.name}, {agreement.model} differs from {of} quoted numbers by "
            f"{agreement.rms_percent:.1f}\u00a0% (root mean square), at most {agreement.max_percent:.1f}\u00a0%: "
            f"{figures.quantity_label(q.quantity)} at {figures.setting(parameters[q.study], q.value)}, source "
            f"{q.published:g}, ours {worst.ours:.4g}. This set: {agreement.pair.note}."
        )
    shifts = [
        abs(row.arc_difference_percent - row.difference_percent)
        for row in quoted
        if row.model == sweep.source_model and math.isfinite(row.arc_mean)
    ]
    if shifts:
        said.append(
            "Means are over the angle ψ. Taken over arc length instead, no quoted mean changes by more than "
            f"{max(shifts):.2f}\u00a0% of itself: the numbers cannot tell which mean the source uses."
        )
    ratios = [
        abs(row.numbers["torsion_mean_bar"] / row.numbers["bending_mean_bar"])
        for row in rows
        if row.ok and row.model == sweep.source_model
    ]
    if ratios:
        said.append(
            f"In the solutions of {sweep.source_model} the mean torsional moment is {min(ratios):.1f} to "
            f"{max(ratios):.1f} times the mean bending moment."
        )
    failed = [row for row in rows if not row.ok]
    said += [f"No solution: {failure(row)}" for row in failed]
    if not failed:
        said.append(f"All {len(rows)} solves converged.")
    return said


def failure(row: SweepRow) -> str:
    """A failed row in one line."""
    place = f"{row.study.name}, {figures.setting(row.study.parameter, row.value)}, {row.pair.name}, {row.model}"
    return f"{place}: {row.outcome}: {row.message}"


def _page(sweep: Sweep, rows: Sequence[SweepRow], quoted: Sequence[QuotedRow], folder: Path) -> str:
    """The page; figures are saved on the way."""
    page = Page(sweep.title, folder)
    page.heading(1, "title", sweep.title)
    page.heading(2, "summary", "Summary")
    page.html(_summary_html(sweep, rows, quoted))
    if quoted:
        page.heading(
            2,
            "quoted",
            "The source's numbers beside ours",
            "Each row is a number that the source's text gives. Nothing was tuned beyond the sets of k and η that "
            "are named; every difference stays as it came out.",
        )
        page.html(_quoted_html(sweep, quoted))
        page.show(figures.differences(sweep, quoted), "quoted")
        page.html(_agreement_html(agreements(sweep, quoted)))
    page.heading(
        2,
        "figures",
        "What each parameter does",
        "From the first value of each parameter to its last, by how much the yarn changes before the cylinder.",
    )
    page.html(_effects_html(sweep, rows))
    if sweep.relation_figure:
        words = (
            "Whether bending matters beside torsion is a matter of twist per cylinder radius: little twist or a thin "
            "cylinder makes bending count, much twist or a thick cylinder lets torsion rule."
        )
        page.heading(3, "relation", f"{_numbered(sweep.relation_figure)}Bending and torsion", words)
        page.show(figures.relation(sweep, rows), sweep.relation_figure)
    for index, study in enumerate(sweep.studies):
        title = f"{_numbered(study.figure)}Effect of {study.name}"
        page.heading(3, f"study-{index}", title, escape(study.note))
        if study.paths:
            page.show(figures.paths(sweep, rows, study), f"{study.figure}_paths")
        page.show(figures.effects(sweep, rows, study), study.figure)
    page.heading(2, "numbers", "Numbers", f"Solutions of {sweep.source_model}; all models: sweep.csv.")
    page.html(_rows_html(sweep, rows))
    page.heading(2, "method", "Method", _METHOD)
    page.heading(2, "provenance", "Provenance")
    given = source(sweep.path, sweep.path.parent)
    base = ", ".join(f"{key} = {value}" for key, value in sweep.base.items())
    words = (
        f"Base scene: {base}. Models: {', '.join(sweep.models)}. Made by yarnval {version('yarnval')} from "
        f"{given.name}, SHA-256 {given.sha256}."
    )
    page.html(f"<p>{escape(words)}</p>")
    return page.to_html()


def _numbered(figure: str) -> str:
    """'fig07' is 'Figure 7: '; a name that holds no number adds nothing."""
    digits = figure.removeprefix("fig")
    return f"Figure {int(digits)}: " if figure.startswith("fig") and digits.isdecimal() else ""


def _summary_html(sweep: Sweep, rows: Sequence[SweepRow], quoted: Sequence[QuotedRow]) -> str:
    items = "".join(f"<li>{escape(text)}</li>" for text in statements(sweep, rows, quoted))
    notes = "".join(f"<p>{escape(note)}</p>" for note in sweep.notes)
    return f'<p class="source">{escape(sweep.source)}</p><ul class="summary">{items}</ul>{notes}'


def _quoted_html(sweep: Sweep, quoted: Sequence[QuotedRow]) -> str:
    parameters = {study.name: study.parameter for study in sweep.studies}
    cells = []
    for given in sweep.quoted:
        decimals = _DECIMALS[given.quantity.partition("_")[0]]
        published = f'<data value="{given.published!r}">{given.published:g}</data>'
        cell = {
            "Scene": escape(figures.setting(parameters[given.study], given.value)),
            "Quantity": escape(figures.quantity_label(given.quantity)),
            "Source": f'<abbr title="{escape(given.where)}">{published}</abbr>',
        }
        for row in quoted:
            if row.quoted == given and row.model == sweep.source_model:
                why = f"no solution: {row.message}"
                cell[f"Ours, {row.pair.name}"] = number(row.ours, decimals, why_missing=why)
                cell[f"% off, {row.pair.name}"] = number(row.difference_percent, 1, why_missing=why, signed=True)
        cells.append(cell)
    return html_table(cells, f"The source's numbers beside ours ({sweep.source_model})", 2)


def _agreement_html(found: Iterable[Agreement]) -> str:
    why = "no quoted number has a solution"
    cells = [
        {
            "Model": escape(a.model),
            "Set": escape(a.pair.name),
            "RMS difference %": number(a.rms_percent, 2, why_missing=why),
            "Largest %": number(a.max_percent, 2, why_missing=why),
            "RMS % with means over arc length": number(a.arc_rms_percent, 2, why_missing=why),
            "Numbers": f"{a.known} of {a.total}",
        }
        for a in found
    ]
    return html_table(cells, "Agreement of each model with the quoted numbers", 2)


def _effects_html(sweep: Sweep, rows: Sequence[SweepRow]) -> str:
    """Change of the results from the first to the last value of each study."""
    by_place = {(r.study.name, r.value, r.pair.name): r for r in rows if r.model == sweep.source_model}
    cells = []
    for study in sweep.studies:
        for pair in sweep.sets:
            first, last = (by_place[study.name, study.values[index], pair.name] for index in (0, -1))
            why = first.message or last.message or "no change in % of 0"
            cell = {
                "Parameter": escape(study.name),
                "From": escape(figures.setting(study.parameter, first.value)),
                "To": escape(f"{last.value:g}"),
                "Set": escape(pair.name),
            }
            for name in _CHANGES:
                a, b = first.numbers[name], last.numbers[name]
                label, unit = figures.quantity_label(name).removesuffix(")").split(" (")
                if unit == "°":
                    cell[f"{label}, °"] = number(b - a, 2, why_missing=why, signed=True)
                else:
                    cell[f"{label}, %"] = number((b / a - 1) * 100 if a else math.nan, 1, why_missing=why, signed=True)
            cells.append(cell)
    return html_table(cells, f"Change from the first value to the last, {sweep.source_model}", 4)


def _rows_html(sweep: Sweep, rows: Iterable[SweepRow]) -> str:
    cells = []
    for row in rows:
        if row.model == sweep.source_model:
            cells.append(
                {
                    "Study": escape(row.study.name),
                    "Value": escape(figures.setting(row.study.parameter, row.value)),
                    "Set": escape(row.pair.name),
                }
                | {
                    figures.quantity_label(name): number(
                        row.numbers[name], _DECIMALS[name.partition("_")[0]], why_missing=f"no solution: {row.message}"
                    )
                    for name in _SHOWN
                }
            )
    return html_table(cells, f"Values at B and means, {sweep.source_model}", 3)
