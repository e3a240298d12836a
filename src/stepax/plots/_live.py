"""The same pictures as Bokeh's, with zoom and hover; for pages and the app, host code.

Bokeh is an extra (`stepax[app]`) and imported where something is drawn. Names from files are set as
plain text: Bokeh would read `$$` in them as mathematics and load a typesetter for it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from ..models._notation import number
from ..records._abstract import AbstractRecord
from ..records._labels import Labels, Units, unit_of
from ..records._record import StepRecord, rows_that_count
from ..records._residuals import Autocorrelation
from ._comparison import DECADES, LOOKS, MOST_DRAWN, Entry
from ._model import EDGE, MODEL, POINTS_UP_TO, RECORD, SHADE, input_line, lines


GREY, DARK, FRAME, BAND = (to_hex(x) for x in (RECORD, MODEL, EDGE, SHADE))
DASHES = ("solid", [10, 4], [8, 3, 2, 3], [3, 3], [12, 3, 3, 3], [5, 5], [3, 2, 3, 6])
"""Dashes of the drawn models, as in `LOOKS`."""


def has_bokeh() -> bool:
    """Whether the extra is there."""
    from importlib.util import find_spec

    return find_spec("bokeh") is not None


def panel(height: int, y_label: str, **options: Any) -> Any:
    """An empty picture as wide as the page, with zoom by a box, and by the wheel if wished."""
    from bokeh.models import InlineStyleSheet, PlainText
    from bokeh.plotting import figure

    plot = figure(
        height=height, sizing_mode="stretch_width", tools="pan,box_zoom,wheel_zoom,reset,save",
        active_drag="box_zoom", active_scroll=None, min_border_left=70, **options,
    )  # fmt: skip
    plot.yaxis.axis_label = PlainText(text=y_label)
    # Bokeh's first paint, squeezed before its width is known, stays in the first column of pixels.
    cover = "content: ''; position: absolute; inset: 0 auto 0 0; width: 3px; z-index: 10;"
    plot.stylesheets = [InlineStyleSheet(css=f":host::before {{ {cover} background: #fff; }}")]
    plot.toolbar.logo = None
    plot.toolbar.autohide = True
    plot.outline_line_color = None
    plot.grid.grid_line_color = "#ebebeb"
    for axis in plot.axis:
        axis.axis_label_text_font_style = "normal"
        axis.minor_tick_line_color = None
    return plot


def named(label: str, role: str) -> str:
    """A column's name, or its role where it has only a number."""
    return role if label.isdecimal() or not label else label


def record_glyph(plot: Any, t: Any, y: Any, named: dict[str, Any]) -> Any:
    """The record, grey: points for a short one, a thin line for a long one."""
    if len(t) <= POINTS_UP_TO:
        return plot.scatter(t, y, size=4.5, color=GREY, **named)
    return plot.line(t, y, line_width=1, color=GREY, **named)


def hover(plot: Any, renderers: list[Any], units: Units, value: str) -> None:
    """Time and value under the pointer."""
    from bokeh.models import HoverTool

    # The format of hover takes braces and `@`, which a unit might hold: units are told on the axes.
    tips = [("time", "@x{0.[0000]}"), (value, "@y{0.[0000]}")]
    plot.add_tools(HoverTool(renderers=renderers, tooltips=tips, mode="mouse"))


def live_responses(
    record: AbstractRecord,
    entries: Sequence[Entry],
    count: int = MOST_DRAWN,
    with_input: bool = True,
) -> Any:
    """Record and models, the change of the input, and residuals, on one axis of time."""
    from bokeh.layouts import column
    from bokeh.models import Span

    record = rows_that_count(record)
    labels, units = record.labels, Units.of(record.labels)
    response, below, residuals = response_panels(labels)
    t, y = np.asarray(record.t), np.asarray(record.y)
    shown, away = [record_glyph(response, t, y, {"legend_label": "record"})], []
    single = len(entries) == 1
    drawn = zip(entries[:count], LOOKS, DASHES, strict=False)
    for place, (entry, (color, _, mark), dash) in enumerate(drawn):
        curve = lines(entry.model, record)
        look: dict[str, Any] = {"color": color, "line_dash": dash}
        look["line_width"] = 2.4 if place == 0 else 1.6
        name = "model" if single else entry.method
        shown.append(response.line(curve.times, curve.output, legend_label=name, **look))
        if entry.marks:
            points = zip(*entry.marks, strict=True)
            response.scatter(
                *points, marker=MARKS[mark], size=9, fill_color=None, line_color=color,
                line_width=1.5, legend_label=name,
            )  # fmt: skip
        if entry.tangent:
            ends = zip(*entry.tangent, strict=True)
            response.line(*ends, color=color, line_width=0.9, legend_label=name)
        if single:
            away.append(record_glyph(residuals, t, curve.residuals, {}))
        else:
            look["line_width"] = 1
            away.append(residuals.line(t, curve.residuals, **look))
    below.line(*input_line(record), color=DARK, line_width=1.5)
    if isinstance(record, StepRecord):
        at = float(record.step_time)
        for plot in (response, below, residuals):
            step = Span(location=at, dimension="height", line_color=FRAME)
            step.line_dash, step.line_width = [4, 3], 1
            plot.add_layout(step)
            if single:
                shade_delay(plot, at, float(np.asarray(entries[0].model.delay)))
    residuals.add_layout(Span(location=0, dimension="width", line_color=FRAME, line_width=1))
    hover(response, shown, units, "output")
    hover(residuals, away, units, "residual")
    legend_above(response)
    panels = [response, below, residuals] if with_input else [response, residuals]
    return column(panels, sizing_mode="stretch_width")


