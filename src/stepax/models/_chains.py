"""Plants that are chains of real lags, with dead time: one class a family."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Complex, Float, Shaped

from .._arrays import Flag, Lags, Samples, Scalar, as_real
from ._abstract import (
    TIME,
    AbstractChain,
    Factor,
    TimeScales,
)
from ._contour import Slopes, chain_response, chain_slopes
from ._free import free_odds, free_positive, positive, root_of_odds
from ._orders import as_real_order, in_range, positions
from ._realisation import AbstractRealisation
from ._responses import (
    MAX_REAL_ORDER,
    equal_lag_ramp,
    equal_lag_response,
    equal_spacing_inflection,
    equal_spacing_response,
    equal_spacing_slopes,
    first_order_response,
    first_order_slopes,
    one_minus_multiple,
)
from ._spread import AbstractSpreadChain


class Hudzovic(AbstractSpreadChain):
    r"""$\prod_{k=1}^n 1/(1 + s T_k)$ with $T_k = T/(1 - (k-1) r)$.

    Source: P. Hudzovic (1994); Murray (2016), eq. 2.7. Rates 1/T_k are equally spaced; T is the
    smallest lag (unit of time, > 0). **Range:** 0 <= r < 1/(n-1), outside it the response is NaN;
    r has no effect for n = 1. r = 0 is equal lags.
    """

    r_at_equal_lags = 0.0
    reaches_first_order = False  # r = 1/(n-1) is outside its range
    has_formulae = False

    @property
    def ratio(self) -> Scalar:
        """1 - (n-1) r, the ratio of the extreme rates."""
        return one_minus_multiple(self.n - 1, self.r)

    @classmethod
    def r_of_ratio(cls, s: Scalar, n) -> Scalar:
        """(1 - s)/(n - 1)."""
        return (1 - s) / jnp.maximum(n - 1, 1)

    @classmethod
    def has_shape(cls, r: Scalar, n) -> Flag:
        """0 <= r < 1/(n-1)."""
        return (r >= 0) & (one_minus_multiple(n - 1, r) > 0)

    @classmethod
    def width_of_r(cls, n) -> Any:
        """1/(n-1)."""
        return 1 / jnp.maximum(n - 1, 1)

    @property
    def lags(self) -> Lags:
        """T_k, ascending."""
        length, used = positions(self.n)
        rates = one_minus_multiple(np.arange(length), self.r)
        return jnp.where(used, self.T / jnp.where(used, rates, 1), 0)

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), by the closed form for equally spaced rates."""
        slowest = self.ratio
        valid = (slowest > 0) & (self.r >= 0) & in_range(self.n)
        slowest = jnp.where(valid, slowest, jnp.nan)
        return equal_spacing_response(t / self.T, slowest, self.r, self.n)

    def slopes(self, t: Samples, changes: Sequence[dict[str, Array]]) -> Slopes:
        """T stretches the time; r moves the slowest rate and the spacing."""
        steps = [(-(self.n - 1) * x["r"], x["r"]) for x in changes if "r" in x]
        found = equal_spacing_slopes(t / self.T, self.ratio, self.r, self.n, steps)
        return _stretched(found, t, self.T, changes)

    def response_and_slope(self, t: Array) -> tuple[Array, Array]:
        """g and t dg/dt."""
        return jax.jvp(self.unit_response, (t,), (t,))

    def inflection(self) -> tuple[Array, Array]:
        """Where E = n - 1, in closed form."""
        return equal_spacing_inflection(self.T, self.r, self.n)


