r"""Coordinates in which each family is refined: bounded, of order one, regular at their bounds.

A family's own parameters map one to one to coordinates; fixing a parameter removes its coordinate.

How far two lags lie apart, s = T_2/T_1 in [0, 1], enters a response as an even function of ln s.
Its coordinate is the square of the contrast, $e = ((1 - s)/(1 + s))^2$: the response has a finite
slope in it that is not 0 at equal lags (e = 0) and at a single lag (e = 1). For a chain, s is the
ratio of the extreme rates; for two lags of damping $\zeta$, $1 - e = 1/\zeta^2$.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from ._curves import chain_of_ratio
from ._models import FOPDT, SOPDT, AbstractPlant, EqualLag, Hudzovic, PTn, Sani
from ._responses import MAX_REAL_ORDER
from ._types import Coordinates


LOG_TIME = (math.log(1e-6), math.log(1e3))
"""Bounds of a time constant, relative to the length of the record."""
CONTRAST = (0.0, 1.0)
LOG_ORDER = (math.log(0.3), math.log(MAX_REAL_ORDER))
LOG_DAMPING = (math.log1p(200.0**-2), math.log1p(0.005**-2))
"""Bounds of $\\ln(1 + 1/\\zeta^2)$: damping from 200 down to 0.005."""


class Ratio(NamedTuple):
    """The coordinate that tells the ratio of the two largest lags: its place, and both maps."""

    place: int
    encode: Callable[[Array], Array]
    decode: Callable[[Array], Array]


class Family(NamedTuple):
    """`names` of the own parameters, one coordinate each (all coordinates for `lags`).

    `encode(model)` gives coordinates, `decode(coordinates, model, exact)` own parameters; what is
    not a coordinate, the order of a chain, is taken from the model. At the end of a contrast the
    slope of r is infinite: `decode` stays a rounding error inside unless `exact`. `bounds` hold
    for a record of unit length; `time_powers` is how each coordinate moves with the logarithm of
    the length. `ratio` is that of the two largest lags, where it can vary.
    """

    names: tuple[str, ...]
    encode: Callable[[AbstractPlant], Array]
    decode: Callable[[Coordinates, AbstractPlant, bool], dict[str, Array]]
    bounds: tuple[tuple[float, float], ...]
    time_powers: tuple[float, ...]
    ratio: Ratio | None = None


def family_of(model: AbstractPlant) -> Family:
    """Coordinates of a model's family."""
    if isinstance(model, Hudzovic | Sani):
        bounds, ratio = (LOG_TIME, CONTRAST), Ratio(1, _encode_ratio, _decode_ratio)
        return Family(("T", "r"), _encode_chain, _decode_chain, bounds, (1, 0), ratio)
    if isinstance(model, FOPDT) or _is_whole(model):
        return Family(("T",), _encode_T, _decode_T, (LOG_TIME,), (1,))
    if isinstance(model, EqualLag):
        bounds = (LOG_TIME, LOG_ORDER)
        return Family(("T", "n"), _encode_equal_lags, _decode_equal_lags, bounds, (1, 0))
    if isinstance(model, SOPDT):
        bounds = (LOG_DAMPING, LOG_TIME)
        names, ratio = ("zeta", "omega_n"), Ratio(0, _encode_damping, _decode_damping)
        return Family(names, _encode_second, _decode_second, bounds, (0, 1), ratio)
    if isinstance(model, PTn):
        more = model.lags.shape[0] - 1
        bounds = (LOG_TIME,) + (CONTRAST,) * more
        powers, ratio = (1,) + (0,) * more, Ratio(1, _encode_ratio, _decode_ratio)
        ratio = ratio if more else None
        return Family(("lags",), _encode_lags, _decode_lags, bounds, powers, ratio)
    raise TypeError(f"refine needs a stepax model, got {type(model).__name__}.")


def _is_whole(model) -> bool:
    if not isinstance(model, EqualLag):
        return False
    return isinstance(model.n, int) or jnp.issubdtype(model.n.dtype, jnp.integer)


def _inside(dtype) -> tuple[float, float]:
    """Distances of a contrast from its ends: at equal lags, and at a single lag."""
    eps = float(jnp.finfo(dtype).eps)
    return eps ** (2 / 3), eps**0.5


