"""A plant as a layer: samples in, samples out, in one pass or in pieces."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from .._arrays import Flag, Samples, Scalar, as_real
from ..models._abstract import AbstractPlant
from ..models._respond import check_hold, respond_evenly
from ..models._sampled import Difference, dead_time, difference_equation, march


class LayerState(eqx.Module):
    """Where a layer stands after its last sample.

    `inner` is the state of the plant, `last` the last sample, `begun` whether there was one, `past`
    the outputs that the dead time still holds back. `delay_too_long` is the reason where outputs
    are NaN: the dead time is longer than the layer's `buffer`.
    """

    inner: Float[Array, " n"]
    last: Scalar
    begun: Flag
    past: Float[Array, " buffer"]
    delay_too_long: Flag


class LTILayer(eqx.Module):
    r"""A plant as a layer: any sampled input, exact for the hold, differentiable in everything.

    `layer(u, dt)` is the response to samples `u` every `dt`, the plant at rest before the first of
    them, as `model.respond` gives it. `layer.rest(dt)` and `layer.run(u, dt, state)` give the same
    numbers in pieces of any length, one sample at a time too.

    **Arguments:**

    - `model`: the plant; train `from_unconstrained` of free numbers to keep it admissible.
    - `hold`: `"zero"` or `"first"`, what the input does between samples.
    - `buffer`: how many samples `run` keeps for the dead time: it may be shorter than
      `(buffer + 1) dt`. A longer one is a `ValueError`, or where it is traced NaN and
      `state.delay_too_long`. `layer(u, dt)` needs none.

    One input and one plant: batches of either are for `jax.vmap`.
    """

    model: AbstractPlant
    hold: str = eqx.field(static=True, default="zero")
    buffer: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        check_hold(self.hold)
        if not isinstance(self.buffer, int) or self.buffer < 0:
            raise ValueError(f"buffer must be a whole number of samples, got {self.buffer!r}.")

    def __call__(self, u: Float[ArrayLike, "..."], dt: float | Scalar) -> Samples:
        """Response to samples `u` every `dt`, from rest."""
        u = _one_row(u)
        y = respond_evenly(self.model, as_real(dt), u, self.hold)
        return self.model.offset + self.model.checked_gain * y

    def rest(self, dt: float | Scalar) -> LayerState:
        """The state before the first sample: at rest at the `offset`, the input at 0."""
        dt = as_real(dt)
        self._check_delay(dt)
        realisation = self._realise(dt)
        none = jnp.zeros_like(realisation.readout * dt)
        return LayerState(
            inner=none[2:],
            last=none[0],
            begun=jnp.array(False),
            past=jnp.zeros(self.buffer, none.dtype),
            delay_too_long=jnp.array(False),
        )

    def run(
        self, u: Float[ArrayLike, "..."], dt: float | Scalar, state: LayerState
    ) -> tuple[Samples, LayerState]:
        """Outputs at the next samples, and the state after them; `dt` as for `rest`."""
        u, dt = _one_row(u), as_real(dt)
        self._check_delay(dt)
        return _run(self, u, dt, state) if u.shape[0] else (u, state)

    def _realise(self, dt: Scalar) -> Any:
        realisation = self.model.realise(dt)
        if realisation is None:
            raise ValueError(
                f"{self.model!r} has no finite state and cannot run in pieces: call layer(u, dt)."
            )
        return realisation

    def _check_delay(self, dt: Scalar) -> None:
        delay = self.model.delay
        if isinstance(delay, Tracer) or isinstance(dt, Tracer) or np.ndim(delay) or np.ndim(dt):
            return
        least = int(np.floor(np.asarray(delay) / np.asarray(dt))) if delay >= 0 else 0
        if least > self.buffer:
            raise ValueError(
                f"the dead time {float(delay):g} is {least} intervals of {float(dt):g} long or"
                f" more, and the layer keeps buffer={self.buffer} samples: give buffer={least}."
            )


def _one_row(u: Any) -> Samples:
    u = as_real(u)
    if u.ndim != 1:
        raise ValueError(
            f"a layer takes one input as a row of samples, not of shape {u.shape}; for several use"
            " jax.vmap."
        )
    return u


@eqx.filter_jit
def _run(layer: LTILayer, u: Samples, dt: Scalar, state: LayerState) -> tuple[Samples, LayerState]:
    realisation = layer._realise(dt)
    # one place more than the buffer has tells a dead time that is too long
    late, phase = dead_time(layer.model.delay + realisation.later, dt, layer.buffer + 2)
    step = difference_equation(realisation, dt, phase, layer.hold)
    y, inner = _held(step, state, u) if layer.hold == "zero" else _along_lines(step, state, u)
    known = jnp.concatenate([state.past, y])
    too_long = late > layer.buffer
    y = jax.lax.dynamic_slice_in_dim(known, jnp.maximum(layer.buffer - late, 0), u.shape[0])
    y = jnp.where(too_long, jnp.nan, y)
    after = LayerState(
        inner=inner,
        last=u[-1].astype(state.last.dtype),
        begun=jnp.array(True),
        past=known[u.shape[0] :],
        delay_too_long=state.delay_too_long | too_long,
    )
    return layer.model.offset + layer.model.checked_gain * y, after


def _held(step: Difference, state: LayerState, u: Samples) -> tuple[Samples, Array]:
    """Outputs without dead time from the last sample on: each is that before its own sample."""
    return march(step, state.inner, jnp.concatenate([state.last[None], u[:-1]]))


def _along_lines(step: Difference, state: LayerState, u: Samples) -> tuple[Samples, Array]:
    """The first interval by itself: before the first sample of all there is no line to it."""
    before = state.inner - step.jump * state.last
    first = jnp.dot(step.c, before) + step.d * state.last + step.e * u[0]
    at_first = jnp.where(state.begun, step.F @ before + step.b * state.last, -step.jump * u[0])
    first = jnp.where(state.begun, first, 0)[None]
    if u.shape[0] == 1:
        return first, at_first + step.jump * u[-1]
    y, last = march(step, at_first, u[:-1])
    return jnp.concatenate([first, y + step.e * u[1:]]), last + step.jump * u[-1]
