r"""What the state of a plant becomes after a while: matrix exponentials without loss of digits.

A plant and its input are one linear system, $\dot x = A x$, whose first two states are the slope of
the input and the input itself; then the state after a time t is $e^{A t} x$, for an input held
constant or moving along a line alike (C. Van Loan 1978, IEEE Trans. Automatic Control 23, 395-404).

**Chains of lags.** A is bidiagonal, and entry (i, j) of the exponential is the product of the
couplings between the two states times a divided difference of $e^{-x}$ at $x_j, \dots, x_i$, the
time over each lag. Divided differences by their definition lose all digits where lags are nearly
equal, and by a series where they are far apart; as in A. McCurdy, K. Ng, B. Parlett (1984,
"Accurate computation of divided differences of the exponential function", Math. Comp. 43, 501-528)
each entry is computed in the way that suits it. With the x ascending all is positive where it is
summed up, whatever their ratios.

**Two poles of any damping** are squared up from a short time, where a few terms of the series do,
with their response, which keeps its digits while it is small.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arrays import Lags, Scalar


WIDEST = 43
"""A time over the shortest time constant of two poles is followed up to 2^42."""


def shortest_lag(dtype) -> float:
    """Lag, over the sampling interval, below which it is a dead time to rounding.

    1/(1 + sT) and e^-sT differ by (sT)^2/2: 5e-15 in float64, 5e-9 in float32.
    """
    return 1e-4 if jnp.finfo(dtype).bits <= 32 else 1e-7


def chain_transition(
    time: Scalar, rates: Lags, present: Array, integrators: int
) -> Float[Array, "states states"]:
    r"""$e^{A t}$ of slope, input, its integrals if so wished, and a chain of lags behind them.

    $\dot x_i = r_i (x_{i-1} - x_i)$ for `rates` r = 1/T > 0, ascending. States from the first that
    is not `present` on stay 0.
    """
    x = rates * time
    free = jnp.zeros(2 + integrators, x.dtype)
    coupled = jnp.concatenate([free[:1], free[1:] + time, jnp.where(present, x, 0)])
    x = jnp.concatenate([free, x])
    ahead = _ahead(x)
    here = np.add.outer(np.arange(x.size), np.arange(x.size)) < x.size
    span = jnp.where(here, ahead - x[:, None], 0)
    near = span < 1
    by_series = _near(jnp.where(near, span, 0), coupled) * jnp.exp(-x)[:, None]

    def difference(entries, row):
        near, by_series, span, coupling = row
        following = jnp.append(coupled[1:] * entries[1:], 0)
        apart = (coupling * entries - following) / jnp.where(near, 1, span)
        entries = jnp.where(near, by_series, apart)
        return entries, entries

    rows = [table.T[1:] for table in (near, by_series, span, _ahead(coupled))]
    _, entries = jax.lax.scan(difference, by_series[:, 0], rows)
    return _columns(jnp.where(here, jnp.concatenate([by_series[:, :1], entries.T], axis=1), 0))


def _near(span: Array, coupled: Array) -> Array:
    r"""Columns of the exponential of a chain, times $e^{x_j}$, where the x differ by `span` <= 1.

    Column j by the series of $e^{(A + x_j) t}$, with the couplings above it.
    """
    # beyond where e^-x is 0 the couplings have no effect, but would overflow
    most = -1.2 * math.log(float(jnp.finfo(span.dtype).tiny))
    coupling = _ahead(jnp.minimum(coupled, most))
    first = jnp.zeros_like(span).at[:, 0].set(1)
    # 1/k! of what follows the first term of an entry is below rounding from k = 18 on (9)
    more = 9 if jnp.finfo(span.dtype).bits <= 32 else 17

    def add(total, k):
        above = jnp.pad(total[:, :-1], ((0, 0), (1, 0)))
        return first + (coupling * above - span * total) / k, None

    terms = jnp.asarray(np.arange(span.shape[0] + more, 0, -1.0), span.dtype)
    return jax.lax.scan(add, first, terms)[0]


def _ahead(row: Array) -> Array:
    """Table of row[j + d] by j and d, 0 beyond its end.

    Cut from copies of the row side by side: no indices, whose derivatives would be slow.
    """
    size = row.shape[0]
    row = jnp.concatenate([row, jnp.zeros_like(row)])
    copies = jnp.tile(row, size + 1)[: size * (2 * size + 1)]
    return copies.reshape(size, 2 * size + 1)[:, :size]


def _columns(table: Array) -> Array:
    """The matrix whose column j holds row j of a table from the diagonal on."""
    size = table.shape[0]
    return jnp.pad(table, ((0, 0), (0, 1))).reshape(-1)[: size * size].reshape(size, size).T


def _limited(rate: Array, time: Scalar) -> Array:
    """A rate so slow that the time times half a power of it can be squared up."""
    most = 2.0 ** (WIDEST - 1)
    fast = rate * time > most
    return jnp.where(fast, most / jnp.where(fast, time, 1), rate)


def second_order_transition(time: Scalar, zeta: Scalar, omega_n: Scalar) -> Float[Array, "4 4"]:
    r"""$e^{A t}$ of slope, input, output y and $w = \dot y/\omega_n$ of two poles, any damping.

    With $\tau = \omega_n t$ it consists of the responses g to a step and $\rho$ to a ramp of time
    $\tau$, and of the slope $\sigma = dg/d\tau$. They double by

    $$ g \to (2 - g) g + \sigma^2, \quad \sigma \to 2\sigma (1 - g - \zeta\sigma), \quad
       \rho \to (2 - g)\rho + (\sigma + \tau) g, $$

    where a g that is small keeps its relative accuracy.
    """
    # where even that many squarings begin too late, both poles are made slower alike: the sum of
    # two lags, all that is seen of them, stays
    excess = jnp.maximum(jnp.maximum(1, 2 * zeta) * omega_n * time * 2.0 ** (1 - WIDEST), 1)
    zeta = zeta / jnp.sqrt(excess)
    omega_n = _limited(omega_n / jnp.sqrt(excess), time)
    tau = omega_n * time * 0.5**WIDEST
    g, sway, ramp = _second_order_series(tau, zeta)

    def double(parts, _):
        g, sway, ramp, tau = parts
        ramp = (2 - g) * ramp + (sway + tau) * g
        g, sway = (2 - g) * g + sway * sway, 2 * sway * (1 - g - zeta * sway)
        return (g, sway, ramp, 2 * tau), None

    parts, _ = jax.lax.scan(double, (g, sway, ramp, tau), length=WIDEST)
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
