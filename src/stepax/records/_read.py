"""Reading a recorded step test from a text table, a MAT file or a DataFrame; host code.

A source becomes a table of named columns, which are time, output and input; the step is found in
the input, and the rows that belong to it are the record. What is wrong is said in one sentence.
"""

import operator
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsIndex

import jax.numpy as jnp
import numpy as np

from ._labels import Labels
from ._record import MIN_SAMPLES, StepRecord
from ._table import TIME_NAME, Table, file_table, finite_numbers, frame_table, increasing_times


if TYPE_CHECKING:
    import pandas as pd


def read_record(
    path: "str | PathLike | pd.DataFrame",
    time: str | SupportsIndex | None = None,
    output: str | SupportsIndex | None = None,
    input: str | SupportsIndex | None = None,
    step: SupportsIndex | None = None,
) -> StepRecord:
    """One step response from a text table (CSV and the like), a MAT file or a DataFrame.

    **Arguments:**

    - `path`: the file, or the DataFrame itself. Separator, decimal comma, comments and header of a
        text table are recognised; a MAT file holds vectors.
    - `time`, `output`, `input`: columns, by name, by position (an int, from 0) or by number (text,
        from 1: also the names of columns without a header). With nothing named, columns t (or
        time), u and y go by these names; else two columns are time and output, three are time,
        input and output. Dates and clock times become seconds since the first row.
    - `step`: which step of the input, counted from 1, or from the last if negative.

    **Returns:** the rows up to the one before the next step; before a later step, the last 5 % of
    those since the step before it. Without an input, the step is at t = 0 with size 1 and every
    row is kept. An input that is constant and not 0 is a step from 0 at its first row.
    `details` has this (`assumed_step`) and the number of steps (`steps_found`).

    **Raises:** `OSError`, `KeyError`, `TypeError`, `ValueError` or `ImportError`, in one sentence.
    """
    import pandas as pd

    table = frame_table(path) if isinstance(path, pd.DataFrame) else file_table(Path(path))
    i_time, i_output, i_input = roles = _roles(table, time, output, input)
    used = [i for i in roles if i is not None]
    _check_counts(table, used)
    t, y = increasing_times(table, i_time), finite_numbers(table, i_output)
    u = None if i_input is None else finite_numbers(table, i_input)
    assumed, steps, chosen, rows = False, [(0.0, 1.0)], 0, slice(None)
    if u is not None:
        where = f"The input {table.names[i_input or 0]!r} of {table.source}"
        found = find_steps(u)
        assumed = not found
        found = found or [(0, _constant_level(u, where))]
        steps = [(float(t[row]), size) for row, size in found]
        chosen = _choice(1 if step is None else step, steps, where)
        rows = _rows_of(chosen, [row for row, _ in found], t.size)
    elif step is not None:
        raise ValueError(f"step={step} needs an input: name that column of {table.source}.")
    t, y = t[rows], y[rows]
    step_time, step_size = steps[chosen]
    span = f"from step {chosen + 1} of {len(steps)} at t = {step_time:g} to t = {t[-1]:g}"
    _check_response(t, y, step_time, f"{table.names[i_output]!r} of {table.source}", span)
    record = StepRecord(
        t,
        y,
        step_time,
        step_size,
        labels=Labels(table.file, *(table.names[i] for i in used)),
        details={
            "assumed_step": jnp.asarray(assumed),
            "steps_found": jnp.asarray(0 if u is None else len(steps)),
        },
    )
    if not np.all(np.diff(record.t) > 0):
        raise ValueError(
            f"The times of {table.source} are too close together for single precision: switch"
            ' float64 on with jax.config.update("jax_enable_x64", True).'
        )
    return record


# The step in the input


