"""Whether a clip's numbers and their stated uncertainties can be believed: rendered clips, drawn at random.

    python benchmarks/measure_coverage.py [FOLDER [KIND ...]]      (default: reports, all kinds)

writes measure_coverage.csv: one row per clip, and prints the statistics; where kinds are named, the rows of the others
stay as they are in the table. All frames are synthetic. Single yarn: 20 to
60 px, 300 to 1500 turns per metre of a yarn of 0.16 mm, S and Z, angle 20° to 160°, 0 to 6 hairs per diameter, signal
to noise 10 to 100, blur 0.5 to 2 px, up to 20° of rotation in the exposure of every third clip, light up to 60° beside
the camera. The yarn runs through the clip as yarn does: frames share fibres. Of the kind "single" the fibres run on the
outline, of the kind "deep" up to 14 % of the radius below it. Plied yarn and yarn with a tracer are drawn over the same
range; the tracer runs on the outline, of the kind "deep tracer" up to 14 % below it. Three kinds of clip have no
credible twist: 8 px across, no texture, 6 px out of focus; "no tracer" is single yarn measured as if it had one.

Errors are those of the measurement, over the frames in view and at the true scale. Whether u holds the truth is asked
as a user meets it ("met"): the scale has an error, drawn from its stated uncertainty, and the angle is that of the
yarn, of which the frames, 0.5° apart at random, are a sample.
"""

import csv
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from measure_bias import BITS, FULL_SCALE, PROCESSES, Stack
from numpy.typing import NDArray

from pipeline.measure.yarn import measure_yarn
from pipeline.records import FrameFlag, RawVideo, Scale, Source
from pipeline.synthetic import Material, Optics, render_frame

SHAPE = (300, 400)
FRAMES = 8
DIAMETER = 0.16e-3
U_SCALE = 0.003
"""Relative standard uncertainty of the scale: that of the shipped study."""
DEEPEST = 0.14
KINDS = {
    "single": 60, "deep": 60, "ply": 20, "tracer": 20, "deep tracer": 40, "no tracer": 60, "8 px": 30, "no texture": 30,
    "defocus 6 px": 30,
}  # fmt: skip
"""Clips of each kind."""
SEEDS = {
    "single": 0, "ply": 1, "tracer": 2, "8 px": 3, "no texture": 4, "defocus 6 px": 5, "deep": 6, "deep tracer": 7,
    "no tracer": 8,
}  # fmt: skip


def clip(kind: str, seed: int) -> dict[str, float | str]:
    """Render and measure one clip; errors of its means in %, ° and standard uncertainties."""
    rng = np.random.default_rng([SEEDS[kind], seed])
    diameter = 8.0 if kind == "8 px" else rng.uniform(20, 60)
    tpm = rng.uniform(300, 1500) * rng.choice([-1, 1])
    metres = DIAMETER / diameter
    plies = int(rng.integers(2, 5)) if kind == "ply" else 1
    material = Material.draw(rng, fibre_length=0.5 / (abs(tpm) * DIAMETER), hairs_per_diameter=rng.uniform(0, 6))
    material = replace(material, plies=plies, tracer=(0.2 if kind in ("tracer", "deep tracer") else 0.0, 0.3))
    if kind in ("deep", "deep tracer"):
        material = replace(material, depth=rng.uniform(0, DEEPEST))
    if kind == "no texture":
        material = replace(material, texture=np.zeros_like(material.texture))
    optics = Optics(
        blur=rng.uniform(0.5, 2.0),
        defocus=6.0 if kind == "defocus 6 px" else 0.0,
        light_angle=rng.uniform(-1.05, 1.05),
        ambient=rng.uniform(0.2, 0.8),
        uneven=(rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2)),
        read_noise=0.5 * FULL_SCALE / math.exp(rng.uniform(math.log(10), math.log(100))),
    )
    angle = rng.uniform(20, 160)
    angles = angle + rng.normal(0, 0.5, FRAMES)
    exposure = rng.uniform(0, 20) if rng.random() < 0.3 else 0.0
    turn, travel = rng.uniform(-0.6, 0.6), rng.uniform(0, 1.0) * diameter
    images = [
        render_frame(
            material, rng, shape=SHAPE, axis_angle=math.radians(a), diameter=diameter, twist=tpm * metres,
            offset=rng.uniform(-5, 5), phase=i * turn, travel=i * travel, exposure=math.radians(exposure),
            optics=optics,
        )
        for i, a in enumerate(angles.tolist())
    ]  # fmt: skip
    video = RawVideo(Source("", "", 0), Stack(images), np.arange(FRAMES) / 1200, 1200.0, BITS, SHAPE)
    method = "tracer" if "tracer" in kind else "ply" if kind == "ply" else "surface"
    m = measure_yarn(
        video, Scale(metres, U_SCALE), cylinder_axis=None, method=method, plies=plies if plies > 1 else None, threads=1
    )
    s = m.summary
    enters = (m.flag & FrameFlag.OUTLIER) == 0
    wrong_angle = np.mod(np.degrees(m.axis_angle) - angles + 90, 180) - 90
    about = math.degrees(s["helix_rotation"].mean / 1200 * 2 * math.pi)
    wrong = {
        "diameter": 100 * (s["diameter"].mean / DIAMETER - 1),
        "twist": 100 * (s["twist"].mean / tpm - 1),
        "helix": about - math.degrees(turn),
    }
    off = 100 * U_SCALE * rng.standard_normal()
    return {
        "kind": kind, "seed": seed, "diameter_px": diameter, "tpm": tpm,
        "turns": abs(tpm) * metres * SHAPE[0], "depth": material.depth, "frames": FRAMES,
        "frames_without_twist": int(np.count_nonzero(np.isnan(m.twist))), "outliers": int(np.count_nonzero(~enters)),
        "angle_error_deg": float(np.nanmean(wrong_angle)) if np.any(np.isfinite(wrong_angle)) else math.nan,
        "angle_sd_deg": spread(wrong_angle[enters]),
        "angle_met_deg": np.mod(math.degrees(s["axis_angle"].mean) - angle + 90, 180) - 90,
        "angle_u_deg": math.degrees(s["axis_angle"].u),
        "diameter_error_percent": wrong["diameter"],
        "diameter_met_percent": wrong["diameter"] + off,
        "diameter_u_percent": 100 * s["diameter"].u / DIAMETER,
        "twist_by_slope": int("depth" in s["twist"].u_terms),
        "twist_error_percent": wrong["twist"],
        "twist_met_percent": wrong["twist"] - off,
        "twist_sd_percent": 100 * spread(m.twist[enters]) / abs(tpm),
        "twist_u_percent": 100 * s["twist"].u / abs(tpm),
        "helix_error_deg": wrong["helix"],
        "helix_met_deg": wrong["helix"],
        "helix_u_deg": math.degrees(s["helix_rotation"].u / 1200 * 2 * math.pi),
        "reason": m.reason,
    }  # fmt: skip


