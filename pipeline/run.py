"""The pipeline, as five calls: ingest → measure → predict → compare → report."""

import platform
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from pipeline.case import Case, Study, load_study
from pipeline.compare import compare
from pipeline.errors import InputError
from pipeline.ingest.raw import read_raw
from pipeline.ingest.source import source
from pipeline.measure.case import measure_case
from pipeline.predict import predict
from pipeline.records import Measured, Results
from pipeline.report.write import write_report

PACKAGES = (
    "yarnval",
    "numpy",
    "scipy",
    "xarray",
    "opencv-python-headless",
    "av",
    "tifffile",
    "matplotlib",
    "nbconvert",
)


@dataclass(frozen=True, slots=True)
class Published:
    """Where the report of a study is, and which solves failed in it, one line each."""

    report: Path
    failures: tuple[str, ...]


def publish(study_folder: Path, out: Path) -> Published:
    """The whole pipeline for one study: `out`/<study name> holds the report, whole or not at all.

    Raises
    ------
    pipeline.errors.InputError
        If a study, case or raw file is wrong; then nothing is written.
    """
    results = evaluate(load_study(study_folder))
    folder = out / results.name
    write_report(results, folder)
    failures = tuple(
        f"{results.name}: {p.case} {p.solution.model}: {p.solution.outcome.name.lower()}: {p.solution.message}"
        for p in results.predictions
        if not p.solution.outcome.ok
    )
    return Published(folder / "report.html", failures)


def publish_all(study_folders: Sequence[Path], out: Path, processes: int = 2) -> list[Published]:
    """`publish` for several studies, `processes` at a time, in the order given.

    Raises
    ------
    pipeline.errors.InputError
        As `publish`; also if two studies have one name, before anything is written.
    """
    places: dict[str, Path] = {}
    for folder in study_folders:
        name = load_study(folder).name
        if name in places:
            raise InputError(folder / "study.toml", f"name '{name}' is also that of {places[name]}", "give it another")
        places[name] = folder
    if len(study_folders) == 1:
        return [publish(study_folders[0], out)]
    with ProcessPoolExecutor(processes) as pool:
        return list(pool.map(publish, study_folders, [out] * len(study_folders)))


def evaluate(study: Study) -> Results:
    """Ingest, measure, predict and compare, without a report."""
    measured = tuple(measure(case) for case in study.cases)
    predictions = tuple(prediction for case in study.cases for prediction in predict(case, study.models))
    return Results(
        name=study.name,
        title=study.title,
        source=study.source,
        synthetic=study.synthetic,
        notes=study.notes,
        fitted=study.fitted,
        measured=measured,
        predictions=predictions,
        comparisons=compare(study, measured, predictions),
        published={case.name: {q: (p.S, p.E_percent) for q, p in case.published.items()} for case in study.cases},
        provenance=_provenance(study, measured),
    )


def measure(case: Case) -> Measured:
    """Ingest and measure a case; a published summary is taken as it is."""
    if case.measured is not None:
        return case.measured
    if case.raw is None:
        raise ValueError(f"{case.name}: neither a summary nor raw files")  # keys.py lets no such case in
    logs, clips = read_raw(case.raw, case.path)
    return measure_case(case, logs, clips)


def _provenance(study: Study, measured: Sequence[Measured]) -> dict[str, object]:
    """What went in, by content, and what it was worked with. No paths of this machine, no times."""
    keys = [source(study.path / "study.toml", study.path)]
    keys += [source(case.path / "case.toml", study.path) for case in study.cases]
    raw = {
        f"{m.case}/{item.source.name}": item.source.sha256
        for m in measured
        for item in [*(log.raw for log in m.tension), *(clip.raw for clip in m.yarn)]
    }
    return {
        "study": study.name,
        "inputs_sha256": {k.name: k.sha256 for k in keys} | raw,
        "layouts": {f"{m.case}/{log.raw.source.name}": log.raw.layout for m in measured for log in m.tension},
        "models": list(study.models),
        "versions": {name: version(name) for name in PACKAGES} | {"python": platform.python_version()},
    }
