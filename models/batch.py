"""Thousands of scenes at once, from arrays to arrays, on all cores.

The compiled models hold no lock of the interpreter, so plain threads share the rows out in chunks; memory is that of
the inputs and results. A row that is no valid scene or has no solution keeps its place, with its outcome and reason.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import MISSING, dataclass, fields
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models import auto, capstan, flexible
from models.diagnosis import WELL_SETTLED
from models.outcome import Outcome, Solution
from models.refinement import ROW, Ending
from models.scene import BENDING_RIGIDITY, TENSION_CD, Scene, normalised, valid_rows
from models.solve import MODELS, ROWS
from models.uniqueness import feedback_bounds

Array = NDArray[np.float64]

CHUNK = 256
"""Rows that a thread takes at a time: some milliseconds of work, so that progress is seen and threads end together."""


ELASTIC = 0.5
"""Share of the tension up to which bending and torsion leave layers that are faster than the solution."""
NUMBERS = (
    "tension_AB", "twist_AB", "theta_B", "u_tension_AB", "u_twist_AB", "u_theta_B", "theta_C", "rotation",
    "normal_force_min",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Batch:
    """Results in SI, arrays of shape (n,), in the order of the rows; NaN where a row has no solution."""

    model: str
    tension_AB: Array
    twist_AB: Array
    theta_B: Array
    u_tension_AB: Array
    """Estimated numerical error, as for `Solution.u_num`."""
    u_twist_AB: Array
    u_theta_B: Array
    theta_C: Array
    rotation: Array
    """n₁ [1/s]."""
    normal_force_min: Array
    """N [N/m]; also where the yarn lifts off."""
    iterations: NDArray[np.int64]
    outcomes: tuple[Outcome, ...]
    messages: tuple[str, ...]


def solve_many(
    inputs: Mapping[str, ArrayLike],
    model: str,
    *,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
    tolerance: float = auto.TOLERANCE,
    wanted: Sequence[str] = auto.ENDS,
) -> Batch:
    """Solve one scene per row.

    Parameters
    ----------
    inputs : values in SI by field name of `Scene`; arrays of shape (n,) or single numbers for all rows. Fields with a
        default may be left out.
    model : a name of `MODELS`.
    threads : as many as there are cores by default.
    progress : called from the calling thread with the number of rows that were just done.
    tolerance, wanted : for the model `auto`, see `auto.solve_auto`.

    Raises
    ------
    ValueError
        If a name is unknown or missing, or the shapes do not fit.
    """
    values = _columns(inputs)
    count = next(iter(values.values())).shape[0]
    valid = valid_rows(values)
    rows, workers = np.flatnonzero(valid), threads or os.cpu_count() or 1
    outcomes, messages = [Outcome.CONVERGED] * count, [""] * count
    columns: dict[str, Any] = {name: np.full(count, np.nan) for name in NUMBERS}
    columns["iterations"] = np.zeros(count, np.int64)
    for i in map(int, np.flatnonzero(~valid)):
        outcomes[i], messages[i] = Outcome.BAD_INPUT, _why_invalid(_row(values, i))
    one_by_one = rows
    if model in ROWS:
        chosen = {name: column[rows] for name, column in values.items()}
        vectors = np.ascontiguousarray(np.column_stack(list(normalised(SimpleNamespace(**chosen)).values())))
        table = _solve_table(ROWS[model], vectors, workers, progress)
        _fill(columns, rows, chosen, table)
        one_by_one = rows[_doubtful(model, vectors, table)]
    choose = {"tolerance": tolerance, "wanted": wanted} if model == auto.NAME else {}
    solve: Callable[..., Solution] = partial(MODELS[model], **choose)
    for i in map(int, one_by_one):
        found = solve(Scene(**_row(values, i)), profile=False)
        outcomes[i], messages[i] = found.outcome, found.message
        for name, number in _numbers(found).items():
            columns[name][i] = number
        if progress and model not in ROWS:
            progress(1)
    return Batch(model=model, outcomes=tuple(outcomes), messages=tuple(messages), **columns)


def _doubtful(model: str, vectors: Array, table: NDArray[Any]) -> NDArray[np.bool_]:
    """Rows whose outcome needs the single solve: no solution, perhaps several, a bad one, great elastic forces.

    Without these a single solve only repeats the compiled search, so that both give the same numbers. ELASTIC is a
    guess on the safe side: layers as slow as the solution need elastic forces greater than the tension.
    tests/exact/test_batch.py holds batches against single solves on random scenes.
    """
    doubtful = ~((table["ending"] == Ending.SETTLED) & (table["normal_min"] > 0))
    if model != capstan.NAME:
        doubtful |= ~(feedback_bounds(vectors) < 1)
    if model in (capstan.NAME, flexible.NAME):
        return doubtful
    tension = np.minimum(table["tension_AB"], vectors[:, TENSION_CD])
    elastic = np.maximum(vectors[:, BENDING_RIGIDITY], 2 * np.pi * np.abs(table["twist_AB"]))
    return doubtful | ~(elastic <= ELASTIC * tension) | (table["size"] > WELL_SETTLED)


def _solve_table(
    solve: Callable[[Array, Any], None],
    vectors: Array,
    workers: int,
    progress: Callable[[int], None] | None,
) -> NDArray[Any]:
    """Solve by compiled code, in chunks on threads."""
    table = np.zeros(vectors.shape[0], ROW).view(np.recarray)
    solve(vectors[:0], table[:0])  # compiles or loads the machine code once, before the threads ask for it
    with ThreadPoolExecutor(workers) as pool:
        chunks = [slice(start, start + CHUNK) for start in range(0, vectors.shape[0], CHUNK)]
        jobs = {pool.submit(solve, vectors[chunk], table[chunk]): chunk for chunk in chunks}
        for job in as_completed(jobs):
            job.result()
            if progress:
                progress(table[jobs[job]].shape[0])
    return table


def _fill(columns: dict[str, Any], rows: NDArray[np.int64], values: Mapping[str, Array], table: NDArray[Any]) -> None:
    """Write the numbers of the rows in SI, those of converged rows only but for iterations and a negative N."""
    scene = SimpleNamespace(**values)
    force, length = scene.torsional_rigidity / scene.cylinder_radius**2, scene.cylinder_radius
    units = {
        "tension_AB": force, "u_tension_AB": force, "twist_AB": 1 / length, "u_twist_AB": 1 / length, "theta_B": 1.0,
        "u_theta_B": 1.0, "theta_C": 1.0,
    }  # fmt: skip
    settled = table["ending"] == Ending.SETTLED
    in_contact = table["normal_min"] > 0
    for name, unit in units.items():
        columns[name][rows] = np.where(settled & in_contact, table[name] * unit, np.nan)
    columns["rotation"][rows] = np.where(settled & in_contact, table["w"] * scene.delivery_speed / length, np.nan)
    columns["normal_force_min"][rows] = np.where(settled, table["normal_min"] * force / length, np.nan)
    columns["iterations"][rows] = table["iterations"]


def _numbers(found: Solution) -> dict[str, float]:
    return {
        "tension_AB": found.ends.tension_AB,
        "twist_AB": found.ends.twist_AB,
        "theta_B": found.ends.theta_B,
        "u_tension_AB": found.u_num.tension_AB,
        "u_twist_AB": found.u_num.twist_AB,
        "u_theta_B": found.u_num.theta_B,
        "theta_C": found.theta_C,
        "rotation": found.rotation,
        "normal_force_min": found.normal_force_min,
        "iterations": found.stats.iterations,
    }


def _columns(inputs: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """An array of shape (n,) for every field of `Scene`."""
    known = {field.name: field.default for field in fields(Scene)}
    given: dict[str, Any] = {name: np.asarray(value, dtype=np.float64) for name, value in inputs.items()}
    for name in given:
        if name not in known:
            raise ValueError(f"unknown input '{name}'; known: {', '.join(known)}")
    for name, default in known.items():
        if name not in given:
            if default is MISSING:
                raise ValueError(f"input '{name}' is missing")
            given[name] = np.asarray(default, dtype=np.float64)
    try:
        columns = np.broadcast_arrays(*(given[name] for name in known))
    except ValueError:
        shapes = ", ".join(f"{name} {value.shape}" for name, value in given.items() if value.ndim)
        raise ValueError(f"the inputs have different lengths: {shapes}") from None
    if columns[0].ndim > 1:
        raise ValueError(f"inputs of shape {columns[0].shape}: one scene per row is needed, shape (n,)")
    return {name: np.atleast_1d(column) for name, column in zip(known, columns, strict=True)}


def _row(values: Mapping[str, Array], i: int) -> dict[str, float]:
    return {name: float(column[i]) for name, column in values.items()}


def _why_invalid(row: Mapping[str, float]) -> str:
    try:
        Scene(**row)
    except ValueError as error:
        return str(error)
    raise AssertionError(f"{row} is a valid scene")
