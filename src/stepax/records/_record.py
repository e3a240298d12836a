"""A recorded step response, and what can be done with the rows of any record."""

from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from .._arrays import Count, Flag, Samples, Scalar
from .._status import Status, refused
from ..models._abstract import AbstractPlant
from ..models._contour import chain_curvature
from ._abstract import AbstractRecord, times_go_on
from ._checks import as_number, as_rows, as_samples, as_weights
from ._labels import Labels


MIN_SAMPLES = 8
"""Fewest rows, from the step on, that a record may have."""

R = TypeVar("R", bound=AbstractRecord)


class StepRecord(AbstractRecord):
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
        of = "of a StepRecord"
        t, y = as_samples(t, f"t {of}"), as_samples(y, f"y {of}")
        if t.shape != y.shape:
            raise ValueError(f"t and y {of} must have equal lengths, got {t.size} and {y.size}.")
        dtype = jnp.result_type(t, y)
        self.t, self.y = t.astype(dtype), y.astype(dtype)
        self.step_time = as_number(step_time, f"step_time {of}", dtype)
        self.step_size = as_number(step_size, f"step_size {of}", dtype)
        self.initial = None if initial is None else as_number(initial, f"initial {of}", dtype)
        self.final = None if final is None else as_number(final, f"final {of}", dtype)
        self.labels = labels
        self.details = {} if details is None else details
        self.rows = None if rows is None else as_rows(rows, f"rows {of}", t.size)
        self.weights = None if weights is None else as_weights(weights, f"weights {of}", self.t)

    of_input = ("t", "step_time", "step_size", "rows")

    @property
    def start_time(self) -> Scalar:
        """`step_time`."""
        return self.step_time

    @property
    def input_size(self) -> Scalar:
        """`step_size`."""
        return self.step_size

    @property
    def after_step(self) -> Array:
        """Which rows lie at or after the step: those that errors and fits use."""
        return (self.t >= self.step_time) & self.present

    @property
    def kinked(self) -> bool:
        """A step is a jump."""
        return True

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

    def compacted(self) -> "StepRecord":
        """Rows of weight 0 go to the end with those that do not count."""
        record = self
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
        present = place < rows
        t, y = times_go_on(t, rows), jnp.where(present, y, y[jnp.maximum(rows - 1, 0)])
        if weights is not None:
            weights = jnp.where(present, weights, 0)
        return _replaced(record, t, y, rows, weights)

    def numbers(self) -> list[Array]:
        """Rows, step and known levels."""
        levels = [level for level in (self.initial, self.final) if level is not None]
        return [self.t, self.y, self.step_time, self.step_size, *levels]

    def input_status(self) -> list[tuple[Flag, Status]]:
        """A step after the record, or of no size."""
        nothing = [(self.step_size == 0, Status.no_step)]
        if not self.t.size:
            return nothing
        return [(self.step_time > self.t[self.last], Status.step_outside_record), *nothing]

    def stand_in(self, t: Samples, y: Samples) -> "StepRecord":
        """A step at 0 of size 1; levels known where they are."""
        zero, one = jnp.zeros((), t.dtype), jnp.ones((), t.dtype)
        return StepRecord(
            t,
            y,
            zero,
            one,
            None if self.initial is None else zero,
            None if self.final is None else one,
            rows=None if self.rows is None else t.size,
            weights=None if self.weights is None else jnp.ones(t.size, t.dtype),
        )

    def response(self, plant: AbstractPlant, t: Any = None) -> Samples:
        """g(t - step_time - delay)."""
        elapsed = self.elapsed if t is None else t - self.step_time
        return plant.unit_response(elapsed - plant.delay)

    def response_slopes(
        self, plant: AbstractPlant, changes: Sequence[dict[str, Array]]
    ) -> tuple[Samples, Samples, Samples, list[Samples]]:
        """Both dead time and unit move the response along its slope in time."""
        since = self.elapsed - plant.delay
        g, slope, moved = plant.slopes(since, changes)
        return g, -slope, -since * slope, moved

    def curvature(self, plant: Any, weights: Samples) -> Array:
        """By the rule of the contour."""
        return chain_curvature(self.elapsed - plant.delay, plant.lags, weights)

    def share_shown(self, plant: AbstractPlant, response: Samples) -> Scalar:
        """The response in the last row."""
        del plant
        return response[self.last]

    def input_facts(self) -> dict[str, Any]:
        """The step."""
        return {"step": {"time": float(self.step_time), "size": float(self.step_size)}}


def with_weights(record: R, weights: Any) -> R:
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


def compact(record: R) -> R:
    """The same record with the rows that count first, and harmless ones behind them.

    Behind, time goes on evenly and the output stays as it is in the last row: an extreme, a
    crossing or a last value is what it is without those rows. Numerical code works on compact
    records; one without `rows` and `weights` is compact as it is.
    """
    return record.compacted()


