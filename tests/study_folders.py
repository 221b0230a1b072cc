"""Small studies on disk for tests of the command line."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pipeline import synthetic

SCENE = """\
phi_deg = 50
r0_mm = 3.0
d_mm = 0.16
mu = 0.81
T_CD_tpm = { value = 902, cv_percent = 14.55 }
p3_CD_cN = { value = 16.53, cv_percent = 5.32 }
K_Nm2 = 4.87e-9
v_m_s = 0.16
vb_over_v = 2
"""
MEASURED = """
[measured]
p3_AB_cN = { mean = 10.61, cv_percent = 7.22 }
T_AB_tpm = { mean = 1217, cv_percent = 14.22 }
theta_B_deg = { mean = 77.9 }
"""
RAW = """
[raw]
tension = [{ file = "log.txt", profile = "german-semicolon" }]
video = ["clip.mkv"]
fps = 1200
scale_um_per_px = { value = 5.0, cv_percent = 0.3 }
axis_deg = 90
"""
STUDY = """\
name = "small"
title = "A small study"
source = "made up for a test"
synthetic = true
cases = ["only"]
models = {models}

[bounds.cosserat]
p3_AB_cN = 15
T_AB_tpm = 15
theta_B_deg = 15
"""


def published(folder: Path, *, models: Sequence[str] = ("cosserat",), case: str = SCENE + MEASURED) -> Path:
    """A study of one published case."""
    (folder / "only").mkdir(parents=True)
    text = STUDY.replace("{models}", str(list(models)).replace("'", '"'))
    (folder / "study.toml").write_text(text, encoding="utf-8")
    (folder / "only" / "case.toml").write_text(case, encoding="utf-8")
    return folder


def raw(folder: Path, *, models: Sequence[str] = ("cosserat",), frames: int = 8) -> Path:
    """A study of one case with a synthetic log and clip."""
    published(folder, models=models, case=SCENE + RAW)
    rig = replace(synthetic.RIG[0], frames=frames)
    synthetic.write_german_log(folder / "only" / "log.txt", synthetic.rig_tension(rig, 0), synthetic.LOG_RATE)
    synthetic.write_video(folder / "only" / "clip.mkv", synthetic.rig_frames(rig), synthetic.FRAME_RATE)
    return folder


def edit(file: Path, old: str, new: str) -> None:
    """Replace text that must be there."""
    text = file.read_text(encoding="utf-8")
    assert old in text, f"{old!r} is not in {file}"
    file.write_text(text.replace(old, new), encoding="utf-8")
