r"""The dead-time scan of the area methods of Maxim and De Keyser, at a cost that follows N.

For every dead time d the method gives a model, and the one with the least squared error over the
whole record is kept. All areas are differences of one running sum. The error is taken over `BLOCKS`
means of the record (the rest, what the samples lack to their mean, is the same for every d), and d
is sought as a number: `CANDIDATES` at once over all that is admissible, then as many around the
best, and last the vertex of a parabola, through which derivatives flow.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arrays import Flag, Scalar
from ..models._plants import FOPDT, SOPDT
from ..models._responses import second_order_zero_response
from ..records._areas import MOST_LOBES, RunningArea


CANDIDATES = 25
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

NEWTON = 7
"""Steps for a damping, from a straight line that it nearly lies on."""


class Blocks(NamedTuple):
    """Means of a record over adjoining intervals."""

    middle: Float[Array, " blocks"]
    width: Float[Array, " blocks"]
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
    early = cut * np.linspace(0, 1, dense, endpoint=False)
    late = cut + (area.end - cut) * np.linspace(0, 1, BLOCKS - dense + 1)
    return jnp.concatenate([early, late])


def edges_of_periods(area: RunningArea, start: Scalar, period: Scalar) -> Float[Array, " edges"]:
    """The first periods from `start` on."""
    end = jnp.minimum(start + BLOCKS / 8 * period, area.end)
    return start + (end - start) * np.linspace(0, 1, BLOCKS + 1)


def blocks(area: RunningArea, edges: Float[Array, " edges"]) -> Blocks:
    """Means of the response between edges."""
    edges = jax.lax.stop_gradient(edges)
    width = jnp.diff(edges)
    wide = width > 0
    mean = jnp.diff(area(edges)) / jnp.where(wide, width, 1)
    return Blocks(0.5 * (edges[1:] + edges[:-1]), width, jnp.where(wide, mean, 0))


def scan(
    area: RunningArea,
    parts: Blocks,
    shape: Callable[[Scalar, Scalar, Scalar], Shape],
    rest: Callable[[FOPDT | SOPDT, Array], Array],
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

    def again(state, _):
        level, lacking = state

        def error(d):
            found = shape(d, level, lacking)
            g = found.plant.unit_response(parts.middle - d)
            square = jnp.sum(parts.width * (parts.mean - level * g) ** 2)
            return jnp.where(found.usable & jnp.isfinite(square), square, jnp.inf)

        d, square = least(error, low, high)
        found = shape(d, level, lacking)
        found = found._replace(usable=jnp.isfinite(square) & found.usable)
        start, end = jnp.maximum(tail[0], d), tail[1]
        before, after, behind = rest(found.plant, jnp.stack([start, end, area.end]) - d)
        mean = 1 - (before - after) / (end - start)
        better = area.mean(start, end) / jnp.where(mean > 0.1, mean, 1)
        good = found.usable & (mean > 0.1) & jnp.isfinite(better + behind)
        state = jnp.where(good & (not known), better, level), jnp.where(good, behind, lacking)
        return state, Scanned(found, d, level)

    _, passes = jax.lax.scan(again, (level, jnp.zeros_like(level)), length=PASSES)
    return jax.tree.map(lambda x: x[-1], passes)


def least(error: Callable[[Scalar], Scalar], low: Scalar, high: Scalar) -> tuple[Scalar, Scalar]:
    """Where an error is least between two ends, and how large it is there.

    Differentiable: which candidate is best is taken as given, the vertex of the parabola through it
    and its neighbours moves with the error. At an end it stays.
    """
    rounds = 4 if jnp.finfo(low.dtype).bits > 32 else 3
    steps, half = np.linspace(-1, 1, CANDIDATES), CANDIDATES // 2

    def nearer(state, _):
        best, reach = jax.lax.stop_gradient(state)
        best = jnp.clip(best, low + reach, high - reach)
        errors = jax.vmap(error)(best + reach * steps)
        place = jnp.clip(jnp.argmin(errors), 1, CANDIDATES - 2)
        before, here, after = errors[place - 1], errors[place], errors[place + 1]
        bend = before - 2 * here + after
        valley = jnp.isfinite(bend) & (bend > 0)
        move = 0.5 * jnp.where(valley, before - after, 0) / jnp.where(valley, bend, 1)
        vertex = best + reach * (steps[place] + jnp.clip(move, -1, 1) / half)
        first = jax.lax.stop_gradient(best + reach * steps[jnp.argmin(errors)])
        return (first, reach / half), (jnp.where(valley, vertex, first), jnp.min(errors))

    steps = jnp.asarray(steps, low.dtype)
    start = 0.5 * (low + high), 0.5 * (high - low)
    _, (vertices, errors) = jax.lax.scan(nearer, start, length=rounds)
    return jnp.clip(vertices[-1], low, high), errors[-1]


# Shapes from areas


def first_order_shape(area: RunningArea, d: Scalar, level: Scalar, lacking: Scalar) -> Shape:
    r"""One lag: $T = A/K$, $A = \int_d (K - y)\,dt$ (eq. 5)."""
    T = area.above(level, d, area.end) / level + lacking
    usable = T > 0
    return Shape(FOPDT(T=jnp.where(usable, T, 1)), usable, jnp.zeros((), bool))


def first_order_rest(plant: FOPDT | SOPDT, x: Array) -> Array:
    r"""$\int_x^\infty (1 - g)\,dt$ of one lag."""
    assert isinstance(plant, FOPDT)
    return plant.T * jnp.exp(-x / plant.T)


def second_order_rest(plant: FOPDT | SOPDT, x: Array) -> Array:
    r"""$\int_x^\infty (1 - g)\,dt = \tau (1 - g_z(x))$, with $\tau = 2\zeta/\omega_n$.

    $g_z$ is the response with a zero of lead $1/(2\zeta\omega_n)$ more: 1 - g is a combination of
    the slope of g and of the slope's slope.
    """
    assert isinstance(plant, SOPDT)
    zeta, omega_n = plant.zeta, plant.omega_n
    lead = 0.5 / (zeta * omega_n)
    return 2 * zeta / omega_n * (1 - second_order_zero_response(x, zeta, omega_n, lead))


def area_ratio(alpha: Array, product: Array) -> Array:
    r"""S/A of eq. 11 and 12 for any damping, by the product of the lags over their sum squared.

    S is the area up to $\alpha\tau$ between one lag $\tau$ and second order of the same sum of
    lags, A that above the response. With $p = T_1 T_2/\tau^2 = 1/(4\zeta^2)$ and
    $q = \alpha^2 (1 - 4p)/(4 p^2)$

    $$ S/A = e^{-\alpha} - e^{-\alpha/(2p)} \left[\cosh\sqrt q + \alpha \left(\frac{1}{2p} - 1\right)
       \frac{\sinh\sqrt q}{\sqrt q}\right], $$

    entire in q: real for any damping, and no 0/0 at zeta = 1. **Range:** alpha below 3 and
    p above 1/36, else the cosine overflows in float32.
    """
    q = alpha**2 * (1 - 4 * product) / (4 * product**2)
    near = jnp.abs(q) < 1e-4
    root = jnp.sqrt(jnp.where(near, 1, q) + 0j)
    cosine = jnp.where(near, 1 + q / 2 * (1 + q / 12), jnp.cosh(root).real)
    sine = jnp.where(near, 1 + q / 6 * (1 + q / 20), (jnp.sinh(root) / root).real)
    bracket = cosine + alpha * (0.5 / product - 1) * sine
    return jnp.exp(-alpha) - jnp.exp(-0.5 * alpha / product) * bracket


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
    """Root of a nearly straight rising function within a range; whether it lies beyond."""

    def step(x, _):
        x = jnp.clip(jax.lax.stop_gradient(x), lowest, highest)
        y, slope = jax.jvp(value, (x,), (jnp.ones_like(x),))
        slope = jax.lax.stop_gradient(slope)
        return x - y / jnp.where(slope > 0, slope, 1), None

    x, _ = jax.lax.scan(step, start, length=NEWTON)
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

    zeta, (beyond, positive) = jax.lax.scan(again, jnp.full_like(period, 0.2), length=3)
    omega_n = 2 * np.pi / (period * jnp.sqrt((1 - zeta) * (1 + zeta)))
    return Shape(SOPDT(zeta=zeta, omega_n=omega_n), positive[-1], beyond[-1])
