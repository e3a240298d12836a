"""What to mind about a result and what to do about it, in sentences; host code."""

import re
from collections.abc import Iterator
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ._status import Status, status_name
from .models._notation import number
from .records._labels import Units


POOR_FIT = 80.0
"""Fit in percent below which a model is reported with a warning."""
# Residuals of a fifth of the output's own spread: noise of a usable record stays well below that, a
# model that misses the shape does not. `test_what_is_uncertain_is_named` would notice.


@runtime_checkable
class Identified(Protocol):
    """What an `Identification` tells of itself to those who put it into words."""

    model: Any
    status: Any
    method: Any
    rmse: Any
    J: Any
    fit_percent: Any
    std: Any
    free: Any
    details: Any
    record: Any


Note = tuple[str, str]
"""What to mind, and what to do about it; the latter is empty where the former says it."""


def notes_of(result: Identified, step: int | None = None) -> list[str]:
    """What a user should know about a result, each in one sentence."""
    return [sentence for sentence, _ in advice_of(result, step)]


def advice_of(result: Identified, step: int | None = None) -> list[Note]:
    """The same, each with what to do about it."""
    details = {**result.record.details, **result.details}
    units = Units.of(result.record.labels)
    notes: list[Note] = []
    if result.status != Status.successful:
        notes.append((Status[result.status], ADVICE.get(status_name(result.status), "")))
    fit = details.get("fit_of_the_rest", result.fit_percent)
    if float(fit) < POOR_FIT:
        sentence = f"The fit is only {number(fit)} %: look at the plot before using it."
        notes.append((sentence, "Compare all methods; another family may follow the record."))
    notes += _about_parameters(result, details)
    if _holds(details, "unsettled") and not result.model.settles:  # it was not asked for
        sentence = "The output still moves steadily at the end: it is taken for an integrator's."
        notes.append((sentence, "If the plant settles, record until it rests: then it has a gain."))
    notes += _about_the_step(result, details, units, step)
    notes += _about_the_rows(details, units.time)
    notes += _about_residuals(result, details, units.output)
    return list(dict(notes).items())


KEYWORDS = {"from": "begin=", "to": "end=", "whole": "whole=True", "all-rows": "all_rows=True"}
"""Options of the command that are not called in Python as they are there."""


def in_python(sentence: str) -> str:
    """A sentence with keywords in place of options of the command: step_time= for --step-time."""

    def keyword(option: re.Match[str]) -> str:
        return KEYWORDS.get(option[1], option[1].replace("-", "_") + "=")

    return re.sub("--([a-z]+(?:-[a-z]+)*)", keyword, sentence)


ADVICE = {
    "at_equal_lags": "Equal lags describe the plant: nothing needs to be done.",
    "at_first_order": "One lag is enough: take a first-order model (fopdt_fit).",
    "at_bound": "Take a simpler model, or hold that parameter where it is known.",
    "not_settled": "Record until the output rests, or give the final level if it is known.",
    "not_identifiable": "Hold what is known (--fixed), or take a model of fewer parameters.",
    "delay_dropped": "Take a model of higher order: the plant answers without a dead time.",
    "at_curve_end": "Mistrust the numbers read; a fit (identify without a method) needs no chart.",
    "extrapolated": "Use a method that was made for this response, or a fit.",
    "nonfinite_data": "Leave out or fill the rows without a number.",
    "time_not_increasing": "Sort the rows by time and leave out repeated ones.",
    "too_few_samples": "Record more rows after the step, or sample faster.",
    "step_outside_record": "Tell the time of the step on the record's own axis of time.",
    "no_step": "Tell the size of the step.",
    "constant_output": "Look whether the right column was named for the output.",
}
"""What to do about a status; where its sentence says all, or another method is the answer, none."""


def _about_parameters(result: Identified, details: dict[str, Any]) -> Iterator[Note]:
    """Parameters that the record does not determine, or that ended on a bound."""

    def named(detail: str, wanted: bool) -> list[str]:
        flags = np.asarray(details.get(detail, []), bool)  # empty where a method has no errors
        pairs = zip(free_names(result), flags, strict=False)
        return [shown for (_, shown), flag in pairs if flag == wanted]

    bounded = named("at_bound", True)
    vague = [name for name in named("identifiable", False) if name not in bounded]
    if vague:
        sentence = f"Not determined by this record: {', '.join(vague)}."
        yield sentence, "Hold what is known (--fixed), or take a model of fewer parameters."
    if "delay" in bounded:
        sentence = "The dead time is at the end of its range and has no standard error."
        yield sentence, "A plant without dead time: hold it (--fixed delay) for honest intervals."
        bounded.remove("delay")
    if bounded:
        yield f"At the end of its range: {', '.join(bounded)}.", ADVICE["at_bound"]


