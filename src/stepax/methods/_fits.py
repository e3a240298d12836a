"""Least-squares fits: a start from the record, then the engine.

Each has a `search_*`, which gives a `Fitted` that can be compared with others, and the method of
that name, which concludes from it.
"""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypedDict, Unpack

import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from .._arrays import Samples
from .._result import Identification
from ..fitting._fitted import Fitted, best_order, fit
from ..fitting._refine import check_options, concluded_in_groups, with_order
from ..models._abstract import AbstractPlant
from ..models._plants import Hudzovic, PTn, Sani
from ..models._spread import DEFAULT_ORDERS, check_orders
from ..records._abstract import AbstractRecord
from ..records._input import InputRecord
from ..records._record import with_weights
from . import _input_starts, _starts


INDIVIDUAL_ORDERS = range(2, 6)
"""Numbers of lags that `ptn_fit` tries."""


class FitOptions(TypedDict, total=False):
    """Options of every fit; see `refine`."""

    fixed: Sequence[str]
    weights: Samples | None
    loss: str
    prior: Mapping[str, Any] | None
    solver: optx.AbstractLeastSquaresSolver | None
    max_steps: int
    errors: bool
    at_rest: bool | None
    drift: bool | None


class OrderOptions(FitOptions, total=False):
    """Options of the fits that choose an order: a whole number or "auto", and what that tries."""

    order: int | str
    orders: Iterable[int]


def fopdt_fit(record: AbstractRecord, **options: Unpack[FitOptions]) -> Identification:
    r"""First order plus dead time by least squares: K, T, L and the offset.

    Starts from the two-point method of Smith (1972) or a grid and refines. Under noise the squared
    error has a minimum between nearly every two samples: where the dead time is sought, the
    intervals around a first estimate are searched outwards, at most 50 to each side, until three
    standard errors are passed. `fixed` (their values are those of `FOPDT`'s defaults) and further
    options as in `refine`. Known levels of the record fix offset and gain. **Status** as in
    `refine`.
    """
    return _concluded(search_fopdt, record, options)


def search_fopdt(record: AbstractRecord, **options: Any) -> Fitted:
    """`fopdt_fit` without its conclusion."""
    return _started(record, starts_for(record).first_order_start, options)


def sopdt_fit(record: AbstractRecord, **options: Unpack[FitOptions]) -> Identification:
    r"""Second order plus dead time by least squares: K, zeta, omega_n, L and the offset.

    One smooth model from oscillation to two real lags. The start has the damping that the largest
    overshoot M tells, zeta = 1/sqrt(1 + (pi/ln M)^2), within 0.1..1. `fixed` and further options
    as in `refine`. **Status** as in `refine`.
    """
    return _concluded(search_sopdt, record, options)


def search_sopdt(record: AbstractRecord, **options: Any) -> Fitted:
    """`sopdt_fit` without its conclusion."""
    return _started(record, starts_for(record).second_order_start, options)


def hudzovic_fit(record: AbstractRecord, **options: Unpack[OrderOptions]) -> Identification:
    r"""Hudzovic's model by least squares (Murray 2016, section 2.4): T, r, and K, L, offset.

    The paper frees T and r only: `fixed=("delay",)` with known levels. **Options:** `order`, or
    "auto": each of `orders` is fitted and the smallest kept whose AICc is within 2 of the best,
    since with a free delay the orders are nearly interchangeable; its AICc then counts n as one
    more parameter. `fixed`, `errors` and further ones as in `refine`. **Status** as in `refine`.
    """
    return _concluded(search_hudzovic, record, options)


def search_hudzovic(record: AbstractRecord, **options: Any) -> Fitted:
    """`hudzovic_fit` without its conclusion."""
    return _chain_fit(
        functools.partial(starts_for(record).chain_start, Hudzovic), with_order, record, options
    )


def sani_fit(record: AbstractRecord, **options: Unpack[OrderOptions]) -> Identification:
    r"""Sani's model by least squares (Murray 2016, section 2.4): T, r, and K, L, offset.

    Options and status as in `hudzovic_fit`.
    """
    return _concluded(search_sani, record, options)


def search_sani(record: AbstractRecord, **options: Any) -> Fitted:
    """`sani_fit` without its conclusion."""
    return _chain_fit(
        functools.partial(starts_for(record).chain_start, Sani), with_order, record, options
    )


def ptn_fit(record: AbstractRecord, **options: Unpack[OrderOptions]) -> Identification:
    r"""Individual time constants by least squares (Murray 2016, `ptn_fit`): lags, K, L, offset.

    As many lags as `order`, largest first. "auto" fits each number in `orders` and keeps the
    smallest whose AICc is within 2 of the best; the model then has max(`orders`) lags, those not
    used 0. Default 2 to 5: with a free dead time no record tells more; for a plant of high order
    without one ask for `orders=range(2, 9)`. Lags that the record cannot tell apart come out equal,
    with the warning `at_bound`. Options and status otherwise as in `hudzovic_fit`.
    """
    return _concluded(search_ptn, record, options)


