"""Pictures of a comparison: models and the marks their methods read, and the ranking by J."""

import re
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ._compare import Comparison, Row
from ._notation import Units, number
from ._plot import EDGE, RECORD, Picture, draw_model, draw_record, finish, plain, response_panels
from ._record import StepRecord


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


def plot_comparison(
    comparison: Comparison,
    *,
    group: str = "all",
    count: int = 6,
    title: str | None = None,
    size: tuple[float, float] | None = None,
) -> Figure:
    """Record and the best models with the marks their methods read, residuals, and the ranking.

    Open marks are levels and times that a method reads off the record, thin lines its tangent.

    **Arguments:**

    - `group`: "all", "first" (first order), "second" (two poles) or "nth" (order chosen).
    - `count`: how many models are drawn, at most 7; the ranking has all of the group.
    - `title`: instead of the name of the file. `size`: of the figure, in inches.
    """
    rows = _rows(comparison, group)
    drawn = list(zip(rows[:count], LOOKS, strict=False))
    record = comparison.record
    height = max(5.5, 1.6 + 0.19 * len(rows))
    figure = Picture(figsize=size or (11.0, height), dpi=150, layout="constrained")
    grid = figure.add_gridspec(1, 2, width_ratios=[1.75, 1])
    left, right = (figure.add_subfigure(place) for place in grid)
    response, residuals = response_panels(left, record.labels)
    draw_record(response, record)
    for place, (row, (color, dashes, mark)) in enumerate(drawn):
        look: dict[str, Any] = {"color": color, "linestyle": dashes, "zorder": 3 + 0.1 * place}
        look["linewidth"] = 2.2 if place == 0 else 1.5
        if level_marks(row) or tangent_ends(row):  # in the legend alone
            look |= {"marker": mark, "markevery": [], "markerfacecolor": "none"}
        label = f"{row.method} ({number(row.fit_percent)} %)"
        draw_model(response, residuals, row.result.model, record, label=label, **look)
        _draw_marks(response, row, color, mark)
    shown = _title(record, group, f"best {len(drawn)} of {len(rows)} models")
    response.set_title(plain(shown if title is None else title), loc="left", fontsize=10)
    finish(response, residuals, record)
    low, high = response.get_ylim()
    response.set_ylim(max(low, _floor(record)), min(high, _ceiling(record)))
    columns = 2 if len(drawn) > 3 else 3
    left.legend(loc="outside lower center", ncols=columns, frameon=False, fontsize=9)
    _draw_bars(right.subplots(), rows, [color for _, (color, *_) in drawn], record)
    return figure


def plot_ranking(
    comparison: Comparison,
    *,
    group: str = "all",
    kind: str = "bar",
    title: str | None = None,
    size: tuple[float, float] | None = None,
) -> Figure:
    """J of every model of a group: `kind` "bar" on a logarithmic axis, or "pie".

    A pie shows the share of each method in the sum of all J: the best ones vanish in it.
    """
    rows = _rows(comparison, group)
    height = max(3.0, 1.2 + 0.24 * len(rows)) if kind == "bar" else 5.0
    figure = Picture(figsize=size or (7.0, height), dpi=150, layout="constrained")
    axes = figure.subplots()
    if kind == "bar":
        _draw_bars(axes, rows, [], comparison.record)
    else:
        _draw_pie(axes, rows)
    shown = _title(comparison.record, group, f"{len(rows)} models ranked by J")
    axes.set_title(plain(shown if title is None else title), loc="left", fontsize=10)
    return figure


_GROUP_NAMES = {"first": "first order", "second": "two poles", "nth": "nth order"}


def _title(record: StepRecord, group: str, what: str) -> str:
    """Record, what is shown of it, and the group where it is not all."""
    text = f"{record.labels.source or 'Record'}: {what}"
    return text if group == "all" else f"{text} ({_GROUP_NAMES[group]})"


def _rows(comparison: Comparison, group: str) -> tuple[Row, ...]:
    """Models of a group, or a sentence that there are none."""
    rows = comparison.models(group)
    if not rows:
        what = "model" if group == "all" else f"model of {_GROUP_NAMES[group]}"
        raise ValueError(f"The comparison has no {what} to draw.")
    return rows


