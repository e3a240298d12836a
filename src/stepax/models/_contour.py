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
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float
from numpy.typing import NDArray

from .._arrays import Lags, Samples, Scalar, computed_once
from .._compilation import FORM


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
    return _sums(t, lags, (0,), ())[0]


def _chain_response_jvp(primals, tangents):
    """Only what has a tangent is computed."""
    t, lags = primals
    value = chain_response(t, lags)
    tangent = jnp.zeros_like(value)
    if not isinstance(tangents[0], SymbolicZero):
        (slope,) = _sums(t, lags, (1,), ())
        tangent = tangent + slope / jnp.where(t > 0, t, 1) * tangents[0]
    if not isinstance(tangents[1], SymbolicZero):
        tangent = tangent + _sums(t, lags, (), (tangents[1],))[0]
    return value, tangent


chain_response.defjvp(_chain_response_jvp, symbolic_zeros=True)


def chain_derivatives(
    t: Float[Array, "*shape"], lags: Lags, highest: int
) -> list[Float[Array, "*shape"]]:
    r"""$g, t g', t^2 g'', \dots$ up to the derivative `highest`."""
    return _sums(t, lags, tuple(range(highest + 1)), ())


def chain_slopes(t: Array, lags: Lags, changes: Sequence[Lags]) -> Slopes:
    """`chain_response` and its slopes; `changes` of the lags."""
    g, slope, *moved = _sums(t, lags, (0, 1), tuple(changes))
    return Slopes(g, slope / jnp.where(t > 0, t, 1), moved)


@functools.partial(jax.jit, static_argnums=2)
def _sums(
    t: Float[Array, "*shape"], lags: Lags, powers: tuple[int, ...], changes: tuple[Lags, ...]
) -> list[Float[Array, "*shape"]]:
    r"""$t^i g^{(i)}$ for each of `powers` i, then the change of g with each of the `changes`.

    The product over the lags is multiplied out, once for all poles: with $u_j = t/(t + \rho T_j)$,
    $v_j = \rho T_j/(t + \rho T_j)$, $x = z/\rho$ and $\rho$ in the middle of all $|z_k|$,

    $$ P(x) = \prod_j (u_j + x v_j) = \sum_m c_m x^m, \qquad
       g = c_0 \sum_k \mathrm{Re} \frac{w_k}{P(z_k/\rho)}. $$

    All $c_m$ are in [0, 1], their sum is 1 and the $|x_k|$ are near 1: no $P$ is large or small,
    whatever t and the lags. Rounding of a sum is multiplied, at a pole of angle $\theta$, by at
    most $\cos(\theta/2)^{-n}$, which is large only where the weight is small. Differentiating in
    time multiplies $w_k$ by $z_k/t$; changes $\tau_j$ of the lags change $P$ by
    $x \sum_j \rho \tau_j/(t + \rho T_j) \prod_{i \ne j} (u_i + x v_i)$ beside the denominators of
    u and v, which cancel. Compiled on its own, so that it is traced once.
    """
    rho = _middle(jnp.result_type(t, lags))
    lags, changes = rho * lags, tuple(rho * change for change in changes)
    started = t > 0
    t = jnp.where(started, t, 1)
    # read while tracing; `test_a_change_of_form_is_traced_anew`
    form = {"written": _written_out, "loop": _in_a_loop, "products": _as_products}[FORM.value]
    return [jnp.where(started, x, 0) for x in form(t, lags, powers, changes)]


Complexes = NDArray[np.complex128]

Number = tuple[Any, Any]
"""Real and imaginary part."""


def _table(dtype, powers: tuple[int, ...], n: int) -> tuple[Complexes, Complexes]:
    """Of each pair the weights of the `powers` and last of a change, and x to 0 up to n."""
    poles, weights = np.array(_pairs(dtype), np.complex128).T
    x = poles / _middle(dtype)
    columns = [*(weights * poles**i for i in powers), weights * x]
    return np.stack(columns, 1), x[:, None] ** np.arange(n + 1)


def _middle(dtype) -> float:
    """Geometric middle of the absolute values of the poles."""
    sizes = [abs(pole) for pole, _ in _pairs(dtype)]
    return (min(sizes) * max(sizes)) ** 0.5


def _at(x_powers: Sequence[Number], coefficients: Sequence[Array]) -> Number:
    """A real polynomial at a pole, from the powers of x, of which there may be more."""
    pairs = list(zip(x_powers, coefficients, strict=False))
    re = coefficients[0] + sum(z[0] * c for z, c in pairs[1:])
    return re, sum(z[1] * c for z, c in pairs[1:])


def _term(w: Number, P: Number) -> Array:
    """Re w/P."""
    return (w[0] * P[0] + w[1] * P[1]) / (P[0] * P[0] + P[1] * P[1])


