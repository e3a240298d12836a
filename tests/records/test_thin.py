"""Long records, averaged over equal spans of time."""

import numpy as np
import pandas as pd
import pytest

from stepax import Status, StepRecord, identify
from stepax._compilation import rung
from stepax.records._thin import MOST_ROWS, SPANS, thinned


pytestmark = pytest.mark.usefixtures("quick_compilation")


def response(t, step_time):
    """A first-order response with noise."""
    since = np.maximum(np.asarray(t) - step_time - 2.0, 0.0)
    noise = 0.02 * np.random.default_rng(0).standard_normal(np.size(t))
    return 22.0 + 32.0 * (1 - np.exp(-since / 8.0)) + noise


def long_record(rows, step_time=11.3, **fields):
    t = np.sort(np.random.default_rng(3).uniform(0, 60, rows))
    return StepRecord(t, response(t, step_time), step_time, 40.0, **fields)


def test_a_short_record_stays_as_it_is():
    record = long_record(MOST_ROWS)
    assert thinned(record) is record


def test_means_over_equal_spans():
    """Each row is the mean of the rows in its span, and no span holds rows of both sides."""
    record = long_record(50_000)
    short = thinned(record)
    t, y = np.asarray(record.t), np.asarray(record.y)
    span = float(short.details["span_of_average"])
    edges = 11.3 + span * np.arange(-10_000, 10_000)
    frame = pd.DataFrame({"t": t, "y": y}).groupby(np.searchsorted(edges, t, side="right")).mean()
    np.testing.assert_allclose(short.t, frame["t"], rtol=1e-12)
    np.testing.assert_allclose(short.y, frame["y"], rtol=1e-12)
    assert int(short.details["rows_thinned"]) == 50_000 and short.t.size <= MOST_ROWS
    assert int(np.sum(np.asarray(short.t) < 11.3)) == len(
        np.unique(np.floor((t[t < 11.3] - 11.3) / span))
    )


def test_a_thinned_record_fills_its_rung():
    assert thinned(long_record(50_000)).t.size <= rung(SPANS + 2) < MOST_ROWS
    assert rung(SPANS + 2) == SPANS + 2


def test_rows_that_do_not_count_are_no_part_of_a_mean():
    weights = np.where(np.arange(10_000) % 2, 1.0, 0.0)
    record = long_record(10_000)
    spoilt = np.where(weights > 0, record.y, np.nan)
    short = thinned(StepRecord(record.t, spoilt, 11.3, 40.0, weights=weights))
    assert int(short.details["rows_thinned"]) == 5000 and np.isfinite(np.asarray(short.y)).all()


def test_a_response_in_few_spans_is_told():
    t = np.linspace(0, 1e5, 20_000)
    y = np.where(t < 100, 0, 1 - np.exp(-(t - 100) / 20))
    assert bool(thinned(StepRecord(t, y, 100.0)).details["thinned_coarsely"])
    assert not bool(thinned(long_record(20_000)).details["thinned_coarsely"])


def test_a_refused_record_is_not_thinned():
    record = long_record(5000)
    wrong = StepRecord(record.t, np.where(np.arange(5000) == 7, np.nan, record.y), 11.3, 40.0)
    assert bool(identify(wrong, "smith_1972").status == Status.nonfinite_data)


def test_all_rows_are_used_where_that_is_asked_for():
    record = long_record(5000)
    assert identify(record, "smith_1972").record.t.size < MOST_ROWS
    assert identify(record, "smith_1972", all_rows=True).record is record
