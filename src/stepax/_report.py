"""An identification in words, as tables for the terminal, and as JSON; host code."""

import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ._models import AbstractPlant
from ._notation import Units, number, transfer_function_text, unit_of
from ._result import Identification, Status, parameter_names, refused, status_name


# Parameters


def parameters(model: AbstractPlant) -> dict[str, Any]:
    """Parameters by name, its own first: numbers, `n` a whole one for a chain, lists of lags."""
    common = ["gain", "offset", "delay"]
    own = [name for name in model.__dataclass_fields__ if name not in common]
    return {name: np.asarray(getattr(model, name)).tolist() for name in own + common}


def _rows(result: Identification) -> Iterator[tuple[str, str, float, float]]:
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


def _parameter_table(result: Identification, units: Units) -> Table:
    table = _table("parameter", "value", "std. error", "95 % interval", "unit", right=(1, 2, 3))
    free = {name.split("[")[0] for name in result.free}
    for label, name, value, std in _rows(result):
        error, interval = "", ""
        if std > 0:
            error, low, high = number(std, 2), value - 1.96 * std, value + 1.96 * std
            interval = f"{_like(low, std)} to {_like(high, std)}"
        elif std == 0 and name not in free:
            error = "fixed"
        shown = str(value) if isinstance(value, int) else number(value, 5)
        table.add_row(label, shown, error, interval, Text(units.parameter(name)))
    return table


def _like(x: float, std: float) -> str:
    """A number to the second digit of its standard error, at most 6 significant ones."""
    size = math.floor(math.log10(abs(x))) if x else 0
    return number(x, min(6, max(2, size - math.floor(math.log10(std)) + 2)))


def _table(*columns: str, right: tuple[int, ...] = ()) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i in right else "left")
    return table


POOR_FIT = 80.0
"""Fit in percent below which a model is reported with a warning."""


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
        f"RMSE {_with_unit(result.rmse, units.output)}",
        f"J {_with_unit(result.J, units.integral)}",
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


def _with_unit(x, unit: str) -> str:
    return f"{number(x)} {unit}".rstrip()


def warning_sentences(result: Identification, step: int | None = None) -> list[str]:
    """What a user should know about a result, each in one sentence."""
    details = {**result.record.details, **result.details}
    unit = unit_of(result.record.labels.output)

    def holds(name: str) -> bool:
        return bool(np.any(np.asarray(details.get(name, False))))

    def named(name: str, wanted: bool) -> list[str]:
        flags = np.asarray(details.get(name, []), bool)
        names = [re.sub(r"lags\[(\d+)\]", _lag_label, x) for x in result.free]
        return [x for x, flag in zip(names, flags, strict=False) if flag == wanted]

    sentences = []
    if result.status != Status.successful:
        sentences.append(Status[result.status])
    if float(result.fit_percent) < POOR_FIT:
        sentences.append(
            f"The fit is only {number(result.fit_percent)} %: look at the plot before using it."
        )
    bounded = named("at_bound", True)
    vague = [name for name in named("identifiable", False) if name not in bounded]
    if vague:
        sentences.append(f"Not determined by this record: {', '.join(vague)}.")
    if "delay" in bounded:
        sentences.append("The dead time is at the end of its range and has no standard error.")
        bounded.remove("delay")
    if bounded:
        sentences.append(f"At the end of its range: {', '.join(bounded)}.")
    if int(details.get("steps_found", 1)) == 0:
        sentences.append(
            "No input column: the step is taken to be at t = 0 with size 1, and gain and dead time"
            " refer to that."
        )
    if holds("assumed_step"):
        sentences.append(
            "The input is constant from its first row: taken as a step from 0 at that row."
        )
    found = int(details.get("steps_found", 0))
    if found > 1:
        chosen = 1 if step is None else step if step > 0 else found + 1 + step
        choose = ": choose with --step" if step is None else ""
        sentences.append(f"{found} steps in the input; this is step {chosen}{choose}.")
    if holds("not_settled"):
        sentences.append(Status[Status.not_settled])
    if holds("quantised"):
        width = details.get("quantisation")
        steps = "" if width is None else f", in steps of {_with_unit(width, unit)}"
        sentences.append(f"The output is quantised{steps}.")
    if holds("residuals_correlated"):
        lag = details.get("residual_autocorrelation")
        amount = "" if lag is None else f" (autocorrelation {number(lag, 2)} from row to row)"
        sentences.append(
            f"The residuals are correlated{amount}: slow disturbances, or a model that misses part"
            " of the response. The standard errors allow for it as first-order noise; slower"
            " disturbances still make them too small."
        )
    return list(dict.fromkeys(sentences))


def _lag_label(match: re.Match[str]) -> str:
    """Name of a lag as in the table: the largest is lag 1."""
    return f"lag {int(match[1]) + 1}"


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


def to_json(result: Identification, method: str) -> dict[str, Any]:
    """The result as a dictionary for JSON; NaN is None."""
    names = parameter_names(result.model)
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
