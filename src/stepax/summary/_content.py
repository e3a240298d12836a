"""What a result says, as plain data: text and rows of text; host code.

How it looks is the business of the other files of this wing.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from .._notes import Identified, free_names, notes_of, with_unit
from .._status import Status, status_name
from ..models._abstract import COMMON, AbstractPlant
from ..models._notation import number, transfer_function_text
from ..records._abstract import AbstractRecord
from ..records._labels import Units
from ..records._record import rows_that_count
from ._intervals import quantile


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


def record_line(record: AbstractRecord) -> str:
    """What was read."""
    units = Units.of(record.labels)
    rows = int(np.asarray(record.details.get("rows_thinned", rows_that_count(record).t.size)))
    facts = record.input_facts()
    if facts["step"]:
        size, time = facts["step"]["size"], facts["step"]["time"]
        moves = f"step of {with_unit(size, units.input)} at t = {with_unit(time, units.time)}"
    else:
        about = facts["input"]
        moves = f"input from {number(about['least'])} to {with_unit(about['most'], units.input)}"
    return f"{record.labels.source or 'Record'}: {rows} rows, {moves}"


def content(result: Identified, method: str | None = None, step: int | None = None) -> Content:
    """What an identification says: transfer function, parameters, quality, and what to mind.

    `method`: how the model was found, in other words than its name. `step` is the number that was
    asked for, None for the first.
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
            f"Model {type(result.model).__name__}{_by(result, method)}",
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


def _by(result: Identified, method: str | None) -> str:
    """How the model was found, as far as that is known."""
    method = result.method if method is None else method
    tried = any(name.startswith("aicc_") for name in result.details)
    chosen = ", chosen by AICc" if tried and method == result.method else ""
    return f" by {method}{chosen}" if method else ""


# Parameters


def parameters(model: AbstractPlant) -> dict[str, Any]:
    """Parameters by name, its own first: numbers, `n` a whole one for a chain, lists of lags."""
    own = [field.name for field in dataclasses.fields(model) if field.name not in COMMON]
    return {name: np.asarray(getattr(model, name)).tolist() for name in [*own, *COMMON]}


def _parameter_rows(result: Identified, units: Units) -> Iterator[ParameterRow]:
    """Every parameter with its standard error and interval."""
    free = {name for name, _ in free_names(result)}
    wide = float(quantile(result))
    for label, name, value, std in _values(result):
        error, interval = "", ""
        if std > 0:
            error, low, high = number(std, 2), value - wide * std, value + wide * std
            interval = f"{like(low, std)} to {like(high, std)}"
        elif std == 0 and name not in free:
            error = "fixed"
        shown = str(value) if isinstance(value, int) else number(value, 5)
        unit = units.unit(result.model.dimension(name))
        yield ParameterRow(label, shown, error, interval, unit)


def _values(result: Identified) -> Iterator[tuple[str, str, float, float]]:
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
