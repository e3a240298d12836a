"""What every method returns: a status, and an identified model with its quality."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ._models import AbstractPlant
from ._types import Flag, Samples, Scalar


if TYPE_CHECKING:
    from ._record import StepRecord


class Status(eqx.Enumeration):
    """How an identification ended; each value is one sentence.

    `successful`, then warnings, which keep their values, then refusals (from `nonfinite_data`
    on), whose parameters are NaN. In a batch there is one status per lane.
    """

    successful = "The identification succeeded."
    # warnings
    at_equal_lags = "The plant has equal lags within the tolerance: r is at that end of its range."
    at_first_order = "The plant is of first order within the tolerance: r is at that end."
    at_bound = "A parameter lies on a bound of its range; its standard error is not known."
    not_settled = "The record ends before the plant has settled: the gain is extrapolated."
    not_identifiable = "The record does not determine every parameter: see the standard errors."
    # refusals
    nonfinite_data = "The record holds NaN or infinite values."
    time_not_increasing = "The times of the record do not increase strictly."
    too_few_samples = "The record has fewer than 8 samples from the step on."
    step_outside_record = "The step lies outside the times of the record."
    no_step = "The input does not step: its step size is 0."
    constant_output = "The output does not change after the step."
    levels_not_crossed = "The response does not cross all levels that the method reads."
    no_inflection = "The response has no usable tangent at an inflection after the step."
    beyond_first_order = "The response rises earlier than any model of this family can."
    beyond_last_order = "The response needs a higher order, or a dead time: try delay= or a fit."
    invalid_times = "The characteristic times are not positive and increasing."
    not_converged = "The least-squares iteration did not converge."


def refused(status: Status) -> Bool[Array, "..."]:
    """Whether a status is a refusal (its parameters are NaN), also traced and in a batch."""
    return jnp.asarray(status._value >= Status.nonfinite_data._value)


def first_problem(*statuses: Status) -> Status:
    """The first refusal among statuses, else the first warning, else `successful`."""
    result = Status.successful
    for status in reversed(statuses):
        worse = refused(status) | (~refused(result) & (status != Status.successful))
        result = Status.where(worse, status, result)
    return result


def status_name(status: Status) -> str:
    """Identifier of one concrete status, as it stands in files: `successful`, `at_bound`, ..."""
    return list(Status._name_to_item)[int(status._value)]


def nan_where(condition: Flag, tree: Any) -> Any:
    """`tree` with its real leaves NaN where `condition` holds."""
    return jax.tree.map(
        lambda x: jnp.where(condition, jnp.nan, x) if eqx.is_inexact_array(x) else x, tree
    )


class Identification(eqx.Module):
    """An identified model, how good it is and how certain.

    - `model`: the plant. `status`: how it went. `record`: what it was identified from.
    - `rmse` (output units), `J` (integral of the squared error by the trapezoid rule, output unit
        squared times time), `fit_percent` (100 (1 - |y - yhat| / |y - mean y|), 2-norm): over all
        rows from the step on.
    - `std`: standard error by parameter name; 0 if the parameter was fixed, NaN where the method
        has none. `covariance`: of the parameters named in `free`, in that order.
    - `details`: further arrays by name.
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
    record: "StepRecord"

    def predict(self, t) -> Samples:
        """Modelled output at times `t` of the record's time axis."""
        return predict(self.model, self.record, t)

    def show_model(self, style: str = "text") -> str:
        """The transfer function as "text" or "latex", without the offset."""
        from ._notation import transfer_function

        return transfer_function(self.model, style)

    def plot(self, **options):
        """Record, model and residuals as a matplotlib figure; see `stepax.plot_identification`."""
        from ._plot import plot_identification

        return plot_identification(self, **options)


def predict(model: AbstractPlant, record: "StepRecord", t) -> Samples:
    """offset + step_size gain g(t - step_time - delay)."""
    return _scaled(model, record, model.unit_response(t - record.step_time - model.delay))


def _scaled(model: AbstractPlant, record: "StepRecord", response: Samples) -> Samples:
    return model.offset + record.step_size * model.gain * response


def conclude(
    record: "StepRecord",
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
    rows = record.after_step
    if response is None:
        prediction = predict(model, record, record.t)
    else:
        prediction = _scaled(model, record, response)
    residual = jnp.where(rows, record.y - prediction, 0)
    count = jnp.sum(rows)
    mean = jnp.sum(jnp.where(rows, record.y, 0)) / count
    spread = jnp.sum(jnp.where(rows, record.y - mean, 0) ** 2)
    square = residual**2
    interval = jnp.where(rows[:-1], jnp.diff(record.t), 0)
    return Identification(
        model=model,
        status=status,
        rmse=safe_sqrt(jnp.sum(square) / count),
        J=jnp.sum(interval * (square[:-1] + square[1:]) / 2),
        fit_percent=100 * (1 - safe_sqrt(jnp.sum(square) / spread)),
        std=dict.fromkeys(parameter_names(model), jnp.full((), jnp.nan, residual.dtype)),
        covariance=jnp.full((len(free), len(free)), jnp.nan, residual.dtype),
        free=free,
        details={} if details is None else details,
        record=record,
    )


def parameter_names(model: AbstractPlant) -> list[str]:
    """Names of a model's real parameters: its own first, then gain, offset and delay."""
    common = ["gain", "offset", "delay"]
    own = [name for name in model.__dataclass_fields__ if name not in common]
    return [name for name in own if eqx.is_inexact_array(getattr(model, name))] + common


def safe_sqrt(x: Array) -> Array:
    """Square root whose derivative at 0 is 0."""
    return jnp.where(x == 0, 0, jnp.sqrt(jnp.where(x == 0, 1, x)))
