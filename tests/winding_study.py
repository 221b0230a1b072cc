"""A small winding file, and results of known numbers (synthetic) in place of runs."""

from pathlib import Path

import numpy as np

from models.winding.result import Snapshot, WindingOutcome, WindingResult
from pipeline.winding.run import Row, row
from pipeline.winding.study import WindingStudy, load_winding

SMALL = """\
name = "small"
title = "A <small> winding"
source = "made up"
notes = ["Lengths & speeds are made up."]

[scene]
mode = "fast"
tension_cN = 50
modulus_N_per_tex = 2.5
duration_s = 0.4
element_mm = 4
bobbin_diameter_mm = 40

[[cases]]
name = "fine"
tex = 60
drum_rpm = 1000
speed_m_s = 6

[[cases]]
name = "coarse, 1000 r/min"
tex = 120
drum_rpm = 1000
speed_m_s = 6

[[vary]]
name = "transverse stiffness"
case = "coarse, 1000 r/min"
parameter = "transverse_stiffness_N_per_mm2"
values = [0.4, 4]
note = "soft & stiff"
"""


def write(folder: Path, text: str = SMALL) -> Path:
    file = folder / "small.toml"
    file.write_text(text, encoding="utf-8")
    return file


def made_up(study: WindingStudy, *, rise: float = 0.0, mean: float = 0.5, layers: tuple[float, ...] = ()) -> list[Row]:
    """A row for each case: tension `mean` + `rise` · t with a ripple of 1 % [N], turns of the guide every 50 ms."""
    rows = []
    for case in study.cases:
        time = np.arange(1, round(case.scene.duration * 1000) + 1) / 1000
        tension = mean + rise * time + 0.005 * np.sin(2 * np.pi * 200 * time)
        result = WindingResult(
            scene=case.scene,
            mode="fast",
            mode_reason="made up",
            outcome=WindingOutcome.COMPLETED,
            message="",
            time=time,
            span_tension=tension,
            guide_phase=time / 0.1,
            guide_position=0.5 * case.scene.stroke * -np.cos(2 * np.pi * time / 0.1),
            layers_T_over_T0=np.array(layers),
            snapshots=(_helix(case.scene.duration / 2, 50, case.scene), _helix(case.scene.duration, 100, case.scene)),
            wall_s=0.25,
        )
        rows.append(row(case, result))
    return rows


def _helix(time: float, nodes: int, scene) -> Snapshot:
    angle = np.linspace(0, nodes / 10, nodes)
    radius = scene.bobbin_radius + scene.diameter / 2
    z = np.linspace(-0.5, 0.5, nodes) * scene.stroke
    position = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    return Snapshot(time, np.repeat([1, 2], nodes // 2), position, np.linspace(0.2, 0.5, nodes))


def small(folder: Path, text: str = SMALL) -> WindingStudy:
    return load_winding(write(folder, text))
