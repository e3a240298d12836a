"""What a plant does by itself, from another state than rest."""

import jax.numpy as jnp
import numpy as np

from .._arrays import Lags, Samples
from ._contour import chain_response


def chain_motions(t: Samples, lags: Lags) -> list[Samples]:
    """Motions of a chain: 1 less the step responses of the largest lag, the two largest, and so on.

    1/s - G_k(s)/s has the poles of the first k lags and no other, so that these span all motions,
    with equal lags too; and none is ever larger than 1. That of a lag of 0 is 0.
    """
    lags = -jnp.sort(-lags)
    motions = []
    for k in range(1, lags.size + 1):
        first = jnp.where(np.arange(lags.size) < k, lags, 0)
        motions.append(jnp.where(lags[k - 1] > 0, 1 - chain_response(t, first), 0))
    return motions
