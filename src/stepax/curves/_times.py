r"""Characteristic times of Hudzovic's and Sani's chains, and the lookup curves made of them.

Murray (2016), eqs. 2.11-2.14: Tu/Tg, 1/Tg, lam = (t90 - t10)/t50 and 1/t50 of the response at
T = 1, as functions of the order n and of r. Nothing is tabulated: every value is computed.
"""

import functools
import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from scipy import special

from .._arrays import as_real, nan_where
from ..models._contour import chain_derivatives
from ..models._plants import Hudzovic, Sani
from ..models._responses import MAX_ORDER
from ..models._spread import AbstractSpreadChain, check_spread_chain
from ._roots import increasing_root


FIRST_ORDER_LAM = math.log(9) / math.log(2)
"""(t90 - t10)/t50 of one lag."""


class Curves(NamedTuple):
    """The four curves at one (n, r): `tu_tg` Tu/Tg, `inv_tg` T/Tg, `lam`, `inv_t50` T/t50."""

    tu_tg: Array
    inv_tg: Array
    lam: Array
    inv_t50: Array


LEVELS = (0.1, 0.5, 0.9)
"""Shares of the change whose times Sani reads."""


def three_times(plant: AbstractSpreadChain) -> Array:
    """t10, t50, t90: roots of ln(g/(1-g)), which is nearly straight in ln t."""
    total = jnp.sum(plant.lags)
    levels = np.array(LEVELS)
    target = jnp.asarray(np.log(levels / (1 - levels)), total.dtype)
    eps = jnp.finfo(total.dtype).eps

    def logit(log_t):
        g, slope = plant.response_and_slope(jnp.exp(log_t))
        g = jnp.clip(g, eps, 1 - eps)
        return jnp.log(g / (1 - g)) - target, slope / (g * (1 - g))

    start = jnp.full_like(target, jnp.log(total))
    return jnp.exp(increasing_root(logit, start - 12, start + 4, start))


def tangent_line(plant: AbstractSpreadChain) -> tuple[Array, Array]:
    """Tu/Tg and 1/Tg of the tangent at the inflection."""
    t, slope = plant.inflection() or _searched_inflection(plant)
    return t * slope - plant.unit_response(t), slope


def _searched_inflection(plant: AbstractSpreadChain) -> tuple[Array, Array]:
    """Largest slope: the response's density is log-concave, so h'/h falls through 0 once."""
    lower, upper = inflection_bracket(plant)
    lags = plant.lags

    t = jnp.exp(
        increasing_root(lambda x: inflection_equation(lags, x), lower, upper, 0.5 * (lower + upper))
    )
    return t, chain_derivatives(t, lags, 1)[1] / t


def inflection_equation(lags: Array, log_t: Array) -> tuple[Array, Array]:
    """-d ln h / d ln t, which rises through 0 at the inflection, and its slope."""
    _, first, second, third = chain_derivatives(jnp.exp(log_t), lags, 3)
    ratio = second / first
    return -ratio, ratio * ratio - ratio - third / first


def inflection_bracket(plant: AbstractSpreadChain) -> tuple[Array, Array]:
    """Bounds of ln t: the mode of the first two lags (each further one delays it), the mean."""
    r = jnp.clip(plant.r, 1e-30, 1)
    apart = jnp.where(r < 0.999, r, 0.5)
    lower = jnp.where(r < 0.999, jnp.log(-apart * jnp.log(apart) / (1 - apart)), -1e-3)
    return lower - 1e-3 + jnp.log(plant.T), jnp.log(jnp.sum(plant.lags))


def _plant_curves(plant: AbstractSpreadChain) -> Curves:
    tu_tg, inv_tg = tangent_line(plant)
    t10, t50, t90 = three_times(plant)
    return Curves(tu_tg, inv_tg, (t90 - t10) / t50, 1 / t50)


def lookup_curves(
    model: type[Hudzovic] | type[Sani], n: ArrayLike, r: Float[ArrayLike, "..."]
) -> Curves:
    """Murray's lookup curves at T = 1 (eqs. 2.11-2.14).

    **Arguments:**

    - `model`: the class `Hudzovic` or `Sani`.
    - `n`: order, 2 to 8. `r`: shape parameter of that class. Scalars or arrays that broadcast.

    **Returns:** `Curves` with `.tu_tg`, `.inv_tg`, `.lam`, `.inv_t50`; NaN for an n or r out of
    range. Relative accuracy about 1e-12 in float64 (Sani's Tu/Tg loses digits like 1e-13/(Tu/Tg)).
    """
    check_spread_chain(model)
    return _lookup_curves(model, jnp.asarray(n), as_real(r))


@eqx.filter_jit
def _lookup_curves(model, n: Array, r: Array) -> Curves:
    def one(n, r):
        valid = (n >= 2) & (n <= MAX_ORDER) & model.has_shape(r, n)
        r = jnp.where(valid, r, 0)
        n = jnp.where(valid, n, 2)
        return nan_where(~valid, _plant_curves(model(T=jnp.ones_like(r), r=r, n=n)))

    return Curves(*jnp.vectorize(one, signature="(),()->(),(),(),()")(n, r))


@functools.cache
def equal_lag_ends(orders: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Largest Tu/Tg and smallest lam of each order: those of equal lags, in closed form."""
    n = np.array(orders, float)
    t10, t50, t90 = (special.gammaincinv(n, p) for p in (0.1, 0.5, 0.9))
    slope = np.exp((n - 1) * np.log(n - 1) - (n - 1) - special.gammaln(n))
    return (n - 1) * slope - special.gammainc(n, n - 1), (t90 - t10) / t50
