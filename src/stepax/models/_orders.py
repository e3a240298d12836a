"""Orders of chains: numbers that stay static, or arrays of them."""

import operator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from .._arrays import as_real
from ._responses import MAX_ORDER


def as_order(n: Any) -> Any:
    """Order of a chain: a Python int, which stays static, or an array of integers."""
    if isinstance(n, np.integer):
        n = operator.index(n)
    if n is None:  # so that a model can hold `in_axes`
        return n
    whole = isinstance(n, int) and not isinstance(n, bool)
    if isinstance(n, jax.Array | np.ndarray):
        whole = jnp.issubdtype(n.dtype, jnp.integer)
    if not whole:
        raise TypeError(f"the order n of a chain must be a whole number, got {n!r}.")
    if isinstance(n, int) and n < 1:
        raise ValueError(f"the order n of a chain must be at least 1, got {n}.")
    return n


def as_real_order(n: Any) -> Any:
    """Order of equal lags: a Python int stays static; anything else is a real array."""
    if isinstance(n, int | np.integer):
        return as_order(n)
    if isinstance(n, jax.Array | np.ndarray) and jnp.issubdtype(n.dtype, jnp.integer):
        return n
    n = as_real(n)
    if not isinstance(n, Tracer) and not np.all(np.asarray(n) > 0):
        raise ValueError(f"the order n of equal lags must be positive, got {n}.")
    return n


def positions(n) -> tuple[int, Array]:
    """Length of `.lags` and which of its places an order `n` uses."""
    length = n if isinstance(n, int) else MAX_ORDER
    return length, jnp.arange(length) < n


def in_range(n) -> Any:
    """Whether an order can be evaluated: any Python int, an array from 1 to `MAX_ORDER`."""
    return True if isinstance(n, int) else (n >= 1) & (n <= MAX_ORDER)
