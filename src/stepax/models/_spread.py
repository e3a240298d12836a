r"""Chains of lags by their spread: Hudzovic's and Sani's, on one coordinate.

Both families become even functions of a spread at equal lags: reversing a chain of lags does not
change it. With s the ratio of the extreme rates (Sani: r of neighbours; Hudzovic: T_1/T_n =
1 - (n-1) r) the coordinate

$$ c = 4s/(1+s)^2, \qquad s = c/(1 + \sqrt{1-c})^2 $$

runs from 0 (first order) to 1 (equal lags), and every curve of characteristic times has a finite
slope not 0 in c = 1, where the slope in r vanishes.
"""

from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._arrays import Count, Scalar
from ._abstract import AbstractSpreadChain
from ._responses import MAX_ORDER


DEFAULT_ORDERS = range(2, MAX_ORDER + 1)
"""Orders that a lookup and a fit consider unless told otherwise."""


def chain_with_spread(
    model: type[AbstractSpreadChain], log_c: Scalar, n: int | Count
) -> AbstractSpreadChain:
    """Chain whose lags sum to 1 at a spread coordinate c <= 1; its times are smooth in c too."""
    return chain_of_ratio(model, jnp.exp(log_c) / (1 + jnp.sqrt(-jnp.expm1(log_c))) ** 2, n)


def chain_of_ratio(
    model: type[AbstractSpreadChain], s: Scalar, n: int | Count
) -> AbstractSpreadChain:
    """Chain whose lags sum to 1 at a ratio 0 < s <= 1 of its slowest to its fastest rate."""
    r = model.r_of_ratio(s, n)
    return model(T=1 / jnp.sum(model(T=jnp.ones_like(s), r=r, n=n).lags), r=r, n=n)


def check_orders(orders: Iterable[int], least: int = 2) -> tuple[int, ...]:
    """`orders` ascending, or a `ValueError` that says what they may be."""
    orders = tuple(sorted(set(orders)))
    if not orders or not all(
        isinstance(n, int | np.integer) and least <= n <= MAX_ORDER for n in orders
    ):
        raise ValueError(f"orders must be whole numbers from {least} to {MAX_ORDER}, got {orders}.")
    return orders


def check_spread_chain(model: Any) -> None:
    """A `TypeError` for what is no class of chains with lookup curves."""
    chain = isinstance(model, type) and issubclass(model, AbstractSpreadChain)
    if not chain or model is AbstractSpreadChain:
        raise TypeError(f"lookup curves exist for the classes Hudzovic and Sani, got {model!r}.")
