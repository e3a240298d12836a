"""Differentiable identification of process models from step responses, in JAX."""

from ._models import (
    FOPDT as FOPDT,
)
from ._models import (
    SOPDT as SOPDT,
)
from ._models import (
    EqualLag as EqualLag,
)
from ._models import (
    Hudzovic as Hudzovic,
)
from ._models import (
    PTn as PTn,
)
from ._models import (
    Sani as Sani,
)
from ._record import StepRecord as StepRecord
from ._responses import MAX_ORDER as MAX_ORDER
from ._result import Identification as Identification
from ._result import Status as Status


__version__ = "0.1.0"
