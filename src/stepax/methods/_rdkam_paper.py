r"""The area methods of Maxim and De Keyser as their listing has them (A.3.2).

For checking against the paper: dead times at samples, areas by the rectangle rule with both end
samples (which makes A too large by K Ts/2), the area signal by the trapezoid rule, damping on a
grid of 0.01. Misprints of the print are set right (element-wise powers and divisions).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arrays import Scalar
from ..models._plants import FOPDT, SOPDT
from ._rdkam_scan import Scanned, Shape, area_ratio


GRIDS = {
    "rising": np.r_[np.arange(50, 100), np.arange(101, 301)] / 100,
    "real": np.r_[50, np.arange(101, 301)] / 100,
    "oscillatory": np.arange(1, 51) / 100,
}
"""Dampings of the listing; zeta = 1 is left out, where its formula is 0/0."""


def paper_scan(areas: Any, branch: str, period: Scalar | None = None) -> Scanned:
    """Best of all samples as dead times, for evenly sampled rows from the step on."""
    safe, level = areas.reading.safe, areas.level
    t, present = safe.elapsed, safe.after_step
    first, last = jnp.argmax(present), safe.last
    interval = (t[last] - t[first]) / (last - first)
    y = areas.response

    def one(row: Array) -> tuple[Scalar, FOPDT | SOPDT]:
        since = (jnp.arange(y.size) - row) * interval
        used = present & (since >= -0.5 * interval)
        plant, usable = _plant(y, level, since, used, interval, branch, period)
        g = plant.unit_response(jnp.where(used, since, 0))
        square = jnp.sum(jnp.where(present, y - level * g, 0) ** 2)
        return jnp.where(usable & jnp.isfinite(square), square, jnp.inf), plant

    rows = jnp.arange(y.size)
    squares, plants = jax.lax.map(one, rows)
    low = first + jnp.round(areas.low / interval)
    high = last - 1 if areas.last is None else first + jnp.round(areas.last / interval)
    squares = jnp.where((rows >= low) & (rows <= jnp.minimum(high, last - 1)), squares, jnp.inf)
    best = jnp.argmin(squares)
    plant = jax.tree.map(lambda x: x[best], plants)
    shape = Shape(plant, jnp.isfinite(squares[best]), jnp.zeros((), bool))
    return Scanned(shape, (best - first) * interval, level)


def _plant(y, level, since, used, interval, branch: str, period) -> tuple[Any, Array]:
    if branch == "oscillatory":
        grid = jnp.asarray(GRIDS[branch], y.dtype)
        area = interval * jnp.sum(jnp.where(used, jnp.abs(level - y), 0))
        measured = area / (jnp.abs(level) * period)
        zeta = grid[jnp.argmin(jnp.abs(measured - infinite_lobe_area(grid)))]
        omega_n = 2 * np.pi / (period * jnp.sqrt(1 - zeta**2))
        return SOPDT(zeta=zeta, omega_n=omega_n), jnp.ones((), bool)
    T = interval * jnp.sum(jnp.where(used, level - y, 0)) / level
    usable = T > 0
    T = jnp.where(usable, T, 1)
    if branch == "first":
        return FOPDT(T=T), usable
    apart = jnp.where(used, -jnp.expm1(-jnp.maximum(since, 0) / T) - y / level, 0)
    both = used[1:] & used[:-1]
    steps = jnp.where(both, 0.5 * interval * (apart[1:] + apart[:-1]), 0)
    signal = jnp.append(0, jnp.cumsum(steps))
    place = jnp.argmax(jnp.where(used, jnp.abs(signal), -1))
    grid = jnp.asarray(GRIDS[branch], y.dtype)
    misses = jnp.abs(signal[place] / T - area_ratio(since[place] / T, 0.25 / grid**2))
    zeta = grid[jnp.argmin(misses)]
    return SOPDT(zeta=zeta, omega_n=2 * zeta / T), usable


def infinite_lobe_area(zeta: Array) -> Array:
    r"""Eq. 18 over K and the period: the lobes of an endless record."""
    root = jnp.sqrt(1 - zeta**2)
    beta = zeta / root
    first = jnp.exp(-beta * (np.pi / 2 + jnp.arcsin(zeta)))
    return root / np.pi * (zeta - first / jnp.expm1(-np.pi * beta))
