"""Least-squares fits: a start from the record, then the engine.

Each has a `search_*`, which gives a `Fitted` that can be compared with others, and the method of
that name, which concludes from it.
"""

import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypedDict, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array
from scipy import special

from .._arrays import Samples, Scalar
from .._result import Identification
from ..fitting._fitted import Fitted, best_order, fit
from ..fitting._refine import check_options, concluded
from ..models._abstract import AbstractPlant
from ..models._plants import FOPDT, SOPDT, Hudzovic, PTn, Sani
from ..models._spread import DEFAULT_ORDERS, chain_with_spread, check_orders
from ..records._characterise import levels
from ..records._preprocess import sliding_average
from ..records._record import StepRecord, usable_record


INDIVIDUAL_ORDERS = range(2, 6)
"""Numbers of lags that `ptn_fit` tries."""

START_LEVELS = (0.283, 0.632)
"""The two levels of Smith (1972): 1/3 and 1 time constant of a first-order plant."""


class FitOptions(TypedDict, total=False):
    """Options of every fit; see `refine`."""

    fixed: Sequence[str]
    weights: Samples | None
    loss: str
    solver: optx.AbstractLeastSquaresSolver | None
    max_steps: int
    errors: bool


class OrderOptions(FitOptions, total=False):
    """Options of the fits that choose an order: a whole number or "auto", and what that tries."""

    order: int | str
    orders: Iterable[int]


def fopdt_fit(record: StepRecord, **options: Unpack[FitOptions]) -> Identification:
    r"""First order plus dead time by least squares: K, T, L and the offset.

    Starts from the two-point method of Smith (1972) and refines; `fixed` (their values are those
    of `FOPDT`'s defaults) and further options as in `refine`. Known levels of the record fix
    offset and gain. **Status** as in `refine`.
    """
    return _concluded(search_fopdt, record, options)


def search_fopdt(record: StepRecord, **options: Any) -> Fitted:
    """`fopdt_fit` without its conclusion."""
    early, late = _start_times(record)
    T = 1.5 * (late - early)
    delay = _delay(late - T, options.get("fixed", ()))
    return _checked_fit(record, FOPDT(T=T, delay=delay), options)


def sopdt_fit(record: StepRecord, **options: Unpack[FitOptions]) -> Identification:
    r"""Second order plus dead time by least squares: K, zeta, omega_n, L and the offset.

    One smooth model from oscillation to two real lags. The start has the damping that the largest
    overshoot M tells, zeta = 1/sqrt(1 + (pi/ln M)^2), within 0.1..1. `fixed` and further options
    as in `refine`. **Status** as in `refine`.
    """
    return _concluded(search_sopdt, record, options)


def search_sopdt(record: StepRecord, **options: Any) -> Fitted:
    """`sopdt_fit` without its conclusion."""
    _, safe = usable_record(record)
    early, late = _start_times(record)
    initial, final = levels(safe)
    y = (_averaged(safe) - initial) / jnp.where(final == initial, 1, final - initial)
    overshoot = jnp.clip(jnp.max(y) - 1, 1e-4, 0.95)
    log = jnp.log(overshoot)
    zeta = jnp.clip(-log / jnp.sqrt(np.pi**2 + log**2), 0.1, 1.0)
    # At zeta = 1 the two levels lie 0.98/omega_n apart, at zeta = 0.1 about 0.5/omega_n.
    omega_n = (0.45 + 0.55 * zeta) / (late - early)
    delay = _delay(late - (1.2 + zeta) / omega_n, options.get("fixed", ()))
    return _checked_fit(record, SOPDT(zeta=zeta, omega_n=omega_n, delay=delay), options)


def hudzovic_fit(record: StepRecord, **options: Unpack[OrderOptions]) -> Identification:
    r"""Hudzovic's model by least squares (Murray 2016, section 2.4): T, r, and K, L, offset.

    The paper frees T and r only: `fixed=("delay",)` with known levels. **Options:** `order`, or
    "auto": each of `orders` is fitted and the smallest kept whose AICc is within 2 of the best,
    since with a free delay the orders are nearly interchangeable; its AICc then counts n as one
    more parameter. `fixed`, `errors` and further ones as in `refine`. **Status** as in `refine`.
    """
    return _concluded(search_hudzovic, record, options)


