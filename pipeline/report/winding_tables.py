"""The tables and sentences of a winding study: rows in; records, HTML and JSON out."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from itertools import groupby

import numpy as np

from models.winding.calibrate import Calibration
from pipeline.records import Array
from pipeline.report.tables import html_table, number, remark, to_json
from pipeline.winding.calibration import CalibratedStudy
from pipeline.winding.findings import Finding, findings
from pipeline.winding.keys import written
from pipeline.winding.run import Row
from pipeline.winding.sensitivity import Sensitivity
from pipeline.winding.store import run_numbers
from pipeline.winding.study import WindingStudy

PAPER_HOURS = 45
"""What the paper's run of 9 m of 131.2 tex at 1000 r/min took."""


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
    "error_all_mean": "error_all_mean_percent", "penetration_max": "penetration_max_m",
    "penetration_share": "penetration_percent_of_d", "transverse_stiffness": "transverse_stiffness_N_per_mm2",
    "time_step": "time_step_s", "time_step_limit": "time_step_limit_s", "wall": "wall_s",
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


def document(rows: Sequence[Row], fit: CalibratedStudy | None = None) -> dict[str, object]:
    """What `yarnval wind --json` prints; null where there is no number."""
    calibration: dict[str, object] = {} if fit is None else {"calibration": _calibration(fit, rows[0])}
    return calibration | {
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
        "penetration": {
            "max_um": _known(1e6 * numbers["penetration_max"]),
            "percent_of_d": _known(numbers["penetration_share"]),
            "transverse_stiffness_N_per_mm2": numbers["transverse_stiffness"],
        },
        "wall_s": _known(numbers["wall"]),
        "outcome": row.result.outcome.name.lower(),
        "message": row.result.message,
    }


def _calibration(fit: CalibratedStudy, row: Row) -> dict[str, object]:
    found = fit.calibration
    return {
        "to": fit.origin.name,
        "compared": fit.kind,
        "parameters": [
            {"name": name, "start": start, "value": value, "u": _known(u)}
            for name, start, value, u in _edge_units(found)
        ],
        "rms_before": found.rms_before,
        "rms_after": found.rms_after,
        "rms_of_this_run": _known(fit.verified(row)),
        "mode_of_this_run": row.result.mode,
        "fast_runs": found.runs,
        "converged": found.converged,
        "message": found.message,
    }


def _edge_units(found: Calibration) -> list[tuple[str, float, float, float]]:
    """Key, start, value and u of each parameter, as a winding file has them."""
    keys = {
        "transverse_stiffness": ("transverse_stiffness_N_per_mm2", 1e-6),
        "relaxation": ("prony_weights[0]", 1.0),
        "axial_stiffness": ("modulus_N_per_tex", 1e-6 / found.scene.linear_density),
        "guide_friction": ("guide_friction", 1.0),
    }
    return [(key, unit * f.start, unit * f.value, unit * f.u) for f in found.fitted for key, unit in [keys[f.name]]]


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def statements(rows: Sequence[Row], found: Sequence[Finding]) -> list[str]:
    """What the page says at its top, each sentence computed from the rows."""
    said = [f"{f.claim}: {f.verdict}{':' if f.verdict == 'reproduced only if' else '.'} {f.why}" for f in found]
    base = [row for row in rows if row.ok and not row.variant]
    off = {row.name: 100 * (row.span.mean / row.end_tension - 1) for row in base if math.isfinite(row.span.mean)}
    if off:
        worst = max(off, key=lambda name: abs(off[name]))
        where = f" in all {len(off)} cases (furthest: {worst})" if len(off) > 1 else ""
        furthest = f"{abs(off[worst]):.1f}\u00a0%"
        said.append(f"The mean tension between guide and bobbin is within {furthest} of the end tension{where}.")
    for against, group in groupby(sorted(base, key=lambda r: r.errors.reference), key=lambda r: r.errors.reference):
        means = [row.errors.mean_percent for row in group if row.errors.count]
        if means:
            said.append(
                f"The paper's error metric against {against}: "
                + (f"{min(means):.1f} to {max(means):.1f}\u00a0%, on average " if len(means) > 1 else "")
                + f"{np.mean(means):.1f}\u00a0%. "
                + (
                    "T₀ is the end tension, not a measurement: this says how much the tension fluctuates. The paper's "
                    "14.09\u00a0% is against measured curves that are not published."
                    if against == "T₀"
                    else "The paper reports 9.39 to 17.06\u00a0%, 14.09\u00a0% on average, against its own machine."
                )
            )
    deep = {row.name: run_numbers(row)["penetration_share"] for row in base}
    deep = {name: share for name, share in deep.items() if math.isfinite(share)}
    if deep:
        worst = max(deep, key=lambda name: deep[name])
        said.append(
            f"Where it is pressed hardest the yarn gives way by up to {deep[worst]:.1f}\u00a0% of its diameter "
            f"({worst}): that is the declared transverse stiffness, an input."
        )
    done = [row.result.wall_s for row in rows if row.ok and math.isfinite(row.result.wall_s)]
    if done:
        said.append(
            f"{len(done)} runs took {sum(done):.1f} s of computing here, the longest {max(done):.1f} s; the "
            f"paper's run of 9 m of 131.2 tex at 1000 r/min took {PAPER_HOURS} h."
        )
    return said + [f"Not completed: {row.name}: {row.result.message}" for row in rows if not row.ok]


