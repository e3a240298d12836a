"""What every method returns: a status, and an identified model with its quality."""

import dataclasses
import json
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ._arrays import Samples, Scalar, nan_where, safe_sqrt
from ._compilation import is_traced
from ._notes import in_python, notes_of
from ._programs import Signature
from ._status import Status, refused, status_name
from .models._abstract import AbstractPlant
from .models._notation import number, transfer_function, transfer_function_text
from .records._abstract import AbstractRecord
from .records._labels import unit_of
from .records._record import compact, predict, scaled
from .summary._intervals import LEVEL, interval
from .summary._json import to_json
from .summary._layout import as_html, as_text


DETAILS = {
    # of the record
    "assumed_step": "the input was constant from its first row and taken as a step from 0 there",
    "steps_found": "number of steps in the input, 0 without an input column",
    # of a record from a picture: standard deviations that all rows share
    "stroke": "of a level row, in output units, the place of the axes included",
    "stroke_time": "of the place of the axis of time, in units of time",
    "scale_output": "of the scale of the output, relative",
    "scale_time": "of the scale of time, relative",
    "step_taken": "which of them, from 1",
    "step_told": "time or size of the step were given",
    "input_without_step": "the column left for the input has no step and is not used",
    "drift": "slope of the output before the step, where it still moves",
    "whole": "the whole log is the record, with its input",
    "whole_by_itself": "that was not asked for: after no step does the output come to rest",
    "begins_late": "time from the step to the first row, where that comes later",
    "rows_used": "how many rows of the file are the record",
    "rows_before_rest": "rows before the step that were left out, the plant not being at rest",
    "rows_left_out": "rows left out for want of a value",
    "rows_averaged": "rows that shared their time stamp with a neighbour",
    "time_stamps": "the times were dates or clock times",
    "began": "date of the first row, in seconds since 1970",
    "rows_thinned": "rows of a long record before they were averaged over spans of time",
    "span_of_average": "length of such a span",
    "thinned_coarsely": "whether few spans cover the response",
    # what point methods read, times from the step; levels in percent as t33, t35_3
    "t<level>": "time at which the response reaches a level",
    "Tu": "time from the step to where the tangent leaves the initial level",
    "Tg": "time from there to where the tangent reaches the final level",
    "t_inflection": "time of the inflection",
    "t_read": "time of the height that a chart asks for",
    "y_read": "height there, as a share of the change",
    "t_i": "time of the inflection's height by Strejc's table",
    "y_i": "that height, as a share of the change",
    "raw_delay": "dead time as computed, before a negative one was left out",
    "area": "area above the response, A0",
    "area_below": "area below the response up to A0",
    "mean": "first moment of the impulse response, from the step",
    "variance": "second central moment of the impulse response",
    "skewness": "its third moment over the standard deviation cubed",
    "order": "order before it was rounded",
    "period": "period of the oscillation",
    "lobes": "extrema of the integral signal that count, two a period",
    "oscillatory": "whether the oscillatory branch was taken",
    "square": "sum of the squared errors over all rows that count, those before the step too",
    # of a fit
    "steps": "iterations of the solver",
    "at_bound": "which parameters of `free` ended on a bound",
    "parameters": "how many were found from the record, a chosen order among them",
    "aicc": "Akaike's criterion, corrected",
    "trend": "slope of a linear drift of the output, where one was sought",
    "own_motion": "numbers of `model.own_motions` that a state other than rest makes",
    "noise_level": "noise that Huber's loss goes by, in output units",
    "degrees_of_freedom": "rows less parameters; of correlated residuals the rows that tell more",
    # of its standard errors
    "residual_autocorrelation": "from row to row; 0 where it is not significant",
    "residuals_correlated": "whether it is",
    "quantisation": "step between distinct values of the output, 0 where it has none",
    "quantised": "whether it has",
    "identifiable": "which parameters of `free` the record determines",
    "effective_parameters": "freedom that the residuals have lost",
    # of method="auto"
    "aicc_<method>": "Akaike's criterion of each family that was tried",
    "glitches": "rows that stand out, where Huber's loss was kept for them",
    "fit_of_the_rest": "fit in percent over the other rows from the step on",
    "wrong_way": "sign in the record: it moves away from its end first",
    "lone_overshoot": "sign in the record: an overshoot that is no oscillation",
    "unsettled": "sign in the record: it ends as a ramp",
}
"""Every key of `Identification.details`, and what stands there."""