class Sani(AbstractSpreadChain):
    r"""$\prod_{k=1}^n 1/(1 + s T_k)$ with $T_k = T r^{k-1}$.

    Source: A. Balestrino, G. Marani, L. Sani (2001); Murray (2016), eq. 2.8. T is the largest lag
    (unit of time, > 0). **Range:** 0 <= r <= 1; r = 0 is one lag, r = 1 equal lags. A negative r
    gives NaN.
    """

    r_at_equal_lags = 1.0
    reaches_first_order = True
    has_formulae = True

    @property
    def ratio(self) -> Scalar:
        """r itself, the ratio of neighbouring rates."""
        return self.r

    @classmethod
    def r_of_ratio(cls, s: Scalar, n) -> Scalar:
        """s itself."""
        return s

    @classmethod
    def has_shape(cls, r: Scalar, n) -> Flag:
        """0 <= r <= 1."""
        return (r >= 0) & (r <= 1)

    @classmethod
    def width_of_r(cls, n) -> Any:
        """1."""
        return 1.0

    def _relative_lags(self) -> Array:
        length, used = positions(self.n)
        power = jnp.where(self.r >= 0, jnp.ones_like(self.r), jnp.nan)
        powers = [power]
        for _ in range(length - 1):
            power = power * self.r
            powers.append(power)
        return jnp.where(in_range(self.n), jnp.where(used, jnp.stack(powers), 0), jnp.nan)

    @property
    def lags(self) -> Lags:
        """T_k, descending."""
        return self.T * self._relative_lags()

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), by contour quadrature."""
        return chain_response(t / self.T, self._relative_lags())

    def slopes(self, t: Samples, changes: Sequence[dict[str, Array]]) -> Slopes:
        """T stretches the time; r moves all lags but the first."""
        lags, change = jax.linearize(
            lambda r: dataclasses.replace(self, r=r)._relative_lags(), self.r
        )
        steps = [change(x["r"]) for x in changes if "r" in x]
        return _stretched(chain_slopes(t / self.T, lags, steps), t, self.T, changes)


class EqualLag(AbstractChain):
    r"""$1/(1 + sT)^n$: n equal lags, the gamma distribution function for real n.

    Source: V. Strejc (1959); W. Latzel (1988), whose table has n = 2.5. T in units of time, > 0.
    **Range:** real 0 < n <= 40 (NaN outside), or any Python int n >= 1, or an integer array up to
    8. A fractional n has no `.lags`, `.poles` or exports (`ValueError`).
    """

    T: Float[Array, "..."] = eqx.field(converter=as_real, metadata=TIME)
    n: int | Shaped[Array, "..."] = eqx.field(converter=as_real_order)

    @property
    def is_whole(self) -> bool:
        """Whether n is a whole number by type, and no parameter."""
        return isinstance(self.n, int) or jnp.issubdtype(self.n.dtype, jnp.integer)

    def own_in_range(self) -> Any:
        """T > 0, and an order that can be evaluated."""
        order = (self.n > 0) & (self.n <= MAX_REAL_ORDER)
        return (self.T > 0) & (in_range(self.n) if self.is_whole else order)

    def own_to_free(self) -> dict[str, Array]:
        """n T, and a real n."""
        free = {"T": free_positive(self.n * self.T)}
        if self.is_whole:
            return free
        return free | {"n": free_odds(jnp.sqrt(self.n / (MAX_REAL_ORDER - self.n)))}

    def own_from_free(self) -> dict[str, Array]:
        """T, and a real n."""
        if self.is_whole:
            return {"T": positive(self.T) / self.n}
        n = MAX_REAL_ORDER / (1 + root_of_odds(-jnp.asarray(self.n)) ** 2)
        return {"T": positive(self.T) / n, "n": n}

    def _whole_order(self) -> Any:
        if isinstance(self.n, int) or self.is_whole:
            return self.n
        if isinstance(self.n, Tracer) or self.n.ndim or float(self.n) % 1:
            raise ValueError(
                f"EqualLag with a fractional or traced order (n = {self.n}) is no chain of lags:"
                " it has no lags, poles or exports. Use step_response, or round n."
            )
        return int(self.n)

    @property
    def lags(self) -> Lags:
        """n times T; `ValueError` for a fractional n."""
        _, used = positions(self._whole_order())
        return jnp.where(used, self.T, jnp.zeros_like(self.T))

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), by the closed form."""
        if not self.is_whole:
            return equal_lag_response(t, self.T, self.n)
        rate = jnp.where(in_range(self.n), jnp.ones_like(self.T), jnp.nan)
        return equal_spacing_response(t / self.T, rate, jnp.zeros_like(self.T), self.n)

    def realise(self, interval: Scalar) -> AbstractRealisation | None:
        """One state for each lag; a real order has no finite number of them."""
        return super().realise(interval) if self.is_whole else None

    def unit_ramp(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """The integral of the response to a step, in closed form."""
        return equal_lag_ramp(t, self.T, self.n)

    def mean_response(self, t: Samples, width: Scalar) -> Samples:
        """Mean of g over a `width` of time up to each t; t rises by the same width.

        Differences of the ramp lose digits where the width is short beside T; there quadrature
        serves, but for the first two means, whose integrand begins like a root or a power.
        """
        ends = jnp.concatenate([t[:1] - width, t])
        exact = jnp.diff(self.unit_ramp(ends)) / width
        nodes, weights = np.polynomial.legendre.leggauss(8)
        mean = sum(
            weight / 2 * self.unit_response(t - (1 - node) / 2 * width)
            for node, weight in zip(nodes, weights, strict=True)
        )
        return jnp.where((width > self.T) | (jnp.arange(t.size) < 2), exact, mean)

    def unit_transfer_function(self, s: Complex[Array, "*shape"]) -> Complex[Array, "*shape"]:
        """G(s), also for a fractional n."""
        return jnp.exp(-self.n * jnp.log1p(s * self.T))

    def denominator(self) -> list[Factor]:
        """One factor to the power n, which may be fractional."""
        return [Factor((1.0, float(np.asarray(self.T))), float(np.asarray(self.n)))]

    def time_scales(self) -> TimeScales:
        """T alone; n of them delay the end."""
        T, n = float(self.T), float(self.n)
        return TimeScales(T, T, (40 + 10 * n) * T)


class PTn(AbstractChain):
    r"""$\prod_k 1/(1 + s\,\text{lags}_k)$ with individual time constants, in any order.

    Source: Murray (2016), section 2.4 and `ptn_fit`. **Range:** lags >= 0, unit of time; a lag of
    0 is no lag; a negative one gives NaN.
    """

    lags: Float[Array, "..."] = eqx.field(converter=as_real, metadata=TIME)  # pyright: ignore[reportIncompatibleMethodOverride, reportAssignmentType]

    def own_in_range(self) -> Any:
        """Lags >= 0."""
        return jnp.all(self.lags >= 0)

    def _paces(self) -> Array:
        """How fast each lag moves in its free number: equal lags part."""
        return 1 + 0.1 * jnp.arange(self.lags.size, dtype=self.lags.dtype)

    def own_to_free(self) -> dict[str, Array]:
        """Each lag."""
        return {"lags": free_positive(self.lags) / self._paces()}

    def own_from_free(self) -> dict[str, Array]:
        """Each lag."""
        return {"lags": positive(self.lags * self._paces())}

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), by contour quadrature."""
        return chain_response(t, jnp.where(self.lags >= 0, self.lags, jnp.nan))

    def slopes(self, t: Samples, changes: Sequence[dict[str, Array]]) -> Slopes:
        """By contour quadrature."""
        return chain_slopes(t, self.lags, [change["lags"] for change in changes])


class FOPDT(AbstractChain):
    r"""First order plus dead time: $1/(1 + sT)$, T > 0 in units of time.

    Source: A. Maxim, R. De Keyser, eq. of the FOPDT model.
    """

    T: Float[Array, "..."] = eqx.field(converter=as_real, metadata=TIME)

    def own_in_range(self) -> Any:
        """T > 0."""
        return self.T > 0

    def own_to_free(self) -> dict[str, Array]:
        """T."""
        return {"T": free_positive(self.T)}

    def own_from_free(self) -> dict[str, Array]:
        """T."""
        return {"T": positive(self.T)}

    @property
    def lags(self) -> Lags:
        """The one time constant."""
        return jnp.reshape(self.T, (1,))

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), in closed form."""
        return first_order_response(t, self.T)

    def own_motions(self, t: Samples) -> list[Samples]:
        """1 - g."""
        return [1 - self.unit_response(t)]

    def slopes(self, t: Samples, changes: Sequence[dict[str, Array]]) -> Slopes:
        """All from one exponential."""
        return first_order_slopes(t, self.T, [change["T"] for change in changes])


def _stretched(found: Slopes, t: Samples, T: Scalar, changes: Sequence[dict[str, Array]]) -> Slopes:
    """Slopes of a response in t / T, and by moves of r alone, as those of a response in t."""
    slope, by_shape = found.in_time / T, iter(found.changes)
    moved = []
    for x in changes:
        move = next(by_shape) if "r" in x else jnp.zeros_like(slope)
        moved.append(move - t / T * slope * x["T"] if "T" in x else move)
    return Slopes(found.response, slope, moved)
