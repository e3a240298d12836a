"""Marks that a person read take the place of a method's own: the published formulae on them."""

import jax.numpy as jnp
import pytest

from stepax import FOPDT, StepRecord, compare


METHODS = ["viteckova_1", "alfaro_1", "ziegler_nichols_tangent", "fopdt_fit"]


@pytest.fixture(scope="module")
def record():
    t = jnp.linspace(0.0, 100.0, 60)
    return StepRecord(t, FOPDT(T=10.0, gain=2.0, delay=4.0).step_response(t - 10), 10.0)


@pytest.fixture(scope="module")
def found(record, quick_compilation):
    told = []
    marks = {"t33": 7.0, "t70": 19.0, "Tu": 3.0, "Tg": 15.0}
    rows = compare(record, METHODS, marks=marks, progress=lambda *x: told.append(x)).rows
    assert told == [(1, 2), (2, 2)]
    return {row.method: row.result.model for row in rows}


def test_two_times(found):
    model = found["viteckova_1"]  # tau = 1.245 (t70 - t33), delay 1.498 t33 - 0.498 t70
    assert float(model.T) == pytest.approx(1.245 * 12.0)
    assert float(model.delay) == pytest.approx(1.498 * 7.0 - 0.498 * 19.0)


def test_tangent(found):
    model = found["ziegler_nichols_tangent"]
    assert (float(model.delay), float(model.T)) == pytest.approx((3.0, 15.0))


def test_other_levels_and_fits_read_for_themselves(found):
    for name in ("alfaro_1", "fopdt_fit"):
        assert float(found[name].T) == pytest.approx(10.0, rel=0.02)


def test_wrong_marks(record):
    with pytest.raises(ValueError, match="No method reads a mark 't34'; known are"):
        compare(record, METHODS, marks={"t34": 1.0})
    with pytest.raises(ValueError, match="must be a time"):
        compare(record, METHODS, marks={"t33": float("nan")})
