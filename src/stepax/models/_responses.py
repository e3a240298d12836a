r"""Unit step responses in closed form: gain 1, no dead time, at rest before t = 0.

Plain functions of time: any shape of `t`, 0 or less gives 0, smooth in every parameter, errors of
a few units in the last place of 1. Chains of arbitrary real lags are in `_contour.py`.
"""

import functools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jax.scipy.special import gammaln
from jaxtyping import Array, Float, Int

from .._arrays import Scalar, computed_once
from ._contour import Slopes, lag_power_response


MAX_ORDER = 8
"""Largest order of a chain whose order is an array; a Python int may be larger."""

MAX_REAL_ORDER = 40
"""Largest real order of equal lags; beyond it the response is NaN."""


def _after_start(t: Array) -> tuple[Array, Array]:
    """Whether t > 0, and times that are safe to differentiate at everywhere."""
    started = t > 0
    return started, jnp.where(started, t, jnp.ones_like(t))


def one_minus_multiple(k: int | np.ndarray | Array, r: Scalar) -> Array:
    """`1 - k r` without the rounding error of `k r`; k >= 0 whole, an array up to `MAX_ORDER`.

    Subtracts power-of-two multiples of r: near `k r = 1` each partial difference is exact
    (Sterbenz), so that Hudzovic's lags keep their digits up to the end of the range of r.
    """
    value = jnp.ones_like(r)
    bits = int(MAX_ORDER if isinstance(k, Array) else np.max(k)).bit_length()
    for bit in reversed(range(bits)):
        value = value - (k >> bit & 1) * (1 << bit) * r
    return value


def first_order_response(t: Float[Array, "*shape"], T: Scalar) -> Float[Array, "*shape"]:
    r"""$g(t) = 1 - e^{-t/T}$."""
    started, t = _after_start(t)
    return jnp.where(started, -jnp.expm1(-t / T), 0)


def first_order_slopes(t: Array, T: Scalar, changes: Sequence[Scalar]) -> Slopes:
    """The response and its slopes from one exponential; `changes` of T."""
    started, t = _after_start(t)
    rate = 1 / T
    x = rate * t
    left = jnp.exp(-x)  # half the time of `expm1`; g is as accurate as a unit of 1
    slope = jnp.where(started, rate * left, 0)
    return Slopes(
        jnp.where(started, 1 - left, 0), slope, [-x * slope * change for change in changes]
    )


