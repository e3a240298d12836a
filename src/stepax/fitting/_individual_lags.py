"""Individual lags in a fit: where two of them meet, along the valley of the loss, and in order.

The response is a symmetric function of its lags. Where two meet, the slope in their difference
vanishes, and nearly equal losses lie along bent valleys: a plain Gauss-Newton step serves neither.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ._problem import Problem, least_loss


MERGED = (1e-4, 1e-3, 1e-2, 0.1)
"""Relative distances of neighbouring lags at which it is tried whether they are equal.

The response moves with the square of such a distance: how near to each other a fit brings equal
lags depends on the noise, so that several are tried."""

ITERATIONS = 12
"""Of the simultaneous iteration for all roots.

Near separate roots it squares the error each time, near double ones it halves it: 12 halvings and
what the test of `settled` then refuses is a plain step.
"""


def symmetric_step(lags: Array, step: Array) -> Array:
    r"""Lags after a step that moves their elementary symmetric functions along a straight line.

    The response depends on those alone, which a record tells far apart in certainty: in terms of
    lags the valley of nearly equal losses is bent. The new lags are the roots of $\prod_k (z - T_k)
    - \sum_j s_j \prod_{i \ne j} (z - T_i)$, by Weierstrass' simultaneous iteration from T + s,
    the step itself; where they are not all real and positive it is that step.
    """
    active = (lags > 0) | (step != 0)
    others = active[None, :] & ~np.eye(lags.size, dtype=bool)

    def improve(_, state):
        z, _ = state
        factors = jnp.where(active[None, :], z[:, None] - lags[None, :], 1)
        rest = [
            jnp.delete(factors, j, axis=1, assume_unique_indices=True) for j in range(lags.size)
        ]
        parts = sum(step[j] * jnp.prod(rest[j], axis=1) for j in range(lags.size))
        gaps = jnp.prod(jnp.where(others, z[:, None] - z[None, :], 1), axis=1)
        value = (jnp.prod(factors, axis=1) - parts) / jnp.where(gaps == 0, jnp.nan, gaps)
        move = jnp.where(active, value, 0)
        return z - move, move

    start = lags + step
    z, move = jax.lax.fori_loop(0, ITERATIONS, improve, (start, start))
    settled = jnp.max(jnp.abs(move)) <= jnp.finfo(z.dtype).eps ** 0.5 * jnp.max(jnp.abs(z))
    real = settled & jnp.all(jnp.where(active, z > 0, True))
    return jnp.where(real, z, start)


def curvature(problem: Problem, x: Array) -> Array:
    r"""$\sum_i r_i \nabla^2 r_i$ of individual lags, the levels and the dead time held.

    Where two lags meet, the slope in their difference vanishes and this tells the way.
    """
    plant: Any = problem.shape(x)
    g = problem.record.response(plant)
    slope = jax.grad(lambda g: jnp.sum(problem.residual(x, g) ** 2) / 2)(g)
    family: Any = problem.family
    unit = family.sum_at_start.astype(g.dtype)
    block = problem.record.curvature(plant, slope) * unit**2
    size = plant.lags.size
    return jnp.zeros((x.size, x.size), block.dtype).at[:size, :size].set(block)


def retract(problem: Problem, x: Array, step: Array) -> Array:
    """The end of a step of individual lags that keeps to the valley of nearly equal losses."""
    size = problem.own_free.size
    return (x + step).at[:size].set(symmetric_step(x[:size], step[:size]))


def in_order(problem: Problem, x: Array) -> Array:
    """Coordinates with individual lags largest first, and equal where the loss does not mind.

    Of the lags that lie within a tolerance of their neighbours all take their mean; of several
    tolerances the largest is kept at which the loss does not rise.
    """
    if not problem.individual:
        return x
    size = problem.own_free.size
    x = x.at[:size].set(-jnp.sort(-x[:size]))

    limit = problem.loss(x) * (1 + jnp.finfo(x.dtype).eps ** 0.5) + least_loss(
        x.dtype, problem.record
    )

    def merge(best, tolerance):
        lags = x[:size]
        starts = jnp.append(True, lags[1:] < (1 - tolerance) * lags[:-1])
        group = jnp.cumsum(starts) - 1
        sums = jnp.zeros_like(lags).at[group].add(lags)
        means = sums / jnp.maximum(jnp.zeros_like(lags).at[group].add(1), 1)
        merged = x.at[:size].set(means[group])
        return jnp.where(problem.loss(merged) <= limit, merged, best), None

    return jax.lax.scan(merge, x, jnp.asarray(MERGED, x.dtype))[0]


def means_of_equal(problem: Problem, x: Array) -> Array:
    """Matrix that gives each coordinate the mean of those equal to it: lags alone can be."""
    if not problem.individual:
        return jnp.eye(x.size, dtype=x.dtype)
    size = problem.own_free.size
    equal = (x[:size, None] == x[None, :size]) & ~problem.absent[:, None] & ~problem.absent[None, :]
    equal = equal | np.eye(size, dtype=bool)
    mean = equal / jnp.sum(equal, axis=1, keepdims=True)
    return jnp.eye(x.size, dtype=x.dtype).at[:size, :size].set(mean.astype(x.dtype))
