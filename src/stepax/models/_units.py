"""The same plant in another unit of time."""

import dataclasses
from typing import TypeVar

from .._arrays import Scalar
from ._abstract import AbstractPlant


P = TypeVar("P", bound=AbstractPlant)

POWERS = {"time": 1, "per time": -1, "output/(input time)": -1}
"""Of the unit of time, in each dimension that has it."""


def in_unit(plant: P, unit: Scalar) -> P:
    """The plant where `unit` of a new unit of time are one of the old; the dead time too."""
    power = {name: POWERS.get(plant.dimension(name), 0) for name in plant.parameter_names}
    moved = {name: getattr(plant, name) * unit**k for name, k in power.items() if k}
    return dataclasses.replace(plant, **moved)
