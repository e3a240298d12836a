"""One least-squares problem: the data, what is known, and the coordinates of the rest."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arrays import Coordinates, Flag, Samples, Scalar, safe_sqrt, still
from .._status import Status
from ..models._abstract import AbstractPlant, ScalarParameter
from ..models._contour import accuracy
from ..records._abstract import AbstractRecord
from ..records._record import usable_record, with_weights
from ._beside import Beside
from ._families import AbstractFamily, family_of
from ._levels import Levels, Near
from ._prior import Prior
from ._solver import inner_products


LONGEST_DELAY = 0.95
"""Largest dead time, relative to the length of the record: some rows must tell the response."""


class SecondStart(NamedTuple):
    """Coordinates to start from a second time, and whether that may lead elsewhere."""

    x: Array
    worthwhile: Flag


class Problem(eqx.Module):
    r"""Residuals of a record as a function of a few coordinates.

    A row of coordinates holds the free own parameters (see `_families`), then the dead time over
    the duration. Gain and offset enter linearly: for given shape and dead time their best values
    are a regression (variable projection, Golub and Pereyra 1973). Only a robust loss, for which
    that does not hold, has them as coordinates too, last.

    `threshold` is None for the sum of squares; else residuals r beyond it (in units of the
    output's range) count as Huber's (1964) loss: $2 k |r| - k^2$ instead of $r^2$. A `prior` adds
    rows to the residuals, which makes gain and offset coordinates too: it comes with a threshold.
    `range` is that of the output, the unit of the residuals.
    """

    record: AbstractRecord
    model: AbstractPlant
    weights: Samples
    fixed: tuple[str, ...] = eqx.field(static=True)
    range: Scalar
    threshold: Scalar | None = None
    prior: Prior | None = None

    @classmethod
    def of(
        cls, record: AbstractRecord, model: AbstractPlant, weights: Samples, fixed: tuple[str, ...]
    ) -> "Problem":
        """By squares; the range is found here, and not in each step of a search."""
        size = jax.lax.stop_gradient(jnp.max(record.y) - jnp.min(record.y))
        return cls(record, model, weights, fixed, size)

    # what is known and what is free

    @property
    def family(self) -> AbstractFamily:
        """Coordinates of the model's family."""
        return family_of(self.model)

    @property
    def known_levels(self) -> Levels:
        """What is known of gain and offset."""
        return Levels.of(self.record, self.model, self.fixed)

    @property
    def counted(self) -> Array:
        """Which rows the loss counts."""
        return self.weights > 0

    @property
    def free_delay(self) -> bool:
        """Whether the dead time is a coordinate."""
        return "delay" not in self.fixed

    @property
    def kinked(self) -> bool:
        """Whether the cost has a kink wherever the dead time meets a sample."""
        return self.family.kinked and self.free_delay and self.record.kinked

    @property
    def own_free(self) -> np.ndarray:
        """Which of the family's coordinates are free."""
        return np.array([name not in self.fixed for name in self.family.names])

    @property
    def individual(self) -> bool:
        """Whether the coordinates are lags, of which any can meet."""
        return self.family.individual and bool(self.own_free.all())

    @property
    def absent(self) -> Array | np.ndarray:
        """Which free own coordinates do not vary."""
        return self.family.absent[np.flatnonzero(self.own_free)]

    @property
    def delay_place(self) -> int:
        """Place of the dead time in a row of coordinates."""
        return int(self.own_free.sum())

    @property
    def free_scalars(self) -> tuple[ScalarParameter, ...]:
        """The free parameters, number by number."""
        levels = {"gain", "offset"} - self.known_levels.found_names
        known = set(self.fixed) | levels
        return tuple(x for x in self.model.scalars if x.name not in known)

    # coordinates

    def bounds(self) -> tuple[Array, Array]:
        """Bounds of the coordinates."""
        free = zip(self.family.bounds, self.own_free, strict=True)
        pairs = [pair for pair, kept in free if kept]
        pairs += [(0.0, LONGEST_DELAY)] * self.free_delay
        if self.threshold is not None:
            pairs += [(-np.inf, np.inf)] * self.known_levels.free
        lower, upper = jnp.asarray(np.array(pairs).reshape(-1, 2).T, self.record.t.dtype)
        own = self.delay_place
        if isinstance(self.absent, np.ndarray):  # constants serve the solver better
            return lower, upper
        return lower, upper.at[:own].set(jnp.where(self.absent, lower[:own], upper[:own]))

    def start(self) -> Array:
        """Coordinates of the model given; its levels are those of the regression."""
        duration, levels = self.record.duration, self.known_levels
        x = self.family.encode(duration)[np.flatnonzero(self.own_free)]
        if self.free_delay:
            x = jnp.append(x, self.model.delay / duration)
        lower, upper = self.bounds()
        x = jnp.clip(x.astype(lower.dtype), lower[: x.size], upper[: x.size])
        if self.threshold is not None:
            g = self.record.response(self.shape(x))
            offset, amplitude = levels.regression(self.record.y, self.weights, g)
            values = [offset - self.record.y[0], amplitude * self._size_of_response()]
            free = [levels.offset is None and levels.final is None, levels.gain is None]
            kept = jnp.stack(values)[np.flatnonzero(free)]
            x = jnp.append(x, kept / self.range)
        return jax.lax.stop_gradient(x)

    def _size_of_response(self) -> Scalar | float:
        """What a response of gain 1 grows to, so that a coordinate of the amplitude is about 1."""
        return 1.0 if self.model.settles else self.record.duration

    def second_start(self, x: Coordinates) -> "SecondStart | None":
        """Another place to start from where the optimum at x may not be the only one.

        None for models that have no other. It needs the dead time to be free.
        """
        duration, family = self.record.duration, self.family
        interval = duration / jnp.sum(self.record.after_step)
        if not self.free_delay or family.shape_name is None or family.shape_name in self.fixed:
            return None
        other = family.other_start(self._full(x), duration, interval)
        if other is None:
            return None
        own = jnp.stack(other.x)[np.flatnonzero(self.own_free)]
        delay = x[self.delay_place] + other.later / duration
        start = jnp.append(jnp.append(own, delay), jnp.asarray(x)[self.delay_place + 1 :])
        # a dead time that is too short already cannot make up for a longer lag
        worthwhile = other.worthwhile & (delay > 0)
        return SecondStart(jnp.clip(start, *self.bounds()), worthwhile)

    def _full(self, x: Coordinates) -> list[Array]:
        """All own coordinates, of which those at x are free."""
        if self.own_free.all():
            return [x[i] for i in range(self.own_free.size)]
        full = list(self.family.encode(self.record.duration).astype(self.record.t.dtype))
        for position, i in enumerate(np.flatnonzero(self.own_free)):
            full[i] = x[position]
        return full

    def shape(self, x: Coordinates, exact: bool = False) -> AbstractPlant:
        """Plant with gain 1 and offset 0 at coordinates; `exact` at the end of a range."""
        duration = self.record.duration
        own = self.family.decode(self._full(x), duration, exact)
        own |= {k: getattr(self.model, k) for k in own if k in self.fixed}
        order = getattr(self.model, "n", None)
        if order is not None:
            own.setdefault("n", order)
        delay = x[self.delay_place] * duration if self.free_delay else self.model.delay
        return type(self.model)(**own, delay=delay)

    def levels(self, x: Coordinates, g: Samples) -> tuple[Scalar, Scalar]:
        """Offset and amplitude (step size times gain) at coordinates, whose response is g."""
        known = self.known_levels
        if self.threshold is None or known.free == 0:
            return known.regression(self.record.y, self.weights, g, self.beside(x))
        first, last = x[self.delay_place + self.free_delay], x[-1]
        amplitude = last * self.range / self._size_of_response()
        if known.final is not None:
            return known.final - amplitude, amplitude
        offset = known.offset
        offset = self.record.y[0] + first * self.range if offset is None else offset
        return offset, amplitude if known.gain is None else known.step * known.gain

    def beside(self, x: Coordinates) -> Beside | None:
        """What moves the output beside the input, and the offset where it is to be found.

        None where there is nothing but the offset.
        """
        if not self.record.seeks_beside:
            return None
        columns = self.record.beside(self.shape(x))
        known = self.known_levels
        ones = [jnp.ones_like(self.record.y)] if known.offset is None else []
        return Beside.of(ones + columns, self.weights)

    # results

    def errors(self, x: Coordinates, g: Samples | None = None) -> Samples:
        """Weighted residuals over the range of the output; g is the response where it is known."""
        g = self.record.response(self.shape(x)) if g is None else g
        offset, amplitude = self.levels(x, g)
        rest, beside = self.record.y - offset - amplitude * g, self.beside(x)
        rest = rest if beside is None else beside.across(rest)
        return safe_sqrt(self.weights) * rest / self.range

    def residual(self, x: Coordinates, g: Samples | None = None) -> Array:
        """What is minimised, a row a sample and one a prior: the sum of its squares is the loss."""
        g = self.record.response(self.shape(x)) if g is None else g
        error = self.errors(x, g)
        error = error if self.threshold is None else huber_residual(error, self.threshold)
        if self.prior is None:
            return error
        return jnp.append(error, self.prior.rows(self._scaled(self.shape(x), x, g)))

    def loss(self, x: Coordinates, g: Samples | None = None) -> Scalar:
        """Sum of the squares of the residuals, in units of the range; g as in `errors`."""
        return jnp.sum(self.residual(x, g) ** 2)

    @property
    def first_near(self) -> Near:
        """Levels to begin a search with: off by no more than the range of the output."""
        return Near(self.record.y[0], jnp.zeros_like(self.record.y[0]))

    def products(
        self, x: Array, near: Near | None = None
    ) -> tuple[Float[Array, "k k"], Near, Scalar]:
        """Inner products of the derivatives of the residuals, and of themselves, last.

        They are computed from levels `near`, those at x where there are none, and come with what
        serves the next evaluation, and by how much the last may be wrong. A dead time and the
        logarithm of the unit of time both move the response along its slope.
        """
        own = np.flatnonzero(self.own_free)
        scaling = [k for k, i in enumerate(own) if self.family.scaling[i]]
        others = [k for k in range(own.size) if k not in scaling]
        plant, changes = self.shape(x), [self._change(k, x) for k in others]
        g, by_delay, by_unit, moved = self.record.response_slopes(plant, changes)
        moves = dict(zip(others, moved, strict=True)) | dict.fromkeys(scaling, by_unit)
        if self.free_delay:
            moves[self.delay_place] = self.record.duration * by_delay
        if self.threshold is None and not self.record.seeks_beside:
            near = still(Near(*self.levels(x, g))) if near is None else near
            rows = [moves[k] for k in range(x.size)]
            data = self.weights, self.record.y
            return self.known_levels.products(*data, g, rows, near, self.range)
        residual, change = jax.linearize(self.residual, x, g)
        unit, zero = jnp.eye(x.size, dtype=x.dtype), jnp.zeros_like(g)
        rows = [change(unit[k], moves.get(k, zero)) for k in range(x.size)]
        near = self.first_near if near is None else near
        return inner_products([*rows, residual]), near, jnp.zeros_like(g[0])

    def _change(self, k: int, x: Array) -> dict[str, Array]:
        """How the own parameters move with one coordinate."""

        def own(xk: Scalar) -> dict[str, Array]:
            values = self.family.decode(self._full(x.at[k].set(xk)), self.record.duration, False)
            return {name: value for name, value in values.items() if name not in self.fixed}

        return jax.jvp(own, (x[k],), (jnp.ones_like(x[k]),))[1]

    def plant(self, x: Coordinates) -> tuple[AbstractPlant, Samples]:
        """The whole model at coordinates, what is known exactly as given; and its response g."""
        shape, g = self.response(x)
        return self._scaled(shape, x, g), g

    def response(self, x: Coordinates) -> tuple[AbstractPlant, Samples]:
        """The plant at coordinates with gain 1 and offset 0, and its response g."""
        shape = self.shape(x, exact=True)
        return shape, self.record.response(shape)

    def _scaled(self, shape: AbstractPlant, x: Coordinates, g: Samples) -> AbstractPlant:
        """A plant of gain 1 and offset 0 with its levels."""
        offset, amplitude = self.levels(x, g)
        gain = self.known_levels.gain
        gain = amplitude / self.record.input_size if gain is None else gain
        beside = self.beside(x)
        if beside is not None and self.known_levels.offset is None:
            offset = beside.numbers(self.record.y - amplitude * g)[0]
        return eqx.tree_at(lambda m: (m.gain, m.offset), shape, (gain, offset))

    def with_found(self, details: dict[str, Array]) -> "Problem":
        """The problem whose record predicts with what was found beside the input, too."""
        return dataclasses.replace(self, record=self.record.with_found(details))

    def found_beside(self, x: Coordinates, model: AbstractPlant, g: Samples) -> dict[str, Array]:
        """Details of a model found at x: slope of a drift, numbers of the plant's own motion."""
        beside = self.beside(x)
        if beside is None:
            return {}
        amplitude = self.record.input_size * model.gain
        found = beside.numbers(self.record.y - amplitude * g)
        found = found[1:] if self.known_levels.offset is None else found
        return self.record.names_beside(found)

    # bounds

    def on_bound(self, x: Array) -> dict[str, Array]:
        """Whether each free parameter lies on a bound of its coordinate, a flag a number."""
        lower, upper = self.bounds()
        at = (x <= lower) | (x >= upper)
        own = [name for name, free in zip(self.family.names, self.own_free, strict=True) if free]
        flags = {name: at[i] for i, name in enumerate(own)}
        if self.individual:  # largest first; equal ones, and one that came out as 0
            lags = jnp.stack(list(x[: len(own)]))
            equal = (lags[1:] == lags[:-1]) & ~self.absent[1:]
            meets = jnp.append(equal, False) | jnp.append(False, equal)
            flags = {own[0]: jnp.logical_and(~self.absent, meets | at[: len(own)])}
        if self.free_delay:
            flags["delay"] = at[self.delay_place]
        return flags

    def at_bound(self, x: Array) -> Array:
        """The same, in the order of `free_scalars`; gain and offset have no bounds."""
        flags = self.on_bound(x)
        rows = [jnp.atleast_1d(flags.get(s.name, jnp.array(False))) for s in self.free_scalars]
        picked = [row[s.place or 0] for row, s in zip(rows, self.free_scalars, strict=True)]
        return jnp.stack(picked) if picked else jnp.zeros(0, bool)

    def settled_status(self, model: AbstractPlant, g: Samples) -> Status:
        """A warning where a gain to be found is extrapolated."""
        known = self.known_levels
        if known.gain is not None or known.final is not None:
            return Status.successful
        settled = self.model.has_settled(self.record.share_shown(model, g))
        return Status.where(settled, Status.successful, Status.not_settled)

    def bound_status(self, x: Array) -> Status:
        """A warning where an own parameter lies on a bound; no dead time is no warning."""
        status, flags = Status.successful, self.on_bound(x)
        flags.pop("delay", None)
        for place, (name, flag) in enumerate(flags.items()):
            reason = self.family.end_status(name, x[place])
            status = Status.where(jnp.any(flag), reason, status)
        return status


def problem_data(record: AbstractRecord, weights) -> tuple[Status, Any, Samples]:
    """Status of a record, the compact rows to fit, and their weights, 1 at most.

    `weights` are those given to a fit, in the place of the record's own.
    """
    status, safe = usable_record(with_weights(record, weights))
    if safe.weights is None:
        return status, safe, safe.present.astype(safe.y.dtype)
    return status, safe, safe.weights / jnp.max(safe.weights)


def least_loss(dtype, record: AbstractRecord) -> Scalar | float:
    """Sum of squares, in units of the range, that the accuracy of the responses allows."""
    return accuracy(dtype) ** 2 * record.count


def huber_residual(error: Samples, threshold: Scalar) -> Samples:
    """Number whose square is Huber's loss: the error itself up to the threshold."""
    size = jnp.abs(error)
    far = size > threshold
    root = jnp.sqrt(jnp.where(far, threshold * (2 * size - threshold), 1))
    return jnp.where(far, jnp.sign(error) * root, error)