def shade_delay(plot: Any, start: float, delay: float) -> None:
    """The dead time, behind everything."""
    from bokeh.models import BoxAnnotation

    if delay > 0:
        shade = BoxAnnotation(left=start, right=start + delay, fill_color=BAND, fill_alpha=1)
        shade.level, shade.line_color = "underlay", None
        plot.add_layout(shade)


MARKS = {"o": "circle", "s": "square", "^": "triangle", "D": "diamond", "v": "inverted_triangle"}
MARKS |= {"P": "plus", "X": "x"}
"""Names of matplotlib's marks."""


def response_panels(
    labels: Labels, fixed: tuple[float, float] | None = None
) -> tuple[Any, Any, Any]:
    """Empty pictures of the response, the input and the residuals, sharing the axis of time.

    `fixed`: ends of all axes, which then do not follow what is drawn.
    """
    from bokeh.models import PlainText

    options = {} if fixed is None else {"x_range": fixed, "y_range": fixed}
    response = panel(380, named(labels.output, "output"), **options)
    own = {} if fixed is None else {"y_range": fixed}
    shared = {"x_range": response.x_range} | own
    unit = unit_of(labels.input)
    below = panel(95, f"input ({unit})" if unit else "input", **shared)
    unit = unit_of(labels.output)
    residuals = panel(180, f"residual ({unit})" if unit else "residual", **shared)
    if fixed is None:
        below.y_range.range_padding = 0.25
    below.yaxis.ticker.desired_num_ticks = 2  # pyright: ignore[reportAttributeAccessIssue]
    residuals.xaxis.axis_label = PlainText(text=named(labels.time, "time"))
    for plot in (response, below):
        plot.xaxis.visible = False
    return response, below, residuals


def legend_above(plot: Any) -> None:
    """The legend over the picture; a click on a name hides what it names."""
    legend = plot.legend[0]
    plot.add_layout(legend, "above")
    legend.orientation, legend.ncols = "horizontal", 2  # both fit a phone
    legend.click_policy, legend.border_line_color = "hide", None
    legend.label_text_font_size, legend.padding, legend.margin = "11px", 2, 0


def live_bars(record: AbstractRecord, entries: Sequence[Entry]) -> Any:
    """J of every model on a logarithmic axis, the best above."""
    from bokeh.models import ColumnDataSource, HoverTool, PlainText

    J = np.array([entry.J for entry in entries])
    finite = J[np.isfinite(J)]
    top = float(finite.max(initial=0.0)) or 1.0
    low = max(top * 10.0**-DECADES, float(finite[finite > 0].min(initial=top))) / 3
    colors = [color for color, *_ in LOOKS[:MOST_DRAWN]]
    colors += [GREY] * (len(entries) - len(colors))
    names = [entry.method for entry in entries]
    plot = panel(
        60 + 19 * len(entries), "", y_range=names[::-1], x_axis_type="log",
        x_range=(low, top * 2),
    )  # fmt: skip
    data = {
        "y": names, "x": np.where(np.isfinite(J), np.maximum(J, low * 1.02), low * 1.02),
        "J": [number(x) for x in J], "color": colors[: len(names)],
    }  # fmt: skip
    bars = plot.hbar(
        y="y", right="x", left=low, height=0.62, color="color", source=ColumnDataSource(data)
    )
    plot.add_tools(HoverTool(renderers=[bars], tooltips=[("method", "@y"), ("J", "@J")]))
    unit = Units.of(record.labels).integral.replace("^2", "²")
    plot.xaxis.axis_label = PlainText(text=f"J ({unit})" if unit else "J")
    plot.ygrid.grid_line_color = None
    return plot


def live_autocorrelation(found: Autocorrelation) -> Any:
    """A bar for each lag, and the band that independent residuals keep to."""
    from bokeh.models import BoxAnnotation, HoverTool, PlainText

    plot = panel(220, "autocorrelation")
    band = BoxAnnotation(bottom=-found.bound, top=found.bound, fill_color=BAND, fill_alpha=1)
    band.level = "underlay"
    plot.add_layout(band)
    bars = plot.vbar(x=found.lags, top=found.values, width=0.45, color=DARK)
    plot.add_tools(HoverTool(renderers=[bars], tooltips=[("lag", "@x"), ("r", "@top{0.000}")]))
    plot.xaxis.axis_label = PlainText(text="lag, rows")
    return plot