def calibration_html(fit: CalibratedStudy, row: Row) -> str:
    """What was fitted, to what, and how near it comes."""
    found = fit.calibration
    cells = [
        {"Parameter": escape(name)}
        | {
            title: number(value if math.isfinite(value) else math.nan, 4, why_missing="the measurement does not say")
            for title, value in (("Start", start), ("Fitted", value), ("u", u))
        }
        for name, start, value, u in _edge_units(found)
    ]
    unit, scale, decimals = ("T₀", 1, 4) if fit.kind == "layers" else ("cN", 100, 3)
    words = (
        f"Fitted to {fit.origin.name} in {found.runs} fast runs. Root mean square difference "
        f"{scale * found.rms_before:.{decimals}f} {unit} before, {scale * found.rms_after:.{decimals}f} {unit} after"
    )
    check = fit.verified(row)
    if math.isfinite(check):
        words += f"; {check:.{decimals}f} {unit} in the run of this page, in the {row.result.mode} mode"
    if not found.converged:
        words += f". The fit did not end well: {found.message}"
    return f"{html_table(cells, 'Fitted parameters', 1)}<p>{escape(words)}.</p>"


def summary_html(study: WindingStudy, rows: Sequence[Row], found: Sequence[Finding]) -> str:
    """The statements as a list, with the source and the notes of the study."""
    items = "".join(f"<li>{escape(text)}</li>" for text in statements(rows, found))
    notes = "".join(f"<p>{escape(note)}</p>" for note in study.notes)
    return f'<p class="source">{escape(study.source)}</p><ul class="summary">{items}</ul>{notes}'


def provenance_html(made: Mapping[str, object]) -> str:
    """As in provenance.json."""
    return (
        '<div class="scroll" role="region" tabindex="0" aria-label="Provenance">'
        f"<pre>{escape(to_json(made))}</pre></div>"
    )


def findings_html(found: Sequence[Finding]) -> str:
    """The paper's findings, what became of each, and why."""
    cells = [
        {"Finding": escape(f.claim), "Here": f"<strong>{escape(f.verdict)}</strong>", "Why": remark(f.why)}
        for f in found
    ]
    return html_table(cells, "The paper's three findings", 1)


def errors_html(rows: Sequence[Row]) -> str:
    """The paper's error metric of every run."""
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


def layers_html(rows: Sequence[Row]) -> str:
    """T/T₀ of the layers, a column each."""
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


def sensitivity_html(changes: Sequence[Sensitivity]) -> str:
    """What each variant changes against its case."""
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


def runs_html(rows: Sequence[Row]) -> str:
    """Every run with its numbers and its outcome; a failed one keeps its row."""
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
                "Transverse stiffness, N/mm²": number(numbers["transverse_stiffness"], 2, why_missing=why),
                "Yarn gives way, % of d": number(numbers["penetration_share"], 1, why_missing=why),
                "Wall, s": number(numbers["wall"], 2, why_missing=why),
                "Outcome": escape(row.result.outcome.name.lower().replace("_", " ")),
                "Message": remark(row.result.message),
            }
        )
    return html_table(cells, "All runs", 1)
