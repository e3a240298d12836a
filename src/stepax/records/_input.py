"""A record with a sampled input of any shape, as it was logged."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from .._arrays import Count, Flag, Samples, Scalar
from .._status import Status
from ..models._abstract import AbstractPlant
from ..models._contour import chain_curvature
from ..models._respond import (
    check_hold,
    interval_of,
    off_grid,
    respond_evenly,
    respond_unevenly,
)
from ..models._units import in_unit
from ._abstract import AbstractRecord, times_go_on
from ._checks import as_rows, as_samples, as_weights
from ._labels import Labels


EVEN = 1e-6
"""Share of the sampling interval by which evenly sampled times may be off, beside rounding."""


FEW_MOVES = 8
"""Moves up to which it is quicker to add up the responses to each, also at even times."""


class InputRecord(AbstractRecord):
    r"""A record with a sampled input: staircase, pulses, PRBS, what a controller did.

    $$ y(t) = \text{offset} + \text{gain} \, (g' * (u - u_0))(t - L) \quad (+ \text{drift and the
    plant's own motion}), $$

    with $u_0$ the first sample of the input: at the first row the plant is at rest with the offset
    as its output, unless `at_rest` is False.

    **Fields:**

    - `t`: (samples,) strictly increasing times, even or uneven; even ones are quickest.
    - `y`, `u`: (samples,) output and input as logged.
    - `hold`: "zero": the input stays until the next sample, as a controller's output does;
        "first": it runs straight to the next sample.
    - `rows`, `weights`, `labels`, `details`: as in `StepRecord`; a row of weight 0 (whose output
        may be NaN) still tells the input.
    - `at_rest`: False: the plant's state at the first row is sought too. `drift`: True: so is a
        linear drift of the output. Both enter linearly and are eliminated. Fits have them as
        options too.

    What is wrong in kind raises a `TypeError` or `ValueError`; what is wrong in value, such as an
    input that does not move, is a `Status`.
    """

    t: Samples
    y: Samples
    u: Samples
    hold: str = eqx.field(static=True)
    labels: Labels = eqx.field(static=True)
    details: dict[str, Array]
    rows: Count | None
    weights: Samples | None
    at_rest: bool = eqx.field(static=True)
    drift: bool = eqx.field(static=True)
    even: bool | None = eqx.field(static=True)  # found when it is made; None: times were traced
    moves: int | None = eqx.field(static=True)  # how often the input moves; None: it was traced
    superposes: bool = eqx.field(static=True)  # see `for_search`
    found: Samples | None  # what multiplies `beside`, of the record of a result

    # Facts of the class, not annotated: an annotation would make them fields.
    by_row = ("t", "y", "u")
    rows_can_go = False
    initial = final = None  # no level is known by itself

    def __init__(
        self,
        t: Any,
        y: Any,
        u: Any,
        hold: str = "zero",
        weights: Any = None,
        rows: Any = None,
        *,
        at_rest: bool = True,
        drift: bool = False,
        labels: Labels = Labels(),  # noqa: B008 (immutable)
        details: dict[str, Array] | None = None,
        even: bool | None = None,
        moves: int | None = None,
        superposes: bool = False,
        found: Samples | None = None,
    ):
        of = "of an InputRecord"
        self.even = _are_even(t, rows) if even is None else even
        self.moves, self.superposes = _moves(u, rows) if moves is None else moves, superposes
        t, y, u = (as_samples(x, f"{name} {of}") for name, x in (("t", t), ("y", y), ("u", u)))
        if not t.shape == y.shape == u.shape:
            sizes = f"{t.size}, {y.size} and {u.size}"
            raise ValueError(f"t, y and u {of} must have equal lengths, got {sizes}.")
        check_hold(hold)
        dtype = jnp.result_type(t, y, u)
        self.t, self.y, self.u = t.astype(dtype), y.astype(dtype), u.astype(dtype)
        self.hold, self.labels = hold, labels
        self.details = {} if details is None else details
        self.rows = None if rows is None else as_rows(rows, f"rows {of}", t.size)
        self.weights = None if weights is None else as_weights(weights, f"weights {of}", self.t)
        self.at_rest, self.drift, self.found = bool(at_rest), bool(drift), found

    # what a record is asked

    @property
    def start_time(self) -> Scalar:
        """The first row."""
        return self.t[0]

    @property
    def input_size(self) -> Scalar:
        """From the least to the largest input: a unit, of which nothing depends."""
        u = jnp.where(self.present, self.u, self.u[:1])  # what pads a record is no level of it
        size = jax.lax.stop_gradient(jnp.max(u) - jnp.min(u))
        return jnp.where(size > 0, size, 1)

    @property
    def after_step(self) -> Array:
        """All rows that count, but those of weight 0."""
        return self.present if self.weights is None else self.present & (self.weights > 0)

    @property
    def kinked(self) -> bool:
        """A held input jumps at every sample."""
        return self.hold == "zero"

    @property
    def plain(self) -> "InputRecord":
        """This record without names and details, and without what was found."""
        return dataclasses.replace(self, labels=Labels(), details={}, found=None)

    @property
    def found_beside(self) -> Samples | None:
        """The slope of the drift, then the numbers of the plant's own motion."""
        return self.found

    def with_found(self, details: Mapping[str, Array]) -> "InputRecord":
        """With `trend` and `own_motion` of the details."""
        names = [name for name in ("trend", "own_motion") if name in details]
        found = [jnp.atleast_1d(details[name]) for name in names]
        return dataclasses.replace(
            self,
            drift="trend" in names,
            at_rest="own_motion" not in names,
            found=jnp.concatenate(found) if found else None,
        )

    def seeking(self, at_rest: bool | None, drift: bool | None) -> "InputRecord":
        """With other wishes than its own, where they are given."""
        at_rest = self.at_rest if at_rest is None else at_rest
        drift = self.drift if drift is None else drift
        return dataclasses.replace(self, at_rest=at_rest, drift=drift)

    def compacted(self) -> "InputRecord":
        """Behind the rows that count the input stays, and times go on; rows of weight 0 are held.

        An output that does not count is that of the last row before that does.
        """
        if self.rows is None and self.weights is None:
            return self
        place = jnp.arange(self.t.size)
        present = jnp.ones(self.t.size, bool) if self.rows is None else place < self.rows
        counts = present if self.weights is None else present & (self.weights > 0)
        rows = jnp.sum(present)
        before = jax.lax.cummax(jnp.where(counts, place, -1))
        y = self.y[jnp.where(before < 0, jnp.argmax(counts), before)]
        u = jnp.where(present, self.u, self.u[jnp.maximum(rows - 1, 0)])
        t = times_go_on(self.t, rows)
        weights = None if self.weights is None else jnp.where(counts, self.weights, 0)
        return eqx.tree_at(
            lambda r: (r.t, r.y, r.u, r.rows, r.weights),
            self,
            (t, y, u, None if self.rows is None else rows, weights),
            is_leaf=lambda x: x is None,
        )

    def numbers(self) -> list[Array]:
        """All rows."""
        return [self.t, self.y, self.u]

    def input_status(self) -> list[tuple[Flag, Status]]:
        """An input that does not move."""
        return [(jnp.max(self.u) == jnp.min(self.u), Status.no_step)] if self.u.size else []

    def stand_in(self, t: Samples, y: Samples) -> "InputRecord":
        """A step after the first row."""
        u = (jnp.arange(t.size) > 0).astype(t.dtype)
        ones = None if self.weights is None else jnp.ones(t.size, t.dtype)
        rows = None if self.rows is None else jnp.asarray(t.size)
        return dataclasses.replace(self.plain, t=t, y=y, u=u, weights=ones, rows=rows)

    @classmethod
    def alike(cls, records: list[Any]) -> list[Any]:
        """All with one hold, and the same to be found; even if all are."""
        records = super().alike(records)
        if len({(record.hold, record.at_rest, record.drift) for record in records}) > 1:
            raise ValueError("stack_records needs InputRecords with one hold, at_rest and drift.")
        known, moves = [record.even for record in records], [record.moves for record in records]
        even = None if None in known else all(known)
        most = max((x for x in moves if x is not None), default=None)
        most = None if None in moves else most
        return [dataclasses.replace(record, even=even, moves=most) for record in records]

    def share_shown(self, plant: AbstractPlant, response: Samples) -> Scalar:
        """The response to a step at the first row, in the last."""
        del response
        return plant.unit_response(self.duration - plant.delay)

    def input_facts(self) -> dict[str, Any]:
        """Range and hold of the input, and what else was found."""
        u = np.asarray(self.u)[: int(self.count)]
        about: dict[str, Any] = {"least": float(u.min()), "most": float(u.max())}
        about |= {"first": float(u[0]), "hold": self.hold, "at_rest": self.at_rest}
        if self.drift and self.found is not None:
            about["trend"] = float(self.found[0])
        return {"step": None, "input": about}

    # how the input moves a plant

    def response(self, plant: AbstractPlant, t: Any = None) -> Samples:
        """g against every move of the input."""
        if t is not None:
            return self._at(plant, t)
        if self.superposes:
            return self._added_up(plant.unit_response(self._since(plant)))
        return self._simulated(plant)

    def response_slopes(
        self, plant: AbstractPlant, changes: Sequence[dict[str, Array]]
    ) -> tuple[Samples, Samples, Samples, list[Samples]]:
        """As of a step, each against every move of the input."""
        if self.superposes:
            since = self._since(plant)
            g, slope, moved = plant.slopes(since, changes)
            kernels = jnp.stack([g, -slope, -since * slope, *moved])
            g, by_delay, by_unit, *moved = self._added_up(kernels)
            return g, by_delay, by_unit, moved
        ways = [{"delay": jnp.ones_like(plant.delay)}, *changes]
        by_delay, *moved = [self._slope(plant, way) for way in ways]

        def stretched(unit: Scalar) -> Samples:
            return self.response(dataclasses.replace(in_unit(plant, unit), delay=plant.delay))

        one = jnp.ones_like(plant.delay)
        by_unit = jax.jvp(stretched, (one,), (one,))[1]
        return self.response(plant), by_delay, by_unit, moved

    def curvature(self, plant: Any, weights: Samples) -> Array:
        """By the rule of the contour where there are few moves, else differentiated."""
        if self.superposes:
            since = self._since(plant)
            back = jax.linear_transpose(self._added_up, since)
            return chain_curvature(since, plant.lags, back(weights)[0])

        def total(lags: Array) -> Scalar:
            return weights @ self.response(dataclasses.replace(plant, lags=lags))

        return jax.hessian(total)(plant.lags)

    @property
    def seeks_beside(self) -> bool:
        """A drift, or a state other than rest."""
        return self.drift or not self.at_rest

    def beside(self, plant: AbstractPlant, t: Any = None) -> list[Samples]:
        """Time since the first row, for a drift; the plant's own motions from another state."""
        elapsed = self.elapsed if t is None else t - self.start_time
        columns = [elapsed] if self.drift else []
        return columns if self.at_rest else [*columns, *plant.own_motions(elapsed)]

    def names_beside(self, numbers: Samples) -> dict[str, Array]:
        """`trend`, a slope, and `own_motion`."""
        names = {"trend": numbers[0]} if self.drift else {}
        return names if self.at_rest else names | {"own_motion": numbers[int(self.drift) :]}

    def for_search(self) -> "InputRecord":
        """The same record, of few moves one that adds up the responses to them.

        Which is quick, and whose derivatives in u know only the rows in which it moves now.
        """
        few = self.kinked and self.moves is not None and self.moves <= FEW_MOVES
        return dataclasses.replace(self, superposes=few)

    def _since(self, plant: AbstractPlant) -> Samples:
        """Times since each of few moves, less the dead time."""
        return (self.t[None] - self.t[self._rows_of_moves][:, None]).ravel() - plant.delay

    def _added_up(self, kernels: Array) -> Array:
        """The response from responses to single steps at these times, along the last axis."""
        moves = jnp.diff(self.u, prepend=self.u[:1]) / self.input_size
        kernels = kernels.reshape(*kernels.shape[:-1], -1, self.t.size)
        return jnp.einsum("...mt,m->...t", kernels, moves[self._rows_of_moves])

    @property
    def _rows_of_moves(self) -> Array:
        """The rows in which the input has moved, filled up with the first, in which it has not."""
        moved = jnp.diff(self.u, prepend=self.u[:1]) != 0
        return jnp.nonzero(moved, size=self.moves, fill_value=0)[0]

    def _simulated(self, plant: AbstractPlant) -> Samples:
        """The plant's own rule for any times and either hold."""
        plant, u = _unit(plant), (self.u - self.u[0]) / self.input_size
        if self.even is None:
            return plant.respond(self.t, u, self.hold)
        if self.even:
            return respond_evenly(plant, self.duration / self.last, u, self.hold)
        return respond_unevenly(plant, self.t, u, self.hold)

    def _slope(self, plant: AbstractPlant, change: dict[str, Array]) -> Samples:
        """How the response moves with own parameters or the dead time."""
        now = {name: getattr(plant, name) for name in change}
        change = {name: jnp.asarray(x, now[name].dtype) for name, x in change.items()}
        moved = lambda values: self.response(dataclasses.replace(plant, **values))  # noqa: E731
        return jax.jvp(moved, (now,), (change,))[1]

    def _at(self, plant: AbstractPlant, t: Any) -> Samples:
        """At any times; behind the last row the input stays as it is."""
        record, t = self.compacted(), jnp.asarray(t, self.t.dtype)
        behind = jnp.maximum(record.t[-1], jnp.max(t)) + record.duration
        times, u = jnp.append(record.t, behind), (record.u - record.u[0]) / record.input_size
        return respond_unevenly(_unit(plant), times, jnp.append(u, u[-1]), self.hold, t)


def refuse_other_input(record: Any, name: str) -> None:
    """A `TypeError` for what reads a step response, where a record has another input."""
    if isinstance(record, InputRecord):
        raise TypeError(
            f"{name} reads the response to a step and needs a StepRecord; to an InputRecord fits"
            ' can be made: identify(record), or a method whose name ends with "_fit".'
        )


def _unit(plant: AbstractPlant) -> AbstractPlant:
    """A plant with gain 1 and offset 0."""
    one = jnp.ones_like(plant.gain)
    return dataclasses.replace(plant, gain=one, offset=jnp.zeros_like(one))


def _moves(u: Any, rows: Any) -> int | None:
    """How often an input moves, or None where it is not known: 1, 2, 4, ..., at least so often."""
    if isinstance(u, Tracer) or isinstance(rows, Tracer):
        return None
    try:
        u = np.asarray(u, float)[: None if rows is None else int(rows)]
    except (TypeError, ValueError):  # the checks say what is wrong
        return None
    return 1 << int(np.count_nonzero(np.diff(u)) - 1).bit_length() if u.ndim == 1 else None


def _are_even(t: Any, rows: Any) -> bool | None:
    """Whether times are evenly spaced but for rounding; None where they are not known."""
    if isinstance(t, Tracer) or isinstance(rows, Tracer):
        return None
    try:
        t = np.asarray(t)
        t = (t if t.dtype.kind == "f" else t.astype(float))[: None if rows is None else int(rows)]
    except (TypeError, ValueError):  # the checks say what is wrong
        return False
    if t.ndim != 1 or t.size < 2 or not np.isfinite(t).all():
        return False
    rounding = 4 * float(np.spacing(np.abs(t).max()))
    t = t.astype(float)
    return bool(off_grid(t, np) <= EVEN * abs(interval_of(t)) + rounding)
