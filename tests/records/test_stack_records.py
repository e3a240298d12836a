"""Records of any lengths in one batch."""

import jax
import numpy as np
import pytest

from stepax import FOPDT, METHODS, Sani, StepRecord, stack_records
from stepax.records._labels import Labels
from stepax.records._record import padded_record, rows_that_count


pytestmark = pytest.mark.usefixtures("quick_compilation")


def ragged(count, shortest, longest, seed=0, **levels):
    """Records of plants of both kinds, with noise."""
    random = np.random.default_rng(seed)
    for k in range(count):
        T = random.uniform(2.0, 6.0)
        plant = Sani(T=T, r=0.5, n=3) if k % 2 else FOPDT(T=T, delay=random.uniform(0.5, 2.0))
        t = np.linspace(0.0, random.uniform(8.0, 12.0) * T, random.integers(shortest, longest + 1))
        y = np.asarray(plant.step_response(t)) + 0.005 * random.standard_normal(t.size)
        yield StepRecord(t, y, 0.0, 1.0, **levels)


def figures(method):
    def run(record):
        result = METHODS[method](record)
        return result.model, result.rmse, result.J, result.fit_percent, result.status

    return run


def one(batch, k):
    return jax.tree.map(lambda x: x[k], batch)


def same(ours, theirs):
    for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        # offsets and dead times may be 0 but for noise: beside changes of 1, and times of 20
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-10)


def test_the_batch_holds_what_the_records_hold():
    records = list(ragged(3, 10, 20))
    weights = np.arange(records[1].t.size) % 3
    records[1] = StepRecord(records[1].t, records[1].y, weights=weights)
    records[2] = StepRecord(records[2].t, records[2].y, rows=9, labels=Labels("a"))
    batch = stack_records(records)
    size = max(record.t.size for record in records)
    assert batch.t.shape == batch.y.shape == (3, size)
    assert batch.weights is not None and batch.weights.shape == (3, size)
    assert list(batch.rows) == [records[0].t.size, records[1].t.size, 9]
    for k, record in enumerate(records):
        ours, theirs = rows_that_count(one(batch, k)), rows_that_count(record)
        np.testing.assert_array_equal(ours.t, theirs.t)
        np.testing.assert_array_equal(ours.y, theirs.y)


@pytest.mark.parametrize("levels", [{}, {"initial": 0.0, "final": 1.0}])
def test_a_small_batch(levels):
    records = list(ragged(3, 60, 80, **levels))
    run = figures("smith_1972")
    batch = jax.jit(jax.vmap(run))(stack_records(iter(records)))
    for k, record in enumerate(records):
        same(one(batch, k), run(record))


@pytest.mark.long
@pytest.mark.parametrize("method", ["fopdt_fit", "sani_t10_t50_t90"])
def test_a_thousand_records_of_100_to_400_rows(method):
    records = list(ragged(1000, 100, 400))
    size = max(record.t.size for record in records)
    run = figures(method)
    batch, single = jax.jit(jax.vmap(run))(stack_records(records)), jax.jit(run)
    for k, record in enumerate(records):
        same(one(batch, k), single(padded_record(record.plain, size)))
    for k in (0, 1, 500, 999):
        same(one(batch, k), run(records[k]))


def test_what_cannot_be_stacked():
    with pytest.raises(ValueError, match="at least one record"):
        stack_records([])
    bare, known = (next(ragged(1, 10, 10, **levels)) for levels in ({}, {"final": 1.0}))
    with pytest.raises(ValueError, match="final level of all records, or of none"):
        stack_records([bare, known])
    with pytest.raises(ValueError, match="initial"):
        stack_records([StepRecord(known.t, known.y, initial=0.0, final=1.0), known])
