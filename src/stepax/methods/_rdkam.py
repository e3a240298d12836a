r"""The area methods of Maxim and De Keyser: first and second order plus dead time from areas.

A. Maxim, R. De Keyser, "Estimation of FOPDT and SOPDT models from noisy step response data"
(RDKAM); R. De Keyser, C. Muresan (2019) for the first branch. For each dead time the areas above
the response give a model; the one with the least squared error is kept. Equations as numbered
there, misprints set right (A10: the exponent is -alpha/Z; A.3.1: omega_n has sqrt(1 - zeta^2)).
"""

import functools
from typing import TypedDict, Unpack

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._arrays import Flag, Samples, Scalar
from .._result import Identification
from .._status import Status
from ..models._abstract import SETTLED
from ..records._areas import (
    FEWEST_LOBES,
    MOST_LOBES,
    TAIL,
    Oscillation,
    RunningArea,
    oscillation,
    running_area,
)
from ..records._preprocess import noise_of
from ..records._record import StepRecord
from ._rdkam_paper import paper_scan
from ._rdkam_scan import (
    BRANCH,
    Scanned,
    blocks,
    edges_of_periods,
    edges_of_rise,
    first_order_rest,
    first_order_shape,
    oscillatory_shape,
    scan,
    second_order_rest,
    second_order_shape,
)
from ._reading import OwnDelay, Reading, Span


PROTOCOLS = ("default", "paper")
"""Continuous damping and dead time, or grids and rules of the paper's listing."""

ONSET = 0.2
"""Share of the change by which the dead time is over."""

Number = Float[ArrayLike, ""] | None


class AreaOptions(TypedDict, total=False):
    """Options of the area methods.

    - `gain`: known gain of the plant; else the record's known final level, else its tail.
    - `min_delay`, `max_delay`: range of the dead time; None from the step to where the response
        has risen by a fifth.
    - `protocol`: "paper" does what the listing does (A.3.2): rectangle rule, dead times at
        samples up to the last but one, damping in steps of 0.01; for even sampling.
    - `span`: LOESS first.
    """

    gain: Number
    min_delay: Number
    max_delay: Number
    protocol: str
    span: Span