def search_ptn(record: AbstractRecord, **options: Any) -> Fitted:
    """`ptn_fit` without its conclusion."""
    order, orders = options.get("order", "auto"), tuple(options.get("orders", INDIVIDUAL_ORDERS))

    def start(record, n, fixed):
        size = max(orders) if order == "auto" else int(order)
        chain = starts_for(record).chain_start(Sani, record, n, fixed)
        return PTn(lags=chain.lags[:size], delay=chain.delay)

    return _chain_fit(start, None, record, options | {"orders": orders})


def sopdt_zero_fit(record: AbstractRecord, **options: Unpack[FitOptions]) -> Identification:
    r"""Second order with one zero by least squares: K, zeta, omega_n, lead, L and the offset.

    For an inverse response (lead < 0) or an overshoot that does not come back as oscillation (lead
    above the larger lag). Where there is no such thing a zero is hardly told from a pole or the
    dead time: see the standard errors, and what `sopdt_fit` gives. Starts from the best of a grid
    of shapes, whose gain, offset and lead are a linear regression. `fixed` and further options as
    in `refine`. **Status** as in `refine`.
    """
    return _concluded(search_sopdt_zero, record, options)


def search_sopdt_zero(record: AbstractRecord, **options: Any) -> Fitted:
    """`sopdt_zero_fit` without its conclusion."""
    return _started(record, starts_for(record).zero_start, options)


def ipdt_fit(record: AbstractRecord, **options: Unpack[FitOptions]) -> Identification:
    r"""Integrating with one lag plus dead time by least squares: K, T, L and the offset.

    For a record that ends as a ramp; K is the slope of the output per unit of input. A known final
    level of the record says nothing of such a plant and is not used. Starts from the line through
    the last half of the record, of whose delay T takes half. Of a record whose ramp is all there is
    T + L is well determined, T alone by how the ramp begins. `fixed` and further options as in
    `refine`. **Status** as in `refine`; a record that has settled is fitted badly, not refused.
    """
    return _concluded(search_ipdt, record, options)


def search_ipdt(record: AbstractRecord, **options: Any) -> Fitted:
    """`ipdt_fit` without its conclusion."""
    return _started(record, starts_for(record).integrating_start, options)


AUTO = {
    "fopdt_fit": search_fopdt,
    "sopdt_fit": search_sopdt,
    "hudzovic_fit": search_hudzovic,
    "sani_fit": search_sani,
}
"""Families that `identify(method="auto")` compares, simplest first."""

CHAINS = ("hudzovic_fit", "sani_fit")
"""Of these, those that choose an order."""

WITH_REASON = {"sopdt_zero_fit": search_sopdt_zero, "ipdt_fit": search_ipdt}
"""Families that it tries only where the record gives a reason."""


def _concluded(search: Callable[..., Fitted], record: AbstractRecord, options) -> Identification:
    """The result of a search; standard errors unless `errors` is off.

    Weights given to the fit are the record's from here on: a start leaves out the same rows.
    """
    options = dict(options)
    errors, weights = options.pop("errors", True), options.pop("weights", None)
    record = record.seeking(options.pop("at_rest", None), options.pop("drift", None))
    return concluded_in_groups(
        lambda record, weights, options: search(with_weights(record, weights), **options),
        record,
        errors,
        weights,
        options,
    )


def starts_for(record: AbstractRecord) -> Any:
    """Where fits to a record start: read off a step response, or the best of a grid."""
    return _input_starts if isinstance(record, InputRecord) else _starts


def _started(
    record: AbstractRecord, start: Callable[..., AbstractPlant], options: dict[str, Any]
) -> Fitted:
    """The fit from a start of the record."""
    return _checked_fit(record, start(record, options.get("fixed", ())), options)


def _checked_fit(record: AbstractRecord, start: AbstractPlant, options: dict[str, Any]) -> Fitted:
    check_options(start, options.get("fixed", ()), None, options.get("loss", "squares"))
    return fit(record, start, **options)


def _chain_fit(
    start: Callable[..., AbstractPlant],
    next_start: Callable[..., AbstractPlant] | None,
    record: AbstractRecord,
    options: dict[str, Any],
) -> Fitted:
    """The fit from `start(record, n, fixed)` for one order n or the best of several.

    Each further order starts from `next_start(plant, n)`, the plant being the optimum of the order
    before, or from the record as well.
    """
    options = dict(options)
    order, orders = options.pop("order", "auto"), options.pop("orders", DEFAULT_ORDERS)
    fit_from = functools.partial(_checked_fit, options=options)

    def begin(n: Array) -> AbstractPlant:
        return start(record, n, options.get("fixed", ()))

    if order == "auto":
        numbers, weights = check_orders(orders), options.get("weights")
        following = next_start or (lambda _, n: begin(n))
        first = begin(jnp.asarray(numbers[0]))
        return best_order(record, weights, numbers, first, following, fit_from)
    if isinstance(order, int | np.integer) and not isinstance(order, bool):
        return fit_from(record, begin(jnp.asarray(check_orders([int(order)])[0])))
    raise ValueError(f"order must be a whole number from 2 to 8 or 'auto', got {order!r}.")
