"""The report's numbers and sentences, against the made-up study whose answers are known by hand."""

import json
import math
import re
from dataclasses import replace

import pytest
import report_study

from pipeline import store
from pipeline.records import Quantity
from pipeline.report import tables


def test_table2_holds_every_row_in_full_precision(tree, results):
    table = tables.table2(tree)
    assert len(table) == len(results.comparisons) == 24
    row = table[(table.case == "published-1") & (table.quantity == "p3_AB_cN") & (table.model == "kirchhoff")].iloc[0]
    assert (row.M, row.cv_percent, row.S, row.unit) == (10.0, 5.0, 10.9, "cN")
    assert row.E == 10.9 - 10.0
    assert (row.paper_S, row.paper_E_percent) == (9.6, 4.0)
    failed = table[(table.case == "raw-1") & (table.model == "cosserat")]
    assert len(failed) == 3
    assert failed.S.isna().all()
    assert (failed.message == report_study.FAILURE).all()
    assert not failed.within.any()


def test_within_is_empty_where_there_is_no_bound(tree):
    table = tables.table2(tree)
    assert table[table.model == "kirchhoff"].within.isna().all()
    assert table[table.model == "flexible"].within.all()


@pytest.mark.parametrize(
    ("E", "u_val", "missing", "expected"),
    [
        (0.5, 1.0, (), True),
        (-0.5, 1.0, (), True),
        (1.0, 1.0, (), False),
        (-2.0, 1.0, (), False),
        (2.0, 1.0, ("u_D",), None),  # the unstated term might be the larger one
        (0.5, 1.0, ("u_D",), True),
        (math.nan, 1.0, (), None),
        (1.0, math.nan, (), None),
    ],
)
def test_whether_the_error_can_be_told_from_the_uncertainty(E, u_val, missing, expected):
    row = report_study.comparison("raw-1", Quantity.TENSION_AB, "flexible")
    assert tables.error_below_u_val(replace(row, E=E, u_val=u_val, missing_u=missing)) is expected


def test_errors_json_is_strict_sorted_and_counts_the_bounds(tree):
    document = json.loads(tables.to_json(tables.errors(tree)), parse_constant=pytest.fail)
    assert document["study"] == "made-up"
    assert document["synthetic"] is True
    assert (document["bounds"]["set"], document["bounds"]["hold"]) == (12, 8)
    assert {"case": "published-1", "quantity": "theta_B_deg", "model": "cosserat"} in document["bounds"]["exceeded"]
    keys = [(row["case"], row["quantity"], row["model"]) for row in document["rows"]]
    assert keys == sorted(keys)
    assert len(keys) == 24
    failed = next(r for r in document["rows"] if (r["case"], r["model"]) == report_study.FAILED)
    assert failed["S"] is None
    assert failed["E_percent"] is None
    assert failed["within"] is False
    assert failed["missing_u"] == []


def test_speed_against_error_is_computed_over_the_solved_cases(tree):
    table = tables.speed_against_error(tree).set_index(["model", "quantity"])
    flexible = table.loc[("flexible", "p3_AB_cN")]
    errors = [10.0, 100 * 0.5 / 12]
    assert flexible.rms_E_percent == pytest.approx(math.sqrt(sum(e * e for e in errors) / 2), rel=1e-14)
    assert flexible.max_E_percent == 10.0
    assert flexible.wall_ms == pytest.approx(0.4)
    assert flexible.max_u_num_percent == pytest.approx(0.001 / 11 * 100)
    cosserat = table.loc[("cosserat", "p3_AB_cN")]
    assert (cosserat.cases, cosserat.solved, cosserat.rms_E_percent) == (2, 1, 5.0)


def test_statements_say_what_the_tree_says(tree):
    said = "\n".join(tables.statements(tree))
    assert "8 of 12 bounds hold. Not held: cosserat, angle, published-1; cosserat, tension, raw-1" in said
    assert "Largest error in twist (T_AB): capstan 12.5\u00a0% (raw-1), flexible 5.0\u00a0% (published-1)" in said
    assert (
        "Figure 13, tension (cases that both models solve: 1): the flexible model is above the Cosserat model in 1 and "
        "below it in 0; the measurement lies between the two in 1."
    ) in said
    assert (
        "Figure 13, twist (cases that both models solve: 1): the flexible model is above the Cosserat model in 0"
        in said
    )
    assert "published-1, tension, twist and angle (flexible, cosserat, kirchhoff)" in said
    assert f"No solution: cosserat in raw-1: not converged. {report_study.FAILURE}" in said


