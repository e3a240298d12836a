"""The five systems of the paper, S1 to S5, and their step responses."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

from experiments.jakoubek.prechar import sampling_times
from stepax import PTn, StepRecord
from stepax.records._labels import Labels


GAIN = 2.0
"""Of every system; known to the methods, as in the paper."""


PLACES = 10
"""Places of a chain's lags, unused ones 0: chains of every length share one compiled response."""


def chain(lags: Sequence[float], delay: float = 0.0) -> PTn:
    """Chain of lags with the systems' gain."""
    padded = np.pad(np.asarray(lags, float), (0, PLACES - len(lags)))
    return PTn(lags=padded, gain=np.float64(GAIN), delay=np.float64(delay))


def response(plant: PTn, t: np.ndarray) -> np.ndarray:
    """Step response at the times of an array."""
    return np.asarray(_response(plant, t))


@jax.jit
def _response(plant: PTn, t):
    return plant.step_response(t)


class System(NamedTuple):
    """One system: the table and the figure of the paper that it is in, its lags in seconds."""

    name: str
    table: int
    figure: int
    title: str
    lags: tuple[float, ...]

    @property
    def plant(self) -> PTn:
        """Eqs. 26-30."""
        return chain(self.lags)

    def record(self) -> StepRecord:
        """Its step response on the grid of the paper, with both levels known."""
        t = sampling_times(self.lags)
        return record_of(self, t, response(self.plant, t))


def record_of(system: System, t: np.ndarray, y: np.ndarray) -> StepRecord:
    labels = Labels(source=system.name, time="time (s)", output="output")
    return StepRecord(t, y, initial=0.0, final=GAIN, labels=labels)


SYSTEMS = {
    system.name: system
    for system in (
        System("S1", 4, 9, "2 / (1 + 0.5 s)", (0.5,)),
        System("S2", 5, 10, "2 / (1 + 0.5 s)²", (0.5, 0.5)),
        System("S3", 6, 11, "2 / ((1 + s)(1 + 0.1 s))", (1.0, 0.1)),
        System("S4", 7, 12, "2 / (1 + 0.5 s)⁵", (0.5,) * 5),
        System(
            "S5", 8, 13, "2 / ((1 + s)(1 + 0.8 s)(1 + 0.6 s)(1 + 0.4 s)(1 + 0.2 s))",
            (1.0, 0.8, 0.6, 0.4, 0.2),
        ),
    )
}  # fmt: skip
