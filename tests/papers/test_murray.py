"""The author's protocol against numbers of his result files, and what correct computation says.

Numbers: stored results and figures of Murray (2016), as read from his files.
"""

import jax
import numpy as np
import pytest
from experiments.murray import figure_picture, legacy
from experiments.murray.drawing import rms
from experiments.murray.plants import PT4_LAGS, padded, random_lags, record_times
from experiments.numpy_responses import chain_lags, chain_response, hudzovic_response
from matplotlib.image import imread

from stepax import METHODS, Hudzovic, Sani, StepRecord, refused, smooth


@pytest.fixture(scope="module")
def pt4():
    """Every method of the legacy code on the plant of figures 10 and 12, without noise."""
    t, clean = legacy.pt4_record()
    assert t[-1] == pytest.approx(23.210, abs=1e-3)  # end of his record, from the figure
    clean = legacy.cut(clean)
    return t, clean, legacy.identify(t, clean, legacy.loess(clean))


@pytest.mark.parametrize(
    ("method", "stored", "relative", "n", "r"),
    [
        ("hudzovic_t10_t50_t90", 2.552690247e-3, 1e-5, 4, 0.1727),
        ("sani_interpolation", 0.000114573**0.5, 1e-5, 4, 0.75),
        ("hudzovic_fit", 1.02676e-8**0.5, 1e-5, 4, None),
        ("sani_fit", 8.146920911e-5, 1e-4, 4, 0.79054),
    ],
)
def test_first_sample_of_his_file(pt4, method, stored, relative, n, r):
    t, clean, found = pt4
    assert legacy.rmse(found[method], t, clean) == pytest.approx(stored, rel=relative)
    assert found[method].n == n
    assert r is None or found[method].r == pytest.approx(r, abs=5e-5)


@pytest.mark.parametrize(
    ("family", "n", "stored"),
    [
        (Hudzovic, 8, 0.098492),
        (Hudzovic, 2, 0.035345),
        (Sani, 8, 0.072478),
        (Sani, 2, 0.091466),
    ],
)
def test_plateaus_of_figure_12_are_default_values(pt4, family, n, stored):
    t, clean, _ = pt4
    model = legacy._checked(family, 3.0, -0.1, n)
    assert model.fallback
    assert legacy.rmse(model, t, clean) ** 2 == pytest.approx(stored, rel=1e-4)


@pytest.mark.parametrize(
    ("family", "n", "r", "curve", "printed", "last_digit"),
    [
        (Hudzovic, 3, 0.4, "tu_tg", 0.1653, 1e-4),
        (Hudzovic, 3, 0.4, "inv_tg", 0.10735, 1e-4),  # by eye: his table ends earlier in time
        (Hudzovic, 3, 0.3479, "lam", 1.767, 1e-3),
        (Hudzovic, 3, 0.3479, "inv_t50", 0.2007, 1e-4),
        (Sani, 4, 0.9, "tu_tg", 0.3169, 1e-4),
        (Sani, 4, 0.9, "inv_tg", 0.26, 1e-2),
    ],
)
def test_example_lookups_of_figures_3_to_5(family, n, r, curve, printed, last_digit):
    table = legacy.tables(family)[n - 2]
    assert legacy.spline(table.r, getattr(table, curve))(r) == pytest.approx(
        printed, abs=last_digit
    )


def test_example_lookup_of_figure_6_is_that_of_the_formulae():
    assert legacy.formula_lam(0.8, 3) == pytest.approx(1.6062, abs=5e-5)
    assert 1 / legacy.formula_t50(0.8, 3) == pytest.approx(0.4688, abs=5e-5)


def test_bisection_stays_below_three_quarters():
    assert legacy.bisection(lambda r: -r, -0.6) == pytest.approx(0.6, abs=1e-6)
    assert legacy.bisection(lambda r: -r, -0.9) == pytest.approx(0.75, abs=1e-6)


def test_sampling_of_matlab():
    # 369 samples to 8.474 for Sani's chain of figure 13
    assert 368 * legacy.step_interval(chain_lags(Sani, 1.0, 0.5, 4)) == pytest.approx(
        8.474, abs=1e-3
    )


def test_loess_is_that_of_the_package():
    t = np.linspace(0, 3, 120)
    y = np.sin(t) + 0.1 * np.random.default_rng(0).random(t.size)
    assert np.allclose(legacy.loess(y), smooth(t, y, 0.2), rtol=0, atol=1e-10)


def test_responses_in_numpy():
    t = np.linspace(0, 30, 50)
    lags = chain_lags(Hudzovic, 1.0, 1 / 6, 4)
    assert np.allclose(lags, PT4_LAGS)
    assert np.allclose(chain_response(t, lags), hudzovic_response(t, 1.0, 1 / 6, 4), atol=1e-12)
    both = chain_response(np.stack([t, t]), padded(np.stack([lags, 2 * lags])))
    assert np.allclose(both[1, 2:4], chain_response(t[2:4], 2 * lags), atol=1e-12)


