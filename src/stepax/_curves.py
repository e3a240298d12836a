r"""Lookup curves of Hudzovic's and Sani's chains, and their exact inverses.

Murray (2016), eqs. 2.11-2.14: Tu/Tg, 1/Tg, lam = (t90 - t10)/t50 and 1/t50 of the response at
T = 1, as functions of the order n and of r. Nothing is tabulated: every value is computed, and an
inverse is a root, found to rounding error and differentiable.

Both families become even functions of a spread at equal lags: reversing a chain of lags does not
change it. With s the ratio of the extreme rates (Sani: r of neighbours; Hudzovic: T_1/T_n =
1 - (n-1) r) the coordinate

$$ c = 4s/(1+s)^2, \qquad s = c/(1 + \sqrt{1-c})^2 $$

runs from 0 (first order) to 1 (equal lags), and every curve has a finite slope not 0 in c = 1,
where the slope in r vanishes.
"""

import functools
import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from scipy import special

from ._contour import chain_derivatives
from ._models import Hudzovic, Sani, as_real, one_minus_multiple
from ._responses import MAX_ORDER
from ._result import Status, nan_where, refused
from ._roots import increasing_root
from ._types import Count, Scalar


DEFAULT_ORDERS = range(2, MAX_ORDER + 1)
SpreadChain = Hudzovic | Sani
"""Families with lookup curves: chains of order n with one shape parameter r."""

FIRST_ORDER_LAM = math.log(9) / math.log(2)
"""(t90 - t10)/t50 of one lag."""


class Curves(NamedTuple):
    """The four curves at one (n, r): `tu_tg` Tu/Tg, `inv_tg` T/Tg, `lam`, `inv_t50` T/t50."""

    tu_tg: Array
    inv_tg: Array
    lam: Array
    inv_t50: Array


class Lookup(NamedTuple):
    """What `lookup` returns: the model (NaN parameters if refused) and its `Status`."""

    model: SpreadChain
    status: Status


# --- characteristic times of a plant at T = 1 --------------------------------------------------


LEVELS = (0.1, 0.5, 0.9)


def _response_and_slope(plant: SpreadChain, t: Array) -> tuple[Array, Array]:
    """g and t dg/dt."""
    if isinstance(plant, Hudzovic):
        return jax.jvp(plant.unit_response, (t,), (t,))
    g, slope = chain_derivatives(t, plant.lags, 1)
    return g, slope


def _level_times(plant: SpreadChain) -> Array:
    """t10, t50, t90: roots of ln(g/(1-g)), which is nearly straight in ln t."""
    total = jnp.sum(plant.lags)
    levels = np.array(LEVELS)
    target = jnp.asarray(np.log(levels / (1 - levels)), total.dtype)
    eps = jnp.finfo(total.dtype).eps

    def logit(log_t):
        g, slope = _response_and_slope(plant, jnp.exp(log_t))
        g = jnp.clip(g, eps, 1 - eps)
        return jnp.log(g / (1 - g)) - target, slope / (g * (1 - g))

    start = jnp.full_like(target, jnp.log(total))
    return jnp.exp(increasing_root(logit, start - 12, start + 4, start))


def _tangent(plant: SpreadChain) -> tuple[Array, Array]:
    """Tu/Tg and 1/Tg of the tangent at the inflection."""
    if isinstance(plant, Hudzovic):
        t, slope = _hudzovic_inflection(plant)
    else:
        t, slope = _sani_inflection(plant)
    return t * slope - plant.unit_response(t), slope


def _hudzovic_inflection(plant: Hudzovic) -> tuple[Array, Array]:
    r"""$t_i = \ln(1/s) T/r$, where $E = n - 1$; slope $\prod 1/T_k\, e^{-m t_i} E^{n-1}/(n-1)!$."""
    n = plant.n
    s = one_minus_multiple(n - 1, plant.r)
    x = 1 - s
    small = x < 0.01
    near = jnp.where(small, x, 0)
    series = jnp.ones_like(x)
    for k in range(9, 1, -1):  # -log(1 - x)/x = 1 + x/2 + x^2/3 + ..., 0.01^9 = 1e-18
        series = 1 + near * (k - 1) / k * series
    t = (n - 1) * jnp.where(small, series, -jnp.log(s) / jnp.where(small, 1, x))
    log_slope = -s * t
    for k in range(1, n if isinstance(n, int) else MAX_ORDER):
        factor = one_minus_multiple(k, plant.r) * (n - 1) / k
        log_slope = log_slope + jnp.log(jnp.where(k < n, factor, 1))
    return t * plant.T, jnp.exp(log_slope) / plant.T


