r"""Chains of lags by their spread: Hudzovic's and Sani's, on one coordinate.

Both families become even functions of a spread at equal lags: reversing a chain of lags does not
change it. With s the ratio of the extreme rates (Sani: r of neighbours; Hudzovic: T_1/T_n =
1 - (n-1) r) the coordinate

$$ c = 4s/(1+s)^2, \qquad s = c/(1 + \sqrt{1-c})^2 $$

runs from 0 (first order) to 1 (equal lags), and every curve of characteristic times has a finite
slope not 0 in c = 1, where the slope in r vanishes.
"""

import abc
import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._arrays import Count, Flag, Scalar, as_real
from ._abstract import TIME, AbstractChain
from ._contour import chain_derivatives
from ._free import free_positive, free_ratio, positive, ratio
from ._orders import as_order, in_range
from ._responses import MAX_ORDER


DEFAULT_ORDERS = range(2, MAX_ORDER + 1)
"""Orders that a lookup and a fit consider unless told otherwise."""


class AbstractSpreadChain(AbstractChain):
    """A chain of order n whose lags follow from one of them and one shape parameter r.

    How far the lags lie apart is told by a `ratio` s of rates, from 0 (one lag) to 1 (equal lags).
    """

    # Facts of a class, not annotated: the end of the range of r where all lags are equal; whether
    # the other end, one lag, is a value of r and not only a limit; whether Sani's interpolation
    # formulae (Murray 2016, eqs. 2.17-2.19) are for this family.
    r_at_equal_lags = math.nan
    reaches_first_order = False
    has_formulae = False

    T: Float[Array, "..."] = eqx.field(converter=as_real, metadata=TIME)
    r: Float[Array, "..."] = eqx.field(converter=as_real)
    n: int | Int[Array, "..."] = eqx.field(converter=as_order)

    @property
    @abc.abstractmethod
    def ratio(self) -> Scalar:
        """Ratio s of the slowest to the fastest rate, or of neighbours, as the family has it."""

    @classmethod
    @abc.abstractmethod
    def r_of_ratio(cls, s: Scalar, n) -> Scalar:
        """r of a chain of order n with a ratio s."""

    @classmethod
    @abc.abstractmethod
    def has_shape(cls, r: Scalar, n) -> Flag:
        """Whether r lies in the range of the family for that order."""

    @classmethod
    @abc.abstractmethod
    def width_of_r(cls, n) -> Any:
        """Length of the range of r."""

    def own_to_free(self) -> dict[str, Array]:
        """The sum of the lags, and the ratio of rates."""
        return {"T": free_positive(jnp.sum(self.lags)), "r": free_ratio(self.ratio)}

    def own_from_free(self) -> dict[str, Array]:
        """T and r."""
        r = self.r_of_ratio(ratio(self.r), self.n)
        lags = dataclasses.replace(self, T=jnp.ones_like(r), r=r).lags
        return {"T": positive(self.T) / jnp.sum(lags), "r": r}

    def own_in_range(self) -> Any:
        """T > 0, r of that order, and an order that can be evaluated."""
        return (self.T > 0) & self.has_shape(self.r, self.n) & in_range(self.n)

    def response_and_slope(self, t: Array) -> tuple[Array, Array]:
        """g and t dg/dt."""
        g, slope = chain_derivatives(t, self.lags, 1)
        return g, slope

    def inflection(self) -> tuple[Array, Array] | None:
        """Time and slope of the steepest rise where the family has a closed form."""
        return None


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
