"""Numbers, transfer functions and units as text; host code."""

import math
import re
from collections.abc import Iterator

import numpy as np

from ._plants import SOPDT, AbstractPlant, EqualLag, parameter_names


# Numbers and transfer functions


def number(x, digits: int = 4) -> str:
    """A number with so many significant digits, without an exponent where it is short."""
    x = _value(x)
    if not math.isfinite(x):
        return "-" if math.isnan(x) else f"{x:g}"
    size = math.floor(math.log10(abs(float(f"{x:.{digits - 1}e}")))) if x else 0
    if not -4 <= size <= 5:
        return f"{x:.{digits - 1}e}"
    decimals = max(0, digits - 1 - size)
    text = f"{x:.{decimals}f}"
    return text.rstrip("0").rstrip(".") if decimals else text


def _value(x) -> float:
    return float(np.asarray(x))


def transfer_function_text(model: AbstractPlant) -> str:
    """G(s) as one line, e.g. `0.6435 exp(-12.3 s) / ((1 + 152.1 s)(1 + 12.2 s)^2)`."""
    if not _is_finite(model):
        return "none"
    numerator = number(model.gain)
    if delay := _value(model.delay):
        numerator += f" exp({number(-delay)} s)"
    factors = [f"({base})" + (power and f"^{power}") for base, power in _factors(model)]
    if not factors:
        return numerator
    denominator = "".join(factors)
    return f"{numerator} / ({denominator})" if len(factors) > 1 else f"{numerator} / {denominator}"


def transfer_function_latex(model: AbstractPlant) -> str:
    r"""G(s) for LaTeX, e.g. `\frac{0.6435\,e^{-12.3 s}}{(1 + 152.1 s)(1 + 12.2 s)^{2}}`."""
    if not _is_finite(model):
        return r"\text{none}"
    numerator = number(model.gain)
    if delay := _value(model.delay):
        numerator += rf"\,e^{{{number(-delay)} s}}"
    factors = [f"({base})" + (power and f"^{{{power}}}") for base, power in _factors(model)]
    text = rf"\frac{{{numerator}}}{{{''.join(factors)}}}" if factors else numerator
    text = re.sub(r"\bs\^(\d)", r"s^{\1}", text)
    return re.sub(r"e([+-])0*(\d+)\b", lambda m: rf" \times 10^{{{m[1].strip('+')}{m[2]}}}", text)


STYLES = {"text": transfer_function_text, "latex": transfer_function_latex}
"""Ways of writing a transfer function."""


def transfer_function(model: AbstractPlant, style: str = "text") -> str:
    """G(s) in one of `STYLES`."""
    if style not in STYLES:
        raise ValueError(f"style must be one of {', '.join(STYLES)}, got {style!r}.")
    return STYLES[style](model)


def _is_finite(model: AbstractPlant) -> bool:
    return all(np.all(np.isfinite(getattr(model, name))) for name in parameter_names(model))


def _factors(model: AbstractPlant) -> Iterator[tuple[str, str]]:
    """Factors of the denominator and their powers, empty for 1; slowest first."""
    if isinstance(model, SOPDT) and (zeta := _value(model.zeta)) < 1:
        omega = _value(model.omega_n)
        yield f"1 + {number(2 * zeta / omega)} s + {number(omega**-2)} s^2", ""
        return
    if isinstance(model, EqualLag):
        powers = {number(model.T): _value(model.n)}
    else:
        lags = np.sort(np.asarray(model.lags, float))[::-1]  # type: ignore[attr-defined]
        shown = [number(lag) for lag in lags if lag > 1e-9 * lags[0]]
        powers = {lag: float(shown.count(lag)) for lag in shown}
    for lag, power in powers.items():
        yield f"1 + {lag} s", "" if power == 1 else number(power)


# Units
