"""The author's protocol against numbers of his result files, and what correct computation says.

Numbers: stored results and figures of Murray (2016), as read from his files.
"""

import jax
import numpy as np
import pytest

from experiments.murray import legacy
from experiments.murray.plants import PT4_LAGS, padded, random_lags, record_times
from experiments.numpy_responses import chain_lags, chain_response, hudzovic_response
from stepax import METHODS, Hudzovic, PTn, Sani, StepRecord, lookup_curves, smooth


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
        ("sani_fit", 8.146920911e-5, 1e-4, 4, 0.79054),
    ],
)
def test_first_sample_of_his_file(pt4, method, stored, relative, n, r):
    t, clean, found = pt4
    assert legacy.rmse(found[method], t, clean) == pytest.approx(stored, rel=relative)
    assert found[method].n == n
    assert found[method].r == pytest.approx(r, abs=5e-5)


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
    ("family", "n", "r", "curve", "printed", "digits"),
    [
        (Hudzovic, 3, 0.4, "tu_tg", 0.1653, 4),
        (Hudzovic, 3, 0.4, "inv_tg", 0.10735, 4),
        (Hudzovic, 3, 0.3479, "lam", 1.767, 3),
        (Hudzovic, 3, 0.3479, "inv_t50", 0.2007, 3),
        (Sani, 4, 0.9, "tu_tg", 0.3169, 3),
        (Sani, 4, 0.9, "inv_tg", 0.26, 2),
    ],
)
def test_example_lookups_of_figures_3_to_5(family, n, r, curve, printed, digits):
    table = legacy.tables(family)[n - 2]
    value = legacy.spline(table.r, getattr(table, curve))(r)
    assert value == pytest.approx(printed, abs=0.5 * 10.0**-digits)
    exact = getattr(lookup_curves(family, n, r), curve)
    assert value == pytest.approx(exact, rel=2e-3)


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