def search_hudzovic(record: StepRecord, **options: Any) -> Fitted:
    """`hudzovic_fit` without its conclusion."""
    return _chain_fit(functools.partial(_chain_start, Hudzovic), record, options)


def sani_fit(record: StepRecord, **options: Unpack[OrderOptions]) -> Identification:
    r"""Sani's model by least squares (Murray 2016, section 2.4): T, r, and K, L, offset.

    Options and status as in `hudzovic_fit`.
    """
    return _concluded(search_sani, record, options)


def search_sani(record: StepRecord, **options: Any) -> Fitted:
    """`sani_fit` without its conclusion."""
    return _chain_fit(functools.partial(_chain_start, Sani), record, options)


def ptn_fit(record: StepRecord, **options: Unpack[OrderOptions]) -> Identification:
    r"""Individual time constants by least squares (Murray 2016, `ptn_fit`): lags, K, L, offset.

    As many lags as `order`, largest first. "auto" fits each number in `orders` and keeps the
    smallest whose AICc is within 2 of the best; the model then has max(`orders`) lags, those not
    used 0. Default 2 to 5: with a free dead time no record tells more; for a plant of high order
    without one ask for `orders=range(2, 9)`. Lags that the record cannot tell apart come out equal,
    with the warning `at_bound`. Options and status otherwise as in `hudzovic_fit`.
    """
    return _concluded(search_ptn, record, options)


def search_ptn(record: StepRecord, **options: Any) -> Fitted:
    """`ptn_fit` without its conclusion."""
    order, orders = options.get("order", "auto"), tuple(options.get("orders", INDIVIDUAL_ORDERS))

    def start(record, n, fixed):
        size = max(orders) if order == "auto" else int(order)
        chain = _chain_start(Sani, record, n, fixed)
        return PTn(lags=chain.lags[:size], delay=chain.delay)

    return _chain_fit(start, record, {"orders": orders} | options)


AUTO = {
    "fopdt_fit": search_fopdt,
    "sopdt_fit": search_sopdt,
    "hudzovic_fit": search_hudzovic,
    "sani_fit": search_sani,
}
"""Families that `identify(method="auto")` compares, simplest first."""


def _concluded(search: Callable[..., Fitted], record: StepRecord, options) -> Identification:
    """The result of a search; standard errors unless `errors` is off."""
    options = dict(options)
    errors = options.pop("errors", True)
    return concluded(search(record, **options), record, errors)


def _checked_fit(record: StepRecord, start: AbstractPlant, options: dict[str, Any]) -> Fitted:
    check_options(start, options.get("fixed", ()), None, options.get("loss", "squares"))
    return fit(record, start, **options)


def _chain_fit(start: Callable[..., AbstractPlant], record: StepRecord, options) -> Fitted:
    """The fit from `start(record, n, fixed)` for one order n or the best of several."""
    options = dict(options)
    order, orders = options.pop("order", "auto"), options.pop("orders", DEFAULT_ORDERS)

    def fit_order(n: Array) -> Fitted:
        return _checked_fit(record, start(record, n, options.get("fixed", ())), options)

    if order == "auto":
        return best_order(record, options.get("weights"), check_orders(orders), fit_order)
    if isinstance(order, int | np.integer) and not isinstance(order, bool):
        return fit_order(jnp.asarray(check_orders([int(order)])[0]))
    raise ValueError(f"order must be a whole number from 2 to 8 or 'auto', got {order!r}.")


def _chain_start(model, record, n: Array, fixed) -> Any:
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
    """Times of the first samples at the two start levels, in the averaged record."""
    _, safe = usable_record(record)
    initial, final = levels(safe)
    y = (_averaged(safe) - initial) * jnp.sign(final - initial)
    t = safe.t - safe.step_time
    early, late = (
        t[jnp.argmax((y >= q * jnp.abs(final - initial)) & (t > 0))] for q in START_LEVELS
    )
    early = jnp.maximum(early, 1e-3 * t[-1])
    return jax.lax.stop_gradient((early, jnp.maximum(late, 1.05 * early)))
