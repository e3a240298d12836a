"""Roots of monotone functions, differentiable by the implicit function theorem."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._arrays import Scalar


MAX_STEPS = 100


def increasing_root(
    value_and_slope: Callable[[Array], tuple[Array, Array]],
    lower: Array,
    upper: Array,
    start: Array,
) -> Array:
    """Where an increasing function, applied to each element on its own, is 0.

    For unknowns of order one (logarithms). Newton's method inside a shrinking bracket: a step that
    leaves it, or is more than half the one before, becomes a bisection. It ends after a Newton
    step below sqrt(eps)/10, whose error is of the order of its square. A function without a sign
    change ends at a bracket end. Forward and reverse derivatives, of any order, come from the
    implicit function theorem.
    """
    return _root(eqx.filter_closure_convert(value_and_slope, start), lower, upper, start)


@eqx.filter_custom_jvp
def _root(function: Callable[[Array], tuple[Array, Array]], lower, upper, start) -> Array:
    """`increasing_root` of a function that carries all that it depends on.

    JAX's own custom root traces the derivatives also where nobody asks for them: of
    roots within roots that was half of the time that a comparison is traced.
    """
    small = jnp.sqrt(jnp.finfo(start.dtype).eps) / 10

    def unfinished(state):
        *_, finished, steps = state
        return jnp.any(~finished) & (steps < MAX_STEPS)

    def step(state):
        lower, upper, x, previous, finished, steps = state
        value, slope = function(x)
        lower = jnp.where(value <= 0, x, lower)
        upper = jnp.where(value >= 0, x, upper)
        newton = x - value / jnp.where(slope > 0, slope, 1)
        small_step = (slope > 0) & (jnp.abs(newton - x) < small)
        good = (slope > 0) & (newton >= lower) & (newton <= upper)
        good = small_step | (good & (jnp.abs(newton - x) <= 0.5 * previous))
        new = jnp.where(good, newton, 0.5 * (lower + upper))
        move = jnp.abs(new - x)
        new = jnp.where(finished, x, new)
        return lower, upper, new, move, finished | (move < small), steps + 1

    state = (lower, upper, start, upper - lower, jnp.zeros_like(start, bool), 0)
    return jax.lax.while_loop(unfinished, step, state)[2]


@_root.def_jvp
def _root_jvp(primals, tangents):
    """Implicit function theorem: the value stays 0."""
    x, function = _root(*primals), primals[0]
    _, slope = jax.jvp(lambda x: function(x)[0], (x,), (jnp.ones_like(x),))
    _, change = eqx.filter_jvp(lambda function: function(x)[0], (function,), (tangents[0],))
    return x, jnp.where(slope == 0, 0, -change / jnp.where(slope == 0, 1, slope))


def clamped_root(
    function: Callable[[Array], Array], lower: Scalar, upper: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Root of a function that rises from `lower` to `upper`, or the end that it lies beyond.

    For an unknown of order one. **Returns:** the root, and the values at both ends: the first is
    above 0 where the root lies below `lower`, the second below 0 where it lies above `upper`. A
    clamped root has derivative 0.
    """
    low, high = jax.vmap(function)(jnp.stack([lower, upper]))  # traced once for both
    inside = (low < 0) & (high > 0)
    middle = 0.5 * (lower + upper)

    def value_and_slope(x):
        value, slope = jax.jvp(function, (x,), (jnp.ones_like(x),))
        return jnp.where(inside, value, x - middle), jnp.where(inside, slope, 1)

    share = low / jnp.where(inside, low - high, 1)
    start = jnp.where(inside, lower + (upper - lower) * share, middle)
    root = increasing_root(value_and_slope, lower, upper, jax.lax.stop_gradient(start))
    return jnp.where(inside, root, jnp.where(high <= 0, upper, lower)), low, high
