"""What a person has loaded, marked, chosen and found: one small state, and what each button does.

No numerics of its own: every step calls what the package offers to anybody. A step gives a new
state or raises with a sentence; then the old state stands, and nothing is lost.
"""

import dataclasses
import io
from collections.abc import Callable
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from .._compare import Comparison, Row, compare, level_marks, tangent_ends
from ..methods import FITS, METHODS, ROWS, SCANS
from ..methods._fits import AUTO
from ..methods._reading import time_name
from ..records._read import read_record
from ..records._record import StepRecord
from ..records._table import file_table
from ..records.image._picture import SUFFIXES
from ..records.image._trace import trace_image


MOST_BYTES = 200_000_000
"""Size of the largest file that is taken."""

GROUPS = ("quick look", "all", "first order", "second order", "n-th order", "fits")
"""Groups of methods that a person can choose; after the first, those of a comparison and fits."""

QUICK_LOOK = (*AUTO, "viteckova_1", "latzel")
"""Fits that `identify` chooses from, and two classical methods."""

SOONEST = ("fopdt_fit", "sopdt_fit")
"""Fits that a new process has compiled soonest: they are shown first."""

READ_TOGETHER = tuple(name for name in METHODS if name not in FITS | SCANS)
"""Methods that are always run, whatever is shown: one program serves every choice of them."""

MARKED = tuple(name for name, row in ROWS.items() if row.levels or row.has_tangent)
"""Methods whose marks can be dragged."""


@dataclasses.dataclass(frozen=True)
class State:
    """One person's work.

    - `name`, `content`: the file last offered; `columns`: its columns, empty for a picture.
    - `reading`: options of reading that were chosen. `base`: the record as it was read.
    - `levels`: what was dragged of the record: `step_time`, `initial`, `final`.
    - `marks`: times that were dragged, by name; `by`: the method whose marks are shown.
    - `methods`: those to compare. `comparison`: what came out.
    """

    name: str = ""
    content: bytes = b""
    columns: tuple[str, ...] = ()
    reading: dict[str, Any] = dataclasses.field(default_factory=dict)
    base: StepRecord | None = None
    levels: dict[str, float] = dataclasses.field(default_factory=dict)
    marks: dict[str, float] = dataclasses.field(default_factory=dict)
    by: str = "hudzovic_t10_t50_t90"
    methods: tuple[str, ...] = QUICK_LOOK
    comparison: Comparison | None = None

    @property
    def is_picture(self) -> bool:
        """Whether the file is a picture of a plot."""
        return Path(self.name).suffix.lower() in SUFFIXES

    @property
    def steps(self) -> int:
        """How many steps the input of the record has."""
        return 0 if self.base is None else int(self.base.details.get("steps_found", 0))

    @property
    def record(self) -> StepRecord | None:
        """The record with the levels and the step where they were dragged to."""
        return None if self.base is None else dataclasses.replace(self.base, **self.levels)

    @property
    def marked(self) -> Row | None:
        """The row of the method whose marks are shown."""
        rows = () if self.comparison is None else self.comparison.rows
        return next((row for row in rows if row.method == self.by), None)


def methods_of(group: str) -> tuple[str, ...]:
    """Methods of one of `GROUPS`."""
    names = {"first order": "first", "second order": "second", "n-th order": "nth"}
    if group == "quick look":
        return QUICK_LOOK
    if group == "fits":
        return tuple(name for name in METHODS if name in FITS)
    return tuple(name for name in METHODS if group == "all" or ROWS[name].group == names[group])


# Reading


def example() -> tuple[str, bytes]:
    """Name and content of the record that comes with the package."""
    return "heater.csv", (files("stepax") / "examples" / "heater.csv").read_bytes()


def offered(state: State, name: str, content: bytes) -> State:
    """A file that was chosen, not yet read: its columns, to choose from."""
    if len(content) > MOST_BYTES:
        raise ValueError(f"{name} has more than {MOST_BYTES // 10**6} MB: cut it, or average rows.")
    state = dataclasses.replace(state, name=name, content=content, columns=(), reading={})
    if state.is_picture:
        return state
    return dataclasses.replace(state, columns=tuple(file_table(_file(state)).names))


def read(state: State, **options: Any) -> State:
    """The record of the file offered, by options that a person chose beside those before."""
    reading = state.reading | options
    # its marks are those of a step: never the whole log with its input
    one_step = partial(read_record, whole=False)
    reader: Callable[..., StepRecord] = trace_image if state.is_picture else one_step
    base = reader(_file(state), **reading)
    return dataclasses.replace(
        state, reading=reading, base=base, levels={}, marks={}, comparison=None
    )


class _Named(io.BytesIO):
    """A file in memory that has a name."""

    name: str


def _file(state: State) -> _Named:
    file = _Named(state.content)
    file.name = state.name
    return file


# Marks


