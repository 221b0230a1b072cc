"""Parameter studies: every value of every study, with every set of k and η, by every model; and quoted numbers.

All results are normalised as in the paper (lengths r₀, forces K/r₀², moments K/r₀; angles in degrees), whatever the
units of the base scene: their names end in `_bar` or `_deg`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.outcome import SOLVED, Profile, Solution
from models.scene import Scene
from models.solve import MODELS
from pipeline.errors import InputError, refuse_unknown
from pipeline.keys import DimensionlessKeys, ParameterKeys, SceneKeys, SetKeys, SweepKeys, read_toml, validated
from pipeline.records import Array
from pipeline.threads import one_thread

PROFILES = ("p3", "T", "theta", "bending", "torsion")
"""What is known along the contact, by the first part of a result's name."""


def dimensionless_profile(profile: Profile, scene: Scene) -> Mapping[str, Array]:
    """The profile by `PROFILES`, normalised; θ in degrees; also ψ in degrees and z in r₀. Arrays of shape (n,)."""
    return {
        "psi": np.degrees(profile.psi),
        "p3": profile.tension / scene.force_unit,
        "T": profile.twist * scene.cylinder_radius,
        "theta": np.degrees(profile.theta),
        "bending": profile.bending_moment / scene.moment_unit,
        "torsion": profile.torsional_moment / scene.moment_unit,
        "z": profile.z / scene.cylinder_radius,
    }


def _name(profile: str, part: str) -> str:
    return f"{profile}_{part}_{'deg' if profile == 'theta' else 'bar'}"


RESULTS = tuple(_name(profile, part) for profile in PROFILES for part in ("B", "C", "mean", "arc_mean"))
"""Names of a row's results: at B, at C, mean over ψ and mean over arc length."""


def results(solution: Solution) -> dict[str, float]:
    """The numbers of `RESULTS`; all NaN where there is no solution.

    A mean is (1/φ) ∫ · dψ, which is what the mean over the nodes of a grid uniform in ψ, the paper's, tends to. The
    paper does not say which mean it quotes, so the mean over arc length (weight ds = r₀ dψ / sinθ) stands beside it.
    """
    profile = solution.profile
    if not solution.outcome.ok or profile is None:
        return dict.fromkeys(RESULTS, math.nan)
    arc = 1 / np.sin(profile.theta)
    found = {}
    values = dimensionless_profile(profile, solution.scene)
    for name in PROFILES:
        y = values[name]
        found[_name(name, "B")] = float(y[0])
        found[_name(name, "C")] = float(y[-1])
        found[_name(name, "mean")] = float(np.trapezoid(y, profile.psi) / np.ptp(profile.psi))
        found[_name(name, "arc_mean")] = float(np.trapezoid(y * arc, profile.psi) / np.trapezoid(arc, profile.psi))
    return found


@dataclass(frozen=True, slots=True)
class Quoted:
    """A number that the source gives: `quantity` is one of `RESULTS`."""

    study: str
    value: float
    quantity: str
    published: float
    where: str


@dataclass(frozen=True, slots=True)
class Sweep:
    """A sweep file, checked."""

    name: str
    title: str
    path: Path
    source: str
    notes: tuple[str, ...]
    base: Mapping[str, Any]
    """Keys of the base scene as written, without k and eta."""
    normalised: bool
    """Whether `base` has the keys of `DimensionlessKeys`, not of `SceneKeys`."""
    models: tuple[str, ...]
    source_model: str
    sets: tuple[SetKeys, ...]
    studies: tuple[ParameterKeys, ...]
    relation_figure: str | None
    quoted: tuple[Quoted, ...]

    def scene(self, parameter: str, value: float, pair: SetKeys) -> Scene:
        """The base scene with one parameter changed.

        Raises
        ------
        ValueError
            If the value has no physical meaning; the message names the key.
        """
        given = {**self.base, parameter: value, "k": pair.k, "eta": pair.eta}
        if self.normalised:
            return DimensionlessKeys.model_validate(given).scene()
        return SceneKeys.model_validate(given).scene()


