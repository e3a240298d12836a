"""Methods over batches of records on every core, and what comes of them as numbers."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from stepax import METHODS, Status, StepRecord, over_devices, refused
from stepax._compilation import quick_compilation


CHUNK = 25


class Way(NamedTuple):
    """A method with options; with the true gain and period given if `given`."""

    method: str
    given: bool = False
    options: tuple[tuple[str, Any], ...] = ()
    final: bool = False


WAYS = {
    "listing": Way("rdkam", True, (("protocol", "paper"),)),
    "listing, oscillatory": Way("rdkam_oscillatory", True, (("protocol", "paper"),)),
    "rdkam, K and Tp given": Way("rdkam", True),
    "rdkam": Way("rdkam"),
    "fit": Way("sopdt_fit", options=(("errors", False),)),
    "fit, K known": Way("sopdt_fit", options=(("errors", False),), final=True),
    "three points": Way("rangaiah_krishnaswamy"),
    "integrals": Way("wang_guo_zhang"),
    "integrals, instruments": Way("wang_guo_zhang", options=(("instruments", True),)),
}
"""The paper's listing, ours, least squares (the stand-in for TFEST), GPR and QGW."""

PARAMETERS = ("gain", "zeta", "omega_n", "delay")


class Found(NamedTuple):
    """Parameters (records, 4), NaN where refused; squared error against the clean response."""

    parameters: np.ndarray
    mse: np.ndarray
    edge: np.ndarray
    oscillatory: np.ndarray


def _one(way: Way, swings: bool):
    """A method on one record, as arrays."""

    def one(case):
        t, y, clean, gain, period = case
        options = dict(way.options)
        if way.given:
            options["gain"] = gain
            if swings:
                options["period"] = period
        record = StepRecord(t, y, initial=0.0, final=gain if way.final else None)
        result = METHODS[way.method](record, **options)
        model: Any = result.model
        lost = refused(result.status)
        error = jnp.mean((model.step_response(t) - clean) ** 2)
        values = jnp.stack([getattr(model, name) for name in PARAMETERS])
        oscillatory = result.details.get("oscillatory", model.zeta < 0.5)
        edge = result.status == Status.at_curve_end
        return jnp.where(lost, jnp.nan, values), jnp.where(lost, jnp.nan, error), edge, oscillatory

    return one


@functools.cache
def _compiled(way: Way, swings: bool):
    one = _one(way, swings)

    def chunked(*rows):
        size = rows[0].shape[0] // CHUNK
        parts = [x.reshape(size, CHUNK, *x.shape[1:]) for x in rows]
        found = jax.lax.map(jax.vmap(one), tuple(parts))
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), found)

    return over_devices(chunked)


def identified(name: str, t, y, clean, gain, period=None) -> Found:
    """A method of `WAYS` on records (records, samples); gain and period are what it may be given.

    Rows are filled up to whole chunks on every core.
    """
    count, size = len(y), CHUNK * jax.device_count()
    filled = -(-count // size) * size
    rows = np.arange(filled) % count
    wide = lambda x, shape: np.broadcast_to(np.asarray(x, float), shape)[rows]  # noqa: E731
    swings = period is not None and WAYS[name].given
    period = 1.0 if period is None else period
    cases = [wide(x, y.shape) for x in (t, y, clean)] + [wide(x, (count,)) for x in (gain, period)]
    found = _compiled(WAYS[name], swings)(*cases)
    return Found(*(np.asarray(x)[:count] for x in found))


def identified_alone(name: str, t, y, clean, gain, period=None) -> Found:
    """The same for one record: as on the command line, compiled quickly."""
    way = WAYS[name]
    numbers = [jnp.asarray(x) for x in (t, y, clean, gain, period or 1.0)]
    with quick_compilation():
        found = _one(way, period is not None)(numbers)
    return Found(*(np.asarray(x)[None] for x in found))