def spread(values: NDArray[np.float64]) -> float:
    """Standard deviation of the frames that enter a clip's mean."""
    return float(np.nanstd(values)) if np.any(np.isfinite(values)) else math.nan


def statistics(rows: list[dict[str, float | str]]) -> None:
    """Print bias, spread and coverage (|error| ≤ 2u) by kind."""
    for kind in dict.fromkeys(row["kind"] for row in rows):
        mine = [row for row in rows if row["kind"] == kind]
        given = np.array([row["frames_without_twist"] < row["frames"] for row in mine])
        outliers = sum(int(row["outliers"]) for row in mine)
        print(f"{kind}: {len(mine)} clips, a twist in {np.count_nonzero(given)}, {outliers} frames outliers")
        slope = np.array([bool(row["twist_by_slope"]) for row in mine])
        for name, unit in (("angle", "deg"), ("diameter", "percent"), ("twist", "percent"), ("helix", "deg")):
            if name == "helix" and kind != "single":
                continue
            parts = {"": np.full(len(mine), True)}
            if name == "twist" and np.any(slope) and np.any(given & ~slope):
                parts = {"by slope": slope, "by turn": ~slope}
            for part, chosen in parts.items():
                say(name, part, unit, [row for row, here in zip(mine, chosen, strict=True) if here])


def say(name: str, part: str, unit: str, rows: list[dict[str, float | str]]) -> None:
    """Print the statistics of a quantity in a part of the clips."""
    error, sd, u, met = (
        np.array([row.get(f"{name}_{what}_{unit}", math.nan) for row in rows], float)
        for what in ("error", "sd", "u", "met")
    )
    known = np.isfinite(error)
    if not np.any(known):
        return
    text = f"  {f'{name} {part}':15} n {known.sum():3} bias {error[known].mean():+.3f} {unit}"
    text += f", clips' scatter {error[known].std():.3f}, largest {np.abs(error[known]).max():.3f}"
    if np.any(np.isfinite(sd)):
        text += f", frames' sd {math.sqrt(np.nanmean(sd**2)):.3f}"
    held = known & np.isfinite(u)
    share = np.mean(np.abs(met[held]) <= 2 * u[held])
    print(text + f", within 2u {100 * share:.0f} %")


def main(folder: Path, kinds: list[str]) -> None:
    path = folder / "measure_coverage.csv"
    kept: list[dict[str, str]] = []
    if kinds and path.exists():
        with path.open(newline="") as file:
            kept = [row for row in csv.DictReader(file) if row["kind"] not in kinds]
    wanted = {kind: KINDS[kind] for kind in kinds or KINDS}
    # kinds alternate, so that a run that is broken off has some of each
    calls = [(kind, seed) for seed in range(max(wanted.values())) for kind, count in wanted.items() if seed < count]
    rows: list[dict[str, float | str]] = []
    with ProcessPoolExecutor(PROCESSES) as pool:
        for row in pool.map(clip, *zip(*calls, strict=True)):
            rows.append(row)
            print(*(f"{value:.4g}" if isinstance(value, float) else value for value in row.values()), flush=True)
    folder.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(kept)
        table.writerows({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    statistics(rows)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("reports"), sys.argv[2:])
