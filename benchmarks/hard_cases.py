"""Does every scene end in a right answer or a true outcome? Random scenes far beyond practice, all solutions rechecked.

    python benchmarks/hard_cases.py [COUNT] [FOLDER]      (default: 10000 scenes, reports)

writes hard_cases.csv (outcomes by model, and what the check found) and hard_cases.png (the map). Scenes: those
of `pipeline.bench.random_scenes`.

The check shares no code with models/: it reads a solution's profile and ends. Flexible: scipy's DOP853 integrates the
equations from one end to the other. Rods: θ is taken from the profile, p₃ and twist are integrated from B by DOP853,
and what is left of the balance across the yarn is compared with the forces in it: the third-order problem itself is
unstable as an initial-value problem. The rods' forces are written in the Frenet frame: the printed model is the same
with the twist in the place of the Frenet torsion. The rod with elastic spans, slow to check, is tried on a part of the
scenes: its polynomial for θ is compared with the profile, and the spans' conditions are tested, too. scipy's solve_bvp
solves the flexible yarn of all scenes from the first guess of `flexible`; what it calls a solution is compared with all
that `flexible` knows. (Four of the first 200 are none: there the yarn has turned past the axis, sinθ < 0.) The other
rods have too few boundary conditions for it.
"""

import csv
import math
import multiprocessing
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
from numpy.polynomial import Chebyshev
from scipy.integrate import solve_ivp
from threadpoolctl import threadpool_limits

from models import kirchhoff_spans
from models.discretisation import chebyshev_collocation
from models.flexible import solve_flexible
from models.outcome import Outcome, Solution
from models.scene import Dimensionless, Scene
from models.self_consistency import feedback, find_roots
from models.solve import MODELS
from pipeline.bench import Ending, random_scenes
from pipeline.peers import by_solve_bvp
from pipeline.report.bench_figures import outcome_map

CHECKED = {"flexible": 1, "cosserat": 1, "kirchhoff": 1, "kirchhoff-spans": 10}
"""Models, and of how many scenes one is tried."""
LARGEST_ERROR = {"flexible": 1e-6, "cosserat": 1e-3, "kirchhoff": 1e-3, "kirchhoff-spans": 1e-3}
"""What the check accepts. Rods may state an error of 1e-4 of their ends; their residual is of the same order."""
BVP_TOLERANCE = 1e-6
BVP_NODES = 20
BVP_ERROR = 1e-3
"""Of p₃AB, up to which what solve_bvp found counts as a solution of the scene."""


def direction(d: Dimensionless, theta: float, w: float) -> float:
    """The friction angle α."""
    spin = 2 * math.pi * d.yarn_radius * (w - d.twist_CD)
    return math.atan2(d.cylinder_speed * math.cos(theta) + 1, d.cylinder_speed * math.sin(theta) + spin)


