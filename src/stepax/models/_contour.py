r"""Step response of any chain of real lags, by rational contour quadrature.

The response of $G(s) = \prod_j 1/(1 + s T_j)$ to a unit step is the inverse Laplace transform of
$G(s)/s$. With $s = z/t$, the Bromwich integral contains $e^z$; replace it by its best rational
approximation on the negative real axis (Caratheodory-Fejer) with poles $z_k$ and residues $c_k$
and the integral becomes a sum over those poles,

$$ g(t) = \sum_k \mathrm{Re} \frac{w_k}{\prod_j (1 + z_k T_j / t)}, \qquad w_k = -2 c_k / z_k, $$

over the upper half plane alone (Trefethen, Weideman, Schmelzer 2006, "Talbot quadratures and
rational approximations", BIT 46, 653-670). The weights do not depend on the plant: there is no
exponential, no partial fraction, no special case for equal lags, and a lag of 0 is a factor 1.

The error is absolute: at most 4e-13 with 10 pairs in float64, 1e-5 with 5 pairs in float32, for
up to eight lags of any ratio and any t >= 0. Far tails have no relative accuracy.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from .._arrays import Lags, Samples, Scalar
from .._compilation import LOOPED


# Caratheodory-Fejer poles and weights of type (2k - 1, 2k) for k conjugate pairs, computed at 60
# digits; `test_contour.py` computes them again. The error is least with 5 pairs in float32 and with
# 10 in float64: fewer leave a larger truncation, and with each pair more the weights double, and
# with them the rounding of their sum. Eight equal lags up to 50 of their sum, largest error:
# 4, 5, 6 pairs in float32: 8e-5, 5e-6, 1e-5; 8, 9, 10, 11 in float64: 1e-10, 2e-12, 3e-13, 6e-13.
_PAIRS_5 = (
    ((4.027732467649549 + 1.1938560664708728j), (5.047995385103296 + 8.958543016137268j)),
    ((3.2837528833704184 + 3.594386772405083j), (-4.646891926492056 - 0.28514309048687997j)),
    ((1.715406015926698 + 6.038934925576109j), (0.5961071187663748 - 0.6803524501109399j)),
    ((-0.8944047014173541 + 8.582756898773036j), (0.0032721263614679443 + 0.06317869210213933j)),
    ((-5.161191271764947 + 11.375156252224778j), (-0.0004827040113067827 - 0.0007980971679094089j)),
)
_PAIRS_10 = (
    ((7.997469941248881 + 1.1941860370529913j), (121.16094795550835 + 252.95485714353555j)),
    ((7.621785402489878 + 3.585840498715428j), (-184.6756038154949 - 44.50463012724136j)),
    ((6.860747767744476 + 5.98767745669292j), (69.68217065013974 - 51.24086351344269j)),
    ((5.693664947030471 + 8.407690968647728j), (-2.4529642032003545 + 25.919648610411222j)),
    ((4.085621432687781 + 10.856038731637748j), (-3.2705352300077886 - 3.818594939588794j)),
    ((1.9810938654711816 + 13.346833919864123j), (0.5886831255099608 + 0.06734776154995246j)),
    ((-0.7090112846253896 + 15.901615793253438j), (-0.0332443164412529 + 0.02085226342748606j)),
    ((-4.136524629201771 + 18.557207109714863j), (0.0005467883076875824 - 0.0011432186928691476j)),
    ((-8.59568856114082 + 21.387810863460803j), (-9.563675454456219e-07 + 1.5141168846312182e-05j)),
    ((-14.841258966979948 + 24.596867440862233j), (2.046110910657629e-09 - 3.385978938983753e-08j)),
)


def _pairs(dtype) -> tuple[tuple[complex, complex], ...]:
    """The pairs of pole and weight that give the smallest error in `dtype`."""
    return _PAIRS_5 if jnp.finfo(dtype).bits <= 32 else _PAIRS_10


def accuracy(dtype) -> float:
    """Largest absolute error of a unit step response from this kernel."""
    # Measured; `test_random_chains` allows twice as much. Fits do not look below it: a smaller
    # value would make them chase rounding on records without noise.
    return 5e-6 if jnp.finfo(dtype).bits <= 32 else 4e-13


class Slopes(NamedTuple):
    """A response, its slope in time, and its changes along directions of its own parameters.

    Nothing expensive is computed twice. On a CPU barriers see to that: without them XLA computes an
    exponential again in every loop that reads it.
    """

    response: Array
    in_time: Array
    changes: list[Array]


@jax.custom_jvp
def chain_response(t: Float[Array, "*shape"], lags: Lags) -> Float[Array, "*shape"]:
    r"""Unit step response of a chain of lags.

    **Arguments:**

    - `t`: times since the step, any shape; 0 or less gives 0.
    - `lags`: time constants $T_j \ge 0$, unit of `t`, any order; a lag of 0 is no lag.

    **Returns:** values of the shape of `t`.
    """
    return chain_derivatives(t, lags, 0)[0]


def _chain_response_jvp(primals, tangents):
    """The slope in time shares the denominators of the response; the lags' is differentiated.

    Only what has a tangent is computed. The barriers keep XLA from sharing subexpressions between
    value and tangents: on a CPU that breaks one pass over the data into many.
    """
    t, lags = primals
    value = chain_response(t, lags)
    tangent = jnp.zeros_like(value)
    if not isinstance(tangents[0], SymbolicZero):
        time, fixed = jax.lax.optimization_barrier((t, lags))
        slope = chain_derivatives(time, fixed, 1)[1]
        tangent = tangent + slope / jnp.where(time > 0, time, 1) * tangents[0]
    if not isinstance(tangents[1], SymbolicZero):
        time, varied = jax.lax.optimization_barrier((t, lags))
        response = lambda lags: chain_derivatives(time, lags, 0)[0]  # noqa: E731
        tangent = tangent + jax.jvp(response, (varied,), (tangents[1],))[1]
    return value, tangent


chain_response.defjvp(_chain_response_jvp, symbolic_zeros=True)


@functools.partial(jax.jit, static_argnums=2)
def chain_derivatives(
    t: Float[Array, "*shape"], lags: Lags, highest: int
) -> list[Float[Array, "*shape"]]:
    r"""$g, t g', t^2 g'', \dots$ up to the derivative `highest`, from one set of denominators.

    Differentiating with respect to time multiplies $w_k$ by $z_k/t$. Each factor $1 + z T/t$ is
    written as $(u + z v)/u$ with $u = t/(t+T)$, $v = T/(t+T)$, both in [0, 1], so that nothing
    overflows for small t or any ratio of lags. Compiled on its own, so that it is traced once.
    """
    started = t > 0
    t = jnp.where(started, t, jnp.ones_like(t))
    inverses = [1 / (t + lags[j]) for j in range(lags.shape[0])]
    shares = [(t * x, lags[j] * x) for j, x in enumerate(inverses)]
    totals = [jnp.zeros_like(shares[0][0])] * (highest + 1)

    def add(totals, pair):
        (pole_re, pole_im), *weights = pair
        re, im = jnp.ones_like(totals[0]), jnp.zeros_like(totals[0])
        for u, v in shares:
            a, b = u + pole_re * v, pole_im * v
            re, im = re * a - im * b, re * b + im * a
        size = re * re + im * im
        return [x + (c * re + d * im) / size for x, (c, d) in zip(totals, weights, strict=True)]

    pairs = [
        [pole, *(weight * pole**m for m in range(highest + 1))]
        for pole, weight in _pairs(totals[0].dtype)
    ]
    if LOOPED.value:  # read while tracing; `test_a_change_of_form_is_traced_anew`
        rows = np.array([[(z.real, z.imag) for z in pair] for pair in pairs])
        rows = jnp.asarray(rows, totals[0].dtype)
        totals, _ = jax.lax.scan(lambda x, row: (add(x, row), None), totals, rows)
    else:
        for pair in pairs:
            totals = add(totals, [(z.real, z.imag) for z in pair])
    product = shares[0][0]
    for u, _ in shares[1:]:
        product = product * u
    return [jnp.where(started, total * product, 0) for total in totals]


def chain_slopes(t: Array, lags: Lags, changes: Sequence[Lags]) -> Slopes:
    """`chain_response` and its slopes; `changes` of the lags."""
    g, slope = chain_derivatives(t, lags, 1)
    slope = slope / jnp.where(t > 0, t, 1)
    response = lambda lags: chain_derivatives(t, lags, 0)[0]  # noqa: E731
    moved = []
    for change in changes:
        lags = jax.lax.optimization_barrier(lags)
        moved.append(jax.jvp(response, (lags,), (change,))[1])
    return Slopes(g, slope, moved)


def chain_curvature(t: Samples, lags: Lags, weights: Samples) -> Float[Array, "lags lags"]:
    r"""$\sum_i \omega_i\, \partial^2 g(t_i)/\partial T_j \partial T_k$ for weights $\omega_i$.

    Each derivative in a lag is a factor $-q_j$, $q_j = z/(t + z T_j)$, under the sum over the
    poles, a second one in the same lag twice that.
    """
    started = t > 0
    t = jnp.where(started, t, jnp.ones_like(t))
    pairs = np.array(_pairs(t.dtype))
    poles, weight = jnp.asarray(pairs.T, jnp.result_type(t, 1j))[:, :, None]
    t, weights = t[None, :], jnp.where(started, weights, 0)[None, :]
    shares = t[None] + poles[None] * lags[:, None, None]
    terms = weight * jnp.prod(t[None] / shares, axis=0) * weights
    factors = poles[None] / shares
    twice = 1 + jnp.eye(lags.size, dtype=t.dtype)
    return twice * jnp.real(jnp.einsum("pn,jpn,kpn->jk", terms, factors, factors))


@jax.jit
def lag_power_response(
    t: Float[Array, "*shape"], T: Scalar, power: Scalar
) -> Float[Array, "*shape"]:
    r"""Unit step response of $1/(1 + sT)^a$ for a real power 0 < a <= 2, smooth in a."""
    started = t > 0
    t = jnp.where(started, t, jnp.ones_like(t))
    inverse = 1 / (t + T)
    u, v = t * inverse, T * inverse
    log_u = jnp.log(jnp.maximum(u, jnp.finfo(u.dtype).tiny))
    total = jnp.zeros_like(u * power)
    for pole, weight in _pairs(total.dtype):
        a, b = u + pole.real * v, pole.imag * v
        size = jnp.exp(power * (log_u - jnp.log(a * a + b * b) / 2))
        angle = -power * jnp.arctan2(b, a)
        total = total + size * (weight.real * jnp.cos(angle) - weight.imag * jnp.sin(angle))
    return jnp.where(started, total, 0)
