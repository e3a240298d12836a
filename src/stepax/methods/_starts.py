"""Where the least-squares fits start: a model from a few features of the record."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy import special

from .._arrays import Scalar
from ..models._plants import FOPDT, IPDT, SOPDT, SOPDTZero
from ..models._sampled import times
from ..models._spread import chain_with_spread
from ..records._characterise import levels
from ..records._preprocess import moving_mean, sliding_average
from ..records._record import StepRecord, usable_record


START_LEVELS = (0.283, 0.632)
"""The two levels of Smith (1972): 1/3 and 1 time constant of a first-order plant."""

DAMPINGS, PERIODS = [0.2, 0.5, 1.0, 2.5, 6.0], np.geomspace(0.02, 1.0, 8)
SHAPES = np.stack([x.ravel() for x in np.meshgrid(np.log(DAMPINGS), np.log(PERIODS))]).T
"""Log damping, and log period over the length of the record."""

AROUND = np.stack([x.ravel() for x in np.meshgrid([-0.5, 0, 0.5], [-0.3, 0, 0.3])]).T
"""Steps from the best of these shapes; half as long once none of them is better."""
ROUNDS = 8

DELAYS = np.linspace(0, 1, 16)
"""Dead times, over the latest possible, each of which gets its best shape: a zero and a dead time
can trade places, so that there are two good ones with a bad one between."""

LAGS, WAITS = np.geomspace(0.02, 1, 8), np.linspace(0, 1, 8)
"""Time constants over the length of the record, and dead times over the largest of each."""

FEW_ROWS = 64
"""Rows on which these are compared."""

ROWS = 100
"""Rows on which the shapes are compared: a start needs no more."""


def first_order_start(record: StepRecord, fixed: Sequence[str]) -> FOPDT:
    """By the two-point method of Smith (1972), or the best of a grid if that fits better.

    Where times lie in clusters both levels may be passed between two samples, and tell little.
    """
    early, late = _start_times(record)
    T = 1.5 * (late - early)
    _, safe = usable_record(record)
    t, y = _some_rows(safe, FEW_ROWS)
    # Smith's two come first: of equal ones they are kept.
    lags = jnp.append(T, safe.duration * jnp.asarray(LAGS, T.dtype))
    waits = late * jnp.asarray(WAITS, T.dtype)
    delays = _delay(jnp.append(late - T, waits), fixed)
    # To choose, single precision will do, in half the time.
    size, length = jnp.max(jnp.abs(y)), safe.duration
    relative = t / length, y / jnp.where(size > 0, size, 1), lags / length, delays / length
    best = jnp.argmin(_first_order_errors(*(x.astype(jnp.float32) for x in relative)))
    return jax.lax.stop_gradient(
        FOPDT(T=lags[best // delays.size], delay=delays[best % delays.size])
    )


def _first_order_errors(t: Array, y: Array, lags: Array, delays: Array) -> Array:
    r"""Squared errors with the best gain and offset, less what all have in common: a row a lag.

    The response is $1 - c e$ with $e = e^{(m - t)/T}$ and $c = e^{(L - m)/T}$ for $t > L$. So its
    sums, with its square and with y, are made of those of 1, y, e, e^2 and ye over the rows after
    each dead time: one matrix product. y has a mean of 0.
    """
    middle = jnp.max(delays) / 2  # so that of these lags neither e nor c overflows in float32
    e = jnp.exp((middle - jnp.maximum(t, 0))[None] / lags[:, None])
    after = jnp.where(t[:, None] > delays[None], 1, jnp.zeros_like(y)[:, None])
    rows = jnp.concatenate([jnp.ones_like(y)[None], y[None], e, e * e, y[None] * e])
    places = 2 + lags.size * np.arange(3)
    both, sum_e, sum_ee, sum_ye = jnp.split(times(rows, after), places)
    count, sum_y = both[:1], both[1:]
    c = jnp.exp((delays - middle)[None] / lags[:, None])
    sum_g, product = count - c * sum_e, sum_y - c * sum_ye
    square = count - 2 * c * sum_e + c * c * sum_ee - sum_g**2 / t.size
    rounding = 4 * jnp.finfo(y.dtype).eps * t.size
    errors = -(product**2) / jnp.where(square > rounding, square, jnp.inf)
    return jnp.where(jnp.isnan(errors), 0, errors)  # of a lag far below the dead times


def second_order_start(record: StepRecord, fixed: Sequence[str]) -> SOPDT:
    """Damping by the largest overshoot, period and dead time by two levels."""
    _, safe = usable_record(record)
    early, late = _start_times(record)
    initial, final = levels(safe)
    y = (_averaged(safe) - initial) / jnp.where(final == initial, 1, final - initial)
    overshoot = jnp.clip(jnp.max(y) - 1, 1e-4, 0.95)
    log = jnp.log(overshoot)
    zeta = jnp.clip(-log / jnp.sqrt(np.pi**2 + log**2), 0.1, 1.0)
    # At zeta = 1 the two levels lie 0.98/omega_n apart, at zeta = 0.1 about 0.5/omega_n.
    omega_n = (0.45 + 0.55 * zeta) / (late - early)
    delay = _delay(late - (1.2 + zeta) / omega_n, fixed)
    return SOPDT(zeta=zeta, omega_n=omega_n, delay=delay)


def chain_start(model: Any, record: StepRecord, n: Array, fixed: Sequence[str]) -> Any:
    """Chain of medium spread through the two start levels, with a dead time if that leaves one.

    Its level times are those of equal lags of an order 0.6 n, at which a chain of that spread
    rises about as steeply.
    """
    early, late = _start_times(record)
    orders = np.arange(9)
    effective = np.maximum(1.0, 0.6 * orders)
    passed = jnp.asarray(
        [special.gammaincinv(effective, q) / effective for q in START_LEVELS], early.dtype
    )[:, n]
    residence = (late - early) / (passed[1] - passed[0])
    delay = _delay(late - residence * passed[1], fixed)
    residence = (late - delay) / passed[1]
    chain = chain_with_spread(model, jnp.log(jnp.asarray(0.6, early.dtype)), n)
    return eqx.tree_at(lambda m: (m.T, m.delay), chain, (chain.T * residence, delay))


def zero_start(record: StepRecord, fixed: Sequence[str]) -> SOPDTZero:
    """The best of `DELAYS`, each with its best shape; offset, gain and lead by regression."""
    _, safe = usable_record(record)
    initial, _ = levels(safe)
    y = _averaged(safe)  # for the onset alone: the regression averages by itself
    far = jnp.abs(y - initial) > 0.05 * (jnp.max(y) - jnp.min(y))
    onset = jnp.where(jnp.any(far), safe.elapsed[jnp.argmax(far & (safe.elapsed > 0))], 0)
    latest = onset + safe.duration / 50  # half of what is averaged over
    t, y = _some_rows(safe, ROWS)

    def regression(shape: Array, delay: Scalar) -> tuple[Scalar, SOPDTZero]:
        """Squared error of the best gain and lead, and the plant that has them."""
        zeta, period = jnp.exp(shape)
        omega_n = jnp.sqrt(1 + 4 * zeta**2) / (period * safe.duration)
        return _best_lead(SOPDT(zeta=zeta, omega_n=omega_n, delay=delay), t, y)

    delays = _delay(latest, fixed) * jnp.asarray(DELAYS, y.dtype)

    def errors(best: Array, size: Array, steps: np.ndarray) -> Array:
        """Squared errors of a row of shapes, one a dead time, and of all steps from it."""
        one = lambda step: jax.vmap(regression)(best + jnp.outer(size, step), delays)[0]  # noqa: E731
        return jax.lax.map(one, jnp.asarray(steps, y.dtype))

    def nearer(carry: tuple[Array, Array], _) -> tuple[tuple[Array, Array], None]:
        best, size = carry
        step = jnp.asarray(AROUND, y.dtype)[jnp.argmin(errors(best, size, AROUND), axis=0)]
        stays = jnp.all(step == 0, axis=1)
        return (best + size[:, None] * step, jnp.where(stays, size / 2, size)), None

    one = jnp.ones_like(delays)
    first = jnp.asarray(SHAPES, y.dtype)[jnp.argmin(errors(0 * one[:, None], one, SHAPES), axis=0)]
    (best, _), _ = jax.lax.scan(nearer, (first, one), length=ROUNDS)
    square, plants = jax.vmap(regression)(best, delays)
    return jax.lax.stop_gradient(jax.tree.map(lambda x: x[jnp.argmin(square)], plants))


def _best_lead(plant: SOPDT, t: Array, y: Array) -> tuple[Scalar, SOPDTZero]:
    """Squared error and lead of a plant with a zero whose gain and lead are a regression.

    The response is a combination of that without a zero and its slope; y has a mean of 0.
    """
    g, h = jax.jvp(lambda t: plant.unit_response(t - plant.delay), (t,), (jnp.ones_like(t),))
    g, h = g - jnp.mean(g), h - jnp.mean(h)
    gg, gh, hh, gy, hy = g @ g, g @ h, h @ h, g @ y, h @ y
    determinant = gg * hh - gh * gh
    usable = determinant > jnp.finfo(y.dtype).eps ** 0.5 * gg * hh
    determinant = jnp.where(usable, determinant, 1)
    gain, slope = (hh * gy - gh * hy) / determinant, (gg * hy - gh * gy) / determinant
    square = y @ y - gain * gy - slope * hy
    lead = slope / jnp.where(gain == 0, 1, gain)
    model = SOPDTZero(zeta=plant.zeta, omega_n=plant.omega_n, lead=lead, delay=plant.delay)
    return jnp.where(usable & (gain != 0), square, jnp.inf), model


def integrating_start(record: StepRecord, fixed: Sequence[str]) -> IPDT:
    """The line through the last half of the record meets the initial level at T + L."""
    _, safe = usable_record(record)
    initial, _ = levels(safe)
    t, late = safe.elapsed, (safe.elapsed >= 0.5 * safe.duration) & safe.present
    count = jnp.sum(late)
    middle, height = jnp.sum(t * late) / count, jnp.sum(safe.y * late) / count
    spread = jnp.sum((t - middle) ** 2 * late)
    slope = jnp.sum((t - middle) * (safe.y - height) * late) / jnp.where(spread > 0, spread, 1)
    meets = middle - (height - initial) / jnp.where(slope == 0, jnp.inf, slope)
    total = jax.lax.stop_gradient(jnp.clip(meets, 0, 0.9 * safe.duration))
    delay = _delay(total / 2, fixed)
    return IPDT(T=jnp.maximum(total - delay, 1e-3 * safe.duration), delay=delay)


def _delay(estimate: Array, fixed: Sequence[str]) -> Array:
    return jnp.zeros_like(estimate) if "delay" in fixed else jnp.maximum(estimate, 0)


def _some_rows(record: StepRecord, number: int) -> tuple[Array, Array]:
    """Times since the step and outputs, their mean taken away, of evenly chosen rows."""
    rows = np.arange(number) * record.count // number
    return record.elapsed[rows], record.y[rows] - jnp.mean(record.y[rows])


def _averaged(record: StepRecord) -> Array:
    """The output, averaged over a 25th of the rows."""
    if isinstance(record.count, int):
        return sliding_average(record.y, max(1, record.count // 25))
    mean = moving_mean(record.y, jnp.maximum(1, record.count // 25), record.count)
    return jnp.where(record.present, mean, mean[record.last])


def _start_times(record: StepRecord) -> tuple[Scalar, Scalar]:
    """Times at which the averaged record first passes the two start levels, between samples."""
    _, safe = usable_record(record)
    initial, final = levels(safe)
    y = (_averaged(safe) - initial) * jnp.sign(final - initial)
    size, t = jnp.abs(final - initial), safe.elapsed

    def passes(q: float) -> Scalar:
        after = jnp.argmax((y >= q * size) & (t > 0))
        before = jnp.maximum(after - 1, 0)
        rise = y[after] - y[before]
        share = jnp.where(rise > 0, (q * size - y[before]) / jnp.where(rise > 0, rise, 1), 1)
        start = jnp.maximum(t[before], 0)  # nothing moves before the step
        return start + jnp.clip(share, 0, 1) * (t[after] - start)

    early, late = (passes(q) for q in START_LEVELS)
    early = jnp.maximum(early, 1e-3 * safe.duration)
    return jax.lax.stop_gradient((early, jnp.maximum(late, 1.05 * early)))
