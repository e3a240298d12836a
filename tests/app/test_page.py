"""The app's document, driven without a browser; comparisons are made of models at hand."""

import base64
import io
import json
from concurrent.futures import Future
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.app.at_hand import compare

from stepax import StepRecord
from stepax.app._state import State, marks_of, offered, read
from stepax.methods import METHODS, ROWS
from stepax.methods._fits import AUTO


pytest.importorskip("bokeh")

EVIL = "<img src=x onerror=alert(1)>"


@pytest.fixture
def asked(monkeypatch):
    """What the app asks of `compare`, which needs no time here."""
    calls = []
    monkeypatch.setattr("stepax.app._state.compare", partial(compare, calls))
    return calls


class Tab:
    """A page whose worker works at once, or when it is told to."""

    def __init__(self, at_once=True):
        from bokeh.document import Document

        from stepax.app._page import Page

        self.waiting = []
        document = Document()
        document.add_next_tick_callback = lambda task: task()
        self.page = Page(document, self._now if at_once else self._later)
        self.widgets, self.charts = self.page.widgets, self.page.charts

    def _now(self, task):
        future = Future()
        try:
            future.set_result(task())
        except Exception as error:
            future.set_exception(error)
        return future

    def _later(self, task):
        future = Future()
        self.waiting.append((task, future))
        return future

    def upload(self, name, content):
        """As the widget does it: content and name in one message."""
        self.widgets.file._property_values |= {"filename": name}
        self.page.load(name, content)

    def drag(self, mark, x=None, y=None):
        """A handle let go elsewhere."""
        data = {key: list(values) for key, values in self.charts.handles.data.items()}
        place = data["mark"].index(mark)
        data["x"][place] = data["x"][place] if x is None else x
        data["y"][place] = data["y"][place] if y is None else y
        self.charts.handles.data = data

    @property
    def methods(self):
        return list(self.widgets.rows.data["method"])

    @property
    def message(self):
        return self.widgets.message.text if self.widgets.message.visible else ""


def click(button):
    from bokeh.events import ButtonClick

    button._trigger_event(ButtonClick(button))


@pytest.fixture
def tab(asked):
    tab = Tab()
    click(tab.widgets.example)
    return tab


def test_the_example(tab, asked):
    assert tab.message == "" and not tab.widgets.state.visible
    assert tab.widgets.results.visible and not tab.widgets.hello.visible
    # the fits first, those ahead which are compiled soonest, then all that can be read too
    assert set(asked[0][1]) == {"fopdt_fit", "sopdt_fit"} and set(asked[1][1]) == set(AUTO)
    assert "viteckova_1" in asked[2][1]
    assert set(tab.methods) == {
        "fopdt_fit", "sopdt_fit", "hudzovic_fit", "sani_fit", "viteckova_1", "hudzovic_t10_t50_t90"
    }  # fmt: skip
    assert len(tab.page.shown) == 3 and set(tab.page.shown) <= set(tab.methods)
    assert len(tab.charts.models.data["xs"]) == 3 and len(tab.charts.record.data["x"]) == 321
    assert "latzel: no" in tab.widgets.lost.text
    assert tab.widgets.details.text.count("<table>") == 3
    marks = tab.charts.handles.data
    assert marks["mark"] == ["step", "initial", "final", "t10", "t50", "t90"]
    assert marks["x"][0] == 20 and marks["label"][3:] == ["10 %", "50 %", "90 %"]


def test_a_level_is_dragged(tab, asked):
    before = tab.charts.high.location
    tab.drag("final", y=55.5)
    record = asked[-1][0]
    assert float(record.final) == 55.5 and tab.charts.high.location == 55.5 != before
    assert float(record.initial) == pytest.approx(tab.charts.low.location)
    tab.drag("step", x=21.5)
    assert float(asked[-1][0].step_time) == 21.5 and float(asked[-1][0].final) == 55.5
    click(tab.widgets.reset)
    assert asked[-1][0].final is None and float(asked[-1][0].step_time) == 20


def test_times_and_tangent_are_dragged(tab, asked):
    tab.drag("t50", x=90.0)
    assert asked[-1][2] == {"t50": 70.0}
    tab.widgets.by.value = "ziegler_nichols_tangent"
    assert asked[-1][2] == {} and tab.charts.handles.data["mark"][-2:] == ["Tu", "Tg"]
    assert "ziegler_nichols_tangent" in tab.methods
    end = tab.charts.tangent.data["x"][1]
    tab.drag("Tu", x=30.0)
    assert asked[-1][2] == pytest.approx({"Tu": 10.0, "Tg": end - 30.0})
    assert tab.charts.tangent.data["x"] == pytest.approx([30.0, end])


def test_methods_and_rows(tab, asked):
    tab.widgets.group.value = "first order"
    click(tab.widgets.compare)
    kept = {name for name in METHODS if ROWS[name].group == "first"}
    assert set(tab.methods) == kept | {"hudzovic_t10_t50_t90"}
    tab.widgets.rows.selected.indices = [1]
    assert tab.page.shown == (tab.methods[1],)
    assert tab.charts.models.data["method"] == [tab.methods[1]]
    tab.widgets.chart.active = 1
    assert tab.charts.pie.visible and not tab.charts.bars.visible
    assert tab.charts.shares.data["end"][-1] == pytest.approx(2 * np.pi)


@pytest.mark.parametrize("kind", ["report", "JSON", "code", "picture"])
def test_what_is_taken_away(tab, kind):
    tab.drag("final", y=55.5)
    click(tab.widgets.exports[kind])
    out = tab.widgets.outgoing.data
    content = base64.b64decode(out["content"][0])
    assert out["name"][0].startswith("heater") and tab.message.startswith("heater")
    if kind == "report":
        assert b"Set by hand: initial" in content and b"stepax app" in content
    elif kind == "JSON":
        assert len(json.loads(content)) == 3
    elif kind == "code":
        assert b"matlab: s = tf" in content
    else:
        assert content.startswith(b"\x89PNG")


