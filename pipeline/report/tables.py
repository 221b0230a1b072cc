"""The report's numbers: data frames, and those as CSV, JSON and HTML. Everything is computed from the results tree."""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import fields
from html import escape
from itertools import groupby
from statistics import median
from typing import Any

import pandas as pd
import xarray as xr

from models.outcome import SOLVED
from pipeline.records import Comparison, Quantity

DECIMALS = {Quantity.TENSION_AB: 2, Quantity.TWIST_AB: 0, Quantity.THETA_B: 2}
NAMES = {Quantity.TENSION_AB: "tension", Quantity.TWIST_AB: "twist", Quantity.THETA_B: "angle"}
NO_MEASUREMENT = "not measured"
NO_BOUND = "reported, not bounded"
NOT_PUBLISHED = "not published"
_FIELDS = [field.name for field in fields(Comparison)]


def cases(tree: xr.DataTree) -> list[str]:
    """Names of the cases, in the study's order."""
    return [str(case) for case in tree["comparison"].to_dataset()["case"].values]


def models(tree: xr.DataTree) -> list[str]:
    """Names of the models, in the study's order."""
    return [str(model) for model in tree["comparison"].to_dataset()["model"].values]


def comparisons(tree: xr.DataTree) -> list[Comparison]:
    """Read the comparison rows back, by case, then quantity, then model."""
    found = []
    names = [name for name in _FIELDS if name not in ("case", "quantity", "model")]
    grids = {}
    for quantity in Quantity:
        group = tree[f"comparison/{quantity}"].to_dataset()
        grids[quantity] = {name: group[name].broadcast_like(group["S"]).values.tolist() for name in names}
    for i, case in enumerate(cases(tree)):
        for quantity, grid in grids.items():
            for j, model in enumerate(models(tree)):
                row: dict[str, Any] = {name: column[i][j] for name, column in grid.items()}
                if row["outcome"]:  # empty where this model was not asked about this case
                    row["missing_u"] = tuple(row["missing_u"].split())
                    found.append(Comparison(case=case, quantity=quantity, model=model, **row))
    return found


def error_below_u_val(row: Comparison) -> bool | None:
    """Whether |E| < u_val: the comparison cannot tell the error from the uncertainty. None where that is not known."""
    if math.isnan(row.E) or math.isnan(row.u_val):
        return None
    if abs(row.E) < row.u_val:
        return True
    return None if row.missing_u else False  # a term that is not stated could only make u_val larger


def paper(tree: xr.DataTree) -> dict[tuple[str, Quantity], tuple[float, float]]:
    """The source's own simulation by case and quantity: S and E in %, NaN where not published."""
    return {
        (case, quantity): (float(group["S"][index]), float(group["E_percent"][index]))
        for quantity in Quantity
        for group in [tree[f"published/{quantity}"].to_dataset()]
        for index, case in enumerate(cases(tree))
    }


def table2(tree: xr.DataTree) -> pd.DataFrame:
    """Table 2, one row per case, quantity and model, in edge units and full precision.

    The columns are the fields of `Comparison`, `unit`, `within` (empty where there is no bound), `E_below_u_val` (empty
    where it cannot be known), and `paper_S` and `paper_E_percent`, the source's own simulation.
    """
    published = paper(tree)
    rows = [
        {
            **_row(row),
            "missing_u": " ".join(row.missing_u),
            "unit": row.quantity.unit,
            "paper_S": published[row.case, row.quantity][0],
            "paper_E_percent": published[row.case, row.quantity][1],
        }
        for row in comparisons(tree)
    ]
    columns = [
        "case", "quantity", "unit", "M", "cv_percent", "model", "S", "E", "E_percent", "bound_percent", "within",
        "bound_reason", "u_D", "u_num", "u_input", "u_val", "missing_u", "E_below_u_val", "paper_S", "paper_E_percent",
        "outcome", "message",
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=columns).astype({"within": "boolean", "E_below_u_val": "boolean"})


