"""Numbers and transfer functions as text."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from stepax import FOPDT, IPDT, SOPDT, EqualLag, Hudzovic, PTn, Sani, SOPDTZero
from stepax.models._notation import number, transfer_function_latex, transfer_function_text


@pytest.mark.parametrize(
    ("x", "text"),
    [
        (0, "0"),
        (12.3, "12.3"),
        (0.64351, "0.6435"),
        (152.13, "152.1"),
        (123456.7, "123457"),
        (9.99999, "10"),
        (-2.5, "-2.5"),
        (1.5e-7, "1.500e-07"),
        (2.3e9, "2.300e+09"),
        (math.nan, "-"),
        (100, "100"),
    ],
)
def test_number(x, text):
    assert number(x) == text


@pytest.mark.parametrize(
    ("model", "text"),
    [
        (
            PTn(lags=np.array([12.2, 0.0, 152.1]), gain=0.64351, delay=12.3),
            "0.6435 exp(-12.3 s) / ((1 + 152.1 s)(1 + 12.2 s))",
        ),
        (PTn(lags=np.zeros(2), gain=-2.0), "-2"),
        (FOPDT(T=3.0), "1 / (1 + 3 s)"),
        (EqualLag(T=2.3, n=3), "1 / (1 + 2.3 s)^3"),
        (EqualLag(T=2.3, n=2.5), "1 / (1 + 2.3 s)^2.5"),
        (EqualLag(T=2.3, n=1), "1 / (1 + 2.3 s)"),
        (Sani(T=4.0, r=1.0, n=2, gain=2.0), "2 / (1 + 4 s)^2"),
        (Sani(T=4.0, r=0.5, n=jnp.asarray(3)), "1 / ((1 + 4 s)(1 + 2 s)(1 + 1 s))"),
        (Hudzovic(T=1.0, r=0.5, n=2), "1 / ((1 + 2 s)(1 + 1 s))"),
        (SOPDT(zeta=0.2, omega_n=0.5, delay=1.0), "1 exp(-1 s) / (1 + 0.8 s + 4 s^2)"),
        (SOPDT(zeta=1.0, omega_n=0.5), "1 / (1 + 2 s)^2"),
        (
            SOPDTZero(zeta=0.2, omega_n=0.5, lead=-0.8, gain=2.0, delay=3.0),
            "2 (1 - 0.8 s) exp(-3 s) / (1 + 0.8 s + 4 s^2)",
        ),
        (SOPDTZero(zeta=1.25, omega_n=0.5, lead=6), "1 (1 + 6 s) / ((1 + 4 s)(1 + 1 s))"),
        (SOPDTZero(zeta=1.0, omega_n=0.5, lead=0), "1 / (1 + 2 s)^2"),
        (IPDT(T=3.0, gain=0.5), "0.5 / (s(1 + 3 s))"),
        (IPDT(T=0.0, gain=-0.5, delay=2.0), "-0.5 exp(-2 s) / s"),
        (IPDT(T=math.nan), "none"),
        (FOPDT(T=math.nan), "none"),
    ],
)
def test_transfer_function(model, text):
    assert transfer_function_text(model) == text


@pytest.mark.parametrize(
    ("model", "latex"),
    [
        (FOPDT(T=10.0, gain=2.0, delay=1.5), r"\frac{2\,e^{-1.5 s}}{(1 + 10 s)}"),
        (EqualLag(T=1e-7, n=3), r"\frac{1}{(1 + 1.000 \times 10^{-7} s)^{3}}"),
        (
            SOPDTZero(zeta=1.0, omega_n=0.5, lead=-0.8, gain=2.0, delay=3.0),
            r"\frac{2\,(1 - 0.8 s)\,e^{-3 s}}{(1 + 2 s)^{2}}",
        ),
        (IPDT(T=3.0, gain=0.5), r"\frac{0.5}{s(1 + 3 s)}"),
        (IPDT(T=0.0, gain=0.5), r"\frac{0.5}{s}"),
        (SOPDT(zeta=0.5, omega_n=2.0, gain=-1.0), r"\frac{-1}{(1 + 0.5 s + 0.25 s^{2})}"),
    ],
)
def test_latex(model, latex):
    assert transfer_function_latex(model) == latex
