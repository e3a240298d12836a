"""Reading a recorded step test from a table, a MAT file, a DataFrame or a Series; host code.

A source becomes a table of named columns, which are time, output and input; the step is found in
the input, and the rows that belong to it are the record. What is wrong is said in one sentence.
"""

from io import BufferedIOBase
from os import PathLike
from typing import TYPE_CHECKING, Any, SupportsFloat, SupportsIndex

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from ._cells import moment, time_label
from ._columns import Roles, roles_of
from ._input import InputRecord
from ._labels import Labels
from ._record import MIN_SAMPLES, StepRecord
from ._rest import comes_to_rest, rest_before
from ._rows import Rows, rows_between, rows_of
from ._steps import choice, constant_level, find_steps, is_constant
from ._table import Table, file_table, frame_table, opened


if TYPE_CHECKING:
    import pandas as pd


def read_record(
    path: "str | PathLike | BufferedIOBase | pd.DataFrame | pd.Series",
    time: str | SupportsIndex | None = None,
    output: str | SupportsIndex | None = None,
    input: str | SupportsIndex | None = None,
    step: SupportsIndex | None = None,
    *,
    step_time: SupportsFloat | str | None = None,
    step_size: SupportsFloat | None = None,
    initial: SupportsFloat | None = None,
    final: SupportsFloat | None = None,
    begin: SupportsFloat | str | None = None,
    end: SupportsFloat | str | None = None,
    dayfirst: bool = False,
    whole: bool | None = None,
    hold: str = "zero",
    at_rest: bool = True,
    drift: bool = False,
) -> Any:
    """A record from a text table, an Excel or MAT file, a DataFrame or a Series: one step response.

    Or the whole log with its input.

    **Arguments:**

    - `path`: the file, or a binary one that is open, such as one in memory; or the DataFrame or
        Series (its index is the time) itself. Encoding, separator, decimal sign, thousands,
        comments, header and a row of units are recognised.
    - `time`, `output`, `input`: columns, by name, with or without its unit, or by number from 1
        (an int, or text, which is a name first). With nothing named, columns t (or time), u and y
        go by these names; else two columns are time and output, three are time, input and output.
        With the output named, one remaining column is the input if it has a step. Dates and clock
        times become seconds since the first row.
    - `step`: which step of the input, counted from 1, or from the last if negative.
    - `step_time`, `step_size`: the step where no column tells it; by default at t = 0, size 1.
    - `initial`, `final`: known levels of the output, as in `StepRecord`.
    - `begin`, `end`: leave out rows before and after these times. They and `step_time` are numbers,
        or, of a file with time stamps, stamps.
    - `dayfirst`: 1.2.2024 is in February; else only where nothing else gives rising times.
    - `whole`: True: an `InputRecord` of all rows with the input as it is. None: that too where the
        input has several steps, and no one is followed by enough rows for the output to come to
        rest; else, and for False, a `StepRecord`. `hold`, `at_rest`, `drift`: of such a record.

    **Returns:** a `StepRecord`, or an `InputRecord` with `whole`. Of a step the rows up to the one
    before the next step; before the first step those in which the output is at rest count, before a
    later one, of these the last 5 % since the step before. Rows without a value are left out, at
    most a tenth, and rows with one time stamp are averaged. An input that is constant and not 0 is
    a step from 0 at its first row. A step before the first row is no mistake. `details` tells what
    was done (`assumed_step`, `rows_used`, ...: `DETAILS`).

    **Raises:** `OSError`, `KeyError`, `TypeError`, `ValueError` or `ImportError`, in one sentence.
    """
    import pandas as pd

    known = isinstance(path, pd.DataFrame | pd.Series)
    table = frame_table(path) if known else file_table(opened(path))
    by_hand = step_time is not None or step_size is not None
    roles = roles_of(table, time, output, input, by_hand)
    rows = rows_of(table, roles, dayfirst)
    first, last = (
        None if value is None else moment(value, rows.times, name, dayfirst)
        for value, name in ((begin, "begin"), (end, "end"))
    )
    rows = rows_between(rows, first, last, table.source)
    asked = [step, step_time, step_size, initial, final]
    if _is_whole(table, roles, rows, whole, any(x is not None for x in asked)):
        wishes = {"hold": hold, "at_rest": at_rest, "drift": drift}
        return _whole_record(table, roles, rows, not whole, wishes)
    at = None if step_time is None else moment(step_time, rows.times, "step_time", dayfirst)
    rows, move = _with_step(table, roles, rows, step, at, step_size)
    return _record(table, roles, rows, move, {"initial": initial, "final": final})


