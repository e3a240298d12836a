"""Noise of a simulated record: small objects that compose with +.

Each takes and gives the relative response of a record, 0 before the step and 1 in the end; sizes
are shares of the change. They act in the order in which they are added: quantisation, which rounds
what comes before it, stands last.
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arrays import Samples


Response = Callable[[Samples, Samples], Samples]
"""Response of the plant to a sampled input: of times, and the input."""


# Drawn in single precision, so that a study has the same noise in both.


def _normal(key: Array, like: Array) -> Array:
    return jax.random.normal(key, like.shape, jnp.float32).astype(like.dtype)


def _uniform(key: Array, like: Array) -> Array:
    return jax.random.uniform(key, like.shape, jnp.float32).astype(like.dtype)


class AbstractNoise(eqx.Module):
    """Something that disturbs a record."""

    level: eqx.AbstractVar[Any]
    """Its size, the number by which a study's table calls it."""

    @abc.abstractmethod
    def disturb(self, key: Array, t: Samples, y: Samples, respond: Response) -> Samples:
        """The relative response `y` at times `t`, disturbed."""

    def __add__(self, other: "AbstractNoise") -> "AbstractNoise":
        if not isinstance(other, AbstractNoise):
            return NotImplemented
        return Together((*_parts(self), *_parts(other)), self.level)


class Together(AbstractNoise):
    """Several, one after the other, each with a key of its own; its level is that of the first."""

    parts: tuple[AbstractNoise, ...]
    level: Any

    def disturb(self, key: Array, t: Samples, y: Samples, respond: Response) -> Samples:
        """All of them."""
        for place, part in enumerate(self.parts):
            y = part.disturb(jax.random.fold_in(key, place), t, y, respond)
        return y


def _parts(noise: AbstractNoise) -> tuple[AbstractNoise, ...]:
    return noise.parts if isinstance(noise, Together) else (noise,)


class GaussianNoise(AbstractNoise):
    """White and normal, with standard deviation `level`."""

    level: Any = eqx.field(converter=float)

    def disturb(self, key: Array, t: Samples, y: Samples, respond: Response) -> Samples:
        """One draw a sample."""
        return y + self.level * _normal(key, y)


class UniformNoise(AbstractNoise):
    """White and uniform, `level` from peak to peak, as Murray's (2016): sigma = level/sqrt(12)."""

    level: Any = eqx.field(converter=float)

    def disturb(self, key: Array, t: Samples, y: Samples, respond: Response) -> Samples:
        """One draw a sample."""
        return y + self.level * (_uniform(key, y) - 0.5)


class AR1Noise(AbstractNoise):
    """Coloured: e_k = c e_(k-1) + sqrt(1 - c^2) w_k, stationary, with standard deviation `level`.

    `correlation` c, from sample to sample, lies in [0, 1).
    """

    level: Any = eqx.field(converter=float)
    correlation: Any = eqx.field(converter=float, default=0.9)

    def disturb(self, key: Array, t: Samples, y: Samples, respond: Response) -> Samples:
        """A stationary draw."""
        white = _normal(key, y)
        share = jnp.sqrt(1 - jnp.square(self.correlation))

        def one(before: Array, new: Array):
            now = self.correlation * before + share * new
            return now, now

        _, noise = jax.lax.scan(one, white[0], white[1:])
        return y + self.level * jnp.append(white[:1], noise)


class InputNoise(AbstractNoise):
    """White noise on the input, held from sample to sample, that reaches the output by the plant.

    `level`: its standard deviation, a share of the step.
    """

    level: Any = eqx.field(converter=float)

    def disturb(self, key: Array, t: Samples, y: Samples, respond: Response) -> Samples:
        """The plant's response to it."""
        return y + self.level * respond(t, _normal(key, y))


class Drift(AbstractNoise):
    """A straight line from 0 at the step to an end uniform in +-`level` at the end of a record."""

    level: Any = eqx.field(converter=float)

    def disturb(self, key: Array, t: Samples, y: Samples, respond: Response) -> Samples:
        """One end a record."""
        end = 2 * _uniform(key, y[0]) - 1
        return y + self.level * end * t / t[-1]


class Glitches(AbstractNoise):
    """Single samples that are off by `level` in either direction, each with chance `share`."""

    level: Any = eqx.field(converter=float)
    share: Any = eqx.field(converter=float, default=0.01)

    def disturb(self, key: Array, t: Samples, y: Samples, respond: Response) -> Samples:
        """Some samples."""
        where, sign = jax.random.split(key)
        off = _uniform(where, y) < self.share
        up = jax.random.bernoulli(sign, 0.5, y.shape)
        return y + jnp.where(off, jnp.where(up, self.level, -self.level), 0)


class Quantisation(AbstractNoise):
    """Rounded to whole multiples of `level`; 0 leaves the record as it is."""

    level: Any = eqx.field(converter=float)

    def disturb(self, key: Array, t: Samples, y: Samples, respond: Response) -> Samples:
        """No draw: the same record is rounded the same way."""
        step = jnp.where(self.level > 0, self.level, 1)
        return jnp.where(self.level > 0, jnp.round(y / step) * step, y)


def as_noise(entry: Any) -> AbstractNoise:
    """A noise model as it is; a number is the standard deviation of white Gaussian noise."""
    if isinstance(entry, AbstractNoise):
        return entry
    if isinstance(entry, bool) or not isinstance(entry, int | float):
        raise TypeError(f"noise must hold numbers or noise models, got {entry!r}.")
    return GaussianNoise(float(entry))


def shape_of(noise: AbstractNoise) -> str:
    """Names of what a noise model is made of, without its numbers."""
    return " + ".join(type(part).__name__ for part in _parts(noise))


class NoiseTable(eqx.Module):
    """All noise of a study, one entry a level: the models of one make with stacked numbers."""

    makes: tuple[AbstractNoise, ...]
    make: np.ndarray
    place: np.ndarray

    def disturb(
        self, entry: Array, key: Array, t: Samples, y: Samples, respond: Response
    ) -> Samples:
        """The relative response with the noise of one entry of the table."""
        found = y
        for number, stacked in enumerate(self.makes):
            place = jnp.asarray(self.place)[entry]
            one = jax.tree.map(lambda x, p=place: jnp.asarray(x, y.dtype)[p], stacked)
            disturbed = one.disturb(key, t, y, respond)
            found = jnp.where(jnp.asarray(self.make)[entry] == number, disturbed, found)
        return found


def noise_table(noise: tuple[AbstractNoise, ...]) -> NoiseTable:
    """The table of a study's noise models."""
    groups: dict[Any, list[AbstractNoise]] = {}
    make, place = [], []
    for model in noise:
        form = jax.tree.structure(model)
        group = groups.setdefault(form, [])
        make.append(list(groups).index(form))
        place.append(len(group))
        group.append(model)
    # an entry of another make takes numbers of this one, which are not used
    longest = max(len(group) for group in groups.values())
    stacked = [
        jax.tree.map(
            lambda *x: np.array(x),
            *(group + [group[-1]] * (longest - len(group))),
        )
        for group in groups.values()
    ]
    return NoiseTable(tuple(stacked), np.array(make), np.array(place))