def test_failures_are_not_hidden_by_default_values():
    """A response that is earlier than first order: the legacy code returns T = 1."""
    times = legacy.level_times(*steep_start())
    assert legacy.lookup_levels(Hudzovic, legacy.tables(Hudzovic), *times).fallback
    result = METHODS["hudzovic_t10_t50_t90"](StepRecord(*steep_start(), initial=0.0, final=1.0))
    assert np.isnan(result.model.T) and np.isnan(result.rmse)


def steep_start():
    t = np.linspace(0, 20, 200)
    return t, 0.5 * (1 - np.exp(-t / 0.3)) + 0.5 * (1 - np.exp(-t / 4))


# ---- what a correct computation says, on random plants without noise


PLANTS = 40


@pytest.fixture(scope="module")
def plants():
    """Lags, times and responses of 40 random plants of each order from 2 to 8."""
    generator = np.random.default_rng(1)
    lags = np.concatenate([random_lags(generator, PLANTS, n) for n in legacy.ORDERS])
    t = record_times(lags)
    return lags, t, chain_response(t, lags)


def errors_by_order(method, t, y, **options):
    """RMS error of each order, and whether any plant was refused."""

    def one(t, y):
        result = METHODS[method](StepRecord(t, y, initial=0.0, final=1.0), **options)
        return result.rmse, refused(result.status)

    rmse, lost = jax.jit(jax.vmap(one))(t, y)
    return np.array([rms(part) for part in np.split(np.asarray(rmse), len(t) // PLANTS)]), lost


def test_lookup_is_better_than_the_formulae_which_improve_with_order(plants):
    _, t, y = plants
    lookup, lost = errors_by_order("sani_t10_t50_t90", t, y)
    assert not np.any(lost)
    assert lookup[0] < 1e-6
    assert np.all(lookup[1:] <= 0.0025)
    formulae, lost = errors_by_order("sani_interpolation", t, y)
    assert not np.any(lost)
    assert np.all(formulae[1:] >= 2 * lookup[1:])
    assert np.all(np.diff(formulae[2:]) < 0)
    assert formulae[2] == pytest.approx(0.0078, rel=0.1)
    assert formulae[-1] == pytest.approx(0.0054, rel=0.1)


@pytest.mark.parametrize("method", ["hudzovic_fit", "sani_fit"])
def test_fits_recover_plants_of_order_2(plants, method):
    _, t, y = plants
    options = {"order": 2, "fixed": ("delay",), "errors": False}
    rmse, lost = errors_by_order(method, t[:PLANTS], y[:PLANTS], **options)
    assert not np.any(lost)
    assert rmse[0] < 1e-6


def test_author_code_gets_worse_with_order_by_its_bisection(plants):
    """His formulae with his bisection, on the same responses."""
    _, t, y = plants
    found = [
        legacy.lookup_formulae(*legacy.level_times(*record)) for record in zip(t, y, strict=True)
    ]
    errors = [
        legacy.rmse(model, *record)
        for model, record in zip(found, zip(t, y, strict=True), strict=True)
    ]
    by_order = np.array([rms(part) for part in np.split(np.array(errors), 7)])
    assert np.all(np.diff(by_order) > 0)
    # figure 8 of the paper, n = 8
    assert by_order[-1] == pytest.approx(0.02155, rel=0.1)
    stuck = np.mean([model.r > 0.7499 for model in found[-2 * PLANTS :]])
    assert stuck > 0.95


@pytest.mark.long
@pytest.mark.skipif(not figure_picture.PICTURE.exists(), reason="the picture is not here")
def test_the_author_reads_his_picture():
    """Against his own code, run in Octave: 288 points, and what each method made of them."""
    picture = np.rint(255 * imread(figure_picture.PICTURE)[..., :3]).astype(int)
    t, y = figure_picture.by_the_author(picture)
    assert t.size == 288
    models = figure_picture.author_models(t, y)
    octave = {
        "hudzovic_tu_tg": (5, 0.1990, 0.270, 0.193),
        "hudzovic_t10_t50_t90": (4, 0.2015, 0.478, 0.185),
        "sani_tu_tg": (5, 0.6525, 1.194, 0.192),
        "sani_interpolation": (4, 0.7335, 1.182, 0.272),
        "sani_fit": (4, 0.7272, 1.149, 0.154),
    }
    for method, (n, r, T, deviation) in octave.items():
        model = models[method]
        assert model.n == n and model.r == pytest.approx(r, abs=2e-4)
        assert model.T == pytest.approx(T, abs=1e-3)
        error = rms(15 * (model.response(10 * t) - y))
        assert error == pytest.approx(deviation, abs=1e-3)
