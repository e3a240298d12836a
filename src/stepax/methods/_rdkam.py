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
from jaxtyping import ArrayLike, Float

from .._arrays import Samples, Scalar
from .._result import Identification
from .._status import Status
from ..records._areas import (
    FEWEST_LOBES,
    MOST_LOBES,
    TAIL,
    Oscillation,
    RunningArea,
    oscillation,
    running_area,
)
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
        self.reading = reading = Reading(record, options.get("span"), 0.0)
        safe, gain = reading.safe, options.get("gain")
        self.known = gain is not None or record.final is not None
        away = jnp.where(safe.after_step, safe.y - reading.initial, 0)
        late = jnp.sum(jnp.where(safe.elapsed > 0.5 * safe.duration, away, 0))
        scale = jnp.where(late < 0, jnp.min(away), jnp.max(away))
        if gain is not None:
            scale = safe.step_size * gain
        elif record.final is not None:
            scale = reading.final - reading.initial
        self.scale = jnp.where(scale == 0, 1, scale)
        self.response = jnp.where(safe.elapsed >= 0, (safe.y - reading.initial) / self.scale, 0)
        self.area = running_area(safe, self.response)
        tail = self.area.mean((1 - TAIL) * self.area.end, self.area.end)
        self.level = jnp.ones_like(tail) if self.known else tail
        onset = self.area.onset(ONSET * self.level, safe.count)
        self.onset = jax.lax.stop_gradient(onset)
        asked = [options.get(name) for name in ("min_delay", "max_delay")]
        first, last = (None if x is None else jnp.asarray(x, tail.dtype) for x in asked)
        self.last = last
        self.high = self.onset if last is None else jnp.clip(last, 0, self.area.end)
        self.low = 0 * self.high if first is None else jnp.clip(first, 0, self.area.end)
        self.high = jnp.maximum(self.high, self.low)

    def oscillation(self) -> Oscillation:
        """The oscillation of the record, with the level held where it is known."""
        found = oscillation(self.area, self.onset, self.reading.safe.count)
        return found._replace(level=self.level) if self.known else found

    def rising(self, shape, rest) -> Scanned:
        """Scan of a response that rises once: first order, or the first branch."""
        parts = blocks(self.area, edges_of_rise(self.area, self.level, self.onset))
        shape, tail = functools.partial(shape, self.area), ((1 - TAIL) * self.area.end, self.area.end)
        return scan(
            self.area, parts, shape, rest, self.level, self.known, tail, self.low, self.high
        )

    def swinging(self, found: Oscillation) -> Scanned:
        """Scan of an oscillating response."""
        low = self._before_swing(found)
        parts = blocks(self.area, edges_of_periods(self.area, low, found.period))
        shape, level = self._swing(found), found.level
        return scan(
            self.area, parts, shape, second_order_rest, level, self.known, (found.start, found.end), low,
            self.high,
        )  # fmt: skip

    def both(self, found: Oscillation) -> Scanned:
        """Scans of both branches, stacked: one traced program does them in turn."""
        level, swing = found.level, self._swing(found)
        rise = functools.partial(second_order_shape, self.area, least_damping=BRANCH)
        lows = jnp.stack([self.low, self._before_swing(found)])
        edges = jnp.stack([
            edges_of_rise(self.area, level, self.onset),
            edges_of_periods(self.area, lows[1], found.period),
        ])  # fmt: skip

        def branch(case):
            place, low, edges = case
            shape = lambda *x: jax.lax.switch(place, [rise, swing], *x)  # noqa: E731
            parts = blocks(self.area, edges)
            return scan(
                self.area, parts, shape, second_order_rest, level, self.known, (found.start, found.end), low,
                self.high,
            )  # fmt: skip

        return jax.lax.map(branch, (np.arange(2), lows, edges))

    def _swing(self, found: Oscillation):
        lobes = jnp.maximum(found.lobes, FEWEST_LOBES).astype(found.period.dtype)
        return functools.partial(oscillatory_shape, self.area, period=found.period, lobes=lobes)

    def _before_swing(self, found: Oscillation) -> Scalar:
        """Earliest dead time of an oscillation: half a period before the rise."""
        low = jax.lax.stop_gradient(jnp.minimum(self.onset, self.high) - 0.5 * found.period)
        return jnp.minimum(jnp.maximum(self.low, low), self.high)

    def response_of(self, found: Scanned) -> Samples:
        """Response of a model at the rows."""
        return found.shape.plant.unit_response(self.area.t - found.delay)

    def error(self, found: Scanned, response: Samples) -> Scalar:
        """Squared error over the rows."""
        rows = self.reading.safe.after_step
        square = jnp.sum(jnp.where(rows, self.response - found.level * response, 0) ** 2)
        return jnp.where(found.shape.usable & jnp.isfinite(square), square, jnp.inf)

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
            settled = shape.plant.has_settled(response[reading.safe.last])
            statuses.append(Status.where(settled, Status.successful, Status.not_settled))
        reading.final = reading.initial + found.level * self.scale
        own = OwnDelay(found.delay, found.delay, Status.successful)
        return reading.conclude(shape.plant, *statuses, own=own, response=response, **details)


