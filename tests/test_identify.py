"""The front door: auto, named methods, comparison, real records."""

import re
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stepax
from stepax import (
    FOPDT,
    IPDT,
    METHODS,
    SOPDT,
    Identification,
    PTn,
    Sani,
    SOPDTZero,
    Status,
    StepRecord,
    compare,
    identify,
)
from stepax._result import DETAILS
from stepax.methods import MODELS
from stepax.methods._fits import AUTO, WITH_REASON


DATA = Path(__file__).parents[2] / "shared" / "data"
TIMES = np.linspace(0.0, 80.0, 240)
PLANT = Sani(T=8.0, r=0.5, n=3, gain=2.0, offset=1.0)
NAMED = [name for name in METHODS if re.match("hudzovic|sani|ptn|fopdt|sopdt", name)]
NAMED += ["viteckova_1", "harriott", "strejc", "rangaiah_krishnaswamy", "tangent_63", "moments_ptn"]
TANGENTS = ("tu_tg", "strejc", "tangent")


@pytest.fixture(scope="module")
def record():
    noise = 0.02 * np.random.default_rng(0).standard_normal(TIMES.size)
    return StepRecord(TIMES, np.asarray(PLANT.step_response(TIMES)) + noise, initial=1.0, final=3.0)


@pytest.mark.parametrize("name", NAMED)
def test_named_methods(record, name):
    options = {"span": 0.1} if any(word in name for word in TANGENTS) else {}
    result = identify(record, name, **options)
    assert isinstance(result, Identification)
    assert type(result.model) is MODELS[name]
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
    chosen = result.method
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


# Models that are tried for a reason


GRID = np.linspace(0.0, 10.0, 200)
INVERSE = SOPDTZero(
    zeta=1 / np.sqrt(3), omega_n=np.sqrt(3), lead=-0.5, gain=2 / 3, offset=1.0, delay=1.0
)
"""(2 - s) e^-s/(s^2 + 2s + 3), simulated."""


def noisy(plant, noise, seed):
    clean = np.asarray(plant.step_response(GRID))
    size = noise * (clean[-1] - clean[0])
    return StepRecord(GRID, clean + size * np.random.default_rng(seed).standard_normal(GRID.size))


def tried(result):
    return {name for name in result.details if name.startswith("aicc_")}


USUAL = {f"aicc_{name}" for name in AUTO}


@pytest.mark.parametrize("seed", range(3))
def test_auto_finds_an_inverse_response(seed):
    result = identify(noisy(INVERSE, 0.02, seed))
    assert result.method == "sopdt_zero_fit" and result.details["wrong_way"]
    assert tried(result) == USUAL | {"aicc_sopdt_zero_fit"}
    for name in ("zeta", "omega_n", "lead", "delay", "gain"):
        assert abs(getattr(result.model, name) - getattr(INVERSE, name)) < 5 * result.std[name]


def test_auto_finds_an_overshoot_that_is_no_oscillation():
    plant = SOPDTZero(zeta=1.5, omega_n=1.5, lead=6.0, gain=2.0)
    result = identify(noisy(plant, 0.01, 0))
    assert result.method == "sopdt_zero_fit" and result.details["lone_overshoot"]


@pytest.mark.parametrize("seed", range(3))
def test_auto_finds_an_integrator(seed):
    plant = IPDT(T=2.0, gain=-0.3, delay=1.0)
    result = identify(noisy(plant, 0.02, seed))
    assert result.method == "ipdt_fit" and result.details["unsettled"]
    assert tried(result) == USUAL | {"aicc_ipdt_fit"}
    assert abs(result.model.gain + 0.3) < 5 * result.std["gain"]
    assert result.status == Status.successful and np.isneginf(result.model.static_gain)
    assert any("taken for an integrator's" in note for note in result.notes)


def usual_plants(count):
    """Plants without a zero, of every kind: lags, equal or not, oscillation, dead time."""
    random = np.random.default_rng(3)
    for k in range(count):
        T, r, delay = random.uniform(0.3, 2.0), random.uniform(0.05, 1.0), random.uniform(0, 1.5)
        levels = {"gain": random.choice([-3.0, 2.0]), "offset": 1.0, "delay": delay}
        yield [
            FOPDT(T=T, **levels),
            SOPDT(zeta=random.uniform(0.1, 1.2), omega_n=random.uniform(0.8, 4.0), **levels),
            Sani(T=T, r=r, n=3, **levels),
            PTn(lags=random.uniform(0.05, 1.0, 4), **levels),
        ][k % 4]


@pytest.mark.parametrize("count", [40, pytest.param(200, marks=pytest.mark.long)])
def test_auto_leaves_the_zero_where_there_is_none(count):
    """Of plants without one it is chosen for none, and tried for few."""
    noise = np.random.default_rng(4).choice([0.003, 0.01, 0.03], 200)
    pairs = zip(usual_plants(count), noise, strict=False)
    results = [identify(noisy(plant, x, k)) for k, (plant, x) in enumerate(pairs)]
    assert sum(result.method in WITH_REASON for result in results) == 0
    assert sum(tried(result) != USUAL for result in results) <= count / 20


# Glitches


def glitched(plant, noise, seed, rows, size):
    """A noisy record with some rows far off."""
    record = noisy(plant, noise, seed)
    y = np.asarray(record.y).copy()
    y[rows] += size
    return StepRecord(GRID, y)


LAG = FOPDT(T=1.0, gain=2.0, offset=1.0, delay=0.5)


