r"""Coordinates of a fit: bounded, of order one, regular at their bounds.

How far two lags lie apart, s = T_2/T_1 in [0, 1], enters a response as an even function of ln s.
Its coordinate is the square of the contrast, $e = ((1 - s)/(1 + s))^2$: the response has a finite
slope in it that is not 0 at equal lags (e = 0) and at a single lag (e = 1). For a chain, s is the
ratio of the extreme rates; for two lags of damping $\zeta$, $1 - e = 1/\zeta^2$. Individual lags,
where any of them can meet, are their own coordinates: the response is a symmetric function of them.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from .._arrays import Coordinates, Flag, Scalar
from ..models._responses import MAX_REAL_ORDER


LOG_TIME = (math.log(1e-6), math.log(1e3))
"""Bounds of a time constant, relative to the length of the record."""
CONTRAST = (0.0, 1.0)
LAG = (0.0, 1e4)
"""Bounds of a lag, relative to the sum of the lags at the start."""
APART = 0.01
"""Least relative distance of two lags at the start: at one place the fit could not part them."""
LEAD = (-100.0, 100.0)
"""Bounds of a lead over the period of its poles: beyond them the response is that of the zero."""
LONGEST_LAG = 100.0
"""Largest lag beside an integrator, relative to the length of the record: a parabola by then."""
LOG_ORDER = (math.log(0.3), math.log(MAX_REAL_ORDER))
LOG_DAMPING = (math.log1p(200.0**-2), math.log1p(0.005**-2))
"""Bounds of $\\ln(1 + 1/\\zeta^2)$: damping from 200 down to 0.005."""


def _inside(dtype) -> tuple[float, float]:
    """Distances of a contrast from its ends: at equal lags, and at a single lag.

    At equal lags s differs from 1 by the root of it, eps^(1/3): there the response still changes by
    more than rounding. `tests/fitting` compares gradients at both ends with differences.
    """
    eps = float(jnp.finfo(dtype).eps)
    return eps ** (2 / 3), eps**0.5


def encode_ratio(s) -> Array:
    """Coordinate of a ratio s of two lags or rates."""
    near, far = _inside(s.dtype)
    contrast = (1 - s) / (1 + s)
    return jnp.clip((contrast**2 - near) / (1 - near - far), 0, 1)


def decode_ratio(x, exact: bool = False) -> Array:
    """Ratio s of two lags or rates at a coordinate; exactly 1 or 0 at its ends, if so wished."""
    near, far = _inside(x.dtype)
    contrast = jnp.sqrt(near + (1 - near - far) * x)
    s = (1 - contrast) / (1 + contrast)
    return jnp.where(x <= 0, 1, jnp.where(x >= 1, 0, s)) if exact else s


def encode_lag(T: Scalar, unit: Scalar) -> Array:
    """ln T."""
    return jnp.log(jnp.reshape(T / unit, (1,)))


def decode_lag(x: Coordinates, unit: Scalar) -> dict[str, Array]:
    """T at its coordinate."""
    return {"T": unit * jnp.exp(x[0])}


def encode_second_order(zeta: Scalar, omega_n: Scalar, unit: Scalar) -> Array:
    """Coordinates of damping and period."""
    period = jnp.log1p(4 * zeta**2) / 2 - jnp.log(omega_n * unit)
    return jnp.stack([jnp.log1p(zeta**-2), period])


def decode_second_order(x: Coordinates, unit: Scalar) -> dict[str, Array]:
    """zeta and omega_n at coordinates."""
    zeta = 1 / jnp.sqrt(jnp.expm1(x[0]))
    return {"zeta": zeta, "omega_n": jnp.sqrt(1 + 4 * zeta**2) * jnp.exp(-x[1]) / unit}


# Where one optimum may not be the only one


FEW_SAMPLES = 3
"""Length of a second lag, in sampling intervals, from which on it has one optimum.

Of 48 000 noisy records of chains of up to five lags (40 and 200 rows) a second start found a better
optimum for 1 to 3 %, and the second lag of the first one was never longer than 2.4 intervals."""


class OtherStart(NamedTuple):
    """Coordinates, how much later the response begins, and whether to search from there at all."""

    x: list[Array]
    later: Scalar
    worthwhile: Flag


def half_interval(
    x: list[Array], lag: Scalar, interval: Scalar, second: Scalar | None = None
) -> OtherStart:
    """For a second lag that can trade places with the dead time: `x` has it at half an interval.

    The dead time makes up for what the `lag` was. Only a lag shorter than some samples does so;
    `second` is the second longest, where that is not the `lag`.
    """
    second = lag if second is None else second
    return OtherStart(x, lag - interval / 2, second < FEW_SAMPLES * interval)
