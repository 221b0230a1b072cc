"""Twist of fibres that run below the outline: the slope tells too little, their return after a full turn does not."""

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from yarn_frames import clip

from pipeline.measure.clip_twist import U_DEPTH, U_TURN
from pipeline.measure.yarn import measure_yarn
from pipeline.records import Scale

DIAMETER, SHAPE, FULL = 40.0, (200, 640), 4095


def bundle(
    twist: float, turn: float, *, fibres: int = 60, thick: float = 0.12, length: float = math.inf, seed: int = 1
):
    """One frame of a bundle: round fibres on helices of radius (1 − thick)·R, nearer ones before the others."""
    rng = np.random.default_rng(seed)
    radius, fine = DIAMETER / 2, 2
    rows, columns = SHAPE[0] * fine, SHAPE[1] * fine
    level, depth = np.full((rows, columns), 300.0), np.full((rows, columns), -np.inf)
    x = (np.arange(columns) + 0.5) / fine - SHAPE[1] / 2
    half = thick * radius
    lanes = np.arange(math.ceil(-half * fine), math.floor(half * fine) + 1)
    for start in np.linspace(0, 2 * math.pi, fibres, endpoint=False):
        # a fibre that ends is followed by another one in its place
        pieces = np.floor((x + rng.uniform(0, 1e3)) / length) if math.isfinite(length) else np.zeros(columns)
        shade = {piece: 1 + 0.2 * rng.standard_normal() for piece in np.unique(pieces)}
        bright = np.array([shade[piece] for piece in pieces])
        around = 2 * math.pi * twist * x + start + turn
        height, y = (radius - half) * np.sin(around), -(radius - half) * np.cos(around)
        for lane in lanes:
            away = lane / fine / half
            if abs(away) >= 1:
                continue
            near = height + half * math.sqrt(1 - away * away)
            row = np.round((y + SHAPE[0] / 2) * fine + lane).astype(int)
            column = np.arange(columns)
            front = near > depth[row, column]
            row, column = row[front], column[front]
            depth[row, column] = near[front]
            level[row, column] = (bright * (700 + 1300 * math.sqrt(1 - away * away)))[front]
    small = cv2.GaussianBlur(cv2.resize(level, SHAPE[::-1], interpolation=cv2.INTER_AREA), (0, 0), 0.8)
    return np.clip(np.round(small + 15 * rng.standard_normal(SHAPE)), 0, FULL).astype(np.uint16)


def measured(images: list[NDArray[np.uint16]]):
    return measure_yarn(clip(images), Scale(1.0, 0.0), cylinder_axis=None).summary["twist"]


@pytest.mark.parametrize("twist", [1 / 250, -1 / 310])
def test_fibres_below_the_outline_by_their_return_after_a_full_turn(twist: float) -> None:
    found = measured([bundle(twist, 0.7 * i) for i in range(6)])
    assert found.mean == pytest.approx(twist, rel=0.01)
    assert found.u_terms["method"] == pytest.approx(U_TURN * abs(found.mean))
    assert "depth" not in found.u_terms
    assert abs(found.mean - twist) <= 3 * found.u < 0.03 * abs(twist)


def test_without_a_return_the_slope_is_all_there_is() -> None:
    found = measured([bundle(1 / 250, 0.7 * i, length=100.0, seed=i) for i in range(6)])
    assert found.mean == pytest.approx(1 / 250, rel=0.2)
    assert found.u_terms["depth"] == pytest.approx(U_DEPTH * found.mean)
    assert abs(found.mean - 1 / 250) <= 2 * found.u
