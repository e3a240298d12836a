"""Plants as poles and residues in NumPy, so that any of them answers exactly at any time.

The five examples of the paper, the two rigs as simulated surrogates, and random plants in the four
classes of the notes: overdamped, underdamped, oscillatory, and of higher order.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy import linalg


@dataclass(frozen=True)
class Plant:
    """gain * prod(1 + s z) / prod(1 + s a + s^2 b) * exp(-s delay); `factors` are pairs (a, b)."""

    factors: tuple[tuple[float, float], ...]
    zeros: tuple[float, ...] = ()
    gain: float = 1.0
    delay: float = 0.0
    name: str = field(default="", compare=False)

    def poles(self):
        found = [np.roots([b, a, 1.0] if b else [a, 1.0]) for a, b in self.factors]
        return np.concatenate(found).astype(complex)

    def rest(self, t):
        """1 - g at times `t` > 0 after the delay: by residues, equal poles by the exponential of a
        companion matrix."""
        poles = self.poles()
        apart = np.abs(poles[:, None] - poles) + np.eye(len(poles)) * np.abs(poles)
        numerator = np.poly1d([1.0])
        for zero in self.zeros:
            numerator *= np.poly1d([zero, 1.0])
        if np.min(apart / np.abs(poles)) > 1e-3:
            products = [np.prod(-np.delete(poles, k) / (p - np.delete(poles, k)))
                        for k, p in enumerate(poles)]  # fmt: skip
            residues = numerator(poles) * np.array(products)
            return np.real(np.sum(residues[:, None] * np.exp(poles[:, None] * t), axis=0))
        denominator = np.real(np.poly(poles))
        companion = np.eye(len(poles), k=1)
        companion[-1] = -denominator[:0:-1]
        output = np.zeros(len(poles))
        output[: len(numerator) + 1] = numerator.coeffs[::-1] * denominator[-1]
        start = np.linalg.solve(companion, -np.eye(len(poles))[-1])
        return linalg.expm(companion * t[:, None, None]) @ start @ output

    def response(self, t):
        """Step response at times `t`."""
        since = np.asarray(t, float) - self.delay
        after = since > 0
        y = np.zeros(since.shape)
        y[after] = self.gain * (1 - self.rest(since[after]))
        return y

    def settling_time(self, band=0.02):
        """Time after the delay from which on the response stays within a band of its end."""
        t = np.linspace(0, 12 / np.min(-np.real(self.poles())), 20_001)
        outside = np.abs(self.response(t + self.delay) / self.gain - 1) > band
        return t[len(t) - 1 - np.argmax(outside[::-1])]


def mode(zeta, omega_n):
    """Factor of a pair of poles."""
    return (2 * zeta / omega_n, omega_n**-2)


def lags(*values):
    return tuple((value, 0.0) for value in values)


EXAMPLES = {
    1: Plant(
        (*lags(1, 1 / 2, 1 / 4, 1 / 8, 1 / 16),), (1 / 1.5, 1 / 3, 1 / 6),
        100 * 1.5 * 3 * 6 / (1 * 2 * 4 * 8 * 16), 0.5, "Example 1",
    ),
    2: Plant((mode(0.5, 10.0),), (), 10.0, 0.1, "Example 2"),
    3: Plant((mode(0.2, 10.0), *lags(0.05)), (), 10.0, 0.0, "Example 3"),
    4: Plant(lags(1, 1, 1, 1, 1), (), 1.0, 0.0, "Example 4"),
    5: Plant(lags(1, 1, 2, 2, 2), (), 1.08, 10.0, "Example 5"),
}  # fmt: skip

RIGS = {
    "six tanks (simulated)": Plant(
        lags(16.31, 16.31, 16.31, 16.31, 1.63, 1.63), (), 0.82, 0.0, "six tanks (simulated)"
    ),
    "mass-spring-damper (simulated)": Plant(
        (mode(0.0625, 20.1), mode(0.10, 40.2)), (), 1.822, 0.10, "mass-spring-damper (simulated)"
    ),
}
"""Surrogates that give models like the published ones: no record of the rigs was published."""

CLASSES = ("over", "under", "osc", "high")


def random_plant(generator, kind, number):
    """One plant of a class, in its own unit of time; three in ten have no dead time."""
    uniform, zeros = generator.uniform, ()
    if kind == "over":
        factors = lags(*np.exp(uniform(np.log(0.2), np.log(5), generator.integers(2, 6))))
    elif kind == "under":
        zeta = uniform(0.5, 1.0)
        factors = (mode(zeta, 1.0),)
        if number % 2:
            factors += lags(uniform(0.1, 1.0))
    elif kind == "osc":
        factors = (mode(np.exp(uniform(np.log(0.03), np.log(0.45))), 1.0),)
    else:
        factors, zeros = _high(generator, number % 3)
    plant = Plant(factors, zeros)
    delay = 0.0 if uniform() < 0.3 else uniform(0.02, 0.5) * plant.settling_time()
    return Plant(factors, zeros, 1.0, delay, f"{kind} {number}")


def _high(generator, case):
    uniform = generator.uniform
    if case == 0:  # a zero and three lags
        return lags(uniform(0.5, 2), uniform(0.2, 1), uniform(0.1, 0.5)), (uniform(0.2, 1.5),)
    if case == 1:  # two resonances
        factors = mode(uniform(0.1, 0.4), 1.0), mode(uniform(0.1, 0.4), uniform(2.5, 5.0))
        return factors, ()
    return lags(uniform(0.5, 2), uniform(0.5, 2), uniform(0.2, 1)), (-uniform(0.1, 0.6),)


def random_records(seed, each=50, samples=401):
    """Plants of the four classes, times and clean responses, one row each."""
    generator = np.random.default_rng(seed)
    plants = [random_plant(generator, kind, k) for kind in CLASSES for k in range(each)]
    ends = [p.delay + generator.uniform(1, 1.5) * p.settling_time() for p in plants]
    t = np.array([np.linspace(0, end, samples) for end in ends])
    return plants, t, np.array([p.response(row) for p, row in zip(plants, t, strict=True)])
