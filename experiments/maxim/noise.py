"""Noise sequences: white at the output, and white at the input of the plant, held over a sample."""

import numpy as np
from scipy import signal

from experiments.maxim.plants import Plant


def coloured(generator, plant: Plant, t, count: int):
    """White input noise of standard deviation 1 through the plant, stationary: (count, samples)."""
    interval = t[1] - t[0]
    longer = interval * np.arange(2 * len(t) + 1)
    pulse = np.diff(plant.response(longer))
    drive = generator.standard_normal((count, 3 * len(t)))
    return signal.fftconvolve(drive, pulse[None], axes=1)[:, 2 * len(t) : 3 * len(t)]


def noisy(generator, plant: Plant, t, count: int, sigma_in: float, sigma_out: float):
    """Sequences with both kinds of noise."""
    sequences = sigma_out * generator.standard_normal((count, len(t)))
    if sigma_in:
        sequences = sequences + sigma_in * coloured(generator, plant, t, count)
    return sequences


def at_level(generator, kind: str, plant: Plant, t, count: int, level: float):
    """Sequences with a standard deviation of `level` times the gain at the output."""
    if kind == "white":
        return level * plant.gain * generator.standard_normal((count, len(t)))
    sequences = coloured(generator, plant, t, count)
    return sequences * (level * plant.gain / np.std(sequences))