def find_steps(u: np.ndarray) -> list[tuple[int, float]]:
    """Steps of an input: the first row with a new value, and the mean level after less before.

    A change counts above 4 times the noise of u and 2 % of the largest change. Changes in one
    direction with at most two rows between them are a ramp: one step. Its size is at least 6 times
    the noise and 5 % of the largest: one of 10 times the noise is found.
    """
    change = np.diff(u)
    noise = _noise(u)
    # A difference of two rows has sqrt(2) of the noise: a row in 200 passes 4 times by chance, and
    # the means below drop it. Higher, and ramps fall apart; lower, and noise is taken for the end
    # of a ramp. The share keeps the ripple of a clean input out, yet a ramp with a slow end whole.
    limit = max(4 * noise, 0.02 * np.max(np.abs(change)))
    ramps: list[tuple[int, int]] = []
    for row in np.flatnonzero(np.abs(change) > limit).tolist():
        first, last = ramps[-1] if ramps else (row, row)
        # Actuators and anti-aliasing filters take a few rows; `test_ramp_is_one_step`.
        if ramps and row - last <= 3 and (change[row] > 0) == (change[last] > 0):
            ramps[-1] = first, row
        else:
            ramps.append((row, row))
    # Means hold many rows, so 6 times is far from chance, and 10 times still passes with the error
    # of short pieces: `test_steps_in_noise`, `test_small_changes_beside_a_large_step`.
    sizes = np.abs(np.diff(_levels(u, ramps)))
    enough = sizes >= max(6 * noise, 0.05 * np.max(sizes, initial=0.0))
    ramps = [ramp for ramp, holds in zip(ramps, enough, strict=True) if holds]
    sizes = np.diff(_levels(u, ramps)).tolist()
    return [(first + 1, size) for (first, _), size in zip(ramps, sizes, strict=True)]


def _levels(u: np.ndarray, ramps: list[tuple[int, int]]) -> list[float]:
    """Means of an input before, between and after ramps, given by their first and last changes."""
    starts, stops = [0] + [last + 1 for _, last in ramps], [first + 1 for first, _ in ramps]
    return [float(np.mean(u[a:b])) for a, b in zip(starts, [*stops, u.size], strict=True)]


def _noise(u: np.ndarray) -> float:
    """Noise of an input, at least 1e-10 of its largest value (rounding is no step).

    From the upper quartile of the second differences: 1.15 sqrt(6) sigma for Gaussian noise, and
    0 for a clean input whose steps are at least 8 rows apart.
    """
    quartile = np.quantile(np.abs(np.diff(u, 2)), 0.75, method="lower")
    return max(float(quartile) / (1.15 * np.sqrt(6)), 1e-10 * float(np.max(np.abs(u))))


def _constant_level(u: np.ndarray, where: str) -> float:
    """Level of an input without steps: that of a step from 0 at the first row."""
    # 12 times: the range of 10^6 rows of Gaussian noise is 10 times; `test_constant_input_...`.
    level, spread = float(np.mean(u)), float(np.ptp(u))
    if level == 0 or spread > min(abs(level), 12 * _noise(u)):
        raise ValueError(f"{where} has no step: it lies from {u.min():g} to {u.max():g}.")
    return level


def _choice(step: Any, steps: list[tuple[float, float]], where: str) -> int:
    """Index of a step counted from 1, or from the last."""
    if isinstance(step, bool) or not isinstance(step, SupportsIndex):
        raise TypeError(f"step must be a whole number counted from 1, got {step!r}.")
    step = operator.index(step)
    count, times = len(steps), ", ".join(f"{time:g}" for time, _ in steps)
    if not 1 <= abs(step) <= count:
        raise ValueError(
            f"{where} has no step {step}: there {'is 1' if count == 1 else f'are {count}'},"
            f" at t = {times}."
        )
    return step - 1 if step > 0 else count + step


