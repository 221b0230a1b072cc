"""The results tree: nothing is lost on the way in, to the file, or back."""

import math
from dataclasses import astuple, replace

import numpy as np
import pytest
import report_study
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline import store
from pipeline.errors import InputError
from pipeline.records import Comparison, Quantity
from pipeline.report import tables


def same(a: Comparison, b: Comparison) -> bool:
    return all(
        x == y or (isinstance(x, float) and math.isnan(x) and math.isnan(y))
        for x, y in zip(astuple(a), astuple(b), strict=True)
    )


def test_file_gives_back_the_same_tree_and_the_same_bytes(tree, tmp_path):
    store.write_tree(tree, tmp_path / "a.nc")
    store.write_tree(tree, tmp_path / "b.nc")
    assert store.read_tree(tmp_path / "a.nc").identical(tree)
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_every_number_has_a_unit_and_every_flag_its_meaning(tree):
    checked = 0
    for node in tree.subtree:
        for name, variable in node.to_dataset(inherit=False).variables.items():
            if variable.dtype.kind not in "iuf":
                continue
            checked += 1
            if "flag_meanings" in variable.attrs:
                coded = variable.attrs.get("flag_masks", variable.attrs.get("flag_values"))
                assert len(coded) == len(variable.attrs["flag_meanings"].split())
                assert coded.dtype == variable.dtype
            else:
                assert variable.attrs["units"], f"{node.path}/{name}"
    assert checked > 100


def test_raw_series_and_flags_are_kept_as_recorded(tree, results):
    log, data = results.measured[1].tension[0], tree["measured/raw-1/tension_0"]
    np.testing.assert_array_equal(data["tension"], log.raw.tension)
    np.testing.assert_array_equal(data["flag"], log.raw.flag)
    assert data.attrs["sha256"] == log.raw.source.sha256
    assert data["mean"].attrs["standard_uncertainty"] == log.estimate.u
    clip, data = results.measured[1].yarn[1], tree["measured/raw-1/yarn_1"]
    np.testing.assert_array_equal(data["twist"], clip.twist)
    assert np.isnan(data["summary_twist"])
    assert data["summary_twist"].attrs["reason"] == clip.reason
    np.testing.assert_array_equal(data["thumbnail"][2], clip.thumbnails[2].image)


def test_solves_and_profiles_are_in_si_and_a_failed_solve_keeps_its_place(tree, results):
    first = results.predictions[1]
    row = tree["solves"].to_dataset().sel(case=first.case, model=first.solution.model)
    assert float(row["tension_AB"]) == first.solution.ends.tension_AB
    assert float(row["u_input_twist_AB"]) == first.u_input.twist_AB
    assert float(row["wall"]) == first.wall
    assert float(row["iterations"]) == first.solution.stats.iterations
    np.testing.assert_array_equal(tree["profiles/published-1/flexible"]["theta"], first.solution.profile.theta)
    failed = tree["solves"].to_dataset().sel(case="raw-1", model="cosserat")
    assert np.isnan(failed["tension_AB"])
    assert failed["outcome"] == "not_converged"
    assert failed["message"] == report_study.FAILURE
    assert "theta" not in tree["profiles/raw-1/cosserat"]


def test_comparison_rows_come_back_as_they_went_in(tree, results):
    back = tables.comparisons(tree)
    assert len(back) == len(results.comparisons)
    assert all(same(a, b) for a, b in zip(back, results.comparisons, strict=True))


numbers = st.one_of(st.just(math.nan), st.floats(allow_nan=False, allow_infinity=False))


@settings(max_examples=20, deadline=None)
@given(M=numbers, S=numbers, u_val=numbers, bound=numbers)
def test_any_row_comes_back_as_it_went_in(M, S, u_val, bound):
    row = report_study.comparison("raw-1", Quantity.TWIST_AB, "flexible")
    row = replace(row, M=M, S=S, u_val=u_val, bound_percent=bound, missing_u=("u_D", "u_num"))
    (back,) = tables.comparisons(store.to_tree(replace(report_study.published_only(), comparisons=(row,))))
    assert same(back, row)


def test_a_missing_file_is_said_in_one_line(tmp_path):
    with pytest.raises(InputError, match=r"results\.nc: no such file; .*yarnval report") as caught:
        store.read_tree(tmp_path / "results.nc")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kept", [0, 100, 5000, 200_000])
def test_a_truncated_file_is_said_in_one_line(tree, tmp_path, kept):
    path = tmp_path / "results.nc"
    store.write_tree(tree, path)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(InputError, match="truncated or not a NetCDF 4 file"):
        store.read_tree(path)


def test_a_foreign_file_is_refused(tmp_path):
    xr.Dataset({"x": ("t", [1.0, 2.0])}).to_netcdf(tmp_path / "other.nc", engine="netcdf4")
    with pytest.raises(InputError, match="format None; 'yarnval results 1'"):
        store.read_tree(tmp_path / "other.nc")
