"""What do the winding modes say, at what cost? The paper's nine cases, refinement, and cost against length.

    python benchmarks/winding_cases.py STUDY [FOLDER]      (default FOLDER: reports/winding)

STUDY is one of
    fast        nine cases, fast mode
    reference   nine cases, reference mode, one process per core, niced; minutes to an hour
    refine      a short package of ten layers in both modes at 4, 2 and 1 mm, stiff and soft
    cost        fast mode from 1 to 180 m, reference mode from 1 to 3 m
    deep        30 layers of a short package in both modes at 4 mm
    calibrate   the layers of the soft run of `reference` taken as if measured: fitted on the fast mode, then run with
                the fitted values in the reference mode
    figures     tables and figures of all runs that are there

A run is kept as FOLDER/runs/NAME.npz and not repeated; a reference run that was stopped goes on from its checkpoint.
Inputs are those of `WindingScene`, most of them assumptions; nothing here is a measurement.
"""

import csv
import math
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from time import process_time

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from models.winding.calibrate import calibrate_to_layers
from models.winding.result import Kept
from models.winding.scene import WindingScene
from models.winding.solve import wind
from pipeline.winding.study import load_winding

FILE = Path(__file__).parents[1] / "data_samples" / "winding" / "nine_cases.toml"
NINE = {given.name: given.scene for given in load_winding(FILE).cases if not given.variant}
FINENESSES, DRUMS = (32.8, 65.6, 131.2), (500, 800, 1000)
"""tex; r/min of the groove drum."""
LENGTHS = (1, 3, 9, 30, 90, 180)
"""Yarn wound [m]."""
FITTED = 90
"""Longest of them in the exponent of cost against length [m]."""
REPEATS = 5
"""Runs of the fast mode, of which the least CPU time counts."""
START = 0.1
"""Left out of means [s]."""
STIFF, SOFT = 2.4e7, 3.9e5
"""K_t [N/m²]."""
COLUMNS = (
    "run", "T0_cN", "span_mean_cN", "span_sd_cN", "span_min_cN", "span_max_cN", "cpu_s", "element_steps",
    "energy_residual", "penetration_over_d", "phase_correlation_with_fast",
)  # fmt: skip


def case(tex: float, rpm: int) -> WindingScene:
    """One of the paper's nine cases."""
    return replace(NINE[f"{tex:g} tex, {rpm} r/min"], mode="auto")


def nine(mode: str) -> dict[str, WindingScene]:
    """The nine cases by name; the costliest first, so that two processes end together."""
    cases = {f"{mode}-{tex:g}tex-{rpm}rpm": case(tex, rpm) for rpm in (1000, 800, 500) for tex in (131.2, 65.6, 32.8)}
    scenes = {name: replace(scene, mode=mode) for name, scene in cases.items()}
    if mode == "fast":
        return scenes
    soft = replace(scenes["reference-131.2tex-1000rpm"], transverse_stiffness=SOFT)
    return {"reference-131.2tex-1000rpm-soft": soft, **scenes}


def refine() -> dict[str, WindingScene]:
    """Ten layers of a third of the stroke: the same crossings per length in a third of the time."""
    short = replace(case(131.2, 1000), turns_per_cycle=1.55, duration=0.56)
    scenes = {}
    for length in (4, 2, 1):
        for name, stiffness in (("stiff", STIFF), ("soft", SOFT)):
            for mode in ("fast", "reference"):
                scenes[f"refine-{name}-{length}mm-{mode}"] = replace(
                    short, element_length=length * 1e-3, transverse_stiffness=stiffness, mode=mode
                )
    return scenes


def deep() -> dict[str, WindingScene]:
    """30 layers of the short package: does the middle of a high package lose its tension in both modes?"""
    short = replace(case(131.2, 1000), turns_per_cycle=1.55, duration=1.56, element_length=4e-3)
    return {f"deep-{mode}": replace(short, mode=mode) for mode in ("fast", "reference")}


def cost() -> dict[str, WindingScene]:
    """131.2 tex at 1000 r/min by length."""
    scenes = {}
    for metres in LENGTHS:
        scene = replace(case(131.2, 1000), duration=0.025 + metres / 6.0)
        scenes[f"cost-fast-{metres}m"] = replace(scene, mode="fast")
        if metres <= 3:
            scenes[f"cost-reference-{metres}m"] = replace(scene, mode="reference")
    return scenes


STUDIES = {
    "fast": lambda: nine("fast"),
    "reference": lambda: nine("reference"),
    "refine": refine,
    "cost": cost,
    "deep": deep,
}


