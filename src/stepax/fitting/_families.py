"""Families of plants in a fit: what each of them knows of its coordinates, ends and kinks.

A family's own parameters map one to one to coordinates (`_coordinates`); fixing a parameter removes
its coordinate.
"""

import abc
import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arrays import Coordinates, Scalar
from .._status import Status
from ..models._abstract import AbstractPlant
from ..models._plants import FOPDT, IPDT, SOPDT, EqualLag, PTn, SOPDTZero
from ..models._spread import AbstractSpreadChain, chain_of_ratio
from ._coordinates import (
    APART,
    CONTRAST,
    LAG,
    LEAD,
    LOG_DAMPING,
    LOG_ORDER,
    LOG_TIME,
    LONGEST_LAG,
    OtherStart,
    decode_lag,
    decode_ratio,
    decode_second_order,
    encode_lag,
    encode_ratio,
    encode_second_order,
    half_interval,
)


SPREADS = 33
"""Contrasts between which the one of another order is interpolated: near enough for a start."""


class AbstractFamily(eqx.Module):
    """How one family of plants is refined, around one of its models.

    Times are measured in a `unit`, the length of the record. What is not a coordinate, the order of
    a chain, is taken from the model.
    """

    model: eqx.AbstractVar[Any]

    shape_name: ClassVar[str | None] = None
    """The parameter that another start changes; where it is fixed there is none."""

    @property
    @abc.abstractmethod
    def names(self) -> tuple[str, ...]:
        """Parameter behind each coordinate; `lags` stands behind several."""

    @property
    @abc.abstractmethod
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Range of each coordinate."""

    @property
    @abc.abstractmethod
    def scaling(self) -> tuple[bool, ...]:
        """Which coordinate is the logarithm of the unit of time: it stretches the response."""

    @abc.abstractmethod
    def encode(self, unit: Scalar) -> Array:
        """Coordinates of the model."""

    @abc.abstractmethod
    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """Own parameters at coordinates.

        At the end of a contrast the slope of r is infinite: what comes out stays a rounding error
        inside unless `exact`.
        """

    @property
    def kinked(self) -> bool:
        """Whether the slope of the response jumps where the dead time ends."""
        return False

    @property
    def individual(self) -> bool:
        """Whether the coordinates are lags, of which any can meet."""
        return False

    @property
    def absent(self) -> Array | np.ndarray:
        """Which coordinates belong to lags of 0: those do not vary. Constant where none can."""
        return np.zeros(len(self.names), bool)

    def end_status(self, name: str, coordinate: Scalar) -> Status:
        """What it means that the coordinate of a parameter lies on a bound."""
        del name, coordinate
        return Status.at_bound

    def vague_beyond(self, name: str, value: Array) -> Any:
        """Half width of an interval of a parameter that says next to nothing.

        What is positive by nature, and a gain, should differ from 0.
        """
        del name
        return jnp.abs(value)

    def other_start(self, x: list[Array], unit: Scalar, interval: Scalar) -> OtherStart | None:
        """Where else to search from an optimum x; `interval` is that between samples.

        None for families whose loss has one optimum, but for kinks.
        """
        del x, unit, interval
        return None

    def with_order(self, n: Array) -> AbstractPlant | None:
        """A chain of another order that responds alike; None without n."""
        del n
        return None


def family_of(model: AbstractPlant) -> AbstractFamily:
    """The family of a model: the one place where its class is asked for."""
    if isinstance(model, AbstractSpreadChain):
        return SpreadFamily(model)
    if isinstance(model, FOPDT):
        return FirstOrderFamily(model)
    if isinstance(model, EqualLag):
        return WholeOrderFamily(model) if model.is_whole else RealOrderFamily(model)
    if isinstance(model, SOPDT):
        return SecondOrderFamily(model)
    if isinstance(model, PTn):
        return IndividualFamily(model)
    if isinstance(model, SOPDTZero):
        return ZeroFamily(model)
    if isinstance(model, IPDT):
        return IntegratingFamily(model)
    raise TypeError(f"refine needs a stepax model, got {type(model).__name__}.")


# The families


class SpreadFamily(AbstractFamily):
    """Hudzovic's and Sani's chains: ln of the sum of the lags, and the contrast of the rates."""

    model: AbstractSpreadChain
    shape_name: ClassVar[str | None] = "r"
    names: ClassVar[Any] = ("T", "r")
    bounds: ClassVar[Any] = (LOG_TIME, CONTRAST)
    scaling: ClassVar[Any] = (True, False)

    def encode(self, unit: Scalar) -> Array:
        """ln of the sum of the lags, and the contrast."""
        return jnp.stack([jnp.log(jnp.sum(self.model.lags) / unit), encode_ratio(self.model.ratio)])

    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """T and r."""
        s = decode_ratio(x[1], exact)
        if not self.model.reaches_first_order:
            s = jnp.where(x[1] >= 1, decode_ratio(x[1], False), s)
        chain = chain_of_ratio(type(self.model), s, self.model.n)
        return {"T": chain.T * unit * jnp.exp(x[0]), "r": chain.r}

    def end_status(self, name: str, coordinate: Scalar) -> Status:
        """Of r: equal lags, or one lag where the family has that."""
        if name != "r":
            return Status.at_bound
        first = Status.at_first_order if self.model.reaches_first_order else Status.at_bound
        return Status.where(coordinate <= 0, Status.at_equal_lags, first)

    def vague_beyond(self, name: str, value: Array) -> Any:
        """Half of the range of r."""
        return 0.5 * self.model.width_of_r(self.model.n) if name == "r" else jnp.abs(value)

    def other_start(self, x: list[Array], unit: Scalar, interval: Scalar) -> OtherStart:
        """The last lag, as if the chain had two, for dead time."""
        total, s = unit * jnp.exp(x[0]), decode_ratio(x[1])
        short = [x[0], encode_ratio(interval / 2 / total)]
        lags = jnp.sort(chain_of_ratio(type(self.model), s, self.model.n).lags)
        second = total * lags[-2] if lags.size > 1 else jnp.zeros_like(total)
        return half_interval(short, s * total, interval, second)

    def with_order(self, n: Array) -> AbstractPlant:
        """The same sum of lags and of their squares, or as near to that as the order allows."""
        lags = self.model.lags
        spread = jnp.sum(lags**2) / jnp.sum(lags) ** 2
        x = jnp.asarray(np.linspace(0, 1, SPREADS), spread.dtype)
        chain = jax.vmap(lambda x: chain_of_ratio(type(self.model), decode_ratio(x), n).lags)
        s = decode_ratio(jnp.interp(spread, jnp.sum(chain(x) ** 2, axis=1), x))
        other = chain_of_ratio(type(self.model), s, n)
        return dataclasses.replace(self.model, T=other.T * jnp.sum(lags), r=other.r, n=n)


class FirstOrderFamily(AbstractFamily):
    """One lag: ln T."""

    model: FOPDT
    names: ClassVar[Any] = ("T",)
    bounds: ClassVar[Any] = (LOG_TIME,)
    scaling: ClassVar[Any] = (True,)
    kinked: ClassVar[Any] = True

    def encode(self, unit: Scalar) -> Array:
        """ln T."""
        return encode_lag(self.model.T, unit)

    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """T."""
        return decode_lag(x, unit)


class WholeOrderFamily(AbstractFamily):
    """Equal lags whose number is given: ln T."""

    model: EqualLag
    names: ClassVar[Any] = ("T",)
    bounds: ClassVar[Any] = (LOG_TIME,)
    scaling: ClassVar[Any] = (True,)

    def encode(self, unit: Scalar) -> Array:
        """ln T."""
        return encode_lag(self.model.T, unit)

    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """T."""
        return decode_lag(x, unit)

    def with_order(self, n: Array) -> AbstractPlant:
        """The same sum of lags."""
        return dataclasses.replace(self.model, T=self.model.T * self.model.n / n, n=n)


class RealOrderFamily(AbstractFamily):
    """Equal lags whose number is sought: ln nT, and ln n."""

    model: EqualLag
    names: ClassVar[Any] = ("T", "n")
    bounds: ClassVar[Any] = (LOG_TIME, LOG_ORDER)
    scaling: ClassVar[Any] = (True, False)

    def encode(self, unit: Scalar) -> Array:
        """ln nT and ln n."""
        n = self.model.n
        return jnp.stack([jnp.log(self.model.T * n / unit), jnp.log(n)])  # pyright: ignore[reportArgumentType]

    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """T and n."""
        return {"T": unit * jnp.exp(x[0] - x[1]), "n": jnp.exp(x[1])}


class SecondOrderFamily(AbstractFamily):
    r"""Two poles: $\ln(1 + 1/\zeta^2)$, and $\ln\sqrt{1 + 4\zeta^2}/\omega_n$.

    The second is the period where the plant oscillates and the sum of its lags where it creeps.
    """

    model: SOPDT
    shape_name: ClassVar[str | None] = "zeta"
    names: ClassVar[Any] = ("zeta", "omega_n")
    bounds: ClassVar[Any] = (LOG_DAMPING, LOG_TIME)
    scaling: ClassVar[Any] = (False, True)

    def encode(self, unit: Scalar) -> Array:
        """Damping and period."""
        return encode_second_order(self.model.zeta, self.model.omega_n, unit)

    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """zeta and omega_n."""
        return decode_second_order(x, unit)

    def other_start(self, x: list[Array], unit: Scalar, interval: Scalar) -> OtherStart:
        """Lags of ratio s have 1/zeta^2 = 4 s/(1 + s)^2; all that oscillates counts as s = 1."""
        total = unit * jnp.exp(x[1])
        square = jnp.minimum(jnp.expm1(x[0]), 1)
        lag = square / (1 + jnp.sqrt(1 - square)) ** 2 * total
        s = interval / 2 / total
        return half_interval([jnp.log1p(4 * s / (1 + s) ** 2), x[1]], lag, interval)


class ZeroFamily(AbstractFamily):
    """Two poles and a zero: damping and period as without it, and lead over that period."""

    model: SOPDTZero
    shape_name: ClassVar[str | None] = "lead"
    names: ClassVar[Any] = ("zeta", "omega_n", "lead")
    bounds: ClassVar[Any] = (LOG_DAMPING, LOG_TIME, LEAD)
    scaling: ClassVar[Any] = (False, True, False)
    kinked: ClassVar[Any] = True

    def encode(self, unit: Scalar) -> Array:
        """Damping, period, and lead over the period."""
        both = encode_second_order(self.model.zeta, self.model.omega_n, unit)
        return jnp.append(both, self.model.lead / unit * jnp.exp(-both[1]))

    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """zeta, omega_n and lead."""
        return decode_second_order(x, unit) | {"lead": x[2] * unit * jnp.exp(x[1])}

    def vague_beyond(self, name: str, value: Array) -> Any:
        """A lead may be 0: no zero is knowledge too."""
        return jnp.inf if name == "lead" else jnp.abs(value)

    def other_start(self, x: list[Array], unit: Scalar, interval: Scalar) -> OtherStart:
        """The lead with the other sign: 1 + s lead and the dead time can trade places.

        1 - s lead with a dead time later by twice the lead has the same mean delay.
        """
        lead = x[2] * unit * jnp.exp(x[1])
        return OtherStart([x[0], x[1], -x[2]], -2 * lead, jnp.array(True))


class IntegratingFamily(AbstractFamily):
    """An integrator with a lag: T itself, over the length of the record, since it may be 0."""

    model: IPDT
    shape_name: ClassVar[str | None] = "T"
    names: ClassVar[Any] = ("T",)
    bounds: ClassVar[Any] = ((0.0, LONGEST_LAG),)
    scaling: ClassVar[Any] = (False,)

    def encode(self, unit: Scalar) -> Array:
        """T."""
        return jnp.reshape(self.model.T / unit, (1,))

    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """T."""
        return {"T": x[0] * unit}

    def vague_beyond(self, name: str, value: Array) -> Any:
        """A lag may be 0."""
        return jnp.inf if name == "T" else jnp.abs(value)

    def other_start(self, x: list[Array], unit: Scalar, interval: Scalar) -> OtherStart:
        """The lag for dead time."""
        return half_interval([interval / 2 / unit], x[0] * unit, interval)


class IndividualFamily(AbstractFamily):
    """Individual lags: themselves, over their sum at the start, largest first."""

    model: PTn
    shape_name: ClassVar[str | None] = "lags"
    individual: ClassVar[Any] = True

    @property
    def names(self) -> tuple[str, ...]:
        """`lags` for each."""
        return ("lags",) * self.model.lags.shape[0]

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """The same range for each."""
        return (LAG,) * self.model.lags.shape[0]

    @property
    def scaling(self) -> tuple[bool, ...]:
        """None alone stretches the response."""
        return (False,) * self.model.lags.shape[0]

    @property
    def kinked(self) -> bool:
        """Where there is but one lag."""
        return self.model.lags.shape == (1,)

    @property
    def sum_at_start(self) -> Array:
        """Unit of the coordinates."""
        return jax.lax.stop_gradient(jnp.sum(self.model.lags))

    @property
    def absent(self) -> Array:
        """A lag of 0 at the start, where they stand largest first, is none and stays none."""
        return ~(-jnp.sort(-self.model.lags) > 0)

    def encode(self, unit: Scalar) -> Array:
        """Lags largest first; equal ones a little apart, where a fit can part them."""
        lags = -jnp.sort(-self.model.lags)
        apart = 1 + APART * jnp.linspace(1, -1, lags.size, dtype=lags.dtype)
        return lags / self.sum_at_start * (apart if lags.size > 1 else 1)

    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """The lags."""
        row = jnp.stack(list(x))
        return {"lags": row * self.sum_at_start.astype(row.dtype)}

    def other_start(self, x: list[Array], unit: Scalar, interval: Scalar) -> OtherStart | None:
        """The shortest lag that is one."""
        if len(x) == 1:
            return None
        row = jnp.stack(x)
        place = jnp.argmin(jnp.where(self.absent, jnp.inf, row))
        total = self.sum_at_start.astype(row.dtype)
        short = list(row.at[place].set(interval / 2 / total))
        return half_interval(short, row[place] * total, interval)