def _about_the_step(
    result: Identified, details: dict[str, Any], units: Units, step: int | None
) -> Iterator[Note]:
    """Where the step was found, or what was assumed; whether it began at rest."""
    found = details.get("steps_found")  # a record from arrays says nothing of it
    if _holds(details, "input_without_step"):
        sentence = "The column that is left has no step in it and is not taken for the input."
        yield sentence, "Name the input, or tell the step with --step-time and --step-size."
    if found is not None and int(found) == 0 and not _holds(details, "step_told"):
        yield (
            "No input column: the step is taken to be at t = 0 with size 1, and gain and dead time"
            " refer to that; --step-time and --step-size tell another.",
            "",
        )
    if _holds(details, "assumed_step") and not _holds(details, "step_told"):
        sentence = "The input is constant from its first row: taken as a step from 0 at that row."
        yield sentence, "If the step came at another time, tell it with --step-time."
    if found is not None and int(found) > 1:
        asked = 1 if step is None else step if step > 0 else int(found) + 1 + step
        chosen = int(details.get("step_taken", asked))
        whole = "; --whole uses the whole log with its input"
        choose = f": choose with --step{whole}" if step is None and chosen == 1 else whole
        yield f"{int(found)} steps in the input; this is step {chosen}{choose}.", ""
    if _holds(details, "whole_by_itself"):
        yield (
            "After no step of the input does the output come to rest: the whole log was used with"
            " its input; --step takes one step.",
            "",
        )
    if _holds(details, "drift"):
        known = f"{units.output}/{units.time}" if units.output and units.time else ""
        slope = with_unit(details["drift"], known or "per unit of time")
        yield (
            f"The output still moves when the step comes, by {slope}: the model takes that for a"
            " part of the response. Take a step that begins at rest (--step), or wait longer"
            " before it.",
            "",
        )
    if _holds(details, "begins_late") and result.record.initial is None:
        yield (
            f"The record begins {with_unit(details['begins_late'], units.time)} after the step:"
            " the level before it is extrapolated. Give it with --initial if it is known.",
            "",
        )


def _about_the_rows(details: dict[str, Any], unit: str) -> Iterator[Note]:
    """What was done with the rows of a log."""
    if _holds(details, "time_stamps"):
        began = details.get("began")
        first = "" if began is None else f", {stamp_of(float(began))}"
        yield f"The time stamps became seconds since the first row{first}.", ""
    if count := _count(details, "rows_left_out"):
        yield f"{_rows(count)} without a value {_are(count)} left out.", ""
    if count := _count(details, "rows_averaged"):
        sentence = (
            f"{_rows(count)} share their time stamp with a neighbour: such rows are averaged."
        )
        yield sentence, "Finer time stamps make the dead time more certain."
    if count := _count(details, "rows_before_rest"):
        yield (
            f"{_rows(count)} before the step {_are(count)} left out: the output was not yet at"
            " rest in them.",
            "",
        )
    if count := _count(details, "rows_thinned"):
        yield (
            f"{_rows(count)} are averaged over equal spans of"
            f" {with_unit(details['span_of_average'], unit)}, and RMSE and fit are those of the"
            " means; --all-rows uses each row.",
            "",
        )
    if _holds(details, "thinned_coarsely"):
        yield (
            "These spans are long beside the response: cut the log with --from and --to for a"
            " finer model.",
            "",
        )


def _about_residuals(result: Identified, details: dict[str, Any], unit: str) -> Iterator[Note]:
    """Glitches, quantised data and correlated residuals."""
    if count := _count(details, "glitches"):
        yield (
            f"{_rows(count)} {'stands' if count == 1 else 'stand'} out of the rest as glitches do:"
            " Huber's loss bounds their pull on the model. Without them the fit is"
            f" {number(details['fit_of_the_rest'])} %.",
            "Look at these rows in the plot; --loss squares keeps them in full.",
        )
    phi = float(details.get("residual_autocorrelation", 0.0))
    # What a row adds to what the one before tells: beyond 0.58 of a step, half a step of noise
    # beside the error of rounding, noise makes rounding one more white noise.
    noise = float(result.rmse) * max(0.0, 1 - phi**2) ** 0.5
    width = float(details.get("quantisation", np.nan))
    if _holds(details, "quantised") and not noise > 0.58 * width:
        steps = f" in steps of {with_unit(width, unit)}" if width == width else ""
        yield (
            f"The output is quantised{steps}, which its noise does not hide: the intervals leave"
            " the error of rounding out.",
            "Take a larger step of the input, or more digits of the sensor.",
        )
    if _holds(details, "residuals_correlated"):
        lag = details.get("residual_autocorrelation")
        amount = "" if lag is None else f" (autocorrelation {number(lag, 2)} from row to row)"
        yield (
            f"The residuals are correlated{amount}: slow disturbances, or a model that misses part"
            " of the response. The standard errors allow for it as first-order noise; slower"
            " disturbances still make them too small.",
            "See the residuals: a pattern just after the step asks for another model (compare), a"
            " slow drift for a second run.",
        )


def stamp_of(seconds: float) -> str:
    """A date and time of day from seconds since 1970, to the millisecond where there are any."""
    text = str(np.datetime64(round(seconds * 1000), "ms")).replace("T", " ")
    return text.removesuffix(".000")


def _count(details: dict[str, Any], name: str) -> int:
    return int(details.get(name, 0))


def _rows(count: int) -> str:
    return "1 row" if count == 1 else f"{count} rows"


def _are(count: int) -> str:
    return "is" if count == 1 else "are"


def _holds(details: dict[str, Any], name: str) -> bool:
    return bool(np.any(np.asarray(details.get(name, False))))


def free_names(result: Identified) -> list[tuple[str, str]]:
    """Free parameters: the field, and the name that a report shows; the third lag is "lag 3"."""
    free = [scalar for scalar in result.model.scalars if scalar.label in result.free]
    return [(x.name, x.name if x.place is None else f"lag {x.place + 1}") for x in free]


def with_unit(x, unit: str) -> str:
    """A number and its unit."""
    return f"{number(x)} {unit}".rstrip()
