"""What point methods share: reading a record, dead times, charts' ends, and the conclusion."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._arrays import Flag, Scalar, nan_where
from .._result import Identification, conclude
from .._status import Status, first_problem, refused
from ..models._abstract import AbstractPlant
from ..records._characterise import (
    Tangent,
    crossing_times,
    integrals,
    levels as levels_of,
    smoothed,
    tangent,
)
from ..records._record import StepRecord, usable_record


Span = float | Scalar | None
"""Share of the samples in each window of LOESS, differentiable where it is traced; None takes the
record as it is."""
Delay = Float[ArrayLike, ""]
"""Dead time known beforehand, in the unit of time."""

CONSTANTS = ("printed", "exact")
"""Constants as they stand in the source, rounded, or recomputed from theory."""


def is_exact(constants: str) -> bool:
    """Whether the recomputed constants are asked for; `ValueError` for an unknown choice."""
    if constants not in CONSTANTS:
        raise ValueError(f"constants must be 'printed' or 'exact', got {constants!r}.")
    return constants == "exact"


def time_name(level: float) -> str:
    """Name of a level's time among the details: t33, t35_3."""
    return f"t{100 * level:.3g}".replace(".", "_")


class Crossings(NamedTuple):
    """When a response reaches some levels.

    `times` from step and known dead time, harmless ones where the `status` refuses; as `read`,
    from the step, NaN where a level is not reached.
    """

    times: Array
    read: Array
    status: Status


class OwnDelay(NamedTuple):
    """Dead time that a method computes: `raw`, of either sign; what is `kept` of it; the status."""

    raw: Scalar
    kept: Scalar
    status: Status


class ByHand(NamedTuple):
    """What a person read instead, counted from the step; NaN where nothing was.

    `times`: of the levels that some method asks for, ascending. `Tu`, `Tg`: of the tangent.
    """

    times: Array
    Tu: Array
    Tg: Array


class _Shared:
    """What methods that read the same record in one trace have already read.

    Keys are the span and what was read; `levels` are all that some method will ask for.
    """

    def __init__(self, record: StepRecord, levels: Sequence[float], by_hand: ByHand | None):
        self.record, self.levels = record, sorted(set(levels))
        self.by_hand = by_hand
        self.found: dict[Any, Any] = {}


_SHARED: ContextVar[_Shared | None] = ContextVar("shared readings", default=None)


@contextlib.contextmanager
def shared_readings(
    record: StepRecord, levels: Sequence[float], by_hand: ByHand | None = None
) -> Iterator[None]:
    """Within it, methods called with this very record read it once between them.

    For several methods in one trace: nothing is traced, compiled or computed twice. `by_hand`
    takes the place of what they would read. Results have no errors yet where a response is not
    known: `judged` gives them.
    """
    token = _SHARED.set(_Shared(record, levels, by_hand))
    try:
        yield
    finally:
        _SHARED.reset(token)


