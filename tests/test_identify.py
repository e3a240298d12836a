"""The front door: auto, named methods, comparison, real records."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stepax
from stepax import METHODS, SOPDT, Identification, Sani, Status, StepRecord, compare, identify


DATA = Path(__file__).parents[2] / "shared" / "data"
TIMES = np.linspace(0.0, 80.0, 240)
PLANT = Sani(T=8.0, r=0.5, n=3, gain=2.0, offset=1.0)
CLASSES = {
    "hudzovic": stepax.Hudzovic,
    "sani": Sani,
    "ptn": stepax.PTn,
    "fopdt": stepax.FOPDT,
    "sopdt": SOPDT,
}


@pytest.fixture(scope="module")
def record():
    noise = 0.02 * np.random.default_rng(0).standard_normal(TIMES.size)
    return StepRecord(TIMES, np.asarray(PLANT.step_response(TIMES)) + noise, initial=1.0, final=3.0)


@pytest.mark.parametrize("name", METHODS)
def test_named_methods(record, name):
    options = {"span": 0.1} if "tu_tg" in name else {}
    result = identify(record, name, **options)
    assert isinstance(result, Identification)
    assert type(result.model) is CLASSES[name.split("_")[0]]
    assert not bool(stepax.refused(result.status)), Status[result.status]
    assert float(result.fit_percent) > 80
    residual = np.asarray(record.y - result.predict(record.t))
    np.testing.assert_allclose(result.rmse, np.sqrt(np.mean(residual**2)), rtol=1e-9)
    np.testing.assert_allclose(result.J, np.trapezoid(residual**2, TIMES), rtol=1e-9)
    spread = np.asarray(record.y) - np.mean(np.asarray(record.y))
    fit = 100 * (1 - np.linalg.norm(residual) / np.linalg.norm(spread))
    np.testing.assert_allclose(result.fit_percent, fit, rtol=1e-9)
    assert set(result.std) >= {"gain", "offset", "delay"}
    assert METHODS[name].__doc__ and METHODS[name].__name__ == name


def test_errors_count_rows_from_the_step_on():
    t = np.linspace(-20.0, 80.0, 101)
    y = np.array(PLANT.step_response(t))
    y[:10] += 5.0
    result = identify(StepRecord(t, y, initial=1.0, final=3.0), "sani_t10_t50_t90")
    assert float(result.rmse) < 1e-4


def test_auto_keeps_the_smallest_aicc(record):
    result = identify(record)
    scores = {k: float(v) for k, v in result.details.items() if k.startswith("aicc_")}
    chosen = stepax._identify.chosen_method(result)
    assert len(scores) == 4
    assert scores[f"aicc_{chosen}"] == min(scores.values())
    assert float(result.fit_percent) > 95
    assert all(np.isfinite(float(x)) for x in result.std.values() if x.shape == ()) or bool(
        np.any(result.details["at_bound"])
    )


def test_traced_and_unknown(record):
    with pytest.raises(TypeError, match="host"):
        jax.jit(lambda r: identify(r).rmse)(record)
    with pytest.raises(TypeError, match="host"):
        jax.jit(lambda r: compare(r).best.rmse)(record)
    with pytest.raises(KeyError, match="sani_fit"):
        identify(record, "newton")
    with pytest.raises(ValueError, match="colour"):
        identify(record, "fopdt_fit", colour="red")
    with pytest.raises(ValueError, match="order"):
        identify(record, "sani_fit", order="many")
    with pytest.raises(TypeError, match="StepRecord"):
        identify([1, 2, 3], "fopdt_fit")  # pyright: ignore[reportArgumentType]


REFUSALS = {
    "nonfinite_data": dict(y=lambda y: y.at[3].set(jnp.nan)),
    "time_not_increasing": dict(t=lambda t: t.at[5].set(t[4])),
    "step_outside_record": dict(step_time=lambda s: s + 1e6),
    "no_step": dict(step_size=lambda s: 0 * s),
    "constant_output": dict(y=lambda y: 0 * y),
}


@pytest.mark.parametrize("method", ["fopdt_fit", "sani_t10_t50_t90"])
def test_bad_values_are_a_status_eager_and_traced(record, method):
    names = ["t", "y", "step_time", "step_size"]
    good = {name: getattr(record, name) for name in names}

    def run(t, y, step_time, step_size):
        result = identify(StepRecord(t, y, step_time, step_size), method)
        return result.model.T, result.status, result.rmse

    traced = jax.jit(run)
    for expected, changes in REFUSALS.items():
        fields = good | {name: change(good[name]) for name, change in changes.items()}
        for call in (run, traced):
            lag, status, rmse = call(**fields)
            assert bool(status == getattr(Status, expected)), (expected, Status[status])
            assert np.isnan(lag) and np.isnan(rmse)
    short = identify(StepRecord([0, 1, 2], [0, 1, 2]), method)
    assert bool(short.status == Status.too_few_samples)


def test_an_unsettled_record_is_a_warning():
    t = np.linspace(0.0, 8.0, 100)
    result = identify(StepRecord(t, np.asarray(stepax.FOPDT(T=8.0).step_response(t))), "fopdt_fit")
    assert bool(result.status == Status.not_settled)
    np.testing.assert_allclose(result.model.gain, 1.0, rtol=1e-4)


@pytest.mark.skipif(not DATA.exists(), reason="real records are not here")
@pytest.mark.parametrize(("output", "fit"), [("T1", 98.0), ("T2", 97.0)])
@pytest.mark.parametrize("run", [1, 2])
def test_temperature_lab(output, fit, run):
    file = DATA / f"tclab_step50_run{run}.csv"
    record = stepax.read_record(file, time="Time", output=output, input="Q1")
    result = identify(record, "sopdt_fit")
    assert float(result.fit_percent) >= fit - (0 if run == 1 else 1)
    assert bool(result.details["quantised"]) and bool(result.details["residuals_correlated"])
    assert bool(result.details["assumed_step"])
