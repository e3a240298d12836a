"""An identification as tables for the terminal; host code."""

import math
from typing import Any

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from .._result import Identification
from .._status import Status, refused, status_name
from ..models._notation import number, transfer_function_text
from ..records._labels import Units
from ._content import like, parameter_rows, warning_sentences, with_unit


# Parameters


def _parameter_table(result: Identification, units: Units) -> Table:
    table = _table("parameter", "value", "std. error", "95 % interval", "unit", right=(1, 2, 3))
    free = {name.split("[")[0] for name in result.free}
    for label, name, value, std in parameter_rows(result):
        error, interval = "", ""
        if std > 0:
            error, low, high = number(std, 2), value - 1.96 * std, value + 1.96 * std
            interval = f"{like(low, std)} to {like(high, std)}"
        elif std == 0 and name not in free:
            error = "fixed"
        shown = str(value) if isinstance(value, int) else number(value, 5)
        table.add_row(label, shown, error, interval, Text(units.parameter(name)))
    return table


def _table(*columns: str, right: tuple[int, ...] = ()) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i in right else "left")
    return table


# Reports


def report(result: Identification, method: str, step: int | None = None) -> Group:
    """What an identification says: transfer function, parameters, quality, and what to mind.

    `step` is the number that was asked for, None for the first.
    """
    units = Units.of(result.record.labels)
    model = type(result.model).__name__
    lines = [
        Text(f"Model {model} by {method}"),
        Text(f"G(s) = {transfer_function_text(result.model)}"),
    ]
    quality = [
        f"fit {number(result.fit_percent)} %",
        f"RMSE {with_unit(result.rmse, units.output)}",
        f"J {with_unit(result.J, units.integral)}",
    ]
    aicc = {
        name.removeprefix("aicc_"): float(value)
        for name, value in result.details.items()
        if name.startswith("aicc_")
    }
    if aicc:
        ranked = sorted(aicc, key=lambda name: (math.isnan(aicc[name]), aicc[name]))
        lines.append(
            Text("AICc: " + ", ".join(f"{name} {number(aicc[name], 6)}" for name in ranked))
        )
    warnings = warning_sentences(result, step)
    ending = [Text(f"Note: {warning}", style="yellow") for warning in warnings]
    if status_name(result.status) == "successful":
        ending.insert(0, Text(Status[result.status], style="green"))
    return Group(*lines, _parameter_table(result, units), Text(", ".join(quality)), *ending)


def comparison_report(comparison, group: str = "all") -> Group:
    """Ranking of the methods that gave a model of a group, and why others gave none."""
    kept = comparison.models(group)
    units = Units.of(comparison.record.labels)
    rmse = f"RMSE, {units.output}" if units.output else "RMSE"
    J = f"J, {units.integral}" if units.integral else "J"
    table = _table(
        "", "method", "model", J, rmse, "fit, %", "par.", "AICc", "G(s)", right=(0, 3, 4, 5, 6, 7)
    )
    notes = []
    for place, row in enumerate(kept, 1):
        table.add_row(
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
        if row.status != "successful":
            notes.append(f"{row.method}: {row.reason}")
    lost = (row for row in comparison.rows if not row.has_model and row.is_of(group))
    notes += [f"{row.method}: {row.reason}" for row in lost]
    return Group(table, *(Text(note) for note in notes))


def lookup_table(rows: list[tuple[str, Any]]) -> Table:
    """Models looked up from times, each under its name, as one table."""
    table = _table("lookup", "model", "n", "r", "T", "G(s)", "status", right=(2, 3, 4))
    for name, (model, status) in rows:
        values = [number(model.r, 5), number(model.T, 5), transfer_function_text(model)]
        values = ["-"] * 4 if bool(refused(status)) else [str(int(model.n)), *values]
        good = status_name(status) == "successful"
        meaning = "successful" if good else Status[status]
        table.add_row(name, type(model).__name__, *values, meaning)
    return table


def method_table(rows: list[tuple[str, str, str]]) -> Table:
    """Names of the methods, their model classes and what they do, as one table."""
    table = _table("method", "model", "what it does")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    return table