def test_bending_statement_draws_its_conclusion_from_the_numbers(results):
    def said(factor: float) -> str:
        rows = [replace(c, S=c.S * factor) if c.model == "kirchhoff" else c for c in results.comparisons]
        return "\n".join(tables.statements(store.to_tree(replace(results, comparisons=tuple(rows)))))

    assert "(cosserat) differ by up to 13.6\u00a0%" in said(1.0)
    assert "(kirchhoff) by up to 1.0\u00a0%. What the printed model adds" in said(1.0)
    assert "What the printed model adds" not in said(0.9)


def test_statements_name_an_exception_to_a_bound(results):
    rows = list(results.comparisons)
    i = next(i for i, c in enumerate(rows) if c.bounded and c.within)
    rows[i] = replace(rows[i], bound_reason="the source says so")
    said = tables.statements(store.to_tree(replace(results, comparisons=tuple(rows))))
    assert f"An exception is made for {rows[i].model}" in said[0]
    assert "the source says so" in said[0]


def test_statements_follow_the_numbers(results):
    # The same study with the two models' tensions exchanged and no uncertainty says the opposite.
    swap = {"flexible": "cosserat", "cosserat": "flexible"}
    rows = tuple(replace(c, model=swap.get(c.model, c.model), u_val=0.0, missing_u=()) for c in results.comparisons)
    said = "\n".join(tables.statements(store.to_tree(replace(results, comparisons=rows))))
    assert "the flexible model is above the Cosserat model in 0 and below it in 1" in said.split("Figure 13, twist")[0]
    assert "In no case is the error of two models smaller" in said


def test_statements_without_bounds_and_failures():
    results = report_study.published_only()
    rows = tuple(replace(c, bound_percent=math.nan) for c in results.comparisons)
    said = tables.statements(store.to_tree(replace(results, comparisons=rows)))
    assert said[0] == "No bound is set: the errors are reported, not judged."
    assert "Every solve converged." in said
    assert not any("Figure 13" in sentence for sentence in said)


def test_html_table_carries_the_full_numbers_and_the_reasons(tree):
    html = tables.table2_html(tree)
    table = tables.table2(tree)
    values = [float(v) for v in re.findall(r'<data value="([^"]+)">', html)]
    for column in ("S", "E", "E_percent", "u_val", "bound_percent"):
        assert set(table[column].dropna()) <= set(values)
    assert 'title="not published">–' in html
    assert 'title="no solution: residual 0.5 after 50 iterations &lt;tol 1e-9&gt;">–' in html
    assert "<tol" not in html
    assert 'title="the published mean is itself a reading">*' in html
    assert "nan" not in html.lower()


def test_html_numbers_are_rounded_and_signed():
    assert tables.number(-1.0049, 2, why_missing="", signed=True) == '<data value="-1.0049">−1.00</data>'
    assert tables.number(0.5, 1, why_missing="", signed=True) == '<data value="0.5">+0.5</data>'
    assert tables.number(math.nan, 1, why_missing='a "b"') == '<abbr title="a &quot;b&quot;">–</abbr>'


def test_every_row_of_a_html_table_fills_the_same_columns(tree):
    for html in (
        tables.table2_html(tree),
        tables.speed_html(tree),
        tables.measured_html(tree),
        tables.solves_html(tree),
    ):
        assert len({len(row) for row in _grid(html)}) == 1


def _grid(html: str) -> list[list[str]]:
    """Lay the cells out as a browser does, row spans filled in."""
    rows: list[list[str]] = []
    pending: dict[int, int] = {}
    for line in re.findall(r"<tr>(.*?)</tr>", html, flags=re.DOTALL):
        cells = iter(re.findall(r"<t[hd]([^>]*)>", line))
        row: list[str] = []
        while True:
            if pending.get(len(row), 0):
                pending[len(row)] -= 1
                row.append("")
                continue
            cell = next(cells, None)
            if cell is None:
                break
            span = re.search(r'rowspan="(\d+)"', cell)
            pending[len(row)] = int(span[1]) - 1 if span else 0
            row.append(cell)
        rows.append(row)
    return rows


def test_summary_escapes_what_the_study_says(tree):
    html = tables.summary_html(tree)
    assert "&lt;tol 1e-9&gt;" in html
    assert "<a " not in html