def _change(w: Number, P: Number, D: Number) -> Array:
    """-Re w D/P^2; a quotient that is used once stays in the pass of what it is used for."""
    (re, im), (a, b) = P, D
    square, twice, size = re * re - im * im, 2 * re * im, re * re + im * im
    return (w[1] * (b * square - a * twice) - w[0] * (a * square + b * twice)) / (size * size)


def _written_out(
    t: Array, lags: Lags, powers: tuple[int, ...], changes: tuple[Lags, ...]
) -> list[Float[Array, "*shape"]]:
    """The sums over the poles one by one, each result a single pass over the data.

    The barriers keep XLA from sharing between them: on a CPU that breaks a pass into many.
    """
    weights, x = (
        [[(z.real, z.imag) for z in row] for row in part.tolist()]
        for part in _table(jnp.result_type(t, lags), powers, lags.shape[0])
    )
    results, seen = [], t
    for i in range(len(powers)):
        t, lags = jax.lax.optimization_barrier((t, lags))
        c, _ = _multiplied_out(t, lags)
        terms = (_term(w[i], _at(z, c)) for w, z in zip(weights, x, strict=True))
        results.append(c[0] * sum(terms))
    for change in changes:  # may be linear in what is transposed: it has a barrier of its own
        t, lags = jax.lax.optimization_barrier((t, lags))
        c, (d,) = _multiplied_out(t, lags, [jax.lax.optimization_barrier(change)])
        terms = (_change(w[-1], _at(z, c), _at(z, d)) for w, z in zip(weights, x, strict=True))
        results.append(sum(terms))
    return list(computed_once(seen, *results)[1:])


def _in_a_loop(
    t: Array, lags: Lags, powers: tuple[int, ...], changes: tuple[Lags, ...]
) -> list[Float[Array, "*shape"]]:
    """All sums in one loop over the poles: what is differentiated again compiles in half the time.

    Unoptimised it is several times slower than by products.
    """
    c, moves = _multiplied_out(t, lags, changes)
    table = _table(c[0].dtype, powers, lags.shape[0])
    parts = [jnp.asarray(part, c[0].dtype) for each in table for part in (each.real, each.imag)]

    def add(totals: list[Array], row: list[Array]) -> tuple[list[Array], None]:
        *weights, last = zip(*row[:2], strict=True)
        x = list(zip(*row[2:], strict=True))
        P = _at(x, c)
        terms = [_term(w, P) for w in weights] + [_change(last, P, _at(x, d)) for d in moves]
        return [a + b for a, b in zip(totals, terms, strict=True)], None

    zeros = [jnp.zeros_like(c[0])] * (len(powers) + len(changes))
    totals, _ = jax.lax.scan(add, zeros, parts)
    return [*(c[0] * x for x in totals[: len(powers)]), *totals[len(powers) :]]


def _as_products(
    t: Array, lags: Lags, powers: tuple[int, ...], changes: tuple[Lags, ...]
) -> list[Float[Array, "*shape"]]:
    """The same as products of matrices: least to compile, and fast without optimisation too.

    In batches it is slow.
    """
    c, moves = _multiplied_out(t, lags, changes)
    weights, x = _table(c[0].dtype, powers, lags.shape[0])
    *weights, last = weights.T

    def product(matrix: Any, rows: Array) -> Array:
        return jnp.tensordot(jnp.asarray(matrix, rows.dtype), rows, 1, precision="highest")

    def at_poles(coefficients: list[Array]) -> Number:
        rows, powers_of_x = jnp.stack(coefficients), x[:, : len(coefficients)]
        return product(powers_of_x.real, rows), product(powers_of_x.imag, rows)

    re, im = at_poles(c)
    size = re * re + im * im
    re, im = re / size, -im / size
    results = [c[0] * (product(w.real, re) - product(w.imag, im)) for w in weights]
    square, twice = re * re - im * im, 2 * re * im
    for d in moves:
        a, b = at_poles(d)
        imaginary = product(last.imag, a * twice + b * square)
        results.append(imaginary - product(last.real, a * square - b * twice))
    return results


def _multiplied_out(
    t: Array, lags: Lags, changes: Sequence[Lags] = ()
) -> tuple[list[Array], list[list[Array]]]:
    """Coefficients of P, and of each change of it over x, times c_0: they alone may be large."""
    c: list[Array] = [jnp.ones_like(t + lags[0])]
    moves: list[list[Array]] = [[] for _ in changes]
    for j in range(lags.shape[0]):
        inverse = 1 / (t + lags[j])
        u, v = t * inverse, lags[j] * inverse
        for k, change in enumerate(changes):
            own = [change[j] * inverse * x for x in c]
            if j:
                own = [a + b for a, b in zip(_times(u, v, moves[k]), own, strict=True)]
            moves[k] = own
        c = _times(u, v, c)
    return c, [[c[0] * x for x in d] for d in moves]


def _times(u: Array, v: Array, c: list[Array]) -> list[Array]:
    """Coefficients of a polynomial times u + x v."""
    return [u * c[0], *(u * a + v * b for a, b in zip(c[1:], c[:-1], strict=True)), v * c[-1]]


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
