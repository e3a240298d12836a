"""Numbers and transfer functions as text; host code."""

import math
import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from ._abstract import AbstractPlant, Factor
from ._export import polynomials


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
    above = [base + (power and f"^{power}") for base, power in _grouped(model.numerator())]
    numerator = " ".join([number(model.gain), *above])
    if delay := _value(model.delay):
        numerator += f" exp({number(-delay)} s)"
    factors = [base + (power and f"^{power}") for base, power in _grouped(model.denominator())]
    if not factors:
        return numerator
    denominator = "".join(factors)
    return f"{numerator} / ({denominator})" if len(factors) > 1 else f"{numerator} / {denominator}"


def transfer_function_latex(model: AbstractPlant) -> str:
    r"""G(s) for LaTeX, e.g. `\frac{0.6435\,e^{-12.3 s}}{(1 + 152.1 s)(1 + 12.2 s)^{2}}`."""
    if not _is_finite(model):
        return r"\text{none}"
    above = [base + (power and f"^{{{power}}}") for base, power in _grouped(model.numerator())]
    numerator = r"\,".join([number(model.gain), *above])
    if delay := _value(model.delay):
        numerator += rf"\,e^{{{number(-delay)} s}}"
    factors = [base + (power and f"^{{{power}}}") for base, power in _grouped(model.denominator())]
    text = rf"\frac{{{numerator}}}{{{''.join(factors)}}}" if factors else numerator
    text = re.sub(r"\bs\^(\d)", r"s^{\1}", text)
    return re.sub(r"e([+-])0*(\d+)\b", lambda m: rf" \times 10^{{{m[1].strip('+')}{m[2]}}}", text)


class Language(NamedTuple):
    """How a program writes G(s).

    - `none`: a comment where there is no model. `code`: what stands around the fraction.
    - `power`: sign of a power. `dead`: factor for a dead time.
    """

    none: str
    code: str
    power: str
    dead: str


LANGUAGES = {
    # as MATLAB's Control System Toolbox takes it, the dead time as a factor exp(-L s)
    "matlab": Language("% none", "s = tf('s'); G = {};", "^", "*exp(-{}*s)"),
    # a dead time as Pade's approximation of order 3
    "python-control": Language(
        "# none",
        'import control; s = control.tf("s"); G = {}',
        "**",
        "*control.tf(*control.pade({}, 3))",
    ),
}


def code(model: AbstractPlant, language: Language) -> str:
    """G(s) to paste."""
    if not _is_finite(model):
        return language.none
    delay = _value(model.delay)
    dead = language.dead.format(_digits(delay)) if delay else ""
    return language.code.format(_rational(model, language.power, dead))


def _rational(model: AbstractPlant, power: str, dead: str) -> str:
    """Gain, dead time and factors as code, lowest powers of s first."""
    above, below = (
        "*".join(_code(factor, power) for factor in factors)
        for factors in (model.numerator(), model.denominator())
    )
    numerator = "*".join(filter(None, [_digits(_value(model.gain)), above])) + dead
    return f"{numerator}/({below})" if below else numerator


def _code(factor: Factor, power: str) -> str:
    """A polynomial in s to a power; a real order is no transfer function of these packages."""
    if factor.power != round(factor.power):
        raise ValueError(f"a real order, {number(factor.power)}, is no rational transfer function.")
    terms = [(k, x) for k, x in enumerate(factor.coefficients) if x]
    names = ["", "*s", f"*s{power}2"]
    text = " + ".join(f"{_digits(x)}{names[k]}" for k, x in terms).replace("+ -", "- ")
    return f"({text})" + (f"{power}{round(factor.power)}" if factor.power != 1 else "")


def _digits(x: float) -> str:
    """A number to ten digits: more than any record tells, and short where it is short."""
    return f"{x:.10g}"


def scipy_code(model: AbstractPlant) -> str:
    """G(s) for SciPy, whose transfer functions have no dead time: it stands beside."""
    if not _is_finite(model):
        return "# none"
    found = polynomials(model)
    if found is None:
        raise ValueError("a real order is no rational transfer function.")
    above, below = (", ".join(map(_digits, x)) for x in found)
    delay = _value(model.delay)
    beside = f"; delay = {_digits(delay)}  # times exp(-delay s)" if delay else ""
    return f"from scipy import signal; G = signal.TransferFunction([{above}], [{below}]){beside}"