def _sani_inflection(plant: SpreadChain) -> tuple[Array, Array]:
    """Largest slope: the response's density is log-concave, so h'/h falls through 0 once."""
    lower, upper = _inflection_bracket(plant)
    lags = plant.lags

    t = jnp.exp(
        increasing_root(
            lambda x: _inflection_equation(lags, x), lower, upper, 0.5 * (lower + upper)
        )
    )
    return t, chain_derivatives(t, lags, 1)[1] / t


def _inflection_equation(lags: Array, log_t: Array) -> tuple[Array, Array]:
    """-d ln h / d ln t, which rises through 0 at the inflection, and its slope."""
    _, first, second, third = chain_derivatives(jnp.exp(log_t), lags, 3)
    ratio = second / first
    return -ratio, ratio * ratio - ratio - third / first


def _inflection_bracket(plant: SpreadChain) -> tuple[Array, Array]:
    """Bounds of ln t: the mode of the first two lags (each further one delays it), the mean."""
    r = jnp.clip(plant.r, 1e-30, 1)
    apart = jnp.where(r < 0.999, r, 0.5)
    lower = jnp.where(r < 0.999, jnp.log(-apart * jnp.log(apart) / (1 - apart)), -1e-3)
    return lower - 1e-3 + jnp.log(plant.T), jnp.log(jnp.sum(plant.lags))


def _plant_curves(plant: SpreadChain) -> Curves:
    tu_tg, inv_tg = _tangent(plant)
    t10, t50, t90 = _level_times(plant)
    return Curves(tu_tg, inv_tg, (t90 - t10) / t50, 1 / t50)


def lookup_curves(model: type[SpreadChain], n: ArrayLike, r: Float[ArrayLike, "..."]) -> Curves:
    """Murray's lookup curves at T = 1 (eqs. 2.11-2.14).

    **Arguments:**

    - `model`: the class `Hudzovic` or `Sani`.
    - `n`: order, 2 to 8. `r`: shape parameter of that class. Scalars or arrays that broadcast.

    **Returns:** `Curves` with `.tu_tg`, `.inv_tg`, `.lam`, `.inv_t50`; NaN for an n or r out of
    range. Relative accuracy about 1e-12 in float64 (Sani's Tu/Tg loses digits like 1e-13/(Tu/Tg)).
    """
    _check_family(model)
    return _lookup_curves(model, jnp.asarray(n), as_real(r))


@eqx.filter_jit
def _lookup_curves(model, n: Array, r: Array) -> Curves:
    def one(n, r):
        last = r <= 1 if model is Sani else one_minus_multiple(n - 1, r) > 0
        valid = (n >= 2) & (n <= MAX_ORDER) & (r >= 0) & last
        r = jnp.where(valid, r, 0)
        n = jnp.where(valid, n, 2)
        return nan_where(~valid, _plant_curves(model(T=jnp.ones_like(r), r=r, n=n)))

    return Curves(*jnp.vectorize(one, signature="(),()->(),(),(),()")(n, r))


# --- inverses --------------------------------------------------------------------------------


def chain_with_spread(model: type[SpreadChain], log_c: Scalar, n: int | Count) -> SpreadChain:
    """Chain whose lags sum to 1 at a spread coordinate c <= 1; its times are smooth in c too."""
    return chain_of_ratio(model, jnp.exp(log_c) / (1 + jnp.sqrt(-jnp.expm1(log_c))) ** 2, n)


def chain_of_ratio(model: type[SpreadChain], s: Scalar, n: int | Count) -> SpreadChain:
    """Chain whose lags sum to 1 at a ratio 0 < s <= 1 of its slowest to its fastest rate."""
    r = s if model is Sani else (1 - s) / jnp.maximum(n - 1, 1)
    return model(T=1 / jnp.sum(model(T=jnp.ones_like(s), r=r, n=n).lags), r=r, n=n)