def _rows_of(chosen: int, starts: list[int], count: int) -> slice:
    """Rows of a step, with all before the first step, or the last 5 % since the step before."""
    # Of the last response only an end that has settled: `test_one_of_several_steps`.
    row, stop = starts[chosen], [*starts, count][chosen + 1]
    before = row if chosen == 0 else max(1, (row - starts[chosen - 1]) // 20)
    return slice(row - before, stop)


def _check_counts(table: Table, used: list[int]) -> None:
    """Refuse columns of unequal lengths and of few rows."""
    counts = {table.names[i]: table.columns[i].size for i in used}
    if len(set(counts.values())) > 1:
        raise ValueError(f"The columns of {table.source} have unequal numbers of rows: {counts}.")
    if min(counts.values()) < MIN_SAMPLES:
        least = f"fewer than {MIN_SAMPLES} samples"
        raise ValueError(f"{table.source} has {least}: only {min(counts.values())}.")


def _check_response(t: np.ndarray, y: np.ndarray, step_time: float, output: str, span: str) -> None:
    """Refuse a step outside the record, few rows from it on, and an output without response."""
    if not t[0] <= step_time <= t[-1]:
        raise ValueError(
            f"The record of {output} goes from t = {t[0]:g} to {t[-1]:g}, which leaves out t = 0,"
            " where the step is taken to be if no input column is named."
        )
    after = y[t >= step_time]
    if after.size < MIN_SAMPLES:
        raise ValueError(
            f"{output} has fewer than {MIN_SAMPLES} samples {span}: only {after.size}."
        )
    if np.ptp(after) == 0:
        raise ValueError(f"The output {output} is constant, {after[0]:g}, {span}.")


# Columns


def _roles(table: Table, time: Any, output: Any, input: Any) -> tuple[int, int, int | None]:
    """Columns of time, output and, if there is one, input."""
    names, source = table.names, table.source
    if len(names) < 2:
        raise ValueError(f"{source} needs columns for time and output; it has: {_listed(names)}.")
    asked = [None if key is None else _position(table, key) for key in (time, output, input)]
    if asked == [None, None, None]:
        t, u, y = (_first_of(names, known) for known in (("t", "time"), ("u",), ("y",)))
        if t is not None and y is not None and (u is not None or len(names) == 2):
            return t, y, u
        if len(names) <= 3:
            return (0, 1, None) if len(names) == 2 else (0, 2, 1)
    rest = [i for i in range(len(names)) if i not in asked]
    i_time, i_output, i_input = asked
    if i_time is None and rest:
        i_time = next((i for i in rest if TIME_NAME.search(names[i])), rest[0])
        rest.remove(i_time)
    if i_output is None and len(rest) == 1:
        i_output = rest[0]
    if i_time is None or i_output is None:
        raise ValueError(f"Name the columns of {source} to use; it has: {_listed(names)}.")
    if len({i_time, i_output, i_input}) < 3:
        raise ValueError(f"One column of {source} is named twice: {[time, output, input]}.")
    return i_time, i_output, i_input


def _first_of(names: list[str], known: tuple[str, ...]) -> int | None:
    """Where the first known name is that a table has."""
    return next((names.index(name) for name in known if name in names), None)


def _position(table: Table, key: Any) -> int:
    """Where a column is, given its name, its position or, as text, its number from 1."""
    names = table.names
    if isinstance(key, str):
        wanted = key.strip().casefold()
        matches = [i for i, name in enumerate(names) if name == key]
        matches = matches or [i for i, name in enumerate(names) if name.casefold() == wanted]
        if not matches and wanted.isdecimal():
            matches = [i for i in range(len(names)) if i + 1 == int(wanted)]
    elif isinstance(key, bool) or not isinstance(key, SupportsIndex):
        raise TypeError(f"A column is given by a name or a position, got {key!r}.")
    else:
        matches = [i for i in range(len(names)) if i == operator.index(key)]
    if len(matches) != 1:
        found = "several columns" if matches else "no column with data"
        raise KeyError(f"{table.source} has {found} {key!r}; it has: {_listed(names)}.")
    return matches[0]


def _listed(names: list[str]) -> str:
    """Names for a message."""
    return ", ".join(map(repr, names)) or "none"
