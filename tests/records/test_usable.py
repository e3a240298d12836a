"""What stands in for a record that is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from stepax import InputRecord, Status, StepRecord
from stepax.records._record import usable_record


T = np.linspace(-2.0, 10.0, 25)
RISE = 1 - np.exp(-np.maximum(T, 0) / 2)
HOLE = np.where(T > 5, np.nan, RISE)


def test_times_that_records_share_stay_shared():
    """Under `vmap` what follows from them alone is then computed once; `out_axes` would refuse."""
    usable = lambda y: usable_record(StepRecord(T, y))[1]  # noqa: E731
    t, since = jax.vmap(lambda y: (usable(y).t, usable(y).step_time), out_axes=None)(
        jnp.stack([RISE, HOLE])
    )
    np.testing.assert_array_equal(t, T)
    assert since == 0


@pytest.mark.parametrize("y", [HOLE, 0 * RISE], ids=["hole", "constant"])
@pytest.mark.parametrize("step_time", [-2.0, 3.0])
@pytest.mark.parametrize("weights", [None, np.where(T < 0, 0.0, 2.0)], ids=["alike", "weighted"])
def test_an_output_is_replaced_by_a_response_to_the_same_step(y, step_time, weights):
    levels = {"initial": 1.0, "final": 5.0}
    record = StepRecord(T, y, step_time, -2.0, weights=weights, **levels)
    status, stand_in = usable_record(record)
    assert bool(status != Status.successful)
    assert stand_in.step_time == step_time
    rows = T if weights is None else T[weights > 0]
    np.testing.assert_array_equal(stand_in.t[: rows.size], rows)
    before = np.asarray(stand_in.elapsed) <= 0
    assert (np.asarray(stand_in.y)[before] == 0).all()
    assert (np.diff(np.asarray(stand_in.y)[~before]) > 0).all()
    assert stand_in.initial == 0
    assert stand_in.final == 1


@pytest.mark.parametrize(
    ("t", "step_time", "step_size"),
    [(T[::-1], 0.0, 1.0), (T, 11.0, 1.0), (T, 0.0, 0.0), (T, np.nan, 1.0), (T, 8.0, 1.0)],
    ids=["backwards", "step outside", "no step", "no time", "too few"],
)
def test_times_and_step_are_replaced_where_something_is_wrong_with_them(t, step_time, step_size):
    status, stand_in = usable_record(StepRecord(t, RISE, step_time, step_size))
    assert bool(status != Status.successful)
    np.testing.assert_array_equal(stand_in.t, np.arange(T.size))
    assert stand_in.step_time == 0
    assert stand_in.step_size == 1


def test_an_input_goes_with_its_output():
    status, stand_in = usable_record(InputRecord(T, HOLE, np.sin(T)))
    assert bool(status == Status.nonfinite_data)
    assert set(np.unique(stand_in.u)) == {0, 1}
    assert np.isfinite(stand_in.y).all()
