"""Plied yarn, tracer fibres, light from the side, rotation and hairs. Frames are synthetic."""

import math

import numpy as np
import pytest
import yarn_frames
from hypothesis import given, settings
from hypothesis import strategies as st
from yarn_frames import clip

from pipeline.errors import InputError
from pipeline.measure.axis import find_axis
from pipeline.measure.lit import fit_lit, level, places_of, side_starts
from pipeline.measure.pitch import ply_twist
from pipeline.measure.tracer import tracer_twist
from pipeline.measure.yarn import measure_json, measure_yarn
from pipeline.records import CylinderAxis, FrameFlag, Scale
from pipeline.synthetic import Material, Optics, bar, compressed, render_frame

SHAPE = (256, 400)
DIAMETER = 32.0


def yarn(seed, *, tan_beta=0.6, angle=25.0, diameter=DIAMETER, **scene):
    """One frame of a yarn, and its twist [1/px]."""
    return yarn_frames.yarn(seed, shape=SHAPE, tan_beta=tan_beta, angle=angle, diameter=diameter, **scene)


def pixels(image):
    return image.astype(np.float32)


@pytest.mark.parametrize(
    ("plies", "tan_beta", "angle"), [(2, 0.9, 20.0), (2, -0.8, 95.0), (3, 0.8, 150.0), (4, -1.0, 0.0)]
)
def test_ply_pitch_of_two_turns_in_view(plies, tan_beta, angle):
    image, twist = yarn(plies, tan_beta=tan_beta, angle=angle, diameter=24, material={"plies": plies})
    axis = find_axis(pixels(image))
    assert axis.length * abs(twist) > 2
    found = ply_twist(pixels(image), axis, plies)
    assert not found.reason
    assert found.per_pixel == pytest.approx(twist, rel=0.01)


def test_single_yarn_has_no_plies_and_less_than_a_turn_is_refused():
    single, _ = yarn(1)
    found = ply_twist(pixels(single), find_axis(pixels(single)), 2)
    assert math.isnan(found.per_pixel)
    assert found.reason
    plied, _ = yarn(1, tan_beta=0.1, diameter=40, material={"plies": 2})
    assert math.isnan(ply_twist(pixels(plied), find_axis(pixels(plied)), 2).per_pixel)


@pytest.mark.parametrize(("dye", "tan_beta"), [(0.3, 0.8), (0.3, -0.7), (1.7, 0.7)])
def test_a_tracer_fibre_dark_or_bright(dye, tan_beta):
    image, twist = yarn(5, tan_beta=tan_beta, angle=160.0, material={"tracer": (0.2, dye)})
    found = tracer_twist(pixels(image), find_axis(pixels(image)))
    assert not found.reason
    assert found.per_pixel == pytest.approx(twist, rel=0.02)


@pytest.mark.parametrize("phase", np.linspace(0, 2 * math.pi, 8, endpoint=False))
def test_a_tracer_fibre_counts_where_it_is_seen_again_a_turn_on_or_all_across_the_face(phase):
    """1.2 turns in view: in some phases the fibre passes the front once, in others twice."""
    image, twist = yarn(5, tan_beta=0.385, angle=90.0, material={"tracer": (0.2, 0.2)}, phase=phase)
    found = tracer_twist(pixels(image), find_axis(pixels(image)))
    if found.reason:
        assert "parts of two passes" in found.reason or "of the face" in found.reason
    else:
        assert found.per_pixel == pytest.approx(twist, rel=0.05 if found.one_pass else 0.015)


@pytest.mark.parametrize(("depth", "tan_beta"), [(0.0, 0.25), (0.0, -0.4), (0.1, 0.25), (0.1, -0.4)])
def test_the_slope_of_one_pass_of_a_tracer_fibre_tells_its_depth_below_the_outline(depth, tan_beta):
    """On a cylinder of (1 − 0.1) R an even view of ±53° of the face sees a slope that is 13 % smaller."""
    material = {"tracer": (0.2, 0.2), "depth": depth}
    errors = []
    for seed in range(3):
        image, twist = yarn(seed, tan_beta=tan_beta, angle=90.0, material=material, phase=0.0)
        found = tracer_twist(pixels(image), find_axis(pixels(image)))
        assert not found.reason
        assert found.one_pass
        errors.append(found.per_pixel / twist - 1)
    assert np.mean(errors) == pytest.approx(-1.26 * depth, abs=0.04)


