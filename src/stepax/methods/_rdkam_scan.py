r"""The dead-time scan of the area methods of Maxim and De Keyser, at a cost that follows N.

For every dead time d the method gives a model, and the one with the least squared error over the
whole record is kept. All areas are differences of one running sum. The error is taken over `BLOCKS`
means of the record (the rest, what the samples lack to their mean, is the same for every d), and d
is sought as a number: `CANDIDATES` at once over all that is admissible, then as many around the
best, and last the vertex of a parabola, through which derivatives flow.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arrays import Flag, Scalar
from ..models._plants import FOPDT, SOPDT
from ..records._areas import MOST_LOBES, RunningArea


CANDIDATES = 17
"""Dead times in one batch."""

BLOCKS = 96
"""Means of the record that the error is taken over: of a rise three quarters of them up to where it
has settled, of an oscillation eight a period."""

PASSES = 3
"""Rounds in which the final level and what the record lacks follow from the model before."""

ALPHAS = np.linspace(0.4, 3.0, 14)
"""Where the area between the response and that of one lag is compared, over their sum of lags.

Any time will do (A.1, note); the largest area is flat, between 1.01 (zeta = 3) and 2.05 (0.5).
"""

LEAST_DAMPING, BRANCH, MOST_DAMPING = 0.01, 0.5, 3.0
"""Range of the damping: oscillatory below `BRANCH`; above the last it is practically one lag."""

NEWTON = 4
"""Steps for a damping, which nearly lies on a straight line; one more carries the derivative."""


class Blocks(NamedTuple):
    """Means of a record between edges."""

    edges: Float[Array, " edges"]
    mean: Float[Array, " blocks"]


class Shape(NamedTuple):
    """Model of gain 1 at one dead time, which it does not hold.

    `usable`: whether the areas are positive. `beyond`: whether the damping lies outside its range
    and ended there.
    """

    plant: FOPDT | SOPDT
    usable: Flag
    beyond: Flag


class Scanned(NamedTuple):
    """The best model of a scan, its dead time and the final level."""

    shape: Shape
    delay: Scalar
    level: Scalar


def edges_of_rise(area: RunningArea, level: Scalar, onset: Scalar) -> Float[Array, " edges"]:
    """Three quarters of the blocks up to five mean residence times after the onset."""
    lag = jnp.maximum(area.above(level, 0 * onset, area.end) / level - onset, 0.02 * area.end)
    cut = jnp.minimum(onset + 5 * lag, 0.75 * area.end)
    dense = 3 * BLOCKS // 4
    early = cut * np.linspace(0, 1, dense, endpoint=False, dtype=cut.dtype)
    late = cut + (area.end - cut) * np.linspace(0, 1, BLOCKS - dense + 1, dtype=cut.dtype)
    return jnp.concatenate([early, late])


def edges_of_periods(area: RunningArea, start: Scalar, period: Scalar) -> Float[Array, " edges"]:
    """The first periods from `start` on."""
    end = jnp.minimum(start + BLOCKS / 8 * period, area.end)
    return start + (end - start) * np.linspace(0, 1, BLOCKS + 1, dtype=end.dtype)


def blocks(area: RunningArea, edges: Float[Array, " edges"]) -> Blocks:
    """Means of the response between edges."""
    edges = jax.lax.stop_gradient(edges)
    width = jnp.diff(edges)
    return Blocks(edges, jnp.diff(area(edges)) / jnp.where(width > 0, width, 1))


def scan(
    area: RunningArea,
    parts: Blocks,
    shape: Callable[[Scalar, Scalar, Scalar], Shape],
    rest: Callable[[Any, Array], Array],
    level: Scalar,
    known: bool,
    tail: tuple[Scalar, Scalar],
    low: Scalar,
    high: Scalar,
) -> Scanned:
    """The best of all dead times from `low` to `high`.

    `shape(d, level, lacking)` is the model for a dead time, where the record, over the level, lacks
    the area `lacking` behind its end; `rest` gives that of a model. The level, unless `known`, is
    that of the mean over the `tail`, from and to, of which the model says what it lacks.
    """

    def again(state, place):
        level, lacking, near = state

        def error(d):
            found = shape(d, level, lacking)
            since = parts.edges - d
            behind = rest(found.plant, jnp.maximum(since, 0)) - jnp.minimum(since, 0)
            width = jnp.diff(parts.edges)
            g = 1 + jnp.diff(behind) / jnp.where(width > 0, width, 1)
            square = jnp.sum(width * (parts.mean - level * g) ** 2)
            return jnp.where(found.usable & jnp.isfinite(square), square, jnp.inf)

        d, square = least(error, low, high, near, place > 0)
        found = shape(d, level, lacking)
        found = found._replace(usable=jnp.isfinite(square) & found.usable)
        start, end = jnp.maximum(tail[0], d), tail[1]
        before, after, behind = rest(found.plant, jnp.stack([start, end, area.end]) - d)
        mean = 1 - (before - after) / (end - start)
        better = area.mean(start, end) / jnp.where(mean > 0.1, mean, 1)
        good = found.usable & (mean > 0.1) & jnp.isfinite(better + behind)
        following = jnp.where(good & (not known), better, level)
        return (following, jnp.where(good, behind, lacking), d), Scanned(found, d, level)

    start = level, jnp.zeros_like(level), 0.5 * (low + high)
    _, passes = jax.lax.scan(again, start, np.arange(PASSES))
    return jax.tree.map(lambda x: x[-1], passes)


def least(
    error: Callable[[Scalar], Scalar], low: Scalar, high: Scalar, near: Scalar, known: Flag
) -> tuple[Scalar, Scalar]:
    """Where an error is least between two ends, and how large it is there.

    If it is `known` to lie `near` a place, only a 64th of the range on either side is searched.
    Differentiable: which candidate is best is taken as given, the vertex of the parabola through it
    and its neighbours moves with the error. At an end it stays.
    """
    rounds = 4 if jnp.finfo(low.dtype).bits > 32 else 3
    steps, half = jnp.asarray(np.linspace(-1, 1, CANDIDATES), low.dtype), CANDIDATES // 2

    def nearer(_, state):
        best, reach = state
        candidates = jnp.clip(best + reach * steps, low, high)
        return candidates[jnp.argmin(jax.vmap(error)(candidates))], reach / half

    reach = 0.5 * (high - low) / jnp.where(known, half**2, 1)
    start = jax.lax.stop_gradient((near, reach))
    best, reach = jax.lax.fori_loop(jnp.where(known, 2, 0), rounds, nearer, start)
    best, reach = jax.lax.stop_gradient((best, reach))

    def vertex(middle, reach):
        middle = jax.lax.stop_gradient(jnp.clip(middle, low + reach, high - reach))
        places = jnp.stack([middle - reach, middle, middle + reach])
        before, here, after = jax.lax.map(error, places)
        bend = before - 2 * here + after
        valley = jnp.isfinite(bend) & (bend > 0)
        move = 0.5 * jnp.where(valley, before - after, 0) / jnp.where(valley, bend, 1)
        found = jnp.clip(middle + reach * jnp.clip(move, -2, 2), low, high)
        return jnp.where(valley, found, jax.lax.stop_gradient(best)), here

    # twice, the second time where the parabola is the error itself
    best, errors = jax.lax.scan(vertex, best, jnp.stack([reach, reach / half]))
    return best, errors[-1]


# Shapes from areas


def first_order_shape(area: RunningArea, d: Scalar, level: Scalar, lacking: Scalar) -> Shape:
    r"""One lag: $T = A/K$, $A = \int_d (K - y)\,dt$ (eq. 5)."""
    T = area.above(level, d, area.end) / level + lacking
    usable = T > 0
    return Shape(FOPDT(T=jnp.where(usable, T, 1)), usable, jnp.zeros((), bool))


def first_order_rest(plant: FOPDT, x: Array) -> Array:
    r"""$\int_x^\infty (1 - g)\,dt$ of one lag."""
    return plant.T * jnp.exp(-x / plant.T)


def second_order_rest(plant: SOPDT, x: Array) -> Array:
    r"""$\int_x^\infty (1 - g)\,dt = \tau R(x/\tau)$, with $\tau = 2\zeta/\omega_n$."""
    total = 2 * plant.zeta / plant.omega_n
    return total * remaining_area(x / total, 0.25 / plant.zeta**2)


def remaining_area(alpha: Array, product: Array) -> Array:
    r"""R: area that a second-order response lacks from $\alpha\tau$ on, over its sum of lags.

    By the product of the lags $p = T_1 T_2/\tau^2 = 1/(4\zeta^2)$: with $s = \alpha/(2p)$ and
    $q = s^2 (1 - 4p)$

    $$ R = e^{-s} \left[\cosh\sqrt q + (s - \alpha) \sinh\sqrt q/\sqrt q\right], $$

    entire in q: real for any damping, no 0/0 at zeta = 1, and never too large a number.
    """
    s = 0.5 * alpha / product
    q = s * s * (1 - 4 * product)
    near = jnp.abs(q) < 0.01
    small, root = jnp.where(near, q, 0), jnp.sqrt(jnp.where(near, 1, jnp.abs(q)))
    cosine, sine = jnp.ones_like(q), jnp.ones_like(q)
    for k in range(4, 0, -1):  # 0.01^5/10! < 3e-17
        cosine = 1 + small / ((2 * k - 1) * (2 * k)) * cosine
        sine = 1 + small / ((2 * k) * (2 * k + 1)) * sine
    real, fall = q > 0, jnp.exp(-s)
    slow, fast = (jnp.exp(sign * jnp.where(real, root, 0) - s) for sign in (1, -1))
    away = jnp.where(real, 0.5 * (slow + fast), fall * jnp.cos(root))
    cosine = jnp.where(near, fall * cosine, away)
    away = jnp.where(real, 0.5 * (slow - fast), fall * jnp.sin(root)) / root
    return cosine + (s - alpha) * jnp.where(near, fall * sine, away)


def area_ratio(alpha: Array, product: Array) -> Array:
    r"""S/A of eq. 11 and 12 for any damping: $e^{-\alpha} - R(\alpha)$.

    S is the area up to $\alpha\tau$ between one lag $\tau$ and second order of the same sum of
    lags, A that above the response.
    """
    return jnp.exp(-alpha) - remaining_area(alpha, product)


def second_order_shape(
    area: RunningArea, d: Scalar, level: Scalar, lacking: Scalar, least_damping: float
) -> Shape:
    r"""Damping from two areas (eq. 11, 12), $\omega_n = 2\zeta/\tau$ (eq. 14)."""
    total = area.above(level, d, area.end) / level + lacking
    positive = total > 0
    total = jnp.where(positive, total, 1)
    alphas = jnp.asarray(ALPHAS, total.dtype)
    until = d + alphas * total
    between = area.above(level, d, jnp.minimum(until, area.end)) / level
    between = between / total - (1 - jnp.exp(-alphas))
    size = jax.lax.stop_gradient(jnp.where(until <= area.end, jnp.abs(between), -1))
    largest = jnp.argmax(size)
    alpha, ratio = alphas[largest], between[largest]
    lowest, highest = 0.25 / MOST_DAMPING**2, 0.25 / least_damping**2

    def value(product):
        return area_ratio(alpha, product) - ratio

    product, beyond = newton(value, jnp.full_like(total, 0.2), lowest, highest)
    zeta = 0.5 / jnp.sqrt(product)
    plant = SOPDT(zeta=zeta, omega_n=2 * zeta / total)
    return Shape(plant, positive & (size[largest] >= 0), beyond)


def newton(
    value: Callable[[Scalar], Scalar], start: Scalar, lowest: float, highest: float
) -> tuple[Scalar, Flag]:
    """Root of a nearly straight rising function within a range; whether it lies beyond.

    The last step carries the derivative, by the implicit function theorem.
    """

    def step(_, x):
        x = jax.lax.stop_gradient(jnp.clip(x, lowest, highest))
        y, slope = jax.jvp(value, (x,), (jnp.ones_like(x),))
        return x - y / jax.lax.stop_gradient(jnp.where(slope > 0, slope, 1))

    x = step(0, jax.lax.stop_gradient(jax.lax.fori_loop(0, NEWTON, step, start)))
    small = 1e-3 * lowest
    return jnp.clip(x, lowest, highest), (x < lowest - small) | (x > highest + small)


def lobe_area(zeta: Array, lobes: Array) -> Array:
    r"""Area of the rise and of the lobes after it, each taken as positive, over K and the period.

    Eq. 18 for a record that ends where the n-th lobe does (the rise is the first): with
    $\beta = \zeta/\sqrt{1-\zeta^2}$ and $\rho = e^{-\pi\beta}$,

    $$ \frac{\sqrt{1-\zeta^2}}{\pi} \left[\zeta + e^{-\beta(\pi/2 + \arcsin\zeta)}
       \frac{1 - \tfrac12(\rho^{n-1} + \rho^n)}{1 - \rho}\right]. $$
    """
    root = jnp.sqrt((1 - zeta) * (1 + zeta))
    fall = np.pi * zeta / root
    first = jnp.exp(-zeta / root * (np.pi / 2 + jnp.arcsin(zeta)))
    sums = 0.5 * (jnp.expm1(-(lobes - 1) * fall) + jnp.expm1(-lobes * fall)) / jnp.expm1(-fall)
    return root / np.pi * (zeta + first * sums)


def oscillatory_shape(
    area: RunningArea, d: Scalar, level: Scalar, lacking: Scalar, period: Scalar, lobes: Scalar
) -> Shape:
    r"""Damping from the areas of the lobes, $\omega_n$ from the period (eq. 20 to 22).

    The paper integrates $|K - y|$, which rectifies noise: zeta comes out 8 % low at 5 % noise, 19 %
    at 10 %. Here each lobe has the sign that the model gives it, between the times $T_k$ at which
    the model passes K (A25). Noise of either sign then cancels as in any other integral. Where K is
    passed the integral is flat, so that $T_1$ hardly matters: it is that of the damping found
    before. The record is used up to T_n, so that what it lacks does not matter.
    """
    places = np.arange(MOST_LOBES)
    signs = jnp.asarray((-1.0) ** places, period.dtype)

    def again(zeta, _):
        first = (0.25 + jnp.arcsin(zeta) / (2 * np.pi)) * period
        edges = d + first + 0.5 * period * jnp.minimum(places, lobes - 1)
        edges = jnp.minimum(jnp.append(d, edges), area.end)
        lobe = level * jnp.diff(edges) - jnp.diff(area(edges))
        measured = jnp.sum(signs * lobe) / (level * period)
        positive = measured > 0
        inverse = 1 / jnp.where(positive, measured, 1)
        value = lambda zeta: 1 / lobe_area(zeta, lobes) - inverse  # noqa: E731
        zeta, beyond = newton(value, zeta, LEAST_DAMPING, BRANCH)
        return zeta, (beyond, positive)

    zeta, (beyond, positive) = jax.lax.scan(again, jnp.full_like(period, 0.2), length=2)
    omega_n = 2 * np.pi / (period * jnp.sqrt((1 - zeta) * (1 + zeta)))
    return Shape(SOPDT(zeta=zeta, omega_n=omega_n), positive[-1], beyond[-1])
