"""What a plant is: parameters, responses, and the facts that other rooms ask it for.

Plants are frozen `equinox.Module`s: PyTrees that can be arguments of a jitted function, stacked
along a batch axis, and differentiated with `equinox.filter_grad`. Whatever depends on the family of
a plant is asked of the plant, never decided by its class elsewhere.
"""

import abc
import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Complex, Float, Shaped

from .._arrays import Flag, Lags, Samples, Scalar, as_real
from ._contour import Slopes, chain_response
from ._export import control_transfer_function, scipy_transfer_function
from ._motions import chain_motions
from ._realisation import AbstractRealisation, ChainRealisation
from ._respond import respond


class ScalarParameter(NamedTuple):
    """One real number of a model: a parameter by name, or one of several in a row of them."""

    name: str
    place: int | None = None

    @property
    def label(self) -> str:
        """`T`, or `lags[2]`."""
        return self.name if self.place is None else f"{self.name}[{self.place}]"


class Factor(NamedTuple):
    """A polynomial in s, by ascending coefficients, to a power."""

    coefficients: tuple[float, ...]
    power: float = 1.0


class TimeScales(NamedTuple):
    """Of a transient: its fastest part, the widest step that follows it, and when it is over.

    Over means below rounding: e^-40 is 4e-18.
    """

    fastest: float
    widest: float
    horizon: float


SETTLED = 0.95
"""Share of the change that a record must show for its gain not to count as extrapolated."""


COMMON = ("gain", "offset", "delay")
"""Parameters that every plant has; they come after its own."""

# Dimension of a parameter, as metadata of its field; without it none, as of a damping.
TIME = {"dimension": "time"}
RATE = {"dimension": "per time"}
OUTPUT = {"dimension": "output"}
GAIN = {"dimension": "output/input"}
SLOPE = {"dimension": "output/(input time)"}


