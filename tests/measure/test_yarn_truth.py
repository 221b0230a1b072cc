"""Rendered yarn of known truth against what is measured in it. The renderer and the measurement share no code."""

import math
from dataclasses import replace

import numpy as np
import pytest
from yarn_frames import clip

from pipeline.errors import InputError
from pipeline.measure.yarn import measure_json, measure_yarn
from pipeline.records import CylinderAxis, FrameFlag, Scale, SlopeRatio
from pipeline.synthetic import Material, Optics, render_frame

DIAMETER = 0.16e-3
SHAPE = (256, 400)


def yarn(seed, *, diameter, twist, angles, material=None, optics=None, hairs=1.5):
    """Frames of one yarn [12 bit]; diameter [px], twist [1/m], angles [°]."""
    rng = np.random.default_rng(seed)
    metres = DIAMETER / diameter
    material = material or Material.draw(rng, fibre_length=0.5 / (abs(twist) * DIAMETER), hairs_per_diameter=hairs)
    return [
        render_frame(
            material,
            rng,
            shape=SHAPE,
            axis_angle=math.radians(angle),
            diameter=diameter,
            twist=twist * metres,
            offset=rng.uniform(-8, 8),
            phase=rng.uniform(0, 2 * math.pi),
            travel=rng.uniform(0, 100) * diameter,
            optics=optics,
        )
        for angle in angles
    ]


def measured(images, diameter, **kwargs):
    return measure_yarn(
        clip(images), Scale(DIAMETER / diameter, 0.002), cylinder_axis=CylinderAxis(math.pi / 2), **kwargs
    )


GRID = [
    (22, 300, 20), (22, -700, 65), (22, 1500, 160), (32, -300, 135), (32, 1200, 12), (32, -1500, 90), (45, 600, 178),
    (45, -1000, 110), (60, 300, 30), (60, -900, 150), (60, 1500, 75),
]  # fmt: skip


@pytest.mark.parametrize(("diameter", "twist", "angle"), GRID)
def test_clip_means_agree_with_the_truth(diameter, twist, angle):
    angles = angle + np.linspace(-2, 2, 12)
    optics = Optics(
        blur=0.7 + 0.005 * diameter, light_angle=0.3 * math.copysign(1, twist), ambient=0.3 + diameter / 200
    )
    m = measured(yarn([diameter, abs(twist)], diameter=diameter, twist=twist, angles=angles, optics=optics), diameter)
    error = np.mod(np.degrees(m.axis_angle) - angles + 90, 180) - 90
    assert abs(error.mean()) < 0.02
    assert np.abs(error).max() < 0.1
    assert m.summary["diameter"].mean == pytest.approx(DIAMETER, rel=0.02)
    assert np.all(np.isfinite(m.twist))
    assert m.summary["twist"].mean == pytest.approx(twist, rel=0.02)
    assert m.handedness == ("Z" if twist > 0 else "S")
    assert np.all(np.sign(m.twist) == np.sign(twist))


def test_a_step_edge_has_no_shading_bias():
    flat = yarn(7, diameter=40, twist=1000, angles=[25] * 4, optics=Optics(ambient=1.0, uneven=(0, 0)), hairs=0)
    lit = yarn(7, diameter=40, twist=1000, angles=[25] * 4, optics=Optics(ambient=0.15, light_angle=0), hairs=0)
    for images in (flat, lit):
        assert measured(images, 40).summary["diameter"].mean == pytest.approx(DIAMETER, rel=0.015)


def test_noise_and_hairs():
    optics = Optics(full_well=3000, read_noise=20)
    angles = np.full(12, 140.0)
    m = measured(yarn(3, diameter=32, twist=1000, angles=angles, optics=optics, hairs=6), 32)
    assert np.degrees(m.axis_angle).mean() == pytest.approx(140, abs=0.1)
    assert m.summary["diameter"].mean == pytest.approx(DIAMETER, rel=0.02)
    assert m.summary["twist"].mean == pytest.approx(1000, rel=0.02)