@dataclass(frozen=True, slots=True)
class SweepRow:
    """One value of one study with one set of k and η by one model. A failed row keeps its place and its reason."""

    study: ParameterKeys
    value: float
    pair: SetKeys
    model: str
    solution: Solution | None
    """None where the value makes no scene."""
    outcome: str
    message: str
    numbers: Mapping[str, float]
    """By `RESULTS`."""

    @property
    def ok(self) -> bool:
        """Whether the solve converged."""
        return self.outcome in SOLVED


@dataclass(frozen=True, slots=True)
class QuotedRow:
    """A quoted number beside ours."""

    quoted: Quoted
    pair: SetKeys
    model: str
    ours: float
    arc_mean: float
    """The same as a mean over arc length; NaN where the number is no mean."""
    message: str

    @property
    def difference_percent(self) -> float:
        """Ours minus the source's, in % of the source's."""
        return (self.ours / self.quoted.published - 1) * 100

    @property
    def arc_difference_percent(self) -> float:
        """As `difference_percent`, by the mean over arc length where the number is a mean."""
        ours = self.ours if math.isnan(self.arc_mean) else self.arc_mean
        return (ours / self.quoted.published - 1) * 100


@dataclass(frozen=True, slots=True)
class Agreement:
    """How near one model with one set comes to all quoted numbers; over the `known` ones of `total`."""

    model: str
    pair: SetKeys
    rms_percent: float
    max_percent: float
    arc_rms_percent: float
    """The same with means over arc length."""
    known: int
    total: int


def load_sweep(file: Path) -> Sweep:
    """Read and check a sweep file.

    Raises
    ------
    InputError
        If it is missing or not TOML, a key or name is unknown, missing, double or of the wrong kind, or the base scene
        has no meaning.
    """
    keys = validated(SweepKeys, read_toml(file, "give a sweep file, like data_samples/sweeps/*.toml"), file)
    for name in (*keys.models, keys.source_model):
        refuse_unknown(file, "model", name, list(MODELS))
    refuse_unknown(file, "source_model", keys.source_model, keys.models)
    for what, names in (
        ("model", keys.models),
        ("set", [pair.name for pair in keys.sets]),
        ("study", [study.name for study in keys.studies]),
        ("figure", [f for f in (keys.relation_figure, *(study.figure for study in keys.studies)) if f]),
    ):
        for name in names:
            if names.count(name) > 1:
                raise InputError(file, f"the {what} '{name}' is named twice", "name each once")
    base, normalised = _base(file, keys)
    kind = DimensionlessKeys if normalised else SceneKeys
    parameters = [key for key in kind.model_fields if key not in ("k", "eta", "tex", "E_note")]
    for study in keys.studies:
        refuse_unknown(f"{file}: study '{study.name}'", "parameter", study.parameter, parameters)
        for value in study.values:
            if study.values.count(value) > 1:
                raise InputError(f"{file}: study '{study.name}'", f"{value:g} is given twice", "give each value once")
    return Sweep(
        name=keys.name,
        title=keys.title,
        path=file,
        source=keys.source,
        notes=tuple(keys.notes),
        base=base,
        normalised=normalised,
        models=tuple(keys.models),
        source_model=keys.source_model,
        sets=tuple(keys.sets),
        studies=tuple(keys.studies),
        relation_figure=keys.relation_figure,
        quoted=tuple(_quoted(file, keys)),
    )


def _base(file: Path, keys: SweepKeys) -> tuple[dict[str, Any], bool]:
    """The base scene as given, proved to be one, and whether it is in normalised numbers."""
    normalised = keys.scene is None
    table, given = ("dimensionless", keys.dimensionless) if normalised else ("scene", keys.scene)
    base, where = given or {}, f"{file}: [{table}]"
    for key in ("k", "eta"):
        if key in base:
            raise InputError(where, f"'{key}' stands here", "give k and eta in [[sets]]")
    try:
        validated(DimensionlessKeys if normalised else SceneKeys, base, where).scene()
    except ValueError as error:
        raise InputError(where, *str(error).split(": ", 1)) from None
    return base, normalised


