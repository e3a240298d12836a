"""Picture of a record and its model, as a matplotlib figure; host code.

Figures are built without pyplot: no window, no global state, no display needed. Every line differs
from the others in lightness or style, so that a print in grey can be read.
"""

import dataclasses
import textwrap
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._compilation import compiled, quick_compilation, rung
from ..models._abstract import AbstractPlant
from ..models._notation import number
from ..records._abstract import AbstractRecord
from ..records._input import InputRecord
from ..records._labels import Labels, unit_of
from ..records._record import StepRecord, padded_record, predict, rows_that_count


RECORD, MODEL, EDGE, SHADE = "0.55", "#0b2a4a", "0.35", "0.90"
POINTS_UP_TO = 400
"""Rows up to which a record is drawn as points; a longer one is a line."""
GRID = 801
"""Times at which a model is drawn."""


class Picture(Figure):
    """A figure that a notebook shows as it is."""

    def _repr_png_(self) -> bytes:
        from io import BytesIO

        buffer = BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def plot_model(
    record: AbstractRecord,
    model: AbstractPlant | None,
    *,
    title: str,
    size: tuple[float, float] = (8.0, 5.0),
    with_input: bool = False,
) -> Figure:
    """Record and model above, residuals below, on one axis of time; `size` in inches.

    Between them the input: of a sampled one, or the step too, `with_input`. Without a model, the
    record alone.
    """
    record = rows_that_count(record)
    figure = Picture(figsize=size, dpi=150, layout="constrained")
    response, residuals = response_panels(figure, record, with_input)
    draw_record(response, record)
    if model is not None:
        draw_model(response, residuals, model, record, color=MODEL, label="model")
        if isinstance(record, StepRecord):
            _shade_delay(response, residuals, record, float(np.asarray(model.delay)))
    response.set_title(literal(title), loc="left", fontsize=10)
    finish(response, residuals, record)
    columns = 4 if size[0] > 6 else 2
    figure.legend(loc="outside lower center", ncols=columns, frameon=False)
    return figure


def response_panels(
    figure: Any, record: AbstractRecord, with_input: bool = False
) -> tuple[Axes, Axes]:
    """Axes of the response and of the residuals in an empty figure, labelled.

    Between them those of the input, drawn: of a sampled one, or of a step, `with_input`.
    """
    labels, between = record.labels, with_input or isinstance(record, InputRecord)
    heights = [2.8, 0.8, 1] if between else [2.8, 1]
    response, *middle, residuals = figure.subplots(
        len(heights), 1, sharex=True, height_ratios=heights
    )
    inches = figure.bbox.height / figure.dpi
    response.set_ylabel(
        _wrapped(_label(labels.output, "output"), inches * heights[0] / sum(heights))
    )
    for axes in middle:
        unit = unit_of(labels.input)
        axes.set_ylabel(literal(f"input\n({unit})" if unit else "input"))
        _draw_input(axes, record)
    unit = unit_of(labels.output)
    residuals.set_ylabel(literal(f"residual\n({unit})" if unit else "residual"))
    residuals.set_xlabel(_label(labels.time, "time"))
    figure.align_ylabels([response, *middle, residuals])
    for axes in (response, *middle, residuals):
        axes.tick_params(labelsize=9)
    return response, residuals


def _draw_input(axes: Axes, record: AbstractRecord) -> None:
    """The input as it is held between samples, or the change of a step."""
    look: dict[str, Any] = {"color": EDGE, "linewidth": 1.0}
    if isinstance(record, InputRecord):
        held = "steps-post" if record.hold == "zero" else "default"
        axes.plot(record.t, record.u, drawstyle=held, **look)
    else:
        axes.plot(*input_line(record), **look)
    quiet(axes)
    axes.margins(y=0.25)


