"""What a report says, as plain data: text, rows of text, and JSON; host code.

How it looks is the business of the other files of this wing.
"""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from .._compare import Comparison
from .._identify_each import Outcome
from .._notes import free_names, notes_of, with_unit
from .._result import Identification
from .._status import Status, refused, status_name
from ..fitting._certainty import NORMAL_95
from ..models._abstract import COMMON, AbstractPlant
from ..models._notation import number, transfer_function_text
from ..records._labels import Units
from ..records._record import StepRecord, rows_that_count


class Table(NamedTuple):
    """Rows of text under the names of their columns; `numbers` says which columns hold numbers."""

    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]
    numbers: tuple[int, ...] = ()


class ParameterRow(NamedTuple):
    """One parameter, as text; empty where there is nothing to say."""

    label: str
    value: str
    error: str
    interval: str
    unit: str


class Content(NamedTuple):
    """What is said of an identification, in the order of reading.

    - `heading`: lines: the model and its method, the transfer function.
    - `ranking`: of the families that were compared, name and AICc, the best first; may be empty.
    - `parameters`: a table of `ParameterRow`s.
    - `quality`: name and value of each figure of merit.
    - `verdict`: the sentence of a result without a warning in its status, else empty.
    - `notes`: what to mind, a sentence each.
    """

    heading: list[str]
    ranking: list[tuple[str, str]]
    parameters: Table
    quality: list[tuple[str, str]]
    verdict: str
    notes: list[str]


class ComparisonContent(NamedTuple):
    """What is said of a comparison: the ranking, and which methods to mind, or gave no model."""

    ranking: Table
    notes: list[str]


# Reports


def record_line(record: StepRecord) -> str:
    """What was read."""
    units = Units.of(record.labels)
    size = with_unit(record.step_size, units.input)
    time = with_unit(record.step_time, units.time)
    rows = rows_that_count(record).t.size
    return f"{record.labels.source}: {rows} rows, step of {size} at t = {time}"


def picture_lines(record: StepRecord) -> list[str]:
    """What was read off a picture, and how well."""
    t, y = (np.asarray(x) for x in (record.t, record.y))
    stroke, place = (float(record.details[name]) for name in ("stroke", "stroke_time"))
    return [
        record_line(record),
        f"time {t[0]:.6g} to {t[-1]:.6g}, output {y.min():.6g} to {y.max():.6g}; standard deviation"
        f" of a level row {number(stroke, 2)}, of the axis of time {number(place, 2)}",
    ]


def content(result: Identification, method: str, step: int | None = None) -> Content:
    """What an identification says: transfer function, parameters, quality, and what to mind.

    `step` is the number that was asked for, None for the first.
    """
    units = Units.of(result.record.labels)
    aicc = {
        name.removeprefix("aicc_"): float(value)
        for name, value in result.details.items()
        if name.startswith("aicc_")
    }
    ranked = sorted(aicc, key=lambda name: (math.isnan(aicc[name]), aicc[name]))
    return Content(
        heading=[
            f"Model {type(result.model).__name__} by {method}",
            f"G(s) = {transfer_function_text(result.model)}",
        ],
        ranking=[(name, number(aicc[name], 6)) for name in ranked],
        parameters=Table(
            ("parameter", "value", "std. error", "95 % interval", "unit"),
            list(_parameter_rows(result, units)),
            numbers=(1, 2, 3),
        ),
        quality=[
            ("fit", f"{number(result.fit_percent)} %"),
            ("RMSE", with_unit(result.rmse, units.output)),
            ("J", with_unit(result.J, units.integral)),
        ],
        verdict=Status[result.status] if status_name(result.status) == "successful" else "",
        notes=notes_of(result, step),
    )


def comparison_content(comparison: Comparison, group: str = "all") -> ComparisonContent:
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


def table_of_files(outcomes: Sequence[Outcome]) -> Table:
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


# Parameters


def parameters(model: AbstractPlant) -> dict[str, Any]:
    """Parameters by name, its own first: numbers, `n` a whole one for a chain, lists of lags."""
    own = [field.name for field in dataclasses.fields(model) if field.name not in COMMON]
    return {name: np.asarray(getattr(model, name)).tolist() for name in [*own, *COMMON]}


def _parameter_rows(result: Identification, units: Units) -> Iterator[ParameterRow]:
    """Every parameter with its standard error and interval."""
    free = {name for name, _ in free_names(result)}
    for label, name, value, std in _values(result):
        error, interval = "", ""
        if std > 0:
            error, low, high = number(std, 2), value - NORMAL_95 * std, value + NORMAL_95 * std
            interval = f"{like(low, std)} to {like(high, std)}"
        elif std == 0 and name not in free:
            error = "fixed"
        shown = str(value) if isinstance(value, int) else number(value, 5)
        unit = units.unit(result.model.dimension(name))
        yield ParameterRow(label, shown, error, interval, unit)


def _values(result: Identification) -> Iterator[tuple[str, str, float, float]]:
    """Label, name, value and standard error of every parameter; lags slowest first, without 0."""
    for name, value in parameters(result.model).items():
        std = np.asarray(result.std.get(name, np.nan), float)
        if not isinstance(value, list):
            yield name, name, value, float(std)
            continue
        values, errors = np.asarray(value, float), np.broadcast_to(std, len(value))
        order = [i for i in np.argsort(-values, kind="stable") if values[i] or not values.any()]
        for place, i in enumerate(order, 1):
            yield f"lag {place}", name, float(values[i]), float(errors[i])


# Numbers


def like(x: float, std: float) -> str:
    """A number to the second digit of its standard error, at most 6 significant ones."""
    size = math.floor(math.log10(abs(x))) if x else 0
    return number(x, min(6, max(2, size - math.floor(math.log10(std)) + 2)))


# JSON


def to_json(result: Identification, method: str) -> dict[str, Any]:
    """The result as a dictionary for JSON; NaN is None."""
    names = result.model.parameter_names
    values = parameters(result.model)
    std = {
        name: np.broadcast_to(np.asarray(result.std.get(name, np.nan)), np.shape(values[name]))
        for name in names
    }
    return _finite_or_none(
        {
            "method": method,
            "model": type(result.model).__name__,
            "parameters": values,
            "standard_errors": {name: x.tolist() for name, x in std.items()},
            "rmse": float(result.rmse),
            "fit_percent": float(result.fit_percent),
            "status": status_name(result.status),
        }
    )


def _finite_or_none(tree) -> Any:
    """A tree of dictionaries and lists with None for NaN and infinity."""
    if isinstance(tree, dict):
        return {name: _finite_or_none(x) for name, x in tree.items()}
    if isinstance(tree, list):
        return [_finite_or_none(x) for x in tree]
    return None if isinstance(tree, float) and not math.isfinite(tree) else tree