class Reading:
    """One record as a point method reads it; it lives inside one call.

    Times count from step + `delay`, the dead time known beforehand. What `times` and `tangent`
    read is remembered: its status, and for the details what was read, counted from the step alone.
    `conclude` makes the result of it.

    A record that is refused is replaced by a harmless one, so that a method's formula need not ask.
    """

    def __init__(self, record: StepRecord, span: Span, delay: Delay):
        self.record, self._span = record, span
        problem, self.safe = self.once("record", lambda: _held(record, span))
        assert self.safe.initial is not None and self.safe.final is not None
        self.initial, self.final = self.safe.initial, self.safe.final
        self.delay = jnp.asarray(delay, record.t.dtype)
        self.details: dict[str, Array] = {}
        self._statuses = [problem]

    def crossings(self, levels: Sequence[float] | Array) -> Crossings:
        """Times of ascending levels, not remembered: for who has yet to choose what to use.

        Status: `levels_not_crossed`, or `invalid_times` where they are not positive and increasing.
        """
        read = self._crossings(levels)
        levels = jnp.asarray(levels, self.delay.dtype)
        times = read - self.delay
        rising = (times[0] > 0) & jnp.all(jnp.diff(times) > 0)
        status = Status.where(rising, Status.successful, Status.invalid_times)
        crossed = jnp.all(jnp.isfinite(read))
        status = Status.where(crossed, status, Status.levels_not_crossed)
        # Instead of times that cannot be used those of one lag of 1, which every formula takes.
        return Crossings(jnp.where(refused(status), -jnp.log1p(-levels), times), read, status)

    def times(self, levels: Sequence[float]) -> Array:
        """Times of ascending levels, one each; `crossings`, remembered as t33, t70, ..."""
        found = self.crossings(levels)
        self.remember(found.status, **dict(zip(map(time_name, levels), found.read, strict=True)))
        return found.times

    def tangent(self) -> Tangent:
        """The tangent, or a harmless one where there is none (`no_inflection`).

        Remembered as Tu, Tg, t_inflection.
        """
        line = self.once("tangent", lambda: tangent(self.safe))
        if hand := self._by_hand:
            Tu, Tg = (
                jnp.where(jnp.isnan(x), y, x) for x, y in ((hand.Tu, line.Tu), (hand.Tg, line.Tg))
            )
            line = line._replace(Tu=Tu, Tg=Tg)
        found = jnp.isfinite(line.Tg) & (line.Tg > 0)
        status = Status.where(found, Status.successful, Status.no_inflection)
        self.remember(status, Tu=line.Tu, Tg=line.Tg, t_inflection=line.t_inflection)
        line = line._replace(Tu=line.Tu - self.delay, t_inflection=line.t_inflection - self.delay)
        return Tangent(*(jnp.where(found, x, 1) for x in line))

    def areas(self) -> Array:
        """Integrals of t^k (1 - y) from the step on, k = 0, 1, 2.

        A method says itself which it can use.
        """
        return self.once("areas", lambda: integrals(self.safe, (0, 1, 2)))

    def once(self, what: str, read: Callable[[], Any]) -> Any:
        """What `read` gives, or what a method before has read: with default options alone."""
        shared = self._shared
        if shared is None:
            return read()
        key = what, self._span
        if key not in shared.found:
            shared.found[key] = read()
        return shared.found[key]

    def _crossings(self, levels: Sequence[float] | Array) -> Array:
        """Times of levels from the step."""
        shared, dtype = self._shared, self.delay.dtype
        known = [] if shared is None or isinstance(levels, Array) else shared.levels
        if not known or not set(levels) <= set(known):
            return crossing_times(self.safe, jnp.asarray(levels, dtype))
        every = lambda: crossing_times(self.safe, jnp.asarray(known, dtype))  # noqa: E731
        times = self.once("crossings", every)
        if hand := self._by_hand:
            times = jnp.where(jnp.isnan(hand.times), times, hand.times)
        return times[np.array([known.index(level) for level in levels])]

    @property
    def _shared(self) -> _Shared | None:
        """What several methods share that read this very record together."""
        shared = _SHARED.get()
        return shared if shared is not None and shared.record is self.record else None

    @property
    def _by_hand(self) -> ByHand | None:
        """What a person read of this record, where several methods read it together."""
        shared = self._shared
        return None if shared is None else shared.by_hand

    def remember(self, status: Status, **details: Array) -> None:
        """What else a method reads: whether that can be used, and what it is, by name."""
        self._statuses.append(status)
        self.details |= details

    def conclude(
        self,
        model: AbstractPlant,
        *statuses: Status,
        own: OwnDelay | None = None,
        response: Array | None = None,
        **details: Array,
    ) -> Identification:
        """The result: `model` with gain, offset and dead time, and the first problem there was.

        `response` is that of the model to a unit step at the rows, where it is known already.

        Problems are asked for in this order: the record, what was read, `statuses`, and the dead
        time of the method's `own`, which comes on top of the one known beforehand. `details` of the
        method's own stand beside what was read; all are NaN where the record or a reading is
        refused, but not where a model of the family cannot follow.
        """
        problems, delay = [*self._statuses, *statuses], self.delay
        details = self.details | details
        if own is not None:
            problems, delay = [*problems, own.status], delay + own.kept
            details["raw_delay"] = own.raw
        status = first_problem(*problems)
        gain = (self.final - self.initial) / self.safe.step_size
        model = eqx.tree_at(
            lambda m: (m.gain, m.offset, m.delay), model, (gain, self.initial, delay)
        )
        details = nan_where(unread(status), details) | self.record.details
        alone = self._shared is None or response is not None
        return conclude(self.record, model, status, response=response, details=details, judge=alone)


def _held(record: StepRecord, span: Span) -> tuple[Status, StepRecord]:
    """Status, and the usable record, smoothed, with its levels held.

    They are read before LOESS: all that follows speaks of shares of the same change.
    """
    problem, safe = usable_record(record)
    return problem, eqx.tree_at(
        lambda r: (r.y, r.initial, r.final),
        safe,
        (smoothed(safe, span), *levels_of(safe)),
        is_leaf=lambda x: x is None,
    )


def own_delay(raw: Scalar, scale: Scalar) -> OwnDelay:
    """Dead time that a method computed: a negative one is dropped, with a warning.

    Without the warning where it is negative by no more than rounding, relative to `scale`.
    """
    dropped = raw < -rounding(raw.dtype) * scale
    status = Status.where(dropped, Status.delay_dropped, Status.successful)
    return OwnDelay(raw, jnp.maximum(raw, 0), status)


def rounding(dtype) -> float:
    """Relative size below which a difference between readings is no news.

    The interpolation between samples errs by 1e-7, and a curve's end next to one lag lies within
    sqrt(eps) of it (`shape_ends`): 1.2e-7 in all, 4.3e-4 in float32.
    """
    return 1e-7 + 1.25 * float(jnp.finfo(dtype).eps) ** 0.5


def end_status(*ends: tuple[Scalar, float | Scalar, Status]) -> Status:
    """Status of a value that may lie beyond the ends of a curve.

    For each end: by how much it lies beyond (below 0 inside), how much is allowed, and the
    refusal. Successful inside and beyond by rounding, then the warning `at_curve_end` as far as
    is allowed.
    """
    status = Status.successful
    for beyond, allowed, refusal in ends:
        status = Status.where(beyond > rounding(beyond.dtype), Status.at_curve_end, status)
        status = Status.where(beyond <= allowed, status, refusal)
    return status


def unread(status: Status) -> Flag:
    """Whether a status refuses the record or the reading, not the model that would follow."""
    ends = (Status.beyond_first_order, Status.beyond_second_order, Status.beyond_last_order)
    return refused(status) & jnp.all(jnp.stack([status != end for end in ends]))