def test_a_second_thin_object_does_not_turn_the_axis():
    images = yarn(4, diameter=32, twist=1000, angles=[30.0] * 3)
    for image in images:
        image[:, 118:124] = 2600
        image[40:43, :] = 2000
    m = measured(images, 32)
    np.testing.assert_allclose(np.degrees(m.axis_angle), 30, atol=0.1)
    np.testing.assert_allclose(m.diameter, DIAMETER, rtol=0.02)


def test_a_mirrored_frame_has_the_other_hand_and_the_mirrored_angle():
    images = yarn(5, diameter=36, twist=900, angles=[25.0, 80.0, 140.0])
    seen = measured(images, 36)
    mirrored = measured([np.ascontiguousarray(image[:, ::-1]) for image in images], 36)
    np.testing.assert_allclose(mirrored.twist, -seen.twist, rtol=0.01)
    np.testing.assert_allclose(mirrored.axis_angle, math.pi - seen.axis_angle, atol=math.radians(0.01))
    np.testing.assert_allclose(mirrored.diameter, seen.diameter, rtol=0.002)
    turned = measured([np.ascontiguousarray(image[::-1, ::-1]) for image in images], 36)
    np.testing.assert_allclose(turned.twist, seen.twist, rtol=0.01)
    np.testing.assert_allclose(turned.axis_angle, seen.axis_angle, atol=math.radians(0.01))


def smooth(rng):
    material = Material.draw(rng)
    return Material(np.zeros_like(material.texture), material.length, material.hairs)


NOT_CREDIBLE = [
    ("small", 8, None, None, "px across"),
    ("smooth", 32, smooth(np.random.default_rng(1)), None, ""),
    ("defocused", 32, None, Optics(blur=6), "blurred"),
]


@pytest.mark.parametrize(("name", "diameter", "material", "optics", "why"), NOT_CREDIBLE)
def test_twist_that_cannot_be_seen_is_not_given(name, diameter, material, optics, why):
    images = yarn(6, diameter=diameter, twist=1000, angles=np.linspace(20, 160, 8), material=material, optics=optics)
    m = measured(images, diameter)
    assert np.all(np.isnan(m.twist)), name
    assert np.all(m.flag & (FrameFlag.TWIST_NOT_CREDIBLE | FrameFlag.NO_YARN))
    assert math.isnan(m.summary["twist"].mean)
    assert m.handedness == ""
    assert why in m.reason
    assert m.reason


def test_frames_without_yarn_and_broken_frames_are_flagged_and_the_rest_is_used():
    images = yarn(8, diameter=32, twist=1100, angles=[15.0] * 5)
    noise = np.random.default_rng(0).normal(250, 5, SHAPE).round().astype(np.uint16)
    m = measured([*images[:2], None, noise, np.zeros(SHAPE, np.uint16), *images[2:]], 32)
    assert list(m.flag) == [0, 0, FrameFlag.UNREADABLE, FrameFlag.NO_YARN, FrameFlag.NO_YARN, 0, 0, 0]
    assert np.all(np.isnan(m.axis_angle[2:5]))
    assert np.all(m.confidence[2:5] == 0)
    assert np.all(m.confidence[m.flag == 0] > 0.5)
    assert m.summary["twist"].mean == pytest.approx(1100, rel=0.02)
    assert "1 of 8 frames cannot be read" in m.reason


def test_noise_is_no_yarn():
    images = [np.random.default_rng(seed).normal(250, 5, SHAPE).round().astype(np.uint16) for seed in range(20)]
    assert np.all(measured(images, 32).flag == FrameFlag.NO_YARN)


