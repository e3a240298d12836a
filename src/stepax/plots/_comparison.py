"""Pictures of a comparison: models and the marks their methods read, and the ranking by J."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..models._abstract import AbstractPlant
from ..models._notation import number
from ..records._abstract import AbstractRecord
from ..records._labels import Units
from ..records._record import rows_that_count
from ._model import EDGE, RECORD, Picture, draw_model, draw_record, finish, literal, response_panels


LOOKS = [
    ("#0b2a4a", "-", "o"),
    ("#c8500a", (0, (6, 2)), "s"),
    ("#2a7f9e", (0, (5, 1.5, 1, 1.5)), "^"),
    ("#7a2f8a", (0, (1.2, 1.2)), "D"),
    ("#4f8a10", (0, (9, 2, 2, 2, 2, 2)), "v"),
    ("#b08900", (0, (3, 3)), "P"),
    ("#8c1d40", (0, (2, 1, 2, 4)), "X"),
]
"""Colour, dashes and mark of the drawn models, best first."""
DECADES = 12
"""Decades of J below the largest that a logarithmic axis shows."""
MOST_DRAWN = 6
"""Models that are drawn unless asked otherwise."""

Points = Sequence[tuple[float, float]]


class Entry(NamedTuple):
    """One model of a comparison: how good it is, and what its method read off the record.

    `marks`: points of the response, time and output. `tangent`: where the tangent meets the initial
    and the final level; empty where the method has none.
    """

    method: str
    model: AbstractPlant
    fit_percent: float
    J: float
    marks: Points = ()
    tangent: Points = ()


def plot_comparison(
    record: AbstractRecord,
    entries: Sequence[Entry],
    *,
    title: str,
    count: int = MOST_DRAWN,
    size: tuple[float, float] | None = None,
) -> Figure:
    """Record and the best models with the marks their methods read, residuals, and the ranking.

    Open marks are levels and times that a method reads off the record, thin lines its tangent.

    **Arguments:**

    - `entries`: best first; the ranking has all of them, `count` (at most 7) are drawn.
    - `size`: of the figure, in inches.
    """
    record = rows_that_count(record)
    drawn = list(zip(entries[:count], LOOKS, strict=False))
    height = max(5.5, 1.6 + 0.19 * len(entries))
    figure = Picture(figsize=size or (11.0, height), dpi=150, layout="constrained")
    grid = figure.add_gridspec(1, 2, width_ratios=[1.75, 1])
    left, right = (figure.add_subfigure(place) for place in grid)
    _draw_responses(left, record, drawn, title, 2 if len(drawn) > 3 else 3)
    _draw_bars(right.subplots(), entries, [color for _, (color, *_) in drawn], record)
    return figure


def plot_responses(
    record: AbstractRecord,
    entries: Sequence[Entry],
    *,
    count: int = MOST_DRAWN,
    size: tuple[float, float],
) -> Figure:
    """The same without the ranking and a title."""
    figure = Picture(figsize=size, dpi=150, layout="constrained")
    drawn = list(zip(entries[:count], LOOKS, strict=False))
    columns = 2 if size[0] > 6 else 1
    _draw_responses(figure, rows_that_count(record), drawn, "", columns)
    return figure


def _draw_responses(
    figure: Any, record: AbstractRecord, drawn: list[Any], title: str, columns: int
) -> None:
    """Record and models, each with its look, with marks and residuals, in a figure or part of one.

    Drawn is what fits beside the record: a model that runs away is cut off.
    """
    response, residuals = response_panels(figure, record)
    draw_record(response, record)
    for place, (entry, (color, dashes, mark)) in enumerate(drawn):
        look: dict[str, Any] = {"color": color, "linestyle": dashes, "zorder": 3 + 0.1 * place}
        look["linewidth"] = 2.2 if place == 0 else 1.5
        if entry.marks or entry.tangent:  # in the legend alone
            look |= {"marker": mark, "markevery": [], "markerfacecolor": "none"}
        label = f"{entry.method} ({number(entry.fit_percent)} %)"
        draw_model(response, residuals, entry.model, record, label=label, **look)
        _draw_marks(response, entry, color, mark)
    response.set_title(literal(title), loc="left", fontsize=10)
    finish(response, residuals, record)
    low, high = response.get_ylim()
    response.set_ylim(max(low, _floor(record)), min(high, _ceiling(record)))
    figure.legend(loc="outside lower center", ncols=columns, frameon=False, fontsize=9)


def plot_ranking(
    record: AbstractRecord,
    entries: Sequence[Entry],
    *,
    title: str,
    kind: str = "bar",
    size: tuple[float, float] | None = None,
) -> Figure:
    """J of every model: `kind` "bar" on a logarithmic axis, or "pie".

    A pie shows the share of each method in the sum of all J: the best ones vanish in it.
    """
    height = max(3.0, 1.2 + 0.24 * len(entries)) if kind == "bar" else 5.0
    figure = Picture(figsize=size or (7.0, height), dpi=150, layout="constrained")
    axes = figure.subplots()
    if kind == "bar":
        _draw_bars(axes, entries, [], record)
    else:
        _draw_pie(axes, entries)
    axes.set_title(literal(title), loc="left", fontsize=10)
    return figure


def _floor(record: AbstractRecord) -> float:
    y = np.asarray(record.y)
    return float(y.min() - 0.3 * np.ptp(y))


def _ceiling(record: AbstractRecord) -> float:
    y = np.asarray(record.y)
    return float(y.max() + 0.3 * np.ptp(y))


# Marks


def _draw_marks(axes: Axes, entry: Entry, color: str, mark: str) -> None:
    if entry.marks:
        axes.plot(
            *zip(*entry.marks, strict=True), linestyle="none", marker=mark, markersize=7,
            markerfacecolor="none", markeredgecolor=color, markeredgewidth=1.3, zorder=5,
        )  # fmt: skip
    if entry.tangent:
        ends = zip(*entry.tangent, strict=True)
        axes.plot(*ends, color=color, linewidth=0.8, marker=mark, markersize=4)


# Ranking


def _draw_bars(
    axes: Axes, entries: Sequence[Entry], colors: list[str], record: AbstractRecord
) -> None:
    """Ranked J on a logarithmic axis, its value behind each bar."""
    values = np.array([entry.J for entry in entries])
    finite = values[np.isfinite(values)]
    largest = float(finite.max()) if finite.size and finite.max() > 0 else 1.0
    lowest = max(largest * 10.0**-DECADES, float(finite[finite > 0].min(initial=largest)))
    base = lowest / 3
    places = np.arange(len(entries))
    widths = np.where(np.isfinite(values), np.maximum(values, base), base)
    shades = colors + [RECORD] * (len(entries) - len(colors))
    axes.barh(places, widths - base, left=base, color=shades, height=0.62)
    for place, value, width in zip(places, values, widths, strict=True):
        axes.annotate(
            number(value, 3), (width, place), (3, 0), textcoords="offset points",
            va="center", fontsize=8,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xlim(base, largest * 10 ** (0.3 * np.log10(largest / base)))
    axes.set_yticks(places, [entry.method for entry in entries], fontsize=8)
    axes.set_ylim(len(entries) - 0.4, -0.6)
    unit = Units.of(record.labels).integral
    axes.set_xlabel(literal(f"J ({unit})" if unit else "J, integral of the squared error"))
    axes.tick_params(axis="x", labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="x", color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)


def _draw_pie(axes: Axes, entries: Sequence[Entry]) -> None:
    """Shares of the sum of J, largest first; slices too thin for a label have none."""
    kept = [entry for entry in reversed(entries) if np.isfinite(entry.J)]
    if not kept:
        raise ValueError("No model has a finite J, of which a pie could show the share.")
    values = np.array([entry.J for entry in kept])
    shares = values / values.sum() if values.sum() > 0 else np.full(len(kept), 1 / len(kept))
    greys = matplotlib.colormaps["YlGnBu_r"](np.linspace(0.1, 0.9, len(kept)))
    labels = [
        f"{entry.method} {100 * share:.0f} %" if share > 0.02 else ""
        for entry, share in zip(kept, shares, strict=True)
    ]
    axes.pie(
        shares, labels=labels, colors=[tuple(x) for x in greys], startangle=90, counterclock=False,
        wedgeprops={"edgecolor": "white", "linewidth": 0.8}, textprops={"fontsize": 8},
    )  # fmt: skip
    axes.set_xlabel("share in the sum of J", color=EDGE)