def _encode_ratio(s) -> Array:
    near, far = _inside(s.dtype)
    contrast = (1 - s) / (1 + s)
    return jnp.clip((contrast**2 - near) / (1 - near - far), 0, 1)


def _decode_ratio(x, exact: bool = False) -> Array:
    """Ratio s of two lags or rates at a coordinate; exactly 1 or 0 at its ends, if so wished."""
    near, far = _inside(x.dtype)
    contrast = jnp.sqrt(near + (1 - near - far) * x)
    s = (1 - contrast) / (1 + contrast)
    return jnp.where(x <= 0, 1, jnp.where(x >= 1, 0, s)) if exact else s


def _encode_chain(model) -> Array:
    """ln of the sum of the lags, and the contrast of the extreme rates."""
    s = model.r if isinstance(model, Sani) else 1 - (model.n - 1) * model.r
    return jnp.stack([jnp.log(jnp.sum(model.lags)), _encode_ratio(s)])


def _decode_chain(x, model, exact) -> dict[str, Array]:
    s = _decode_ratio(x[1], exact)
    if isinstance(model, Hudzovic):  # r = 1/(n-1) is outside its range
        s = jnp.where(x[1] >= 1, _decode_ratio(x[1], False), s)
    chain = chain_of_ratio(type(model), s, model.n)
    return {"T": chain.T * jnp.exp(x[0]), "r": chain.r}


def _encode_T(model) -> Array:
    return jnp.log(jnp.reshape(model.T, (1,)))


def _decode_T(x, model, exact) -> dict[str, Array]:
    return {"T": jnp.exp(x[0])}


def _encode_equal_lags(model) -> Array:
    return jnp.stack([jnp.log(model.T * model.n), jnp.log(model.n)])


def _decode_equal_lags(x, model, exact) -> dict[str, Array]:
    return {"T": jnp.exp(x[0] - x[1]), "n": jnp.exp(x[1])}


def _encode_second(model) -> Array:
    r"""$\ln(1 + 1/\zeta^2)$, and $\ln\sqrt{1 + 4\zeta^2}/\omega_n$.

    The second is the period where the plant oscillates and the sum of its lags where it creeps.
    """
    period = jnp.log1p(4 * model.zeta**2) / 2 - jnp.log(model.omega_n)
    return jnp.stack([jnp.log1p(model.zeta**-2), period])


def _decode_second(x, model, exact) -> dict[str, Array]:
    zeta = 1 / jnp.sqrt(jnp.expm1(x[0]))
    return {"zeta": zeta, "omega_n": jnp.sqrt(1 + 4 * zeta**2) * jnp.exp(-x[1])}


def _encode_damping(s) -> Array:
    """The coordinate of the damping at a ratio s of two lags: 1/zeta^2 = 4 s/(1 + s)^2."""
    return jnp.log1p(4 * s / (1 + s) ** 2)


def _decode_damping(x) -> Array:
    """That ratio; 1 for all that oscillates."""
    square = jnp.minimum(jnp.expm1(x), 1)
    return square / (1 + jnp.sqrt(1 - square)) ** 2


def _encode_lags(model) -> Array:
    """ln of the sum of the lags, and the contrasts of neighbours in descending order."""
    lags = -jnp.sort(-model.lags)
    ratios = lags[1:] / jnp.where(lags[:-1] > 0, lags[:-1], 1)
    total = jnp.log(jnp.sum(lags))
    return jnp.stack([total, *(_encode_ratio(ratios[k]) for k in range(ratios.size))])


def _decode_lags(x, model, exact) -> dict[str, Array]:
    lags = [jnp.ones_like(x[0])]
    for contrast in list(x)[1:]:
        lags.append(lags[-1] * _decode_ratio(contrast, exact))
    row = jnp.where(present_lags(model), jnp.stack(lags), 0)
    return {"lags": row * jnp.exp(x[0]) / jnp.sum(row)}


def present_lags(model: PTn) -> Array:
    """Which of the lags of a start, largest first, are lags: a lag of 0 is none and stays none."""
    return -jnp.sort(-model.lags) > 0