def _is_whole(
    table: Table, roles: Roles, rows: Rows, whole: bool | None, asked_for_step: bool
) -> bool:
    """Whether all rows are the record: as told, or where no step of several can stand alone."""
    if whole:
        if asked_for_step:
            raise ValueError(
                "The whole log has no one step and no known level: leave out step, step_time,"
                " step_size, initial and final, or whole."
            )
        if rows.u is None:
            raise ValueError(f"The whole log needs an input: name that column of {table.source}.")
        return True
    if whole is False or asked_for_step or rows.u is None:
        return False
    found = [row for row, _ in find_steps(rows.u)]
    if len(found) < 2:
        return False
    ends = [*found[1:], rows.t.size]
    return not any(comes_to_rest(rows.y[a:b]) for a, b in zip(found, ends, strict=True))


def _whole_record(
    table: Table, roles: Roles, rows: Rows, unasked: bool, wishes: dict[str, Any]
) -> InputRecord:
    """All rows, with the input as it is."""
    t, y, u = rows.t, rows.y, rows.u
    assert u is not None  # `_is_whole` has asked
    for values, column in ((y, roles.output), (u, roles.input)):
        if np.ptp(values) == 0:
            name = f"{table.names[column or 0]!r} of {table.source}"
            raise ValueError(f"{name} is constant, {values[0]:g}: that tells no response.")
    rows = rows.with_facts({"whole": True, "rows_used": t.size})
    rows = rows.with_fact("whole_by_itself", True) if unasked else rows
    names, details = _named(table, roles, rows)
    record = InputRecord(t, y, u, labels=names, details=details, **wishes)
    return _rising(record, table)


Move = tuple[float, float]
"""Time and size of a step."""


def _with_step(
    table: Table,
    roles: Roles,
    rows: Rows,
    step: SupportsIndex | None,
    step_time: float | None,
    step_size: SupportsFloat | None,
) -> tuple[Rows, Move]:
    """The rows that belong to a step of the input, or to the one that was told; and the step."""
    by_hand = step_time is not None or step_size is not None
    if rows.u is not None:
        where = f"The input {table.names[roles.input or 0]!r} of {table.source}"
        found = find_steps(rows.u)
        if found and by_hand:
            raise ValueError(
                f"{where} tells the step: leave out the input, or step_time, step_size."
            )
        if roles.implied and step is None and not found and not is_constant(rows.u):
            rows = rows.with_fact("input_without_step", True)
        else:
            return _of_input(table, roles, rows, found, step, step_time, where)
    if step is not None:
        raise ValueError(f"step={step} needs an input: name that column of {table.source}.")
    move = (step_time or 0.0, 1.0 if step_size is None else float(step_size))
    if move[1] == 0 or not np.isfinite(move).all():
        raise ValueError(
            f"The step at t = {move[0]:g} needs a size that is not 0, got {move[1]:g}."
        )
    span = f"from step 1 of 1 at t = {move[0]:g} to t = {rows.t[-1]:g}"
    told = step_time is not None
    _check_response(rows, move[0], f"{table.names[roles.output]!r} of {table.source}", span, told)
    facts = {"assumed_step": False, "steps_found": 0} | ({"step_told": True} if by_hand else {})
    return _at_rest(rows, move, None).with_facts(facts), move


