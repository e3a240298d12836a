"""Array aliases used in signatures, and what every room needs of arrays."""

from collections.abc import Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int


T = TypeVar("T")

Scalar = Float[Array, ""]
"""One real number: a parameter, a time, a level."""
Flag = Bool[Array, ""]
"""One truth value."""
Count = Int[Array, ""]
"""One whole number."""
Samples = Float[Array, " samples"]
"""One value per sample of a record."""
Lags = Float[Array, " lags"]
"""Time constants of a chain of first-order lags; 0 is no lag."""
Coordinates = Array | Sequence[Array]
"""A few unknowns: a row, or numbers one by one."""


def as_real(value: Any) -> Array:
    """Real array of `value`; a Python number stays weakly typed and follows the data's dtype."""
    if value is None:  # so that a model can hold `in_axes`
        return value  # pyright: ignore[reportReturnType]
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        value = float(value)
    value = jnp.asarray(value)
    if jnp.issubdtype(value.dtype, jnp.integer):
        value = value.astype(float)
    if not jnp.issubdtype(value.dtype, jnp.floating):
        raise TypeError(f"a model parameter must be a real number, got dtype {value.dtype}.")
    return value


def nan_where(condition: Flag, tree: Any) -> Any:
    """`tree` with its real leaves NaN where `condition` holds."""
    return jax.tree.map(
        lambda x: jnp.where(condition, jnp.nan, x) if eqx.is_inexact_array(x) else x, tree
    )


def safe_sqrt(x: Array) -> Array:
    """Square root whose derivative at 0 is 0."""
    return jnp.where(x == 0, 0, jnp.sqrt(jnp.where(x == 0, 1, x)))


def still(tree: T) -> T:
    """A tree without derivatives."""
    stop = lambda x: jax.lax.stop_gradient(x) if eqx.is_inexact_array(x) else x  # noqa: E731
    return jax.tree.map(stop, tree)


def computed_once(*values: Array) -> tuple[Array, ...]:
    """Values that several others are computed from, divided by a 1 that no compiler can see.

    XLA on a CPU computes an expression again in every loop that reads it, a sine and a cosine too,
    and drops optimisation barriers before it decides that; but what ends in a division it stores.
    NaN where the first value is.
    """
    one = jnp.where(values[0] == values[0], jnp.ones_like(values[0]), values[0])
    return tuple(x / one for x in values)


def row_by_row(rows: Sequence[Float[Array, " n"]]) -> Float[Array, "rows n"]:
    """The rows as a matrix, written into it one by one.

    Of a `stack` XLA on a CPU computes, for each of its elements, what all rows are made of, and of
    a sum over a contour that is twenty times the work.
    """
    matrix = jnp.zeros((len(rows), rows[0].size), rows[0].dtype)
    for place, row in enumerate(jax.lax.optimization_barrier(list(rows))):
        matrix = matrix.at[place].set(row)
    return matrix