def flexible_error(solution: Solution) -> float:
    """Largest relative mismatch at the other end, integrating from the end from which neighbouring paths converge."""
    d, r, force = solution.scene.dimensionless(), solution.scene.cylinder_radius, solution.scene.force_unit
    profile = solution.profile
    w = solution.rotation * r / solution.scene.delivery_speed

    def slope(_: float, y: np.ndarray) -> tuple[float, float, float, float]:
        q, _, _, _ = y
        sine, theta = 1 / math.cosh(q), 2 * math.atan(math.exp(q))
        alpha = direction(d, theta, w)
        step = 1e-6
        steeper = (math.cos(direction(d, 2 * math.atan(math.exp(q + step)), w)) - math.cos(alpha)) / step
        across = d.friction * math.cos(alpha)
        pull = math.exp(y[1]) * across * sine * d.yarn_radius * d.tension_CD
        return across, d.friction * math.sin(alpha) * sine, -pull, d.friction * steeper

    def state(i: int) -> np.ndarray:
        theta = profile.theta[i]
        tau = 2 * math.pi * profile.twist[i] * r + math.sin(theta) * math.cos(theta)
        return np.array([math.log(math.tan(theta / 2)), math.log(profile.tension[i] / force / d.tension_CD), tau, 0.0])

    def run(begin: int, end: int) -> tuple[np.ndarray, float]:
        span = (0.0, d.wrap_angle) if begin == 0 else (d.wrap_angle, 0.0)
        path = solve_ivp(slope, span, state(begin), method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        gap = path[:3] - state(end)[:3]
        gap[2] /= max(abs(state(0)[2]), abs(state(-1)[2]), 1.0)
        return gap, float(path[3])

    gap, stretch = run(0, -1)
    if stretch > 0:  # ∫ ∂q'/∂q > 0: neighbouring paths part towards C, so that C is the end to start from
        gap, _ = run(-1, 0)
    return max(float(np.max(np.abs(gap))), end_error(solution, d))


def end_error(solution: Solution, d: Dimensionless, turned_B: float = 0.0, turned_C: float = 0.0) -> float:
    """Largest mismatch of the four boundary conditions, from the stated ends and what the free spans add to θ there."""
    r, profile = solution.scene.cylinder_radius, solution.profile
    w = solution.rotation * r / solution.scene.delivery_speed
    twist = solution.ends.twist_AB * r
    wanted = d.twist_congestion * (twist - d.twist_trapping * d.twist_CD)
    geometry = d.span_ratio * math.cos(solution.ends.theta_B + turned_B) + math.cos(solution.theta_C + turned_C)
    return max(
        abs(geometry) / (1 + d.span_ratio),
        abs(w - wanted) / (1 + abs(w)),
        abs(profile.tension[-1] / solution.scene.tension_CD - 1),
        abs(profile.twist[-1] * r - d.twist_CD) / (1 + abs(d.twist_CD)),
    )


def frenet(t: list[float]) -> tuple[float, ...]:
    """κ, κ_s, κ_ss, a = sin²θ/κ, b = θ_s/κ, Frenet torsion and its derivative by s, from θ and three derivatives."""
    sine, cosine = math.sin(t[0]), math.cos(t[0])
    dsine = cosine * t[1]
    ddsine = cosine * t[2] - sine * t[1] ** 2
    # θ_s = sinθ θ' and g = sin²θ with two derivatives by ψ.
    h0, h1 = sine * t[1], dsine * t[1] + sine * t[2]
    h2 = ddsine * t[1] + 2 * dsine * t[2] + sine * t[3]
    g0, g1 = sine**2, 2 * sine * dsine
    g2 = 2 * (dsine**2 + sine * ddsine)
    kappa = math.hypot(h0, g0)
    kappa_1 = (h0 * h1 + g0 * g1) / kappa
    kappa_2 = (h1**2 + h0 * h2 + g1**2 + g0 * g2 - kappa_1**2) / kappa
    chi_1 = (h1 * g0 - h0 * g1) / kappa**2
    chi_2 = (h2 * g0 - h0 * g2) / kappa**2 - 2 * chi_1 * kappa_1 / kappa
    kappa_s, kappa_ss = sine * kappa_1, sine * (sine * kappa_2 + dsine * kappa_1)
    torsion = sine * cosine - sine * chi_1
    torsion_s = sine * ((cosine**2 - sine**2) * t[1] - dsine * chi_1 - sine * chi_2)
    return kappa, kappa_s, kappa_ss, g0 / kappa, h0 / kappa, torsion, torsion_s


def span_error(solution: Solution, theta: Chebyshev) -> float:
    """Largest of: mismatch of the boundary conditions with elastic spans, and of the polynomial with the profile."""
    d, force, profile = solution.scene.dimensionless(), solution.scene.force_unit, solution.profile
    turned, kept = [], []
    for end, sign in ((0, 1), (-1, -1)):
        angle, first, second = (float(f(profile.psi[end])) for f in (theta, theta.deriv(1), theta.deriv(2)))
        slope = math.sin(angle) * first
        bend = math.sin(angle) * (math.cos(angle) * first**2 + math.sin(angle) * second)
        length = math.sqrt(d.bending_rigidity * force / profile.tension[end])
        turned.append(-sign * length * slope)
        kept.append(abs(length * bend - sign * slope) / (1 + abs(slope)))
    unlike = float(np.max(np.abs(theta(profile.psi) - profile.theta)))
    return max(end_error(solution, d, *turned), unlike, *kept)


def rod_error(solution: Solution, theta: Chebyshev, at_ends: float, *, printed: bool) -> float:
    """Largest of: mismatch of p₃ and twist at C, that at the ends, and force left across relative to that in it."""
    d, r, force = solution.scene.dimensionless(), solution.scene.cylinder_radius, solution.scene.force_unit
    profile, B = solution.profile, d.bending_rigidity
    w = solution.rotation * r / solution.scene.delivery_speed
    derivatives = [theta, *(theta.deriv(k) for k in (1, 2, 3))]

    def forces(psi: float, pull: float, twist: float) -> tuple[float, float, float, float, float]:
        """N, α, force left across, the size of the terms in it, and κ p_n."""
        kappa, kappa_s, kappa_ss, a, b, torsion, torsion_s = frenet([float(f(psi)) for f in derivatives])
        angle = float(theta(psi))
        alpha = direction(d, angle, w)
        drag = d.friction * math.cos(alpha) * d.yarn_radius  # u₃,s = −drag N
        p_n, p_ns = -B * kappa_s, -B * kappa_ss
        if printed:
            torsion, torsion_s, own = twist, 0.0, (1 - B) * kappa
        else:
            own = kappa
        p_b = kappa * (twist - B * torsion)
        p_bs = kappa_s * (twist - B * torsion) - (0.0 if printed else kappa * B * torsion_s)  # and own · u₃,s
        bare_n, bare_b = p_ns + kappa * pull - torsion * p_b, p_bs + torsion * p_n
        normal = (a * bare_n + b * bare_b) / (1 + b * own * drag)
        bare_b -= own * drag * normal
        left = -b * bare_n + a * bare_b + d.friction * normal * math.cos(alpha)
        size = abs(b * bare_n) + abs(a * bare_b) + d.friction * abs(normal)
        return normal, alpha, left, size + abs(normal), kappa * p_n

    def slope(psi: float, y: np.ndarray) -> tuple[float, float]:
        normal, alpha, _, _, bend = forces(psi, y[0], y[1])
        sine = math.sin(float(theta(psi)))
        return (
            (bend + d.friction * normal * math.sin(alpha)) / sine,
            -d.friction * normal * math.cos(alpha) * d.yarn_radius / sine,
        )

    def tau(i: int) -> float:
        return 2 * math.pi * profile.twist[i] * r + math.sin(profile.theta[i]) * math.cos(profile.theta[i])

    path = solve_ivp(
        slope, (0.0, d.wrap_angle), (profile.tension[0] / force, tau(0)), method="DOP853", rtol=1e-9, atol=1e-9,
        dense_output=True,
    )  # fmt: skip
    pull, twist = path.y[:, -1]
    gap = max(abs(pull / d.tension_CD - 1), abs(twist - tau(-1)) / max(abs(tau(0)), abs(tau(-1)), 1.0))
    across = [forces(psi, *path.sol(psi))[2:4] for psi in np.linspace(0.0, d.wrap_angle, 41)]
    largest = max(size for _, size in across)
    return max(gap, at_ends, max(abs(left) for left, _ in across) / largest)


def check(solution: Solution) -> float:
    """The error of a solution by independent means."""
    with np.errstate(all="ignore"):
        if solution.model == "flexible":
            return flexible_error(solution)
        profile = solution.profile
        if solution.model == kirchhoff_spans.NAME:  # of too high a degree for the profile's points
            found, _ = kirchhoff_spans.find(solution.scene)
            length = solution.scene.wrap_angle
            nodes = chebyshev_collocation(found.degree, length).nodes
            theta = Chebyshev.fit(nodes, found.fields[0], found.degree, domain=[0, length])
            return rod_error(solution, theta, span_error(solution, theta), printed=False)
        theta = Chebyshev.fit(profile.psi, profile.theta, solution.stats.nodes - 1)  # a polynomial of known degree
        ends = end_error(solution, solution.scene.dimensionless())
        return rod_error(solution, theta, ends, printed=solution.model == "cosserat")


@dataclass(frozen=True)
class Row:
    """One scene and one model."""

    scene: int
    model: str
    outcome: Outcome
    message: str
    error: float
    seconds: float


def bvp_outcome(scene: Scene, flexible: Solution) -> str:
    """What solve_bvp makes of the flexible yarn, beside the solution that `flexible` took."""
    solved, tension, _ = by_solve_bvp(scene.dimensionless(), BVP_TOLERANCE, BVP_NODES, straight=True)
    if not solved:
        return "not_converged"
    tension *= scene.force_unit
    if abs(tension / flexible.ends.tension_AB - 1) <= BVP_ERROR:
        return "converged"
    unit = scene.delivery_speed / scene.cylinder_radius
    roots = find_roots(scene.dimensionless().vector).w
    others = [solve_flexible(scene, profile=False, rotation=w * unit) for w in roots]
    near = any(abs(tension / other.ends.tension_AB - 1) <= BVP_ERROR for other in others)
    return "converged to another solution" if near else "wrong"


def solve_row(work: tuple[int, Scene]) -> tuple[list[Row], str]:
    """All models on one scene, rechecked; and what became of solve_bvp."""
    number, scene = work
    rows = []
    with threadpool_limits(limits=1):
        for model, every in CHECKED.items():
            if number % every:
                continue
            begin = time.process_time()
            solution = MODELS[model](scene)
            seconds = time.process_time() - begin
            error = check(solution) if solution.outcome.ok else math.nan
            rows.append(Row(number, model, solution.outcome, solution.message, error, seconds))
            if model == "flexible":
                peer = bvp_outcome(scene, solution)
    return rows, peer


def main(count: int, folder: Path) -> None:
    """Solve, recheck, write the table and draw the map."""
    scenes = random_scenes(count)
    begin = time.perf_counter()
    solve_row((0, scenes[0]))  # compiles once, before there are two processes
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        results = list(pool.imap(solve_row, enumerate(scenes), chunksize=10))
    wall = time.perf_counter() - begin
    rows = [row for found, _ in results for row in found]
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "hard_cases.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["model", "outcome", "scenes", "percent", "wrong_by_check", "largest_error"])
        for model in CHECKED:
            mine = [row for row in rows if row.model == model]
            for outcome, number in Counter(row.outcome for row in mine).most_common():
                these = [row for row in mine if row.outcome is outcome]
                wrong = [row for row in these if outcome.ok and not row.error <= LARGEST_ERROR[model]]
                largest = f"{max(row.error for row in these):.1e}" if outcome.ok else ""
                mean = 1e3 * sum(row.seconds for row in these) / number
                print(f"{model}, {outcome.name.lower()}: {mean:.1f} ms of processor time each")
                percent = f"{100 * number / len(mine):.2f}"
                table.writerow([model, outcome.name.lower(), number, percent, len(wrong), largest])
                for row in wrong:
                    print(f"check: {model}, scene {row.scene}, error {row.error:.1e}")
            for row in mine:
                if row.outcome in (Outcome.NOT_CONVERGED, Outcome.SINGULAR):
                    print(f"cause unknown: {model}, scene {row.scene}: {row.message}")
        for outcome, number in Counter(peer for _, peer in results).most_common():
            share = f"{100 * number / count:.2f}"
            table.writerow(
                ["flexible by solve_bvp", outcome, number, share, number if outcome == "wrong" else "", "", ""]
            )
    gamma = feedback(np.array([scene.dimensionless().vector for scene in scenes]))
    found = [
        Ending(
            row.model,
            row.scene,
            scenes[row.scene].dimensionless().tension_CD,
            gamma[row.scene],
            row.outcome.name.lower(),
        )
        for row in rows
    ]
    outcome_map(found, tuple(CHECKED)).savefig(folder / "hard_cases.png", dpi=130)
    print((folder / "hard_cases.csv").read_text(encoding="utf-8"))
    several = [gamma[row.scene] for row in rows if row.outcome is Outcome.SEVERAL_SOLUTIONS]
    print(f"{count} scenes in {wall:.0f} s on two processes; several solutions from Γ = {min(several, default=0):.2f}")


if __name__ == "__main__":
    arguments = sys.argv[1:]
    main(int(arguments[0]) if arguments else 10_000, Path(arguments[1]) if len(arguments) > 1 else Path("reports"))
