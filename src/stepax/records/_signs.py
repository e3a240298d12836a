"""Signs in a record that call for a zero or an integrator: reasons to try such a model."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .._arrays import Flag, Samples, Scalar
from ._characterise import levels
from ._preprocess import moving_mean, noise_of
from ._record import StepRecord, usable_record


SEEN = 0.01
"""Share of the output's range below which a move is no sign, also without noise."""
STANDS_OUT = 5.0
"""Standard errors above which the extreme of many averaged rows is no noise: one in 10^6."""
RAMP = 0.15
"""Share of the range that the last quarter of a ramp covers: of a record that has settled less."""
STEADY = 0.85
"""Ratio of the slopes in the last two quarters above which there is no sign of settling.

A first-order response shows e^(-1/4) = 0.78 where the record ends at its time constant."""


class Signs(NamedTuple):
    """What a plant of real lags or an oscillation does not do.

    - `wrong_way`: the output first moves away from where it ends.
    - `lone_overshoot`: it passes its final level and comes back without swinging through it by the
        square of the overshoot, as an oscillation would.
    - `unsettled`: it ends as a ramp.
    """

    wrong_way: Flag
    lone_overshoot: Flag
    unsettled: Flag


@eqx.filter_jit
def signs(record: Any) -> Signs:
    """The signs in a record, above its noise; of another input than a step all may be there."""
    if not isinstance(record, StepRecord):
        return Signs(*[jnp.array(True)] * 3)
    _, record = usable_record(record)
    initial, final = levels(record)
    up = jnp.where(final < initial, -1, 1)
    change = jnp.abs(final - initial)
    width = jnp.maximum(1, record.count // 25)
    y = up * (moving_mean(record.y, width, record.count) - initial)
    after = (record.elapsed > 0) & record.present
    extent = jnp.max(record.y) - jnp.min(record.y)
    seen = jnp.maximum(SEEN * extent, _extreme_of_noise(record, width))

    over = jnp.where(after, y - change, -jnp.inf)
    past_peak = after & (jnp.arange(y.size) > jnp.argmax(over))
    back = jnp.max(jnp.where(past_peak, change - y, 0))
    overshoot = jnp.max(over)
    swing = overshoot**2 / jnp.where(change > 0, change, 1)
    return Signs(
        wrong_way=jnp.max(jnp.where(after, -y, 0)) > seen,
        lone_overshoot=(overshoot > seen) & (back < 0.5 * swing),
        unsettled=_ends_as_ramp(record, up * record.y, extent),
    )


def _extreme_of_noise(record: StepRecord, width: Array) -> Scalar:
    """What noise can move an average of `width` rows away from the initial level."""
    before = jnp.maximum(jnp.sum(~(record.elapsed > 0)), 1)
    variance = 1 / width + (0 if record.initial is not None else 1 / before)
    return STANDS_OUT * noise_of(record.t, record.y, record.count) * jnp.sqrt(variance)


def _ends_as_ramp(record: StepRecord, y: Samples, extent: Scalar) -> Flag:
    """Whether the last quarter rises as steeply as the one before, and covers its share."""
    quarter = record.duration / 4

    def rise(begin: float) -> Scalar:
        """Slope of the line through a quarter, times its length."""
        t = record.elapsed / quarter - begin
        rows = (t >= 0) & (t <= 1) & record.present
        count = jnp.maximum(jnp.sum(rows), 1)
        middle, height = jnp.sum(t * rows) / count, jnp.sum(y * rows) / count
        spread = jnp.sum((t - middle) ** 2 * rows)
        product = jnp.sum((t - middle) * (y - height) * rows)
        return product / jnp.where(spread > 0, spread, 1)

    third, last = rise(2.0), rise(3.0)
    return (last > RAMP * extent) & (last > STEADY * third)