def calibrate(folder: Path) -> None:
    """Fit stiffness and relaxation to the layers of a kept reference run, run the fit, write calibration.csv."""
    runs = read(folder)
    given = runs.get("reference-131.2tex-1000rpm-soft")
    if given is None:
        sys.exit("run the study 'reference' first: its soft run stands for the measurement")
    own = case(131.2, 1000)
    fit = calibrate_to_layers(replace(own, mode="fast"), given["layers"][: math.floor(own.cycles)])
    print(run("calibrated-reference", replace(fit.scene, mode="reference"), folder))
    verified = read(folder)["calibrated-reference"]["layers"][: fit.measured.size]
    columns = {
        "as_if_measured": fit.measured,
        "fast_before": fit.before,
        "fast_fitted": fit.after,
        "reference": verified,
    }
    with (folder / "calibration.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["layer", *columns])
        for k, row in enumerate(zip(*columns.values(), strict=True), start=1):
            table.writerow([k, *(f"{x:.3f}" for x in row)])
    for found in fit.fitted:
        print(f"{found.name}: {found.start:g} before, {found.value:.4g} fitted, u {found.u:.2g}")
    rms = np.sqrt(np.mean((verified - fit.measured) ** 2))
    print(f"rms in T/T0: {fit.rms_before:.3f} before, {fit.rms_after:.3f} fitted, {rms:.3f} in the reference mode")


class Checkpoint:
    """State of a run in a file, replaced as a whole."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def load(self) -> Kept | None:
        """The state kept last."""
        if not self.path.exists():
            return None
        with np.load(self.path) as file:
            return dict(file)

    def save(self, kept: Kept) -> None:
        """Keep `kept`."""
        fresh = self.path.with_suffix(".new.npz")
        np.savez(fresh, **kept)  # pyright: ignore[reportArgumentType]
        fresh.replace(self.path)


def run(name: str, scene: WindingScene, folder: Path) -> str:
    """Run one scene if it has not been run; a line about it."""
    path = folder / "runs" / f"{name}.npz"
    if not path.exists():
        checkpoint = Checkpoint(folder / "runs" / f"{name}.checkpoint.npz")
        wind(replace(scene, duration=0.005))  # compiles, so that the times below are those of the run
        times = [process_time()]
        result = wind(scene, checkpoint=checkpoint)
        times.append(process_time())
        for _ in range(REPEATS - 1 if scene.mode == "fast" else 0):
            wind(scene)
            times.append(process_time())
        seconds = float(np.min(np.diff(times)))
        if not result.outcome.ok:
            return f"{name}: {result.outcome.name}: {result.message}"
        last = result.snapshots[-1]
        np.savez(
            path,
            time=result.time,
            phase=result.guide_phase,
            span=result.span_tension,
            layers=result.layers_T_over_T0,
            position=last.position,
            tension=last.tension,
            layer=last.layer,
            numbers=[
                scene.tension,
                seconds,
                result.element_steps,
                math.nan if result.energy is None else result.energy.residual,
                result.penetration_max / scene.diameter,
            ],
        )
        checkpoint.path.unlink(missing_ok=True)
    return f"{name}: done"


def _niced(name: str, scene: WindingScene, folder: Path) -> str:
    if os.nice(0) < 10:
        os.nice(10 - os.nice(0))
    return run(name, scene, folder)


def read(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    """All runs that are there."""
    runs = {}
    for path in sorted((folder / "runs").glob("*.npz")):
        if "checkpoint" not in path.name:
            with np.load(path) as file:
                runs[path.stem] = dict(file)
    return runs


def tables(runs: dict[str, dict[str, np.ndarray]], folder: Path) -> None:
    """winding.csv, one row per run, and winding_layers.csv."""
    with (folder / "winding.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for name, r in runs.items():
            pull, seconds, steps, residual, depth = r["numbers"]
            span = 100 * r["span"][r["time"] > START]
            other = runs.get(name.replace("reference", "fast").removesuffix("-soft"))
            match = math.nan
            if "reference" in name and other is not None and not name.startswith("cost"):
                match = np.corrcoef(by_phase(r), by_phase(other))[0, 1]
            numbers = [100 * pull, span.mean(), span.std(), span.min(), span.max()]
            cost = f"{seconds:.4g}", int(steps)
            rest = f"{residual:.2e}", f"{depth:.3f}", f"{match:.3f}"
            table.writerow([name, *(f"{x:.2f}" for x in numbers), *cost, *rest])
    with (folder / "winding_layers.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["run", *(f"layer_{k}" for k in range(1, 31))])
        for name, r in runs.items():
            if not name.startswith("cost"):
                table.writerow([name, *(f"{x:.3f}" for x in r["layers"][:30])])


def by_phase(r: dict[str, np.ndarray], bins: int = 40) -> np.ndarray:
    """Mean span tension over the guide cycle, shape (bins,)."""
    steady = r["time"] > START
    place = (r["phase"][steady] % 1 * bins).astype(int)
    return np.array([r["span"][steady][place == k].mean() for k in range(bins)])


def figures(runs: dict[str, dict[str, np.ndarray]], folder: Path) -> None:
    """Span tension, layers, refinement and cost."""
    metadata = {"Date": None}
    figure, grid = plt.subplots(3, 3, figsize=(11, 7), sharex=True, layout="constrained")
    for row, tex in zip(grid, FINENESSES, strict=True):
        for axes, rpm in zip(row, DRUMS, strict=True):
            for mode, style in (("reference", "C0"), ("fast", "C1")):
                r = runs.get(f"{mode}-{tex:g}tex-{rpm}rpm")
                if r is not None:
                    axes.plot(r["time"], 100 * r["span"], style, lw=0.6, label=mode)
            axes.axhline(100 * case(tex, rpm).tension, color="k", lw=0.6)
            axes.set_title(f"{tex:g} tex, {rpm} r/min", fontsize=9)
    grid[-1, -1].legend(fontsize=8)  # the case that is run first in both modes
    figure.supxlabel("time (s)")
    figure.supylabel("tension between guide and bobbin (cN); black: T₀")
    figure.savefig(folder / "span_tension.svg", metadata=metadata)

    figure, axes = plt.subplots(1, 2, figsize=(10, 4), sharey=True, layout="constrained")
    for ax, name in zip(axes, ("stiff", "soft"), strict=True):
        ax.axhline(1, color="k", lw=0.6)
        for length, colour in ((4, "C2"), (2, "C0"), (1, "C3")):
            for mode, style in (("reference", "-o"), ("fast", "--")):
                r = runs.get(f"refine-{name}-{length}mm-{mode}")
                if r is not None:
                    layers = r["layers"]
                    ax.plot(range(1, len(layers) + 1), layers, style, color=colour, ms=3, label=f"{mode} {length} mm")
        ax.set(title=f"{name} yarn", xlabel="layer")
        if ax.lines[1:]:
            ax.legend(fontsize=7)
    axes[0].set_ylabel("T / T₀ at the end")
    figure.savefig(folder / "layers_refined.svg", metadata=metadata)

    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for mode in ("fast", "reference"):
        lengths = [m for m in LENGTHS if f"cost-{mode}-{m}m" in runs]
        seconds = [runs[f"cost-{mode}-{m}m"]["numbers"][1] for m in lengths]
        label, fitted = mode, [(m, t) for m, t in zip(lengths, seconds, strict=True) if m <= FITTED]
        if len(fitted) > 1:
            exponent = np.polyfit(*np.log(fitted).T, 1)[0]
            label = f"{mode}, exponent {exponent:.2f} from {fitted[0][0]} to {fitted[-1][0]} m"
        axes.loglog(lengths, seconds, "o-", label=label)
        if mode == "fast" and lengths:
            axes.loglog(lengths, seconds[0] * np.array(lengths) / lengths[0], "k:", lw=0.8, label="in proportion")
    axes.set(xlabel="yarn wound (m)", ylabel="CPU time (s)")
    axes.legend()
    figure.savefig(folder / "cost.svg", metadata=metadata)

    best = runs.get("refine-stiff-1mm-reference")
    if best is not None:
        figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
        for mode, mark in (("fast", "C1o"), ("reference", "C0s")):
            for length in (4, 2, 1):
                r = runs.get(f"refine-stiff-{length}mm-{mode}")
                if r is not None and r is not best:
                    error = np.sqrt(np.mean((by_phase(r) / by_phase(best) - 1) ** 2))
                    axes.loglog(r["numbers"][1], error, mark)
                    place, text = (r["numbers"][1], error), f"{mode} {length} mm"
                    shift, side = {4: ((-6, -3), "right"), 2: ((-6, -16), "left"), 1: ((6, -3), "left")}[length]
                    axes.annotate(text, place, shift, textcoords="offset points", ha=side, fontsize=8)
        axes.set(xlim=(5e-4, 300), ylim=(1e-3, 1e-1))
        axes.set(xlabel="CPU time (s)", ylabel="span tension over the guide cycle:\nrms deviation from reference 1 mm")
        figure.savefig(folder / "work_error.svg", metadata=metadata)


def main(study: str, folder: Path) -> None:
    """Run a study, then draw what is there."""
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    if study == "calibrate":
        calibrate(folder)
    elif study != "figures":
        scenes = STUDIES[study]()
        if study in ("reference", "refine", "deep"):
            with ProcessPoolExecutor(2) as pool:
                for line in pool.map(_niced, scenes.keys(), scenes.values(), [folder] * len(scenes)):
                    print(line, flush=True)
        else:
            for name, scene in scenes.items():
                print(run(name, scene, folder), flush=True)
    runs = read(folder)
    tables(runs, folder)
    figures(runs, folder)


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in (*STUDIES, "calibrate", "figures"):
        sys.exit(__doc__)
    main(sys.argv[1], Path(sys.argv[2]) if len(sys.argv) > 2 else Path("reports/winding"))