class Identification(eqx.Module):
    """An identified model, how good it is and how certain.

    - `model`: the plant. `status`: how it went. `record`: what it was identified from.
    - `rmse` (output units), `J` (integral of the squared error by the trapezoid rule, output unit
        squared times time), `fit_percent` (100 (1 - |y - yhat| / |y - mean y|), 2-norm): over all
        rows from the step on.
    - `std`: standard error by parameter name; 0 if the parameter was fixed, NaN where the method
        has none. `covariance`: of the parameters named in `free`, in that order.
    - `details`: further arrays by name; `DETAILS` lists them.
    - `method`: name of the method; of "auto" the one that was kept.

    A result speaks: `print(result)` and notebooks show `summary()`. One that holds tracers or a
    batch shows its PyTree.
    """

    model: Any  # a plant, whose class depends on the method
    status: Status
    rmse: Scalar
    J: Scalar
    fit_percent: Scalar
    std: dict[str, Array]
    covariance: Array
    free: tuple[str, ...] = eqx.field(static=True)
    details: dict[str, Array]
    record: AbstractRecord
    method: str = eqx.field(static=True, default="")

    def predict(self, t) -> Samples:
        """Modelled output at times `t` of the record's time axis."""
        return predict(self.model, self.record, t)

    def show_model(self, style: str = "text") -> str:
        """The transfer function, without the offset: as "text" or "latex", or as code to paste.

        "matlab": for the Control System Toolbox, with the dead time; "python-control": for that
        package, the dead time as a Pade approximation of order 3.
        """
        return transfer_function(self.model, style)

    def summary(self) -> str:
        """What the command prints: record, model, parameters with intervals, quality and notes.

        Notes name keywords where those of the command name options.
        """
        return as_text(self)

    @property
    def notes(self) -> list[str]:
        """What to mind about this result, each in one sentence."""
        return [in_python(note) for note in notes_of(self)]

    def interval(self, name: str, level: float = LEVEL) -> tuple:
        """Lower and upper end of a parameter's confidence interval, by Student's t.

        `name`: as in `.std`, or one lag of several, such as "lags[1]". A parameter that was fixed
        has an interval of no width; NaN where the method has no standard error.
        """
        return interval(self, name, level)

    def to_json(self) -> str:
        """All numbers, intervals and notes as JSON text, as the command's `--json` writes them."""
        return json.dumps(to_json(self), indent=2, ensure_ascii=False, allow_nan=False)

    def __repr__(self) -> str:
        if not _is_one(self):
            return eqx.tree_pformat(self)
        about = ", ".join(filter(None, [self.method, f"fit {number(self.fit_percent)} %"]))
        return f"Identification({self.model!r}, {about}, {status_name(self.status)})"

    def __str__(self) -> str:
        return self.summary() if _is_one(self) else eqx.tree_pformat(self)

    def _repr_html_(self) -> str | None:
        return as_html(self) if _is_one(self) else None

    def report(self, path: str | PathLike) -> None:
        """Write a page to hand over: one HTML file with pictures, parameters, notes and code.

        It needs nothing beside it, neither a network nor scripts. With the extra `stepax[app]` its
        pictures have zoom and hover on a screen. `path` must end in .html.
        """
        from .report._files import write_page
        from .report._html import html
        from .report._pages import result_page

        write_page(html(result_page(self)), Path(path))

    def plot(self, *, title: str | None = None, size: tuple[float, float] = (8.0, 5.0)):
        """Record, model and residuals as a matplotlib figure; `size` in inches.

        `title`: instead of the transfer function and the fit.
        """
        from .plots._model import plot_model

        model = None if bool(refused(self.status)) else self.model
        return plot_model(self.record, model, title=title or _title(self), size=size)


class Quality(NamedTuple):
    """How well a model describes a record: `square`, the sum of the squared errors, in all rows."""

    rmse: Scalar
    J: Scalar
    fit_percent: Scalar
    square: Scalar


