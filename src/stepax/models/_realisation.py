"""Plants as linear systems with a state: what a response to any input steps through."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._arrays import Lags, Scalar
from ._transition import chain_transition, second_order_transition, shortest_lag


class AbstractRealisation(eqx.Module):
    """A plant of gain 1 as a state, whose first two numbers are the slope of the input and itself.

    Its output comes `later` than the readout says: what is too short for a lag is a dead time.
    """

    later: eqx.AbstractVar[Scalar]

    @abc.abstractmethod
    def transition(self, time: Scalar) -> Float[Array, "states states"]:
        """What a time makes of the state while the input moves along a line."""

    @property
    @abc.abstractmethod
    def readout(self) -> Float[Array, " states"]:
        """The output is this times the state."""


class ChainRealisation(AbstractRealisation):
    """A chain of lags, behind an integrator or not; one state for each.

    Lags below `shortest_lag` of the shortest sampling interval are dead time. The largest come
    first, so that what is no lag stands at the end, and the output is the last state that is one.
    """

    rates: Lags
    present: Bool[Array, " lags"]
    later: Scalar
    integrators: int = eqx.field(static=True)

    def __init__(self, lags: Lags, interval: Scalar, integrators: int = 0):
        dtype = jnp.result_type(lags, interval)
        lags = -jnp.sort(-lags.astype(dtype))
        least = shortest_lag(dtype) * interval
        self.present = ~(lags < least)
        self.later = jnp.sum(jnp.where(self.present, 0, lags))
        self.rates = 1 / jnp.where(self.present, lags, least)
        self.integrators = integrators

    def transition(self, time: Scalar) -> Float[Array, "states states"]:
        """By divided differences."""
        return chain_transition(time, self.rates, self.present, self.integrators)

    @property
    def readout(self) -> Float[Array, " states"]:
        """The last lag, or what drives the first."""
        last = 1 + self.integrators + jnp.sum(self.present)
        states = jnp.arange(2 + self.integrators + self.rates.size)
        return (states == last).astype(self.rates.dtype)


class SecondOrderRealisation(AbstractRealisation):
    """Two poles of any damping, and a zero: the output and its slope."""

    zeta: Scalar
    omega_n: Scalar
    lead: Scalar
    later: Scalar

    def __init__(self, zeta: Scalar, omega_n: Scalar, lead: Scalar):
        self.zeta, self.omega_n, self.lead = zeta, omega_n, lead
        self.later = jnp.zeros_like(zeta)  # no lag is left out

    def transition(self, time: Scalar) -> Float[Array, "states states"]:
        """By doubling."""
        return second_order_transition(time, self.zeta, self.omega_n)

    @property
    def readout(self) -> Float[Array, " states"]:
        """y, and lead times its slope."""
        none = jnp.zeros_like(self.lead * self.omega_n)
        return jnp.stack([none, none, none + 1, self.lead * self.omega_n])
