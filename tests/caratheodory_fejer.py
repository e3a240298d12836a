r"""Near-best rational approximation of the exponential on the negative axis, in mpmath.

The Caratheodory-Fejer method as in Trefethen, Weideman, Schmelzer (2006), "Talbot quadratures and
rational approximations", BIT 46, 653-670, section 4 and the function `cf` printed there:

1. The map $x = 9 (\cos\theta - 1)/(\cos\theta + 1)$ takes the half axis to the unit circle
   $w = e^{i\theta}$, and $e^x$ to a Chebyshev series with coefficients $c_k$.
2. With singular value $\sigma$ number n (from 0) and vector v of the Hankel matrix
   $(c_{i+j+1})$, the function $\sum c_k w^k - \pm\sigma\, w\, v(w)/v(1/w)$ is the best
   approximation on the circle of the analytic part among functions with n poles outside it.
3. Its n poles $q$ there are the inverse zeros of v inside the circle; what else it has is
   negligible and dropped. Mapped back, they and their residues are the result.
"""

from collections.abc import Callable

import mpmath
from mpmath import mp, mpf


TERMS = 80  # Chebyshev coefficients
SAMPLES = 256  # points on the circle
SCALE = 9  # where the map puts the middle of the half axis
DIGITS = 60


def poles_and_weights(pairs: int) -> list[tuple[complex, complex]]:
    """Poles z in the upper half plane, and weights w = -2 residue/z; ascending imaginary part."""
    with mp.workdps(DIGITS):
        return sorted(
            ((complex(z), complex(-2 * c / z)) for z, c in approximation(2 * pairs) if z.imag > 0),
            key=lambda pair: pair[0].imag,
        )


def approximation(n: int) -> list[tuple]:
    """Poles and residues, of $e^x$ by type (n-1, n)."""
    circle = [mpmath.expjpi(mpf(2 * j) / SAMPLES) for j in range(SAMPLES)]
    series = chebyshev_coefficients(circle)
    sigma, vector = singular_pair(series, n)

    def extended(w):
        return polynomial(series, w) - sigma * w * polynomial(vector, w) / polynomial(vector, 1 / w)

    inverse_zeros = mpmath.polyroots(vector[::-1], maxsteps=500, extraprec=400, asc=True)
    outside = [q for q in inverse_zeros if abs(q) > 1]
    assert len(outside) == n
    return [
        (SCALE * ((q - 1) / (q + 1)) ** 2, 4 * c * SCALE * ((q - 1) / (q + 1)) ** 2 / (q * q - 1))
        for q, c in zip(outside, residues(extended, outside, circle), strict=True)
    ]


def polynomial(coefficients: list, x):
    """Value of a polynomial with ascending coefficients."""
    value = mpf(0)
    for c in reversed(coefficients):
        value = value * x + c
    return value


def chebyshev_coefficients(circle: list) -> list:
    """Coefficients c_0 ... c_TERMS of $e^x$ on the circle, each of w^k and w^-k."""
    cosines = [w.real for w in circle]
    half = SAMPLES // 2  # theta = pi is x = -infinity
    f = [
        mpf(0) if j == half else mpmath.exp(SCALE * (t - 1) / (t + 1))
        for j, t in enumerate(cosines)
    ]
    return [
        sum(f[j] * cosines[j * k % SAMPLES] for j in range(SAMPLES)) / SAMPLES
        for k in range(TERMS + 1)
    ]


def singular_pair(series: list, n: int) -> tuple:
    """Eigenvalue of the n-th largest modulus, from 0, of the Hankel matrix, and its vector."""
    hankel = mpmath.zeros(TERMS)
    for i in range(TERMS):
        for j in range(TERMS - i):
            hankel[i, j] = series[i + j + 1]
    values, vectors = mpmath.eigsy(hankel)
    k = sorted(range(TERMS), key=lambda i: -abs(values[i]))[n]
    return values[k], [vectors[i, k] for i in range(TERMS)]


def residues(function: Callable, poles: list, circle: list) -> list:
    """Residues at poles outside the circle, from values on it: Laurent terms below 0 dropped."""

    def others(w, q=None):
        return mpmath.fprod(w - p for p in poles if p is not q)

    values = [function(w) * others(w) for w in circle]
    numerator = [
        (sum(y * circle[-j * k % SAMPLES] for j, y in enumerate(values)) / SAMPLES).real
        for k in range(len(poles) + 1)
    ]
    return [polynomial(numerator, q) / others(q, q) for q in poles]
