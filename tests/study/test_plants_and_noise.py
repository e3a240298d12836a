"""Random plants and noise: distributions, reproducibility, and what each noise does."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import stepax
from stepax import (
    AR1Noise,
    Drift,
    GaussianNoise,
    Glitches,
    InputNoise,
    LagAndRatio,
    LogUniformLags,
    PTn,
    Quantisation,
    Study,
    UniformLags,
    UniformNoise,
    random_plants,
)
from stepax.study._noise import noise_table
from stepax.study._plants import settling_time


KEY = jax.random.key(3)
T = np.linspace(0.0, 1.0, 4000)


def held(t, u):
    return u


def disturbed(noise, y=None, key=KEY):
    y = np.zeros_like(T) if y is None else y
    return np.asarray(noise.disturb(key, jnp.asarray(T), jnp.asarray(y), held))


def test_random_plants_are_murrays():
    plants = random_plants(KEY, 2000, 3)
    assert isinstance(plants, PTn) and plants.lags.shape == (2000, 3)
    assert all(leaf.shape[0] == 2000 for leaf in jax.tree.leaves(plants))
    assert stats.kstest(np.ravel(plants.lags), stats.uniform(1, 8).cdf).pvalue > 0.01
    y = jax.vmap(lambda plant: plant.step_response(jnp.array([1e3])))(plants)
    np.testing.assert_allclose(y, 1, atol=1e-9)


def test_the_first_plants_do_not_depend_on_how_many_there_are():
    few, many = random_plants(KEY, 3, 4), random_plants(KEY, 300, 4)
    np.testing.assert_array_equal(few.lags, many.lags[:3])
    assert not np.allclose(few.lags, random_plants(jax.random.key(4), 3, 4).lags)


@pytest.mark.parametrize(
    "distribution, cdf",
    [
        (UniformLags(2, 3), stats.uniform(2, 1).cdf),
        (LogUniformLags(0.1, 10), stats.loguniform(0.1, 10).cdf),
        (lambda key, order: jax.random.exponential(key, (order,)), stats.expon.cdf),
    ],
)
def test_distributions(distribution, cdf):
    lags = random_plants(KEY, 1000, 2, distribution).lags
    assert stats.kstest(np.ravel(lags), cdf).pvalue > 0.01


def test_a_dominant_lag_and_ratios():
    lags = np.asarray(random_plants(KEY, 500, 3, LagAndRatio()).lags)
    assert stats.kstest(lags[:, 0], stats.uniform(3, 6).cdf).pvalue > 0.01
    assert stats.kstest(lags[:, 2] / lags[:, 1], stats.uniform(0.1, 0.9).cdf).pvalue > 0.01


@pytest.mark.parametrize("order", [0, 9, 2.0, True])
def test_orders_that_no_plant_has(order):
    with pytest.raises(ValueError, match="order of a plant"):
        random_plants(KEY, 2, order)


def test_ranges_that_are_none():
    for ends in [(0, 1), (2, 1), (1, np.inf)]:
        with pytest.raises(ValueError, match="low <= high"):
            UniformLags(*ends)


@pytest.mark.parametrize("lags", [[2.0], [1.0, 1.0], [9.0, 1.0, 5.0, 0.0], [3.0] * 8])
def test_records_end_at_99_9_per_cent(lags):
    end = settling_time(jnp.array(lags))
    used = np.array([x for x in lags if x])
    if np.ptp(used) == 0:
        expected = stats.gamma(used.size, scale=used[0]).ppf(0.999)
        np.testing.assert_allclose(end, expected, rtol=1e-8)
    g = PTn(lags=jnp.array(lags)).step_response(end[None])
    np.testing.assert_allclose(g, 0.999, atol=1e-11)


def test_sizes_of_noise():
    np.testing.assert_allclose(disturbed(GaussianNoise(0.02)).std(), 0.02, rtol=0.05)
    uniform = disturbed(UniformNoise(0.1))
    np.testing.assert_allclose(uniform.std(), 0.1 / np.sqrt(12), rtol=0.05)
    assert np.ptp(uniform) <= 0.1
    assert stats.kstest(uniform, stats.uniform(-0.05, 0.1).cdf).pvalue > 0.01


def test_coloured_noise_is_stationary():
    keys = jax.random.split(KEY, 400)
    t = jnp.linspace(0, 1, 60)
    draw = lambda k: AR1Noise(0.1, 0.9).disturb(k, t, jnp.zeros(60), held)  # noqa: E731
    e = np.asarray(jax.vmap(draw)(keys))
    np.testing.assert_allclose(e.std(axis=0), 0.1, rtol=0.15)  # 4 standard errors of a deviation
    np.testing.assert_allclose(np.mean(e[:, 1:] * e[:, :-1]) / np.mean(e**2), 0.9, atol=0.02)


def test_quantisation_drift_and_glitches():
    y = np.linspace(0, 1, T.size)
    rounded = disturbed(Quantisation(0.1), y)
    np.testing.assert_allclose(rounded, np.round(10 * y) / 10, atol=1e-12)
    np.testing.assert_array_equal(disturbed(Quantisation(0.0), y), y)
    drift = disturbed(Drift(0.2))
    np.testing.assert_allclose(drift, drift[-1] * T, atol=1e-12)
    assert 0 < abs(drift[-1]) <= 0.2
    hit = disturbed(Glitches(0.5, share=0.02))
    assert set(np.unique(hit)) == {-0.5, 0.0, 0.5}
    np.testing.assert_allclose(np.mean(hit != 0), 0.02, atol=0.01)


def test_noise_composes_in_order():
    both = UniformNoise(0.1) + Drift(0.1) + Quantisation(0.05)
    y = disturbed(both)
    assert float(both.level) == 0.1 and len(both.parts) == 3
    np.testing.assert_allclose(y / 0.05, np.round(y / 0.05), atol=1e-9)
    first = disturbed(UniformNoise(0.1), key=jax.random.fold_in(KEY, 0))
    assert np.abs(y - first).max() < 0.1 + 0.03


def test_a_table_of_noise_gives_each_of_its_models():
    models = (GaussianNoise(0.1), UniformNoise(0.2), GaussianNoise(0.3), Quantisation(0.1))
    table, y = noise_table(models), jnp.linspace(0, 1, 40)
    t = jnp.linspace(0, 1, 40)
    for place, model in enumerate(models):
        found = table.disturb(jnp.asarray(place), KEY, t, y, held)
        np.testing.assert_allclose(found, model.disturb(KEY, t, y, held), atol=1e-15)


def test_noise_on_the_input_comes_by_the_plant():
    """In a study its response is a convolution of samples; `respond` sums responses."""
    from stepax.study._chunk import _record

    study = Study(["smith_1972"], orders=[3], noise=[InputNoise(0.5)], samples=50)
    key = jax.random.key(0)
    places = [jnp.asarray(k) for k in (0, 1, 0, 0)]
    t, clean, raw = _record(study, "threefry2x32", jax.random.key_data(key), *places)
    place = jax.random.fold_in(jax.random.fold_in(key, 3), 1)
    lags = study.distribution(place, 3)
    for k in (1, 0, 0):
        place = jax.random.fold_in(place, k)
    u = jax.random.normal(place, (50,), jnp.float32).astype(float)
    expected = 0.5 * PTn(lags=lags).respond(t, u)
    np.testing.assert_allclose(raw - clean, expected, atol=1e-12)


def test_what_a_study_cannot_be():
    for change, error, said in [
        ({"methods": ["none"]}, KeyError, "Unknown method"),
        ({"methods": "smith"}, TypeError, "list of names"),
        ({"methods": {"smith": {"width": 3}}}, ValueError, "has no option"),
        ({"methods": {"sani_fit": {"order": "sani_tu_tg"}}}, ValueError, "before it"),
        ({"methods": {"smith": {}, "sani_fit": {"order": "smith"}}}, ValueError, "start"),
        ({"methods": {"sani_tu_tg": {"span": 1.5}}}, ValueError, "span"),
        ({"orders": 3}, TypeError, "must be a list"),
        ({"orders": [2, 2]}, ValueError, "differ"),
        ({"orders": [9]}, ValueError, "order of a plant"),
        ({"noise": ["much"]}, TypeError, "noise"),
        ({"noise": []}, ValueError, "empty"),
        ({"plants": 0}, ValueError, "plants"),
        ({"samples": 5}, ValueError, "samples"),
    ]:  # fmt: skip
        with pytest.raises(error, match=said):
            Study(**({"methods": ["smith"]} | change))


def test_public_names():
    for name in ("Study", "run_study", "random_plants", "StudyResults"):
        assert hasattr(stepax, name)
