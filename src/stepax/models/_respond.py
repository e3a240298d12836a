"""What is asked for when a plant responds to samples: which samples, held how, at which times."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._arrays import Samples, Scalar, as_real
from ._convolved import convolved_response, superposed_response
from ._sampled import even_response
from ._uneven import uneven_response


HOLDS = ("zero", "first")
"""How the input goes on from a sample: constant, or along the line to the next."""


def respond(plant: Any, t: Any, u: Any, hold: str) -> Samples:
    """Response of gain 1 to samples at any times; what cannot be is said or, traced, NaN."""
    with jax.ensure_compile_time_eval():  # times that are known stay known while JAX traces
        t = as_real(t)
    u = as_real(u)
    check_hold(hold)
    if t.ndim != 1 or t.shape != u.shape:
        raise ValueError(
            "respond takes one input: t and u as rows of equal length, not of shapes"
            f" {t.shape} and {u.shape}; for several use jax.vmap."
        )
    if isinstance(t, Tracer):
        return _respond_traced(plant, t, u, hold)
    known = np.asarray(t)
    if not np.all(np.diff(known) > 0):
        raise ValueError(
            "the times of respond must increase from row to row;"
            " several records, one behind the other, are for jax.vmap."
        )
    if t.shape[0] < 2 or is_even(known, np):
        return respond_evenly(plant, interval_of(t), u, hold)
    return respond_unevenly(plant, t, u, hold)


def check_hold(hold: Any) -> None:
    """A `ValueError` that names the holds."""
    if hold not in HOLDS:
        raise ValueError(f"hold must be one of {', '.join(map(repr, HOLDS))}, got {hold!r}.")


def interval_of(t: Any) -> Any:
    """The sampling interval of an even grid."""
    return (t[-1] - t[0]) / max(t.shape[0] - 1, 1)


def off_grid(t: Any, xp: Any = jnp) -> Any:
    """How far times lie off the even grid between the first and the last, at most."""
    return xp.max(xp.abs(t - t[0] - interval_of(t) * xp.arange(t.shape[0], dtype=t.dtype)))


def is_even(t: Any, xp: Any = jnp) -> Any:
    """Whether times are those of an even grid but for their rounding, and that is small.

    `xp` is numpy where that has to be known now, also inside a function that JAX traces.
    """
    eps = float(jnp.finfo(t.dtype).eps)
    interval, off = interval_of(t), off_grid(t, xp)
    rounding = 4 * eps * xp.maximum(xp.abs(t[0]), xp.abs(t[-1]))
    return (interval > 0) & (off <= rounding) & (off <= 1e-3 * interval)


def respond_evenly(plant: Any, interval: Scalar, u: Samples, hold: str) -> Samples:
    """Response of gain 1 to samples of the input every `interval`, which can be traced.

    Order N in time and memory; for a real order of equal lags N log N.
    """
    return _evenly(plant, interval, u, hold)


@eqx.filter_jit
def _evenly(plant: Any, interval: Scalar, u: Samples, hold: str) -> Samples:
    if u.shape[0] < 2:  # at rest up to the first sample
        return 0 * u
    realisation = plant.realise(interval)
    if realisation is None:
        y = convolved_response(
            plant.unit_response, plant.mean_response, plant.delay, interval, u, hold
        )
    else:
        y = even_response(realisation, plant.delay, interval, u, hold)
    return y


@eqx.filter_jit
def respond_unevenly(
    plant: Any, t: Samples, u: Samples, hold: str, at: Float[Array, " outputs"] | None = None
) -> Array:
    """Response of gain 1 to samples at increasing times; there, or `at` any up to the last."""
    realisation = plant.realise(jnp.min(jnp.diff(t)))
    if realisation is None:
        y = superposed_response(plant.unit_response, plant.unit_ramp, plant.delay, t, u, hold, at)
    else:
        y = uneven_response(realisation, plant.delay, t, u, hold, at)
    return y


@eqx.filter_jit
def _respond_traced(plant: Any, t: Samples, u: Samples, hold: str) -> Samples:
    """Even or not is decided when it runs; NaN where the times do not increase."""
    if t.shape[0] < 2:
        return 0 * u
    y = jax.lax.cond(
        is_even(t),
        lambda plant, t, u: _evenly(plant, interval_of(t), u, hold),
        lambda plant, t, u: respond_unevenly(plant, t, u, hold),
        plant,
        t,
        u,
    )
    return jnp.where(jnp.all(jnp.diff(t) > 0), y, jnp.nan)
