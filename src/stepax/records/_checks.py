"""What the fields of a record may hold: what is wrong in kind raises a sentence."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array


def as_samples(values: Any, name: str) -> Array:
    """A row of real numbers; `name`: which, such as "t of a StepRecord"."""
    if not isinstance(values, jax.Array):
        try:
            values = np.asarray(values)
        except ValueError:
            raise ValueError(f"{name} must be one row of numbers.") from None
    if values.dtype == bool or not (
        np.issubdtype(values.dtype, np.integer) or jnp.issubdtype(values.dtype, jnp.floating)
    ):
        raise TypeError(f"{name} must hold real numbers, got values of type {values.dtype}.")
    if values.ndim != 1:
        raise ValueError(
            f"{name} must be one row of numbers, got shape {values.shape};"
            " for a batch of records use jax.vmap."
        )
    if jnp.issubdtype(values.dtype, jnp.integer):
        values = values.astype(float)
    return jnp.asarray(values)


def as_number(value: Any, name: str, dtype) -> Array:
    """A real number."""
    value = jnp.asarray(value) if isinstance(value, jax.Array) else np.asarray(value)
    if value.dtype == bool or not (
        jnp.issubdtype(value.dtype, jnp.floating) or jnp.issubdtype(value.dtype, jnp.integer)
    ):
        raise TypeError(f"{name} must be a real number, got {value!r}.")
    if value.ndim != 0:
        raise ValueError(f"{name} must be one number, got shape {value.shape}.")
    return jnp.asarray(value, dtype)


def as_rows(rows: Any, name: str, size: int) -> Array:
    """How many of `size` rows count."""
    rows = rows if isinstance(rows, jax.Array) else np.asarray(rows)
    if not jnp.issubdtype(rows.dtype, jnp.integer) or rows.ndim:
        raise TypeError(f"{name} must be a whole number, got {rows!r}.")
    if not isinstance(rows, Tracer) and not 0 <= int(rows) <= size:
        raise ValueError(f"{name} must lie in 0..{size}, got {rows}.")
    return jnp.asarray(rows)


def as_weights(weights: Any, name: str, like: Array) -> Array:
    """One weight a row."""
    weights = as_samples(weights, name).astype(like.dtype)
    if weights.shape != like.shape:
        raise ValueError(f"{name} need one value per row, {like.size}, got {weights.size}.")
    return weights
