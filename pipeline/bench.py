"""What a digit costs and how often a solve fails: each model beside other programs, in one run.

Warm, one thread, medians. Errors are of p₃AB at the paper's base scene (section 3), against the same model's converged
solution. The peers (peers.py) solve the flexible yarn.
"""

import csv
import io
import math
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from models import capstan, cosserat, flexible, kirchhoff
from models.batch import solve_many
from models.cosserat_fd import solve_cosserat_fd
from models.discretisation import derivatives, integrals
from models.outcome import Outcome
from models.scene import Scene
from models.self_consistency import feedback
from models.slow_manifold import Rod, collocation_matrices, find
from models.solve import MODELS, ROWS
from pipeline.peers import CASADI_ORDER, HAVE_CASADI, by_casadi, by_shooting, by_solve_bvp
from pipeline.threads import one_thread

BASE = Scene(
    wrap_angle=math.radians(60),
    cylinder_radius=1.0,
    yarn_radius=0.03,
    friction=0.8,
    twist_CD=1.0,
    tension_CD=600.0,
    torsional_rigidity=1.0,
    delivery_speed=1.0,
    cylinder_speed_ratio=1.0,
)
RANGES = {
    "wrap_angle": (math.radians(2), math.radians(360)),
    "friction": (0, 1.5),
    "cylinder_speed_ratio": (-2, 10),
    "twist_trapping": (0, 1.2),
    "twist_congestion": (0, 1.5),
    "span_ratio": (0.1, 10),
    "twist_CD": (-1500, 1500),
    "tension_CD": (0.5e-2, 300e-2),
    "cylinder_radius": (0.5e-3, 30e-3),
    "yarn_radius": (0.025e-3, 0.5e-3),
    "torsional_rigidity": (1e-10, 1e-7),
}
"""Far beyond practice."""
LOG_UNIFORM = {"span_ratio", "tension_CD", "cylinder_radius", "yarn_radius", "torsional_rigidity"}
SEED = 20260
FINEST = 16
"""Degree that stands for the rods' exact solution at the base scene: 14 and 16 agree to 2e-10."""
SECONDS = 0.2
"""Spent on timing one setting."""
UNEXPLAINED = (Outcome.NOT_CONVERGED, Outcome.SINGULAR)
STATED = "own choice of degree, its stated error"
BVP, SHOOTING, CASADI = "flexible by solve_bvp", "flexible by shooting", "flexible by CasADi"


@dataclass(frozen=True, slots=True)
class Cost:
    """One method at one setting."""

    method: str
    setting: str
    nodes: int
    relative_error_p3_AB: float
    seconds_per_solve: float


@dataclass(frozen=True, slots=True)
class Ending:
    """How one method ended on one random scene."""

    method: str
    scene: int
    tension_bar: float
    """p₃CD r₀²/K."""
    feedback: float
    """Γ of models/self_consistency.py: how strongly the twist acts on itself."""
    outcome: str


@dataclass(frozen=True, slots=True)
class Fate:
    """How the random scenes ended, as shares of their number."""

    method: str
    scenes: int
    solved: float
    explained: float
    """No solution, with the reason: fold, sticking, lift-off, no scale separation."""
    unexplained: float


@dataclass(frozen=True, slots=True)
class Throughput:
    """Scenes per second of a batch on all cores, and of a whole `yarnval predict` with its start."""

    model: str
    scenes: int
    scenes_per_second: float
    table_wall_s: float


def random_scenes(count: int, seed: int = SEED) -> list[Scene]:
    """The first `count` scenes of a set that is uniform in RANGES, or log-uniform; numpy's default generator."""
    parts = np.random.default_rng(seed).random((count, len(RANGES)))
    return [
        Scene(
            delivery_speed=0.2,
            **{
                name: low * (high / low) ** part if name in LOG_UNIFORM else low + (high - low) * part
                for (name, (low, high)), part in zip(RANGES.items(), row, strict=True)
            },
        )
        for row in parts
    ]