def _row(row: Comparison) -> dict[str, object]:
    return {name: getattr(row, name) for name in _FIELDS} | {
        "quantity": row.quantity.value,
        "within": row.within if row.bounded else None,
        "E_below_u_val": error_below_u_val(row),
    }


def errors(tree: xr.DataTree) -> dict[str, object]:
    """What `errors.json` holds: the comparison rows with the field names of `Comparison`, and how the bounds stand."""
    rows = sorted(comparisons(tree), key=lambda row: (row.case, row.quantity, row.model))
    bounded = [row for row in rows if row.bounded]
    exceeded = [row for row in bounded if not row.within]
    return {
        "study": tree.attrs["study"],
        "synthetic": bool(tree.attrs["synthetic"]),
        "bounds": {
            "set": len(bounded),
            "hold": len(bounded) - len(exceeded),
            "exceeded": [{"case": r.case, "quantity": r.quantity.value, "model": r.model} for r in exceeded],
        },
        "rows": [
            {
                name: None if isinstance(value, float) and math.isnan(value) else value
                for name, value in _row(row).items()
            }
            for row in rows
        ],
    }


def to_json(document: object) -> str:
    """Text of a JSON file: strict (no NaN), readable, one trailing newline."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def speed_against_error(tree: xr.DataTree) -> pd.DataFrame:
    """Per model and quantity: cases, solved, rms_E_percent, max_E_percent, max_u_num_percent (of S), wall_ms (median).

    RMS and maxima are over the cases that were solved and measured; `solved` counts those.
    """
    rows = comparisons(tree)
    wall = tree["solves"].to_dataset()["wall"]
    table = []
    for index, model in enumerate(models(tree)):
        times = [float(t) for t in wall[:, index] if math.isfinite(t)]
        for quantity in Quantity:
            here = [row for row in rows if row.model == model and row.quantity is quantity]
            known = [row.E_percent for row in here if math.isfinite(row.E_percent)]
            u_num = [row.u_num / abs(row.S) * 100 for row in here if math.isfinite(row.u_num)]
            table.append(
                {
                    "model": model,
                    "quantity": quantity.value,
                    "cases": len(here),
                    "solved": len(known),
                    "rms_E_percent": math.sqrt(sum(e * e for e in known) / len(known)) if known else math.nan,
                    "max_E_percent": max(known, default=math.nan),
                    "max_u_num_percent": max(u_num, default=math.nan),
                    "wall_ms": median(times) * 1e3 if times else math.nan,
                }
            )
    return pd.DataFrame(table)


def statements(tree: xr.DataTree) -> list[str]:
    """What the report says at its top, in plain sentences, each computed from the tree."""
    rows = comparisons(tree)
    said = [_bounds_statement(rows)]
    for quantity in Quantity:
        known = [row for row in rows if row.quantity is quantity and math.isfinite(row.E_percent)]
        worst = [
            max((row for row in known if row.model == model), key=lambda row: row.E_percent)
            for model in dict.fromkeys(row.model for row in known)
        ]
        if worst:
            parts = ", ".join(f"{row.model} {row.E_percent:.1f}\u00a0% ({row.case})" for row in worst)
            said.append(f"Largest error in {NAMES[quantity]} ({quantity.symbol}): {parts}.")
    said += [_ordering_statement(rows, quantity) for quantity in (Quantity.TENSION_AB, Quantity.TWIST_AB)]
    said += [_bending_statement(rows), _ranking_statement(rows)]
    failed = {(row.model, row.case): row for row in rows if row.outcome not in SOLVED}.values()
    for row in failed:
        said.append(f"No solution: {row.model} in {row.case}: {row.outcome.replace('_', ' ')}. {row.message}")
    if not failed:
        said.append("Every solve converged.")
    said.append(f"Fitted parameters: {tree.attrs['fitted'] or 'none'}.")
    return [sentence for sentence in said if sentence]


def _bounds_statement(rows: Iterable[Comparison]) -> str:
    bounded = [row for row in rows if row.bounded]
    if not bounded:
        return "No bound is set: the errors are reported, not judged."
    exceeded = [f"{row.model}, {NAMES[row.quantity]}, {row.case}" for row in bounded if not row.within]
    text = f"{len(bounded) - len(exceeded)} of {len(bounded)} bounds hold."
    if exceeded:
        text += f" Not held: {'; '.join(exceeded)}."
    for row in bounded:
        if row.bound_reason:
            text += (
                f" An exception is made for {row.model}, {NAMES[row.quantity]}, {row.case}: error "
                f"{row.E_percent:.1f}\u00a0%, bound {row.bound_percent:g}\u00a0%; {row.bound_reason.rstrip('.')}."
            )
    return text


def _bending_statement(rows: Iterable[Comparison]) -> str:
    """Whether bending explains the printed model: the consistent rod has bending too (physics: frame term)."""
    simulated = {(row.case, row.quantity, row.model): row.S for row in rows if math.isfinite(row.S)}
    largest: dict[str, float] = {}
    for (case, quantity, model), S in simulated.items():
        flexible = simulated.get((case, quantity, "flexible"))
        if model in ("cosserat", "kirchhoff") and flexible and quantity is not Quantity.THETA_B:
            difference = abs(S / flexible - 1) * 100
            largest[model] = max(largest.get(model, 0.0), difference)
    if len(largest) < 2:
        return ""
    text = (
        f"Against the flexible model, tension and twist of the model as printed (cosserat) differ by up to "
        f"{largest['cosserat']:.1f}\u00a0%, those of a rod with the same bending stiffness and consistent frames "
        f"(kirchhoff) by up to {largest['kirchhoff']:.1f}\u00a0%."
    )
    if largest["kirchhoff"] < largest["cosserat"] / 3:
        text += (
            " What the printed model adds to the flexible one is therefore mostly not bending: it uses the yarn's "
            "material twist where the torsion of its path belongs."
        )
    return text


def _ordering_statement(rows: Iterable[Comparison], quantity: Quantity) -> str:
    """The paper's Figure 13: flexible above, Cosserat below the measured tension; the reverse in twist."""
    simulated = {(row.case, row.model): row.S for row in rows if row.quantity is quantity and math.isfinite(row.S)}
    measured = {row.case: row.M for row in rows if row.quantity is quantity}
    pairs = [
        (simulated[case, "flexible"], M, simulated[case, "cosserat"])
        for case, M in measured.items()
        if (case, "flexible") in simulated and (case, "cosserat") in simulated
    ]
    if not pairs:
        return ""
    above = sum(flexible > cosserat for flexible, _, cosserat in pairs)
    below = sum(flexible < cosserat for flexible, _, cosserat in pairs)
    between = sum(min(flexible, cosserat) <= M <= max(flexible, cosserat) for flexible, M, cosserat in pairs)
    return (
        f"Figure 13, {NAMES[quantity]} (cases that both models solve: {len(pairs)}): the flexible model is above the "
        f"Cosserat model in {above} and below it in {below}; the measurement lies between the two in {between}."
    )


