"""Figures 9 to 13: the models on each system, their errors, and J before and after."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from experiments.drawing import new_figure, quiet
from experiments.jakoubek.cells import Row, rows
from experiments.jakoubek.drawing import HELP, LOOKS, SYSTEM
from experiments.jakoubek.outcome import Outcome
from experiments.jakoubek.published import METHODS
from experiments.jakoubek.systems import SYSTEMS, response


def run(name: str) -> Outcome:
    """System and models above, deviations below, for printed and for correct models; J beside."""
    system = SYSTEMS[name]
    judged = sorted(rows(name), key=lambda row: (np.isnan(row.J["correct"]), row.J["correct"]))
    t = np.linspace(0, 5 * sum(system.lags), 501)
    y = response(system.plant, t)
    frame = pd.DataFrame({"time_s": t, "system": y})

    figure = new_figure((13, 6))
    grid = figure.add_gridspec(1, 2, width_ratios=[2.1, 1])
    left, right = (figure.add_subfigure(grid[0, column]) for column in (0, 1))
    panels = left.subplots(2, 2, sharex=True, sharey="row", height_ratios=[1.7, 1])
    stages = (("printed", "Models as published"), ("correct", "Models, methods applied correctly"))
    for (upper, lower), (stage, title) in zip(panels.T, stages, strict=True):
        upper.plot(t, y, color=SYSTEM, linewidth=4, label="system")
        for row in judged:
            reading = getattr(row, stage)
            if reading.model is None:
                continue
            values = reading.response(t)
            frame[f"{row.cell.method}_{stage}"] = values
            look = LOOKS[row.cell.method]
            style = {"color": look.color, "linestyle": look.dashes, "linewidth": 1.5}
            upper.plot(t, values, label=METHODS[row.cell.method], **style)
            lower.plot(t, values - y, **style)
        upper.set_title(title, loc="left", fontsize=10)
        lower.axhline(0, color=HELP, linewidth=0.8)
        lower.set_xlabel("time (s)")
    panels[0, 0].set(ylabel="output", xlim=(0, t[-1]))
    panels[1, 0].set_ylabel("model - system")
    widest = max(np.abs(frame[name] - y).max() for name in frame if name.endswith("_correct"))
    panels[1, 0].set_ylim(-1.15 * widest, 1.15 * widest)
    if max(np.abs(frame[name] - y).max() for name in frame.columns[1:]) > 1.15 * widest:
        panels[1, 0].annotate(
            "larger errors are cut off", (0.98, 0.04), xycoords="axes fraction", ha="right",
            fontsize=8, color=HELP,
        )  # fmt: skip
    left.align_ylabels(panels[:, 0])
    handles, labels = panels[0, 0].get_legend_handles_labels()
    left.legend(
        handles, labels, loc="outside lower center", ncols=4, frameon=False, handlelength=4,
        fontsize=9,
    )  # fmt: skip
    bars = right.subplots()
    _draw_J(bars, judged)
    figure.suptitle(f"Figure {system.figure}: {name}, G(s) = {system.title}", fontsize=11)
    quiet((*panels.flat, bars))
    return Outcome(frame, figure)


FLOOR = 1e-9
"""Shortest bar: a J below it is drawn as long as this."""


def _draw_J(axes: Axes, judged: list[Row]) -> None:
    """Ranked J on a logarithmic axis: bars correct, marks published and recomputed."""
    places = np.arange(len(judged))
    correct = np.array([row.J["correct"] for row in judged])
    drawn = np.where(np.isnan(correct), 0, np.maximum(correct, FLOOR))
    axes.barh(places, drawn, color="0.75", height=0.62, label="correct")
    looks = (("published", "D", "published"), ("recomputed", "x", "paper's sampling"))
    for stage, marker, label in looks:
        values = np.maximum([row.J[stage] for row in judged], FLOOR)
        axes.plot(
            values, places, linestyle="none", marker=marker, color="0.05", markersize=6,
            markerfacecolor="none", markeredgewidth=1.3, label=label,
        )  # fmt: skip
    texts = ["not applicable" if np.isnan(J) else _short(J) for J in correct]
    names = [f"{METHODS[row.cell.method]}\n{text}" for row, text in zip(judged, texts, strict=True)]
    axes.set_yticks(places, names, fontsize=8)
    axes.set(xscale="log", xlim=(FLOOR / 2, 1), xlabel="J ((output unit)² s)")
    axes.set_ylim(len(judged) - 0.4, -0.6)
    axes.set_title("J against the system, best first", loc="left", fontsize=10)
    axes.figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=9)


def _short(J: float) -> str:
    return f"J < {FLOOR:g}" if J < FLOOR else f"J = {J:.2e}"
