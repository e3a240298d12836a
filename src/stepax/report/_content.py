"""What a report says of a result, as plain data; host code."""

import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from .._result import Identification
from .._status import Status, status_name
from ..models._abstract import AbstractPlant
from ..models._notation import number
from ..records._labels import unit_of


def parameters(model: AbstractPlant) -> dict[str, Any]:
    """Parameters by name, its own first: numbers, `n` a whole one for a chain, lists of lags."""
    common = ["gain", "offset", "delay"]
    own = [name for name in model.__dataclass_fields__ if name not in common]
    return {name: np.asarray(getattr(model, name)).tolist() for name in own + common}


def parameter_rows(result: Identification) -> Iterator[tuple[str, str, float, float]]:
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


POOR_FIT = 80.0
"""Fit in percent below which a model is reported with a warning."""


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
        steps = "" if width is None else f", in steps of {with_unit(width, unit)}"
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


def with_unit(x, unit: str) -> str:
    """A number and its unit."""
    return f"{number(x)} {unit}".rstrip()


def like(x: float, std: float) -> str:
    """A number to the second digit of its standard error, at most 6 significant ones."""
    size = math.floor(math.log10(abs(x))) if x else 0
    return number(x, min(6, max(2, size - math.floor(math.log10(std)) + 2)))


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
