"""Orthonormal rows by Gram and Schmidt."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._arrays import Samples


class Orthonormal(NamedTuple):
    """Orthonormal rows q = c rows, and which rows are no combination of those before them.

    Rows of q and c are 0 where they are one.
    """

    q: Float[Array, "k samples"]
    c: Float[Array, "k k"]
    own: Bool[Array, " k"]


def orthonormal(rows: Sequence[Samples], weights: Samples | float, least: float) -> Orthonormal:
    """Rows made orthonormal in the inner product of the weights, in their order.

    `least`: share of its length that a row must keep across those before it to be one of its own.
    By Gram and Schmidt, twice, which is enough (Giraud, Langou 2005): few rows vectorise over a
    batch. LAPACK's QR never returns within `shard_map` on several CPU devices.
    """
    done: list[tuple[Samples, Array]] = []
    owns = []
    for row, c in zip(rows, jnp.eye(len(rows), dtype=rows[0].dtype), strict=True):
        square = (weights * row) @ row
        q = row
        for _ in range(2):
            for other, along in done:
                part = (weights * other) @ q
                q, c = q - part * other, c - part * along
        rest = (weights * q) @ q
        own = rest > least**2 * square
        size = jnp.where(own, 1 / jnp.sqrt(jnp.where(own, rest, 1)), 0)
        done.append((q * size, c * size))
        owns.append(own)
    q, c = (jnp.stack(x) for x in zip(*done, strict=True))
    return Orthonormal(q, c, jnp.stack(owns))
