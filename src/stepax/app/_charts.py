"""The pictures of the app: filled anew for every state, built once."""

from typing import Any

import numpy as np

from .._compare import Row
from ..models._notation import number
from ..plots._comparison import LOOKS
from ..plots._live import DARK, DASHES, FRAME, GREY, legend_above, named, panel, response_panels
from ..plots._model import input_line, lines
from ..records._labels import Labels, Units, unit_of
from ..records._record import rows_that_count
from ._state import State, marks_of


HANDLES = {
    "step": "step", "initial": "base line", "final": "final level", "Tu": "tangent",
    "Tg": "tangent",
}  # fmt: skip
"""Marks by their names; those of levels are their percentage."""

BELOW = ("final", "Tg")
"""Marks whose names stand below them: above there is the end of the picture."""

ORANGE = "#c8500a"


_SPANS: Any = (("height", FRAME), ("width", ORANGE), ("width", ORANGE))
"""Lines of the step and of the two levels: direction and colour."""


def look_of(place: int) -> tuple[str, Any]:
    """Colour and dashes of the model at a place in the ranking."""
    return (LOOKS[place][0], DASHES[place]) if place < len(LOOKS) else (GREY, "dotted")


class Charts:
    """Response with marks, input, residuals, and J as bars and as a pie."""

    def __init__(self):
        from bokeh.models import ColumnDataSource, PointDrawTool, Span

        self.response, self.input, self.residuals = response_panels(Labels(), fixed=(0.0, 1.0))
        self._drawn: Any = None
        empty: Any = {"x": [], "y": []}
        self.record = ColumnDataSource(empty)
        self.change = ColumnDataSource(empty)
        curves: Any = {"xs": [], "ys": [], "color": [], "dash": [], "width": [], "method": []}
        self.models, self.away = ColumnDataSource(curves), ColumnDataSource(curves)
        self.tangent = ColumnDataSource(empty)
        marks = ("x", "y", "mark", "label", "away", "aside", "align")
        nothing: Any = {name: [] for name in marks}
        self.handles = ColumnDataSource(nothing)
        self.points = self.response.scatter(
            "x", "y", source=self.record, size=4, color=GREY, legend_label="record"
        )
        self.response.line("x", "y", source=self.record, line_width=0.6, color=GREY)
        self.input.line("x", "y", source=self.change, color=DARK, line_width=1.5)
        look = {"line_color": "color", "line_dash": "dash", "line_width": "width"}
        self.response.multi_line("xs", "ys", source=self.models, legend_field="method", **look)
        self.residuals.multi_line("xs", "ys", source=self.away, **look)
        self.response.line("x", "y", source=self.tangent, color=ORANGE, line_width=1.2)
        handles = self.response.scatter(
            "x", "y", source=self.handles, size=13, marker="circle", fill_color="white",
            line_color=ORANGE, line_width=2.2, hit_dilation=1.6,
        )  # fmt: skip
        self.response.text(
            "x", "y", text="label", source=self.handles, x_offset="aside", y_offset="away",
            text_align="align",
            text_font_size="11px", text_color=ORANGE,
        )  # fmt: skip
        self.tool = PointDrawTool(renderers=[handles], add=False, description="Drag a mark")
        self.response.add_tools(self.tool)
        self.response.toolbar.active_drag = self.tool
        self.step, self.low, self.high = (
            Span(dimension=side, line_color=color, line_dash=[4, 3], visible=False)
            for side, color in _SPANS
        )
        for span in (self.step, self.low, self.high):
            self.response.add_layout(span)
        legend_above(self.response)
        self._build_ranking()

    def _build_ranking(self) -> None:
        from bokeh.models import ColumnDataSource, FactorRange, HoverTool

        nothing: Any = {"y": [], "x": [], "left": [], "J": [], "color": []}
        self.ranking = ColumnDataSource(nothing)
        self.methods = FactorRange()
        self.bars = panel(300, "", y_range=self.methods, x_axis_type="log", x_range=(0.1, 1.0))
        bars = self.bars.hbar(
            y="y", right="x", left="left", height=0.62, color="color", source=self.ranking
        )
        self.bars.add_tools(HoverTool(renderers=[bars], tooltips=[("method", "@y"), ("J", "@J")]))
        nothing = {"start": [], "end": [], "color": [], "method": [], "share": []}
        self.shares = ColumnDataSource(nothing)
        self.pie = panel(300, "", x_range=(-1.1, 1.1), y_range=(-1.1, 1.1), match_aspect=True)
        wedges = self.pie.wedge(
            0, 0, radius=1, start_angle="start", end_angle="end", color="color",
            line_color="white", source=self.shares,
        )  # fmt: skip
        tips = [("method", "@method"), ("share of J", "@share")]
        self.pie.add_tools(HoverTool(renderers=[wedges], tooltips=tips))
        self.pie.axis.visible, self.pie.grid.visible, self.pie.visible = False, False, False

    def fill(self, state: State, shown: tuple[str, ...]) -> None:
        """Everything of a state; of the models those in `shown`, in the order of the ranking."""
        from bokeh.models import PlainText

        if state.record is None:
            return
        comparison = state.comparison
        record = rows_that_count(state.record if comparison is None else comparison.record)
        t, y = np.asarray(record.t, float), np.asarray(record.y, float)
        self.record.data = {"x": t, "y": y}
        self.points.glyph.size = 4 if t.size < 1500 else 2
        x, u = input_line(record)
        self.change.data = {"x": x, "y": u}
        labels = record.labels
        self.response.yaxis.axis_label = PlainText(text=named(labels.output, "output"))
        self.residuals.xaxis.axis_label = PlainText(text=named(labels.time, "time"))
        for plot, label in ((self.input, labels.input), (self.residuals, labels.output)):
            word = "input" if plot is self.input else "residual"
            unit = unit_of(label)
            plot.yaxis.axis_label = PlainText(text=f"{word} ({unit})" if unit else word)
        rows = () if comparison is None else comparison.models()
        self._fill_models(rows, shown, record, t)
        self._fill_marks(state)
        self._fill_ranges(state)
        self._fill_ranking(rows, Units.of(labels).integral)

    def _fill_models(self, rows: Any, shown: tuple[str, ...], record: Any, t: Any) -> None:
        curves = [
            (row.method, lines(row.result.model, record), look_of(place), 2.4 if not place else 1.6)
            for place, row in enumerate(rows)
            if row.method in shown
        ]
        look = {
            "color": [color for *_, (color, _), _ in curves],
            "dash": [dash for *_, (_, dash), _ in curves],
            "method": [method for method, *_ in curves],
        }
        width = [wide for *_, wide in curves]
        self.models.data = look | {
            "xs": [curve.times for _, curve, *_ in curves],
            "ys": [curve.output for _, curve, *_ in curves],
            "width": width,
        }
        self.away.data = look | {
            "xs": [t for _ in curves],
            "ys": [curve.residuals for _, curve, *_ in curves],
            "width": [1.0 for _ in curves],
        }

    def _fill_marks(self, state: State) -> None:
        marks = marks_of(state)
        self.handles.data = {
            "x": [time for time, _ in marks.values()],
            "y": [output for _, output in marks.values()],
            "mark": list(marks),
            "label": [HANDLES.get(mark, f"{mark[1:].replace('_', '.')} %") for mark in marks],
            "away": [22 if mark in BELOW else -9 for mark in marks],
            "aside": [-4 if mark == "final" else 9 for mark in marks],
            "align": ["right" if mark == "final" else "left" for mark in marks],
        }
        ends = [marks[name] for name in ("Tu", "Tg") if name in marks]
        self.tangent.data = {"x": [time for time, _ in ends], "y": [level for _, level in ends]}
        self.step.location, self.step.visible = marks["step"][0], True
        for span, name in ((self.low, "initial"), (self.high, "final")):
            span.location, span.visible = marks[name][1], True

    def _fill_ranges(self, state: State) -> None:
        """Of a new record, or for a mark outside; else what a person zoomed to stays."""
        x, y = (np.asarray(self.record.data[name], float) for name in ("x", "y"))
        marks = np.array(list(marks_of(state).values()))
        times, outputs = np.append(x[[0, -1]], marks[:, 0]), np.append(y, marks[:, 1])
        away = np.concatenate([[0.0], *self.away.data["ys"]])
        _span(self.residuals.y_range, away, 0.08)
        ranges = self.response.x_range, self.response.y_range
        inside = all(r.start <= values.min() and values.max() <= r.end
                     for r, values in zip(ranges, (times, outputs), strict=True))  # fmt: skip
        if self._drawn is not state.base or not inside:
            _span(ranges[0], times, 0.03)
            _span(ranges[1], outputs, 0.08)
            _span(self.input.y_range, np.asarray(self.change.data["y"]), 0.25)
            self._drawn = state.base

    def _fill_ranking(self, rows: tuple[Row, ...], unit: str) -> None:
        from bokeh.models import PlainText

        names, J = [row.method for row in rows], np.array([row.J for row in rows])
        finite = J[np.isfinite(J) & (J > 0)]
        low = max(float(finite.min()) / 3, float(finite.max()) * 1e-12) if finite.size else 0.1
        high = 2 * float(finite.max()) if finite.size else 1.0
        colors = [look_of(place)[0] for place in range(len(rows))]
        self.methods.factors = names[::-1]
        self.bars.x_range.start, self.bars.x_range.end = low, high
        self.bars.height = self.pie.height = max(160, 70 + 18 * len(rows))
        values = np.where(np.isfinite(J), np.maximum(J, low * 1.02), high)
        said = [number(x) for x in J]
        self.ranking.data = {
            "y": names, "x": values, "left": np.full(len(rows), low), "J": said, "color": colors
        }  # fmt: skip
        text = "J" + (f" ({unit})" if unit else "") + ", integral of the squared error"
        self.bars.xaxis.axis_label = PlainText(text=text.replace("^2", "²"))
        parts = np.where(np.isfinite(J), J, 0.0)
        shares = (
            parts / parts.sum() if parts.sum() > 0 else np.full(len(rows), 1 / (len(rows) or 1))
        )
        ends = np.cumsum(shares) * 2 * np.pi
        self.shares.data = {
            "start": ends - shares * 2 * np.pi, "end": ends, "color": colors, "method": names,
            "share": [f"{100 * x:.3g} %" for x in shares],
        }  # fmt: skip


def _span(range_: Any, values: np.ndarray, margin: float) -> None:
    """A range that holds all values, and a margin on both sides."""
    low, high = float(values.min()), float(values.max())
    margin *= (high - low) or abs(high) or 1.0
    range_.update(
        start=low - margin, end=high + margin, reset_start=low - margin, reset_end=high + margin
    )
