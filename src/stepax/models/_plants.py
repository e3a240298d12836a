"""The plants: six families of process models with dead time.

All are frozen `equinox.Module`s: PyTrees that can be arguments of a jitted function, stacked along
a batch axis, and differentiated with `equinox.filter_grad`.
"""

import abc
import operator
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Complex, Float, Int, Shaped

from .._arrays import Lags, Samples, Scalar, as_real
from ._contour import chain_response
from ._export import control_transfer_function, scipy_transfer_function
from ._responses import (
    MAX_ORDER,
    equal_lag_response,
    equal_spacing_response,
    first_order_response,
    second_order_response,
)


def _as_order(n: Any) -> Any:
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


def _as_real_order(n: Any) -> Any:
    """Order of equal lags: a Python int stays static; anything else is a real array."""
    if isinstance(n, int | np.integer):
        return _as_order(n)
    if isinstance(n, jax.Array | np.ndarray) and jnp.issubdtype(n.dtype, jnp.integer):
        return n
    n = as_real(n)
    if not isinstance(n, Tracer) and not np.all(np.asarray(n) > 0):
        raise ValueError(f"the order n of equal lags must be positive, got {n}.")
    return n


def _positions(n) -> tuple[int, Array]:
    """Length of `.lags` and which of its places an order `n` uses."""
    length = n if isinstance(n, int) else MAX_ORDER
    return length, jnp.arange(length) < n


def _in_range(n) -> Any:
    """Whether an order can be evaluated: any Python int, an array from 1 to `MAX_ORDER`."""
    return True if isinstance(n, int) else (n >= 1) & (n <= MAX_ORDER)


class AbstractPlant(eqx.Module):
    r"""Process model: $\text{offset} + \text{gain} \cdot g(t - \text{delay})$ for a unit step.

    g rises from 0 to 1, monotone unless the model oscillates. Up to the delay the response is the
    offset. `gain` is output per unit of input, `delay` (dead time, >= 0) has the unit of time,
    `offset` the unit of the output; impulse and frequency response, static gain and exports leave
    the offset out.
    """

    gain: Float[Array, "..."] = eqx.field(converter=as_real, default=1.0, kw_only=True)
    offset: Float[Array, "..."] = eqx.field(converter=as_real, default=0.0, kw_only=True)
    delay: Float[Array, "..."] = eqx.field(converter=as_real, default=0.0, kw_only=True)

    @abc.abstractmethod
    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t): step response for gain 1, offset 0, delay 0."""

    @abc.abstractmethod
    def unit_transfer_function(self, s: Complex[Array, "*shape"]) -> Complex[Array, "*shape"]:
        """G(s) for gain 1 and delay 0."""

    @property
    @abc.abstractmethod
    def poles(self) -> Shaped[np.ndarray, " n"]:
        """Poles of the transfer function, on the host (concrete parameters)."""

    def _elapsed(self, t: ArrayLike) -> Array:
        """Time since the response begins."""
        return as_real(t) - self.delay

    def step_response(self, t: Float[ArrayLike, "*shape"]) -> Float[Array, "*shape"]:
        """Response to a unit step at t = 0, at times `t` of any shape."""
        return self.offset + self.gain * self.unit_response(self._elapsed(t))

    def impulse_response(self, t: Float[ArrayLike, "*shape"]) -> Float[Array, "*shape"]:
        """Response to a unit impulse at t = 0: the derivative of the step response.

        Its accuracy is absolute, relative to its largest value; 0 up to the delay.
        """
        elapsed = self._elapsed(t)
        _, slope = jax.jvp(self.unit_response, (elapsed,), (jnp.ones_like(elapsed),))
        return self.gain * slope

    def frequency_response(self, omega: Float[ArrayLike, "*shape"]) -> Complex[Array, "*shape"]:
        r"""Complex $G(j\omega)$ at angular frequencies `omega` (radian per unit of time)."""
        s = 1j * as_real(omega)
        return self.gain * jnp.exp(-s * self.delay) * self.unit_transfer_function(s)

    def respond(self, t: Float[ArrayLike, " samples"], u: Float[ArrayLike, " samples"]) -> Samples:
        r"""Response to a sampled input, held constant between samples (zero-order hold).

        $y(t_i) = \text{offset} + \text{gain} \sum_k (u_k - u_{k-1})\, g(t_i - t_k - L)$, exact for
        uneven times too. `u` is the deviation from the operating point, the plant is at rest
        before `t[0]`. Time and memory grow with the square of the number of samples.
        """
        t, u = as_real(t), as_real(u)
        moves = jnp.diff(u, prepend=jnp.zeros_like(u[:1]))
        return self.offset + self.gain * (
            self.unit_response(t[:, None] - t[None, :] - self.delay) @ moves
        )

    @property
    def static_gain(self) -> Scalar:
        """Change of the output per unit of input after all transients."""
        return self.gain

    def to_control(self, pade_order: int | None = None):
        """This model as a python-control `TransferFunction` (needs `stepax[control]`).

        A rational transfer function has no dead time: with a delay give `pade_order`, the order of
        the Pade approximation; without it a delay raises a `ValueError`.
        """
        return control_transfer_function(self, pade_order)

    def to_scipy(self, pade_order: int | None = None):
        """This model as `scipy.signal.ZerosPolesGain`; a delay as in `to_control`."""
        return scipy_transfer_function(self, pade_order)


class AbstractChain(AbstractPlant):
    r"""A chain of real lags, $\prod_k 1/(1 + s T_k)$."""

    if TYPE_CHECKING:

        @property
        def lags(self) -> Lags:
            """Time constants: shape (n,) for a Python int as order, else (8,), zeros last."""
            ...
    else:
        lags: eqx.AbstractVar[Lags]

    @property
    def poles(self) -> Shaped[np.ndarray, " n"]:
        """Poles -1/T_k in the order of the lags; a lag of 0 has none. Needs concrete lags."""
        lags = np.asarray(self.lags)
        return -1 / lags[lags > 0]

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), by contour quadrature."""
        return chain_response(t, self.lags)

    def unit_transfer_function(self, s: Complex[Array, "*shape"]) -> Complex[Array, "*shape"]:
        """G(s), the product over the lags."""
        lags = self.lags
        return jnp.prod(1 / (1 + s[..., None] * lags.reshape((1,) * s.ndim + (-1,))), axis=-1)


