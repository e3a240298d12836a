"""The steps in a sampled input; host code."""

import operator
from typing import Any, SupportsIndex

import numpy as np


def find_steps(u: np.ndarray) -> list[tuple[int, float]]:
    """Steps of an input: the first row with a new value, and the mean level after less before.

    A change counts above 4 times the noise of u and 2 % of the largest change. Changes in one
    direction with at most two rows between them are a ramp: one step. Its size is at least 6 times
    the noise and 5 % of the largest: one of 10 times the noise is found.
    """
    change = np.diff(u)
    noise = _noise(u)
    # A difference of two rows has sqrt(2) of the noise: a row in 200 passes 4 times by chance, and
    # the means below drop it. Higher, and ramps fall apart; lower, and noise is taken for the end
    # of a ramp. The share keeps the ripple of a clean input out, yet a ramp with a slow end whole.
    limit = max(4 * noise, 0.02 * np.max(np.abs(change)))
    ramps: list[tuple[int, int]] = []
    for row in np.flatnonzero(np.abs(change) > limit).tolist():
        first, last = ramps[-1] if ramps else (row, row)
        # Actuators and anti-aliasing filters take a few rows; `test_ramp_is_one_step`.
        if ramps and row - last <= 3 and (change[row] > 0) == (change[last] > 0):
            ramps[-1] = first, row
        else:
            ramps.append((row, row))
    # Means hold many rows, so 6 times is far from chance, and 10 times still passes with the error
    # of short pieces: `test_steps_in_noise`, `test_small_changes_beside_a_large_step`.
    sizes = np.abs(np.diff(_levels(u, ramps)))
    enough = sizes >= max(6 * noise, 0.05 * np.max(sizes, initial=0.0))
    ramps = [ramp for ramp, holds in zip(ramps, enough, strict=True) if holds]
    sizes = np.diff(_levels(u, ramps)).tolist()
    return [(first + 1, size) for (first, _), size in zip(ramps, sizes, strict=True)]


def _levels(u: np.ndarray, ramps: list[tuple[int, int]]) -> list[float]:
    """Means of an input before, between and after ramps, given by their first and last changes."""
    starts, stops = [0] + [last + 1 for _, last in ramps], [first + 1 for first, _ in ramps]
    return [float(np.mean(u[a:b])) for a, b in zip(starts, [*stops, u.size], strict=True)]


def _noise(u: np.ndarray) -> float:
    """Noise of an input, at least 1e-10 of its largest value (rounding is no step).

    From the upper quartile of the second differences: 1.15 sqrt(6) sigma for Gaussian noise, and
    0 for a clean input whose steps are at least 8 rows apart.
    """
    quartile = np.quantile(np.abs(np.diff(u, 2)), 0.75, method="lower")
    return max(float(quartile) / (1.15 * np.sqrt(6)), 1e-10 * float(np.max(np.abs(u))))


def constant_level(u: np.ndarray, where: str) -> float:
    """Level of an input without steps: that of a step from 0 at the first row."""
    if not is_constant(u):
        raise ValueError(f"{where} has no step: it lies from {u.min():g} to {u.max():g}.")
    return float(np.mean(u))


def is_constant(u: np.ndarray) -> bool:
    """Whether an input is constant but for noise, and not 0."""
    # 12 times: the range of 10^6 rows of Gaussian noise is 10 times; `test_constant_input_...`.
    level, spread = float(np.mean(u)), float(np.ptp(u))
    return bool(level != 0 and spread <= min(abs(level), 12 * _noise(u)))


def choice(step: Any, steps: list[tuple[float, float]], where: str) -> int:
    """Index of a step counted from 1, or from the last."""
    if isinstance(step, bool) or not isinstance(step, SupportsIndex):
        raise TypeError(f"step must be a whole number counted from 1, got {step!r}.")
    step = operator.index(step)
    count, times = len(steps), ", ".join(f"{time:g}" for time, _ in steps)
    if not 1 <= abs(step) <= count:
        raise ValueError(
            f"{where} has no step {step}: there {'is 1' if count == 1 else f'are {count}'},"
            f" at t = {times}."
        )
    return step - 1 if step > 0 else count + step
