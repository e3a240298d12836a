"""Long records made short by averaging over equal spans of time; host code."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ._record import R, StepRecord, rows_that_count


MOST_ROWS = 4000
"""Rows that a fit works on: of more it would take minutes, and tell nothing that means do not."""
SPANS = 3563
"""Spans of a longer record; with one more at either end they fill a rung of the ladder of lengths.

`test_a_thinned_record_fills_its_rung` holds that."""
FEW_SPANS = 10
"""Spans between 10 and 90 % of the change below which means blur the response."""


def thinned(record: R) -> R:
    """A record of fewer rows where it has more than `MOST_ROWS`; else the record as it is.

    Each row is the mean over one of equal spans, which are laid from the step on, so that none has
    rows of both sides of it. Means keep what white noise tells of a slow response; that of a span
    differs from the response at its middle by a 24th of its curvature. Means of a sampled input
    would be another input: such a record keeps its rows.
    """
    if record.t.size <= MOST_ROWS or not isinstance(record, StepRecord):
        return record
    record = rows_that_count(record)
    t, y = np.asarray(record.t, float), np.asarray(record.y, float)
    usable = t.size > MOST_ROWS and np.all(np.isfinite(y)) and np.all(np.diff(t) > 0)
    if not usable:  # a refusal says why
        return record
    span = (t[-1] - t[0]) / SPANS
    place = np.floor((t - float(record.step_time)) / span)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(place)) + 1])
    counts = np.diff(starts, append=place.size)
    t, y = (np.add.reduceat(x - x[0], starts) / counts + x[0] for x in (t, y))
    facts = {
        "rows_thinned": jnp.asarray(place.size),
        "span_of_average": jnp.asarray(span),
        "thinned_coarsely": jnp.asarray(_is_coarse(t, y, float(record.step_time))),
    }
    rows = (jnp.asarray(x, record.t.dtype) for x in (t, y))
    short = eqx.tree_at(lambda r: (r.t, r.y), record, tuple(rows))
    return eqx.tree_at(lambda r: r.details, short, record.details | facts)


def _is_coarse(t: np.ndarray, y: np.ndarray, step_time: float) -> bool:
    """Whether few spans lie between 10 and 90 % of the change after a step."""
    after, before = y[t >= step_time], y[t < step_time]
    initial = np.median(before) if before.size else y[0]
    change = np.median(after[-max(1, after.size // 20) :]) - initial
    share = (after - initial) / (change or 1.0)
    return bool(np.argmax(share > 0.9) - np.argmax(share > 0.1) < FEW_SPANS)
