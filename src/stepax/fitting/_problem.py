"""One least-squares problem: the data, what is known, and the coordinates of the rest."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arrays import Coordinates, Samples, Scalar, safe_sqrt
from .._status import Status
from ..models._contour import accuracy
from ..models._plants import FOPDT, AbstractPlant, Hudzovic, PTn, Sani, parameter_names
from ..records._record import MIN_SAMPLES, StepRecord
from ._families import Family, family_of, present_lags


SETTLED = 0.95
"""Share of the change that a record must show for its gain not to count as extrapolated."""

LONGEST_DELAY = 0.95
"""Largest dead time, relative to the length of the record."""

FEW_SAMPLES = 6
"""Length of a second lag, in sampling intervals, from which on it has one optimum."""


class Fit(eqx.Module):
    r"""Residuals of a record as a function of a few coordinates.

    A row of coordinates holds the free own parameters (see `_coordinates`), then the dead time
    over the duration. Gain and offset enter linearly: for given shape and dead time their best
    values are a regression (variable projection, Golub and Pereyra 1973). Only a robust loss, for
    which that does not hold, has them as coordinates too, last.

    `threshold` is None for the sum of squares; else residuals r beyond it (in units of the
    output's range) count as Huber's (1964) loss: $2 k |r| - k^2$ instead of $r^2$.
    """

    record: StepRecord
    model: AbstractPlant
    weights: Samples
    fixed: tuple[str, ...] = eqx.field(static=True)
    threshold: Scalar | None = None

    # what is known and what is free

    @property
    def family(self) -> Family:
        """Coordinates of the model's family."""
        return family_of(self.model)

    @property
    def duration(self) -> Scalar:
        """Length of the record after the step, the unit of time of the coordinates."""
        return self.record.t[-1] - self.record.step_time

    @property
    def range(self) -> Scalar:
        """Range of the output, the unit of the residuals."""
        return jax.lax.stop_gradient(jnp.max(self.record.y) - jnp.min(self.record.y))

    @property
    def offset(self) -> Scalar | None:
        """The offset where it is known."""
        if "offset" in self.fixed:
            return jnp.asarray(self.model.offset, self.record.y.dtype)
        if self.record.initial is None and self.record.final is not None and "gain" in self.fixed:
            return self.record.final - self.record.step_size * self.model.gain
        return self.record.initial

    @property
    def gain(self) -> Scalar | None:
        """The gain where it is known."""
        if "gain" in self.fixed:
            return jnp.asarray(self.model.gain, self.record.y.dtype)
        if self.record.final is not None and self.offset is not None:
            return (self.record.final - self.offset) / self.record.step_size
        return None

    @property
    def final(self) -> Scalar | None:
        """The final level where it ties gain and offset, neither being known."""
        return self.record.final if final_level_ties(self.record, self.fixed) else None

    @property
    def free_delay(self) -> bool:
        """Whether the dead time is a coordinate."""
        return "delay" not in self.fixed

    @property
    def kinked(self) -> bool:
        """Whether the cost has a kink wherever the dead time meets a sample."""
        single = isinstance(self.model, FOPDT) or (
            isinstance(self.model, PTn) and self.model.lags.shape == (1,)
        )
        return single and self.free_delay

    @property
    def own_free(self) -> np.ndarray:
        """Which of the family's coordinates are free."""
        names = self.family.names
        if names == ("lags",):
            names = names * len(self.family.bounds)
        return np.array([name not in self.fixed for name in names])

    @property
    def individual(self) -> bool:
        """Whether the coordinates are lags, of which any can meet."""
        return isinstance(self.model, PTn) and "lags" not in self.fixed

    @property
    def absent(self) -> Array:
        """Which free own coordinates belong to lags of 0: those do not vary."""
        if self.individual:
            return ~present_lags(self.model)
        return jnp.zeros(int(self.own_free.sum()), bool)

    @property
    def delay_place(self) -> int:
        """Place of the dead time in a row of coordinates."""
        return int(self.own_free.sum())

    @property
    def free_levels(self) -> int:
        """Number of levels, offset and amplitude, that a regression would find."""
        if self.final is not None:
            return 1
        return (self.offset is None) + (self.gain is None)

    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters, lags counted one by one."""
        known = set(self.fixed)
        known |= {"offset"} if self.offset is not None or self.final is not None else set()
        known |= {"gain"} if self.gain is not None else set()
        names: list[str] = []
        for name in parameter_names(self.model):
            if name == "lags" and name not in known:
                names += [f"lags[{k}]" for k in range(jnp.size(getattr(self.model, name)))]
            elif name not in known:
                names.append(name)
        return tuple(names)

    # coordinates

    def _shift(self) -> Array:
        return jnp.asarray(self.family.time_powers, self.record.t.dtype) * jnp.log(self.duration)

    def bounds(self) -> tuple[Array, Array]:
        """Bounds of the coordinates."""
        free = zip(self.family.bounds, self.own_free, strict=True)
        pairs = [pair for pair, kept in free if kept]
        pairs += [(0.0, LONGEST_DELAY)] * self.free_delay
        if self.threshold is not None:
            pairs += [(-np.inf, np.inf)] * self.free_levels
        lower, upper = jnp.asarray(np.array(pairs).reshape(-1, 2).T, self.record.t.dtype)
        own = int(self.own_free.sum())
        return lower, upper.at[:own].set(jnp.where(self.absent, lower[:own], upper[:own]))

    def start(self) -> Array:
        """Coordinates of the model given; its levels are those of the regression."""
        x = (self.family.encode(self.model) - self._shift())[np.flatnonzero(self.own_free)]
        if self.free_delay:
            x = jnp.append(x, self.model.delay / self.duration)
        lower, upper = self.bounds()
        x = jnp.clip(x.astype(lower.dtype), lower[: x.size], upper[: x.size])
        if self.threshold is not None:
            g = self.shape(x).step_response(self.elapsed)
            offset, amplitude = self._regression(g)
            levels = jnp.stack([offset - self.record.y[0], amplitude]) / self.range
            free = np.array([self.offset is None and self.final is None, self.gain is None])
            x = jnp.append(x, levels[np.flatnonzero(free)])
        return jax.lax.stop_gradient(x)

    def second_start(self, x: Coordinates) -> Coordinates | None:
        """Another place to start from where the optimum at x may not be the only one.

        With the dead time free, a second lag shorter than some samples can trade places with it:
        there the lag is half a sampling interval, and the dead time makes up for it. Elsewhere x
        itself; None for models that have no such lag.
        """
        shortened = self.family.shortened
        if shortened is None or {"r", "zeta", "lags"} & set(self.fixed) or not self.free_delay:
            return None
        interval = self.duration / jnp.sum(self.record.after_step)
        full, before = shortened(self._full(x), self.model, interval / 2)
        delay = x[self.delay_place] + (before - interval / 2) / self.duration
        own = (jnp.stack(full) - self._shift())[np.flatnonzero(self.own_free)]
        other = jnp.append(own, delay)
        other = jnp.append(other, jnp.asarray(x)[self.delay_place + 1 :])
        short = before < FEW_SAMPLES * interval
        return jnp.where(short, jnp.clip(other, *self.bounds()), jnp.asarray(x))

    def _full(self, x: Coordinates) -> list[Array]:
        """All own coordinates, in the unit of time of the record."""
        full = list(self.family.encode(self.model).astype(self.record.t.dtype))
        shift = self._shift()
        for position, i in enumerate(np.flatnonzero(self.own_free)):
            full[i] = x[position] + shift[i]
        return full

    def shape(self, x: Coordinates, exact: bool = False) -> AbstractPlant:
        """Plant with gain 1 and offset 0 at coordinates; `exact` at the end of a range."""
        own = self.family.decode(self._full(x), self.model, exact)
        own |= {k: getattr(self.model, k) for k in own if k in self.fixed}
        order = getattr(self.model, "n", None)
        if order is not None:
            own.setdefault("n", order)
        delay = x[self.delay_place] * self.duration if self.free_delay else self.model.delay
        return type(self.model)(**own, delay=delay)

    # levels

    def levels(self, x: Coordinates, g: Samples) -> tuple[Scalar, Scalar]:
        """Offset and amplitude (step size times gain) at coordinates, whose response is g."""
        if self.threshold is None or self.free_levels == 0:
            return self._regression(g)
        first, last = x[self.delay_place + self.free_delay], x[-1]
        amplitude = last * self.range
        if self.final is not None:
            return self.final - amplitude, amplitude
        offset = self.record.y[0] + first * self.range if self.offset is None else self.offset
        gain = self.gain
        return offset, amplitude if gain is None else self.record.step_size * gain

    def _regression(self, g: Samples) -> tuple[Scalar, Scalar]:
        y, w, step = self.record.y, self.weights, self.record.step_size
        offset, gain, final = self.offset, self.gain, self.final
        if offset is not None and gain is not None:
            return offset, step * gain
        if gain is not None:
            return jnp.sum(w * (y - step * gain * g)) / jnp.sum(w), step * gain
        if offset is not None:
            return offset, _slope(w, g, y - offset)
        if final is not None:
            amplitude = _slope(w, g - 1, y - final)
            return final - amplitude, amplitude
        mean_g, mean_y = jnp.sum(w * g) / jnp.sum(w), jnp.sum(w * y) / jnp.sum(w)
        amplitude = _slope(w, g - mean_g, y - mean_y)
        return mean_y - amplitude * mean_g, amplitude

    # results

    def errors(self, x: Coordinates, g: Samples | None = None) -> Samples:
        """Weighted residuals over the range of the output; g is the response where it is known."""
        g = self.shape(x).step_response(self.elapsed) if g is None else g
        offset, amplitude = self.levels(x, g)
        return safe_sqrt(self.weights) * (self.record.y - offset - amplitude * g) / self.range

    def residual(self, x: Coordinates, g: Samples | None = None) -> Samples:
        """What is minimised: the sum of its squares is the loss."""
        error = self.errors(x, g)
        return error if self.threshold is None else huber_residual(error, self.threshold)

    def linearised(self, x: Array) -> tuple[Samples, list[Samples]]:
        """Residuals, and their derivative in each coordinate.

        A dead time and the logarithm of the unit of time both move the response along its slope,
        which is found once. The barriers keep XLA from sharing subexpressions between derivatives:
        on a CPU that breaks one pass over the data into many.
        """
        barrier = jax.lax.optimization_barrier
        own = np.flatnonzero(self.own_free)
        scaling = [k for k, i in enumerate(own) if self.family.time_powers[i]]
        g = barrier(self.shape(x).step_response(self.elapsed))
        moves = [jnp.zeros_like(g)] * x.size
        for k in range(own.size):
            if k not in scaling:
                moves[k] = barrier(self._move(k, barrier(x)))
        if scaling or self.free_delay:
            plant = self.shape(barrier(x))
            since = self.elapsed - plant.delay
            slope = barrier(jax.jvp(plant.unit_response, (since,), (jnp.ones_like(since),))[1])
            for k in scaling:
                moves[k] = -since * slope
            if self.free_delay:
                moves[self.delay_place] = -self.duration * slope
        residual, change = jax.linearize(self.residual, x, g)
        unit = jnp.eye(x.size, dtype=x.dtype)
        return residual, [change(unit[k], move) for k, move in enumerate(moves)]

    def _move(self, k: int, x: Array) -> Samples:
        """Derivative of the response in one coordinate."""

        def response(xk):
            return self.shape(x.at[k].set(xk)).step_response(self.elapsed)

        return jax.jvp(response, (x[k],), (jnp.ones_like(x[k]),))[1]

    @property
    def elapsed(self) -> Samples:
        """Times since the step."""
        return self.record.t - self.record.step_time

    def plant(self, x: Coordinates) -> tuple[AbstractPlant, Samples]:
        """The whole model at coordinates, what is known exactly as given; and its response g."""
        shape = self.shape(x, exact=True)
        g = shape.step_response(self.elapsed)
        offset, amplitude = self.levels(x, g)
        gain = amplitude / self.record.step_size if self.gain is None else self.gain
        return eqx.tree_at(lambda m: (m.gain, m.offset), shape, (gain, offset)), g

    def on_bound(self, x: Array) -> dict[str, Array]:
        """Whether each free parameter lies on a bound of its coordinate."""
        lower, upper = self.bounds()
        at = (x <= lower) | (x >= upper)
        own = self.own_free
        if self.family.names == ("lags",):
            flags = {}
            if own.any():  # largest first; equal ones, and one that came out as 0
                lags = jnp.stack(list(x[: own.size]))
                equal = (lags[1:] == lags[:-1]) & ~self.absent[1:]
                meets = jnp.append(equal, False) | jnp.append(False, equal)
                flags = {"lags": ~self.absent & (meets | at[: own.size])}
        else:
            names = [name for name, kept in zip(self.family.names, own, strict=True) if kept]
            flags = {name: at[i] for i, name in enumerate(names)}
        if self.free_delay:
            flags["delay"] = at[self.delay_place]
        return flags

    def at_bound(self, x: Array) -> Array:
        """The same, in the order of `free_names`."""
        stuck = self.on_bound(x)
        flags = [
            stuck.get("lags", jnp.zeros(0, bool))[int(name[5:-1])]
            if name.startswith("lags[")
            else stuck.get(name, jnp.array(False))
            for name in self.free_names()
        ]
        return jnp.stack(flags) if flags else jnp.zeros(0, bool)

    def settled_status(self, g: Samples) -> Status:
        """A warning where a gain to be found is extrapolated."""
        if self.gain is not None or self.final is not None:
            return Status.successful
        return Status.where(g[-1] < SETTLED, Status.not_settled, Status.successful)

    def bound_status(self, x: Array) -> Status:
        """A warning where an own parameter lies on a bound; no dead time is no warning."""
        stuck = self.on_bound(x)
        own = [jnp.any(flag) for name, flag in stuck.items() if name != "delay"]
        if not own:
            return Status.successful
        status = Status.where(jnp.any(jnp.stack(own)), Status.at_bound, Status.successful)
        if isinstance(self.model, Hudzovic | Sani) and "r" in stuck:
            contrast = x[int(self.own_free[0])]
            status = Status.where(contrast <= 0, Status.at_equal_lags, status)
            if isinstance(self.model, Sani):
                status = Status.where(contrast >= 1, Status.at_first_order, status)
        return status


def final_level_ties(record: StepRecord, fixed) -> bool:
    """Whether a known final level ties gain and offset, neither being known."""
    return (
        record.final is not None
        and record.initial is None
        and "gain" not in fixed
        and "offset" not in fixed
    )


def weights_of(record: StepRecord, weights) -> Samples:
    """Weights of the rows of a record, 1 at most, or of its stand-in where that is too short."""
    size = max(record.y.size, MIN_SAMPLES)
    if weights is None:
        return jnp.ones(size, record.y.dtype)
    weights = jnp.asarray(weights, record.y.dtype)
    if weights.shape not in ((), record.y.shape):
        raise ValueError(
            f"weights need one value per row of the record, {record.y.size}, got {weights.size}."
        )
    largest = jnp.max(weights)
    weights = weights / jnp.where(largest > 0, largest, 1)
    ones = jnp.ones(size, record.y.dtype)
    return weights * ones if weights.shape in ((), (size,)) else ones


def least_loss(dtype, record: StepRecord) -> float:
    """Sum of squares, in units of the range, that the accuracy of the responses allows."""
    return accuracy(dtype) ** 2 * record.y.size


def huber_residual(error: Samples, threshold: Scalar) -> Samples:
    """Number whose square is Huber's loss: the error itself up to the threshold."""
    size = jnp.abs(error)
    far = size > threshold
    root = jnp.sqrt(jnp.where(far, threshold * (2 * size - threshold), 1))
    return jnp.where(far, jnp.sign(error) * root, error)


def _slope(w: Samples, x: Samples, y: Samples) -> Scalar:
    """Slope of the weighted regression of y on x through 0."""
    square = jnp.sum(w * x * x)
    return jnp.sum(w * x * y) / jnp.where(square > 0, square, 1)
