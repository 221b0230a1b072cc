"""Solved numbers against references: two independent solutions of the same equations, and the paper's Table 2."""

import math

import pytest
from scenes import scene, table_1

from models.solve import MODELS

# φ = 60°, p₃CD = 600, T_CD = 1, R₀ = 0.03, μ = 0.8, v_b = v, k = η = 1: p₃AB, T_AB, θ_B (°), solved twice,
# independently, before this code was written.
BASE = {
    "flexible": (338.2986, 2.234536, 73.09866),
    "cosserat": (321.2447, 2.334876, 72.98503),
    "kirchhoff": (339.4486, 2.233577, 73.54984),
}
# Table 1 with k = η = 1: cN, tpm, °.
CASES = {
    ("cosserat", 1): (9.528, 1179.2, 73.48),
    ("cosserat", 2): (9.702, 970.0, 72.68),
    ("cosserat", 3): (13.724, 1093.5, 72.51),
    ("flexible", 1): (11.501, 1092.5, 73.23),
    ("flexible", 2): (10.256, 918.3, 72.62),
    ("flexible", 3): (14.424, 1031.2, 72.50),
}
# Table 2, column S (Yin, Tao, Jasper 2020).
PAPER = {1: (9.61, 1180, 73.09), 2: (9.71, 966, 72.66), 3: (13.79, 1091, 72.46)}


def solved(model: str, case: int) -> tuple[float, float, float]:
    ends = MODELS[model](table_1(case)).require().ends
    return ends.tension_AB * 100, ends.twist_AB, math.degrees(ends.theta_B)


@pytest.mark.parametrize("model", BASE)
def test_base_scene(model: str) -> None:
    ends = MODELS[model](scene()).require().ends
    assert (ends.tension_AB, ends.twist_AB, math.degrees(ends.theta_B)) == pytest.approx(BASE[model], rel=2e-6)


@pytest.mark.parametrize(("model", "case"), CASES)
def test_table_1(model: str, case: int) -> None:
    assert solved(model, case) == pytest.approx(CASES[model, case], rel=1e-4)


@pytest.mark.parametrize("case", PAPER)
def test_cosserat_reproduces_the_papers_simulation(case: int) -> None:
    assert solved("cosserat", case) == pytest.approx(PAPER[case], rel=0.01)


@pytest.mark.parametrize("case", PAPER)
def test_fig_13_ordering(case: int) -> None:
    flexible, cosserat = solved("flexible", case), solved("cosserat", case)
    assert flexible[0] > cosserat[0]
    assert flexible[1] < cosserat[1]


@pytest.mark.parametrize("case", PAPER)
def test_the_consistent_rod_stays_within_one_percent_of_the_flexible_yarn(case: int) -> None:
    assert solved("kirchhoff", case) == pytest.approx(solved("flexible", case), rel=0.01)


@pytest.mark.parametrize("case", PAPER)
def test_finite_differences_agree_with_collocation(case: int) -> None:
    assert solved("cosserat-fd", case) == pytest.approx(solved("cosserat", case), rel=1e-3)