class AbstractPlant(eqx.Module):
    r"""Process model: $\text{offset} + \text{gain} \cdot g(t - \text{delay})$ for a unit step.

    g rises from 0 to 1, monotone unless the model oscillates or has a zero; that of an integrator
    ends as a ramp. Up to the delay the response is the
    offset. `gain` is output per unit of input, `delay` (dead time, >= 0) has the unit of time,
    `offset` the unit of the output; impulse and frequency response, static gain and exports leave
    the offset out.
    """

    gain: Float[Array, "..."] = eqx.field(
        converter=as_real, default=1.0, kw_only=True, metadata=GAIN
    )
    offset: Float[Array, "..."] = eqx.field(
        converter=as_real, default=0.0, kw_only=True, metadata=OUTPUT
    )
    delay: Float[Array, "..."] = eqx.field(
        converter=as_real, default=0.0, kw_only=True, metadata=TIME
    )

    # Facts of a class are not annotated: an annotation would make them fields.
    settles = True
    """Whether the response to a step comes to rest."""

    @abc.abstractmethod
    def own_in_range(self) -> Any:
        """Whether its own parameters lie in the range of the family."""

    @abc.abstractmethod
    def own_to_free(self) -> dict[str, Array]:
        """Its own real parameters as numbers without bounds (`_free`), by name."""

    @abc.abstractmethod
    def own_from_free(self) -> dict[str, Array]:
        """Its own parameters, where it holds numbers without bounds in their place."""

    @property
    def admissible(self) -> Flag:
        """Whether own parameters and dead time lie in their range: else every response is NaN."""
        return (self.delay >= 0) & self.own_in_range()

    @property
    def checked_gain(self) -> Array:
        """The gain of one plant, NaN outside the range of its parameters."""
        for name in self.parameter_names:
            if jnp.ndim(getattr(self, name)) != (name == "lags"):
                raise ValueError(
                    f"{type(self).__name__} is one plant, and its {name} has the shape"
                    f" {jnp.shape(getattr(self, name))}; for several plants use jax.vmap."
                )
        return jnp.where(self.admissible, self.gain, jnp.nan)

    @abc.abstractmethod
    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t): step response for gain 1, offset 0, delay 0."""

    def slopes(self, t: Samples, changes: Sequence[dict[str, Array]]) -> Slopes:
        """g(t), its slope in time, and its change along each of some directions.

        `changes`: own parameters that move, by name, and how fast. A plant whose response and
        slopes share something expensive has a rule of its own.
        """
        slope = jax.jvp(self.unit_response, (t,), (jnp.ones_like(t),))[1]
        moved = []
        for change in changes:

            def response(values: dict[str, Array]) -> Samples:
                return dataclasses.replace(self, **values).unit_response(t)

            now = {name: getattr(self, name) for name in change}
            # apart from what comes before: shared, XLA would break one pass into many
            now = jax.lax.optimization_barrier(now)
            moved.append(jax.jvp(response, (now,), (change,))[1])
        return Slopes(self.unit_response(t), slope, moved)

    @abc.abstractmethod
    def own_motions(self, t: Samples) -> list[Samples]:
        """What the output can do without an input, from t = 0 on: a basis, of order one.

        Any state at t = 0 moves the output by a sum of these, each times a number. A lag of 0 has
        no state: its motion is 0. What an integrator holds is the offset, and left out.
        """

    @abc.abstractmethod
    def unit_transfer_function(self, s: Complex[Array, "*shape"]) -> Complex[Array, "*shape"]:
        """G(s) for gain 1 and delay 0."""

    @property
    def zeros(self) -> Shaped[np.ndarray, " m"]:
        """Zeros of the transfer function, on the host (concrete parameters)."""
        return np.empty(0)

    @property
    @abc.abstractmethod
    def poles(self) -> Shaped[np.ndarray, " n"]:
        """Poles of the transfer function, on the host (concrete parameters)."""

    @abc.abstractmethod
    def denominator(self) -> list[Factor]:
        """Factors of the transfer function's denominator, slowest first; host code."""

    def numerator(self) -> list[Factor]:
        """Factors of its numerator beside gain and dead time; host code."""
        return []

    @abc.abstractmethod
    def time_scales(self) -> TimeScales:
        """How fast its transient is, and how long; host code."""

    def has_settled(self, last: Scalar) -> Flag:
        """Whether a record whose last row has g = `last` shows enough of the change."""
        return last >= SETTLED

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the real parameters: its own first, then gain, offset and delay."""
        own = [field.name for field in dataclasses.fields(self) if field.name not in COMMON]
        real = [name for name in own if eqx.is_inexact_array(getattr(self, name))]
        return (*real, *COMMON)

    @property
    def scalars(self) -> tuple[ScalarParameter, ...]:
        """The real parameters number by number, in the order of `parameter_names`."""
        found: list[ScalarParameter] = []
        for name in self.parameter_names:
            value = getattr(self, name)
            places = range(value.size) if value.ndim else [None]
            found += [ScalarParameter(name, place) for place in places]
        return tuple(found)

    def dimension(self, name: str) -> str:
        """Dimension of a parameter, in terms of "time", "input" and "output"; "1" for none."""
        return self.__dataclass_fields__[name].metadata.get("dimension", "1")

    def _elapsed(self, t: ArrayLike) -> Array:
        """Time since the response begins."""
        return as_real(t) - self.delay

    def step_response(self, t: Float[ArrayLike, "*shape"]) -> Float[Array, "*shape"]:
        """Response to a unit step at t = 0, at times `t` of any shape."""
        return self.offset + self.checked_gain * self.unit_response(self._elapsed(t))

    def impulse_response(self, t: Float[ArrayLike, "*shape"]) -> Float[Array, "*shape"]:
        """Response to a unit impulse at t = 0: the derivative of the step response.

        Its accuracy is absolute, relative to its largest value; 0 up to the delay.
        """
        gain, elapsed = self.checked_gain, self._elapsed(t)
        _, slope = jax.jvp(self.unit_response, (elapsed,), (jnp.ones_like(elapsed),))
        return gain * slope

    def frequency_response(self, omega: Float[ArrayLike, "*shape"]) -> Complex[Array, "*shape"]:
        r"""Complex $G(j\omega)$ at angular frequencies `omega` (radian per unit of time)."""
        s = 1j * as_real(omega)
        return self.checked_gain * jnp.exp(-s * self.delay) * self.unit_transfer_function(s)

    def respond(
        self, t: Float[ArrayLike, "..."], u: Float[ArrayLike, "..."], hold: str = "zero"
    ) -> Samples:
        r"""Response to a sampled input, exact for what the input does between samples.

        `hold="zero"`: it is constant from each sample to the next,
        $y(t_i) = \text{offset} + \text{gain} \sum_k (u_k - u_{k-1})\, g(t_i - t_k - L)$;
        `hold="first"`: it moves along the line between them, after a jump to the first. `t`
        increases, evenly or not; `u` is the deviation from the operating point, and the plant is at
        rest before `t[0]`. A jump is seen from the left: the output at its time is that before it.

        Time and memory grow as the number N of samples (a real order of equal lags: N log N, at
        uneven times N^2). A whole number of sampling intervals is as good a dead time as any other.
        """
        return self.offset + self.checked_gain * respond(self, t, u, hold)

    def realise(self, interval: Scalar) -> AbstractRealisation | None:
        """As a linear system with a state, sampled at intervals of at least `interval`.

        None for a plant without a finite state, which has a `unit_ramp` and `mean_response`.
        """
        raise NotImplementedError

    def __repr__(self) -> str:
        """The numbers of a concrete plant, to six digits; else the PyTree."""
        names = sorted(self.__dataclass_fields__, key=lambda name: name in COMMON)  # own first
        values = {name: getattr(self, name) for name in names}
        if not all(isinstance(x, int | jax.Array | np.ndarray) for x in values.values()) or any(
            isinstance(x, Tracer) for x in values.values()
        ):
            return eqx.tree_pformat(self)
        with np.printoptions(precision=6, threshold=20, suppress=False):
            said = [f"{name}={_shown(x)}" for name, x in values.items()]
        return f"{type(self).__name__}({', '.join(said)})"

    @property
    def static_gain(self) -> Scalar:
        """Change of the output per unit of input after all transients."""
        return self.gain

    @property
    def sum_of_lags(self) -> Scalar:
        r"""$-G'(0)/G(0)$ without the dead time: $\sum_k T_k$, less the lead of a zero.

        With the dead time it is the mean residence time, the area above the response to a unit
        step over the gain: what a record determines best. $2\zeta/\omega_n$ of two poles, NaN of an
        integrator.
        """
        if not self.settles:
            return jnp.full_like(self.delay, jnp.nan)
        s = 1j * jnp.zeros_like(self.delay)
        return -jax.jvp(self.unit_transfer_function, (s,), (jnp.ones_like(s),))[1].real

    def to_control(self, pade_order: int | None = None):
        """This model as a python-control `TransferFunction` (needs `stepax[control]`).

        A rational transfer function has no dead time: with a delay give `pade_order`, the order of
        the Pade approximation; without it a delay raises a `ValueError`.
        """
        return control_transfer_function(self, pade_order)

    def to_scipy(self, pade_order: int | None = None):
        """This model as `scipy.signal.ZerosPolesGain`; a delay as in `to_control`."""
        return scipy_transfer_function(self, pade_order)


def _shown(x: Any) -> str:
    """A number, or numbers, of a concrete parameter."""
    x = np.asarray(x)
    if x.ndim:
        return np.array2string(x, separator=", ")
    return f"{x:.6g}" if np.issubdtype(x.dtype, np.floating) else str(x)


class AbstractChain(AbstractPlant):
    r"""A chain of real lags, $\prod_k 1/(1 + s T_k)$."""

    if TYPE_CHECKING:

        @property
        def lags(self) -> Lags:
            """Time constants: shape (n,) for a Python int as order, else (8,), zeros last."""
            ...
    else:
        lags: eqx.AbstractVar[Lags]

    def denominator(self) -> list[Factor]:
        """One factor a lag, largest first; what is a rounding error beside the largest is none."""
        lags = np.sort(np.asarray(self.lags, float))[::-1]
        return [Factor((1.0, lag)) for lag in lags.tolist() if lag > 1e-9 * lags[0]]

    def time_scales(self) -> TimeScales:
        """From the smallest to the largest lag; the lags after it delay the end."""
        lags = np.asarray(self.lags, float)
        lags = lags[lags > 0]
        if not lags.size:
            return TimeScales(np.inf, np.inf, 0.0)
        return TimeScales(lags.min(), lags.max(), 40 * lags.max() + 10 * lags.sum())

    @property
    def poles(self) -> Shaped[np.ndarray, " n"]:
        """Poles -1/T_k in the order of the lags; a lag of 0 has none. Needs concrete lags."""
        lags = np.asarray(self.lags)
        return -1 / lags[lags > 0]

    def unit_response(self, t: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """g(t), by contour quadrature."""
        return chain_response(t, self.lags)

    def own_motions(self, t: Samples) -> list[Samples]:
        """One a lag."""
        return chain_motions(t, self.lags)

    def realise(self, interval: Scalar) -> AbstractRealisation | None:
        """One state for each lag."""
        return ChainRealisation(self.lags, interval)

    def unit_transfer_function(self, s: Complex[Array, "*shape"]) -> Complex[Array, "*shape"]:
        """G(s), the product over the lags."""
        lags = self.lags
        return jnp.prod(1 / (1 + s[..., None] * lags.reshape((1,) * s.ndim + (-1,))), axis=-1)