def test_nothing_to_take_away(asked):
    tab = Tab()
    click(tab.widgets.exports["report"])
    assert "no model to export" in tab.message
    click(tab.widgets.compare)
    assert tab.message.startswith("Load a record first")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", b"", "a.csv is empty."),
        ("a.csv", b"a,b\n1\n", "needs columns"),
        ("a.xlsx", b"PK\x03\x04nothing", "damaged, or no Excel file"),
        ("a.mat", b"MATLAB nothing", "damaged, or not a MAT file"),
        ("a.png", b"nothing", "no PNG"),
        (f"{EVIL}.csv", b"", "&lt;img src=x"),
    ],
)
def test_a_wrong_file_loses_nothing(tab, name, content, words):
    rows = tab.methods
    tab.upload(name, content)
    assert words in tab.message and EVIL not in tab.message
    assert tab.methods == rows and tab.page.state.base is not None
    click(tab.widgets.example)
    assert tab.message == ""


def test_columns_and_steps(tab, asked):
    t = np.arange(0, 90)
    u = 5 * (t >= 10) + 5 * (t >= 50)
    y = 3 * u + 0.01 * np.sin(t)
    rows = "".join(f"{a},{b},{c:.3f},{-c:.3f}\n" for a, b, c in zip(t, u, y, strict=True))
    tab.upload("log.csv", f"time,u,T {EVIL},other\n{rows}".encode())
    assert "Name the columns" in tab.message or tab.message == ""
    for role, name in (("time", "time"), ("input", "u"), ("output", f"T {EVIL}")):
        assert tab.widgets.columns[role].visible
        tab.widgets.columns[role].value = name
    assert tab.message == "" and asked[-1][0].labels.output == f"T {EVIL}"
    assert tab.widgets.step.visible and len(tab.widgets.step.options) == 3
    tab.widgets.step.value = "2"
    assert float(asked[-1][0].step_time) == 50
    assert EVIL not in tab.widgets.details.text


def test_a_picture(tab, asked):
    picture = Path(__file__).parents[2] / "docs" / "heater.png"
    tab.upload("heater.png", picture.read_bytes())
    assert "give the values at the edges" in tab.message and tab.widgets.picture.visible
    click(tab.widgets.read_picture)
    assert "must be a number" in tab.message
    for field, value in zip(tab.widgets.axes.values(), ("-20", "420", "20", "56"), strict=True):
        field.value = value
    click(tab.widgets.read_picture)
    assert tab.message == "" and asked[-1][0].labels.source == "heater.png"
    assert 0 < float(asked[-1][0].step_time) < 40  # found where the curve leaves its level


def test_a_file_that_is_too_large(tab, monkeypatch):
    monkeypatch.setattr("stepax.app._state.MOST_BYTES", 1_000_000)
    tab.upload("a.csv", bytes(1_000_001))
    assert "has more than 1 MB" in tab.message


def test_a_long_log(tab):
    t = np.arange(100_000)
    text = io.StringIO()
    y = 1 - np.exp(-np.maximum(t - 1000, 0) / 9000)
    np.savetxt(text, np.c_[t, t >= 1000, y], delimiter=",", fmt="%.5f", header="t,u,y", comments="")
    tab.upload("log.csv", text.getvalue().encode())
    assert tab.message == ""


def test_two_tabs(asked):
    first, second = Tab(), Tab()
    click(first.widgets.example)
    assert second.page.state.base is None and second.methods == []
    first.drag("final", y=55.5)
    click(second.widgets.example)
    assert second.page.state.levels == {}


def test_only_what_was_asked_last_is_shown(asked):
    tab = Tab(at_once=False)
    click(tab.widgets.example)
    tab.upload("a.csv", b"t,u,y\n" + b"".join(b"%d,%d,%d\n" % (k, k > 3, k) for k in range(40)))
    assert tab.widgets.state.visible and tab.widgets.compare.disabled
    for task, future in list(tab.waiting):
        future.set_result(task())
    assert tab.page.state.name == "a.csv"


def test_a_closed_tab(asked):
    """What comes after it was closed goes nowhere."""
    tab = Tab(at_once=False)
    click(tab.widgets.example)

    def gone(task):
        raise RuntimeError("the session is gone")

    tab.page._document.add_next_tick_callback = gone
    (task, future), *_ = tab.waiting
    future.set_result(task())
    assert tab.page.state.base is None


def test_an_error_of_our_own_is_told(tab, monkeypatch):
    def broken(*args, **kwargs):
        raise ZeroDivisionError("oops")

    monkeypatch.setattr("stepax.app._state.compare", broken)
    click(tab.widgets.compare)
    assert "ZeroDivisionError: oops" in tab.message and tab.methods


def test_of_steps_that_are_too_short_one_is_taken():
    """`read_record` would use the whole log by itself; the marks are those of a step."""
    t = np.arange(100.0)
    u = np.repeat(np.array([0.0, 1.0, 3.0, 2.0, 4.0, 1.0, 5.0]), 15)[: t.size]
    y = np.convolve(np.diff(u, prepend=0), 1 - np.exp(-t / 8))[: t.size]
    rows = "\n".join(f"{a},{b},{c:.4f}" for a, b, c in zip(t, u, y, strict=True))
    state = offered(State(), "log.csv", f"t,u,y\n{rows}\n".encode())
    state = read(state, time="t", output="y", input="u")
    assert isinstance(state.record, StepRecord) and state.steps == 6
    assert marks_of(state)["step"][0] == 15.0
