"""`yarnval wind --calibrate`: known values found again from synthetic measurements, by fit and by command."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import winding_study

from models.winding.calibrate import calibrate_to_layers, calibrate_to_span
from models.winding.fast import wind_fast
from models.winding.scene import WindingScene
from pipeline.winding.calibration import read_layers
from pipeline.winding.study import load_winding

TRUE_STIFFNESS, TRUE_RELAXATION = 1e6, 0.3


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return winding_study.write(tmp_path, winding_study.SMALL.replace("duration_s = 0.4", "duration_s = 0.6"))


@pytest.fixture
def scene(file) -> WindingScene:
    return load_winding(file, only="coarse, 1000 r/min").cases[0].scene


@pytest.fixture
def truth(scene) -> WindingScene:
    return replace(scene, transverse_stiffness=TRUE_STIFFNESS, prony_weights=(TRUE_RELAXATION, 0.0))


def test_both_parameters_are_found_again_from_a_profile(scene, truth):
    profile = wind_fast(truth, "truth").layers_T_over_T0
    assert profile.size >= 4
    found = calibrate_to_layers(scene, profile)
    stiffness, relaxation = found.fitted
    assert stiffness.value == pytest.approx(TRUE_STIFFNESS, rel=2e-3)
    assert relaxation.value == pytest.approx(TRUE_RELAXATION, abs=2e-3)
    assert found.converged
    assert found.rms_after < 1e-4 < found.rms_before
    assert found.scene.transverse_stiffness == stiffness.value
    assert wind_fast(found.scene, "again").layers_T_over_T0 == pytest.approx(profile, abs=1e-4)


def test_noise_makes_the_fit_uncertain(scene, truth):
    profile = wind_fast(truth, "truth").layers_T_over_T0
    noise = 0.02 * np.random.default_rng(2).normal(size=profile.size)
    (stiffness,) = calibrate_to_layers(scene, profile + noise, ["transverse_stiffness"]).fitted
    assert stiffness.u > 0.01 * stiffness.value
    assert stiffness.value == pytest.approx(TRUE_STIFFNESS, rel=0.5)


def noisy(tension):
    """With the noise of a good meter, 0.5 % of the mean."""
    return tension + 0.005 * tension.mean() * np.random.default_rng(4).normal(size=tension.size)


def test_a_span_knows_the_modulus_and_the_guide(scene):
    other = replace(scene, axial_stiffness=1.5 * scene.axial_stiffness, guide_friction=0.1)
    result = wind_fast(other, "truth")
    found = calibrate_to_span(scene, noisy(result.span_tension[result.time > 2 * scene.speed_rise]))
    values = {fitted.name: fitted for fitted in found.fitted}
    assert values["axial_stiffness"].value == pytest.approx(other.axial_stiffness, rel=0.1)
    assert values["guide_friction"].value == pytest.approx(0.1, abs=5e-3)
    assert [name for name, fitted in values.items() if not fitted.determined] == ["relaxation"]


def test_what_a_span_does_not_know_stays_and_is_said(scene, truth):
    readings = noisy(wind_fast(truth, "truth").span_tension)
    found = calibrate_to_span(scene, readings, ["relaxation"])
    (relaxation,) = found.fitted
    assert not relaxation.determined
    assert math.isinf(relaxation.u)
    assert relaxation.value == relaxation.start == scene.prony_weights[0]
    assert found.scene == scene
    assert "determines no parameter" in found.message


def test_too_little_to_fit(scene):
    with pytest.raises(ValueError, match="2 layers: 3 to"):
        calibrate_to_layers(scene, np.array([0.9, 1.0]))
    with pytest.raises(ValueError, match="5 readings: at least 19"):
        calibrate_to_span(scene, np.full(5, 0.5))


def profile_file(folder: Path, values) -> Path:
    file = folder / "profile.csv"
    rows = "".join(f"{layer},{float(value)!r}\n" for layer, value in enumerate(values, 1))
    file.write_text(f"layer,T_over_T0\n{rows}", encoding="utf-8")
    return file


def test_the_command_fits_and_verifies(yarnval, file, tmp_path, truth):
    given = profile_file(tmp_path, wind_fast(truth, "truth").layers_T_over_T0)
    ran = yarnval(
        "wind", file, "--case", "coarse, 1000 r/min", "--calibrate", given, "--out", tmp_path / "out", "--json"
    )
    assert ran.code == 0
    document = json.loads(ran.out)
    stiffness, relaxation = document["calibration"]["parameters"]
    assert (stiffness["name"], stiffness["start"]) == ("transverse_stiffness_N_per_mm2", 24)
    assert stiffness["value"] == pytest.approx(1, rel=2e-3)
    assert relaxation["value"] == pytest.approx(TRUE_RELAXATION, abs=2e-3)
    assert document["calibration"]["rms_of_this_run"] == pytest.approx(document["calibration"]["rms_after"], abs=1e-6)
    assert len(document["cases"]) == 1
    assert document["variants"] == []
    folder = tmp_path / "out/small"
    assert (folder / "figures/calibration.svg").is_file()
    html = (folder / "wind.html").read_text(encoding="utf-8")
    assert "Fitted to profile.csv" in html
    provenance = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    assert provenance["fitted_to"] == "profile.csv"
    (scene,) = provenance["scenes"].values()
    assert scene["transverse_stiffness"] == pytest.approx(1e6 * stiffness["value"])


def test_a_profile_is_told_from_a_log(tmp_path):
    values = read_layers(profile_file(tmp_path, [0.5, 0.75]))
    assert values is not None
    assert list(values) == [0.5, 0.75]
    log = tmp_path / "log.csv"
    log.write_text("time_s,tension_cN\n0,1\n", encoding="utf-8")
    assert read_layers(log) is None
    log.write_bytes("Zeit;Zugkraft µN\n".encode("cp1252"))
    assert read_layers(log) is None


BAD = [
    ("layer,T_over_T0\n2,0.5\n", "line 2: layer is '2'; give layer 1"),
    ("layer,T_over_T0\n1,half\n", "line 2: T_over_T0 is 'half'"),
    ("layer,T_over_T0\n1\n", "line 2: T_over_T0 is None"),
    ("layer,T_over_T0\n1,nan\n", "line 2: T_over_T0 is 'nan'"),
    ("layer,T_over_T0\n1,1e308\n", "line 2: T_over_T0 is '1e308'; give a tension over T₀, 0 to 100"),
    ("time_s,tension_cN\n" + "".join(f"{i / 100},0\n" for i in range(40)), "mean tension 0 N; must be greater than 0"),
    ("layer,T_over_T0\n1,0.5\n2,0.6\n", "2 layers; 3 to"),
    ("layer,T_over_T0\n", "0 layers"),
    ("something,else\n1,2\n", "profile.csv"),  # read as a log, and refused as one
]


@pytest.mark.parametrize(("text", "words"), BAD, ids=range(len(BAD)))
def test_a_bad_measurement_is_one_line(yarnval, file, tmp_path, text, words):
    given = tmp_path / "profile.csv"
    given.write_text(text, encoding="utf-8")
    ran = yarnval("wind", file, "--case", "fine", "--calibrate", given, "--out", tmp_path / "out")
    assert ran.code == 2
    assert words in ran.line
    assert not (tmp_path / "out").exists()


def test_one_case_is_fitted_at_a_time(yarnval, file, tmp_path):
    ran = yarnval("wind", file, "--calibrate", tmp_path / "none.csv")
    assert ran.code == 2
    assert "--calibrate: 2 cases; one case is fitted at a time" in ran.line
    ran = yarnval("wind", file, "--case", "fine", "--calibrate", tmp_path / "none.csv")
    assert "none.csv: cannot be read" in ran.line