def rdkam_fopdt(record: StepRecord, **options: Unpack[AreaOptions]) -> Identification:
    r"""First order plus dead time by one area (Maxim, De Keyser, eq. 5): $T = A/K$.

    $A = \int_L (K - y)\,dt$ for every dead time L; the one with the least squared error is kept.
    K is the level of the tail, what the model lacks there allowed for. **Options** as in
    `AreaOptions`. **Status:** no dead time with a positive area refuses with `invalid_moments`;
    a record that ends below 95 % of the change warns with `not_settled`. Standard errors are NaN:
    the method has none.
    """
    areas = Areas(record, options)
    if areas.protocol == "paper":
        return areas.conclude(paper_scan(areas, "first"))
    return areas.conclude(areas.rising(first_order_shape, first_order_rest))


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
    least = 1.0 if real_poles else BRANCH
    if areas.protocol == "paper":
        return areas.conclude(paper_scan(areas, "real" if real_poles else "rising"))
    shape = functools.partial(second_order_shape, least_damping=least)
    return areas.conclude(areas.rising(shape, second_order_rest))


def rdkam_oscillatory(
    record: StepRecord, *, period: Number = None, **options: Unpack[AreaOptions]
) -> Identification:
    r"""Second order plus dead time of a plant that oscillates (Maxim, De Keyser, eq. 17 to 22).

    The area of all lobes tells the damping (`lobe_area`, for a record of any length), the `period`
    the frequency, $\omega_n = 2\pi/(T_p\sqrt{1-\zeta^2})$. Each lobe is integrated with its sign:
    the paper's $|K - y|$ rectifies noise. By default the period is read off the extrema of the
    integral signal, and K is the mean over whole periods.

    **Range:** zeta from 0.01 to 0.5, outside the end is taken, with the warning `at_curve_end`.
    **Status:** a record without a period, an overshoot and an undershoot, refuses with
    `levels_not_crossed`. Options and further status as in `rdkam_fopdt`.
    """
    areas = Areas(record, options)
    if areas.protocol == "paper":
        found = areas.oscillation()
        period_ = found.period if period is None else jnp.asarray(period, found.period.dtype)
        swings = _swings(found, period)
        return _swinging(areas, paper_scan(areas, "oscillatory", period_), period_, found, swings)
    found = _with_period(areas, areas.oscillation(), period)
    swings = _swings(found, period)
    return _swinging(areas, areas.swinging(found), found.period, found, swings)


def rdkam(
    record: StepRecord, *, period: Number = None, **options: Unpack[AreaOptions]
) -> Identification:
    r"""Second order plus dead time from areas, the branch chosen by itself.

    `rdkam_sopdt`, and where the record has an overshoot and an undershoot `rdkam_oscillatory` too;
    the smaller squared error is kept. K is then the mean over whole periods in both. Among the
    `details`: `period`, `lobes`, and whether the model is `oscillatory`. Options and status as in
    these two; `protocol="paper"` is oscillatory if a `period` is given, as in the listing.
    """
    areas = Areas(record, options)
    if areas.protocol == "paper":
        if period is None:
            return areas.conclude(paper_scan(areas, "rising"))
        return rdkam_oscillatory(record, period=period, **options)
    found = _with_period(areas, areas.oscillation(), period)
    swings = _swings(found, period)
    both = areas.both(found)
    rising, swinging = jax.tree.map(lambda x: x[0], both), jax.tree.map(lambda x: x[1], both)
    responses = [areas.response_of(rising), areas.response_of(swinging)]
    better = areas.error(swinging, responses[1]) < areas.error(rising, responses[0])
    oscillates = swings & better
    pick = lambda a, b: jnp.where(oscillates, a, b)  # noqa: E731
    best = jax.tree.map(pick, swinging, rising)
    period_ = jnp.where(swings, found.period, jnp.nan)
    details = {"period": period_, "lobes": found.lobes, "oscillatory": oscillates}
    return areas.conclude(best, pick(*responses[::-1]), **details)


def _swings(found: Oscillation, period: Number):
    """Whether there is an oscillation to identify."""
    return found.lobes >= FEWEST_LOBES if period is None else jnp.ones((), bool)


def _with_period(areas: Areas, found: Oscillation, period: Number) -> Oscillation:
    """With a period given instead of the one read: lobes up to the end of the record."""
    if period is None:
        return found
    period = jnp.asarray(period, found.period.dtype)
    room = jnp.floor((areas.area.end - areas.onset) / (0.5 * period))
    lobes = jnp.where(found.lobes >= FEWEST_LOBES, found.lobes, jnp.clip(room, 2, MOST_LOBES))
    return found._replace(period=period, lobes=lobes.astype(found.lobes.dtype))


def _swinging(
    areas: Areas, scanned: Scanned, period: Scalar, found: Oscillation, swings
) -> Identification:
    status = Status.where(swings, Status.successful, Status.levels_not_crossed)
    areas.reading.remember(status, period=period, lobes=found.lobes)
    return areas.conclude(scanned)