def _ranking_statement(rows: Iterable[Comparison]) -> str:
    unranked: dict[tuple[str, Quantity], list[str]] = {}
    for row in rows:
        if error_below_u_val(row):
            unranked.setdefault((row.case, row.quantity), []).append(row.model)
    together: dict[tuple[str, str], list[str]] = {}
    for (case, quantity), names in unranked.items():
        if len(names) >= 2:
            together.setdefault((case, ", ".join(names)), []).append(NAMES[quantity])
    if not together:
        return "In no case is the error of two models smaller than the validation uncertainty u_val."
    parts = "; ".join(f"{case}, {_and(what)} ({names})" for (case, names), what in together.items())
    return (
        "Table 2 alone cannot rank the models named here, because the error |E| of each is smaller than its validation "
        f"uncertainty u_val: {parts}."
    )


def _and(words: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def number(value: float, decimals: int, *, why_missing: str, signed: bool = False) -> str:
    """A rounded number as HTML that keeps its full precision in `value`; where there is none, a dash that says why."""
    if math.isnan(value):
        return dash(why_missing)
    text = f"{value:{'+' if signed else ''}.{decimals}f}".replace("-", "−")
    return f'<data value="{value!r}">{text}</data>'


def dash(why: str) -> str:
    """A dash as HTML that says why there is no number."""
    return f'<abbr title="{escape(why)}">–</abbr>'


def _verdict(value: bool | None, why_missing: str) -> str:
    return dash(why_missing) if value is None else "yes" if value else "no"


def remark(text: str) -> str:
    """Words in a cell that may take several lines."""
    return f'<div class="remark">{escape(text)}</div>'


def html_table(rows: Sequence[dict[str, str]], caption: str, headers: int) -> str:
    """Table whose first `headers` columns head its rows, merged where they repeat, in a container that scrolls.

    Cells are HTML already. No two rows may have the same heads.
    """
    columns = list(rows[0]) if rows else []
    text = [not any("<data" in row[column] for row in rows) for column in columns]
    lines = []

    def cell(tag: str, index: int, content: str, attributes: str = "") -> str:
        kind = ' class="text"' if text[index] else ""
        return f"<{tag}{kind}{attributes}>{content}</{tag}>"

    def emit(block: list[list[str]], depth: int, start: list[str]) -> None:
        if depth == headers:
            values = [cell("td", index, block[0][index]) for index in range(depth, len(columns))]
            lines.append(f"<tr>{''.join(start + values)}</tr>")
            return
        for content, group in groupby(block, key=lambda row: row[depth]):
            inner = list(group)
            span = f' rowspan="{len(inner)}" scope="rowgroup"' if len(inner) > 1 else ' scope="row"'
            emit(inner, depth + 1, [*start, cell("th", depth, content, span)])
            start = []  # a merged header stands in its first row only

    emit([list(row.values()) for row in rows], 0, [])
    names = "".join(cell("th", index, escape(name), ' scope="col"') for index, name in enumerate(columns))
    return (
        f'<div class="scroll" role="region" tabindex="0" aria-label="{escape(caption)}"><table>'
        f"<caption>{escape(caption)}</caption><thead><tr>{names}</tr></thead><tbody>{chr(10).join(lines)}</tbody>"
        "</table></div>"
    )


def _label(quantity: Quantity) -> str:
    return f"{NAMES[quantity]} {quantity.symbol} ({quantity.unit})"


def table2_html(tree: xr.DataTree) -> str:
    """Table 2 for the page: per case and quantity, the measurement and every model against it."""
    published = paper(tree)
    cells = []
    for row in comparisons(tree):
        decimals = DECIMALS[row.quantity]
        unsolved = NO_MEASUREMENT if row.outcome in SOLVED else f"no solution: {row.message}"
        unstated = f"not stated: {', '.join(row.missing_u)}"
        bound = number(row.bound_percent, 1, why_missing=NO_BOUND)
        verdict = _verdict(row.within if row.bounded else None, NO_BOUND)
        paper_S, paper_E = published[row.case, row.quantity]
        cells.append(
            {
                "Case": escape(row.case),
                "Quantity": _label(row.quantity),
                "M": number(row.M, decimals, why_missing=NO_MEASUREMENT),
                "CV %": number(row.cv_percent, 2, why_missing=NOT_PUBLISHED),
                "Paper S": number(paper_S, decimals, why_missing=NOT_PUBLISHED),
                "Paper E %": number(paper_E, 2, why_missing=NOT_PUBLISHED),
                "Model": escape(row.model),
                "S": number(row.S, decimals, why_missing=unsolved),
                "E = S − M": number(row.E, decimals, why_missing=unsolved, signed=True),
                "|E|/M %": number(row.E_percent, 2, why_missing=unsolved),
                "Bound %": bound + (f'<abbr title="{escape(row.bound_reason)}">*</abbr>' if row.bound_reason else ""),
                "Within": f'<strong class="no">{verdict}</strong>' if verdict == "no" else verdict,
                "u_val": (f'<abbr title="{escape(unstated)}">≥</abbr> ' if row.missing_u else "")
                + number(row.u_val, decimals, why_missing=unsolved),
                "|E| < u_val": _verdict(error_below_u_val(row), unstated if row.missing_u else unsolved),
            }
        )
    return html_table(cells, "Table 2. Models (S) against measurement (M)", 7)


def speed_html(tree: xr.DataTree) -> str:
    """Accuracy and speed of each model."""
    cells = [
        {
            "Model": escape(row["model"]),
            "Median solve, ms": number(row["wall_ms"], 3, why_missing="not timed"),
            "Quantity": _label(Quantity(row["quantity"])),
            "Solved": f"{row['solved']} of {row['cases']}",
            "RMS |E| %": number(row["rms_E_percent"], 2, why_missing="no case solved and measured"),
            "Largest |E| %": number(row["max_E_percent"], 2, why_missing="no case solved and measured"),
            "Largest u_num %": number(row["max_u_num_percent"], 6, why_missing="not estimated"),
        }
        for row in speed_against_error(tree).to_dict(orient="records")
    ]
    return html_table(cells, "Accuracy and speed of the models", 3)


def measured_html(tree: xr.DataTree) -> str:
    """What was measured, with spread, uncertainty and sample counts."""
    cells = []
    for case in cases(tree):
        for quantity in Quantity:
            row = tree[f"comparison/{quantity}"].to_dataset().sel(case=case)
            why = str(row["reason"].item()) or NOT_PUBLISHED
            decimals = DECIMALS[quantity]
            cells.append(
                {
                    "Case": escape(case),
                    "Quantity": _label(quantity),
                    "Mean": number(float(row["M"]), decimals, why_missing=why),
                    "CV %": number(float(row["cv_percent"]), 2, why_missing=NOT_PUBLISHED),
                    "u": number(float(row["u_D"]), decimals + 1, why_missing=why),
                    "Samples": number(float(row["n"]), 0, why_missing=why),
                    "Effective": number(float(row["n_eff"]), 1, why_missing=why),
                    "Remark": remark(str(row["reason"].item())),
                }
            )
    return html_table(cells, "Measured values", 2)


def solves_html(tree: xr.DataTree) -> str:
    """Every solve with its outcome and its numerical evidence; failed solves keep their row."""
    solves = tree["solves"].to_dataset()
    cells = []
    for case in cases(tree):
        for model in models(tree):
            row = solves.sel(case=case, model=model)
            outcome = str(row["outcome"].item())
            if not outcome:
                continue
            why = f"no solution: {row['message'].item()}"
            cells.append(
                {
                    "Case": escape(case),
                    "Model": escape(model),
                    "Outcome": escape(outcome.replace("_", " ")),
                    "Iterations": number(float(row["iterations"]), 0, why_missing=why),
                    "Residual": _scientific(float(row["residual"]), why),
                    "θ_C (°)": number(math.degrees(row["theta_C"]), 2, why_missing=why),
                    "n₁ (1/s)": number(float(row["rotation"]), 2, why_missing=why),
                    "Smallest N (N/m)": number(float(row["normal_force_min"]), 1, why_missing=why),
                    "Wall, ms": number(float(row["wall"]) * 1e3, 3, why_missing="not timed"),
                    "Message": remark(str(row["message"].item())),
                }
            )
    return html_table(cells, "Solves and their numerical evidence", 2)


def _scientific(value: float, why_missing: str) -> str:
    if math.isnan(value):
        return dash(why_missing)
    return f'<data value="{value!r}">{value:.1e}</data>'


def summary_html(tree: xr.DataTree) -> str:
    """The statements as a list, with the source and the notes of the study."""
    items = "".join(f"<li>{escape(text)}</li>" for text in statements(tree))
    notes = "".join(f"<p>{escape(note)}</p>" for note in json.loads(tree.attrs["notes"]))
    return f'<p class="source">{escape(tree.attrs["source"])}</p><ul class="summary">{items}</ul>{notes}'


def provenance_html(tree: xr.DataTree) -> str:
    """Inputs, versions and settings, as in provenance.json."""
    text = to_json(json.loads(tree.attrs["provenance"]))
    return f'<div class="scroll" role="region" tabindex="0" aria-label="Provenance"><pre>{escape(text)}</pre></div>'
