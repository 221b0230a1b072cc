"""The rig's generator: what it says it makes is what it makes, the same each time."""

import math
from dataclasses import replace

import av
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.ingest.layouts import load_layout
from pipeline.ingest.tension import read_tension
from pipeline.synthetic import (
    RIG,
    Material,
    Optics,
    main,
    render_frame,
    rig_frames,
    rig_tension,
    rig_truth,
    smooth_series,
    write_rig,
)

SMALL = tuple(replace(case, frames=2) for case in RIG[:2])


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(30, 300),
    mean=st.floats(1, 2000),
    cv=st.floats(0.01, 0.2),
    correlation=st.floats(0, 0.95),
)
@settings(max_examples=40, deadline=None)
def test_a_series_has_exactly_the_mean_and_cv_asked_for(seed, n, mean, cv, correlation):
    series = smooth_series(np.random.default_rng(seed), n, mean, cv, correlation)
    assert series.mean() == pytest.approx(mean, rel=1e-12)
    assert series.std(ddof=1) / series.mean() == pytest.approx(cv, rel=1e-9)


@pytest.mark.parametrize("case", RIG, ids=lambda case: case.name)
def test_truth_has_the_published_statistics_and_stays_physical(case):
    truth = rig_truth(case)
    for values, (mean, cv) in ((np.degrees(truth["theta"]), case.theta), (truth["twist"], case.twist)):
        assert values.mean() == pytest.approx(mean, rel=1e-9)
        assert values.std(ddof=1) / values.mean() == pytest.approx(cv, rel=1e-9)
    assert np.all((truth["theta"] > math.radians(30)) & (truth["theta"] < math.radians(130)))
    assert np.all(truth["twist"] > 400)
    np.testing.assert_allclose(np.mod(math.pi / 2 - truth["axis_angle"], math.pi), truth["theta"])


@pytest.mark.parametrize("case", RIG, ids=lambda case: case.name)
def test_logs_read_back_as_drawn(case, tmp_path):
    write_rig(tmp_path, [replace(case, frames=2)])
    for log, name in enumerate(case.logs):
        layout, step = ("german-semicolon", 1e-3) if name.endswith(".txt") else ("plain-csv", 1e-5)
        raw = read_tension(tmp_path / case.name / name, load_layout(layout, tmp_path))
        np.testing.assert_allclose(raw.tension, rig_tension(case, log) / 100, atol=0.5001 * step)
        np.testing.assert_allclose(raw.time, np.arange(3000) / 100, atol=1e-9)
        assert not np.any(raw.flag)
        assert 100 * raw.tension.mean() == pytest.approx(case.tension[0], abs=0.002)
        assert raw.tension.std(ddof=1) / raw.tension.mean() == pytest.approx(case.tension[1], rel=2e-3)


def test_regeneration_is_bit_identical_and_lossless(tmp_path):
    for folder in ("a", "b"):
        write_rig(tmp_path / folder, SMALL)
    for case in SMALL:
        for name in (*case.logs, case.video):
            assert (tmp_path / "a" / case.name / name).read_bytes() == (tmp_path / "b" / case.name / name).read_bytes()
        drawn = list(rig_frames(case))
        path = tmp_path / "a" / case.name / case.video
        if path.suffix == ".tif":
            stored = list(tifffile.imread(path))
        else:
            with av.open(str(path)) as container:
                stored = [frame.to_ndarray(format="gray16le") for frame in container.decode(video=0)]
        for one, other in zip(drawn, stored, strict=True):
            np.testing.assert_array_equal(one, other)
            assert one.max() < 4095


def test_the_shipped_rig_is_what_the_generator_makes(request):
    root = request.config.rootpath / "data_samples" / "rig"
    for case in RIG:
        first = next(rig_frames(case))
        path = root / case.name / case.video
        if path.suffix == ".tif":
            stored = tifffile.imread(path, key=0)
        else:
            with av.open(str(path)) as container:
                stored = next(container.decode(video=0)).to_ndarray(format="gray16le")
        np.testing.assert_array_equal(first, stored)


def test_command_line_writes_the_study_and_the_truth_apart(tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.synthetic.write_rig", lambda folder: folder.mkdir())
    main([str(tmp_path / "rig"), "--truth", str(tmp_path / "truth" / "rig.csv")])
    lines = (tmp_path / "truth" / "rig.csv").read_text().splitlines()
    assert lines[0] == "case,frame,axis_angle_deg,theta_B_deg,twist_tpm,diameter_mm"
    assert len(lines) == 1 + sum(case.frames for case in RIG)
    assert list((tmp_path / "rig").iterdir()) == []


def test_rendered_geometry_is_where_it_is_said_to_be():
    """A vertical yarn, light even: its edges stand at offset ± d/2 of the centre, and Z runs like the letter."""
    rng = np.random.default_rng(0)
    material = Material.draw(rng, fibre_length=6, hairs_per_diameter=0)
    optics = Optics(ambient=1.0, uneven=(0, 0), read_noise=0, full_well=1e9)
    frame = render_frame(
        material, rng, shape=(160, 120), axis_angle=math.pi / 2, diameter=40, twist=0.004, offset=10, optics=optics
    )
    body = frame.mean(axis=0) > 0.28 * 4095
    assert list(np.flatnonzero(body)[[0, -1]]) == [50, 89]
    # near the axis, eight rows higher the same fibre is 8·πdT = 4 px further right
    texture = frame[:, 60:80].astype(float)
    texture -= texture.mean(axis=0)
    right = float(np.sum(texture[:-8, 4:] * texture[8:, :-4]))
    left = float(np.sum(texture[:-8, :-4] * texture[8:, 4:]))
    assert right > left + 0.2 * float(np.sum(texture**2))


def test_twist_turns_the_texture_by_one_turn_per_pitch():
    """Moved along by one pitch with the material's own travel taken out, a helix looks the same."""
    rng = np.random.default_rng(2)
    material = Material.draw(rng, hairs_per_diameter=0)
    quiet = Optics(uneven=(0, 0), read_noise=0, full_well=1e12)
    scene = {"shape": (60, 300), "axis_angle": 0.0, "diameter": 30, "optics": quiet}
    here = render_frame(material, rng, twist=0.01, phase=0.0, **scene)
    turned = render_frame(material, rng, twist=0.01, phase=2 * math.pi, **scene)
    moved = render_frame(material, rng, twist=0.01, travel=material.length * 30, **scene)
    other = render_frame(material, rng, twist=0.01, phase=math.pi, **scene)
    assert np.abs(here.astype(int) - turned).max() <= 1
    assert np.abs(here.astype(int) - moved).max() <= 1
    assert np.abs(here.astype(int) - other).max() > 100
