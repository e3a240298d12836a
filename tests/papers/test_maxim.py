"""The paper's own numbers: the MSE of its printed models, and where they are misprints."""

import numpy as np
import pytest
from experiments.maxim.plants import CLASSES, EXAMPLES, Plant, lags, mode, random_records
from experiments.maxim.published import PRINTED, SETTINGS
from scipy import signal


MISPRINTED = {(5, "RDKAM"): 1.44, (4, "TFEST"): 1.24, (5, "TFEST"): 1.36}
"""MSE of the printed model over the printed MSE, where they are not those of each other."""

CASES = [(number, model) for number, models in PRINTED.items() for model in models]


@pytest.mark.parametrize(("number", "model"), CASES, ids=lambda x: getattr(x, "method", x))
def test_printed_models_have_the_printed_errors(number, model):
    setting = SETTINGS[number]
    t = setting.interval * np.arange(setting.samples)
    error = np.mean((model.plant.response(t) - EXAMPLES[number].response(t)) ** 2)
    factor = MISPRINTED.get((number, model.method), 1.0)
    np.testing.assert_allclose(error, factor * model.mse, rtol=0.02)


@pytest.mark.parametrize("factors", [lags(1, 1, 2, 2, 2), (mode(0.2, 3.0), *lags(0.5))])
@pytest.mark.parametrize("zeros", [(), (-0.7,)])
def test_plants_answer_as_in_scipy(factors, zeros):
    plant = Plant(factors, zeros, 2.0, 1.0)
    below, above = np.ones(1), np.ones(1)
    for a, b in factors:
        below = np.polymul(below, [b, a, 1] if b else [a, 1])
    for zero in zeros:
        above = np.polymul(above, [zero, 1])
    t = np.linspace(0, 15, 200)
    expected = 2 * signal.step((above, below), T=t)[1]
    np.testing.assert_allclose(plant.response(t + 1.0), expected, atol=1e-9)


def test_random_records_have_four_classes_and_settle():
    plants, t, y = random_records(1, each=4, samples=50)
    assert [plant.name.split()[0] for plant in plants] == [k for k in CLASSES for _ in range(4)]
    assert np.allclose(y[:, -1], 1, atol=0.021) and t.shape == y.shape == (16, 50)
