r"""Second-order plants on one scale of shape, and the times at which they reach a level.

The charts of Harriott, Smith and Strejc and the three-point methods all read the shape of a
second-order response off ratios that do not depend on the unit of time. Here the shape is

$$ \kappa = \left(\frac{T_1 - T_2}{T_1 + T_2}\right)^2 = 1 - \frac{1}{\zeta^2} \;\; (\zeta \ge 1),
   \qquad \kappa = \zeta^2 - 1 \;\; (\zeta < 1), $$

from 1 (one lag) over 0 (two equal lags) down to -1 (no damping). Curves have a finite slope in
it throughout, also at equal lags, where their slope in a ratio of lags is 0. The unit of time is
the sum of the lags $T_1 + T_2 = 2\zeta/\omega_n$ for $\kappa \ge 0$, and $2/\omega_n$ below.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arrays import Scalar, safe_sqrt
from ..models._responses import second_order_response, second_order_slopes
from ._roots import increasing_root


def shape_ends(dtype) -> tuple[Array, Array, Array]:
    """The shape next to no damping, that of equal lags, and the one next to a single lag.

    Within sqrt(eps) of its ends a shape is not to be told from them: curves are flat to rounding.
    """
    near = float(jnp.finfo(dtype).eps) ** 0.5
    return jnp.asarray(near - 1, dtype), jnp.zeros((), dtype), jnp.asarray(1 - near, dtype)


def damping(shape: Scalar) -> tuple[Scalar, Scalar]:
    r"""Damping $\zeta$ and $\omega_n$ in the unit of time of that shape."""
    over = shape >= 0
    overdamped = 1 / jnp.sqrt(1 - jnp.where(over, shape, 0))
    underdamped = jnp.sqrt(1 + jnp.where(over, 0, shape))
    return jnp.where(over, overdamped, underdamped), 2 * jnp.where(over, overdamped, 1)


def unit_response(x: Float[Array, "*shape"], shape: Scalar) -> Float[Array, "*shape"]:
    """Step response at times `x`, in the unit of time of that shape."""
    return second_order_response(x, *damping(shape))


def lags_of(shape: Scalar, total: Scalar) -> Float[Array, "2"]:
    """Two lags of a given sum, the larger first; from 1 on one lag and a 0, below 0 equal ones."""
    contrast = safe_sqrt(jnp.clip(shape, 0, 1))
    return 0.5 * total * jnp.stack([1 + contrast, 1 - contrast])


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def level_times(levels: tuple[float, ...], shape: Scalar) -> Float[Array, " levels"]:
    """Times of the first crossings of `levels`, in the unit of time of that shape.

    Roots of ln(g/(1-g)), nearly straight in ln t; an oscillation is cut off at its first peak.
    """
    shares = np.array(levels)
    target = jnp.asarray(np.log(shares / (1 - shares)), shape.dtype)
    eps = jnp.finfo(shape.dtype).eps
    zeta, omega_n = damping(shape)
    no_lead = jnp.zeros_like(shape)

    def logit(log_x):
        x = jnp.exp(log_x)
        g, slope, _ = second_order_slopes(x, zeta, omega_n, no_lead, [])
        slope = slope * x
        between = (g > eps) & (g < 1 - eps)
        g = jnp.clip(g, eps, 1 - eps)
        return jnp.log(g / (1 - g)) - target, jnp.where(between, slope / (g * (1 - g)), 0)

    sway = jnp.sqrt(jnp.maximum(-shape, 1e-3))
    peak = jnp.full_like(target, jnp.log(0.5 * np.pi / sway))
    start = jnp.asarray(np.log(0.25 - np.log1p(-shares)), shape.dtype)
    lowest = jnp.full_like(target, -10)
    return jnp.exp(increasing_root(logit, lowest, peak, jnp.minimum(start, peak)))


@level_times.defjvp
def _level_times_jvp(levels, primals, tangents):
    """Implicit function theorem: the response stays at its level."""
    (shape,), (shape_dot,) = primals, tangents
    x = level_times(levels, shape)
    (zeta, omega_n), changes = jax.jvp(damping, (shape,), (jnp.ones_like(shape),))
    no_lead = jnp.zeros_like(shape)
    found = second_order_slopes(x, zeta, omega_n, no_lead, [(*changes, no_lead)])
    return x, -found.changes[0] / found.in_time * shape_dot
