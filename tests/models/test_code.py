"""Models as code to paste, run or evaluated, against their frequency response."""

import re

import numpy as np
import pytest

from stepax import FOPDT, IPDT, SOPDT, EqualLag, Hudzovic, PTn, Sani, SOPDTZero
from stepax.models._export import polynomials
from stepax.models._notation import transfer_function


COMMON = {"gain": -2.0, "offset": 3.0}
MODELS = [
    FOPDT(T=8.0, **COMMON),
    SOPDT(zeta=0.4, omega_n=0.5, **COMMON),
    SOPDTZero(zeta=0.7, omega_n=0.4, lead=-3.0, **COMMON),
    IPDT(T=6.0, **COMMON),
    Hudzovic(T=3.0, r=0.2, n=4, **COMMON),
    Sani(T=8.0, r=1.0, n=3, **COMMON),
    EqualLag(T=4.0, n=3, **COMMON),
    PTn(lags=[8.0, 2.0, 0.0], **COMMON),
]
OMEGA = np.geomspace(0.01, 3.0, 20)
each = pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)


def with_delay(model, delay):
    fields = {name: getattr(model, name) for name in model.__dataclass_fields__}
    return type(model)(**fields | {"delay": delay})


@each
def test_python_control_code_runs(model):
    pytest.importorskip("control")
    for delay in (0.0, 1.5):
        names = {}
        exec(transfer_function(with_delay(model, delay), "python-control"), names)
        found = names["G"](1j * OMEGA[:12])
        # Pade's approximation of order 3 of a delay of 1.5 s, up to 0.2 rad/s
        expected = with_delay(model, delay).frequency_response(OMEGA[:12])
        np.testing.assert_allclose(found, expected, rtol=1e-8 if not delay else 1e-5)


@each
def test_matlab_code_means_the_model(model):
    """Its expression, with a power written as Python has it, at points of the imaginary axis."""
    model = with_delay(model, 1.5)
    code = transfer_function(model, "matlab")
    expression = re.fullmatch(r"s = tf\('s'\); G = (.*);", code)
    assert expression is not None
    names = {"s": 1j * OMEGA, "exp": np.exp, "__builtins__": {}}
    found = eval(expression[1].replace("^", "**"), names)
    np.testing.assert_allclose(found, model.frequency_response(OMEGA), rtol=1e-8)


@each
def test_polynomials(model):
    numerator, denominator = polynomials(model)
    found = np.polyval(numerator, 1j * OMEGA) / np.polyval(denominator, 1j * OMEGA)
    np.testing.assert_allclose(found, model.frequency_response(OMEGA), rtol=1e-10)


def test_a_real_order_has_no_code():
    model = EqualLag(T=2.0, n=2.5)
    assert polynomials(model) is None
    for style in ("matlab", "python-control"):
        with pytest.raises(ValueError, match=r"a real order, 2\.5,"):
            transfer_function(model, style)


@each
def test_scipy_code_runs(model):
    names = {}
    model = with_delay(model, 1.5)
    exec(transfer_function(model, "scipy"), names)
    found = names["G"].freqresp(OMEGA)[1] * np.exp(-1j * OMEGA * names["delay"])
    np.testing.assert_allclose(found, model.frequency_response(OMEGA), rtol=1e-7)
