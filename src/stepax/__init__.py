"""Differentiable identification of process models from step responses, in JAX."""

from ._characterise import Tangent as Tangent
from ._characterise import crossing_times as crossing_times
from ._characterise import tangent as tangent
from ._compare import Comparison as Comparison
from ._compare import compare as compare
from ._curves import Curves as Curves
from ._curves import Lookup as Lookup
from ._curves import lookup as lookup
from ._curves import lookup_curves as lookup_curves
from ._identify import identify as identify
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
from ._preprocess import (
    noise_level as noise_level,
)
from ._preprocess import (
    preprocess as preprocess,
)
from ._preprocess import (
    sliding_average as sliding_average,
)
from ._preprocess import (
    smooth as smooth,
)
from ._read import read_record as read_record
from ._record import StepRecord as StepRecord
from ._refine import refine as refine
from ._responses import MAX_ORDER as MAX_ORDER
from ._result import Identification as Identification
from ._result import Status as Status
from ._result import refused as refused
from ._solver import BoundedLevenbergMarquardt as BoundedLevenbergMarquardt
from .methods import METHODS as METHODS


__version__ = "0.1.0"
