r"""Areas under a record that need no point of it, and the oscillation that can be read off them.

Integration averages noise: the area over a time of length a has a standard deviation of
$\sigma\sqrt{h a}$ for white noise $\sigma$ at the interval h. All areas up to any level are
differences of one running sum, so that a change of the level or of the dead time costs nothing.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._arrays import Count, Samples, Scalar
from ._record import StepRecord


TAIL = 0.15
"""Share of the record, at its end, whose mean is the first guess of the final level."""

MOST_LOBES = 24
"""Extrema of the integral signal that are used: of an oscillation that lasts longer, the first."""

FEWEST_LOBES = 2
"""Lobes that make an oscillation, an overshoot and an undershoot: one whole period."""

LOBE = 0.06
"""Area of a lobe that counts, over that of the rise from 20 %: the undershoot at zeta = 0.54.

At zeta = 0.5, where the oscillatory branch begins, it is 0.09; below that the errors decide."""

NOISE_LOBES = 4.0
"""The same in standard deviations of the noise's area over the time of a lobe."""

ALIKE = 0.35
"""How far a spacing of extrema may lie from their median in the same oscillation."""

MIDDLE = 0.28
"""From an extremum of the integral signal to where it passes its end, in periods.

That is 1/4 + arcsin(zeta)/(2 pi): 0.25 without damping and 0.33 at zeta = 0.5."""

ROUNDS = 4
"""Final level, times of the extrema and length of a lobe want each other: rounds until they fit."""


