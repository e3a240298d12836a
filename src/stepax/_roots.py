"""Roots of monotone functions, differentiable by the implicit function theorem."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array


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
    small = jnp.sqrt(jnp.finfo(start.dtype).eps) / 10

    def unfinished(state):
        *_, finished, steps = state
        return jnp.any(~finished) & (steps < MAX_STEPS)

    def step(state):
        lower, upper, x, previous, finished, steps = state
        value, slope = value_and_slope(x)
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

    def solve(_, start):
        state = (lower, upper, start, upper - lower, jnp.zeros_like(start, bool), 0)
        return jax.lax.while_loop(unfinished, step, state)[2]

    def tangent_solve(linear, y):
        slope = linear(jnp.ones_like(y))
        return jnp.where(slope == 0, 0, y / jnp.where(slope == 0, 1, slope))

    return jax.lax.custom_root(lambda x: value_and_slope(x)[0], start, solve, tangent_solve)
