"""Least-squares fits: a start from the record, then `refine`."""

from collections.abc import Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy import special

from .._characterise import crossing_times, levels
from .._curves import DEFAULT_ORDERS, chain_with_spread, check_orders
from .._models import FOPDT, SOPDT, AbstractPlant, Hudzovic, Sani
from .._preprocess import sliding_average
from .._record import StepRecord, usable_record
from .._refine import refine
from .._result import Identification, refused
from .._types import Scalar


START_LEVELS = (0.283, 0.632)
"""The two levels of Smith (1972): 1/3 and 1 time constant of a first-order plant."""


def fopdt_fit(record: StepRecord, *, fixed: Sequence[str] = (), **options: Any) -> Identification:
    r"""First order plus dead time by least squares: K, T, L and the offset.

    Starts from the two-point method of Smith (1972) and refines; `fixed` (their values are those
    of `FOPDT`'s defaults) and further options as in `refine`. Known levels of the record fix
    offset and gain. **Status** as in `refine`.
    """
    early, late = _start_times(record)
    T = 1.5 * (late - early)
    start = FOPDT(T=T, delay=_delay(late - T, fixed))
    return refine(record, start, fixed, **options)


def sopdt_fit(record: StepRecord, *, fixed: Sequence[str] = (), **options: Any) -> Identification:
    r"""Second order plus dead time by least squares: K, zeta, omega_n, L and the offset.

    One smooth model from oscillation to two real lags. The start has the damping that the largest
    overshoot M tells, zeta = 1/sqrt(1 + (pi/ln M)^2), within 0.1..1. `fixed` and further options
    as in `refine`. **Status** as in `refine`.
    """
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
    return refine(record, SOPDT(zeta=zeta, omega_n=omega_n, delay=delay), fixed, **options)


def hudzovic_fit(
    record: StepRecord,
    *,
    order: int | str = "auto",
    orders: Iterable[int] = DEFAULT_ORDERS,
    fixed: Sequence[str] = (),
    **options: Any,
) -> Identification:
    r"""Hudzovic's model by least squares (Murray 2016, section 2.4): T, r, and K, L, offset.

    The paper frees T and r only: `fixed=("delay",)` with known levels. **Options:** `order`, or
    "auto": each of `orders` is fitted and the one with the smallest error kept (AICc ranks alike,
    all having the same number of free parameters); `fixed` and further ones as in `refine`. With a
    free delay the orders are nearly interchangeable. **Status** as in `refine`.
    """
    return _chain_fit(Hudzovic, record, order, orders, fixed, options)


def sani_fit(
    record: StepRecord,
    *,
    order: int | str = "auto",
    orders: Iterable[int] = DEFAULT_ORDERS,
    fixed: Sequence[str] = (),
    **options: Any,
) -> Identification:
    r"""Sani's model by least squares (Murray 2016, section 2.4): T, r, and K, L, offset.

    Options and status as in `hudzovic_fit`.
    """
    return _chain_fit(Sani, record, order, orders, fixed, options)


def _chain_fit(model, record, order, orders, fixed, options) -> Identification:
    if order == "auto":
        candidates = check_orders(orders)
        results = eqx.filter_vmap(
            lambda n: refine(record, _chain_start(model, record, n, fixed), fixed, **options)
        )(jnp.asarray(candidates))
        score = jnp.where(refused(results.status), jnp.inf, results.rmse)
        best = jnp.argmin(jnp.where(jnp.isnan(score), jnp.inf, score))
        return jax.tree.map(lambda x: x[best], results)
    (n,) = check_orders([order]) if isinstance(order, int | np.integer) else (order,)
    if isinstance(n, str):
        raise ValueError(f"order must be a whole number from 2 to 8 or 'auto', got {order!r}.")
    return refine(record, _chain_start(model, record, jnp.asarray(n), fixed), fixed, **options)


def _chain_start(model, record, n: Array, fixed) -> AbstractPlant:
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


def _delay(estimate: Scalar, fixed: Sequence[str]) -> Scalar:
    return jnp.zeros_like(estimate) if "delay" in fixed else jnp.maximum(estimate, 0)


def _averaged(record: StepRecord) -> Array:
    return sliding_average(record.y, max(1, record.y.size // 25))


def _start_times(record: StepRecord) -> tuple[Scalar, Scalar]:
    """Times at the two start levels, of the averaged record; a guess where they do not exist."""
    _, safe = usable_record(record)
    smooth = eqx.tree_at(lambda r: r.y, safe, _averaged(safe))
    early, late = crossing_times(smooth, jnp.array(START_LEVELS))
    duration = safe.t[-1] - safe.step_time
    early = jnp.where(early > 0, early, 0.1 * duration)
    late = jnp.where(late > 1.05 * early, late, 1.5 * early)
    return jax.lax.stop_gradient((early, late))
