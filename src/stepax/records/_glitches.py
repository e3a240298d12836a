"""Rows that stand out of their neighbours, as glitches of a sensor or a logger do; host code."""

import numpy as np


SPIKE = 9.0
"""Noise levels beyond which a row stands out of its neighbours.

Both are read off the same rows: 6 would be exceeded in one of 100 records of Gaussian noise (60 to
2000 rows), 9 in fewer than one of 1000 from 40 rows on. Each costs another search."""
STANDS_OUT = 6.0
"""Noise levels beyond which a row is no noise, where the level is that of a robust fit."""
SEEN = 0.02
"""Share of the range below which a row that stands out does not matter to a fit."""
SHORT = 3
"""Rows in which a glitch is over; longer, it is a move of the plant or an error of the model."""
MOST = 0.1
"""Share of rows that may stand out: beyond, they are no exceptions."""


def spikes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which rows stand out of the running median of seven, and by how much.

    It keeps steps and slopes. `values`: outputs or residuals, in units of the output's range.
    """
    if values.size < 2 * SHORT + 1:
        return np.zeros(values.size, bool), np.zeros(values.size)
    padded = np.pad(values, SHORT, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * SHORT + 1)
    away = values - np.median(windows, axis=1)
    return np.abs(away) > max(SPIKE * 1.4826 * np.median(np.abs(away)), SEEN), away


def outliers(residual: np.ndarray, noise: float, quantum: float = 0.0) -> np.ndarray:
    """Which rows of a robust fit stand out of the noise that it found."""
    return np.abs(residual) > max(STANDS_OUT * noise, quantum)


def are_glitches(rows: np.ndarray) -> bool:
    """Whether rows that stand out are few, and most of them in short runs."""
    if not rows.any() or rows.mean() > MOST:
        return False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rows.astype(int), [0]])))
    lengths = edges[1::2] - edges[::2]
    return bool(lengths[lengths <= SHORT].sum() * 2 >= lengths.sum())