@pytest.mark.parametrize(
    "rows, size",
    [
        pytest.param([20, 21], 3.0, marks=pytest.mark.long),
        pytest.param([0, 60, 61, 62, 150], -4.0, marks=pytest.mark.long),
        pytest.param(slice(10, 190, 18), 30.0, marks=pytest.mark.long),
        (range(90, 102), -9),
    ],
    ids=["two", "five", "ten large", "a dropout of twelve"],
)
def test_auto_is_not_misled_by_glitches(rows, size):
    """Gain, offset and time to rise are those of the rows without them, but for a bounded pull."""
    rows = np.arange(GRID.size)[rows]
    record = glitched(LAG, 0.01, 0, rows, size)
    result = identify(record)
    assert int(result.details["glitches"]) == rows.size
    clean = METHODS["fopdt_fit"](StepRecord(np.delete(GRID, rows), np.delete(record.y, rows)))
    assert result.method in AUTO and "noise_level" in result.details
    np.testing.assert_allclose(result.model.gain, clean.model.gain, rtol=0.02)
    np.testing.assert_allclose(result.model.offset, clean.model.offset, atol=0.04)
    np.testing.assert_allclose(result.predict(GRID), clean.predict(GRID), atol=0.06)
    assert float(result.details["fit_of_the_rest"]) > 95
    assert any(f"{rows.size} rows stand out" in note for note in result.notes)
    assert not any("fit is only" in note for note in result.notes)


def test_no_glitches_no_huber():
    """Nor is it tried for noise, an oscillation or a coarse record, whose reasons are no spikes."""
    plants = [LAG, SOPDT(zeta=0.15, omega_n=3.0), Sani(T=1.0, r=0.5, n=3)]
    for plant in plants:
        for noise in (0.0, 0.02, 0.2):
            record = noisy(plant, noise, 1)
            assert "glitches" not in identify(record).details
    coarse = StepRecord(GRID, np.round(np.asarray(noisy(LAG, 0.02, 0).y) / 0.25) * 0.25)
    assert "glitches" not in identify(coarse).details


def test_a_loss_that_is_given_is_kept():
    record = glitched(LAG, 0.01, 0, [20, 21], 3.0)
    result = identify(record, loss="squares")
    assert "glitches" not in result.details and "noise_level" not in result.details


@pytest.mark.skipif(not DATA.exists(), reason="real records are not here")
def test_the_motor_with_two_glitches():
    """T within 20 % of the fit with the two rows after the step removed by hand."""
    record = stepax.read_record(DATA / "dc_motor_glitch.csv", output=4, input="Voltaje (V)")
    kept = ~np.isin(np.arange(record.t.size), np.flatnonzero(record.t >= record.step_time)[:2])
    by_hand = identify(
        StepRecord(record.t[kept], record.y[kept], record.step_time, record.step_size)
    )
    result = identify(record)
    assert int(result.details["glitches"]) == 2
    for name in ("T", "gain"):
        expected = float(getattr(by_hand.model, name))
        assert abs(float(getattr(result.model, name)) - expected) < 0.2 * expected


@pytest.mark.skipif(not DATA.exists(), reason="real records are not here")
@pytest.mark.parametrize("step, moves", [(1, False), (2, True), (3, True)])
def test_the_staircase_tells_which_steps_begin_in_motion(step, moves):
    record = stepax.read_record(DATA / "heater_multistep_kelvin.csv", 1, 3, 2, step)
    notes = " ".join(identify(record, "sopdt_fit").notes)
    assert ("still moves when the step comes" in notes) == moves
    assert f"3 steps in the input; this is step {step}" in notes


def test_every_detail_is_listed():
    """Their names and meaning stand in `DETAILS`; levels and methods in its patterns."""
    patterns = [re.compile(r"t\d+(_\d+)?$"), re.compile(rf"aicc_({'|'.join(METHODS)})$")]
    record = noisy(Sani(T=1.0, r=0.5, n=2, gain=2.0), 0.0, 0)
    results = [eqx.filter_eval_shape(METHODS[name], record) for name in METHODS]
    results += [eqx.filter_eval_shape(METHODS["fopdt_fit"], record, loss="huber")]
    names = {name for result in [*results, identify(record)] for name in result.details}
    assert {n for n in names if not any(p.match(n) for p in patterns)} <= set(DETAILS)
    used = list({name: None for name in DETAILS if "<" not in name})
    of_records = used[: used.index("t<level>") if "t<level>" in used else used.index("Tu")]
    # of records that were read from files, of glitches, and of records of any input
    others = {"glitches", "fit_of_the_rest", "trend", "own_motion"}
    assert set(used) - names == {*of_records, *others}


def test_unknown_options_of_auto():
    with pytest.raises(ValueError, match=r"no option 'bad'.*fixed"):
        identify(noisy(INVERSE, 0.0, 0), bad=1)


def test_auto_in_a_context_of_jax():
    """Its threads work in the caller's precision."""
    code = (
        "import jax, numpy as np, stepax\n"
        "t = np.linspace(0.0, 60.0, 100)\n"
        "with jax.enable_x64(True):\n"
        "    result = stepax.identify(stepax.StepRecord(t, 1 - np.exp(-t / 8)))\n"
        "print(result.rmse.dtype, result.model.gain.dtype)\n"
    )
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True
    )
    assert run.stdout.split() == ["float64", "float64"], run.stderr


def test_orders_of_auto():
    record = noisy(Sani(T=1.0, r=0.5, n=4, gain=2.0), 0.001, 0)
    result = identify(record, orders=iter([2, 3]), errors=False)
    assert result.method in AUTO
    chains = [METHODS[name](record, orders=(2, 3)) for name in ("hudzovic_fit", "sani_fit")]
    for name, chain in zip(("hudzovic_fit", "sani_fit"), chains, strict=True):
        np.testing.assert_allclose(result.details[f"aicc_{name}"], chain.details["aicc"], rtol=1e-6)
