"""The integral of the squared deviation of two responses, to infinity; host code."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ._abstract import AbstractPlant, TimeScales


NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)


def squared_deviation(model: AbstractPlant, plant: AbstractPlant, step_size: float = 1.0) -> float:
    r"""$\int_0^\infty (y_m - y_p)^2\,dt$ of two step responses; infinite if they settle apart.

    Or if one of them does not settle.

    Gauss-Legendre quadrature on panels that grow from the fastest lag to the slowest, from each
    dead time on; in float64 the relative error is below 1e-9 (absolute 1e-24 K^2 T).
    """
    if not (model.settles and plant.settles):
        return np.inf
    last = [float(x.offset) + step_size * float(x.gain) for x in (model, plant)]
    size = abs(step_size) * max(abs(float(x.gain)) for x in (model, plant))
    rounding = max(1e-9, 16 * float(jnp.finfo(jnp.result_type(model.gain, plant.gain)).eps))
    if abs(last[0] - last[1]) > rounding * max(size, abs(last[1])):
        return np.inf
    scales = [x.time_scales() for x in (model, plant)]
    begin, middle = sorted(float(x.delay) for x in (model, plant))
    end = max(scale.horizon for scale in scales)
    edges = [[0.0], begin + _panels(middle - begin, scales), middle + _panels(end, scales)]
    edges = np.concatenate(edges)
    left, width = edges[:-1], np.diff(edges)
    rows = -(-width.size // 128) * 128  # few shapes: each is compiled once
    left, width = np.pad(left, (0, rows - width.size)), np.pad(width, (0, rows - width.size))
    times = left[:, None] + width[:, None] * (NODES + 1) / 2
    deviation = np.asarray(_deviation(model, plant, times), float)
    return float(step_size**2 * np.sum(width * (deviation**2 @ WEIGHTS)) / 2)


@eqx.filter_jit
def _deviation(model: AbstractPlant, plant: AbstractPlant, times):
    """Difference of the transients, whose limits are equal."""

    def transient(x):
        return x.gain * (x.unit_response(times - x.delay) - 1)

    return transient(model) - transient(plant)


def _panels(length: float, scales: Sequence[TimeScales]) -> np.ndarray:
    """Edges from 0 to `length`: from half the fastest scale on a quarter wider each.

    None is wider than the transients that have not died away allow.
    """
    edges, width = [0.0], 0.5 * min(scale.fastest for scale in scales)
    while edges[-1] + width < length:
        edges.append(edges[-1] + width)
        alive = [scale.widest for scale in scales if scale.horizon > edges[-1]]
        width = min([1.25 * width, *alive])
    return np.array([*edges, length])
