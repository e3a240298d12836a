"""One person's page: widgets, what they do, and what they show; each tab has its own."""

import base64
import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from typing import Any

from .._identify_each import BAD_INPUT
from ..models._notation import number, transfer_function_text
from ._charts import Charts
from ._export import KINDS, exported
from ._state import (
    MARKED,
    State,
    compared,
    dragged,
    example,
    glances,
    methods_of,
    offered,
    read,
    untouched,
)
from ._widgets import Widgets


MOST_SHOWN = 3
"""Models that are shown of a new comparison."""


class Page:
    """The document of one tab: it holds the state, and asks a worker for what takes time.

    `submit` runs a function in the worker and returns a future.
    """

    def __init__(self, document: Any, submit: Callable[[Callable[[], Any]], Any]):
        self.state, self.shown = State(), ()
        self._document, self._submit = document, submit
        self._asked = 0
        self._filling = False
        self.charts, self.widgets = Charts(), Widgets()
        layout = self.widgets.layout(self.charts)
        self._fill_choices()
        self._wire()
        document.add_root(layout)
        document.title = "stepax"

    # What buttons do

    def _wire(self) -> None:
        w = self.widgets

        def when(model: Any, name: str, act: Callable[[Any], Any]) -> None:
            model.on_change(name, lambda attr, old, new: act(new))

        # A file's name comes with its content, in one message: in the next round both are there.
        when(w.file, "value", lambda _: self._later(self._upload))
        w.example.on_click(self.load_example)
        for name, choice in w.columns.items():
            when(choice, "value", partial(self._choose, name))
        when(w.step, "value", partial(self._choose, "step"))
        w.read_picture.on_click(self._read_picture)
        when(w.group, "value", self._choose_group)
        when(w.methods, "value", lambda names: self._choose_methods(tuple(names)))
        w.compare.on_click(self.compare)
        when(w.by, "value", self._choose_marks)
        w.reset.on_click(lambda: self._rework(untouched))
        when(w.chart, "active", self._show_chart)
        when(w.rows.selected, "indices", lambda _: self._show_rows())
        self.charts.handles.on_change("data", lambda attr, old, new: self._dragged(old, new))
        for kind in KINDS:
            w.exports[kind].on_click(partial(self.export, kind))

    def load_example(self) -> None:
        """The record that comes with the package."""
        self.load(*example())

    def load(self, name: str, content: bytes) -> None:
        """Take a file, and read and compare it if it can be read as it is."""
        try:
            self.state = offered(self.state, name, content)
        except BAD_INPUT as error:
            self._say(error)
            return
        self._fill_choices()
        self._begin()

    def _begin(self, **options: Any) -> None:
        """Read the file offered: first what some fits find, then all fits, then all chosen."""
        state, all_chosen = self.state, partial(compared, progress=self._progress)
        first, *others = glances(state) or [all_chosen]

        def done(found: State) -> None:
            self._show(found)
            if first is not all_chosen:
                self._look_closer(others)

        self._run(lambda: first(read(state, **options)), done)

    def _look_closer(self, looks: Sequence[Callable[[State], State]]) -> None:
        """One look after the other, each of which finds more; then all that was chosen."""
        if not looks:
            self._work(partial(compared, progress=self._progress))
            return
        state, first = self.state, self.shown

        def done(found: State) -> None:
            if self.shown == first:  # no person has chosen others by now
                self.shown = ()
            self._show(dataclasses.replace(found, methods=self.state.methods))
            self._look_closer(looks[1:])

        self._run(lambda: looks[0](state), done)

    def _upload(self) -> None:
        file = self.widgets.file
        if file.value:
            self.load(str(file.filename), base64.b64decode(str(file.value)))

    def _choose(self, option: str, value: str) -> None:
        """A column or a step from its list; the first entry of a list leaves the choice to us."""
        if self._filling:
            return
        chosen: Any = value or None
        if option == "step" and chosen is not None:
            chosen = int(chosen)
        options: dict[str, Any] = {option: chosen}
        if option != "step":
            options["step"] = None
        kept = {key: x for key, x in (self.state.reading | options).items() if x is not None}
        self.state = dataclasses.replace(self.state, reading=kept)
        self._begin()

    def _read_picture(self) -> None:
        try:
            options = self.widgets.options_of_picture()
        except ValueError as error:
            self._say(error)
            return
        self._begin(**options)

    def _choose_group(self, group: str) -> None:
        self.widgets.methods.value = list(methods_of(group))

    def _choose_methods(self, names: tuple[str, ...]) -> None:
        self.state = dataclasses.replace(self.state, methods=names)

    def compare(self) -> None:
        """The methods chosen on the record as it is marked."""
        self._work(partial(compared, progress=self._progress))

    def _choose_marks(self, method: str) -> None:
        if self._filling or method == self.state.by:
            return
        self.state = dataclasses.replace(self.state, by=method, marks={})
        self._work(compared)

    def _rework(self, step: Callable[[State], State]) -> None:
        """A step that takes no time, and the comparison after it."""
        self._work(lambda state: compared(step(state)))

    def _dragged(self, old: Any, new: Any) -> None:
        """Of the marks the one that was let go elsewhere."""
        if self._filling:
            return
        for mark, x, y, x0, y0 in zip(
            new["mark"], new["x"], new["y"], old["x"], old["y"], strict=False
        ):
            if (x, y) != (x0, y0):
                self._rework(lambda state, m=mark, x=x, y=y: dragged(state, m, float(x), float(y)))
                return

    def export(self, kind: str) -> None:
        """Hand a file to the browser."""
        chart = "pie" if self.widgets.chart.active else "bar"
        state, shown = self.state, self.shown

        def done(file: Any) -> None:
            content = base64.b64encode(file.content).decode()
            self.widgets.outgoing.data = {
                "name": [file.name], "kind": [file.kind], "content": [content]
            }  # fmt: skip
            self._say(f"{file.name} is in the folder of your downloads.")

        self._run(lambda: exported(state, kind, shown, chart), done)

    # Work that takes time

    def _work(self, step: Callable[[State], State]) -> None:
        """A new state in the worker; where it cannot be had the old one stands."""
        state = self.state
        self._run(lambda: step(state), self._show)

    def _run(self, task: Callable[[], Any], done: Callable[[Any], None]) -> None:
        """A task in the worker, then what to do with its result; only the last one asked counts."""
        self._asked += 1
        asked = self._asked
        self.widgets.busy("Computing ...")

        def ended(future: Any) -> None:
            self._later(lambda: self._ended(asked, future, done))

        self._submit(task).add_done_callback(ended)

    def _ended(self, asked: int, future: Any, done: Callable[[Any], None]) -> None:
        if asked != self._asked:
            return
        self.widgets.busy("")
        error = future.exception()
        if error is None:
            self._say("")
            done(future.result())
        elif isinstance(error, BAD_INPUT):
            self._say(error)
            self._refill()
        else:
            self._say(f"Something went wrong in stepax itself: {type(error).__name__}: {error}")
            self._refill()

    def _later(self, task: Callable[[], Any]) -> None:
        """In the document's own loop; a tab that was closed meanwhile needs nothing any more."""
        try:
            self._document.add_next_tick_callback(task)
        except RuntimeError:
            pass

    def _progress(self, done: int, total: int) -> None:
        self._later(lambda: self.widgets.busy(f"Comparing: {done} of {total} parts ..."))

    def _say(self, what: Exception | str) -> None:
        said = str(what.args[0]) if isinstance(what, Exception) and what.args else str(what)
        self.widgets.message.text = escape(said)
        self.widgets.message.visible = bool(said)

    # What is shown

    def _show(self, state: State) -> None:
        """A new state: the best models of a new comparison are shown, else those that were."""
        comparison = state.comparison
        names = [] if comparison is None else [row.method for row in comparison.models()]
        kept = tuple(name for name in names if name in self.shown)
        same = self.state.base is state.base and kept
        self.shown = kept if same else tuple(names[:MOST_SHOWN])
        self.state = state
        self._refill()

    def _refill(self) -> None:
        """Everything from the state."""
        self._filling = True
        try:
            self._fill_choices()
            self._fill_rows()
            self.charts.fill(self.state, self.shown)
            self._fill_details()
            loaded = self.state.base is not None
            self.widgets.results.visible, self.widgets.hello.visible = loaded, not loaded
        finally:
            self._filling = False

    def _fill_choices(self) -> None:
        filling, self._filling = self._filling, True
        w, state = self.widgets, self.state
        w.fill_choices(state)
        w.by.options, w.by.value = list(MARKED), state.by
        self._filling = filling

    def _fill_rows(self) -> None:
        comparison = self.state.comparison
        rows = () if comparison is None else comparison.models()
        source = self.widgets.rows
        # Bokeh's table draws anew only when the number of its rows changes: first there are none.
        source.selected.indices = []  # pyright: ignore
        source.data = {name: [] for name in source.column_names}
        source.data = {
            "method": [row.method for row in rows],
            "model": [row.model for row in rows],
            "fit": [number(row.fit_percent) for row in rows],
            "J": [number(row.J) for row in rows],
            "rmse": [number(row.rmse) for row in rows],
            "parameters": [str(row.parameters) for row in rows],
            "G": [transfer_function_text(row.result.model) for row in rows],
        }
        chosen = [place for place, row in enumerate(rows) if row.method in self.shown]
        source.selected.indices = chosen  # pyright: ignore
        self.widgets.table.height = min(520, 34 + 26 * max(1, len(rows)))
        lost = [] if comparison is None else [row for row in comparison.rows if not row.has_model]
        self.widgets.lost.text = "".join(
            f"<div>{escape(row.method)}: {escape(row.reason)}</div>" for row in lost
        )

    def _show_rows(self) -> None:
        """The models whose rows are chosen."""
        if self._filling or self.state.comparison is None:
            return
        rows = self.state.comparison.models()
        chosen = self.widgets.rows.selected.indices  # pyright: ignore
        self.shown = tuple(rows[place].method for place in sorted(chosen) if place < len(rows))
        self._refill()

    def _show_chart(self, which: int) -> None:
        self.charts.bars.visible, self.charts.pie.visible = which == 0, which == 1

    def _fill_details(self) -> None:
        """Parameters with intervals, and notes, of each model that is shown."""
        comparison = self.state.comparison
        rows = () if comparison is None else comparison.models()
        self.widgets.details.text = "".join(
            '<div style="display: inline-block; vertical-align: top; margin: 0 32px 16px 0">'
            f"{row.result._repr_html_() or ''}</div>"
            for row in rows
            if row.method in self.shown
        )
