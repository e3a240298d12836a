"""What is known of parameters beforehand, each up to a standard deviation."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._arrays import Scalar
from ..models._abstract import AbstractPlant


class Prior(eqx.Module):
    r"""Normal distributions of some parameters, independent of each other and of the noise.

    The loss gains $\sigma^2 \sum_j ((p_j - \mu_j)/s_j)^2$: each parameter counts as one more row,
    with the noise of the record, $\sigma$. `noise` is over the range of the output.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    value: Float[Array, " priors"]
    std: Float[Array, " priors"]
    noise: Scalar

    def distances(self, plant: AbstractPlant) -> Float[Array, " priors"]:
        """How many standard deviations the parameters of a plant lie off."""
        numbers = [getattr(plant, name) for name in self.names]
        return (jnp.stack(numbers) - self.value) / self.std

    def rows(self, plant: AbstractPlant) -> Float[Array, " priors"]:
        """What is added to the residuals."""
        return self.noise * self.distances(plant)


def checked_pairs(prior: Any, dtype) -> dict[str, tuple[Array, Array]]:
    """Value and standard deviation by name; a sentence for what cannot be a prior."""
    if not isinstance(prior, Mapping):
        raise TypeError('prior must name parameters, such as prior={"gain": (2.0, 0.1)}.')
    return {name: _checked(name, pair, dtype) for name, pair in prior.items()}


def _checked(name: str, pair: Any, dtype) -> tuple[Array, Array]:
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise TypeError(
            f"The prior of {name!r} must be a pair, value and standard deviation, got {pair!r}."
        )
    if not any(isinstance(x, Tracer) for x in pair):
        value, std = (float(x) for x in pair)
        if not (np.isfinite(value) and 0 < std < np.inf):
            raise ValueError(
                f"The prior of {name!r} needs a finite value and a positive standard deviation,"
                f" got {pair!r}."
            )
    return jnp.asarray(pair[0], dtype), jnp.asarray(pair[1], dtype)


def prior_of(prior: Any, model: AbstractPlant, free: Sequence[str], dtype) -> Prior | None:
    """The prior of a model, of which `free` are to be found; without noise it counts nothing yet.

    None where there is none.
    """
    if not prior:
        return None
    pairs = checked_pairs(prior, dtype)
    for name in pairs:
        if name not in model.parameter_names:
            known = ", ".join(model.parameter_names)
            what = type(model).__name__
            raise ValueError(f"{what} has no parameter {name!r} for a prior; it has {known}.")
        if name not in free:
            raise ValueError(
                f"A prior of {name!r} says nothing here: it is fixed, told by known levels, or"
                " no single number."
            )
    value, std = (jnp.stack([pair[i] for pair in pairs.values()]) for i in (0, 1))
    return Prior(tuple(pairs), value, std, jnp.zeros((), dtype))
