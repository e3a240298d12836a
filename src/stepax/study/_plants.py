"""Random plants, each with randomness of its own, and the records that are made of them."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._arrays import Lags, Scalar
from ..curves._roots import increasing_root
from ..models._plants import PTn
from ..models._responses import MAX_ORDER


Real = float | int

REST = 1e-3
"""What is left of the change at the end of a study's record: Murray (2016) ends at 99.9 %."""


@dataclasses.dataclass(frozen=True)
class UniformLags:
    """Lags uniform between `low` and `high`: Murray (2016), eq. 4.1 as the author's code has it."""

    low: Real = 1.0
    high: Real = 9.0

    def __post_init__(self) -> None:
        _check_range(self.low, self.high)

    def __call__(self, key: Array, order: int) -> Lags:
        """Lags of one plant."""
        return uniform(key, (order,), self.low, self.high)


@dataclasses.dataclass(frozen=True)
class LogUniformLags:
    """Lags whose logarithms are uniform: every decade between `low` and `high` is as likely."""

    low: Real = 0.1
    high: Real = 10.0

    def __post_init__(self) -> None:
        _check_range(self.low, self.high)

    def __call__(self, key: Array, order: int) -> Lags:
        """Lags of one plant."""
        return jnp.exp(uniform(key, (order,), math.log(self.low), math.log(self.high)))


@dataclasses.dataclass(frozen=True)
class LagAndRatio:
    """A dominant lag, uniform between `low` and `high`, and shorter ones.

    Each shorter lag is the one before times a ratio, uniform between `least` and `most`: plants as
    in studies of two lags (experiments/benchmarks), from nearly first order to nearly equal lags.
    """

    low: Real = 3.0
    high: Real = 9.0
    least: Real = 0.1
    most: Real = 1.0

    def __post_init__(self) -> None:
        _check_range(self.low, self.high)
        _check_range(self.least, self.most)

    def __call__(self, key: Array, order: int) -> Lags:
        """Lags of one plant, largest first."""
        first, others = jax.random.split(key)
        lag = uniform(first, (1,), self.low, self.high)
        ratios = uniform(others, (order - 1,), self.least, self.most)
        return jnp.cumprod(jnp.concatenate([lag, ratios]))


def uniform(key: Array, shape: tuple[int, ...], low: Real, high: Real) -> Array:
    """Uniform numbers, drawn in single precision: a study has the same plants in both."""
    share = jax.random.uniform(key, shape, jnp.float32).astype(float)
    return low + (high - low) * share


Distribution = Callable[[Array, int], Lags]
"""The lags of one plant from a key and an order; a function of one's own may stand here too."""


def _check_range(low: Real, high: Real) -> None:
    if not 0 < low <= high < math.inf:
        raise ValueError(f"A range of lags or ratios needs 0 < low <= high, got {low} and {high}.")


def check_order(order: Any) -> int:
    """`order`, or a `ValueError`."""
    if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= MAX_ORDER:
        raise ValueError(f"The order of a plant must be from 1 to {MAX_ORDER}, got {order!r}.")
    return order


def random_plants(
    key: Array, count: Any, order: Any, distribution: Distribution = UniformLags()
) -> PTn:
    r"""Random plants $\prod_k 1/(1 + s T_k)$: a batch of `PTn`, every leaf with a leading axis.

    **Arguments:** `key`: of JAX, `jax.random.key(0)`. `count`: how many. `order`: number of lags,
    1 to 8. `distribution`: `UniformLags(1, 9)` is Murray's (2016); `LogUniformLags` and
    `LagAndRatio` are others, and any function of (key, order) that gives the lags of one plant,
    with JAX, is one too. Lags in units of time.

    **Returns:** plants of gain 1 without dead time; `.lags` has shape (count, order). Plant k
    depends on (key, k) alone: the first plants are the same however many are drawn.
    """
    order = check_order(order)
    if isinstance(count, bool) or not isinstance(count, int) or count < 0:
        raise ValueError(f"count must be a whole number of plants, got {count!r}.")
    lags = jax.vmap(lambda k: plant_lags(key, k, order, distribution))(jnp.arange(count))
    zero = jnp.zeros(count, lags.dtype)
    return PTn(lags=lags, gain=zero + 1, offset=zero, delay=zero)


def plant_lags(key: Array, place: Array | int, order: int, distribution: Distribution) -> Lags:
    """Lags of plant number `place`."""
    return distribution(jax.random.fold_in(key, place), order)


def settling_time(lags: Lags, rest: float = REST) -> Scalar:
    """Time at which the step response of a chain has come within `rest` of its end.

    It lies beyond the sum of the lags, the mean delay, and before ln(1/rest) times that, where a
    single lag has it. -ln(1 - g) is nearly straight there.
    """
    total = jnp.sum(lags)
    plant = PTn(lags=lags / total)
    eps = jnp.finfo(total.dtype).eps

    def left(log_t: Array) -> tuple[Array, Array]:
        t = jnp.exp(log_t)
        g, change = jax.jvp(plant.unit_response, (t,), (t,))
        below = jnp.maximum(1 - g, eps)
        return math.log(rest) - jnp.log(below), change / below

    lower = jnp.zeros_like(total)
    upper = lower + math.log(1.1 * math.log(1 / rest))
    return total * jnp.exp(increasing_root(left, lower, upper, 0.5 * (lower + upper)))
