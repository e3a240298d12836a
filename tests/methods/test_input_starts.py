"""Starts of the fits to a sampled input: near the plant, at any dead time."""

import dataclasses

import numpy as np
import pytest

from stepax import FOPDT, SOPDT, InputRecord
from stepax.methods._input_starts import first_order_start, second_order_start
from stepax.records._record import predict


T = np.linspace(0.0, 100.0, 400)
U = np.repeat(np.random.default_rng(0).integers(0, 2, 40), 10)


def noisy(plant, **options):
    record = InputRecord(T, T, U, **options)
    y = np.asarray(predict(plant, record))
    y = y + 0.1 * np.std(y) * np.random.default_rng(1).normal(size=T.size)
    return dataclasses.replace(record, y=y)


@pytest.mark.parametrize("options", [{}, {"at_rest": False, "drift": True}])
def test_lag_and_dead_time_are_near(options):
    start = first_order_start(noisy(FOPDT(T=6.0, gain=-2.0, offset=5.0, delay=17.0), **options), ())
    assert 3.5 < start.T < 10 and abs(start.delay - 17.0) < 2.5


def test_a_fixed_dead_time_is_left_out():
    plant = SOPDT(zeta=0.3, omega_n=0.5, gain=2.0)
    start = second_order_start(noisy(plant), ("delay",))
    assert float(start.delay) == 0 and 0.3 < start.omega_n < 0.8 and start.zeta < 0.8
