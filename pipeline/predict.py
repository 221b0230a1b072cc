"""Predict: every model on every case, with the uncertainty that the inputs bring; and tables of scenes."""

import csv
import math
import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from models.outcome import SOLVED, Ends, Solution
from models.scene import Scene
from models.sensitivity import sensitivities
from models.solve import MODELS
from pipeline.case import Case
from pipeline.errors import InputError, nearest
from pipeline.keys import SceneKeys
from pipeline.records import Prediction, Quantity
from pipeline.threads import one_thread

TIMED_SOLVES = 3


def predict(case: Case, models: Sequence[str]) -> tuple[Prediction, ...]:
    """Solve one case with each model. A solve that fails keeps its place, with its outcome and reason."""
    with one_thread():
        return tuple(_predict_one(case, model) for model in models)


def _predict_one(case: Case, model: str) -> Prediction:
    solve = MODELS[model]
    solution = solve(case.scene)  # also warms the caches, so that the timed solves are alike
    seconds: list[float] = []
    for _ in range(TIMED_SOLVES):
        begin = time.perf_counter()
        solve(case.scene)
        seconds.append(time.perf_counter() - begin)
    u_input = input_uncertainty(case.scene, case.input_u, model) if solution.outcome.ok else Ends()
    return Prediction(case.name, solution, u_input, statistics.median(seconds))


def input_uncertainty(scene: Scene, input_u: Mapping[str, float], model: str) -> Ends:
    """Standard uncertainty of the ends from uncorrelated input uncertainties, to first order (GUM, Eq. 10).

    Parameters
    ----------
    input_u : standard uncertainty in SI by field name of `Scene`.

    Returns
    -------
    Ends
        In SI; NaN where no input uncertainty is stated or the model has no solution.
    """
    slopes = sensitivities(scene, model)
    stated = {field: u for field, u in input_u.items() if u > 0}
    if not stated or slopes is None:
        return Ends()
    terms = np.array([np.array(astuple(slopes[field])) * u for field, u in stated.items()])
    return Ends(*map(float, np.sqrt(np.sum(terms**2, axis=0))))


@dataclass(frozen=True, slots=True)
class TableRow:
    """One case and one model of a prediction table, in the units of the names."""

    case: str
    model: str
    p3_AB_cN: float
    T_AB_tpm: float
    theta_B_deg: float
    theta_C_deg: float
    n1_per_s: float
    N_min_N_per_m: float
    outcome: str
    message: str
    u_num_p3_AB_cN: float
    u_num_T_AB_tpm: float
    u_num_theta_B_deg: float
    iterations: int
    wall_s: float

    @property
    def ok(self) -> bool:
        """Whether the solve converged."""
        return self.outcome in SOLVED

    def as_json(self) -> dict[str, object]:
        """The row with null for numbers that are not known."""
        return {
            key: None if isinstance(value, float) and math.isnan(value) else value
            for key, value in asdict(self).items()
        }


@dataclass(frozen=True, slots=True)
class TableScene:
    """A row of the input table: a scene, or the reason why it is none."""

    case: str
    scene: Scene | None
    reason: str = ""


def read_table(file: Path) -> tuple[TableScene, ...]:
    """Read a table of scenes; a row that is no valid scene keeps its place with the reason.

    Raises
    ------
    InputError
        If the file cannot be read as CSV, a column is unknown, missing or double, or there are no rows.
    """
    try:
        text = file.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})", "give a CSV table of scenes") from None
    except UnicodeDecodeError as error:
        raise InputError(file, f"not UTF-8 text ({error.reason})", "save the table as CSV in UTF-8") from None
    lines = list(csv.reader(text.splitlines()))
    if not lines:
        raise InputError(file, "the file is empty", "a header row and one row per scene are needed")
    header = [name.strip() for name in lines[0]]
    if len(header) == 1 and ";" in header[0]:
        raise InputError(f"{file}: line 1", "semicolons between the columns", "save the table with commas and points")
    known = ["case", *SceneKeys.model_fields]
    for name in header:
        if name not in known:
            raise InputError(f"{file}: line 1", f"unknown column '{name}'", nearest(name, known))
        if header.count(name) > 1:
            raise InputError(f"{file}: line 1", f"column '{name}' stands twice", "keep one of them")
    required = [name for name, field in SceneKeys.model_fields.items() if field.is_required()]
    for name in ["case", *required]:
        if name not in header:
            raise InputError(f"{file}: line 1", f"column '{name}' is missing", f"needed: case, {', '.join(required)}")
    rows = [(number, cells) for number, cells in enumerate(lines[1:], start=2) if any(c.strip() for c in cells)]
    if not rows:
        raise InputError(file, "a header but no rows", "one row per scene is needed")
    return tuple(_table_scene(number, header, cells) for number, cells in rows)


def _table_scene(number: int, header: Sequence[str], cells: Sequence[str]) -> TableScene:
    given = {name: cell.strip() for name, cell in zip(header, cells, strict=False) if cell.strip()}
    case = given.pop("case", f"line {number}")
    if len(cells) != len(header):
        return TableScene(case, None, f"line {number}: {len(cells)} cells, the header has {len(header)}")
    values: dict[str, object] = {}
    for name, text in given.items():
        if name == "E_note":
            values[name] = text
            continue
        try:
            values[name] = float(text)
        except ValueError:
            return TableScene(case, None, f"line {number}, column {name}: '{text}' is not a number")
    try:
        return TableScene(case, SceneKeys.model_validate(values).scene()[0])
    except ValidationError as error:
        first = error.errors()[0]
        found = "is missing" if first["type"] == "missing" else f"is {first['input']}: {first['msg'].lower()}"
        return TableScene(case, None, f"line {number}, column {first['loc'][0]}: {found}")
    except ValueError as error:
        return TableScene(case, None, f"line {number}, {error}")


def predict_rows(scenes: Sequence[TableScene], models: Sequence[str]) -> Iterator[TableRow]:
    """Solve each scene with each model, in order; failed rows keep their reason."""
    for scene in scenes:
        for model in models:
            if scene.scene is None:
                yield _bad_row(scene, model)
                continue
            begin = time.perf_counter()
            with one_thread():
                solution = MODELS[model](scene.scene)
            yield _row(scene.case, model, solution, time.perf_counter() - begin)


def _bad_row(scene: TableScene, model: str) -> TableRow:
    nan = math.nan
    return TableRow(
        scene.case,
        model,
        nan,
        nan,
        nan,
        nan,
        nan,
        nan,
        "bad_input",
        scene.reason,
        nan,
        nan,
        nan,
        iterations=0,
        wall_s=0.0,
    )


def _row(case: str, model: str, solution: Solution, wall: float) -> TableRow:
    values = {q.value: q.of(solution.ends) * q.per_si for q in Quantity}
    errors = {f"u_num_{q.value}": q.of(solution.u_num) * q.per_si for q in Quantity}
    return TableRow(
        case=case,
        model=model,
        **values,
        theta_C_deg=math.degrees(solution.theta_C),
        n1_per_s=solution.rotation,
        N_min_N_per_m=solution.normal_force_min,
        outcome=solution.outcome.name.lower(),
        message=solution.message,
        **errors,
        iterations=solution.stats.iterations,
        wall_s=wall,
    )