class Hudzovic(AbstractChain):
    r"""$\prod_{k=1}^n 1/(1 + s T_k)$ with $T_k = T/(1 - (k-1) r)$.

    Source: P. Hudzovic (1994); Murray (2016), eq. 2.7. Rates 1/T_k are equally spaced; T is the
    smallest lag (unit of time, > 0). **Range:** 0 <= r < 1/(n-1), outside it the response is NaN;
    r has no effect for n = 1. r = 0 is equal lags.
    """

    T: Float[Array, "..."] = eqx.field(converter=as_real)
    r: Float[Array, "..."] = eqx.field(converter=as_real)
    n: int | Int[Array, "..."] = eqx.field(converter=_as_order)

    @property
    def lags(self) -> Lags:
        """T_k, ascending."""
        length, used = _positions(self.n)
        rates = one_minus_multiple(np.arange(length), self.r)
        return jnp.where(used, self.T / jnp.where(used, rates, 1), 0)

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), by the closed form for equally spaced rates."""
        slowest = one_minus_multiple(self.n - 1, self.r)
        valid = (slowest > 0) & (self.r >= 0) & _in_range(self.n)
        slowest = jnp.where(valid, slowest, jnp.nan)
        return equal_spacing_response(t / self.T, slowest, self.r, self.n)


class Sani(AbstractChain):
    r"""$\prod_{k=1}^n 1/(1 + s T_k)$ with $T_k = T r^{k-1}$.

    Source: A. Balestrino, G. Marani, L. Sani (2001); Murray (2016), eq. 2.8. T is the largest lag
    (unit of time, > 0). **Range:** 0 <= r <= 1; r = 0 is one lag, r = 1 equal lags. A negative r
    gives NaN.
    """

    T: Float[Array, "..."] = eqx.field(converter=as_real)
    r: Float[Array, "..."] = eqx.field(converter=as_real)
    n: int | Int[Array, "..."] = eqx.field(converter=_as_order)

    def _relative_lags(self) -> Array:
        length, used = _positions(self.n)
        power = jnp.where(self.r >= 0, jnp.ones_like(self.r), jnp.nan)
        powers = [power]
        for _ in range(length - 1):
            power = power * self.r
            powers.append(power)
        return jnp.where(_in_range(self.n), jnp.where(used, jnp.stack(powers), 0), jnp.nan)

    @property
    def lags(self) -> Lags:
        """T_k, descending."""
        return self.T * self._relative_lags()

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), by contour quadrature."""
        return chain_response(t / self.T, self._relative_lags())


