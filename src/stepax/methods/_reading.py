"""What point methods share: reading a record, dead times, charts' ends, and the conclusion."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arrays import Flag, Scalar, nan_where
from .._result import Identification, conclude
from .._status import Status, refused
from ..records._characterise import Tangent, crossing_times, levels, smoothed, tangent
from ..records._record import StepRecord, usable_record


CONSTANTS = ("printed", "exact")
"""Constants as they stand in the source, rounded, or recomputed from theory."""


def is_exact(constants: str) -> bool:
    """Whether the recomputed constants are asked for; `ValueError` for an unknown choice."""
    if constants not in CONSTANTS:
        raise ValueError(f"constants must be 'printed' or 'exact', got {constants!r}.")
    return constants == "exact"


def readable(record: StepRecord, span: float | None) -> tuple[Status, StepRecord]:
    """`usable_record`, smoothed once where a `span` is given, with its levels held."""
    problem, safe = usable_record(record)
    initial, final = levels(safe)
    y = smoothed(safe, span)
    return problem, StepRecord(safe.t, y, safe.step_time, safe.step_size, initial, final)


def time_name(level: float) -> str:
    """Name of a level's time among the details: t33, t35_3."""
    return f"t{100 * level:g}".replace(".", "_")


def read_times(safe: StepRecord, levels, delay) -> tuple[Array, dict[str, Scalar], Status]:
    """Times at which a response reaches ascending `levels`, counted from step and `delay`.

    **Returns:** the times, or harmless ones where the status refuses; the times from the step by
    name; and `levels_not_crossed`, or `invalid_times` where they are not positive and increasing.
    """
    levels = np.asarray(levels)
    read = crossing_times(safe, jnp.asarray(levels, safe.t.dtype))
    times, status = checked_times(read, delay)
    times = jnp.where(refused(status), jnp.asarray(-np.log1p(-levels), times.dtype), times)
    return times, dict(zip(map(time_name, levels), read, strict=True)), status


def checked_times(read: Array, delay) -> tuple[Array, Status]:
    """Times counted from step and `delay`, and whether they can be used."""
    times = read - delay
    crossed = jnp.all(jnp.isfinite(read))
    rising = (times[0] > 0) & jnp.all(jnp.diff(times) > 0)
    status = Status.where(rising, Status.successful, Status.invalid_times)
    return times, Status.where(crossed, status, Status.levels_not_crossed)


def rounding(dtype) -> float:
    """Relative size below which a difference between readings is no news.

    The interpolation between samples errs by 1e-7, and a curve's end next to one lag lies within
    sqrt(eps) of it (`shape_ends`): 1.2e-7 in all, 4.3e-4 in float32.
    """
    return 1e-7 + 1.25 * float(jnp.finfo(dtype).eps) ** 0.5


def own_delay(raw: Scalar, scale: Scalar) -> tuple[Scalar, Status]:
    """Dead time that a method computed: a negative one is dropped, with a warning.

    Without the warning where it is negative by no more than rounding, relative to `scale`.
    """
    dropped = raw < -rounding(raw.dtype) * scale
    status = Status.where(dropped, Status.delay_dropped, Status.successful)
    return jnp.maximum(raw, 0), status


def end_status(*ends: tuple[Scalar, float | Scalar, Status]) -> Status:
    """Status of a value that may lie beyond the ends of a curve.

    For each end: by how much it lies beyond (below 0 inside), how much is allowed, and the
    refusal. Successful inside and beyond by rounding, then the warning `at_curve_end` as far as
    is allowed.
    """
    status = Status.successful
    for beyond, allowed, refusal in ends:
        status = Status.where(beyond > rounding(beyond.dtype), Status.at_curve_end, status)
        status = Status.where(beyond <= allowed, status, refusal)
    return status


def unread(status: Status) -> Flag:
    """Whether a status refuses the record or the reading, not the model that would follow."""
    ends = (Status.beyond_first_order, Status.beyond_second_order, Status.beyond_last_order)
    return refused(status) & jnp.all(jnp.stack([status != end for end in ends]))


def finish(record, safe, found, delay, status: Status, details) -> Identification:
    """Gain and offset from the levels; the record's own details beside the method's.

    The method's details are NaN where the record or the reading is refused.
    """
    details = nan_where(unread(status), details)
    initial, final = levels(safe)
    gain = (final - initial) / safe.step_size
    model = eqx.tree_at(
        lambda m: (m.gain, m.offset, m.delay),
        found,
        (gain, initial, jnp.asarray(delay, gain.dtype)),
    )
    return conclude(record, model, status, details=details | record.details)


def read_tangent(safe: StepRecord) -> tuple[Tangent, dict[str, Scalar], Status]:
    """The tangent, or a harmless one where there is none; as read, by name; `no_inflection`."""
    line = tangent(safe)
    found = jnp.isfinite(line.Tg) & (line.Tg > 0)
    status = Status.where(found, Status.successful, Status.no_inflection)
    details = {"Tu": line.Tu, "Tg": line.Tg, "t_inflection": line.t_inflection}
    usable = Tangent(*(jnp.where(found, x, 1) for x in line))
    return usable, details, status
