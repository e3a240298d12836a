"""What all records share: rows of time and output, and an input that moved the plant."""

import abc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .._arrays import Count, Flag, Samples, Scalar
from .._status import Status
from ..models._abstract import AbstractPlant
from ._labels import Labels


class AbstractRecord(eqx.Module):
    """Rows of time and output, which of them count, and how an input moved the plant.

    What differs between a step and any other input is asked of the record. Fits see a plant as
    offset + `input_size` gain g, with g the `response` of the plant for gain 1 and offset 0.
    """

    t: eqx.AbstractVar[Samples]
    y: eqx.AbstractVar[Samples]
    labels: eqx.AbstractVar[Labels]
    details: eqx.AbstractVar[dict[str, Array]]
    rows: eqx.AbstractVar[Count | None]
    weights: eqx.AbstractVar[Samples | None]
    initial: eqx.AbstractVar[Scalar | None]
    final: eqx.AbstractVar[Scalar | None]

    # Which fields hold a value a row, beside the weights; and whether a row of weight 0 can be left
    # out: of a sampled input it still tells the input.
    by_row: ClassVar[tuple[str, ...]] = ("t", "y")
    rows_can_go: ClassVar[bool] = True

    # Times and input, where they can stay as they are beside a stand-in for the output of a record
    # that is refused (see `usable_record`).
    of_input: ClassVar[tuple[str, ...]] = ()

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
        """Times since the input first moved the plant."""
        return self.t - self.start_time

    @property
    def duration(self) -> Scalar:
        """Length of the record from then on."""
        return self.t[self.last] - self.start_time

    @property
    @abc.abstractmethod
    def start_time(self) -> Scalar:
        """From when on the input moves the plant."""

    @property
    @abc.abstractmethod
    def input_size(self) -> Scalar:
        """How far the input moves: responses are per this much of input."""

    @property
    @abc.abstractmethod
    def after_step(self) -> Array:
        """Which rows errors and fits use, of a compact record."""

    @property
    @abc.abstractmethod
    def kinked(self) -> bool:
        """Whether the input jumps: then a plant that starts at once has a kink there."""

    @property
    @abc.abstractmethod
    def plain(self) -> Any:
        """This record without names and details: what numerical code needs."""

    @abc.abstractmethod
    def compacted(self) -> Any:
        """See `compact`."""

    @abc.abstractmethod
    def numbers(self) -> list[Array]:
        """All numbers that must be finite."""

    @abc.abstractmethod
    def input_status(self) -> list[tuple[Flag, Status]]:
        """What may be wrong with the input of a compact record."""

    @abc.abstractmethod
    def stand_in(self, t: Samples, y: Samples) -> Any:
        """A harmless record of the same form, with these times, from 0 on, and outputs."""

    @abc.abstractmethod
    def response(self, plant: AbstractPlant, t: Any = None) -> Samples:
        """Response to the input for gain 1 and offset 0, per `input_size`; rows, or times `t`."""

    @abc.abstractmethod
    def response_slopes(
        self, plant: AbstractPlant, changes: Sequence[dict[str, Array]]
    ) -> tuple[Samples, Samples, Samples, list[Samples]]:
        """`response`, and how it moves: with the dead time, the unit of time, and `changes`.

        The second is the derivative in the dead time, the third that in the logarithm of the unit
        that all times of the plant are measured in, but for the dead time. `changes`: as in
        `AbstractPlant.slopes`.
        """

    @abc.abstractmethod
    def curvature(self, plant: Any, weights: Samples) -> Array:
        """Second derivatives of the weighted sum of a response in the lags of a plant."""

    @classmethod
    def alike(cls, records: list[Any]) -> list[Any]:
        """Records that can be stacked; a `ValueError` where they differ in kind."""
        if any(type(record) is not cls for record in records):
            raise ValueError("stack_records needs records of one kind: steps, or sampled inputs.")
        return records

    @abc.abstractmethod
    def share_shown(self, plant: AbstractPlant, response: Samples) -> Scalar:
        """Share of its change that a plant shows within the record."""

    @abc.abstractmethod
    def input_facts(self) -> dict[str, Any]:
        """Time and size of a `step`, which is None where the `input` is another; host code."""

    @property
    def seeks_beside(self) -> bool:
        """Whether more than the response to the input is sought in the output."""
        return False

    def beside(self, plant: AbstractPlant, t: Any = None) -> list[Samples]:
        """What moves the output beside the input, each times a number to be found."""
        del plant, t
        return []

    def for_search(self) -> Any:
        """The same record in a form that is quick, but need not be differentiable in its input."""
        return self

    def seeking(self, at_rest: bool | None, drift: bool | None) -> Any:
        """A record of which a state other than rest, or a drift, is sought too."""
        if at_rest is not None or drift is not None:
            raise ValueError("at_rest and drift are options of a fit to an InputRecord.")
        return self

    def names_beside(self, numbers: Samples) -> dict[str, Array]:
        """These numbers by name, as details of a result."""
        del numbers
        return {}

    @property
    def found_beside(self) -> Samples | None:
        """These numbers in their order, once found."""
        return None

    def with_found(self, details: Mapping[str, Array]) -> Any:
        """The record with these numbers, of the details of a result."""
        del details
        return self


def times_go_on(t: Samples, rows: Count) -> Samples:
    """Times of which the first `rows` count, and which go on evenly behind them."""
    place, last = jnp.arange(t.size), jnp.maximum(rows - 1, 0)
    interval = (t[last] - t[0]) / jnp.maximum(last, 1)
    after = t[last] + jnp.where(interval > 0, interval, 1) * (place - last)
    return jnp.where(place < rows, t, after)