class Areas:
    """One record as the area methods read it; it lives inside one call.

    Responses are relative to a known final level, else to the largest deviation from the initial.
    """

    def __init__(self, record: StepRecord, options: AreaOptions):
        self.protocol = options.get("protocol", "default")
        if self.protocol not in PROTOCOLS:
            raise ValueError(f"protocol must be 'default' or 'paper', got {self.protocol!r}.")
        self.reading = Reading(record, options.get("span"), 0.0)
        gain = options.get("gain")
        asked = [options.get(name) for name in ("gain", "min_delay", "max_delay")]
        self._plain = all(x is None for x in asked)
        self.known = gain is not None or record.final is not None
        read = self._once("area", lambda: self._area(gain))
        self.scale, self.response, self.area, self.noise = read
        self.end = self.area.end
        self.level, self.onset = self._once("onset", self._level_and_onset)
        first, last = (None if x is None else jnp.asarray(x, self.end.dtype) for x in asked[1:])
        self.last = last
        self.low = jnp.zeros_like(self.end) if first is None else jnp.clip(first, 0, self.end)
        high = self.onset if last is None else jnp.minimum(last, self.onset)
        self.high = jnp.maximum(high, self.low)

    def _once(self, what: str, read):
        return self.reading.once(f"rdkam {what}", read) if self._plain else read()

    def _area(self, gain: Number) -> tuple[Scalar, Samples, RunningArea, Scalar]:
        """Unit of the response, the response in it, its running area, and the noise of that.

        The noise of an integral over a time a is this times the root of a.
        """
        reading, safe = self.reading, self.reading.safe
        away = jnp.where(safe.after_step, safe.y - reading.initial, 0)
        late = jnp.sum(jnp.where(safe.elapsed > 0.5 * safe.duration, away, 0))
        scale = jnp.where(late < 0, jnp.min(away), jnp.max(away))
        if gain is not None:
            scale = safe.step_size * gain
        elif reading.record.final is not None:
            scale = reading.final - reading.initial
        scale = jnp.where(scale == 0, 1, scale)
        response = jnp.where(safe.elapsed >= 0, (safe.y - reading.initial) / scale, 0)
        noise = noise_of(safe.t, safe.y, safe.count) / jnp.abs(scale)
        noise = noise * jnp.sqrt(safe.duration / jnp.sum(safe.after_step))
        return scale, response, running_area(safe, response), jax.lax.stop_gradient(noise)

    def _level_and_onset(self) -> tuple[Scalar, Scalar]:
        tail = self.area.mean((1 - TAIL) * self.end, self.end)
        level = jnp.ones_like(tail) if self.known else tail
        onset = self.area.onset(ONSET * level, self.reading.safe.count)
        return level, jax.lax.stop_gradient(onset)

    def oscillation(self, period: Number = None) -> Oscillation:
        """The oscillation of the record, with the level held where it is known.

        With a `period` given instead of the one read, its lobes last to the end of the record.
        """

        def read():
            found = oscillation(self.area, self.onset, self.noise, self.reading.safe.count)
            return found._replace(level=self.level) if self.known else found

        found = self._once("oscillation", read)
        if period is None:
            return found
        period = jnp.asarray(period, found.period.dtype)
        room = jnp.clip(jnp.floor((self.end - self.onset) / (0.5 * period)), 2, MOST_LOBES)
        lobes = jnp.where(found.lobes >= FEWEST_LOBES, found.lobes, room)
        return found._replace(period=period, lobes=lobes.astype(found.lobes.dtype))

    def scanned(self, shape, rest, found: Oscillation, low: Scalar, edges: Array) -> Scanned:
        """Scan with one shape of model."""
        parts, tail = blocks(self.area, edges), (found.start, found.end)
        level, high = found.level, self.high
        return scan(self.area, parts, shape, rest, level, self.known, tail, low, high)

    def rising(self, shape, rest, found: Oscillation) -> Scanned:
        """Scan of a response that rises once: first order, or the first branch."""
        edges = edges_of_rise(self.area, found.level, self.onset)
        return self.scanned(functools.partial(shape, self.area), rest, found, self.low, edges)

    def branches(self, found: Oscillation) -> Scanned:
        """Scans of both branches, stacked: one traced program does them in turn."""
        # an oscillation has no dead time more than half a period before its rise
        low = jax.lax.stop_gradient(jnp.minimum(self.onset, self.high) - 0.5 * found.period)
        low = jnp.minimum(jnp.maximum(self.low, low), self.high)
        lobes = jnp.maximum(found.lobes, FEWEST_LOBES).astype(low.dtype)
        shapes = [
            functools.partial(second_order_shape, self.area, least_damping=BRANCH),
            functools.partial(oscillatory_shape, self.area, period=found.period, lobes=lobes),
        ]

        def branch(case):
            place, low, edges = case
            shape = lambda *x: jax.lax.switch(place, shapes, *x)  # noqa: E731
            return self.scanned(shape, second_order_rest, found, low, edges)

        rise = edges_of_rise(self.area, found.level, self.onset)
        edges = jnp.stack([rise, edges_of_periods(self.area, low, found.period)])
        lows = jnp.stack([self.low, low])
        return self._once("branches", lambda: jax.lax.map(branch, (np.arange(2), lows, edges)))

    def response_of(self, found: Scanned) -> Samples:
        """Response of a model at the rows."""
        return found.shape.plant.unit_response(self.area.t - found.delay)

    def error(self, found: Scanned, response: Samples) -> Scalar:
        """Squared error over the rows."""
        rows = self.reading.safe.after_step
        square = jnp.sum(jnp.where(rows, self.response - found.level * response, 0) ** 2)
        return jnp.where(found.shape.usable & jnp.isfinite(square), square, jnp.inf)

    def _still_moving(self) -> Flag:
        """Whether the tail differs from what is before it, by more than 5 % and its noise."""
        width = TAIL * self.end
        before = self.area.mean(self.end - 2 * width, self.end - width)
        apart = jnp.abs(self.area.mean(self.end - width, self.end) - before)
        return apart > (1 - SETTLED) * jnp.abs(before) + 4 * self.noise / jnp.sqrt(width)

    def conclude(
        self, found: Scanned, response: Samples | None = None, **details
    ) -> Identification:
        """The result of a scan."""
        reading, shape = self.reading, found.shape
        response = self.response_of(found) if response is None else response
        good = shape.usable & jnp.isfinite(found.level) & (found.level != 0)
        status = Status.where(good, Status.successful, Status.invalid_moments)
        statuses = [status, Status.where(shape.beyond, Status.at_curve_end, Status.successful)]
        if not self.known:
            settled = shape.plant.has_settled(response[reading.safe.last]) & ~self._still_moving()
            statuses.append(Status.where(settled, Status.successful, Status.not_settled))
        reading.final = reading.initial + found.level * self.scale
        own = OwnDelay(found.delay, found.delay, Status.successful)
        return reading.conclude(shape.plant, *statuses, own=own, response=response, **details)