def _floor(record: StepRecord) -> float:
    y = np.asarray(record.y)
    return float(y.min() - 0.3 * np.ptp(y))


def _ceiling(record: StepRecord) -> float:
    y = np.asarray(record.y)
    return float(y.max() + 0.3 * np.ptp(y))


# Marks


_LEVEL = re.compile(r"t(\d+(?:_\d+)?)$")


def level_marks(row: Row) -> list[tuple[float, float]]:
    """Points of the response that a method reads: time and output."""
    model, record, details = row.result.model, row.result.record, row.result.details
    initial = float(model.offset)
    change = float(model.gain) * float(record.step_size)
    points = [
        (float(value), float(match[1].replace("_", ".")) / 100)
        for name, value in details.items()
        if (match := _LEVEL.match(name))
    ]
    points += [
        (float(details[time]), float(details[height]))
        for time, height in (("t_read", "y_read"), ("t_i", "y_i"))
        if time in details
    ]
    start = float(record.step_time)
    return [(start + t, initial + level * change) for t, level in points]


def tangent_ends(row: Row) -> list[tuple[float, float]]:
    """Where a method's tangent meets the initial and the final level; empty if it has none."""
    model, record, details = row.result.model, row.result.record, row.result.details
    if "Tu" not in details or "Tg" not in details:
        return []
    initial, start = float(model.offset), float(record.step_time + details["Tu"])
    final = initial + float(model.gain) * float(record.step_size)
    return [(start, initial), (start + float(details["Tg"]), final)]


def _draw_marks(axes: Axes, row: Row, color: str, mark: str) -> None:
    if points := level_marks(row):
        axes.plot(
            *zip(*points, strict=True), linestyle="none", marker=mark, markersize=7,
            markerfacecolor="none", markeredgecolor=color, markeredgewidth=1.3, zorder=5,
        )  # fmt: skip
    if ends := tangent_ends(row):
        axes.plot(*zip(*ends, strict=True), color=color, linewidth=0.8, marker=mark, markersize=4)


# Ranking


def _draw_bars(axes: Axes, rows, colors: list[str], record: StepRecord) -> None:
    """Ranked J on a logarithmic axis, its value behind each bar."""
    values = np.array([row.J for row in rows])
    finite = values[np.isfinite(values)]
    largest = float(finite.max()) if finite.size and finite.max() > 0 else 1.0
    lowest = max(largest * 10.0**-DECADES, float(finite[finite > 0].min(initial=largest)))
    base = lowest / 3
    places = np.arange(len(rows))
    widths = np.where(np.isfinite(values), np.maximum(values, base), base)
    shades = colors + [RECORD] * (len(rows) - len(colors))
    axes.barh(places, widths - base, left=base, color=shades, height=0.62)
    for place, value, width in zip(places, values, widths, strict=True):
        axes.annotate(
            number(value, 3), (width, place), (3, 0), textcoords="offset points",
            va="center", fontsize=8,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xlim(base, largest * 10 ** (0.3 * np.log10(largest / base)))
    axes.set_yticks(places, [row.method for row in rows], fontsize=8)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    unit = Units.of(record.labels).integral
    axes.set_xlabel(plain(f"J ({unit})" if unit else "J, integral of the squared error"))
    axes.tick_params(axis="x", labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="x", color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)


def _draw_pie(axes: Axes, rows) -> None:
    """Shares of the sum of J, largest first; slices too thin for a label have none."""
    kept = [row for row in reversed(rows) if np.isfinite(row.J)]
    if not kept:
        raise ValueError("No model has a finite J, of which a pie could show the share.")
    values = np.array([row.J for row in kept])
    shares = values / values.sum() if values.sum() > 0 else np.full(len(kept), 1 / len(kept))
    greys = matplotlib.colormaps["YlGnBu_r"](np.linspace(0.1, 0.9, len(kept)))
    labels = [
        f"{row.method} {100 * share:.0f} %" if share > 0.02 else ""
        for row, share in zip(kept, shares, strict=True)
    ]
    axes.pie(
        shares, labels=labels, colors=[tuple(x) for x in greys], startangle=90, counterclock=False,
        wedgeprops={"edgecolor": "white", "linewidth": 0.8}, textprops={"fontsize": 8},
    )  # fmt: skip
    axes.set_xlabel("share in the sum of J", color=EDGE)