def input_line(record: AbstractRecord) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the input over the record: times and values; of a step the change alone.

    Its level before the step is not part of a record.
    """
    if isinstance(record, InputRecord):
        t, u = np.asarray(record.t), np.asarray(record.u)
        if record.hold == "first":
            return t, u
        return np.repeat(t, 2)[1:], np.repeat(u, 2)[:-1]
    assert isinstance(record, StepRecord)
    first, last = float(record.t[0]), float(record.t[-1])
    step, size = float(record.step_time), float(record.step_size)
    return np.array([min(first, step), step, step, last]), np.array([0.0, 0.0, size, size])


def draw_record(axes: Axes, record: AbstractRecord) -> None:
    """The record, grey; without rows of weight 0."""
    y = np.asarray(record.y)
    y = y if record.weights is None else np.where(np.asarray(record.weights) > 0, y, np.nan)
    axes.plot(record.t, y, **_record_look(record), color=RECORD, label="record")


def _record_look(record: AbstractRecord) -> dict[str, Any]:
    """Points for a short record, a thin line for a long one."""
    if record.t.size <= POINTS_UP_TO:
        return {"linestyle": "none", "marker": "o", "markersize": 3.2, "markeredgewidth": 0}
    return {"linewidth": 0.8}


def draw_model(
    response: Axes, residuals: Axes, model, record: AbstractRecord, *, label: str, **look
) -> None:
    """A model's line, with a kink where its dead time ends, and its residuals."""
    drawn = lines(model, record)
    look = {"linewidth": 1.5, "zorder": 3} | look
    response.plot(drawn.times, drawn.output, label=literal(label), **look)
    if label == "model":
        look = {**_record_look(record), "color": RECORD}
    else:
        look["linewidth"] = 0.9
    residuals.plot(record.t, drawn.residuals, **look)


class Lines(NamedTuple):
    """A model on a grid of times, and its residuals at the rows of a record."""

    times: np.ndarray
    output: np.ndarray
    residuals: np.ndarray


def lines(model: AbstractPlant, record: AbstractRecord) -> Lines:
    """What is drawn of a model beside a record, all rows of which count."""
    start, stop = float(record.t[0]), float(record.t[-1])
    kink = float(record.start_time + model.delay)
    grid = np.sort(np.append(np.linspace(start, stop, GRID), np.clip(kink, start, stop)))
    times = np.concatenate([record.t, grid]).astype(record.t.dtype)
    modelled = predicted(model, record, times)
    at_rows, on_grid = modelled[: record.t.size], modelled[record.t.size :]
    return Lines(grid, on_grid, np.asarray(record.y) - at_rows)


def predicted(model: AbstractPlant, record: AbstractRecord, times: np.ndarray) -> np.ndarray:
    """Output of a model at times, filled up to a rung: other lengths seldom compile anew."""
    filled = jnp.asarray(np.pad(times, (0, rung(times.size) - times.size), mode="edge"))
    record = padded_record(
        dataclasses.replace(record, labels=Labels(), details={}), rung(record.t.size)
    )
    with quick_compilation():
        return np.asarray(_predict(model, record, filled))[: times.size]


@compiled
def _predict(model: AbstractPlant, record: AbstractRecord, times):
    return predict(model, record, times)


def _shade_delay(response: Axes, residuals: Axes, record: StepRecord, delay: float) -> None:
    if delay <= 0:
        return
    unit = unit_of(record.labels.time)
    label = literal(f"dead time {number(delay, 3)} {unit}".rstrip())
    step_time = float(record.step_time)
    for axes, name in ((response, label), (residuals, None)):
        axes.axvspan(step_time, step_time + delay, color=SHADE, linewidth=0, zorder=0, label=name)


def finish(response: Axes, residuals: Axes, record: AbstractRecord) -> None:
    """The step, the zero of the residuals, limits, and a quiet frame."""
    for axes, label in ((response, "step"), (residuals, None)):
        if isinstance(record, StepRecord):
            look: dict[str, Any] = {"linewidth": 0.9, "linestyle": (0, (4, 3)), "label": label}
            axes.axvline(float(record.step_time), color=EDGE, **look)
        quiet(axes)
    residuals.axhline(0, color=EDGE, linewidth=0.8)
    residuals.margins(x=0.01)


def quiet(axes: Axes) -> None:
    """A frame that stays behind what is drawn."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)


def _label(name: str, role: str) -> str:
    """A column's name, or its role where it has only a number."""
    return literal(role if name.isdecimal() or not name else name)


def _wrapped(label: str, inches: float) -> str:
    """A name on as many lines as its axis is too short for it, at most three."""
    width = max(12, int(9.5 * inches))  # characters of ten points; the axis has no more than that
    return textwrap.fill(label, width, max_lines=3, placeholder=" …", drop_whitespace=True)


def literal(text: str) -> str:
    """Text that matplotlib does not read as mathematics."""
    return text.replace("$", r"\$")