def marks_of(state: State) -> dict[str, tuple[float, float]]:
    """Marks of the record and of the method shown: time and output, by name.

    `step`, `initial`, `final`; the levels that the method reads, as t33; the ends of its tangent,
    Tu and Tg. What the method did not find has none.
    """
    record, row = state.record, state.marked
    if record is None:
        return {}
    first, last = float(record.t[0]), float(record.t[-1])
    low, high = levels_of(state)
    # Apart from each other where a record begins with its step.
    start, end = first + 0.03 * (last - first), last - 0.03 * (last - first)
    middle = low + 0.5 * (high - low)
    marks = {
        "step": (float(record.step_time), middle),
        "initial": (start, low),
        "final": (end, high),
    }
    if row is None:
        return marks
    levels = [time_name(level) for level in row.about.levels]
    if row.has_model:
        marks |= dict(zip(levels, level_marks(row), strict=False))
        return marks | dict(zip(("Tu", "Tg"), tangent_ends(row), strict=False))
    # Of a method that refuses, those that were dragged: to be dragged on.
    heights = dict(zip(levels, row.about.levels, strict=True))
    since, change = float(record.step_time), high - low
    marks |= {
        name: (since + time, low + heights[name] * change)
        for name, time in state.marks.items()
        if name in heights
    }
    if row.about.has_tangent and "Tu" in state.marks:
        Tu, Tg = state.marks["Tu"], state.marks["Tg"]
        marks |= {"Tu": (since + Tu, low), "Tg": (since + Tu + Tg, high)}
    return marks


def levels_of(state: State) -> tuple[float, float]:
    """Initial and final level as they are drawn: known ones, else those that a method found."""
    record = state.record
    assert record is not None
    y = np.asarray(record.y)
    low, high = float(y[0]), float(y[-1])
    rows = [] if state.comparison is None else list(state.comparison.models())
    for row in [*rows[:1], *(row for row in [state.marked] if row is not None and row.has_model)]:
        model = row.result.model
        low = float(model.offset)
        if model.settles:
            high = low + float(model.gain) * float(record.step_size)
    known = record.initial, record.final
    low, high = (
        x if level is None else float(level) for level, x in zip(known, (low, high), strict=True)
    )
    return low, high


def dragged(state: State, mark: str, time: float, output: float) -> State:
    """A mark let go at another place: levels go up and down, times sideways."""
    record = state.record
    assert record is not None
    since = time - float(record.step_time)
    if mark == "step":
        return dataclasses.replace(state, levels=state.levels | {"step_time": time})
    if mark in ("initial", "final"):
        # The other one holds where it is drawn: what is compiled for known levels has both.
        both = dict(zip(("initial", "final"), levels_of(state), strict=True))
        return dataclasses.replace(state, levels=state.levels | both | {mark: output})
    marks = dict(state.marks)
    if mark in ("Tu", "Tg"):  # both ends of the tangent are its, the other one stays where it is
        (Tu, _), (end, _) = (marks_of(state)[name] for name in ("Tu", "Tg"))
        start = since if mark == "Tu" else Tu - float(record.step_time)
        end = since if mark == "Tg" else end - float(record.step_time)
        marks |= {"Tu": start, "Tg": end - start}
    else:
        marks[mark] = since
    return dataclasses.replace(state, marks=marks)


def untouched(state: State) -> State:
    """All marks where they were found."""
    return dataclasses.replace(state, levels={}, marks={})


# Comparing


def glimpsed(state: State) -> State:
    """Of the fits chosen those that a new process answers soonest."""
    return _with_methods(state, set(state.methods) & set(SOONEST))


def glanced(state: State) -> State:
    """The fits chosen: compiled sooner than all."""
    return _with_methods(state, set(state.methods) & FITS)


def glances(state: State) -> list[Callable[[State], State]]:
    """What to look at before all that was chosen, each finding more than the one before."""
    soon, fits = set(state.methods) & set(SOONEST), set(state.methods) & FITS
    first = [glimpsed] if soon and soon != fits else []
    return [*first, glanced] if fits else []


def _with_methods(state: State, names: set[str]) -> State:
    """The comparison of some methods."""
    record = state.record
    assert record is not None
    chosen = [name for name in METHODS if name in names]
    return dataclasses.replace(state, comparison=compare(record, chosen))


def compared(state: State, progress: Callable[[int, int], object] | None = None) -> State:
    """The methods chosen, and the one whose marks are shown, on the record as it is marked."""
    record = state.record
    if record is None:
        raise ValueError("Load a record first: a file, or the example.")
    wanted = {*state.methods, state.by}
    others = [name for name in METHODS if name in wanted and name not in READ_TOGETHER]
    names = [*others, *READ_TOGETHER]
    found = compare(record, names, marks=state.marks, progress=progress)
    rows = tuple(row for row in found.rows if row.method in wanted)
    return dataclasses.replace(state, comparison=Comparison(found.record, rows))
