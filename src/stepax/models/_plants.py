"""The plants: families of process models with dead time."""

from ._abstract import AbstractPlant as AbstractPlant
from ._chains import (
    FOPDT as FOPDT,
    EqualLag as EqualLag,
    Hudzovic as Hudzovic,
    PTn as PTn,
    Sani as Sani,
)
from ._two_poles import IPDT as IPDT, SOPDT as SOPDT, SOPDTZero as SOPDTZero
