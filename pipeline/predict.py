"""Predict: every model on every case, with the uncertainty that the inputs bring; and tables of scenes."""

import csv
import math
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from models import auto
from models.batch import Batch, solve_many
from models.outcome import SOLVED, Ends
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


NUMBERS = (
    "p3_AB_cN", "T_AB_tpm", "theta_B_deg", "theta_C_deg", "n1_per_s", "N_min_N_per_m", "u_num_p3_AB_cN",
    "u_num_T_AB_tpm", "u_num_theta_B_deg",
)  # fmt: skip
"""Columns of a prediction table that are NaN where there is no solution."""


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
            raise InputError(f"{file}: line 1", f"unknown column {name!r}", nearest(name, known))
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
        return TableScene(case, SceneKeys.model_validate(values).scene())
    except ValidationError as error:
        first = error.errors()[0]
        found = "is missing" if first["type"] == "missing" else f"is {first['input']}: {first['msg'].lower()}"
        return TableScene(case, None, f"line {number}, column {first['loc'][0]}: {found}")
    except ValueError as error:
        return TableScene(case, None, f"line {number}, {error}")


def predict_rows(
    scenes: Sequence[TableScene],
    models: Sequence[str],
    *,
    progress: Callable[[int], None] | None = None,
    tolerance: float = auto.TOLERANCE,
    wanted: Sequence[Quantity] = tuple(Quantity),
) -> Iterator[TableRow]:
    """Solve each scene with each model, in order; failed rows keep their reason.

    All valid scenes are solved at once, on all cores; `wall_s` is each row's share of the time that its model took.
    `progress` is called with the number of solves that were just done; `tolerance` and `wanted` are for `auto`.
    """
    valid = [scene.scene for scene in scenes if scene.scene is not None]
    inputs = {field.name: np.array([getattr(scene, field.name) for scene in valid]) for field in fields(Scene)}
    results: dict[str, Iterator[TableRow]] = {}
    for model in models:
        begin = time.perf_counter()
        with one_thread():
            batch = solve_many(
                inputs, model, progress=progress, tolerance=tolerance, wanted=[quantity.field for quantity in wanted]
            )
        share = (time.perf_counter() - begin) / max(len(valid), 1)
        results[model] = _rows([scene.case for scene in scenes if scene.scene is not None], batch, share)
    for scene in scenes:
        for model in models:
            yield next(results[model]) if scene.scene is not None else _bad_row(scene, model)


def _bad_row(scene: TableScene, model: str) -> TableRow:
    numbers = dict.fromkeys(NUMBERS, math.nan)
    return TableRow(
        case=scene.case, model=model, **numbers, outcome="bad_input", message=scene.reason, iterations=0, wall_s=0.0
    )


def _rows(cases: Sequence[str], batch: Batch, wall: float) -> Iterator[TableRow]:
    columns = {
        **{q.value: getattr(batch, q.field) * q.per_si for q in Quantity},
        **{f"u_num_{q.value}": getattr(batch, f"u_{q.field}") * q.per_si for q in Quantity},
        "theta_C_deg": np.degrees(batch.theta_C),
        "n1_per_s": batch.rotation,
        "N_min_N_per_m": batch.normal_force_min,
    }
    numbers = zip(*(columns[name].tolist() for name in NUMBERS), strict=True)
    fates = zip(batch.outcomes, batch.messages, batch.iterations.tolist(), strict=True)
    for case, values, (outcome, message, iterations) in zip(cases, numbers, fates, strict=True):
        yield TableRow(
            case=case,
            model=batch.model,
            **dict(zip(NUMBERS, values, strict=True)),
            outcome=outcome.name.lower(),
            message=message,
            iterations=iterations,
            wall_s=wall,
        )
