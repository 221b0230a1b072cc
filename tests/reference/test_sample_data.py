"""The shipped studies are what their README says."""

import hashlib
import re
from pathlib import Path

import pandas as pd
import pytest

from pipeline.case import load_study
from pipeline.records import Quantity
from pipeline.run import measure

DATA = Path(__file__).parents[2] / "data_samples"


def test_raw_files_have_the_stated_sums():
    stated = dict(
        line.split()[::-1] for line in (DATA / "README.md").read_text().splitlines() if re.match("[0-9a-f]{64} ", line)
    )
    files = {str(p.relative_to(DATA)) for p in DATA.glob("rig/*/*") if p.suffix != ".toml"}
    assert set(stated) == files
    for name, digest in stated.items():
        assert hashlib.sha256((DATA / name).read_bytes()).hexdigest() == digest, name
    assert sum(p.stat().st_size for p in DATA.glob("rig/*/*")) < 25e6


# Yin, Tao, Jasper 2020, Table 2: M [CV %], S, E. CVs that are not clearly legible are missing there and here.
TABLE_2 = {
    ("case1", Quantity.TENSION_AB): (10.61, 7.22, 9.61, 9.43),
    ("case1", Quantity.TWIST_AB): (1217, 14.22, 1180, 3.04),
    ("case1", Quantity.THETA_B): (77.9, 15.89, 73.09, 6.17),
    ("case2", Quantity.TENSION_AB): (10.03, None, 9.71, 3.19),
    ("case2", Quantity.TWIST_AB): (943, 14.57, 966, 2.44),
    ("case2", Quantity.THETA_B): (76.7, None, 72.66, 5.27),
    ("case3", Quantity.TENSION_AB): (14.07, None, 13.79, 1.99),
    ("case3", Quantity.TWIST_AB): (1157, 15.41, 1091, 5.70),
    ("case3", Quantity.THETA_B): (77.9, None, 72.46, 6.98),
}


@pytest.mark.parametrize(("case", "quantity"), TABLE_2)
def test_published_study_holds_table_2(case, quantity):
    found = next(c for c in load_study(DATA / "yin2020").cases if c.name == case)
    mean, cv, S, E = TABLE_2[case, quantity]
    assert found.measured is not None
    estimate = found.measured.values[quantity]
    assert estimate.mean * quantity.per_si == pytest.approx(mean, rel=1e-12)
    assert estimate.cv * 100 == pytest.approx(cv if cv is not None else float("nan"), nan_ok=True)
    assert (found.published[quantity].S, found.published[quantity].E_percent) == (S, E)
    # the paper's own E is |S − M| / M of its own numbers, to its rounding
    assert abs(S - mean) / mean * 100 == pytest.approx(E, abs=0.06)


def test_synthetic_study_says_so():
    rig, paper = load_study(DATA / "rig"), load_study(DATA / "yin2020")
    assert rig.synthetic
    assert "SYNTHETIC" in rig.title
    assert not paper.synthetic
    assert not rig.fitted
    assert not paper.fitted


@pytest.fixture(scope="module")
def rig():
    return {case.name: (case, measure(case)) for case in load_study(DATA / "rig").cases}


TRUTH = pd.read_csv(DATA.parent / "tests/truth/rig.csv").groupby("case")
TENSION = {"case1": 10.61, "case2": 10.03, "case3": 14.07}


@pytest.mark.parametrize("name", TENSION)
def test_rig_is_measured_to_its_truth(rig, name):
    case, measured = rig[name]
    truth = TRUTH.get_group(name)
    found = {q: measured.values[q].mean * q.per_si for q in Quantity}
    assert found[Quantity.THETA_B] == pytest.approx(truth["theta_B_deg"].mean(), abs=0.1)
    assert found[Quantity.TWIST_AB] == pytest.approx(truth["twist_tpm"].mean(), rel=0.02)
    assert measured.diameter.mean * 1e3 == pytest.approx(truth["diameter_mm"].mean(), rel=0.02)
    tension = measured.values[Quantity.TENSION_AB]
    assert abs(tension.mean * 100 - TENSION[name]) < tension.u * 100
    # the record was made to show its mean exactly, so what is left is the meter's step (0.1 cN) and rounding
    assert found[Quantity.TENSION_AB] == pytest.approx(TENSION[name], abs=0.003)
    assert all(clip.handedness == "Z" for clip in measured.yarn)
    assert not any(clip.flag.any() for clip in measured.yarn)
    assert case.scene.twist_CD > 0
