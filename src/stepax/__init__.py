"""Differentiable identification of process models from step responses, in JAX."""

from ._models import (
    EqualLag as EqualLag,
    FOPDT as FOPDT,
    Hudzovic as Hudzovic,
    PTn as PTn,
    Sani as Sani,
    SOPDT as SOPDT,
)
from ._record import StepRecord as StepRecord
from ._responses import MAX_ORDER as MAX_ORDER
from ._result import Identification as Identification, Status as Status


__version__ = "0.1.0"