@functools.cache
def equal_lag_ends(orders: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Largest Tu/Tg and smallest lam of each order: those of equal lags, in closed form."""
    n = np.array(orders, float)
    t10, t50, t90 = (special.gammaincinv(n, p) for p in (0.1, 0.5, 0.9))
    slope = np.exp((n - 1) * np.log(n - 1) - (n - 1) - special.gammaln(n))
    return (n - 1) * slope - special.gammainc(n, n - 1), (t90 - t10) / t50


class _Ends(NamedTuple):
    """Range of a measured ratio over the orders: per-order equal-lag ends, first-order end."""

    equal_lags: np.ndarray
    first_order: float


def _select(value: Scalar, orders: tuple[int, ...], ends: _Ends, tolerance: float):
    """Smallest order whose range, widened by a relative tolerance, contains a ratio.

    A ratio rises or falls from the first-order end to the equal-lag end. **Returns:** order, its
    equal-lag end, and the truth of: within tolerance of that end, of the first-order end, beyond
    the first order, beyond the last order.
    """
    rising = bool(ends.equal_lags[0] > ends.first_order)
    sign = 1.0 if rising else -1.0
    ends_of = jnp.asarray(ends.equal_lags, jnp.result_type(value))
    contains = sign * (value - ends_of) <= tolerance * ends_of
    index = jnp.argmax(contains)
    end = ends_of[index]
    scale = ends.first_order or 1.0
    before = sign * (ends.first_order - value)
    return (
        jnp.asarray(orders)[index],
        end,
        jnp.abs(value - end) <= tolerance * end,
        jnp.abs(before) <= tolerance * scale,
        before > tolerance * scale,
        ~jnp.any(contains),
    )


class _Ratio(NamedTuple):
    """A ratio of characteristic times, and one Newton step towards it.

    `value(plant)` is exact and differentiable. `newton(model, n, log_c, log_t)` starts from times
    that are only approximate and returns the ratio, its slope in log c, better times, and the
    slope of the times in log c: the inversion improves c and the times together.
    """

    value: Callable[[SpreadChain], Array]
    newton: Callable[..., tuple[Array, Array, Array, Array]]


def _invert(model, ratio: _Ratio, value, n, end, first_order, interior) -> Scalar:
    """r at which the ratio of an order n chain has a value, for values inside its range.

    Newton's method for log c, with the distance to the first-order end on a logarithmic scale,
    where every curve is close to straight.
    """
    value = jnp.where(interior, value, 0.5 * (end + first_order))
    log_c = _spread_of(value, n, end, model, ratio, first_order)
    return chain_with_spread(model, log_c, n).r


@functools.partial(jax.custom_jvp, nondiff_argnums=(3, 4, 5))
def _spread_of(value, n, end, model, ratio: _Ratio, first_order: float):
    eps = jnp.finfo(value.dtype).eps
    small = jnp.sqrt(eps) / 10
    lowest, highest = -25.0, jnp.log1p(-8 * eps)

    def share(x):
        x = (x - first_order) / (end - first_order)
        return jnp.log(jnp.maximum(x, eps))

    def step(state):
        log_c, log_t, _, steps = state
        x, slope, better_t, slope_t = ratio.newton(model, n, log_c, log_t)
        slope = slope / (x - first_order)
        move = (share(value) - share(x)) / jnp.where(slope > 0, slope, 1)
        move = jnp.where(steps < SETTLING_STEPS, 0, jnp.clip(move, -1, 1))
        new = jnp.clip(log_c + move, lowest, highest)
        new_t = better_t + slope_t * (new - log_c)
        error = jnp.maximum(jnp.abs(new - log_c), jnp.max(jnp.abs(new_t - log_t)))
        return new, new_t, error, steps + 1

    def unfinished(state):
        *_, error, steps = state
        return (steps <= SETTLING_STEPS) | ((error > small) & (steps < MAX_STEPS))

    start = jnp.clip(share(value), lowest, highest)
    log_t = jnp.zeros((len(LEVELS),), start.dtype)
    state = (start, log_t, jnp.full_like(start, jnp.inf), 0)
    return jax.lax.while_loop(unfinished, step, state)[0]


@_spread_of.defjvp
def _spread_of_jvp(model, ratio, first_order, primals, tangents):
    """Implicit function theorem: d log c = d value / (d ratio / d log c)."""
    value, n, end = primals
    log_c = _spread_of(value, n, end, model, ratio, first_order)
    _, slope = jax.jvp(
        lambda x: ratio.value(chain_with_spread(model, x, n)), (log_c,), (jnp.ones_like(log_c),)
    )
    return log_c, tangents[0] / slope


SETTLING_STEPS = 4
"""Newton steps on the times alone before c moves."""
MAX_STEPS = 40


def _newton_levels(model, n, log_c, log_t):
    """lam by one Newton step on each level time."""

    def response(log_c):
        return chain_with_spread(model, log_c, n).unit_response(jnp.exp(log_t))

    _, slope_t = _response_and_slope(chain_with_spread(model, log_c, n), jnp.exp(log_t))
    g, slope_c = jax.jvp(response, (log_c,), (jnp.ones_like(log_c),))
    eps = jnp.finfo(g.dtype).eps
    g = jnp.clip(g, eps, 1 - eps)
    levels = np.array(LEVELS)
    distance = jnp.log(g / (1 - g)) - jnp.asarray(np.log(levels / (1 - levels)), g.dtype)
    slope_t = jnp.maximum(slope_t, eps)
    better = log_t - jnp.clip(distance * g * (1 - g) / slope_t, -2, 2)
    along = -slope_c / slope_t
    t, dt = jnp.exp(better), jnp.exp(better) * along
    lam = (t[2] - t[0]) / t[1]
    return lam, (dt[2] - dt[0]) / t[1] - lam * along[1], better, along


def _newton_tangent(model, n, log_c, log_t):
    """Tu/Tg: stationary in the time of the inflection, which takes one Newton step on its own."""

    def at(log_c, t):
        plant = chain_with_spread(model, log_c, n)
        g, slope = _response_and_slope(plant, t)
        return slope - g

    if model is Hudzovic:
        ratio = lambda x: _tu_tg(chain_with_spread(model, x, n))  # noqa: E731
        value, slope = jax.jvp(ratio, (log_c,), (jnp.ones_like(log_c),))
        return value, slope, log_t, jnp.zeros_like(log_t)
    plant = chain_with_spread(model, log_c, n)
    lower, upper = _inflection_bracket(plant)
    x = jnp.clip(log_t[0], lower, upper)
    value, slope = _inflection_equation(plant.lags, x)
    x = jnp.clip(x - value / jnp.where(slope > 0, slope, 1), lower, upper)
    value, slope = jax.jvp(lambda c: at(c, jnp.exp(x)), (log_c,), (jnp.ones_like(log_c),))
    return value, slope, jnp.full_like(log_t, x), jnp.zeros_like(log_t)


def _lam(plant: SpreadChain) -> Array:
    t10, t50, t90 = _level_times(plant)
    return (t90 - t10) / t50


def _tu_tg(plant: SpreadChain) -> Array:
    return _tangent(plant)[0]


def _formula_t50(plant: SpreadChain) -> Array:
    """Sani's eq. 2.17 over T, with a sum for the quotient (1 - r^n)/(1 - r)."""
    return math.log(2) - 1 + jnp.sum(plant.lags / plant.T)


def _newton_formula(model, n, log_c, log_t):
    value, slope = jax.jvp(
        lambda x: _formula_lam(chain_with_spread(model, x, n)), (log_c,), (jnp.ones_like(log_c),)
    )
    return value, slope, log_t, jnp.zeros_like(log_t)


def _formula_lam(plant: SpreadChain) -> Array:
    """Sani's eq. 2.19: eq. 2.18 over eq. 2.17."""
    lags = plant.lags / plant.T
    return 1.315 * jnp.sqrt(3.8 * jnp.sum(lags**2) - 1) / _formula_t50(plant)


_LAM = _Ratio(_lam, _newton_levels)
_TU_TG = _Ratio(_tu_tg, _newton_tangent)
_FORMULA = _Ratio(_formula_lam, _newton_formula)


def _formula_ends(orders: tuple[int, ...]) -> _Ends:
    n = np.array(orders, float)
    return _Ends(
        1.315 * np.sqrt(3.8 * n - 1) / (math.log(2) - 1 + n), 1.315 * math.sqrt(2.8) / math.log(2)
    )


def _solve(model, orders, tolerance, ratio, ends, value, time_at_unit, time, valid) -> Lookup:
    """Order and r from a ratio of times, T from one time; everything in one batchable pass."""
    n, end, at_end, at_first, beyond_first, beyond_last = _select(value, orders, ends, tolerance)
    interior = valid & ~(at_end | at_first | beyond_first | beyond_last)
    r = _invert(model, ratio, value, n, end, ends.first_order, interior)
    equal_lags = 1.0 if model is Sani else 0.0
    r = jnp.where(at_end, equal_lags, jnp.where(at_first, 0.0, r))
    T = time / time_at_unit(model(T=jnp.ones_like(r), r=r, n=n))
    first = Status.at_first_order if model is Sani else Status.beyond_first_order
    status = Status.successful
    for condition, meaning in (
        (at_end, Status.at_equal_lags),
        (at_first, first),
        (beyond_first, Status.beyond_first_order),
        (beyond_last, Status.beyond_last_order),
        (~valid, Status.invalid_times),
    ):
        status = Status.where(condition, meaning, status)
    return Lookup(nan_where(refused(status), model(T=T, r=r, n=n)), status)


def lookup(
    model: type[SpreadChain],
    *,
    Tu: ArrayLike | None = None,
    Tg: ArrayLike | None = None,
    t10: ArrayLike | None = None,
    t50: ArrayLike | None = None,
    t90: ArrayLike | None = None,
    orders: Iterable[int] = DEFAULT_ORDERS,
    formula: bool = False,
    tolerance: float = 1e-6,
) -> Lookup:
    r"""Model from times read by hand: (`Tu`, `Tg`) or (`t10`, `t50`, `t90`).

    The order is the smallest one whose curve contains the measured ratio (Murray 2016, eqs.
    2.15-2.16, with the ends set right: both families end at equal lags), r is the exact inverse of
    the curve there, and T = Tg (1/Tg)(r, n) or t50 (1/t50)(r, n). Differentiable in every time.

    **Arguments:**

    - `model`: the class `Hudzovic` or `Sani`.
    - `Tu`, `Tg`: dead-time-like and rise-like time of the tangent at the inflection.
    - `t10`, `t50`, `t90`: times from the step to 10, 50 and 90 % of the change. One unit of time.
    - `orders`: which to consider, within 2..8.
    - `formula`: with t10, t50, t90 and `Sani`, use Sani's interpolation formulae 2.17-2.19
        (errors up to 1.7 % in lam and 3.4 % in t50) instead of the exact curves.
    - `tolerance`: relative width by which each order's range is widened at its equal-lag end;
        inside it r is that end, with derivative 0 and a warning. More with noisy times.

    **Returns:** `Lookup(model, status)`: gain 1, offset 0, delay 0. At the first-order end
    (Tu/Tg = 0, lam = ln 9/ln 2) Sani gives r = 0 with a warning and Hudzovic refuses; beyond it,
    and beyond the last order's equal lags, both refuse, with NaN parameters.
    """
    _check_family(model)
    orders = check_orders(orders)
    by_tangent, by_levels = (Tu, Tg), (t10, t50, t90)
    given = [[x is not None for x in times] for times in (by_tangent, by_levels)]
    if sorted(map(tuple, given)) not in ([(False,) * 3, (True,) * 2], [(False,) * 2, (True,) * 3]):
        raise TypeError("lookup takes either Tu and Tg, or t10, t50 and t90.")
    if formula and (model is not Sani or all(given[0])):
        raise ValueError("formula=True is for Sani with t10, t50 and t90.")

    times = [as_real(x) for x in (by_tangent if all(given[0]) else by_levels)]
    if any(x.ndim for x in times):
        shapes = ", ".join(str(x.shape) for x in times)
        raise ValueError(f"lookup takes single times, got shapes {shapes}; batch with jax.vmap.")
    dtype = jnp.result_type(*times)
    times = [x.astype(dtype) for x in times]
    tolerance = max(tolerance, 32 * float(jnp.finfo(dtype).eps))
    return _lookup(model, times, orders, formula, tolerance)


@eqx.filter_jit
def _lookup(model, times: list[Array], orders: tuple[int, ...], formula: bool, tolerance: float):
    """`lookup` for checked arguments: two times are Tu and Tg, three are t10, t50, t90."""
    finite = jnp.all(jnp.isfinite(jnp.stack(times)))
    tangent_ends, level_ends = equal_lag_ends(orders)
    if len(times) == 2:
        Tu, Tg = times
        valid = finite & (Tg > 0)
        value = Tu / jnp.where(valid, Tg, 1)
        return _solve(
            model, orders, tolerance, _TU_TG, _Ends(tangent_ends, 0.0), value,
            lambda plant: 1 / _tangent(plant)[1], Tg, valid,
        )  # fmt: skip
    a, b, c = times
    valid = finite & (a > 0) & (b > a) & (c > b)
    value = (c - a) / jnp.where(valid, b, 1)
    if formula:
        return _solve(
            model, orders, tolerance, _FORMULA, _formula_ends(orders), value,
            _formula_t50, b, valid,
        )  # fmt: skip
    return _solve(
        model, orders, tolerance, _LAM, _Ends(level_ends, FIRST_ORDER_LAM), value,
        lambda plant: _level_times(plant)[1], b, valid,
    )  # fmt: skip


def check_orders(orders: Iterable[int], least: int = 2) -> tuple[int, ...]:
    """`orders` ascending, or a `ValueError` that says what they may be."""
    orders = tuple(sorted(set(orders)))
    if not orders or not all(
        isinstance(n, int | np.integer) and least <= n <= MAX_ORDER for n in orders
    ):
        raise ValueError(f"orders must be whole numbers from {least} to {MAX_ORDER}, got {orders}.")
    return orders


def _check_family(model) -> None:
    if model is not Hudzovic and model is not Sani:
        raise TypeError(f"lookup curves exist for the classes Hudzovic and Sani, got {model!r}.")
