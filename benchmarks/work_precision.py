"""What does a digit cost? Error of p₃AB against time per solve: each tier, and scipy's solve_bvp on the flexible yarn.

    python benchmarks/work_precision.py [FOLDER]      (default: reports)

writes work_precision.csv and work_precision.svg. One thread, warm, the paper's base scene (section 3). The error is
against the same model's most accurate solution here; times are medians.
"""

import csv
import math
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_bvp
from threadpoolctl import threadpool_limits

from models.boundary_value import solve
from models.cosserat import ROD as COSSERAT
from models.cosserat import solve_cosserat
from models.cosserat_fd import solve_cosserat_fd
from models.discretisation import chebyshev_collocation
from models.flexible import ORDERS as FLEXIBLE_ORDERS
from models.flexible import Flexible, solve_fields, solve_flexible, start_values
from models.kirchhoff import ROD as KIRCHHOFF
from models.kirchhoff import solve_kirchhoff
from models.scene import Dimensionless, Scene
from models.slow_manifold import ORDERS, Rod

SCENE = Scene(
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
REPEATS = 15

Row = tuple[str, str, float, float]
"""Method, setting, relative error of p₃AB, seconds per solve."""


def timed(work: Callable[[], float]) -> tuple[float, float]:
    """The result of `work` and its median time [s] after one warm-up."""
    result = work()
    seconds = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begin)
    return result, statistics.median(seconds)


def flexible_rows(d: Dimensionless) -> Iterator[Row]:
    """Collocation of fixed degree from the circle at constant tension."""
    exact = solve_flexible(SCENE).require().ends.tension_AB
    for degree in (4, 6, 8, 12, 16, 24):
        grid = chebyshev_collocation(degree, d.wrap_angle)
        start = np.zeros((3, degree + 1))
        start[2] = 2 * math.pi

        def work(grid=grid, start=start) -> float:
            return d.tension_CD * math.exp(solve(Flexible(d.vector), FLEXIBLE_ORDERS, grid, start, 0.0).fields[1, 0])

        tension, seconds = timed(work)
        yield "flexible", f"degree {degree}", abs(tension / exact - 1), seconds


def rod_rows(rod: Rod, exact: float, d: Dimensionless) -> Iterator[Row]:
    """Collocation of fixed degree from the flexible yarn; its solve counts."""
    for degree in (4, 6, 8, 10, 12, 14):
        grid = chebyshev_collocation(degree, d.wrap_angle)

        def work(grid=grid, degree=degree) -> float:
            flexible = solve_fields(d)[0]
            start = start_values(d, flexible, degree)
            return d.tension_CD * solve(rod.problem(d.vector), ORDERS, grid, start, flexible.w).fields[1, 0]

        tension, seconds = timed(work)
        yield rod.name, f"degree {degree}", abs(tension / exact - 1), seconds


def difference_rows(exact: float) -> Iterator[Row]:
    """The paper's scheme."""
    for intervals in (10, 20, 40, 80):
        tension, seconds = timed(lambda n=intervals: solve_cosserat_fd(SCENE, n).require().ends.tension_AB)
        yield "cosserat-fd", f"{intervals} intervals", abs(tension / exact - 1), seconds


def solve_bvp_rows(d: Dimensionless) -> Iterator[Row]:
    """Adaptive fourth-order collocation by scipy on the flexible yarn, in θ, p₃/p₃CD, τ with w as its parameter."""
    exact = solve_flexible(SCENE).require().ends.tension_AB

    def slope(_: np.ndarray, y: np.ndarray, p: np.ndarray) -> np.ndarray:
        sine, cosine = np.sin(y[0]), np.cos(y[0])
        spin = 2 * math.pi * d.yarn_radius * (p[0] - d.twist_CD)
        alpha = np.arctan2(d.cylinder_speed * cosine + 1, d.cylinder_speed * sine + spin)
        across = d.friction * np.cos(alpha) * sine
        pull = d.friction * np.sin(alpha) * sine * y[1]
        return np.array([across, pull, -across * d.yarn_radius * d.tension_CD * y[1]])

    def ends(b: np.ndarray, c: np.ndarray, p: np.ndarray) -> np.ndarray:
        twist_B = (b[2] - math.sin(b[0]) * math.cos(b[0])) / (2 * math.pi)
        geometry = d.span_ratio * math.cos(b[0]) + math.cos(c[0])
        twist_C = c[2] - math.sin(c[0]) * math.cos(c[0]) - 2 * math.pi * d.twist_CD
        return np.array([geometry, c[1] - 1, twist_C, p[0] - d.twist_rotation(twist_B)])

    psi = np.linspace(0, d.wrap_angle, 5)
    start = np.array([np.full(5, math.pi / 2), np.ones(5), np.full(5, 2 * math.pi)])
    for tolerance in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10):

        def work(tolerance=tolerance) -> float:
            found = solve_bvp(slope, ends, psi, start, p=[0.0], tol=tolerance, max_nodes=100_000)
            return d.tension_CD * found.y[1, 0]

        tension, seconds = timed(work)
        yield "flexible by solve_bvp", f"tol {tolerance:g}", abs(tension / exact - 1), seconds


def main(folder: Path) -> None:
    """Measure, write the table and draw the figure."""
    d = SCENE.dimensionless()
    with threadpool_limits(limits=1):
        cosserat = solve_cosserat(SCENE).require().ends.tension_AB
        kirchhoff = solve_kirchhoff(SCENE).require().ends.tension_AB
        rows = [
            *flexible_rows(d),
            *rod_rows(COSSERAT, cosserat, d),
            *rod_rows(KIRCHHOFF, kirchhoff, d),
            *difference_rows(cosserat),
            *solve_bvp_rows(d),
        ]
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "work_precision.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["method", "setting", "relative_error_p3_AB", "seconds_per_solve"])
        table.writerows([method, setting, f"{error:.3e}", f"{seconds:.3e}"] for method, setting, error, seconds in rows)
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for method in dict.fromkeys(row[0] for row in rows):
        points = [(1e3 * seconds, max(error, 1e-16)) for name, _, error, seconds in rows if name == method]
        axes.loglog(*zip(*points, strict=True), marker="o", label=method)
    axes.set(xlabel="time per solve (ms)", ylabel="relative error of p₃AB")
    axes.legend()
    figure.savefig(folder / "work_precision.svg", metadata={"Date": None})
    for method, setting, error, seconds in rows:
        print(f"{method:22} {setting:14} {error:9.1e} {1e3 * seconds:8.2f} ms")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("reports"))