@pytest.mark.parametrize("shape", [(1, 1), (1, 400), (300, 2)])
def test_a_frame_too_small_for_a_yarn_shows_none(shape):
    m = measure_yarn(clip([np.full(shape, 500, np.uint16)] * 2), Scale(1.0, 0.0), cylinder_axis=None)
    assert np.all(m.flag & FrameFlag.NO_YARN)
    assert np.all(np.isnan(m.diameter))


@pytest.mark.parametrize("shape", [(16, 64), (17, 33), (19, 300), (700, 17)])
def test_noise_in_a_narrow_frame_is_no_yarn(shape):
    """Every fourth of a fourth of 17 rows is one row: too little for a quadratic ground, whose fit was taken unseen."""
    noise = np.random.default_rng(1).integers(0, 4096, shape).astype(np.uint16)
    m = measure_yarn(clip([noise] * 2), Scale(1.0, 0.0), cylinder_axis=None)
    assert np.all(m.flag & FrameFlag.NO_YARN)


def test_angles_near_the_wrap_average_to_the_wrap():
    m = measured(yarn(9, diameter=32, twist=1000, angles=[-3, 3, -2, 2]), 32)
    mean = math.degrees(m.summary["axis_angle"].mean)
    assert 0 <= mean < 180
    assert math.remainder(mean, 180) == pytest.approx(0, abs=0.05)
    assert math.degrees(m.summary["theta_B"].mean) == pytest.approx(90, abs=0.05)


def test_eight_bits_are_accepted_and_named():
    images = [(image >> 4).astype(np.uint8) for image in yarn(10, diameter=32, twist=-1200, angles=[40] * 6)]
    m = measure_yarn(clip(images, bits=8), Scale(DIAMETER / 32), cylinder_axis=None)
    assert "8 bits" in m.reason
    assert "scale's uncertainty" in m.reason
    assert m.summary["twist"].mean == pytest.approx(-1200, rel=0.02)
    assert np.all(np.isnan(m.theta))


def test_uncertainty_holds_the_scale():
    images = yarn(11, diameter=32, twist=1000, angles=[40] * 6)
    tight = measure_yarn(clip(images), Scale(DIAMETER / 32, 0.0), cylinder_axis=None).summary
    loose = measure_yarn(clip(images), Scale(DIAMETER / 32, 0.05), cylinder_axis=None).summary
    for key in ("diameter", "twist"):
        assert math.sqrt(loose[key].u ** 2 - tight[key].u ** 2) == pytest.approx(0.05 * loose[key].mean, rel=1e-6)
    assert loose["axis_angle"].u == tight["axis_angle"].u


def test_an_outlying_frame_is_flagged_and_left_out_of_the_means():
    images = yarn(12, diameter=32, twist=1000, angles=[40] * 8) + yarn(13, diameter=48, twist=1000, angles=[40])
    m = measured(images, 32)
    assert m.flag[8] & FrameFlag.OUTLIER
    assert m.diameter[8] == pytest.approx(1.5 * DIAMETER, rel=0.02)
    assert m.summary["diameter"].n == 8
    assert "outlier" in m.reason


def test_saturated_frames_are_flagged():
    m = measured(yarn(14, diameter=32, twist=1000, angles=[40] * 2, optics=Optics(yarn=1.1)), 32)
    assert np.all(m.flag & FrameFlag.SATURATED)


def test_json_has_the_contract_s_keys_and_no_nan():
    images = yarn(15, diameter=32, twist=1000, angles=[40] * 3)
    document = measure_json(measured([*images, None], 32))
    assert set(document) == {
        "frames", "fps", "time_s", "axis_angle_deg", "twist_tpm", "diameter_mm", "confidence", "flag", "summary",
        "method", "handedness", "reason", "hairiness_per_m", "helix_rotation_per_s", "sagitta_mm",
        "diameter_cv_along_yarn_percent", "clip",
    }  # fmt: skip
    assert set(document["summary"]) == {
        "theta_B_deg", "axis_angle_deg", "twist_tpm", "diameter_mm", "hairiness_per_m", "helix_rotation_per_s",
        "diameter_cv_along_yarn_percent",
    }  # fmt: skip
    twist = document["summary"]["twist_tpm"]
    assert set(twist) == {"mean", "cv_percent", "n", "n_eff", "u", "u_terms", "reason"}
    assert math.hypot(*twist["u_terms"].values()) == pytest.approx(twist["u"])
    assert document["twist_tpm"][3] is None
    assert document["flag"] == ["", "", "", "UNREADABLE"]
    assert document["summary"]["theta_B_deg"]["mean"] == pytest.approx(50, abs=0.1)
    without = measure_json(measure_yarn(clip(images), Scale(5e-6), cylinder_axis=None))
    assert "theta_B_deg" not in without["summary"]


