r"""What the state of a plant becomes after a while: matrix exponentials without loss of digits.

A plant and its input are one linear system, $\dot x = A x$, whose first two states are the slope of
the input and the input itself; then the state after a time t is $e^{A t} x$, for an input held
constant or moving along a line alike (C. Van Loan 1978, IEEE Trans. Automatic Control 23, 395-404).

The exponential is squared up from a short time h = t/2^k, where a few terms of its series do. That
keeps all digits although one lag may be a million times longer than another. In a chain of lags all
entries are positive: sums do not cancel, and entries off the diagonal gain a rounding error or two
in each squaring. The diagonal, whose errors would double each time, is written down
(A. Al-Mohy, N. Higham 2009, SIAM J. Matrix Anal. Appl. 31, 970-989). For two poles of any damping
the same is done with their response, which keeps its digits while it is small.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arrays import Lags, Scalar


EXACT = jax.lax.Precision.HIGHEST
"""Of matrix products: accelerators multiply single precision with ten bits unless told so."""

WIDEST = 43
"""A time over the shortest time constant is followed up to 2^43; what is shorter counts as that."""


def shortest_lag(dtype) -> float:
    """Lag, over the sampling interval, below which it is a dead time to rounding.

    1/(1 + sT) and e^-sT differ by (sT)^2/2: 5e-15 in float64, 5e-9 in float32.
    """
    return 1e-4 if jnp.finfo(dtype).bits <= 32 else 1e-7


def doublings(dtype) -> int:
    """Squarings after which an interval over its `shortest_lag` is below 1/2 at the start."""
    return math.ceil(math.log2(1 / shortest_lag(dtype))) + 1


def chain_transition(
    time: Scalar, rates: Lags, integrators: int, squarings: int
) -> Float[Array, "states states"]:
    r"""$e^{A t}$ of slope, input, its integrals if so wished, and a chain of lags behind them.

    $\dot x_i = r_i (x_{i-1} - x_i)$ for rates r = 1/T; a rate of 0 is no lag: it, and what comes
    after it, stays 0. A rate times the time is at most $2^{k-1}$ after k squarings; what is faster
    counts as that.
    """
    rates = _limited(rates, time, squarings)
    free = jnp.zeros(2 + integrators, rates.dtype)
    falls = jnp.concatenate([free, rates])
    one = jnp.eye(falls.size, dtype=jnp.result_type(time, rates))
    short = jnp.diag(jnp.concatenate([free[1:] + 1, rates]), -1) - jnp.diag(falls)
    short = short * (time * 0.5**squarings)
    # the first term of the last entry is the product of all couplings, and what follows it
    # shrinks faster than 2^-k/k!: 1e-17 after 13 more
    terms = np.arange(falls.size + 12, 0, -1.0)

    def series(total, k):
        return one + jnp.matmul(short, total, precision=EXACT) / k, None

    def square(power, share):
        power = jnp.matmul(power, power, precision=EXACT)
        return jnp.where(one > 0, jnp.exp(-falls * time * share)[:, None], power), None

    power, _ = jax.lax.scan(series, one, jnp.asarray(terms, one.dtype))
    shares = jnp.asarray(0.5 ** np.arange(squarings - 1, -1, -1.0), one.dtype)
    return jax.lax.scan(square, power, shares)[0]


def _limited(rates: Array, time: Scalar, squarings: int) -> Array:
    """Rates so slow that the time times half a power of them can be squared up."""
    most = 2.0 ** (squarings - 1)
    fast = rates * time > most
    return jnp.where(fast, most / jnp.where(fast, time, 1), rates)


@functools.partial(jax.jit, static_argnums=3)
def second_order_transition(
    time: Scalar, zeta: Scalar, omega_n: Scalar, squarings: int = WIDEST
) -> Float[Array, "4 4"]:
    r"""$e^{A t}$ of slope, input, output y and $w = \dot y/\omega_n$ of two poles, any damping.

    With $\tau = \omega_n t$ it consists of the responses g to a step and $\rho$ to a ramp of time
    $\tau$, and of the slope $\sigma = dg/d\tau$. They double by

    $$ g \to (2 - g) g + \sigma^2, \quad \sigma \to 2\sigma (1 - g - \zeta\sigma), \quad
       \rho \to (2 - g)\rho + (\sigma + \tau) g, $$

    where a g that is small keeps its relative accuracy.
    """
    # where even that many squarings begin too late, both poles are made slower alike: the sum of
    # two lags, all that is seen of them, stays
    excess = jnp.maximum(jnp.maximum(1, 2 * zeta) * omega_n * time * 2.0 ** (1 - squarings), 1)
    zeta = zeta / jnp.sqrt(excess)
    omega_n = _limited(omega_n / jnp.sqrt(excess), time, squarings)
    tau = omega_n * time * 0.5**squarings
    g, sway, ramp = _second_order_series(tau, zeta)

    def double(parts, _):
        g, sway, ramp, tau = parts
        ramp = (2 - g) * ramp + (sway + tau) * g
        g, sway = (2 - g) * g + sway * sway, 2 * sway * (1 - g - zeta * sway)
        return (g, sway, ramp, 2 * tau), None

    parts, _ = jax.lax.scan(double, (g, sway, ramp, tau), length=squarings)
    g, sway, ramp, _ = parts
    none, one = jnp.zeros_like(g), jnp.ones_like(g)
    rows = (
        (one, none, none, none),
        (time * one, one, none, none),
        (ramp / omega_n, g, 1 - g, sway),
        (g / omega_n, sway, -sway, 1 - g - 2 * zeta * sway),
    )
    return jnp.stack([jnp.stack(row) for row in rows])


def _second_order_series(tau: Scalar, zeta: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    r"""g, its slope and its integral for $\tau$ and $2 \zeta\tau$ up to 1/2, by powers of time.

    $\alpha_{k+2} = -\left(2 \zeta\tau\, \alpha_{k+1} + \tau^2 \alpha_k/(k+1)\right)/(k+2)$ from
    $\alpha_2 = \tau^2/2$ on; the terms are written without one $\tau$, which may be 0.
    """
    before, term = jnp.zeros_like(tau * zeta), tau / 2 + 0 * zeta
    g, slope, integral = term, 2 * term, term / 3
    for k in range(1, 15):
        before, term = term, -(2 * zeta * tau * term + tau * tau * before / (k + 1)) / (k + 2)
        g, slope, integral = g + term, slope + (k + 2) * term, integral + term / (k + 3)
    return tau * g, slope, tau * tau * integral
