"""Picture of a study: error and refusals against the noise."""

from typing import Any

import numpy as np

from ..plots._comparison import LOOKS
from ..plots._model import Picture, quiet


DEEPEST = 1e-5
"""Lowest error on the axis over the largest median: what is exact would take all of the axis."""


def draw(results: Any, *, title: str | None = None, size: tuple[float, float] = (10.0, 6.5)):
    """Median error with its quartiles above, share of refusals below, a line a method."""
    table = results.summary(by=("method", "noise"), quantiles=(0.25, 0.5, 0.75), bootstrap=0)
    if table.empty:
        raise ValueError("There are no results to draw.")
    figure = Picture(figsize=size, dpi=150, layout="constrained")
    error, lost = figure.subplots(2, 1, sharex=True, height_ratios=[2.5, 1])
    error.set_yscale("log")
    for place, method in enumerate(results.study.options):
        part = table[table["method"] == method]
        color, dashes, mark = LOOKS[place % len(LOOKS)]
        marker = mark if len(part) < 30 else None
        style = {"color": color, "linestyle": dashes, "marker": marker}
        low, middle, high = (part[q].replace(np.inf, np.nan) for q in ("q25", "q50", "q75"))
        error.plot(100 * part["noise"], middle, label=method, **style)
        error.fill_between(100 * part["noise"], low, high, color=color, alpha=0.1, linewidth=0)
        lost.plot(100 * part["noise"], 100 * part["refused"], **style)
    medians = table["q50"].replace([np.inf, 0.0], np.nan)
    if medians.notna().any():
        error.set_ylim(bottom=max(0.5 * medians.min(), DEEPEST * medians.max()))
    study = results.study
    said = f"{study.plants} plants each of orders {', '.join(map(str, study.orders))}"
    error.set(ylabel="RMSE (share of the change),\nmedian and quartiles", title=title or said)
    lost.set(xlabel="noise, % of the change", ylabel="refused, %", ylim=(-2, 102))
    for axes in (error, lost):
        quiet(axes)
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    return figure
