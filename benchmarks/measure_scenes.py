"""What is measured as yarn where other things are in view, or the yarn fills the frame: rendered frames, at random.

    python benchmarks/measure_scenes.py [FOLDER]      (default: reports)

writes measure_scenes.csv: one row per frame, and prints how many of each scene were measured, and measured wrong. All
frames are synthetic. Single yarn of 14 px to 55 % of the frame's shorter side, at any angle (in narrow frames within 8°
of along them), helix angle 6° to 22°, light up to 34° beside the camera. The scenes: dark, gray and bright ground;
before a cylinder with both edges in view, darker than the yarn or brighter; before one broader than the frame; before a
ground whose one half is brighter. The cylinder lies 40° to 140° from the yarn.

Wrong is a diameter that is given and off by more than `OFF_DIAMETER`, or an angle off by more than `OFF_ANGLE`. One
frame is a harder case than a clip, where frames that disagree become outliers.
"""

import csv
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from measure_bias import BITS, PROCESSES, Stack

from pipeline.measure.yarn import measure_yarn
from pipeline.records import RawVideo, Scale, Source
from pipeline.synthetic import Backdrop, Material, Optics, bar, render_frame

SCENES = ("dark", "gray", "bright", "dark cylinder", "bright cylinder", "broad cylinder", "half bright")
PLAIN = {"gray": 0.3, "bright": 0.7}
"""Levels of grounds that are not dark."""
FRAMES = 40
"""Of each scene."""
SHAPES = ((600, 800), (300, 400), (128, 400), (96, 256), (256, 256))
NARROW = 200
"""Frames with fewer rows show yarn along them."""
OFF_DIAMETER, OFF_ANGLE = 0.05, 1.0
"""Relative, and [°]."""


def ground(scene: str, side: int, angle: float, rng: np.random.Generator) -> tuple[float, float, Backdrop | None]:
    """Levels of background and yarn, and what is behind; `side` is the frame's shorter one [px], `angle` the yarn's."""
    across, place = angle + math.radians(rng.uniform(40, 140)), rng.uniform(-0.2, 0.2) * side
    width = rng.uniform(0.3, 0.9) * side
    background, level, backdrop = PLAIN.get(scene, 0.06), 0.25 if scene == "bright" else 0.5, None
    match scene:
        case "dark cylinder":
            backdrop = bar(across, place, width, 0.2, lit=True)
        case "bright cylinder":
            level, backdrop = float(rng.choice([0.15, 0.25, 0.4])), bar(across, place, width, 0.7, lit=True)
        case "broad cylinder":
            level = float(rng.choice([0.25, 0.5]))
            backdrop = bar(across, place, 3 * width, float(rng.choice([0.2, 0.7])), lit=True)
        case "half bright":
            backdrop = bar(across, place + 2 * side, 4 * side, float(rng.choice([0.15, 0.7])))
    return background, level, backdrop


def frame(scene: str, seed: int) -> dict[str, float | str]:
    """Render and measure one frame."""
    rng = np.random.default_rng([SCENES.index(scene), seed])
    shape = SHAPES[int(rng.integers(len(SHAPES)))]
    side = min(shape)
    diameter = math.exp(rng.uniform(math.log(14), math.log(0.55 * side)))
    angle = math.radians(rng.uniform(-8, 8) if side < NARROW else rng.uniform(0, 180))
    background, level, backdrop = ground(scene, side, angle, rng)
    optics = Optics(background=background, yarn=level, light_angle=rng.uniform(-0.6, 0.6))
    image = render_frame(
        Material.draw(rng), rng, shape=shape, axis_angle=angle, diameter=diameter,
        twist=rng.choice([-1, 1]) * rng.uniform(0.1, 0.4) / (math.pi * diameter), offset=rng.uniform(-0.1, 0.1) * side,
        phase=rng.uniform(0, 2 * math.pi), travel=rng.uniform(0, 100), backdrop=backdrop, optics=optics,
    )  # fmt: skip
    video = RawVideo(Source("", "", 0), Stack([image]), np.zeros(1), 1200.0, BITS, shape)
    m = measure_yarn(video, Scale(1.0, 0.0), cylinder_axis=None, threads=1)
    off_angle = abs((math.degrees(m.axis_angle[0] - angle) + 90) % 180 - 90)
    off_diameter = float(m.diameter[0]) / diameter - 1
    length = min(shape[0] / max(abs(math.sin(angle)), 1e-9), shape[1] / max(abs(math.cos(angle)), 1e-9))
    wrong = abs(off_diameter) > OFF_DIAMETER or off_angle > OFF_ANGLE  # what is not given is NaN, and not wrong
    return {
        "scene": scene, "seed": seed, "rows": shape[0], "columns": shape[1], "diameter_px": diameter,
        "angle_deg": math.degrees(angle), "length_over_diameter": length / diameter,
        "share_of_frame": diameter / side, "angle_error_deg": off_angle, "diameter_error_percent": 100 * off_diameter,
        "wrong": int(wrong), "reason": m.reason,
    }  # fmt: skip


def main(folder: Path) -> None:
    """Run all scenes, write the table, print what came out."""
    tasks = [(scene, seed) for scene in SCENES for seed in range(FRAMES)]
    with ProcessPoolExecutor(PROCESSES) as pool:
        rows = list(pool.map(frame, *zip(*tasks, strict=True)))
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "measure_scenes.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {k: f"{v:.4g}" if isinstance(v, float) and k != "seed" else v for k, v in row.items()} for row in rows
        )
    for scene in (*SCENES, None):
        mine = [row for row in rows if scene in (row["scene"], None)]
        given = sum(math.isfinite(float(row["diameter_error_percent"])) for row in mine)
        wrong = sum(int(row["wrong"]) for row in mine)
        print(f"{scene or 'all'}: {len(mine)} frames, a diameter in {given}, a wrong diameter or angle in {wrong}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("reports"))
