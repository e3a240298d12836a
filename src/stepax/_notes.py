"""What to mind about a result, in sentences; host code."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ._result import Identification
from ._status import Status
from .models._notation import number
from .records._labels import Units


POOR_FIT = 80.0
"""Fit in percent below which a model is reported with a warning."""
# Residuals of a fifth of the output's own spread: noise of a usable record stays well below that, a
# model that misses the shape does not. `test_what_is_uncertain_is_named` would notice.


def notes_of(result: Identification, step: int | None = None) -> list[str]:
    """What a user should know about a result, each in one sentence."""
    details = {**result.record.details, **result.details}
    sentences = []
    if result.status != Status.successful:
        sentences.append(Status[result.status])
    if float(result.fit_percent) < POOR_FIT:
        sentences.append(
            f"The fit is only {number(result.fit_percent)} %: look at the plot before using it."
        )
    sentences += _about_parameters(result, details)
    sentences += _about_the_step(details, step)
    sentences += _about_residuals(details, Units.of(result.record.labels).output)
    return list(dict.fromkeys(sentences))


def _about_parameters(result: Identification, details: dict[str, Any]) -> Iterator[str]:
    """Parameters that the record does not determine, or that ended on a bound."""

    def named(detail: str, wanted: bool) -> list[str]:
        flags = np.asarray(details.get(detail, []), bool)  # empty where a method has no errors
        pairs = zip(free_names(result), flags, strict=False)
        return [shown for (_, shown), flag in pairs if flag == wanted]

    bounded = named("at_bound", True)
    vague = [name for name in named("identifiable", False) if name not in bounded]
    if vague:
        yield f"Not determined by this record: {', '.join(vague)}."
    if "delay" in bounded:
        yield "The dead time is at the end of its range and has no standard error."
        bounded.remove("delay")
    if bounded:
        yield f"At the end of its range: {', '.join(bounded)}."


def _about_the_step(details: dict[str, Any], step: int | None) -> Iterator[str]:
    """Where the step was found, or what was assumed."""
    found = details.get("steps_found")  # a record from arrays says nothing of it
    if found is not None and int(found) == 0:
        yield (
            "No input column: the step is taken to be at t = 0 with size 1, and gain and dead time"
            " refer to that."
        )
    if _holds(details, "assumed_step"):
        yield "The input is constant from its first row: taken as a step from 0 at that row."
    if found is not None and int(found) > 1:
        chosen = 1 if step is None else step if step > 0 else int(found) + 1 + step
        choose = ": choose with --step" if step is None else ""
        yield f"{int(found)} steps in the input; this is step {chosen}{choose}."


def _about_residuals(details: dict[str, Any], unit: str) -> Iterator[str]:
    """Quantised data and correlated residuals."""
    if _holds(details, "quantised"):
        width = details.get("quantisation")
        steps = "" if width is None else f", in steps of {with_unit(width, unit)}"
        yield f"The output is quantised{steps}."
    if _holds(details, "residuals_correlated"):
        lag = details.get("residual_autocorrelation")
        amount = "" if lag is None else f" (autocorrelation {number(lag, 2)} from row to row)"
        yield (
            f"The residuals are correlated{amount}: slow disturbances, or a model that misses part"
            " of the response. The standard errors allow for it as first-order noise; slower"
            " disturbances still make them too small."
        )


def _holds(details: dict[str, Any], name: str) -> bool:
    return bool(np.any(np.asarray(details.get(name, False))))


def free_names(result: Identification) -> list[tuple[str, str]]:
    """Free parameters: the field, and the name that a report shows; the third lag is "lag 3"."""
    free = [scalar for scalar in result.model.scalars if scalar.label in result.free]
    return [(x.name, x.name if x.place is None else f"lag {x.place + 1}") for x in free]


def with_unit(x, unit: str) -> str:
    """A number and its unit."""
    return f"{number(x)} {unit}".rstrip()
