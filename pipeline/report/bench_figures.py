"""The figures of `yarnval bench`: error against time, how random scenes end and where, cost by the number of nodes."""

from collections.abc import Sequence

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from pipeline.bench import Cost, Ending, Fate

OUTCOMES = {
    "converged": "#9ecae1",
    "several_solutions": "#08519c",
    "fold": "#d94801",
    "no_scale_separation": "#bdbdbd",
    "unresolved": "#fdae6b",
    "lift_off": "#31a354",
    "sticking": "#984ea3",
    "not_converged": "#000000",
    "singular": "#000000",
}
MANY = 2000
"""Points from which on they are drawn as an image inside the SVG."""


def bench_figure(costs: Sequence[Cost], fates: Sequence[Fate]) -> Figure:
    """Three panels from the measured rows."""
    figure, panels = plt.subplot_mosaic(
        [["precision", "nodes"], ["fate", "fate"]], figsize=(8.2, 6.6), height_ratios=(3, 1), layout="constrained"
    )
    precision, nodes, fate = panels["precision"], panels["nodes"], panels["fate"]
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
    figure.legend(*precision.get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize="small")
    nodes.set(xlabel="nodes", ylabel="time per solve (ms)", title="Cost by nodes")
    names = [row.method for row in fates]
    left = [0.0] * len(fates)
    for label, colour in (("solved", "C2"), ("explained", "C7"), ("unexplained", "C3")):
        widths = [100 * getattr(row, label) for row in fates]
        fate.barh(names, widths, left=left, color=colour, label=label)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    fate.invert_yaxis()
    fate.set(xlabel=f"% of {fates[0].scenes} random scenes", title="How they end")
    fate.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
    figure.set_label("Error and time of each method, the outcomes of random scenes, and time by the number of nodes")
    return figure


def outcome_map(found: Sequence[Ending], methods: Sequence[str]) -> Figure:
    """Outcomes of random scenes over tension and the feedback of the twist, one panel a method."""
    figure, panels = plt.subplots(1, len(methods), figsize=(8.2, 3.9), sharey=True, layout="constrained", squeeze=False)
    for axes, method in zip(panels[0], methods, strict=True):
        mine = [ending for ending in found if ending.method == method]
        for outcome, colour in OUTCOMES.items():
            here = [ending for ending in mine if ending.outcome == outcome]
            if here:
                axes.scatter(
                    [ending.tension_bar for ending in here],
                    [max(ending.feedback, 1e-4) for ending in here],
                    s=5 if len(mine) > MANY else 12,
                    color=colour,
                    linewidths=0,
                    label=f"{outcome.replace('_', ' ')} ({len(here)})",
                    rasterized=len(mine) > MANY,
                )
        axes.set(xscale="log", yscale="log", xlabel="p₃CD r₀² / K", title=method)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), fontsize=7, markerscale=2)
    panels[0, 0].set_ylabel("Γ = η R₀² p₃CD (1 − exp(−μφ)) / K")
    figure.set_label("Outcomes of random scenes by tension and by the feedback of the twist on itself")
    return figure