def work_precision() -> list[Cost]:
    """Every method at rising accuracy."""
    with one_thread():
        return [*_flexible(), *_rod(cosserat.ROD), *_rod(kirchhoff.ROD), *_differences(), *_peers()]


def _timed(work: Callable[[], float]) -> tuple[float, float]:
    """The result and the median time [s] after one warm-up."""
    result = work()
    seconds: list[float] = []
    while sum(seconds) < SECONDS or len(seconds) < 3:
        begin = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begin)
    return result, statistics.median(seconds)


def _flexible() -> Iterator[Cost]:
    vector, matrices = BASE.dimensionless().vector, flexible.integration_matrices()
    exact = flexible.find(vector, matrices).ends[0]
    for degree in (4, 6, 8, 12, 16):
        same = integrals((degree, degree))  # settles at the second, which checks the first
        tension, seconds = _timed(lambda same=same: flexible.find(vector, same).ends[0])
        yield Cost(flexible.NAME, f"degree {degree}", degree + 1, abs(tension / exact - 1), seconds)
    found = flexible.find(vector, matrices)
    _, seconds = _timed(lambda: flexible.find(vector, matrices).size)
    yield Cost(flexible.NAME, STATED, found.degree + 1, found.size, seconds)
    tension, seconds = _timed(lambda: capstan.find(vector).ends[0])
    yield Cost(capstan.NAME, "closed form", 1, abs(tension / exact - 1), seconds)


def _rod(rod: Rod) -> Iterator[Cost]:
    vector, integration, matrices = BASE.dimensionless().vector, flexible.integration_matrices(), collocation_matrices()

    def at_degree(degree: int) -> float:
        same = derivatives((degree, degree))  # settles at the second, which checks the first
        return find(rod.problem(vector), integration, same).ends[0]

    exact = at_degree(FINEST)
    for degree in (4, 6, 8, 10, 12):
        tension, seconds = _timed(lambda degree=degree: at_degree(degree))
        yield Cost(rod.name, f"degree {degree}", degree + 1, abs(tension / exact - 1), seconds)
    found = find(rod.problem(vector), integration, matrices)
    _, seconds = _timed(lambda: find(rod.problem(vector), integration, matrices).size)
    yield Cost(rod.name, STATED, found.degree + 1, found.size, seconds)


def _differences() -> Iterator[Cost]:
    exact = cosserat.solve_cosserat(BASE, profile=False).require().ends.tension_AB
    for intervals in (10, 20, 40, 80):
        tension, seconds = _timed(lambda n=intervals: solve_cosserat_fd(BASE, n, profile=False).ends.tension_AB)
        yield Cost("cosserat-fd", f"{intervals} intervals", intervals + 1, abs(tension / exact - 1), seconds)


def _peers() -> Iterator[Cost]:
    d, exact = BASE.dimensionless(), flexible.solve_flexible(BASE, profile=False).require().ends.tension_AB

    def cost(method: str, setting: str, nodes: int, work: Callable[[], float]) -> Cost:
        tension, seconds = _timed(work)
        return Cost(method, setting, nodes, abs(tension / exact - 1), seconds)

    for tolerance in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10):
        nodes = by_solve_bvp(d, tolerance)[2]
        yield cost(BVP, f"tol {tolerance:g}", nodes, lambda tolerance=tolerance: by_solve_bvp(d, tolerance)[1])
    for tolerance in (1e-4, 1e-6, 1e-8, 1e-10):
        yield cost(SHOOTING, f"tol {tolerance:g}", 0, lambda tolerance=tolerance: by_shooting(d, tolerance))
    for intervals in (1, 2, 4) if HAVE_CASADI else ():
        nodes = 1 + intervals * (CASADI_ORDER + 1)
        yield cost(CASADI, f"{intervals} × {CASADI_ORDER} points", nodes, by_casadi(d, intervals))


