"""The results of `yarnval bench`: tables, figures and one page."""

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from pipeline.atomic import whole_file
from pipeline.bench import BVP, RANGES, SEED, Cost, Ending, Throughput, as_csv, fates
from pipeline.report.bench_figures import bench_figure, outcome_map
from pipeline.report.figures import to_svg
from pipeline.report.page import Page
from pipeline.report.tables import html_table, number

_COSTS = (
    "The error is that of p₃AB at the paper's base scene against the same model's converged solution; the time is the "
    "median of a warm solve on one thread. Of a row that names its stated error, the error is the model's own "
    "estimate. CasADi is compared where it is installed."
)
_ENDINGS = (
    "Random scenes far beyond practice. Explained: no solution, with the reason, which is a property of the equations "
    "(the branch folds back, the yarn lifts off or sticks, the elastic layers are not thin). Unexplained: the search "
    "failed. benchmarks/hard_cases.py also integrates every solution again by other means."
)
_RATES = (
    "Batches around the paper's first case on all cores, and the whole command with its start, reading and writing."
)


def write_bench(
    costs: Sequence[Cost], found: Sequence[Ending], rates: Sequence[Throughput], folder: Path
) -> dict[str, str]:
    """Write tables, figures and bench.html to `folder`, each file whole; return the tables' text by file name."""
    shares = fates(found)
    tables = {
        "work_precision.csv": as_csv(costs),
        "fates.csv": as_csv(shares),
        "throughput.csv": as_csv(rates),
    }
    methods = [method for method in dict.fromkeys(ending.method for ending in found) if method != BVP]
    drawings = {
        "work_precision": _svg(bench_figure(costs, shares), "work_precision"),
        "outcome_map": _svg(outcome_map(found, methods), "outcome_map"),
    }
    files = {**tables, "outcomes.csv": as_csv(found), "bench.html": _page(costs, found, rates, drawings)}
    files |= {f"{name}.svg": f'<?xml version="1.0" encoding="utf-8"?>\n{drawing}' for name, drawing in drawings.items()}
    for name, text in files.items():
        with whole_file(folder / name) as file:
            file.write(text)
    return tables


def _svg(figure: Figure, name: str) -> str:
    drawing = to_svg(figure, name)
    plt.close(figure)
    return drawing


def _page(costs: Sequence[Cost], found: Sequence[Ending], rates: Sequence[Throughput], drawings: dict[str, str]) -> str:
    page = Page("yarnval bench")

    def show(name: str, caption: str) -> None:
        page.output({"image/svg+xml": drawings[name]}, {"image/svg+xml": {"name": name, "caption": caption}})

    page.heading(1, "title", "What a digit costs, and how a solve ends")
    page.heading(2, "work-precision", "Error against time", _COSTS)
    show("work_precision", "Above: error against time, and time by the number of nodes. Below: how random scenes end.")
    page.html(html_table([_cost(row) for row in costs], "Error and time of each setting", 2))
    page.heading(2, "hard-cases", "Hard cases", _ENDINGS)
    show("outcome_map", "Each point is a random scene, coloured by how the solve of that model ended.")
    page.html(html_table(_outcomes(found), "Outcomes, % of the scenes", 2))
    page.heading(2, "batches", "Batches", _RATES)
    page.html(html_table([_rate(row) for row in rates], "Scenes per second, and a table's wall time", 1))
    ranges = "; ".join(f"{name} {low:.3g} to {high:.3g}" for name, (low, high) in RANGES.items())
    words = f"Made by yarnval {version('yarnval')}. Random scenes (SI units, seed {SEED}): {ranges}."
    page.heading(2, "provenance", "Provenance", words)
    return page.to_html()


def _cost(row: Cost) -> dict[str, str]:
    return {
        "Method": row.method,
        "Setting": row.setting,
        "Nodes": f'<data value="{row.nodes}">{row.nodes or "–"}</data>',
        "Relative error of p₃AB": _scientific(row.relative_error_p3_AB),
        "Time per solve (ms)": _scientific(1e3 * row.seconds_per_solve),
    }


def _outcomes(found: Sequence[Ending]) -> list[dict[str, str]]:
    rows: list[dict[str, str]] = []
    for method in dict.fromkeys(ending.method for ending in found):
        mine = [ending.outcome for ending in found if ending.method == method]
        for outcome in sorted(set(mine), key=mine.count, reverse=True):
            share = number(100 * mine.count(outcome) / len(mine), 2, why_missing="")
            rows.append({"Method": method, "Outcome": outcome.replace("_", " "), f"% of {len(mine)} scenes": share})
    return rows


def _rate(row: Throughput) -> dict[str, str]:
    return {
        "Model": row.model,
        "Scenes per second": number(row.scenes_per_second, 0, why_missing=""),
        f"Table of {row.scenes} rows, wall (s)": number(row.table_wall_s, 2, why_missing=""),
    }


def _scientific(value: float) -> str:
    return f'<data value="{value!r}">{value:.2g}</data>'