def test_the_axis_and_the_tilt_are_in_u_where_they_are_stated() -> None:
    images = yarn(15, diameter=32, twist=1000, angles=[40] * 3)
    e_z, tilt = CylinderAxis(math.pi / 2, math.radians(0.3)), math.radians(4)
    stated = measure_yarn(clip(images), Scale(5e-6, 0.0), cylinder_axis=e_z, u_tilt=tilt).summary
    share = math.sqrt(3) / 2 * tilt**2
    assert stated["twist"].u_terms["tilt"] == pytest.approx(share * stated["twist"].mean)
    theta = stated["theta_B"]
    assert theta.u_terms["axis"] == e_z.u
    assert theta.u_terms["tilt"] == pytest.approx(share / math.tan(math.radians(50)), rel=1e-2)
    assert theta.u == pytest.approx(math.hypot(*theta.u_terms.values()))
    assert not any("not stated" in stated[name].reason for name in ("twist", "theta_B", "diameter"))
    unstated = measure_yarn(clip(images), Scale(5e-6), cylinder_axis=CylinderAxis(math.pi / 2)).summary
    assert "the cylinder axis' uncertainty is not stated and not in u" in unstated["theta_B"].reason
    assert "the tilt out of the image plane is not stated" in unstated["twist"].reason
    assert unstated["theta_B"].u < theta.u
    along = measure_yarn(clip(images), Scale(5e-6), cylinder_axis=CylinderAxis(math.radians(40)), u_tilt=tilt).summary
    assert along["theta_B"].u_terms["tilt"] == tilt


@pytest.mark.parametrize("tilt", [5, 10])
def test_a_tilted_yarn_appears_twisted_more_by_1_over_cos_tilt(tilt: float) -> None:
    rng = np.random.default_rng(16)
    material = Material.draw(rng, fibre_length=3.0)
    for tau, error in ((0.0, 0.0), (math.radians(tilt), 1 / math.cos(math.radians(tilt)) - 1)):
        images = [
            render_frame(
                material, rng, shape=SHAPE, axis_angle=math.radians(40), diameter=32, twist=1000 * DIAMETER / 32,
                tilt=tau, phase=i, travel=30 * i,
            )
            for i in range(12)
        ]  # fmt: skip
        assert measured(images, 32).summary["twist"].mean == pytest.approx(1000 * (1 + error), rel=0.012)


def test_fibres_below_the_outline_show_too_little_twist_and_u_holds_it() -> None:
    deep = replace(Material.draw(np.random.default_rng(17)), depth=0.1)
    twist = measured(yarn(17, diameter=40, twist=900, angles=[50] * 6, material=deep), 40).summary["twist"]
    assert 0.85 < twist.mean / 900 < 0.93
    assert 900 - twist.mean < 2 * twist.u


def test_the_slope_is_corrected_where_it_was_compared_with_direct_counting() -> None:
    images = yarn(18, diameter=40, twist=900, angles=[50] * 3)
    told = measured(images, 40).summary["twist"]
    known = measured(images, 40, ratio=SlopeRatio(0.9, 0.018)).summary["twist"]
    assert known.mean == pytest.approx(told.mean / 0.9)
    assert known.u_terms["depth"] == pytest.approx(0.02 * known.mean)
    assert known.u < told.u
    with pytest.raises(InputError, match="slope ratio"):
        measured(images, 40, ratio=SlopeRatio(0.9, 0.018), method="ply", plies=2)


