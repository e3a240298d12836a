"""What every method returns: a status, and an identified model with its quality."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from ._arrays import Samples, Scalar, nan_where, safe_sqrt
from ._status import Status, refused
from .models._abstract import AbstractPlant
from .models._notation import number, transfer_function, transfer_function_text
from .records._labels import unit_of
from .records._record import StepRecord, compact, predict, scaled


DETAILS = {
    # of the record
    "assumed_step": "the input was constant from its first row and taken as a step from 0 there",
    "steps_found": "number of steps in the input, 0 without an input column",
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
    # of a fit
    "steps": "iterations of the solver",
    "at_bound": "which parameters of `free` ended on a bound",
    "parameters": "how many were found from the record, a chosen order among them",
    "aicc": "Akaike's criterion, corrected",
    "noise_level": "noise that Huber's loss goes by, in output units",
    # of its standard errors
    "residual_autocorrelation": "from row to row; 0 where it is not significant",
    "residuals_correlated": "whether it is",
    "quantisation": "step between distinct values of the output, 0 where it has none",
    "quantised": "whether it has",
    "identifiable": "which parameters of `free` the record determines",
    "effective_parameters": "freedom that the residuals have lost",
    # of method="auto"
    "aicc_<method>": "Akaike's criterion of each family that was tried",
    "chosen": "which of them was kept",
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
    record: StepRecord

    def predict(self, t) -> Samples:
        """Modelled output at times `t` of the record's time axis."""
        return predict(self.model, self.record, t)

    def show_model(self, style: str = "text") -> str:
        """The transfer function as "text" or "latex", without the offset."""
        return transfer_function(self.model, style)

    def plot(self, *, title: str | None = None, size: tuple[float, float] = (8.0, 5.0)):
        """Record, model and residuals as a matplotlib figure; `size` in inches.

        `title`: instead of the transfer function and the fit.
        """
        from .plots._model import plot_model

        model = None if bool(refused(self.status)) else self.model
        return plot_model(self.record, model, title=title or _title(self), size=size)


def conclude(
    record: StepRecord,
    model: AbstractPlant,
    status: Status,
    *,
    response: Samples | None = None,
    free: tuple[str, ...] = (),
    details: dict[str, Array] | None = None,
) -> Identification:
    """Result of a method: errors over the rows from the step on, NaN where the status refuses.

    `response` is that of the model for gain 1 and offset 0 at the times of the record, where it is
    known already.
    """
    model = nan_where(refused(status), model)
    used = compact(record)
    rows = used.after_step
    if response is None:
        prediction = predict(model, used)
    else:
        prediction = scaled(model, used, response)
    residual = jnp.where(rows, used.y - prediction, 0)
    count = jnp.sum(rows)
    mean = jnp.sum(jnp.where(rows, used.y, 0)) / count
    spread = jnp.sum(jnp.where(rows, used.y - mean, 0) ** 2)
    square = residual**2
    interval = jnp.where(rows[:-1] & rows[1:], jnp.diff(used.t), 0)
    return Identification(
        model=model,
        status=status,
        rmse=safe_sqrt(jnp.sum(square) / count),
        J=jnp.sum(interval * (square[:-1] + square[1:]) / 2),
        fit_percent=100 * (1 - safe_sqrt(jnp.sum(square) / spread)),
        std=dict.fromkeys(model.parameter_names, jnp.full((), jnp.nan, residual.dtype)),
        covariance=jnp.full((len(free), len(free)), jnp.nan, residual.dtype),
        free=free,
        details={} if details is None else details,
        record=record,
    )


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
