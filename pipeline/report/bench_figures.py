"""The figure of `yarnval bench`: error against time, how random scenes end, and cost against the number of nodes."""

import io
from collections.abc import Sequence

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from pipeline.bench import Cost, Fate


def bench_figure(costs: Sequence[Cost], fates: Sequence[Fate]) -> Figure:
    """Three panels from the measured rows."""
    figure, (precision, fate, nodes) = plt.subplots(1, 3, figsize=(12, 4.8), layout="constrained")
    for method in dict.fromkeys(cost.method for cost in costs):
        rows = sorted((c for c in costs if c.method == method), key=lambda c: c.seconds_per_solve)
        times = [1e3 * c.seconds_per_solve for c in rows]
        precision.loglog(times, [max(c.relative_error_p3_AB, 1e-16) for c in rows], marker="o", label=method)
        counted = sorted((c for c in rows if c.nodes > 1), key=lambda c: c.nodes)
        if counted:
            sizes, costs_ms = [c.nodes for c in counted], [1e3 * c.seconds_per_solve for c in counted]
            nodes.loglog(sizes, costs_ms, marker="o", label=method)
        else:
            nodes.plot([], [])  # keeps a method's colour the same in both panels
    precision.set(xlabel="time per solve (ms)", ylabel="relative error of p₃AB", title="Work and precision")
    figure.legend(*precision.get_legend_handles_labels(), loc="outside lower center", ncols=7, fontsize="small")
    nodes.set(xlabel="nodes", ylabel="time per solve (ms)", title="Cost by nodes")
    names = [row.method for row in fates]
    left = [0.0] * len(fates)
    for label, colour in (("solved", "C2"), ("explained", "C7"), ("unexplained", "C3")):
        widths = [100 * getattr(row, label) for row in fates]
        fate.barh(names, widths, left=left, color=colour, label=label)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    fate.invert_yaxis()
    fate.set(xlabel=f"% of {fates[0].scenes} random scenes", title="How they end")
    fate.legend(loc="upper center", bbox_to_anchor=(0.4, -0.14), ncols=3, fontsize="small")
    return figure


def svg(figure: Figure) -> str:
    """The figure as SVG text, without a date so that it changes only with the numbers."""
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    plt.close(figure)
    return text.getvalue()
