"""High-precision step responses: partial fractions at 400 digits, lags spread by 1e-45.

Spreading equal lags by a relative 1e-45 changes the response by about as little; the partial
fractions then lose at most 315 digits of 420.
"""

import mpmath
from mpmath import mp, mpf


DIGITS = 420


def exact(x) -> mpf:
    """The exact value of a float of any width."""
    return mpf(float(x))


def hudzovic_lags(p):
    return [p["T"] / (1 - k * p["r"]) for k in range(p["n"])]


def sani_lags(p):
    return [p["T"] * p["r"] ** k for k in range(p["n"])]


def chain(t, lags):
    """Unit step response of a chain at one time."""
    lags = [T * (1 + mpf(10) ** -45 * (k + 1)) for k, T in enumerate(lags) if T != 0]
    if t <= 0:
        return mpf(0)
    total = mpf(1)
    for j, a in enumerate(lags):
        c = mpf(1)
        for k, b in enumerate(lags):
            if k != j:
                c *= a / (a - b)
        total -= c * mpmath.exp(-t / a)
    return total


def gamma(t, p):
    return mpmath.gammainc(p["n"], 0, t / p["T"], regularized=True) if t > 0 else mpf(0)


def second_order(t, p):
    zeta, w = p["zeta"] * (1 + mpf(10) ** -45), p["omega_n"]
    if t <= 0:
        return mpf(0)
    root = mpmath.sqrt(mpmath.mpc(zeta**2 - 1))
    a, b = w * (zeta - root), w * (zeta + root)
    return (1 - (b * mpmath.exp(-a * t) - a * mpmath.exp(-b * t)) / (b - a)).real


UNIT = {
    "Hudzovic": lambda t, p: chain(t, hudzovic_lags(p)),
    "Sani": lambda t, p: chain(t, sani_lags(p)),
    "EqualLag": gamma,
    "PTn": lambda t, p: chain(t, [p[f"lag{k}"] for k in range(p["n"])]),
    "FOPDT": lambda t, p: chain(t, [p["T"]]),
    "SOPDT": second_order,
}


def step_response(family: str, t, parameters: dict):
    """Response of a model with parameters given as exact numbers."""
    with mp.workdps(DIGITS):
        p = {k: v if k == "n" and isinstance(v, int) else mpf(v) for k, v in parameters.items()}
        g = UNIT[family](mpf(t) - p.get("delay", 0), p)
        return p.get("offset", 0) + p.get("gain", 1) * g


def derivative(family: str, t, parameters: dict, name: str):
    """Central difference at 420 digits: exact to about 30 digits of the parameter."""
    with mp.workdps(DIGITS):
        if name == "t":
            h = mpf(10) ** -35 * max(mpf(1), abs(mpf(t)))
            return (
                step_response(family, t + h, parameters) - step_response(family, t - h, parameters)
            ) / (2 * h)
        h = mpf(10) ** -35 * max(mpf(10) ** -12, abs(parameters[name]))
        up, down = (
            step_response(family, t, parameters | {name: parameters[name] + s * h}) for s in (1, -1)
        )
        return (up - down) / (2 * h)
