"""High-precision step responses and their derivatives, by partial fractions.

Equal lags are spread by a relative 1e-45, which changes the response by about as little; the
partial fractions of n of them then lose 45 (n-1) digits. Derivatives are differences over a
relative 1e-35: exact to some 30 digits.
"""

import mpmath
from mpmath import mp, mpf


SPREAD = mpf(10) ** -45
STEP = mpf(10) ** -35
FORGOTTEN = 2000  # exp(-2000) is below every digit that is kept


def exact(x) -> mpmath.mpf:
    """The exact value of a float of any width."""
    return mpf(float(x))


def hudzovic_lags(p):
    return [p["T"] / (1 - k * p["r"]) for k in range(p["n"])]


def sani_lags(p):
    return [p["T"] * p["r"] ** k for k in range(p["n"])]


def listed_lags(p):
    return [p[f"lag{k}"] for k in range(p["n"])]


def chain(t, lags):
    """1/prod(1 + s T_k); a lag of 0 is no lag."""
    lags = [T * (1 + SPREAD * (k + 1)) for k, T in enumerate(lags) if T != 0]
    total = mpf(1)
    for j, a in enumerate(lags):
        if t / a > FORGOTTEN:
            continue
        residue = mpmath.exp(-t / a)
        for k, b in enumerate(lags):
            if k != j:
                residue *= a / (a - b)
        total -= residue
    return total


def equal_lags(t, T, n):
    """1/(1 + s T)^n for real n: the gamma distribution function."""
    return mpmath.gammainc(n, 0, t / T, regularized=True)


def second_order(t, zeta, omega_n):
    root = mpmath.sqrt(mpmath.mpc((zeta * (1 + SPREAD)) ** 2 - 1))
    a, b = omega_n * (zeta - root), omega_n * (zeta + root)
    return (1 - (b * mpmath.exp(-a * t) - a * mpmath.exp(-b * t)) / (b - a)).real


def second_order_zero(t, zeta, omega_n, lead):
    """Without the zero, plus lead times its slope."""
    root = mpmath.sqrt(mpmath.mpc((zeta * (1 + SPREAD)) ** 2 - 1))
    a, b = omega_n * (zeta - root), omega_n * (zeta + root)
    slope = a * b * (mpmath.exp(-a * t) - mpmath.exp(-b * t)) / (b - a)
    return second_order(t, zeta, omega_n) + lead * slope.real


def lagged_ramp(t, T):
    """1/(s (1 + s T)); a lag of 0 is no lag."""
    return t - T * (1 - mpmath.exp(-t / T)) if T else t


UNIT_RESPONSE = {
    "Hudzovic": lambda t, p: chain(t, hudzovic_lags(p)),
    "Sani": lambda t, p: chain(t, sani_lags(p)),
    "EqualLag": lambda t, p: equal_lags(t, p["T"], p["n"]),
    "PTn": lambda t, p: chain(t, listed_lags(p)),
    "FOPDT": lambda t, p: chain(t, [p["T"]]),
    "SOPDT": lambda t, p: second_order(t, p["zeta"], p["omega_n"]),
    "SOPDTZero": lambda t, p: second_order_zero(t, p["zeta"], p["omega_n"], p["lead"]),
    "IPDT": lambda t, p: lagged_ramp(t, p["T"]),
}
LEVELS = {"gain": mpf(1), "offset": mpf(0), "delay": mpf(0)}


def enough_digits(family, parameters):
    """Working precision: 60 digits remain after partial fractions and a difference."""
    lags = 1 if family == "EqualLag" else parameters.get("n", 1)
    return mp.workdps(100 + 45 * lags)


def unit_response(family: str, elapsed, p):
    return UNIT_RESPONSE[family](elapsed, p) if elapsed > 0 else mpf(0)


def step_response(family: str, t, parameters: dict) -> mpmath.mpf:
    """Response of a model whose parameters are exact numbers; a whole `n` is a Python int."""
    with enough_digits(family, parameters):
        p = LEVELS | parameters
        return p["offset"] + p["gain"] * unit_response(family, mpf(t) - p["delay"], p)


def derivatives(family: str, t, parameters: dict) -> dict[str, mpmath.mpf]:
    """Derivatives with respect to every parameter and `t`; up to the delay all but one are 0.

    One-sided at a parameter of 0, where the range of r and of a lag ends.
    """
    with enough_digits(family, parameters):
        p = LEVELS | parameters
        elapsed = mpf(t) - p["delay"]

        def difference(name):
            size = STEP * (abs(p[name]) or mpf(10) ** -12)
            up, down = size, (-size if p[name] else 0)
            responses = [
                unit_response(family, elapsed, p | {name: p[name] + h}) for h in (up, down)
            ]
            return p["gain"] * (responses[0] - responses[1]) / (up - down)

        own = [k for k, v in p.items() if k not in LEVELS and not isinstance(v, int)]
        h = STEP * abs(elapsed)
        ahead, behind = (unit_response(family, elapsed + s * h, p) for s in (1, -1))
        slope = p["gain"] * (ahead - behind) / (2 * h) if elapsed > 0 else mpf(0)
        return {name: difference(name) for name in own} | {
            "t": slope,
            "delay": -slope,
            "gain": unit_response(family, elapsed, p),
            "offset": mpf(1),
        }