def dyed(seed: int, twist: float, phases: list[float]) -> list[np.ndarray]:
    """Frames of a yarn of 40 px with a tracer fibre 10 % of the radius below the outline."""
    rng = np.random.default_rng(seed)
    drawn = Material.draw(rng, fibre_length=0.5 / (twist * DIAMETER))
    material = replace(drawn, tracer=(0.2, 0.2), depth=0.1)
    return [
        render_frame(
            material, rng, shape=SHAPE, axis_angle=math.pi / 2, diameter=40, twist=twist * DIAMETER / 40, phase=phase
        )
        for phase in phases
    ]  # fmt: skip


def test_one_pass_of_a_tracer_fibre_gives_the_twist_by_its_slope() -> None:
    images = dyed(3, 500, [-0.3, 0.0, 0.3])
    told = measured(images, 40, method="tracer").summary["twist"]
    assert "one pass is seen: the twist is by its slope" in told.reason
    assert told.u_terms["depth"] == pytest.approx(0.12 * told.mean)
    assert 0.02 < 1 - told.mean / 500 < 2 * told.u / 500
    known = measured(images, 40, ratio=SlopeRatio(0.88, 0.01), method="tracer").summary["twist"]
    assert known.mean == pytest.approx(told.mean / 0.88)
    assert known.u_terms["depth"] == pytest.approx(0.01 / 0.88 * known.mean)
    assert abs(known.mean - 500) < 2 * known.u


@pytest.mark.parametrize("twist", [400, -700])
def test_fibres_of_a_yarn_without_a_tracer_are_none(twist: float) -> None:
    m = measured(yarn([19, abs(twist)], diameter=40, twist=twist, angles=[50] * 8), 40, method="tracer")
    assert math.isnan(m.summary["twist"].mean)
    assert "tracer" in m.reason


def test_where_frames_show_a_turn_of_a_tracer_fibre_one_pass_does_not_count() -> None:
    """1.3 turns in view, of which at two phases one pass is whole and at the others two are seen."""
    images = dyed(3, 1000, [0.0, 0.3, 3.0, 3.2, 3.4])
    m = measured(images, 40, ratio=SlopeRatio(0.88, 0.01), method="tracer")
    assert np.isnan(m.twist).tolist() == [True, True, False, False, False]
    assert "one pass of the tracer fibre is seen, and in other frames a turn" in m.reason
    assert "a turn or more is seen" in m.summary["twist"].reason
    assert "depth" not in m.summary["twist"].u_terms
    assert m.summary["twist"].mean == pytest.approx(1000, rel=0.02)


def test_thumbnails_carry_what_was_measured_in_their_own_pixels():
    images = yarn(16, diameter=32, twist=1000, angles=[20] * 8)
    wide = [np.pad(image, ((0, 0), (0, 560)), mode="edge") for image in images]
    thumbnails = measured(images, 32).thumbnails
    assert [t.frame for t in thumbnails] == [0, 1, 3, 4, 6, 7]
    for t in thumbnails:
        assert t.image.dtype == np.uint8
        assert t.image.shape == SHAPE
        x, y = round(t.centre[0]), round(t.centre[1])
        assert t.image[y, x] > 60
        assert t.diameter == pytest.approx(32, rel=0.02)
    assert all(t.image.shape[1] <= 480 for t in measured(wide, 32).thumbnails)


def test_wrong_calls_are_refused():
    images = yarn(17, diameter=32, twist=1000, angles=[20])
    with pytest.raises(InputError, match="surface"):
        measured(images, 32, method="surfase")
    with pytest.raises(InputError, match="positive number"):
        measure_yarn(clip(images), Scale(0.0), cylinder_axis=None)
