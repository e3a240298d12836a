"""The rows of a table that can be used: those with values, in the order of time; host code."""

import dataclasses
from typing import Any

import numpy as np

from ._cells import MOST_MISSING, Times, missing_marks, numbers_of, refuse_missing, times_of
from ._columns import Roles
from ._record import MIN_SAMPLES
from ._table import Table


@dataclasses.dataclass(frozen=True)
class Rows:
    """Times, output and input, row by row; `facts`: what was done with the rows, by name."""

    t: np.ndarray
    y: np.ndarray
    u: np.ndarray | None
    times: Times
    facts: dict[str, Any] = dataclasses.field(default_factory=dict)

    def part(self, rows: slice | np.ndarray) -> "Rows":
        """Some of the rows."""
        u = None if self.u is None else self.u[rows]
        return dataclasses.replace(self, t=self.t[rows], y=self.y[rows], u=u)

    def with_facts(self, facts: dict[str, Any]) -> "Rows":
        """The same rows, and more that was done with them."""
        return dataclasses.replace(self, facts=self.facts | facts)

    def with_fact(self, name: str, value: Any) -> "Rows":
        """The same for one fact."""
        return self.with_facts({name: value})


def rows_of(table: Table, roles: Roles, dayfirst: bool) -> Rows:
    """Rows with a time and values, in increasing time: what a logger does in few rows is mended.

    Rows without an output, or with a mark such as `---` for time or input, are left out, at most a
    tenth of all; rows with the same time stamp become their mean.
    """
    used = [i for i in (roles.time, roles.output, roles.input) if i is not None]
    _check_counts(table, used)
    times = times_of(table, roles.time, dayfirst)
    y = numbers_of(table, roles.output)
    u = None if roles.input is None else numbers_of(table, roles.input)
    missing = ~np.isfinite(y)
    refuse_missing(table, roles.output, y, int(MOST_MISSING * y.size))
    for column in used:
        missing |= missing_marks(table, column)
    others = [(roles.time, times.values)] + ([] if u is None else [(roles.input or 0, u)])
    for column, values in others:
        shown = np.where(missing, 0.0, values)
        # where few rows are left out, the others must be whole; else the marks are what is wrong
        refuse_missing(table, column, shown if np.mean(missing) <= MOST_MISSING else values)
    kept = np.flatnonzero(~missing)
    rows = Rows(times.values, y, u, times).part(kept)
    facts: dict[str, Any] = {"time_stamps": True} if times.stamped else {}
    if np.isfinite(times.began):
        facts["began"] = np.float64(times.began)
    if missing.any():
        facts["rows_left_out"] = int(missing.sum())
    return _in_order(table, roles.time, rows.with_facts(facts), kept)


def rows_between(rows: Rows, begin: float | None, end: float | None, source: str) -> Rows:
    """The rows from one time to another, both included; None leaves that end open."""
    low = -np.inf if begin is None else begin
    high = np.inf if end is None else end
    inside = (rows.t >= low) & (rows.t <= high)
    if np.sum(inside) < MIN_SAMPLES:
        raise ValueError(
            f"{source} has fewer than {MIN_SAMPLES} samples from t = {low:g} to {high:g}:"
            f" only {np.sum(inside)}."
        )
    return rows if inside.all() else rows.part(inside)


def _in_order(table: Table, column: int, rows: Rows, numbers: np.ndarray) -> Rows:
    """Rows with one stamp as their mean; refused where time goes back, or stands still."""
    change = np.diff(rows.t)
    back = np.flatnonzero(change < 0)
    starts = np.concatenate([[0], np.flatnonzero(change > 0) + 1])
    if not back.size and starts.size < min(MIN_SAMPLES, rows.t.size):
        back = np.flatnonzero(change <= 0)
    if back.size:
        places = (int(back[0]), int(back[0]) + 1)
        before, after = (f"{rows.t[i]:.9g} {table.place(int(numbers[i]))}" for i in places)
        raise ValueError(
            f"The time {table.names[column]!r} of {table.source} does not increase:"
            f" it is {before} and {after}."
        )
    if starts.size == rows.t.size:
        return rows
    counts = np.diff(starts, append=rows.t.size)
    y = np.add.reduceat(rows.y, starts) / counts
    u = None if rows.u is None else np.add.reduceat(rows.u, starts) / counts
    merged = int(np.sum(counts[counts > 1]))
    return Rows(rows.t[starts], y, u, rows.times, rows.facts | {"rows_averaged": merged})


def _check_counts(table: Table, used: list[int]) -> None:
    """Refuse columns of unequal lengths and of few rows."""
    counts = {table.names[i]: table.columns[i].size for i in used}
    if len(set(counts.values())) > 1:
        raise ValueError(f"The columns of {table.source} have unequal numbers of rows: {counts}.")
    if min(counts.values()) < MIN_SAMPLES:
        least = f"fewer than {MIN_SAMPLES} samples"
        raise ValueError(f"{table.source} has {least}: only {min(counts.values())}.")
