"""What Prechar, the program of the paper, did to a step response; plain NumPy.

The paper does not say how it sampled and read. One law explains the printed parameters of every
cell that its formulae can give: a sampling interval of 0.002 times the sum of the time constants,
and the first sample at or above a level as the time of that level. Strejc's method read the output
without dividing it by the gain, and chose its order downwards (both inferred from tables 5 to 8).
"""

import numpy as np


STEP = 0.002
"""Sampling interval over the sum of the time constants."""
HORIZON = 10
"""Length of the records over the sum of the time constants."""
LEVELS = (0.10, 0.20, 0.33, 0.353, 0.50, 0.60, 0.70, 0.72, 0.73, 0.853, 0.90)
"""Shares of the final value that the seven methods look for."""


def sampling_times(lags: tuple[float, ...]) -> np.ndarray:
    """The grid: as many samples for every system."""
    return STEP * sum(lags) * np.arange(round(HORIZON / STEP) + 1)


def reading_time(t: np.ndarray, y: np.ndarray, value: float) -> float:
    """Time of the first sample at or above a value."""
    return float(t[np.argmax(y >= value)])


def as_read(t: np.ndarray, y: np.ndarray, final: float) -> np.ndarray:
    """Outputs that cross every level exactly at the time that Prechar reads.

    The first sample at or above a level is lowered to it: a method that interpolates then finds
    the grid time. Levels are several samples apart, everything else is as it was.
    """
    changed = y.copy()
    for level in LEVELS:
        changed[np.argmax(y >= level * final)] = level * final
    return changed


STREJC_ORDERS = (2, 3, 4, 5, 6, 7, 8, 9, 10)
STREJC_RATIOS = (0.104, 0.218, 0.319, 0.410, 0.493, 0.570, 0.642, 0.709, 0.773)
STREJC_INFLECTIONS = (0.264, 0.327, 0.359, 0.371, 0.384, 0.394, 0.401, 0.407, 0.413)
"""Table 3 as printed: tau = Tu/Tn and the output at the inflection, by order."""
STREJC_END = 0.3005
"""Largest y(t2) of table 2, where the second time constant is 0."""


def strejc(t: np.ndarray, y: np.ndarray, final: float) -> tuple[float, int]:
    """Time constant and order of Strejc's method as Prechar computed it.

    y(t2) and y_i are taken from the output itself, not from its share of the final value. For a
    gain of 2 y(t2) is at least 2 * 0.161, beyond the end of table 2: of the two lags only their sum
    is left. y_i, 0.359 for n = 4, is met at 18 % of the final value.
    """
    ratio = tangent_ratio(t, y, final)
    if ratio < STREJC_RATIOS[0]:
        total = reading_time(t, y, 0.72 * final) / 1.2564
        if np.interp(0.3574 * total, t, y) < STREJC_END:
            raise ValueError("Prechar's Strejc method is reconstructed for a gain of 2 only.")
        return total, 1
    place = np.searchsorted(STREJC_RATIOS, ratio, side="right") - 1
    order = STREJC_ORDERS[place]
    return reading_time(t, y, STREJC_INFLECTIONS[place]) / (order - 1), order


def tangent_ratio(t: np.ndarray, y: np.ndarray, final: float) -> float:
    """Tu/Tn of the steepest difference of samples: time of the earlier, output of the later one.

    With the point in its place table 7 would have n = 5 (tau = 0.4103, printed 0.41); the paper
    prints n = 4, which takes a tau below 0.41 and an order chosen downwards.
    """
    slopes = np.diff(y) / np.diff(t)
    row = np.argmax(slopes)
    return float((slopes[row] * t[row] - y[row + 1]) / final)