def _quoted(file: Path, keys: SweepKeys) -> list[Quoted]:
    studies = {study.name: study for study in keys.studies}
    found: list[Quoted] = []
    for number, row in enumerate(keys.quoted, 1):
        where = f"{file}: [[quoted]] number {number}"
        refuse_unknown(where, "study", row.study, list(studies))
        refuse_unknown(where, "quantity", row.quantity, list(RESULTS))
        if row.value not in studies[row.study].values:
            values = ", ".join(f"{value:g}" for value in studies[row.study].values)
            raise InputError(where, f"value {row.value:g} is not in study '{row.study}'", f"its values are {values}")
        if row.published == 0:
            raise InputError(where, "published = 0", "differences are in % of it: give a number that is not 0")
        if any((row.study, row.value, row.quantity) == (q.study, q.value, q.quantity) for q in found):
            raise InputError(where, "this number is given twice", "give each number once")
        found.append(Quoted(row.study, row.value, row.quantity, row.published, row.where))
    return found


def run_sweep(sweep: Sweep) -> tuple[SweepRow, ...]:
    """Solve everything, ordered by study, value, set and model."""
    with one_thread():
        return tuple(
            _solve(sweep, study, value, pair, model)
            for study in sweep.studies
            for value in study.values
            for pair in sweep.sets
            for model in sweep.models
        )


def _solve(sweep: Sweep, study: ParameterKeys, value: float, pair: SetKeys, model: str) -> SweepRow:
    try:
        scene = sweep.scene(study.parameter, value, pair)
    except ValueError as error:
        numbers = dict.fromkeys(RESULTS, math.nan)
        return SweepRow(study, value, pair, model, None, "bad_input", str(error), numbers)
    solution = MODELS[model](scene)
    outcome = solution.outcome.name.lower()
    return SweepRow(study, value, pair, model, solution, outcome, solution.message, results(solution))


def quoted_rows(sweep: Sweep, rows: Sequence[SweepRow]) -> tuple[QuotedRow, ...]:
    """Every quoted number beside ours, ordered by number, model and set."""
    by_place = {(row.study.name, row.value, row.pair.name, row.model): row for row in rows}
    found = []
    for quoted in sweep.quoted:
        for model in sweep.models:
            for pair in sweep.sets:
                row = by_place[quoted.study, quoted.value, pair.name, model]
                arc_name = quoted.quantity.replace("_mean_", "_arc_mean_")
                arc = row.numbers[arc_name] if arc_name != quoted.quantity else math.nan
                found.append(QuotedRow(quoted, pair, model, row.numbers[quoted.quantity], arc, row.message))
    return tuple(found)


def agreements(sweep: Sweep, quoted: Sequence[QuotedRow]) -> tuple[Agreement, ...]:
    """Root mean square and largest difference from the quoted numbers, by model and set."""
    found = []
    for model in sweep.models:
        for pair in sweep.sets:
            here = [row for row in quoted if (row.model, row.pair.name) == (model, pair.name)]
            known = [row for row in here if math.isfinite(row.ours)]
            difference = np.array([row.difference_percent for row in known])
            arc = np.array([row.arc_difference_percent for row in known])
            found.append(
                Agreement(
                    model=model,
                    pair=pair,
                    rms_percent=float(np.sqrt(np.mean(difference**2))) if known else math.nan,
                    max_percent=float(np.max(np.abs(difference))) if known else math.nan,
                    arc_rms_percent=float(np.sqrt(np.mean(arc**2))) if known else math.nan,
                    known=len(known),
                    total=len(here),
                )
            )
    return tuple(found)