def transfer_function_mathml(model: AbstractPlant) -> str:
    """G(s) as an HTML page sets it, in presentation MathML."""
    if not _is_finite(model):
        return "<math><mtext>none</mtext></math>"
    above, below = (
        "".join(
            f"<msup><mrow>{_marked(base)}</mrow>{_marked(power)}</msup>" if power else _marked(base)
            for base, power in _grouped(factors)
        )
        for factors in (model.numerator(), model.denominator())
    )
    numerator = _marked(number(model.gain)) + (above and SPACE + above)
    if delay := _value(model.delay):
        numerator += f"{SPACE}<msup><mi>e</mi><mrow>{_marked(number(-delay) + ' s')}</mrow></msup>"
    body = f"<mrow>{numerator}</mrow>"
    if below:
        body = f"<mfrac>{body}<mrow>{below}</mrow></mfrac>"
    alternative = transfer_function_text(model)
    return (
        f'<math display="block" alttext="{alternative}"><mrow class="name"><mi>G</mi>'
        f'<mo stretchy="false">(</mo><mi>s</mi><mo stretchy="false">)</mo><mo>=</mo></mrow>'
        f"{body}</math>"
    )


SPACE = '<mspace width="0.17em"/>'
"""Between a number and what it multiplies."""

_TOKEN = re.compile(r"(\d[\d.]*)(?:e([+-])0*(\d+))?|s\^(\d)|([s()+-])")


def _marked(text: str) -> str:
    """Numbers, s and signs of our own text as MathML, with invisible products."""
    marked = ""
    for digits, sign, exponent, power, symbol in _TOKEN.findall(text):
        if digits:
            marked += f"<mn>{digits}</mn>"
            if exponent:
                ten = f"{sign.strip('+').replace('-', '−')}{exponent}"
                marked += f"<mo>·</mo><msup><mn>10</mn><mn>{ten}</mn></msup>"
        elif power:
            marked += SPACE * marked.endswith("</mn>")
            marked += f"<msup><mi>s</mi><mn>{power}</mn></msup>"
        elif symbol == "s":
            marked += SPACE * marked.endswith("</mn>") + "<mi>s</mi>"
        elif symbol in "()":
            marked += f'<mo stretchy="false">{symbol}</mo>'
        else:
            marked += f"<mo>{symbol.replace('-', '−')}</mo>"
    return f"<mrow>{marked}</mrow>"


STYLES: dict[str, Callable[[AbstractPlant], str]] = {
    "text": transfer_function_text,
    "latex": transfer_function_latex,
    "mathml": transfer_function_mathml,
    "scipy": scipy_code,
    **{name: partial(code, language=language) for name, language in LANGUAGES.items()},
}
"""Ways of writing a transfer function."""


def transfer_function(model: AbstractPlant, style: str = "text") -> str:
    """G(s) in one of `STYLES`."""
    if style not in STYLES:
        raise ValueError(f"style must be one of {', '.join(STYLES)}, got {style!r}.")
    return STYLES[style](model)


def _is_finite(model: AbstractPlant) -> bool:
    return all(np.all(np.isfinite(getattr(model, name))) for name in model.parameter_names)


def _grouped(factors: list[Factor]) -> Iterator[tuple[str, str]]:
    """Factors as text and their powers, empty for 1; those that read the same are one."""
    powers: dict[str, float] = {}
    for factor in factors:
        text = _polynomial(factor.coefficients)
        powers[text] = powers.get(text, 0.0) + factor.power
    for text, power in powers.items():
        yield text, "" if power == 1 else number(power)


def _polynomial(coefficients: tuple[float, ...]) -> str:
    """`(1 + 2.5 s - 4 s^2)`, or `s` alone."""
    text = ""
    for k, value in enumerate(coefficients):
        if not value:
            continue
        name = ("", "s", f"s^{k}")[min(k, 2)]
        size = number(abs(value)) if value != 1 or not name or text else ""
        sign = (" - " if value < 0 else " + ") if text else "-" * (value < 0)
        text += sign + " ".join(filter(None, (size, name)))
    return text if text == "s" else f"({text})"