class EqualLag(AbstractChain):
    r"""$1/(1 + sT)^n$: n equal lags, the gamma distribution function for real n.

    Source: V. Strejc (1959); W. Latzel (1988), whose table has n = 2.5. T in units of time, > 0.
    **Range:** real 0 < n <= 40 (NaN outside), or any Python int n >= 1, or an integer array up to
    8. A fractional n has no `.lags`, `.poles` or exports (`ValueError`).
    """

    T: Float[Array, "..."] = eqx.field(converter=as_real)
    n: int | Shaped[Array, "..."] = eqx.field(converter=_as_real_order)

    @property
    def _is_whole(self) -> bool:
        return isinstance(self.n, int) or jnp.issubdtype(self.n.dtype, jnp.integer)

    def _whole_order(self) -> Any:
        if isinstance(self.n, int) or self._is_whole:
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
        _, used = _positions(self._whole_order())
        return jnp.where(used, self.T, jnp.zeros_like(self.T))

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), by the closed form."""
        if not self._is_whole:
            return equal_lag_response(t, self.T, self.n)
        rate = jnp.where(_in_range(self.n), jnp.ones_like(self.T), jnp.nan)
        return equal_spacing_response(t / self.T, rate, jnp.zeros_like(self.T), self.n)

    def unit_transfer_function(self, s: Complex[Array, "*shape"]) -> Complex[Array, "*shape"]:
        """G(s), also for a fractional n."""
        return jnp.exp(-self.n * jnp.log1p(s * self.T))


class PTn(AbstractChain):
    r"""$\prod_k 1/(1 + s\,\text{lags}_k)$ with individual time constants, in any order.

    Source: Murray (2016), section 2.4 and `ptn_fit`. **Range:** lags >= 0, unit of time; a lag of
    0 is no lag; a negative one gives NaN.
    """

    lags: Float[Array, "..."] = eqx.field(converter=as_real)  # pyright: ignore[reportIncompatibleMethodOverride, reportAssignmentType]

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), by contour quadrature."""
        return chain_response(t, jnp.where(self.lags >= 0, self.lags, jnp.nan))


class FOPDT(AbstractChain):
    r"""First order plus dead time: $1/(1 + sT)$, T > 0 in units of time.

    Source: A. Maxim, R. De Keyser, eq. of the FOPDT model.
    """

    T: Float[Array, "..."] = eqx.field(converter=as_real)

    @property
    def lags(self) -> Lags:
        """The one time constant."""
        return jnp.reshape(self.T, (1,))

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), in closed form."""
        return first_order_response(t, self.T)


class SOPDT(AbstractPlant):
    r"""Second order plus dead time: $\omega_n^2/(s^2 + 2\zeta\omega_n s + \omega_n^2)$.

    Source: A. Maxim, R. De Keyser. `zeta` is the damping, any zeta > 0; `omega_n` the undamped
    natural frequency in radian per unit of time, > 0. Smooth through zeta = 1.
    """

    zeta: Float[Array, "..."] = eqx.field(converter=as_real)
    omega_n: Float[Array, "..."] = eqx.field(converter=as_real)

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), in closed form."""
        return second_order_response(t, self.zeta, self.omega_n)

    def unit_transfer_function(self, s: Complex[Array, "*shape"]) -> Complex[Array, "*shape"]:
        """G(s)."""
        x = s / self.omega_n
        return 1 / (1 + x * (2 * self.zeta + x))

    @property
    def lags(self) -> Lags:
        """Both time constants of an overdamped model, descending; `ValueError` if it oscillates."""
        if not float(self.zeta) >= 1:
            raise ValueError(f"SOPDT with damping zeta = {self.zeta} < 1 has no real lags.")
        slow = (self.zeta + jnp.sqrt((self.zeta - 1) * (self.zeta + 1))) / self.omega_n
        return jnp.stack([slow, 1 / (slow * self.omega_n**2)])

    @property
    def poles(self) -> Shaped[np.ndarray, " n"]:
        """The two poles, complex for zeta < 1. Needs concrete parameters."""
        zeta, omega_n = np.asarray(self.zeta), np.asarray(self.omega_n)
        if zeta >= 1:
            return -1 / np.asarray(self.lags)
        damped = omega_n * np.sqrt((1 - zeta) * (1 + zeta))
        return np.array([-zeta * omega_n + 1j * damped, -zeta * omega_n - 1j * damped])


def one_minus_multiple(k: int | np.ndarray | Array, r: Scalar) -> Array:
    """`1 - k r` without the rounding error of `k r`, for a whole 0 <= k < 2^8.

    Subtracts power-of-two multiples of r: near `k r = 1` each partial difference is exact
    (Sterbenz), so that Hudzovic's lags keep their digits up to the end of the range of r.
    """
    value = jnp.ones_like(r)
    bits = 8 if isinstance(k, Array) else int(np.max(k)).bit_length()
    for bit in reversed(range(bits)):
        value = value - (k >> bit & 1) * (1 << bit) * r
    return value


def parameter_names(model: AbstractPlant) -> list[str]:
    """Names of a model's real parameters: its own first, then gain, offset and delay."""
    common = ["gain", "offset", "delay"]
    own = [name for name in model.__dataclass_fields__ if name not in common]
    return [name for name in own if eqx.is_inexact_array(getattr(model, name))] + common
