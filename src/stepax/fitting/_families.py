r"""Coordinates in which each family is refined: bounded, of order one, regular at their bounds.

A family's own parameters map one to one to coordinates; fixing a parameter removes its coordinate.

How far two lags lie apart, s = T_2/T_1 in [0, 1], enters a response as an even function of ln s.
Its coordinate is the square of the contrast, $e = ((1 - s)/(1 + s))^2$: the response has a finite
slope in it that is not 0 at equal lags (e = 0) and at a single lag (e = 1). For a chain, s is the
ratio of the extreme rates; for two lags of damping $\zeta$, $1 - e = 1/\zeta^2$. Individual lags,
where any of them can meet, are their own coordinates: the response is a symmetric function of them.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._arrays import Coordinates
from ..models._plants import FOPDT, SOPDT, AbstractPlant, EqualLag, Hudzovic, PTn, Sani
from ..models._responses import MAX_REAL_ORDER
from ..models._spread import chain_of_ratio


LOG_TIME = (math.log(1e-6), math.log(1e3))
"""Bounds of a time constant, relative to the length of the record."""
CONTRAST = (0.0, 1.0)
LAG = (0.0, 1e4)
"""Bounds of a lag, relative to the sum of the lags at the start."""
APART = 0.01
"""Least relative distance of two lags at the start."""
LOG_ORDER = (math.log(0.3), math.log(MAX_REAL_ORDER))
LOG_DAMPING = (math.log1p(200.0**-2), math.log1p(0.005**-2))
"""Bounds of $\\ln(1 + 1/\\zeta^2)$: damping from 200 down to 0.005."""


class Family(NamedTuple):
    """`names` of the own parameters, one coordinate each (all coordinates for `lags`).

    `encode(model)` gives coordinates, `decode(coordinates, model, exact)` own parameters; what is
    not a coordinate, the order of a chain, is taken from the model. At the end of a contrast the
    slope of r is infinite: `decode` stays a rounding error inside unless `exact`. `bounds` hold
    for a record of unit length; `time_powers` is how each coordinate moves with the logarithm of
    the length. `shortened(coordinates, model, lag)` gives the coordinates with the second lag, or
    the shortest of several, set to a value, and what it was; None where there is but one.
    """

    names: tuple[str, ...]
    encode: Callable[[AbstractPlant], Array]
    decode: Callable[[Coordinates, AbstractPlant, bool], dict[str, Array]]
    bounds: tuple[tuple[float, float], ...]
    time_powers: tuple[float, ...]
    shortened: Callable[[list[Array], AbstractPlant, Array], tuple[list[Array], Array]] | None = (
        None
    )


def family_of(model: AbstractPlant) -> Family:
    """Coordinates of a model's family."""
    if isinstance(model, Hudzovic | Sani):
        bounds = (LOG_TIME, CONTRAST)
        return Family(("T", "r"), _encode_chain, _decode_chain, bounds, (1, 0), _shortened_chain)
    if isinstance(model, FOPDT) or _is_whole(model):
        return Family(("T",), _encode_T, _decode_T, (LOG_TIME,), (1,))
    if isinstance(model, EqualLag):
        bounds = (LOG_TIME, LOG_ORDER)
        return Family(("T", "n"), _encode_equal_lags, _decode_equal_lags, bounds, (1, 0))
    if isinstance(model, SOPDT):
        bounds, names = (LOG_DAMPING, LOG_TIME), ("zeta", "omega_n")
        return Family(names, _encode_second, _decode_second, bounds, (0, 1), _shortened_second)
    if isinstance(model, PTn):
        count = model.lags.shape[0]
        bounds, powers = (LAG,) * count, (0,) * count
        shortened = _shortened_lags if count > 1 else None
        return Family(("lags",), _encode_lags, _decode_lags, bounds, powers, shortened)
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


def _shortened_chain(full, model, lag) -> tuple[list[Array], Array]:
    total = jnp.exp(full[0])
    before = _decode_ratio(full[1]) * total
    return [full[0], _encode_ratio(lag / total)], before


def _shortened_second(full, model, lag) -> tuple[list[Array], Array]:
    """Two lags of ratio s have 1/zeta^2 = 4 s/(1 + s)^2; all that oscillates counts as s = 1."""
    total = jnp.exp(full[1])
    square = jnp.minimum(jnp.expm1(full[0]), 1)
    before = square / (1 + jnp.sqrt(1 - square)) ** 2 * total
    s = lag / total
    return [jnp.log1p(4 * s / (1 + s) ** 2), full[1]], before


def _shortened_lags(full, model, lag) -> tuple[list[Array], Array]:
    row = jnp.stack(full)
    place = jnp.argmin(jnp.where(present_lags(model), row, jnp.inf))
    unit = unit_of_lags(model).astype(row.dtype)
    return list(row.at[place].set(lag / unit)), row[place] * unit


def _encode_lags(model) -> Array:
    """Lags over their sum, largest first; equal ones a little apart, where a fit can part them."""
    lags = -jnp.sort(-model.lags)
    apart = 1 + APART * jnp.linspace(1, -1, lags.size, dtype=lags.dtype)
    return lags / unit_of_lags(model) * (apart if lags.size > 1 else 1)


def _decode_lags(x, model, exact) -> dict[str, Array]:
    row = jnp.stack(list(x))
    return {"lags": row * unit_of_lags(model).astype(row.dtype)}


def unit_of_lags(model: Any) -> Array:
    """Unit of the lags: the sum of those of the start."""
    return jax.lax.stop_gradient(jnp.sum(model.lags))


def present_lags(model: Any) -> Array:
    """Which of the lags of a start, largest first, are lags: a lag of 0 is none and stays none."""
    return -jnp.sort(-model.lags) > 0


def with_order(model, n: Array):
    """A chain of another order with the same sum of lags and ratio of extreme rates."""
    if isinstance(model, EqualLag):
        return dataclasses.replace(model, T=model.T * model.n / n, n=n)
    family, other = family_of(model), dataclasses.replace(model, n=n)
    return dataclasses.replace(other, **family.decode(family.encode(model), other, False))