def rdkam_fopdt(record: StepRecord, **options: Unpack[AreaOptions]) -> Identification:
    r"""First order plus dead time by one area (Maxim, De Keyser, eq. 5): $T = A/K$.

    $A = \int_L (K - y)\,dt$ for every dead time L; the one with the least squared error is kept.
    K is the level of the tail, of an oscillation over whole periods, what the model lacks there
    allowed for. **Options** as in `AreaOptions`. **Status:** no dead time with a positive area
    refuses with `invalid_moments`; a record that ends below 95 % of the change warns with
    `not_settled`. Standard errors are NaN: the method has none.
    """
    areas = Areas(record, options)
    if areas.protocol == "paper":
        return areas.conclude(paper_scan(areas, "first"))
    return areas.conclude(areas.rising(first_order_shape, first_order_rest, areas.oscillation()))


def rdkam_sopdt(
    record: StepRecord, *, real_poles: bool = False, **options: Unpack[AreaOptions]
) -> Identification:
    r"""Second order plus dead time by two areas (Maxim, De Keyser, eq. 11 to 14).

    $\tau = A/K$ is the sum of the lags, and the largest area S between the response and that of one
    lag $\tau$ tells the damping: S/A (`area_ratio`). Then $\omega_n = 2\zeta/\tau$.

    **Range:** zeta from 0.5, with `real_poles` from 1, to 3; outside the end is taken, with the
    warning `at_curve_end`. Above about 2 the damping is hardly determined: a change of S/A by 0.001
    moves it by 0.04 there, by 0.14 at 3. Options and further status as in `rdkam_fopdt`.
    """
    areas = Areas(record, options)
    if areas.protocol == "paper":
        return areas.conclude(paper_scan(areas, "real" if real_poles else "rising"))
    least = 1.0 if real_poles else BRANCH
    shape = functools.partial(second_order_shape, least_damping=least)
    return areas.conclude(areas.rising(shape, second_order_rest, areas.oscillation()))


def rdkam_oscillatory(
    record: StepRecord, *, period: Number = None, **options: Unpack[AreaOptions]
) -> Identification:
    r"""Second order plus dead time of a plant that oscillates (Maxim, De Keyser, eq. 17 to 22).

    The area of all lobes tells the damping (`lobe_area`, for a record of any length), the `period`
    the frequency, $\omega_n = 2\pi/(T_p\sqrt{1-\zeta^2})$. Each lobe is integrated with its sign:
    the paper's $|K - y|$ rectifies noise. By default the period is read off the extrema of the
    integral signal.

    **Range:** zeta from 0.01 to 0.5, outside the end is taken, with the warning `at_curve_end`.
    **Status:** a record without a period, an overshoot and an undershoot, refuses with
    `levels_not_crossed`. Options and further status as in `rdkam_fopdt`.
    """
    areas = Areas(record, options)
    found = areas.oscillation(period)
    swings = _swings(found, period)
    status = Status.where(swings, Status.successful, Status.levels_not_crossed)
    areas.reading.remember(status, period=found.period, lobes=found.lobes)
    if areas.protocol == "paper":
        return areas.conclude(paper_scan(areas, "oscillatory", found.period))
    return areas.conclude(_branch(areas.branches(found), 1))


def rdkam(
    record: StepRecord, *, period: Number = None, **options: Unpack[AreaOptions]
) -> Identification:
    r"""Second order plus dead time from areas, the branch chosen by itself.

    `rdkam_sopdt`, and where the record has an overshoot and an undershoot `rdkam_oscillatory` too;
    the smaller squared error is kept. Among the `details`: `period`, `lobes`, and whether the model
    is `oscillatory`. Options and status as in these two; `protocol="paper"` is oscillatory if a
    `period` is given, as in the listing.
    """
    if options.get("protocol") == "paper":
        if period is None:
            return rdkam_sopdt(record, **options)
        return rdkam_oscillatory(record, period=period, **options)
    areas = Areas(record, options)
    found = areas.oscillation(period)
    swings = _swings(found, period)
    both = areas.branches(found)
    rising, swinging = _branch(both, 0), _branch(both, 1)
    responses = [areas.response_of(rising), areas.response_of(swinging)]
    better = areas.error(swinging, responses[1]) < areas.error(rising, responses[0])
    oscillates = swings & better
    pick = lambda a, b: jnp.where(oscillates, a, b)  # noqa: E731
    best = jax.tree.map(pick, swinging, rising)
    period_ = jnp.where(swings, found.period, jnp.nan)
    details = {"period": period_, "lobes": found.lobes, "oscillatory": oscillates}
    return areas.conclude(best, pick(*responses[::-1]), **details)


def _swings(found: Oscillation, period: Number) -> Flag:
    """Whether there is an oscillation to identify: one that was found, or is known."""
    return found.lobes >= FEWEST_LOBES if period is None else jnp.ones((), bool)


def _branch(both: Scanned, place: int) -> Scanned:
    return jax.tree.map(lambda x: x[place], both)
