r"""Families of plants in a fit: bounded coordinates, of order one, regular at their bounds.

A family's own parameters map one to one to coordinates; fixing a parameter removes its coordinate.

How far two lags lie apart, s = T_2/T_1 in [0, 1], enters a response as an even function of ln s.
Its coordinate is the square of the contrast, $e = ((1 - s)/(1 + s))^2$: the response has a finite
slope in it that is not 0 at equal lags (e = 0) and at a single lag (e = 1). For a chain, s is the
ratio of the extreme rates; for two lags of damping $\zeta$, $1 - e = 1/\zeta^2$. Individual lags,
where any of them can meet, are their own coordinates: the response is a symmetric function of them.
"""

import abc
import dataclasses
import math
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._arrays import Coordinates, Scalar
from .._status import Status
from ..models._abstract import AbstractPlant, AbstractSpreadChain
from ..models._plants import FOPDT, SOPDT, EqualLag, PTn
from ..models._responses import MAX_REAL_ORDER
from ..models._spread import chain_of_ratio


LOG_TIME = (math.log(1e-6), math.log(1e3))
"""Bounds of a time constant, relative to the length of the record."""
CONTRAST = (0.0, 1.0)
LAG = (0.0, 1e4)
"""Bounds of a lag, relative to the sum of the lags at the start."""
APART = 0.01
"""Least relative distance of two lags at the start: at one place the fit could not part them."""
LOG_ORDER = (math.log(0.3), math.log(MAX_REAL_ORDER))
LOG_DAMPING = (math.log1p(200.0**-2), math.log1p(0.005**-2))
"""Bounds of $\\ln(1 + 1/\\zeta^2)$: damping from 200 down to 0.005."""


class AbstractFamily(eqx.Module):
    """How one family of plants is refined, around one of its models.

    Times are measured in a `unit`, the length of the record. What is not a coordinate, the order of
    a chain, is taken from the model.
    """

    model: eqx.AbstractVar[Any]

    shape_name: ClassVar[str | None] = None
    """The parameter that tells how far the lags lie apart, where there is one."""

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
    def absent(self) -> Array:
        """Which coordinates belong to lags of 0: those do not vary."""
        return jnp.zeros(len(self.names), bool)

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

    def shortened(
        self, x: list[Array], unit: Scalar, lag: Scalar
    ) -> tuple[list[Array], Scalar] | None:
        """Coordinates with the second lag, or the shortest of several, set to `lag`; what it was.

        None for families that have but one.
        """
        del x, unit, lag
        return None

    def with_order(self, n: Array) -> AbstractPlant | None:
        """A chain of another order with the same sum of lags and ratio of rates; None without n."""
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
    raise TypeError(f"refine needs a stepax model, got {type(model).__name__}.")


# The contrast of two lags


def _inside(dtype) -> tuple[float, float]:
    """Distances of a contrast from its ends: at equal lags, and at a single lag.

    At equal lags s differs from 1 by the root of it, eps^(1/3): there the response still changes by
    more than rounding. `tests/fitting` compares gradients at both ends with differences.
    """
    eps = float(jnp.finfo(dtype).eps)
    return eps ** (2 / 3), eps**0.5


def _encode_ratio(s) -> Array:
    near, far = _inside(s.dtype)
    contrast = (1 - s) / (1 + s)
    return jnp.clip((contrast**2 - near) / (1 - near - far), 0, 1)


def _decode_ratio(x, exact: bool = False) -> Array:
    """Ratio s of two lags or rates at a coordinate; exactly 1 or 0 at its ends, if so wished."""
    near, far = _inside(x.dtype)
    contrast = jnp.sqrt(near + (1 - near - far) * x)
    s = (1 - contrast) / (1 + contrast)
    return jnp.where(x <= 0, 1, jnp.where(x >= 1, 0, s)) if exact else s


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
        return jnp.stack(
            [jnp.log(jnp.sum(self.model.lags) / unit), _encode_ratio(self.model.ratio)]
        )

    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """T and r."""
        s = _decode_ratio(x[1], exact)
        if not self.model.reaches_first_order:
            s = jnp.where(x[1] >= 1, _decode_ratio(x[1], False), s)
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

    def shortened(self, x: list[Array], unit: Scalar, lag: Scalar) -> tuple[list[Array], Scalar]:
        """The last lag as if the chain had two."""
        total = unit * jnp.exp(x[0])
        return [x[0], _encode_ratio(lag / total)], _decode_ratio(x[1]) * total

    def with_order(self, n: Array) -> AbstractPlant:
        """The same sum of lags and ratio."""
        other = SpreadFamily(dataclasses.replace(self.model, n=n))
        unit = jnp.ones_like(self.model.T)
        return dataclasses.replace(other.model, **other.decode(self.encode(unit), unit, False))


class FirstOrderFamily(AbstractFamily):
    """One lag: ln T."""

    model: FOPDT
    names: ClassVar[Any] = ("T",)
    bounds: ClassVar[Any] = (LOG_TIME,)
    scaling: ClassVar[Any] = (True,)
    kinked: ClassVar[Any] = True

    def encode(self, unit: Scalar) -> Array:
        """ln T."""
        return jnp.log(jnp.reshape(self.model.T / unit, (1,)))

    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """T."""
        return {"T": unit * jnp.exp(x[0])}


class WholeOrderFamily(AbstractFamily):
    """Equal lags whose number is given: ln T."""

    model: EqualLag
    names: ClassVar[Any] = ("T",)
    bounds: ClassVar[Any] = (LOG_TIME,)
    scaling: ClassVar[Any] = (True,)

    def encode(self, unit: Scalar) -> Array:
        """ln T."""
        return jnp.log(jnp.reshape(self.model.T / unit, (1,)))

    def decode(self, x: Coordinates, unit: Scalar, exact: bool) -> dict[str, Array]:
        """T."""
        return {"T": unit * jnp.exp(x[0])}

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

    def shortened(self, x: list[Array], unit: Scalar, lag: Scalar) -> tuple[list[Array], Scalar]:
        """Lags of ratio s have 1/zeta^2 = 4 s/(1 + s)^2; all that oscillates counts as s = 1."""
        total = unit * jnp.exp(x[1])
        square = jnp.minimum(jnp.expm1(x[0]), 1)
        before = square / (1 + jnp.sqrt(1 - square)) ** 2 * total
        s = lag / total
        return [jnp.log1p(4 * s / (1 + s) ** 2), x[1]], before


def encode_second_order(zeta: Scalar, omega_n: Scalar, unit: Scalar) -> Array:
    """Coordinates of damping and period."""
    period = jnp.log1p(4 * zeta**2) / 2 - jnp.log(omega_n * unit)
    return jnp.stack([jnp.log1p(zeta**-2), period])


def decode_second_order(x: Coordinates, unit: Scalar) -> dict[str, Array]:
    """zeta and omega_n at coordinates."""
    zeta = 1 / jnp.sqrt(jnp.expm1(x[0]))
    return {"zeta": zeta, "omega_n": jnp.sqrt(1 + 4 * zeta**2) * jnp.exp(-x[1]) / unit}


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

    def shortened(
        self, x: list[Array], unit: Scalar, lag: Scalar
    ) -> tuple[list[Array], Scalar] | None:
        """The shortest lag that is one."""
        if len(x) == 1:
            return None
        row = jnp.stack(x)
        place = jnp.argmin(jnp.where(self.absent, jnp.inf, row))
        total = self.sum_at_start.astype(row.dtype)
        return list(row.at[place].set(lag / total)), row[place] * total