def conclude(
    record: AbstractRecord,
    model: AbstractPlant,
    status: Status,
    *,
    response: Samples | None = None,
    free: tuple[str, ...] = (),
    details: dict[str, Array] | None = None,
    judge: bool = True,
) -> Identification:
    """Result of a method: errors over the rows from the step on, NaN where the status refuses.

    `response` is that of the model for gain 1 and offset 0 at the times of the record, where it is
    known already. `judge=False`: without errors, for `judged`.
    """
    model = nan_where(refused(status), model)
    unknown = jnp.full((), jnp.nan, record.y.dtype)
    result = Identification(
        model=model,
        status=status,
        rmse=unknown,
        J=unknown,
        fit_percent=unknown,
        std=dict.fromkeys(model.parameter_names, unknown),
        covariance=jnp.full((len(free), len(free)), jnp.nan, record.y.dtype),
        free=free,
        details={} if details is None else details,
        record=record,
    )
    return _with(_quality(compact(record), model, response), result) if judge else result


def judged(record: AbstractRecord, results: Sequence[Identification]) -> list[Identification]:
    """Results of one record, with the errors of those that have none yet.

    Models of one class are one batch: their response is traced and compiled once.
    """
    used, done = compact(record), list(results)
    alike: dict[Signature, list[int]] = {}
    for place, result in enumerate(results):
        if "square" not in result.details:
            alike.setdefault(Signature(result.model), []).append(place)
    for form, places in alike.items():
        models = [eqx.filter(results[place].model, eqx.is_array) for place in places]
        batch = [jnp.stack(leaves) for leaves in zip(*map(jax.tree.leaves, models), strict=True)]
        found = jax.vmap(lambda *x, form=form: _quality(used, form.arguments(x)))(*batch)
        for k, place in enumerate(places):
            done[place] = _with(Quality(*(x[k] for x in found)), results[place])
    return done


def _with(quality: Quality, result: Identification) -> Identification:
    rmse, J, fit_percent, square = quality
    details = result.details | {"square": square}
    return dataclasses.replace(result, rmse=rmse, J=J, fit_percent=fit_percent, details=details)


def _quality(
    used: AbstractRecord, model: AbstractPlant, response: Samples | None = None
) -> Quality:
    """Of a compact record."""
    known = response is not None
    prediction = scaled(model, used, response) if known else predict(model, used)
    counts = used.present if used.weights is None else used.present & (used.weights > 0)
    error = jnp.where(counts, used.y - prediction, 0)
    rows = used.after_step
    count = jnp.sum(rows)
    mean = jnp.sum(jnp.where(rows, used.y, 0)) / count
    spread = jnp.sum(jnp.where(rows, used.y - mean, 0) ** 2)
    square = jnp.where(rows, error, 0) ** 2
    interval = jnp.where(rows[:-1] & rows[1:], jnp.diff(used.t), 0)
    return Quality(
        rmse=safe_sqrt(jnp.sum(square) / count),
        J=jnp.sum(interval * (square[:-1] + square[1:]) / 2),
        fit_percent=100 * (1 - safe_sqrt(jnp.sum(square) / spread)),
        square=jnp.sum(error**2),
    )


def _is_one(result: Identification) -> bool:
    """Whether a result is that of one record and concrete: neither a batch nor being traced."""
    numbers = (result.rmse, result.J, result.fit_percent, result.status._value)
    arrays = all(isinstance(x, jax.Array | np.ndarray) and x.ndim == 0 for x in numbers)
    return arrays and not is_traced(result)


def _title(result: Identification) -> str:
    """Transfer function and fit; where the method refused, why."""
    if bool(refused(result.status)):
        return Status[result.status]
    unit = unit_of(result.record.labels.output)
    rmse = f"RMSE {number(result.rmse, 3)} {unit}".rstrip()
    text = _wrapped(f"G(s) = {transfer_function_text(result.model)}")
    return f"{text}\n{type(result.model).__name__}, fit {number(result.fit_percent)} %, {rmse}"


def _wrapped(text: str, width: int = 85) -> str:
    """A transfer function on as many lines as it needs, broken between factors."""
    lines = [""]
    for factor in text.replace(")(", ")\n(").split("\n"):
        if len(lines[-1]) + len(factor) > width:
            lines.append("        ")
        lines[-1] += factor
    return "\n".join(lines)