def endings(count: int) -> list[Ending]:
    """How the first `count` random scenes end with each model, and with solve_bvp from the same first guess."""
    found: list[Ending] = []
    with one_thread():
        for i, scene in enumerate(random_scenes(count)):
            d = scene.dimensionless()
            place = i, d.tension_CD, float(feedback(d.vector))
            for model in (flexible.NAME, cosserat.NAME, kirchhoff.NAME):
                outcome = MODELS[model](scene, profile=False).outcome
                found.append(Ending(model, *place, outcome.name.lower()))
            solved = by_solve_bvp(d, 1e-6, 20, straight=True)[0]
            outcome = Outcome.CONVERGED if solved else Outcome.NOT_CONVERGED
            found.append(Ending(BVP, *place, outcome.name.lower()))
    return found


def fates(found: Sequence[Ending]) -> list[Fate]:
    """Shares of the outcomes of each method."""
    shares: list[Fate] = []
    for method in dict.fromkeys(ending.method for ending in found):
        outcomes = [Outcome[ending.outcome.upper()] for ending in found if ending.method == method]
        count = len(outcomes)
        solved = sum(outcome.ok for outcome in outcomes)
        unexplained = sum(outcome in UNEXPLAINED for outcome in outcomes)
        explained = count - solved - unexplained
        shares.append(Fate(method, count, solved / count, explained / count, unexplained / count))
    return shares


def throughput(count: int) -> list[Throughput]:
    """Batches around the first published case, as for its uncertainty: in memory, and through the command."""
    rng = np.random.default_rng(SEED)

    def around(value: float, cv: float) -> np.ndarray:
        return value * (1 + cv * rng.uniform(-2, 2, count))

    inputs = {
        "wrap_angle": around(math.radians(50), 0.05),
        "cylinder_radius": np.full(count, 3e-3),
        "yarn_radius": np.full(count, 8e-5),
        "friction": around(0.81, 0.05),
        "twist_CD": around(902, 0.15),
        "tension_CD": around(0.1653, 0.05),
        "torsional_rigidity": around(4.87e-9, 0.14),
        "delivery_speed": np.full(count, 0.16),
        "cylinder_speed_ratio": around(2, 0.05),
    }
    rows: list[Throughput] = []
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "table.csv"
        table.write_text(_as_table(inputs, count), encoding="utf-8")
        for model in ROWS:
            solve_many({name: values[:2] for name, values in inputs.items()}, model)
            with one_thread():
                begin = time.perf_counter()
                solve_many(inputs, model)
                rate = count / (time.perf_counter() - begin)
            arguments = ["predict", str(table), "--model", model, "--out", str(Path(folder) / "out.csv")]
            start = "import sys; from pipeline.cli import main; sys.exit(main())"
            begin = time.perf_counter()
            subprocess.run([sys.executable, "-c", start, *arguments], capture_output=True, check=True)
            rows.append(Throughput(model, count, rate, time.perf_counter() - begin))
    return rows


def _as_table(inputs: dict[str, np.ndarray], count: int) -> str:
    units = {
        "phi_deg": ("wrap_angle", math.degrees(1)), "r0_mm": ("cylinder_radius", 1e3), "d_mm": ("yarn_radius", 2e3),
        "mu": ("friction", 1), "T_CD_tpm": ("twist_CD", 1), "p3_CD_cN": ("tension_CD", 100),
        "K_Nm2": ("torsional_rigidity", 1), "v_m_s": ("delivery_speed", 1), "vb_over_v": ("cylinder_speed_ratio", 1),
    }  # fmt: skip
    columns = [inputs[name] * unit for name, unit in units.values()]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["case", *units])
    writer.writerows([i, *(float(column[i]) for column in columns)] for i in range(count))
    return text.getvalue()


def as_csv(rows: Sequence[Cost] | Sequence[Ending] | Sequence[Fate] | Sequence[Throughput]) -> str:
    """The rows as a table with the field names as its header."""
    names = [field.name for field in fields(rows[0])]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        values = [getattr(row, name) for name in names]
        writer.writerow([f"{value:.4g}" if isinstance(value, float) else value for value in values])
    return text.getvalue()
