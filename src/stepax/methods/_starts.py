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
from ..models._spread import chain_with_spread
from ..records._characterise import levels
from ..records._preprocess import moving_mean, sliding_average
from ..records._record import StepRecord, usable_record


START_LEVELS = (0.283, 0.632)
"""The two levels of Smith (1972): 1/3 and 1 time constant of a first-order plant."""

DAMPINGS, PERIODS, DELAYS = (
    [0.2, 0.5, 1.0, 2.5, 6.0],
    np.geomspace(0.02, 1.0, 8),
    [0, 0.4, 0.7, 1.0],
)
SHAPES = np.stack([x.ravel() for x in np.meshgrid(np.log(DAMPINGS), np.log(PERIODS), DELAYS)]).T
"""Log damping, log period over the length of the record, dead time over the onset."""

AROUND = np.stack(
    [x.ravel() for x in np.meshgrid([-0.5, 0, 0.5], [-0.3, 0, 0.3], [-0.2, 0, 0.2])]
).T
"""Steps from the best of these shapes towards one another, 0.6 times as long in each round."""
ROUNDS = 6

ROWS = 100
"""Rows on which the shapes are compared: a start needs no more."""


def first_order_start(record: StepRecord, fixed: Sequence[str]) -> FOPDT:
    """By the two-point method of Smith (1972)."""
    early, late = _start_times(record)
    T = 1.5 * (late - early)
    return FOPDT(T=T, delay=_delay(late - T, fixed))


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
    times = jnp.asarray(
        [special.gammaincinv(effective, q) / effective for q in START_LEVELS], early.dtype
    )[:, n]
    residence = (late - early) / (times[1] - times[0])
    delay = _delay(late - residence * times[1], fixed)
    residence = (late - delay) / times[1]
    chain = chain_with_spread(model, jnp.log(jnp.asarray(0.6, early.dtype)), n)
    return eqx.tree_at(lambda m: (m.T, m.delay), chain, (chain.T * residence, delay))


def zero_start(record: StepRecord, fixed: Sequence[str]) -> SOPDTZero:
    """The best of `SHAPES`, with offset, gain and gain times lead by regression."""
    _, safe = usable_record(record)
    initial, _ = levels(safe)
    y = _averaged(safe)  # for the onset alone: the regression averages by itself
    far = jnp.abs(y - initial) > 0.05 * (jnp.max(y) - jnp.min(y))
    onset = jnp.where(jnp.any(far), safe.elapsed[jnp.argmax(far & (safe.elapsed > 0))], 0)
    rows = np.arange(ROWS) * safe.count // ROWS
    t, y = safe.elapsed[rows], safe.y[rows] - jnp.mean(safe.y[rows])

    def plant(shape: Array) -> SOPDTZero:
        zeta, period = jnp.exp(shape[:2])
        omega_n = jnp.sqrt(1 + 4 * zeta**2) / (period * safe.duration)
        delay = _delay(shape[2] * onset, fixed)
        return SOPDTZero(zeta=zeta, omega_n=omega_n, lead=jnp.ones_like(omega_n), delay=delay)

    def regression(shape: Array) -> tuple[Scalar, Scalar]:
        """Squared error, and lead, of the best gain and gain times lead."""
        model = plant(shape)
        g = SOPDT(zeta=model.zeta, omega_n=model.omega_n).unit_response(t - model.delay)
        h = model.unit_response(t - model.delay) - g
        g, h = g - jnp.mean(g), h - jnp.mean(h)
        gg, gh, hh, gy, hy = g @ g, g @ h, h @ h, g @ y, h @ y
        determinant = gg * hh - gh * gh
        usable = determinant > jnp.finfo(y.dtype).eps ** 0.5 * gg * hh
        determinant = jnp.where(usable, determinant, 1)
        gain, slope = (hh * gy - gh * hy) / determinant, (gg * hy - gh * gy) / determinant
        square = y @ y - gain * gy - slope * hy
        lead = slope / jnp.where(gain == 0, 1, gain)
        return jnp.where(usable & (gain != 0), square, jnp.inf), lead

    def nearer(best: Array, size: Scalar) -> tuple[Array, None]:
        shapes = best[None, :] + size * jnp.asarray(AROUND, y.dtype)
        return shapes[jnp.argmin(jax.vmap(regression)(shapes)[0])], None

    shapes = jnp.asarray(SHAPES, y.dtype)
    best = shapes[jnp.argmin(jax.lax.map(regression, shapes)[0])]
    best, _ = jax.lax.scan(nearer, best, jnp.asarray(0.6 ** np.arange(ROUNDS), y.dtype))
    model = eqx.tree_at(lambda m: m.lead, plant(best), regression(best)[1])
    return jax.lax.stop_gradient(model)


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


def _delay(estimate: Scalar, fixed: Sequence[str]) -> Scalar:
    return jnp.zeros_like(estimate) if "delay" in fixed else jnp.maximum(estimate, 0)


def _averaged(record: StepRecord) -> Array:
    """The output, averaged over a 25th of the rows."""
    if isinstance(record.count, int):
        return sliding_average(record.y, max(1, record.count // 25))
    mean = moving_mean(record.y, jnp.maximum(1, record.count // 25), record.count)
    return jnp.where(record.present, mean, mean[record.last])


def _start_times(record: StepRecord) -> tuple[Scalar, Scalar]:
    """Times of the first samples at the two start levels, in the averaged record."""
    _, safe = usable_record(record)
    initial, final = levels(safe)
    y = (_averaged(safe) - initial) * jnp.sign(final - initial)
    t = safe.elapsed
    early, late = (
        t[jnp.argmax((y >= q * jnp.abs(final - initial)) & (t > 0))] for q in START_LEVELS
    )
    early = jnp.maximum(early, 1e-3 * safe.duration)
    return jax.lax.stop_gradient((early, jnp.maximum(late, 1.05 * early)))
