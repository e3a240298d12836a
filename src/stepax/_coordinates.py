r"""Coordinates in which each family is refined: bounded, of order one, regular at equal lags.

A family's own parameters map one to one to coordinates; fixing a parameter removes its coordinate.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ._curves import chain_with_spread
from ._models import FOPDT, SOPDT, AbstractPlant, EqualLag, Hudzovic, PTn, Sani
from ._responses import MAX_REAL_ORDER
from ._types import Coordinates


LOG_TIME = (math.log(1e-6), math.log(1e3))
"""Bounds of a time constant, relative to the length of the record."""
MAX_SPREAD = 25.0
"""Bound of -ln c of a chain: s = 3.5e-12, one dominant lag to rounding."""
LOG_ORDER = (math.log(0.3), math.log(MAX_REAL_ORDER))
LOG_DAMPING = (math.log(0.005), math.log(200.0))


class Family(NamedTuple):
    """`names` of the own parameters, one coordinate each (all coordinates for `lags`).

    `encode(model)` gives coordinates, `decode(coordinates, model)` own parameters; what is not a
    coordinate, the order of a chain, is taken from the model. `bounds` hold for a record of unit
    length; `time_powers` is how each coordinate moves with the logarithm of the length.
    """

    names: tuple[str, ...]
    encode: Callable[[AbstractPlant], Array]
    decode: Callable[[Coordinates, AbstractPlant], dict[str, Array]]
    bounds: tuple[tuple[float, float], ...]
    time_powers: tuple[float, ...]


def family_of(model: AbstractPlant) -> Family:
    """Coordinates of a model's family."""
    if isinstance(model, Hudzovic | Sani):
        return Family(
            ("T", "r"), _encode_chain, _decode_chain, (LOG_TIME, (0.0, MAX_SPREAD)), (1, 0)
        )
    if isinstance(model, EqualLag):
        if isinstance(model.n, int) or jnp.issubdtype(model.n.dtype, jnp.integer):
            return Family(("T",), _encode_T, _decode_T, (LOG_TIME,), (1,))
        return Family(
            ("T", "n"), _encode_equal_lags, _decode_equal_lags, (LOG_TIME, LOG_ORDER), (1, 0)
        )
    if isinstance(model, FOPDT):
        return Family(("T",), _encode_T, _decode_T, (LOG_TIME,), (1,))
    if isinstance(model, SOPDT):
        return Family(
            ("zeta", "omega_n"), _encode_second, _decode_second,
            (LOG_DAMPING, (-LOG_TIME[1], -LOG_TIME[0])), (0, -1),
        )  # fmt: skip
    if isinstance(model, PTn):
        count = model.lags.shape[0]
        return Family(("lags",), _encode_lags, _decode_lags, (LOG_TIME,) * count, (1,) * count)
    raise TypeError(f"refine needs a stepax model, got {type(model).__name__}.")


def _softening(dtype) -> float:
    """Spread kept at the equal-lag end, where the slope of r in the spread is infinite."""
    return float(jnp.finfo(dtype).eps) ** (2 / 3)


def _encode_chain(model) -> Array:
    """ln of the sum of the lags, and -ln c, c = 4 s/(1+s)^2 with s the ratio of extreme rates."""
    s = model.r if isinstance(model, Sani) else 1 - (model.n - 1) * model.r
    s = jnp.clip(s, 1e-12, 1.0)
    spread = 2 * jnp.log1p(s) - jnp.log(4 * s)
    return jnp.stack([jnp.log(jnp.sum(model.lags)), jnp.maximum(spread, 0)])


def _decode_chain(x, model) -> dict[str, Array]:
    chain: Hudzovic | Sani = chain_with_spread(
        type(model), -(x[1] + _softening(x[1].dtype)), model.n
    )
    equal_lags = 1.0 if isinstance(model, Sani) else 0.0
    at_end = x[1] <= 0
    # On the bound r is exactly at its end; derivatives are those a rounding error inside it.
    to_end = jax.lax.stop_gradient(jnp.where(at_end, equal_lags - chain.r, 0))
    return {"T": chain.T * jnp.exp(x[0]), "r": chain.r + to_end}


def _encode_T(model) -> Array:
    return jnp.log(jnp.reshape(model.T, (1,)))


def _decode_T(x, model) -> dict[str, Array]:
    return {"T": jnp.exp(x[0])}


def _encode_equal_lags(model) -> Array:
    return jnp.stack([jnp.log(model.T * model.n), jnp.log(model.n)])


def _decode_equal_lags(x, model) -> dict[str, Array]:
    return {"T": jnp.exp(x[0] - x[1]), "n": jnp.exp(x[1])}


def _encode_second(model) -> Array:
    return jnp.stack([jnp.log(model.zeta), jnp.log(model.omega_n)])


def _decode_second(x, model) -> dict[str, Array]:
    return {"zeta": jnp.exp(x[0]), "omega_n": jnp.exp(x[1])}


def _encode_lags(model) -> Array:
    return jnp.log(jnp.maximum(model.lags, 1e-9))


def _decode_lags(x, model) -> dict[str, Array]:
    return {"lags": jnp.exp(jnp.stack(list(x)))}