def stack_records(records: Iterable[R]) -> R:
    """A batch of records of any lengths, for `jax.vmap`: each padded to the longest.

    All of one kind: `StepRecord`s, or `InputRecord`s with one `hold`. Every leaf has a leading
    axis; names and details are left out. Known levels must be known of all records or of none.
    **Raises** `ValueError` for no record at all, or for records that differ in that.
    """
    records = [record.plain for record in records]
    if not records:
        raise ValueError("stack_records needs at least one record.")
    records = type(records[0]).alike(records)
    for level in ("initial", "final"):
        if len({getattr(record, level) is None for record in records}) > 1:
            raise ValueError(f"stack_records needs the {level} level of all records, or of none.")
    size = max(record.t.size for record in records)
    weighted = any(record.weights is not None for record in records)
    padded = [padded_record(record, size, weighted) for record in records]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *padded)


def padded_record(record: R, size: int, weighted: bool = False) -> R:
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
    values = [filled(getattr(record, name)) for name in record.by_row]
    return _replaced(
        record, *values, jnp.asarray(rows), None if weights is None else filled(weights)
    )


def rows_that_count(record: R) -> R:
    """The record without the rows that do not count; host code."""
    if record.rows is None and record.weights is None:
        return record
    counts, weights = np.arange(record.t.size) < np.asarray(record.count), record.weights
    if weights is not None and record.rows_can_go:
        counts, weights = counts & (np.asarray(weights) > 0), None
    cut = lambda row: None if row is None else jnp.asarray(np.asarray(row)[counts])  # noqa: E731
    values = [cut(getattr(record, name)) for name in record.by_row]
    return _replaced(record, *values, None, cut(weights))


def _replaced(record: R, *values: Any) -> R:
    """A record with other values a row, number of rows, and weights."""
    names = (*record.by_row, "rows", "weights")
    get = lambda r: [getattr(r, name) for name in names]  # noqa: E731
    return eqx.tree_at(get, record, list(values), is_leaf=lambda x: x is None)


def record_status(record: AbstractRecord) -> Status:
    """`Status.successful`, or what is wrong with the values of a compact record."""
    weights = [] if record.weights is None else [record.weights]
    checks = _checks(record, record.numbers() + weights)
    if record.t.size:
        after = jnp.where(record.after_step, record.y, record.y[-1])
        checks.append((jnp.max(after) == jnp.min(after), Status.constant_output))
    return _first(checks)


def _checks(record: AbstractRecord, numbers: list[Array]) -> list[tuple[Flag, Status]]:
    """What may be wrong with these numbers of a record, and with its times and input."""
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in numbers]))
    return [
        (~finite, Status.nonfinite_data),
        (~jnp.all(jnp.diff(record.t) > 0), Status.time_not_increasing),
        *record.input_status(),
        (jnp.sum(record.after_step) < MIN_SAMPLES, Status.too_few_samples),
    ]


def _first(checks: list[tuple[Flag, Status]]) -> Status:
    """The first that is wrong."""
    status = Status.successful
    for wrong, reason in reversed(checks):
        status = Status.where(wrong, reason, status)
    return status


def usable_record(record: R) -> tuple[Status, R]:
    """Status of a record, and the record, compact, or where it is refused a harmless stand-in.

    Numerical code runs on the stand-in without a NaN or an endless loop; its result is discarded.
    Times and input stay where nothing is wrong with them: what follows from them alone is computed
    once for all records of a batch that share them.
    """
    record = compact(record).plain
    status = record_status(record)
    rise = lambda elapsed, duration: 1 - jnp.exp(-5 * jnp.maximum(elapsed, 0) / duration)  # noqa: E731
    t = jnp.arange(max(record.t.size, MIN_SAMPLES), dtype=record.t.dtype)
    stand_in = record.stand_in(t, rise(t, t[-1]))
    if record.t.size < MIN_SAMPLES:
        return status, stand_in
    bad = refused(status)
    usable = jax.tree.map(lambda a, b: jnp.where(bad, a, b), stand_in, record)
    names = [name for name in record.of_input if getattr(record, name) is not None]
    if names:
        of = lambda record: [getattr(record, name) for name in names]  # noqa: E731
        lost = refused(_first(_checks(record, of(record))))
        kept = [jnp.where(lost, a, b) for a, b in zip(of(stand_in), of(record), strict=True)]
        usable = eqx.tree_at(of, usable, kept)
        y = jnp.where(bad, rise(usable.elapsed, usable.duration), record.y)
        usable = eqx.tree_at(lambda record: record.y, usable, y)
    return status, usable


def predict(model: AbstractPlant, record: AbstractRecord, t: Any = None) -> Samples:
    """Output of a model, offset + input_size gain g, at the record's rows or at times `t`.

    And what was found to move it beside the input.
    """
    return scaled(model, record, record.response(model, t), t)


def scaled(model: AbstractPlant, record: AbstractRecord, response: Samples, t: Any = None):
    """The same for a response that is known already."""
    output = model.offset + record.input_size * model.gain * response
    return output if record.found_beside is None else output + moved_beside(model, record, t)


def moved_beside(model: AbstractPlant, record: AbstractRecord, t: Any = None) -> Any:
    """What was found to move the output beside the input; 0 where nothing was sought."""
    found = () if record.found_beside is None else record.found_beside
    return sum(x * column for x, column in zip(found, record.beside(model, t), strict=True))