def decay_integral(rate: Float[Array, "..."], t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    r"""$E = (1 - e^{-d t})/d$; t at d = 0, and smooth through it."""
    x = rate * t
    small = jnp.abs(x) < 0.1
    near = jnp.where(small, x, jnp.zeros_like(x))
    series = jnp.ones_like(x)
    for k in range(10, 1, -1):  # 0.1^10 / 11! < 2e-18
        series = 1 - near / k * series
    far = jnp.where(small, jnp.ones_like(x), x)
    return t * jnp.where(small, series, -jnp.expm1(-far) / far)


def equal_spacing_response(
    t: Float[Array, "*shape"], slowest: Scalar, spacing: Scalar, order: int | Int[Array, ""]
) -> Float[Array, "*shape"]:
    r"""Chain whose rates are m, m + d, ..., m + (n-1) d: Hudzovic's, and equal lags at d = 0.

    With $E = (1 - e^{-d t})/d$,

    $$ g(t) = 1 - e^{-m t} \sum_{j=0}^{n-1} \frac{E^j}{j!} \prod_{i=0}^{j-1} (m + i d), $$

    which is the regularised incomplete beta function $I_{1 - e^{-d t}}(n, m/d)$ (derived from the
    partial fractions of Murray 2016, eq. 2.5 with 2.7). All terms are positive: nothing cancels,
    neither at equal lags nor as m -> 0.

    **Arguments:** `slowest` is m > 0 and `spacing` is d >= 0, both 1/unit of `t`; `order` is n,
    at most `MAX_ORDER` when it is an array.
    """
    length = order if isinstance(order, int) else MAX_ORDER
    return _equal_spacing(t, slowest, spacing, jnp.asarray(order), length)


@functools.partial(jax.custom_jvp, nondiff_argnums=(4,))
def _equal_spacing(t, slowest, spacing, order, length: int) -> Array:
    started, t = _after_start(t)
    t = _before_overflow(t, slowest)
    total = _equal_spacing_sum(decay_integral(spacing, t), slowest, spacing, order, length)
    return jnp.where(started, 1 - jnp.exp(-slowest * t) * total, 0)


def _equal_spacing_sum(e: Array, slowest, spacing, order, length: int) -> Array:
    """The sum over j, by Horner's rule."""
    total = jnp.ones_like(e)
    for j in range(length - 1, 0, -1):
        factor = jnp.where(j < order, (slowest + (j - 1) * spacing) / j, 0)
        total = 1 + factor * e * total
    return total


def _equal_spacing_slope(e: Array, fall: Array, slowest, spacing, order, length: int) -> Array:
    r"""The slope in time, $e^{-m t} m \prod_{j=1}^{n-1} (m + j d) E/j$; `fall` is $e^{-m t}$."""
    slope = slowest * fall
    for j in range(1, length):
        slope = slope * jnp.where(j < order, (slowest + j * spacing) * e / j, 1)
    return slope


def _equal_spacing_jvp(length, primals, tangents):
    """The slope in time is written down, that in the rates derived.

    Only what has a tangent is computed, apart from the value (see `_contour.py`).
    """
    value = _equal_spacing(*primals, length)
    tangent = jnp.zeros_like(value)
    if not isinstance(tangents[0], SymbolicZero):
        t, slowest, spacing, order = jax.lax.optimization_barrier(primals)
        started, t = _after_start(t)
        limited = _before_overflow(t, slowest)
        e, fall = decay_integral(spacing, limited), jnp.exp(-slowest * limited)
        slope = _equal_spacing_slope(e, fall, slowest, spacing, order, length)
        tangent = tangent + jnp.where(started & (limited == t), slope, 0) * tangents[0]
    rates = [isinstance(x, SymbolicZero) for x in tangents[1:3]]
    if not all(rates):
        t, slowest, spacing, order = jax.lax.optimization_barrier(primals)
        response = lambda *rates: _equal_spacing.fun(t, *rates, order, length)  # noqa: E731
        directions = tuple(
            jnp.zeros_like(rate) if isinstance(x, SymbolicZero) else x
            for rate, x in zip((slowest, spacing), tangents[1:3], strict=True)
        )
        tangent = tangent + jax.jvp(response, (slowest, spacing), directions)[1]
    return value, tangent


_equal_spacing.defjvp(_equal_spacing_jvp, symbolic_zeros=True)


def equal_spacing_slopes(
    t: Array,
    slowest: Scalar,
    spacing: Scalar,
    order: int | Int[Array, ""],
    changes: Sequence[tuple[Scalar, Scalar]],
) -> Slopes:
    """`equal_spacing_response` and its slopes; `changes` of both rates."""
    length = order if isinstance(order, int) else MAX_ORDER
    started, t = _after_start(t)
    limited = _before_overflow(t, slowest)

    def total(e: Array, slowest: Scalar, spacing: Scalar) -> Array:
        return _equal_spacing_sum(e, slowest, spacing, order, length)

    e, by_spacing = jax.jvp(
        lambda d: decay_integral(d, limited), (spacing,), (jnp.ones_like(spacing),)
    )
    fall = jnp.exp(-slowest * limited)
    e, by_spacing = computed_once(e, by_spacing)
    slope = _equal_spacing_slope(e, fall, slowest, spacing, order, length)
    slope = jnp.where(started & (limited == t), slope, 0)
    (value,), moved = computed_once(total(e, slowest, spacing)), []
    for m, d in changes:
        _, change = jax.jvp(total, (e, slowest, spacing), (by_spacing * d, m, d))
        moved.append(jnp.where(started, fall * (m * limited * value - change), 0))
    return Slopes(jnp.where(started, 1 - fall * value, 0), slope, moved)


def equal_spacing_inflection(
    T: Scalar, r: Scalar, n: int | Int[Array, ""]
) -> tuple[Scalar, Scalar]:
    r"""Time and slope of the steepest rise of Hudzovic's chain.

    $t_i = \ln(1/s) T/r$ with $s = 1 - (n-1) r$, where $E = n - 1$, and there the slope is
    $\prod_k 1/T_k\; e^{-m t_i} E^{n-1}/(n-1)!$.
    """
    s = one_minus_multiple(n - 1, r)
    x = 1 - s
    small = x < 0.01
    near = jnp.where(small, x, 0)
    series = jnp.ones_like(x)
    for k in range(9, 1, -1):  # -log(1 - x)/x = 1 + x/2 + x^2/3 + ..., 0.01^9 = 1e-18
        series = 1 + near * (k - 1) / k * series
    t = (n - 1) * jnp.where(small, series, -jnp.log(s) / jnp.where(small, 1, x))
    log_slope = -s * t
    for k in range(1, n if isinstance(n, int) else MAX_ORDER):
        factor = one_minus_multiple(k, r) * (n - 1) / k
        log_slope = log_slope + jnp.log(jnp.where(k < n, factor, 1))
    return t * T, jnp.exp(log_slope) / T


def _before_overflow(t: Array, slowest: Scalar) -> Array:
    """Times up to that beyond which the response is 1 to rounding and the sum overflows."""
    return jnp.minimum(t, -math.log(float(jnp.finfo(t.dtype).tiny)) / slowest)


@jax.jit
def equal_lag_response(
    t: Float[Array, "*shape"], T: Scalar, n: int | Scalar
) -> Float[Array, "*shape"]:
    r"""$1/(1 + sT)^n$ for real n: the gamma distribution function $P(n, x)$, $x = t/T$.

    Split $n = a + k$ with $1 < a \le 2$ (k = 0 for n <= 1) and step up the recurrence
    $P(a+1, x) = P(a, x) - x^a e^{-x}/\Gamma(a+1)$ (DLMF 8.8.5):

    $$ P(a + k, x) = P(a, x) - \frac{x^a e^{-x}}{\Gamma(a+1)}
       \sum_{i=0}^{k-1} \prod_{l=1}^{i} \frac{x}{a+l}, $$

    with $P(a, x)$ from the contour kernel, whose error is small there. Unlike
    `jax.scipy.special.gammainc` it has derivatives of every order with respect to n.

    **Range:** 0 < n <= `MAX_REAL_ORDER`; outside it NaN.
    """
    started, t = _after_start(t)
    tiny = float(jnp.finfo(t.dtype).tiny)
    x = jnp.clip(t / T, tiny, -math.log(tiny))
    steps = jnp.maximum(jnp.ceil(n) - 2, 0)
    a = n - steps

    def add(total, i):
        return jnp.where(i <= steps, 1 + x / (a + i) * total, total), None

    places = np.arange(MAX_REAL_ORDER - 2, 0, -1)
    total, _ = jax.lax.scan(add, jnp.zeros_like(x * a), jnp.asarray(places, x.dtype))
    first = jnp.exp(a * jnp.log(x) - x - gammaln(a + 1))
    g = lag_power_response(t, T, a) - first * total
    valid = (n > 0) & (n <= MAX_REAL_ORDER)
    return jnp.where(started, jnp.where(valid, g, jnp.nan), 0)


def equal_lag_ramp(t: Float[Array, "*shape"], T: Scalar, n: int | Scalar) -> Float[Array, "*shape"]:
    r"""Integral of `equal_lag_response` over time: $t - nT$ and what is left of the transient,

    $$ T x^n e^{-x}/\Gamma(n) - (t - nT) (1 - P(n, x)), \qquad x = t/T, $$

    which is below rounding from 2 n + 60 lags on; there an error of P would be multiplied by t.
    """
    started, after = _after_start(t)
    x = after / T
    over = x > 2 * n + 60
    x = jnp.where(over, 1, x)
    short = (x - n) * (1 - equal_lag_response(x, jnp.ones_like(T), n))
    rest = T * (jnp.exp(n * jnp.log(x) - x - gammaln(n)) - short)
    return jnp.where(started, after - n * T + jnp.where(over, 0, rest), 0)


@jax.jit
def second_order_response(
    t: Float[Array, "*shape"], zeta: Scalar, omega_n: Scalar
) -> Float[Array, "*shape"]:
    r"""$\omega_n^2/(s^2 + 2\zeta\omega_n s + \omega_n^2)$ for any damping $\zeta > 0$.

    With $\tau = \omega_n t$ and $q = \tau^2 (\zeta^2 - 1)$,

    $$ 1 - g = e^{-\zeta\tau} (\cosh\sqrt q + \zeta\tau \sinh\sqrt q/\sqrt q), $$

    an entire function of q; see `_second_order_parts`.
    """
    started, t = _after_start(t)
    tau = omega_n * t
    c, s, _ = _second_order_parts(tau, zeta)
    return jnp.where(started, 1 - c - zeta * tau * s, 0)


@jax.jit
def second_order_zero_response(
    t: Float[Array, "*shape"], zeta: Scalar, omega_n: Scalar, lead: Scalar
) -> Float[Array, "*shape"]:
    r"""$(1 + s\,\text{lead})\,\omega_n^2/(s^2 + 2\zeta\omega_n s + \omega_n^2)$, lead of any sign.

    The response without the zero plus lead times its slope,
    $\omega_n \tau e^{-\zeta\tau} \sinh\sqrt q/\sqrt q$ in the terms of `second_order_response`.
    """
    started, t = _after_start(t)
    tau = omega_n * t
    c, s, _ = _second_order_parts(tau, zeta)
    return jnp.where(started, 1 - c + (lead * omega_n - zeta) * tau * s, 0)


def second_order_slopes(
    t: Array,
    zeta: Scalar,
    omega_n: Scalar,
    lead: Scalar,
    changes: Sequence[tuple[Scalar, Scalar, Scalar]],
) -> Slopes:
    r"""`second_order_zero_response` and its slopes; `changes` of zeta, omega_n and lead.

    With the parts c, s, d of `_second_order_parts` and $\nu = \text{lead}\,\omega_n$

    $$ \frac{\partial g}{\partial \tau} = \tau s + \nu (c - \zeta\tau s), \quad
       \frac{\partial g}{\partial \zeta} = -\tau^3 d + \nu \tau^2 (\zeta\tau d - s), \quad
       \frac{\partial g}{\partial \nu} = \tau s. $$
    """
    started, t = _after_start(t)
    tau, nu = omega_n * t, lead * omega_n
    c, s, d = _second_order_parts(tau, zeta)
    sway = jnp.where(started, tau * s, 0)
    c = jnp.where(started, c, 0)
    slope = sway + nu * (c - zeta * sway)
    by_zeta = jnp.where(started, tau * tau * (nu * (zeta * tau * d - s) - tau * d), 0)
    moved = [z * by_zeta + w * t * slope + (w * lead + omega_n * x) * sway for z, w, x in changes]
    response = jnp.where(started, 1, 0) - c + (nu - zeta) * sway
    return Slopes(response, omega_n * slope, moved)


def _second_order_parts(tau: Array, zeta: Scalar) -> tuple[Array, Array, Array]:
    r"""$e^{-\zeta\tau}$ times $\cosh\sqrt q$, $\sinh\sqrt q/\sqrt q$, and their difference over q.

    All are entire functions of $q = \tau^2 (\zeta^2 - 1)$: power series near q = 0, cosine and sine
    below. Above, $\zeta\tau - \sqrt q = \tau^2/(\zeta\tau + \sqrt q)$ is the exponent of the slow
    pole: nothing cancels or overflows.
    """
    excess = (zeta - 1) * (zeta + 1)
    q = tau * tau * excess
    decay = zeta * tau
    near, over = jnp.abs(q) < 1, q > 0
    m = tau * jnp.sqrt(jnp.where(near, 1, jnp.abs(excess)))
    fast = decay + m
    slow = jnp.where(over & ~near, tau * tau / fast, decay)
    fall = jnp.exp(-slow)

    small = jnp.where(near, q, jnp.zeros_like(q))
    c = s = d = jnp.zeros_like(q)
    for k in range(9, -1, -1):  # 1/20! < 1e-18
        c = 1 / math.factorial(2 * k) + small * c
        s = 1 / math.factorial(2 * k + 1) + small * s
        d = (2 * k + 2) / math.factorial(2 * k + 3) + small * d
    away = jnp.where(near, 1, m)
    rest = jnp.exp(-fast)
    # each ends in a division: see `computed_once`
    one = jnp.where(near, 1, tau) / jnp.where(near, 1, tau)
    c = jnp.where(near, fall * c, jnp.where(over, (fall + rest) / 2, fall * jnp.cos(away))) / one
    s = jnp.where(near, fall * s, jnp.where(over, (fall - rest) / 2, fall * jnp.sin(away))) / away
    d = jnp.where(near, fall * d, c - s) / jnp.where(near, 1, q)
    return c, s, d


def lagged_ramp_response(t: Float[Array, "*shape"], T: Scalar) -> Float[Array, "*shape"]:
    r"""$1/(s (1 + sT))$: $g(t) = t - T (1 - e^{-t/T})$, a ramp in the end; t itself for T = 0.

    By its series below x = t/T = 1/2, where the difference cancels: $T x^2/2 (1 - x/3 (1 - ...))$.
    A negative T gives NaN.
    """
    started, t = _after_start(t)
    lagged = T > 0
    safe = jnp.where(lagged, T, 1)
    x = t / safe
    small = x < 0.5
    near = jnp.where(small, x, jnp.zeros_like(x))
    series = jnp.ones_like(x)
    for k in range(16, 2, -1):  # 0.5^14 2/16! < 1e-17
        series = 1 - near / k * series
    far = t + safe * jnp.expm1(-jnp.where(small, 1, x))
    g = jnp.where(small, safe * near * near / 2 * series, far)
    # at T = 0 the derivative in T is -1: every lag comes too late by itself
    g = jnp.where(lagged, g, jnp.where(T == 0, t - T, jnp.nan))
    return jnp.where(started, g, 0)
