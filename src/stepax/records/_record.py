"""A recorded step response."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arrays import Flag, Samples, Scalar
from .._status import Status, refused
from ..models._abstract import AbstractPlant
from ._labels import Labels


MIN_SAMPLES = 8
"""Fewest rows, from the step on, that a record may have."""


def _as_samples(values: Any, name: str) -> Array:
    if not isinstance(values, jax.Array):
        try:
            values = np.asarray(values)
        except ValueError:
            raise ValueError(f"{name} of a StepRecord must be one row of numbers.") from None
    if values.dtype == bool or not (
        np.issubdtype(values.dtype, np.integer) or jnp.issubdtype(values.dtype, jnp.floating)
    ):
        raise TypeError(
            f"{name} of a StepRecord must hold real numbers, got values of type {values.dtype}."
        )
    if values.ndim != 1:
        raise ValueError(
            f"{name} of a StepRecord must be one row of numbers, got shape {values.shape};"
            " for a batch of records use jax.vmap."
        )
    if jnp.issubdtype(values.dtype, jnp.integer):
        values = values.astype(float)
    return jnp.asarray(values)


def _as_number(value: Any, name: str, dtype) -> Array:
    value = jnp.asarray(value) if isinstance(value, jax.Array) else np.asarray(value)
    if value.dtype == bool or not (
        jnp.issubdtype(value.dtype, jnp.floating) or jnp.issubdtype(value.dtype, jnp.integer)
    ):
        raise TypeError(f"{name} of a StepRecord must be a real number, got {value!r}.")
    if value.ndim != 0:
        raise ValueError(f"{name} of a StepRecord must be one number, got shape {value.shape}.")
    return jnp.asarray(value, dtype)


class StepRecord(eqx.Module):
    """One recorded step response.

    **Fields:**

    - `t`: (samples,) strictly increasing times, even or uneven; lists and integers are taken.
    - `y`: (samples,) the output.
    - `step_time`: when the input stepped, unit of `t`; inside the record.
    - `step_size`: by how much the input stepped, not 0, either sign.
    - `initial`, `final`: levels of the output before the step and after all transients. Given,
        they are held exactly; None has them estimated.
    - `labels`: names for plots and reports. `details`: facts about the reading, by name.

    What is wrong in kind (strings, complex numbers, a matrix, unequal lengths) raises a
    `TypeError` or `ValueError`; what is wrong in value is a `Status` from `identify`.
    """

    t: Samples
    y: Samples
    step_time: Scalar
    step_size: Scalar
    initial: Scalar | None
    final: Scalar | None
    labels: Labels = eqx.field(static=True)
    details: dict[str, Array]

    def __init__(
        self,
        t: Any,
        y: Any,
        step_time: Any = 0.0,
        step_size: Any = 1.0,
        initial: Any = None,
        final: Any = None,
        labels: Labels = Labels(),  # noqa: B008 (immutable)
        details: dict[str, Array] | None = None,
    ):
        t, y = _as_samples(t, "t"), _as_samples(y, "y")
        if t.shape != y.shape:
            raise ValueError(
                f"t and y of a StepRecord must have equal lengths, got {t.size} and {y.size}."
            )
        dtype = jnp.result_type(t, y)
        self.t, self.y = t.astype(dtype), y.astype(dtype)
        self.step_time = _as_number(step_time, "step_time", dtype)
        self.step_size = _as_number(step_size, "step_size", dtype)
        self.initial = None if initial is None else _as_number(initial, "initial", dtype)
        self.final = None if final is None else _as_number(final, "final", dtype)
        self.labels = labels
        self.details = {} if details is None else details

    @property
    def elapsed(self) -> Samples:
        """Times since the step."""
        return self.t - self.step_time

    @property
    def duration(self) -> Scalar:
        """Length of the record after the step."""
        return self.t[-1] - self.step_time

    @property
    def after_step(self) -> Array:
        """Which rows lie at or after the step: those that errors and fits use."""
        return self.t >= self.step_time

    @property
    def plain(self) -> "StepRecord":
        """This record without names and details: what numerical code needs."""
        return StepRecord(self.t, self.y, self.step_time, self.step_size, self.initial, self.final)


def record_status(record: StepRecord) -> Status:
    """`Status.successful`, or what is wrong with the values of a record."""
    numbers = [record.t, record.y, record.step_time, record.step_size]
    numbers += [level for level in (record.initial, record.final) if level is not None]
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in numbers]))
    t, y = record.t, record.y
    checks: list[tuple[Flag, Status]] = [
        (~finite, Status.nonfinite_data),
        (~jnp.all(jnp.diff(t) > 0), Status.time_not_increasing),
    ]
    if t.size:
        outside = (record.step_time < t[0]) | (record.step_time > t[-1])
        checks.append((outside, Status.step_outside_record))
    checks += [
        (jnp.sum(record.after_step) < MIN_SAMPLES, Status.too_few_samples),
        (record.step_size == 0, Status.no_step),
    ]
    if t.size:
        after = jnp.where(record.after_step, y, y[-1])
        checks.append((jnp.max(after) == jnp.min(after), Status.constant_output))
    status = Status.successful
    for wrong, reason in reversed(checks):
        status = Status.where(wrong, reason, status)
    return status


def usable_record(record: StepRecord) -> tuple[Status, StepRecord]:
    """Status of a record, and the record itself or, where it is refused, a harmless stand-in.

    Numerical code runs on the stand-in without a NaN or an endless loop; its result is discarded.
    """
    status = record_status(record)
    bad = refused(status)
    count = max(record.t.size, MIN_SAMPLES)
    dtype = record.t.dtype
    t = jnp.arange(count, dtype=dtype)
    stand_in = StepRecord(
        t,
        1 - jnp.exp(-5 * t / count),
        jnp.zeros((), dtype),
        jnp.ones((), dtype),
        None if record.initial is None else jnp.zeros((), dtype),
        None if record.final is None else jnp.ones((), dtype),
    )
    if record.t.size < MIN_SAMPLES:
        return status, stand_in
    pick = lambda a, b: jnp.where(bad, a, b)  # noqa: E731
    return status, jax.tree.map(pick, stand_in, record.plain)


# How the input moves a plant: the one place that knows it is a step


def input_response(record: StepRecord, plant: AbstractPlant, t: Any = None) -> Samples:
    """Response to the record's input for gain 1 and offset 0, per `step_size` of input.

    At the record's rows, or at times `t` of its axis. g(t - step_time - delay).
    """
    elapsed = record.elapsed if t is None else t - record.step_time
    return plant.unit_response(elapsed - plant.delay)


def input_response_slopes(record: StepRecord, plant: AbstractPlant) -> tuple[Samples, Samples]:
    """Derivatives of `input_response` in the dead time, and in the logarithm of the unit of time.

    Both move the response along its slope in time, which is found once.
    """
    since = record.elapsed - plant.delay
    slope = jax.jvp(plant.unit_response, (since,), (jnp.ones_like(since),))[1]
    slope = jax.lax.optimization_barrier(slope)
    return -slope, -since * slope


def predict(model: AbstractPlant, record: StepRecord, t: Any = None) -> Samples:
    """Output of a model, offset + step_size gain g, at the record's rows or at times `t`."""
    return scaled(model, record, input_response(record, model, t))


def scaled(model: AbstractPlant, record: StepRecord, response: Samples) -> Samples:
    """The same for a response that is known already."""
    return model.offset + record.step_size * model.gain * response