def _of_input(
    table: Table,
    roles: Roles,
    rows: Rows,
    found: list[tuple[int, float]],
    step: SupportsIndex | None,
    step_time: float | None,
    where: str,
) -> tuple[Rows, Move]:
    """The rows that belong to one of the steps found in the input, and that step.

    With all before the first step, or the last 5 % since the step before.
    """
    assumed = not found
    u = rows.u
    assert u is not None
    found = found or [(0, constant_level(u, where))]
    steps = [(float(rows.t[row]), size) for row, size in found]
    if assumed and step_time is not None:
        steps = [(step_time, steps[0][1])]
    chosen = choice(1 if step is None else step, steps, where)
    starts = [row for row, _ in found]
    row, stop = starts[chosen], [*starts, rows.t.size][chosen + 1]
    first = starts[chosen - 1] if chosen else 0
    # Of the last response only an end that has settled: `test_one_of_several_steps`.
    begin = None if chosen == 0 else row - first - max(1, (row - first) // 20)
    rows = rows.part(slice(first, stop))
    span = f"from step {chosen + 1} of {len(steps)} at t = {steps[chosen][0]:g} to"
    span += f" t = {rows.t[-1]:g}"
    output = f"{table.names[roles.output]!r} of {table.source}"
    _check_response(rows, steps[chosen][0], output, span, told=True)
    rows = _at_rest(rows, steps[chosen], begin)
    facts = {"assumed_step": assumed, "steps_found": len(steps), "step_taken": chosen + 1}
    return rows.with_facts(facts), steps[chosen]


def _at_rest(rows: Rows, move: Move, begin: int | None) -> Rows:
    """The rows from `begin` on; None: from the one on in which the plant is at rest."""
    rest = rest_before(rows.t, rows.y, move[0])
    rows = rows.part(slice(rest.unrest if begin is None else begin, None))
    facts: dict[str, ArrayLike] = {"rows_used": rows.t.size}
    if begin is None and rest.unrest:
        facts["rows_before_rest"] = rest.unrest
    if rest.drift:
        facts["drift"] = rest.drift
    if rows.t[0] > move[0]:
        facts["begins_late"] = float(rows.t[0]) - move[0]
    return rows.with_facts(facts)


def _check_response(rows: Rows, step_time: float, output: str, span: str, told: bool) -> None:
    """Refuse a step after the record, few rows from it on, and an output without response.

    A step that was not told is taken to be at t = 0: a record that begins later than it is long
    shows nothing of the response to such a step.
    """
    t, y = rows.t, rows.y
    if step_time > t[-1] or (not told and t[0] - step_time > t[-1] - t[0]):
        leaves = f", which leaves out t = {step_time:g}"
        told_by = "" if told else ", where the step is taken to be if no input column is named"
        raise ValueError(
            f"The record of {output} goes from t = {t[0]:g} to {t[-1]:g}{leaves}{told_by}."
        )
    after = y[t >= step_time]
    if after.size < MIN_SAMPLES:
        raise ValueError(
            f"{output} has fewer than {MIN_SAMPLES} samples {span}: only {after.size}."
        )
    if np.ptp(after) == 0:
        raise ValueError(f"The output {output} is constant, {after[0]:g}, {span}.")


def _record(
    table: Table, roles: Roles, rows: Rows, move: Move, known: dict[str, SupportsFloat | None]
) -> StepRecord:
    """The record of rows, with names and with what was done."""
    names, details = _named(table, roles, rows)
    return _rising(StepRecord(rows.t, rows.y, *move, **known, labels=names, details=details), table)


def _named(table: Table, roles: Roles, rows: Rows) -> tuple[Labels, dict[str, Any]]:
    """Names of the columns, and what was done."""
    used = [i for i in (roles.time, roles.output, roles.input) if i is not None]
    names = [table.names[i] for i in used]
    names[0] = time_label(names[0], rows.times)
    if "input_without_step" in rows.facts:
        names.pop()
    return Labels(table.file, *names), {name: _fact(x) for name, x in rows.facts.items()}


def _rising(record: Any, table: Table) -> Any:
    """A record whose times still rise in its precision."""
    if not np.all(np.diff(record.t) > 0):
        raise ValueError(
            f"The times of {table.source} are too close together for single precision: switch"
            ' float64 on with jax.config.update("jax_enable_x64", True).'
        )
    return record


def _fact(value: Any) -> Any:
    """A fact as an array; the date of the first row needs float64, also in single precision."""
    return np.asarray(value) if isinstance(value, np.float64) else jnp.asarray(value)
