"""How an identification ended: one status a lane, each a sentence."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool


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
    delay_dropped = "The dead time came out negative and was left out."
    at_curve_end = "A value read lies beyond the method's curve or table: its end was taken."
    extrapolated = "A value read lies outside the range that the formula was made for."
    # refusals
    nonfinite_data = "The record holds NaN or infinite values."
    time_not_increasing = "The times of the record do not increase strictly."
    too_few_samples = "The record has fewer than 8 samples from the step on."
    step_outside_record = "The step lies after the last row of the record."
    no_step = "The input does not step: its step size is 0."
    constant_output = "The output does not change after the step."
    levels_not_crossed = "The response does not cross all levels that the method reads."
    no_inflection = "The response has no usable tangent at an inflection after the step."
    beyond_first_order = "The response rises earlier than any model of this family can."
    beyond_last_order = "The response needs a higher order, or a dead time: try delay= or a fit."
    beyond_second_order = "Two lags are not enough: a dead time, a higher order or oscillation."
    invalid_times = "The characteristic times are not positive and increasing."
    invalid_moments = "The areas or moments of the response are not positive."
    not_stable = "The regression on the record's integrals gives no stable model."
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
