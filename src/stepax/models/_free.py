r"""Numbers without bounds for parameters that have some: one number each, and back.

They are the coordinates of the fits (`fitting/_coordinates`) put on the whole line: logarithms of
times, the sum of a chain's lags, the contrast of its rates, the period of two poles. A fit knows
the length of its record and stays within a range beside it; an optimiser that knows nothing may
take any step. So beyond `STEEP` a logarithm grows as another logarithm does: a step of 10^5 too far
is a factor of 10^5, neither an overflow nor 0, and comes back.

What lies on an end of its range, a lag or a dead time of 0, is at minus infinity, has no slope
there and stays: no finite number leads to it.
"""

import math

import jax.numpy as jnp
from jaxtyping import Array

from .._arrays import Scalar


STEEP = 20.0
"""Logarithms are as they are up to here: factors of 2e-9 to 5e8 times the unit of time."""


def free_positive(value: Array) -> Array:
    """Free number of a positive one; minus infinity for 0."""
    present = value > 0
    log = jnp.log(jnp.where(present, value, 1))
    beyond = jnp.abs(log) > STEEP
    far = STEEP + jnp.expm1(jnp.where(beyond, jnp.abs(log) - STEEP, 0))
    return jnp.where(present, jnp.where(beyond, jnp.sign(log) * far, log), -jnp.inf)


def positive(free: Array) -> Array:
    """A positive number, 0 for minus infinity, of any free one."""
    present = free > -jnp.inf
    free = jnp.where(present, free, 0)
    beyond = jnp.abs(free) > STEEP
    far = STEEP + jnp.log1p(jnp.where(beyond, jnp.abs(free) - STEEP, 0))
    log = jnp.where(beyond, jnp.sign(free) * far, free)
    return jnp.where(present, jnp.exp(log), 0)


def free_odds(root: Array) -> Array:
    r"""Free number of odds of which this is the root: $z = (w - 1/w)/2$; infinite at both ends."""
    inside = (root > 0) & (root < jnp.inf)
    safe = jnp.where(inside, root, 1)
    return jnp.where(inside, (safe - 1 / safe) / 2, jnp.where(root > 0, jnp.inf, -jnp.inf))


def root_of_odds(free: Array) -> Array:
    r"""$w = z + \sqrt{1 + z^2}$, for the odds w^2 of a share of a range: algebraic at both ends."""
    inside = jnp.abs(free) < jnp.inf
    safe = jnp.where(inside, free, 0)
    size = jnp.abs(safe) + jnp.sqrt(1 + safe * safe)
    return jnp.where(inside, jnp.where(safe > 0, size, 1 / size), jnp.where(free > 0, jnp.inf, 0))


def free_ratio(s: Scalar) -> Array:
    r"""Free number of a ratio of rates: its squared contrast $((1-s)/(1+s))^2$ as odds.

    Their root is $(1 - s)/(2\sqrt s)$: both ends, equal lags and one lag, keep their digits.
    """
    apart = s > 0
    return jnp.where(apart, free_odds((1 - s) / (2 * jnp.sqrt(jnp.where(apart, s, 1)))), jnp.inf)


def ratio(free: Array) -> Array:
    r"""Ratio of rates $s = e^{-2\,\text{asinh}\,w}$; 1 at minus infinity and 0 at infinity.

    A finite number leads to no less than 16 eps: a ratio of 0 is not in the range of all families.
    """
    single = free == jnp.inf
    w = root_of_odds(jnp.where(single, 0, free))
    most = 1 / (8 * math.sqrt(float(jnp.finfo(w.dtype).eps)))
    w = jnp.minimum(w, most)
    return jnp.where(single, 0, 1 / (w + jnp.sqrt(1 + w * w)) ** 2)
