"""The results that are kept as reference are what the code gives today (`yarnval report data_samples/yin2020`)."""

import csv
import math
from pathlib import Path

import pytest

from pipeline.case import load_study
from pipeline.check import read_errors
from pipeline.records import Quantity
from pipeline.run import evaluate

ROOT = Path(__file__).parents[2]
ACCEPTED = ROOT / "reports/accepted/yin2020"


@pytest.fixture(scope="module")
def today():
    results = evaluate(load_study(ROOT / "data_samples/yin2020"))
    return {(row.case, row.quantity, row.model): row for row in results.comparisons}


def test_accepted_errors(today):
    study, rows = read_errors(ACCEPTED)
    assert study == "yin2020"
    assert {(row.case, row.quantity, row.model) for row in rows} == set(today)
    for row in rows:
        now = today[row.case, row.quantity, row.model]
        assert (now.outcome, now.within, now.missing_u) == (row.outcome, row.within, row.missing_u)
        for name in ("M", "S", "E", "E_percent", "u_D", "u_input", "u_val", "cv_percent", "bound_percent"):
            found, kept = getattr(now, name), getattr(row, name)
            assert found == pytest.approx(kept, rel=1e-6, nan_ok=True), (row.case, row.model, name)


def test_accepted_table_holds_the_same_numbers():
    _, rows = read_errors(ACCEPTED)
    table = {
        (r["case"], r["quantity"], r["model"]): r
        for r in csv.DictReader((ACCEPTED / "table2.csv").read_text().splitlines())
    }
    assert len(table) == len(rows)
    for row in rows:
        line = table[row.case, row.quantity.value, row.model]
        assert float(line["S"]) == row.S
        assert float(line["E_percent"]) == row.E_percent


def test_input_uncertainty_of_the_printed_model(today):
    # From Table 1's CVs on T_CD, p₃CD and K, worked out before this code was written: cN, tpm.
    expected = {"case1": (0.95, 156), "case2": (0.81, 131), "case3": (0.93, 124)}
    for case, (tension, twist) in expected.items():
        assert today[case, Quantity.TENSION_AB, "cosserat"].u_input == pytest.approx(tension, rel=0.02)
        assert today[case, Quantity.TWIST_AB, "cosserat"].u_input == pytest.approx(twist, rel=0.01)


def test_table_2_alone_does_not_rank_the_models_in_case_1(today):
    for model in ("flexible", "cosserat"):
        row = today["case1", Quantity.TENSION_AB, model]
        assert abs(row.E) < row.u_val


def test_flexible_above_cosserat_below_the_measured_tension(today):
    for case in ("case1", "case2", "case3"):
        flexible, cosserat = (today[case, Quantity.TENSION_AB, m] for m in ("flexible", "cosserat"))
        assert flexible.S > flexible.M > cosserat.S
        twist = [today[case, Quantity.TWIST_AB, m].S for m in ("flexible", "cosserat")]
        assert twist[0] < twist[1]


def test_only_the_printed_model_is_bounded(today):
    for (_, _, model), row in today.items():
        assert row.bounded == (model == "cosserat")
        assert math.isnan(row.bound_percent) == (model != "cosserat")
