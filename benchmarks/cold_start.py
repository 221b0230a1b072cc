"""How long is the first call of a model after an install, while it is compiled? One process a row, in processor time.

    python benchmarks/cold_start.py [FOLDER]      (default: reports)

writes cold_start.csv. The package is copied to an empty folder, so that nothing compiled is found. Each model is called
alone, and then what `make report` calls one after another: all models of its studies with their sensitivities.
"""

import csv
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

MODELS = ("capstan", "flexible", "cosserat", "cosserat-fd", "kirchhoff", "kirchhoff-spans", "auto")
REPORT = ("flexible", "cosserat", "cosserat-fd", "kirchhoff")
CALL = """
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


def first_call(models: Sequence[str], what: str) -> float:
    """Processor time [s] of the first calls in a fresh copy of the package."""
    with tempfile.TemporaryDirectory() as folder:
        package = Path(__file__).parents[1] / "models"
        shutil.copytree(package, Path(folder) / "models", ignore=shutil.ignore_patterns("__pycache__"))
        run = [sys.executable, "-c", CALL, what, *models]
        return float(subprocess.run(run, cwd=folder, capture_output=True, text=True, check=True).stdout)


def main(folder: Path) -> None:
    """Measure and write the table."""
    rows = [(model, first_call([model], "solve")) for model in MODELS]
    rows.append((f"a report: {', '.join(REPORT)}, with sensitivities", first_call(REPORT, "report")))
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "cold_start.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["first_call_of", "processor_time_s"])
        table.writerows((name, f"{seconds:.1f}") for name, seconds in rows)
    print((folder / "cold_start.csv").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("reports"))
