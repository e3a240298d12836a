"""The widgets of a page and where they stand: left what to do, right what came out."""

from typing import Any

from ..methods import METHODS
from ._export import KINDS
from ._state import GROUPS, QUICK_LOOK, State


AXES = {"x_range": "x at left and right edge", "y_range": "y at lower and upper edge"}
"""What has to be told of a picture: the values at the edges of its axes."""

DOWNLOAD = """
const [name, kind, text] = [source.data.name[0], source.data.kind[0], source.data.content[0]];
if (name) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([bytes], {type: kind}));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}
"""

HELLO = """
<p><b>From a recorded step response to a transfer function.</b></p>
<p>Load a file with columns for time and output, best with the input too (CSV, Excel, MAT), or a
picture of a plot. The step is found, models are fitted and ranked. Then drag what was found
wrongly: the time of the step, the levels, the times that a method reads, its tangent. Tick the
models that you want to see, and take away a report, numbers, code or a picture.</p>
<p>Nothing leaves this machine.</p>
"""

WIDE: Any = {"sizing_mode": "stretch_width"}


class Widgets:
    """All widgets of one page."""

    def __init__(self):
        from bokeh.models import (
            Button,
            ColumnDataSource,
            CustomJS,
            Div,
            FileInput,
            MultiChoice,
            RadioButtonGroup,
            Select,
            TextInput,
        )

        accept = ".csv,.txt,.tsv,.dat,.xlsx,.mat,.png,.jpg,.jpeg,.webp,.gif"
        self.file = FileInput(accept=accept, title="A file: choose it, or drop it here", **WIDE)
        self.example = Button(label="Use the example", **WIDE)
        roles = ("time", "output", "input")
        self.columns = {
            role: Select(title=role, options=[], visible=False, **WIDE) for role in roles
        }
        self.step = Select(title="step of the input", options=[], visible=False, **WIDE)
        self.axes = {
            f"{name}{end}": TextInput(title=f"{title.split(' at ')[0]}, {end}", width=120)
            for name, title in AXES.items()
            for end in (("left", "right") if name == "x_range" else ("lower", "upper"))
        }
        self.at = TextInput(title="step at x, empty: find it", width=120)
        self.size = TextInput(title="size of the step", value="1", width=120)
        self.read_picture = Button(label="Read the picture", button_type="primary", **WIDE)
        self.group = Select(title="methods", options=list(GROUPS), value=GROUPS[0], **WIDE)
        self.methods = MultiChoice(
            title="one by one", options=list(METHODS), value=list(QUICK_LOOK), **WIDE
        )
        self.compare = Button(label="Compare", button_type="primary", **WIDE)
        self.by = Select(title="marks of", options=[], **WIDE)
        self.reset = Button(label="Marks as they were found", **WIDE)
        self.exports = {kind: Button(label=kind, **WIDE) for kind in KINDS}
        self.chart = RadioButtonGroup(labels=["J as bars", "as a pie"], active=0, width=200)
        self.message = Div(
            text="", visible=False, disable_math=True, css_classes=["message"], **WIDE
        )
        self.message.styles = {
            "background": "#fff4e0", "border-left": "4px solid #e0a341", "padding": "8px 12px",
            "font-size": "14px", "overflow-wrap": "anywhere",
        }  # fmt: skip
        self.hello = Div(text=HELLO, **WIDE)
        self.hello.styles = {"font-size": "15px", "color": "#16202b", "max-width": "44em"}
        self.state = Div(text="", visible=False, disable_math=True)
        self.state.styles = {"font-size": "14px", "color": "#0b2a4a", "padding": "4px 0"}
        self.details = Div(text="", disable_math=True, **WIDE)
        self.details.styles = {"font-size": "14px", "overflow-x": "auto"}
        self.lost = Div(text="", disable_math=True, **WIDE)
        self.lost.styles = {"font-size": "13px", "color": "#5b6672"}
        names = ("method", "model", "fit", "J", "rmse", "parameters", "G")
        self.rows = ColumnDataSource({name: [] for name in names})
        self.table = self._table()
        self.outgoing = ColumnDataSource({"name": [""], "kind": [""], "content": [""]})
        self.outgoing.js_on_change("data", CustomJS(args={"source": self.outgoing}, code=DOWNLOAD))
        # It is no part of the layout: this makes it one of the document, so that the page gets it.
        self.message.js_on_change("tags", CustomJS(args={"source": self.outgoing}, code=""))

    def _table(self) -> Any:
        from bokeh.models import DataTable, TableColumn

        titles = {
            "method": ("method", 190), "model": ("model", 80), "fit": ("fit, %", 65),
            "J": ("J", 75), "rmse": ("RMSE", 75), "parameters": ("par.", 40), "G": ("G(s)", 420),
        }  # fmt: skip
        columns = [
            TableColumn(field=field, title=title, width=width, sortable=False)
            for field, (title, width) in titles.items()
        ]
        return DataTable(
            source=self.rows, columns=columns, selectable="checkbox", index_position=None,
            height=180, autosize_mode="none", row_height=26, reorderable=False,
            sizing_mode="stretch_width",
        )  # fmt: skip

    def layout(self, charts: Any) -> Any:
        """All of them: a column to act in, and the results, beside it or on a phone below."""
        from bokeh.layouts import column, row
        from bokeh.models import Div

        def title(text: str) -> Any:
            styles: Any = {"font-size": "15px", "font-weight": "600", "color": "#0b2a4a"}
            return Div(text=text, styles=styles, margin=(12, 5, 2, 5))

        x_left, x_right, y_lower, y_upper = self.axes.values()
        self.picture = column(
            row(x_left, x_right),
            row(y_lower, y_upper),
            row(self.at, self.size),
            self.read_picture,
            visible=False,
            **WIDE,
        )
        left = column(
            title("1  Record"), self.file, self.example, *self.columns.values(), self.step,
            self.picture,
            title("2  Marks: drag them"), self.by, self.reset,
            title("3  Methods"), self.group, self.methods, self.compare,
            title("4  Take away"), *self.exports.values(),
            styles={"flex": "1 1 260px", "max-width": "100%"}, width=270, name="actions",
        )  # fmt: skip
        # A column of its own: Bokeh aligns the axes of pictures that stand in one.
        pictures = column(charts.response, charts.input, charts.residuals, **WIDE)
        self.results = column(
            pictures, self.table, self.lost,
            self.chart, column(charts.bars, charts.pie, **WIDE), self.details, visible=False, **WIDE
        )  # fmt: skip
        right = column(
            self.message, self.state, self.hello, self.results,
            styles={"flex": "100 1 340px", "min-width": "0"}, sizing_mode="stretch_width",
            name="results",
        )  # fmt: skip
        both = row(left, right, sizing_mode="stretch_width")
        both.styles = {"flex-wrap": "wrap", "gap": "0 18px", "align-items": "flex-start"}
        return both

    def busy(self, what: str) -> None:
        """Say what is going on; nothing goes on where it is empty."""
        self.state.text, self.state.visible = what, bool(what)
        self.compare.disabled = bool(what)

    def fill_choices(self, state: State) -> None:
        """Columns and steps of the file offered, or the axes of a picture."""
        first = [("", "as found")]
        for role, choice in self.columns.items():
            choice.options = [*first, *((name, name) for name in state.columns)]
            choice.value = state.reading.get(role, "") or ""
            choice.visible = len(state.columns) > 1
        self.picture.visible = state.is_picture
        count = state.steps
        self.step.options = [*first, *((str(k), f"step {k}") for k in range(1, count + 1))]
        self.step.value = str(state.reading.get("step", "") or "")
        self.step.visible = count > 1

    def options_of_picture(self) -> dict[str, Any]:
        """What a person typed of a picture: the edges of its axes, and the step."""
        fields = [*self.axes.values(), self.size]
        x0, x1, y0, y1, size = (_number(field.title, field.value) for field in fields)
        at = _number(self.at.title, self.at.value) if self.at.value.strip() else None
        axes = {"x_range": (x0, x1), "y_range": (y0, y1)}
        return {**axes, "step_time": at, "step_size": size}


def _number(title: Any, text: str) -> float:
    """A number with a decimal point or comma."""
    try:
        return float(text.strip().replace(",", "."))
    except ValueError:
        raise ValueError(
            f"{title!r} must be a number, got {text!r}: type the values at the four edges of the"
            " axes, and the size of the step."
        ) from None
