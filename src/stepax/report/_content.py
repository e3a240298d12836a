"""What reports on several results say, as plain data; of one result `summary` says it; host code.

How it looks is the business of the other files of this wing.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from .._notes import notes_of
from .._status import Status, refused, status_name
from ..models._notation import number, transfer_function_text
from ..records._labels import Units
from ..records._record import StepRecord
from ..summary._content import Table, content as content, record_line as record_line
from ..summary._json import to_json as to_json
from ._told import FileOutcome, Ranking


class ComparisonContent(NamedTuple):
    """What is said of a comparison: the ranking, and which methods to mind, or gave no model."""

    ranking: Table
    notes: list[str]


def picture_lines(record: StepRecord) -> list[str]:
    """What was read off a picture, and how well."""
    t, y = (np.asarray(x) for x in (record.t, record.y))
    stroke, place = (float(record.details[name]) for name in ("stroke", "stroke_time"))
    return [
        record_line(record),
        f"time {t[0]:.6g} to {t[-1]:.6g}, output {y.min():.6g} to {y.max():.6g}; standard deviation"
        f" of a level row {number(stroke, 2)}, of the axis of time {number(place, 2)}",
    ]


def comparison_content(comparison: Ranking, group: str = "all") -> ComparisonContent:
    """Ranking of the methods that gave a model of a group, and why others gave none."""
    units = Units.of(comparison.record.labels)
    rmse = f"RMSE, {units.output}" if units.output else "RMSE"
    J = f"J, {units.integral}" if units.integral else "J"
    columns = ("", "method", "model", J, rmse, "fit, %", "par.", "AICc", "G(s)")
    kept = comparison.models(group)
    rows = [
        (
            str(place),
            row.method,
            row.model,
            number(row.J),
            number(row.rmse),
            number(row.fit_percent),
            str(row.parameters),
            number(row.aicc, 6),
            transfer_function_text(row.result.model),
        )
        for place, row in enumerate(kept, 1)
    ]
    told = [row for row in kept if row.status != "successful"]
    told += [row for row in comparison.rows if not row.has_model and row.is_of(group)]
    notes = [f"{row.method}: {row.reason}" for row in told]
    return ComparisonContent(Table(columns, rows, numbers=(0, 3, 4, 5, 6, 7)), notes)


def table_of_files(outcomes: Sequence[FileOutcome]) -> Table:
    """A row a file: its model and how good it is, or why there is none."""
    rows = []
    for file in outcomes:
        if not file.has_model or file.result is None:
            rows.append((file.source, "", "", "", file.reason))
            continue
        result = file.result
        fit, text = number(result.fit_percent), transfer_function_text(result.model)
        rows.append(
            (file.source, type(result.model).__name__, fit, text, " ".join(notes_of(result)))
        )
    return Table(("file", "model", "fit, %", "G(s)", "notes"), rows, numbers=(2,))


def lookup_content(rows: Iterable[tuple[str, Any]]) -> Table:
    """Models looked up from times, each under its name."""
    cells = []
    for name, (model, status) in rows:
        values = [number(model.r, 5), number(model.T, 5), transfer_function_text(model)]
        values = ["-"] * 4 if bool(refused(status)) else [str(int(model.n)), *values]
        good = status_name(status) == "successful"
        meaning = "successful" if good else Status[status]
        cells.append((name, type(model).__name__, *values, meaning))
    return Table(("lookup", "model", "n", "r", "T", "G(s)", "status"), cells, numbers=(2, 3, 4))
