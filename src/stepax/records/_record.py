"""A recorded step response."""

from collections.abc import Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from .._arrays import Count, Flag, Samples, Scalar
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


def _as_rows(rows: Any, size: int) -> Array:
    rows = rows if isinstance(rows, jax.Array) else np.asarray(rows)
    if not jnp.issubdtype(rows.dtype, jnp.integer) or rows.ndim:
        raise TypeError(f"rows of a StepRecord must be a whole number, got {rows!r}.")
    if not isinstance(rows, Tracer) and not 0 <= int(rows) <= size:
        raise ValueError(f"rows of a StepRecord must lie in 0..{size}, got {rows}.")
    return jnp.asarray(rows)


class StepRecord(eqx.Module):
    """One recorded step response.

    **Fields:**

    - `t`: (samples,) strictly increasing times, even or uneven; lists and integers are taken.
    - `y`: (samples,) the output.
    - `step_time`: when the input stepped, unit of `t`; not after the last row. Before the first,
        no row tells the level before the step: give `initial` if it is known.
    - `step_size`: by how much the input stepped, not 0, either sign.
    - `initial`, `final`: levels of the output before the step and after all transients. Given,
        they are held exactly; None has them estimated.
    - `labels`: names for plots and reports. `details`: facts about the reading, by name.
    - `rows`: how many rows count, from the first on; the rest is padding that nothing reads. A
        whole number, or a traced one; None: all. `stack_records` makes such records.
    - `weights`: (samples,) per row, used by every fit unless it is given its own. A row of weight 0
        is left out of everything, also where it holds NaN. None: all count the same.

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
    rows: Count | None
    weights: Samples | None

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
        *,
        rows: Any = None,
        weights: Any = None,
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
        self.rows = None if rows is None else _as_rows(rows, t.size)
        self.weights = None if weights is None else _as_samples(weights, "weights").astype(dtype)
        if self.weights is not None and self.weights.shape != t.shape:
            raise ValueError(
                f"weights of a StepRecord need one value per row, {t.size},"
                f" got {self.weights.size}."
            )

    @property
    def count(self) -> Count | int:
        """Number of rows that count; of a compact record (see `compact`)."""
        return self.t.size if self.rows is None else self.rows

    @property
    def present(self) -> Array:
        """Which rows count, of a compact record: the first ones."""
        if self.rows is None:  # a constant, which costs nothing
            return jnp.ones(self.t.size, bool)
        return jnp.arange(self.t.size) < self.rows

    @property
    def last(self) -> Count | int:
        """Place of the last row that counts, of a compact record."""
        return self.count - 1

    @property
    def elapsed(self) -> Samples:
        """Times since the step."""
        return self.t - self.step_time

    @property
    def duration(self) -> Scalar:
        """Length of the record after the step."""
        return self.t[self.last] - self.step_time

    @property
    def after_step(self) -> Array:
        """Which rows lie at or after the step: those that errors and fits use."""
        return (self.t >= self.step_time) & self.present

    @property
    def plain(self) -> "StepRecord":
        """This record without names and details: what numerical code needs."""
        return StepRecord(
            self.t,
            self.y,
            self.step_time,
            self.step_size,
            self.initial,
            self.final,
            rows=self.rows,
            weights=self.weights,
        )


def with_weights(record: StepRecord, weights: Any) -> StepRecord:
    """A record with other weights than its own: per row, or one number; None leaves its own."""
    if weights is None:
        return record
    weights = jnp.asarray(weights, record.y.dtype)
    if weights.shape not in ((), record.y.shape):
        raise ValueError(
            f"weights need one value per row of the record, {record.y.size}, got {weights.size}."
        )
    weights = jnp.broadcast_to(weights, record.y.shape)
    return eqx.tree_at(lambda r: r.weights, record, weights, is_leaf=lambda x: x is None)


def compact(record: StepRecord) -> StepRecord:
    """The same record with the rows that count first, and harmless ones behind them.

    Behind, time goes on evenly and the output stays as it is in the last row: an extreme, a
    crossing or a last value is what it is without those rows. Numerical code works on compact
    records; one without `rows` and `weights` is compact as it is.
    """
    if record.rows is None and record.weights is None:
        return record
    t, y, weights = record.t, record.y, record.weights
    place = jnp.arange(t.size)
    counts = jnp.ones(t.size, bool) if record.rows is None else place < record.rows
    if weights is not None:
        counts = counts & (weights > 0)
        order = jnp.argsort(~counts, stable=True)
        t, y, weights = t[order], y[order], weights[order]
    rows = jnp.sum(counts)
    last = jnp.maximum(rows - 1, 0)
    interval = (t[last] - t[0]) / jnp.maximum(last, 1)
    after = t[last] + jnp.where(interval > 0, interval, 1) * (place - last)
    present = place < rows
    t, y = jnp.where(present, t, after), jnp.where(present, y, y[last])
    if weights is not None:
        weights = jnp.where(present, weights, 0)
    return eqx.tree_at(
        lambda r: (r.t, r.y, r.rows, r.weights),
        record,
        (t, y, rows, weights),
        is_leaf=lambda x: x is None,
    )


def stack_records(records: Iterable[StepRecord]) -> StepRecord:
    """A batch of records of any lengths, for `jax.vmap`: each padded to the longest.

    Every leaf has a leading axis; names and details are left out. Known levels must be known of
    all records or of none. **Raises** `ValueError` for no record at all, or for levels known of
    some.
    """
    records = [record.plain for record in records]
    if not records:
        raise ValueError("stack_records needs at least one record.")
    for level in ("initial", "final"):
        if len({getattr(record, level) is None for record in records}) > 1:
            raise ValueError(f"stack_records needs the {level} level of all records, or of none.")
    size = max(record.t.size for record in records)
    weighted = any(record.weights is not None for record in records)
    padded = [padded_record(record, size, weighted) for record in records]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *padded)


def padded_record(record: StepRecord, size: int, weighted: bool = False) -> StepRecord:
    """A record filled up with zeros to `size` rows, of which only those count that it had.

    NumPy does it where it can: JAX would compile that for every length.
    """
    weights = record.weights
    if weights is None and weighted:
        weights = np.ones(record.t.size, record.t.dtype)

    def filled(row: Array | np.ndarray) -> Array:
        pad = jnp.pad if isinstance(row, Tracer) else np.pad
        return jnp.asarray(pad(row, (0, size - record.t.size)))

    rows = record.t.size if record.rows is None else record.rows
    return eqx.tree_at(
        lambda r: (r.t, r.y, r.rows, r.weights),
        record,
        (
            filled(record.t),
            filled(record.y),
            jnp.asarray(rows),
            None if weights is None else filled(weights),
        ),
        is_leaf=lambda x: x is None,
    )


def rows_that_count(record: StepRecord) -> StepRecord:
    """The record without the rows that do not count; host code."""
    if record.rows is None and record.weights is None:
        return record
    counts = np.arange(record.t.size) < np.asarray(record.count)
    if record.weights is not None:
        counts = counts & (np.asarray(record.weights) > 0)
    t, y = (jnp.asarray(np.asarray(x)[counts]) for x in (record.t, record.y))
    return eqx.tree_at(
        lambda r: (r.t, r.y, r.rows, r.weights),
        record,
        (t, y, None, None),
        is_leaf=lambda x: x is None,
    )


def record_status(record: StepRecord) -> Status:
    """`Status.successful`, or what is wrong with the values of a compact record."""
    numbers = [record.t, record.y, record.step_time, record.step_size]
    numbers += [] if record.weights is None else [record.weights]
    numbers += [level for level in (record.initial, record.final) if level is not None]
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in numbers]))
    t, y = record.t, record.y
    checks: list[tuple[Flag, Status]] = [
        (~finite, Status.nonfinite_data),
        (~jnp.all(jnp.diff(t) > 0), Status.time_not_increasing),
    ]
    if t.size:
        checks.append((record.step_time > t[record.last], Status.step_outside_record))
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
    """Status of a record, and the record, compact, or where it is refused a harmless stand-in.

    Numerical code runs on the stand-in without a NaN or an endless loop; its result is discarded.
    """
    record = compact(record)
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
        rows=None if record.rows is None else count,
        weights=None if record.weights is None else jnp.ones(count, dtype),
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


def input_response_slopes(
    record: StepRecord, plant: AbstractPlant, changes: Sequence[dict[str, Array]]
) -> tuple[Samples, Samples, Samples, list[Samples]]:
    """`input_response`, and how it moves: with the dead time, the unit of time, and `changes`.

    The second is the derivative in the logarithm of the unit that all times of the plant are
    measured in, but for the dead time. `changes`: as in `AbstractPlant.slopes`.
    """
    since = record.elapsed - plant.delay
    g, slope, moved = plant.slopes(since, changes)
    return g, -slope, -since * slope, moved


def predict(model: AbstractPlant, record: StepRecord, t: Any = None) -> Samples:
    """Output of a model, offset + step_size gain g, at the record's rows or at times `t`."""
    return scaled(model, record, input_response(record, model, t))


def scaled(model: AbstractPlant, record: StepRecord, response: Samples) -> Samples:
    """The same for a response that is known already."""
    return model.offset + record.step_size * model.gain * response
