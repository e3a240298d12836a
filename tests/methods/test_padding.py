"""A record whose rows count only in part gives what the bare one gives, in every method."""

import jax
import numpy as np
import pytest

from stepax import (
    IPDT,
    METHODS,
    Sani,
    SOPDTZero,
    Status,
    StepRecord,
)


pytestmark = pytest.mark.usefixtures("quick_compilation")
COUNT, SIZE = 140, 180  # ceil(0.05 140) = 8 in double precision, since 0.05 140 > 7
PLANTS = {
    "sopdt_zero_fit": SOPDTZero(zeta=0.8, omega_n=0.9, lead=-1.0, gain=2.0, offset=1.0, delay=1.0),
    "ipdt_fit": IPDT(T=2.0, gain=0.1, offset=1.0, delay=1.0),
}
CHAIN = Sani(T=4.0, r=0.5, n=3, gain=2.0, offset=1.0)


def bare(plant=CHAIN, count=COUNT, seed=0, noise=0.002, **levels):
    t = np.linspace(-3.0, 37.0, count) + np.linspace(0, 1, count) ** 2  # uneven
    y = np.asarray(plant.step_response(t))
    y = y + noise * np.random.default_rng(seed).standard_normal(count)
    return StepRecord(t, y, **levels)


def padded(record, size=SIZE):
    """Filled up with rows that would spoil everything."""
    more = size - record.t.size
    t = np.append(record.t, np.full(more, -1e6))
    y = np.append(record.y, np.where(np.arange(more) % 2, np.nan, 1e9))
    return StepRecord(t, y, initial=record.initial, final=record.final, rows=record.t.size)


def spread_out(record, size=SIZE):
    """The same rows among others of weight 0."""
    place = np.sort(np.random.default_rng(1).choice(size, record.t.size, replace=False))
    t, y, weights = np.full(size, 5.0), np.full(size, np.nan), np.zeros(size)
    t[place], y[place], weights[place] = record.t, record.y, 1.0
    return StepRecord(t, y, initial=record.initial, final=record.final, weights=weights)


def check(result, expected, rtol=1e-9):
    assert result.status == expected.status, (Status[result.status], Status[expected.status])
    pairs = [
        (result.model, expected.model),
        (result.rmse, expected.rmse),
        (result.J, expected.J),
        (result.fit_percent, expected.fit_percent),
        (result.std, expected.std),
        (result.details, expected.details),
    ]
    for ours, theirs in pairs:
        for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
            a, b = np.asarray(a, float), np.asarray(b, float)
            np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol * 1e-3)


@pytest.mark.parametrize("name", METHODS)
def test_padding_changes_nothing(name):
    options = {} if name.endswith("_fit") else {"span": 0.15}
    record = bare(PLANTS.get(name, CHAIN))
    check(METHODS[name](padded(record), **options), METHODS[name](record, **options))


@pytest.mark.parametrize("name", ["sopdt_fit", "harriott", "sani_tu_tg", "moments_sopdt"])
def test_rows_of_weight_0_are_left_out(name):
    record = bare(noise=0.0, initial=1.0, final=3.0)
    check(METHODS[name](spread_out(record)), METHODS[name](record))
