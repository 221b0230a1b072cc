"""How long is the first call after an install, while it is compiled? One process a row, in processor time.

    python benchmarks/cold_start.py [FOLDER]      (default: reports)

writes cold_start.csv. The packages are copied to an empty folder, so that nothing compiled is found. Each model is
called alone, then what `make report` calls one after another: all models of its studies with their sensitivities. Then
eight rendered frames of single yarn are measured, and 0.01 s are wound in each mode.
"""

import csv
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

MODELS = ("capstan", "flexible", "cosserat", "cosserat-fd", "kirchhoff", "kirchhoff-spans", "auto")
REPORT = ("flexible", "cosserat", "cosserat-fd", "kirchhoff")
SOLVE = """
import sys, time
from models.scene import Scene
from models.sensitivity import sensitivities
from models.solve import MODELS
scene = Scene(
    wrap_angle=1.0, cylinder_radius=3e-3, yarn_radius=8e-5, friction=0.8, twist_CD=900.0, tension_CD=0.16,
    torsional_rigidity=5e-9, delivery_speed=0.2, cylinder_speed_ratio=2.0,
)
begin = time.process_time()
for model in sys.argv[2:]:
    MODELS[model](scene).require()
    if sys.argv[1] == "report":
        sensitivities(scene, model)
print(time.process_time() - begin)
"""
MEASURE = """
import math, time
import numpy as np
from pipeline.measure.yarn import measure_yarn
from pipeline.records import RawVideo, Scale, Source
from pipeline.synthetic import Material, render_frame
class Stack(list):
    frame = list.__getitem__
rng = np.random.default_rng(1)
look = dict(shape=(300, 400), axis_angle=math.radians(70), diameter=40.0, twist=0.004)
images = Stack(render_frame(Material.draw(rng), rng, **look) for _ in range(8))
video = RawVideo(Source("", "", 0), images, np.arange(8) / 1200, 1200.0, 12, look["shape"])
begin = time.process_time()
measure_yarn(video, Scale(4e-6, 0.0), cylinder_axis=None)
print(time.process_time() - begin)
"""
WIND = """
import sys, time
from models.winding.scene import WindingScene
from models.winding.solve import wind
scene = WindingScene(
    linear_density=1.3e-4, diameter=4.2e-4, axial_stiffness=315.0, bending_stiffness=3.5e-6, speed=6.0, tension=0.5,
    duration=0.01, mode=sys.argv[1],
)
begin = time.process_time()
wind(scene)
print(time.process_time() - begin)
"""


def first_call(code: str, *words: str) -> float:
    """Processor time [s] that `code` says it took in a fresh copy of the packages."""
    with tempfile.TemporaryDirectory() as folder:
        for package in ("models", "pipeline"):
            source = Path(__file__).parents[1] / package
            shutil.copytree(source, Path(folder) / package, ignore=shutil.ignore_patterns("__pycache__"))
        run = [sys.executable, "-c", code, *words]
        return float(subprocess.run(run, cwd=folder, capture_output=True, text=True, check=True).stdout)


def main(folder: Path) -> None:
    """Measure and write the table."""
    rows = [(model, first_call(SOLVE, "solve", model)) for model in MODELS]
    rows.append((f"a report: {', '.join(REPORT)}, with sensitivities", first_call(SOLVE, "report", *REPORT)))
    rows.append(("a measurement of single yarn", first_call(MEASURE)))
    rows.extend((f"winding, {mode} mode", first_call(WIND, mode)) for mode in ("fast", "reference"))
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "cold_start.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["first_call_of", "processor_time_s"])
        table.writerows((name, f"{seconds:.1f}") for name, seconds in rows)
    print((folder / "cold_start.csv").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("reports"))