def test_a_tracer_fibre_seen_twice_is_enough():
    found = []
    for phase in np.linspace(0, 2 * math.pi, 8, endpoint=False):
        image, _ = yarn(5, tan_beta=0.5, angle=90.0, material={"tracer": (0.2, 0.3)}, phase=phase)
        found.append(tracer_twist(pixels(image), find_axis(pixels(image))).per_pixel)
    assert np.count_nonzero(np.isfinite(found)) >= 4


def test_a_yarn_without_a_tracer_is_refused():
    for seed in range(2):
        image, _ = yarn(seed)
        found = tracer_twist(pixels(image), find_axis(pixels(image)))
        assert math.isnan(found.per_pixel)
        assert "tracer" in found.reason


@pytest.mark.parametrize("faded", [True, False])
def test_a_tracer_fibre_has_one_colour_all_along(faded):
    """Half of the yarn has a fibre that is dyed less."""
    strong, weak = (
        yarn(5, tan_beta=0.8, angle=90.0, material={"tracer": (0.2, dye)})[0] for dye in (0.2, 0.7 if faded else 0.2)
    )
    image = pixels(np.concatenate([strong[: SHAPE[0] // 2], weak[SHAPE[0] // 2 :]]))
    found = tracer_twist(image, find_axis(image))
    assert ("of its depth along the yarn" in found.reason) == faded
    assert math.isnan(found.per_pixel) == faded


@pytest.mark.parametrize("ambient", [0.35, 0.0])
@pytest.mark.parametrize("light", [0.4, -0.8, 1.1])
def test_light_from_the_side_moves_neither_diameter_nor_twist(light, ambient):
    optics = Optics(light_angle=light, ambient=ambient)
    frames = [yarn(seed, angle=70.0 + 40 * seed, optics=optics) for seed in range(3)]
    m = measure_yarn(clip([image for image, _ in frames]), Scale(1.0, 0.0), cylinder_axis=None)
    assert not np.any(m.flag)
    assert m.summary["diameter"].mean == pytest.approx(DIAMETER, rel=0.01)
    assert m.summary["twist"].mean == pytest.approx(frames[0][1], rel=0.02)


def test_a_lamp_behind_the_yarn_is_refused():
    optics = Optics(light_angle=1.5, ambient=0.1)
    m = measure_yarn(clip([yarn(seed, optics=optics)[0] for seed in range(3)]), Scale(1.0, 0.0), cylinder_axis=None)
    assert np.all(m.flag & (FrameFlag.DIAMETER_NOT_CREDIBLE | FrameFlag.NO_YARN))
    assert math.isnan(m.summary["diameter"].mean)
    assert math.isnan(m.summary["twist"].mean)


@given(
    radius=st.floats(8, 24), offset=st.floats(-2, 2), blur=st.floats(0.7, 2), light=st.floats(-1.1, 1.1),
    ambient=st.floats(0.0, 1.0),
)  # fmt: skip
@settings(max_examples=8, deadline=None)
def test_a_profile_with_a_shadow_is_fitted_exactly(radius, offset, blur, light, ambient):
    """By a brute-force sum over the surface, which shares nothing with the fit."""
    half = math.ceil(2 * radius + 8)
    w = np.arange(-half, half + 1)
    gamma = (np.arange(8000) + 0.5) / 8000 * math.pi - math.pi / 2
    surface = level(gamma, light, (1 + ambient, ambient)) * radius * np.cos(gamma) * (math.pi / 8000)
    place = offset + radius * np.sin(gamma)
    profile = np.array([np.sum(surface * np.exp(-0.5 * ((x - place) / blur) ** 2)) for x in w])
    profile = 300 + w + 1000 * profile / (blur * math.sqrt(2 * math.pi))
    found = fit_lit(profile, np.ones(profile.size), side_starts(profile, 1.0))
    assert found.radius == pytest.approx(radius, rel=4e-3)
    assert found.offset == pytest.approx(offset, abs=0.05)


def test_without_blur_a_row_shows_its_own_angle():
    gamma = np.linspace(-0.9, 0.9, 19)
    np.testing.assert_allclose(places_of(gamma, 20, 0.0, 0.3, (2.0, 1.0)), 20 * np.sin(gamma), atol=0.02)
    even = places_of(gamma, 20, 2.0, 0.0, (1.0, 1.0))
    assert np.all(np.abs(even[:9]) > 0)
    np.testing.assert_allclose(even, -even[::-1], atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 90.0])
def test_rotation_of_the_helix_and_of_the_yarn(angle):
    """The yarn of 0.16 mm travels 20 px and its helix turns by 0.3 rad from frame to frame of 1200 a second."""
    material = Material.draw(np.random.default_rng(3), fibre_length=3)
    twist, metres = 0.6 / (math.pi * DIAMETER), 5e-6
    images = [
        render_frame(
            material, np.random.default_rng(i), shape=SHAPE, axis_angle=math.radians(angle), diameter=DIAMETER,
            twist=twist, phase=0.3 * i, travel=20 * i,
        )
        for i in range(6)
    ]  # fmt: skip
    speed = 20 * metres * 1200
    cylinder = math.radians(angle + 90)  # the yarn travels to the right of it, in the direction of its angle
    m = measure_yarn(clip(images), Scale(metres, 0.0), cylinder_axis=CylinderAxis(cylinder), speed=speed)
    helix = 0.3 / (2 * math.pi) * 1200
    assert m.summary["helix_rotation"].mean == pytest.approx(helix, rel=0.05)
    assert m.summary["rotation"].mean == pytest.approx(helix + speed * twist / metres, rel=0.03)
    back = measure_yarn(clip(images), Scale(metres, 0.0), cylinder_axis=CylinderAxis(cylinder - math.pi))
    assert back.summary["helix_rotation"].mean == pytest.approx(-m.summary["helix_rotation"].mean)
    document = measure_json(m)
    assert document["helix_rotation_per_s"][-1] is None
    assert document["summary"]["rotation_per_s"]["mean"] == pytest.approx(m.summary["rotation"].mean)


def test_a_rotation_beyond_what_faces_the_camera_is_not_given():
    material = Material.draw(np.random.default_rng(3), fibre_length=3)
    images = [
        render_frame(
            material, np.random.default_rng(i), shape=SHAPE, axis_angle=0.5, diameter=DIAMETER, twist=0.006,
            phase=math.pi * i,
        )
        for i in range(6)
    ]  # fmt: skip
    m = measure_yarn(clip(images), Scale(1.0, 0.0), cylinder_axis=None)
    assert math.isnan(m.summary["helix_rotation"].mean)
    assert "seen again" in m.summary["helix_rotation"].reason


def test_hairs_are_counted():
    counts = []
    for hairs in (0.0, 2.0, 6.0):
        images = [yarn(seed, angle=30.0 * seed, hairs=hairs)[0] for seed in range(2)]
        m = measure_yarn(clip(images), Scale(1.0, 0.0), cylinder_axis=None)
        counts.append(m.summary["hairiness"].mean * DIAMETER)
    assert counts[0] < 0.05
    assert counts[1] > 0.2
    assert counts[2] > 2 * counts[1]


SCENES = {
    "dark on bright": ({"optics": Optics(background=0.7, yarn=0.25)}, 12),
    "as bright as its edges": ({"optics": Optics(background=0.3)}, 12),
    "before a cylinder": ({"backdrop": bar(math.pi / 2, 10, 150, 0.2, lit=True)}, 12),
    "before a bright cylinder": ({"backdrop": bar(math.pi / 2, 10, 600, 0.7, lit=True)}, 12),
    "compressed": ({}, 8),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_yarn_is_found_and_measured_on_any_ground(name):
    scene, bits = SCENES[name]
    frames = [yarn(seed, angle=20.0 + 20 * seed, **scene) for seed in range(3)]
    images = [compressed(image, 60) if bits == 8 else image for image, _ in frames]
    m = measure_yarn(clip(images, bits), Scale(1.0, 0.0), cylinder_axis=None)
    np.testing.assert_allclose(np.degrees(m.axis_angle), [20, 40, 60], atol=0.1)
    assert m.summary["diameter"].mean == pytest.approx(DIAMETER, rel=0.02)
    assert m.summary["twist"].mean == pytest.approx(frames[0][1], rel=0.04)


def test_the_number_of_plies_goes_with_the_method():
    images = [yarn(1)[0]]
    for method, plies in (("ply", None), ("ply", 1), ("surface", 2)):
        with pytest.raises(InputError, match="plies"):
            measure_yarn(clip(images), Scale(1.0), cylinder_axis=None, method=method, plies=plies)