class RunningArea(NamedTuple):
    """Integral of the response from the step to any time, by the trapezoid rule.

    `t`: times of the rows from the step, `y`: the response there, `below`: the integral up to
    there, `end`: time of the last row that counts. The response is straight between rows.
    """

    t: Samples
    y: Samples
    below: Samples
    end: Scalar

    def __call__(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Integral from the step to times `x` within the record."""
        row = jnp.clip(jnp.searchsorted(self.t, x, side="right") - 1, 0, self.t.size - 2)
        past = x - self.t[row]
        slope = (self.y[row + 1] - self.y[row]) / (self.t[row + 1] - self.t[row])
        return self.below[row] + past * (self.y[row] + 0.5 * past * slope)

    def above(self, level: Scalar, a: Scalar, b: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Integral of `level` minus the response from `a` to `b`."""
        below = self(jnp.append(jnp.atleast_1d(b), a))
        return level * (b - a) - (below[:-1].reshape(jnp.shape(b)) - below[-1])

    def mean(self, a: Scalar, b: Scalar) -> Scalar:
        """Mean of the response from `a` to `b`."""
        first, last = self(jnp.stack([a, b]))
        return (last - first) / (b - a)

    def onset(self, level: Scalar, rows: Count | int) -> Scalar:
        """Time of the row up to which the response stays below `level` in the main.

        Where the sum of their difference is least, before the response is largest: noise moves the
        time as little as that of the monotone regression (see `crossing_times`).
        """
        y = jnp.sign(level) * self.y
        places = jnp.arange(y.size)
        rising = (places <= jnp.argmax(jnp.where(places < rows, y, -jnp.inf))) & (self.t >= 0)
        below = jnp.cumsum(jnp.where(rising, y - jnp.abs(level), 0))
        return self.t[jnp.argmin(jnp.where(rising, below, jnp.inf))]


def running_area(record: StepRecord, y: Samples) -> RunningArea:
    """Running area of `y`, a response with a row for each of a compact record; 0 before the step.

    The rows behind those that count stay at the last value and change nothing.
    """
    t = record.elapsed
    parts = 0.5 * jnp.diff(t) * (y[1:] + y[:-1])
    below = jnp.append(jnp.zeros_like(y[:1]), jnp.cumsum(parts))
    area = RunningArea(t, y, below, record.duration)
    return area._replace(below=below - area(jnp.zeros_like(record.duration)))


class Oscillation(NamedTuple):
    """What the extrema of the integral signal tell.

    `period`; `lobes`: how many extrema count; `level`: the final level, over whole periods where
    there is an oscillation, else over the tail; `start` and `end` of what it is the mean over.
    """

    period: Scalar
    lobes: Count
    level: Scalar
    start: Scalar
    end: Scalar


def oscillation(area: RunningArea, onset: Scalar, noise: Scalar, count: Count | int) -> Oscillation:
    r"""Period and final level of an oscillating record, by the extrema of its integral signal.

    The signal $I(t) = \int_0^t (K - y)$ has its extrema where the response passes its final level
    (Maxim, De Keyser, A.3.1). Those count that rise above the one before by `LOBE` of the area of
    the rise, from the `onset` on, or by `NOISE_LOBES` of the noise's. Of these the leading run
    counts whose spacings are `ALIKE`; twice the slope of their times is the period. K is then the
    mean over whole periods, half of those that the record has, between passages of the signal
    through its end, where the mean of a decaying oscillation is K too. Not meaningful below
    `FEWEST_LOBES`. `noise`: standard deviation of an integral over one unit of time.
    """
    level = area.mean(area.end - TAIL * area.end, area.end)

    def look(_, state):
        level, lobe, *_ = state
        signal = jnp.sign(level) * (level * area.t - area.below)
        signal = jnp.where(area.t >= 0, signal, -jnp.inf)
        signal = jnp.where(jnp.arange(signal.size) < count, signal, signal[count - 1])
        rise = jnp.max(signal) - jnp.sign(level) * (level * onset - area(onset))
        least = jnp.maximum(LOBE * jnp.abs(rise), NOISE_LOBES * noise * jnp.sqrt(lobe))
        rows, found = _turning_points(signal, least)
        times, used, spacing = _leading_run(area.t[rows], found)
        swings = used >= FEWEST_LOBES
        fitting = _whole_periods(area, times, used, level).level
        return jnp.where(swings, fitting, level), jnp.where(swings, spacing, lobe), times, used

    none = jnp.full(MOST_LOBES, jnp.nan, level.dtype)
    start = (level, (area.end - onset) / 10, none, jnp.zeros((), int))
    last, lobe, times, used = jax.lax.fori_loop(0, ROUNDS, look, jax.lax.stop_gradient(start))
    return _settled(area, jnp.where(used >= FEWEST_LOBES, last, level), times, used, lobe)


def _settled(
    area: RunningArea,
    level: Scalar,
    times: Float[Array, " lobes"],
    used: Count,
    lobe: Scalar,
) -> Oscillation:
    """Period and level for given extrema: their exact times depend on the level, a little."""

    def again(level, _):
        found = _whole_periods(area, _refined(area, level, times, lobe), used, level)
        return found.level, found

    _, found = jax.lax.scan(again, level, length=3)
    return jax.tree.map(lambda x: x[-1], found)


def _turning_points(signal: Samples, least: Scalar) -> tuple[Int[Array, " lobes"], Count]:
    """Rows of the extrema, a maximum first, that are left behind by at least `least`; how many."""

    def step(state, row):
        sign, extreme, place = state
        value = sign * signal[row]
        left = value < extreme - least
        further = value > extreme
        extreme = jnp.where(left, -value, jnp.maximum(extreme, value))
        moved = jnp.where(left | further, row, place)
        return (jnp.where(left, -sign, sign), extreme, moved), (left, place)

    rows = jnp.arange(signal.size)
    one = jnp.ones((), signal.dtype)
    _, (left, place) = jax.lax.scan(step, (one, -jnp.inf * one, rows[0]), rows)
    chosen = jnp.nonzero(left, size=MOST_LOBES, fill_value=0)[0]
    return place[chosen], jnp.minimum(jnp.sum(left), MOST_LOBES)


def _leading_run(
    times: Float[Array, " lobes"], found: Count
) -> tuple[Float[Array, " lobes"], Count, Scalar]:
    """Times of the leading extrema whose spacings are alike, NaN behind; how many; a spacing."""
    times = jnp.where(jnp.arange(times.size) < found, times, jnp.nan)
    spacings = jnp.diff(times)
    count = jnp.maximum(found - 1, 0)
    middle = jnp.sort(jnp.where(jnp.isnan(spacings), jnp.inf, spacings))[count // 2]
    middle = jnp.where(count > 0, middle, 1)
    alike = jnp.abs(spacings / middle - 1) <= ALIKE
    # how many are alike in a row, from the first on
    run = jnp.sum(jnp.cumprod(alike.astype(int)))
    used = jnp.where(found > 0, run + 1, 0)
    return jnp.where(jnp.arange(times.size) < used, times, jnp.nan), used, middle


def _refined(
    area: RunningArea, level: Scalar, times: Float[Array, " lobes"], spacing: Scalar
) -> Float[Array, " lobes"]:
    """Extrema by the parabola through areas a quarter of a lobe before and after.

    Every extremum of a decaying oscillation has the same shape: what the parabola misses moves all
    alike, and their spacing not at all.
    """
    times = jax.lax.stop_gradient(jnp.where(jnp.isnan(times), 0, times))
    reach = jax.lax.stop_gradient(jnp.minimum(0.25 * spacing, 0.25 * area.end))
    middle = jnp.clip(times, reach, area.end - reach)
    edges = jnp.stack([middle - reach, middle, middle + reach])
    before, after = level * reach - jnp.diff(area(edges), axis=0)
    bend = before - after
    moved = 0.5 * reach * (before + after) / jnp.where(bend == 0, 1, bend)
    return jnp.where(times > 0, middle + jnp.clip(moved, -reach, reach), jnp.nan)


def _whole_periods(
    area: RunningArea, times: Float[Array, " lobes"], used: Count, level: Scalar
) -> Oscillation:
    """Period by regression on the number of the extremum, and the level over whole periods."""
    known = jnp.isfinite(times)
    times = jnp.where(known, times, 0)
    index = jnp.arange(times.size, dtype=times.dtype)
    count = jnp.maximum(jnp.sum(known), 1).astype(times.dtype)
    centred = jnp.where(known, index - jnp.sum(jnp.where(known, index, 0)) / count, 0)
    spread = jnp.sum(centred**2)
    enough = used >= FEWEST_LOBES
    period = 2 * jnp.sum(centred * times) / jnp.where(spread > 0, spread, 1)
    period = jnp.where(enough & (period > 0), period, 1)
    # the running mean of a decaying oscillation is K between passages through its middle
    first = times[0] + MIDDLE * period
    available = (area.end - first) / period
    periods = jnp.floor(jnp.maximum(0.5 * available, 1))
    halves = jnp.floor(2 * (available - periods))
    start = first + jax.lax.stop_gradient(0.5 * halves) * period
    end = start + jax.lax.stop_gradient(periods) * period
    whole = enough & (available >= 1)
    start = jnp.where(whole, start, (1 - TAIL) * area.end)
    end = jnp.where(whole, end, area.end)
    return Oscillation(period, used, jnp.where(whole, area.mean(start, end), level), start, end)
