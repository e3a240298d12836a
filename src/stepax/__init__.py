"""Differentiable identification of process models from step responses, in JAX."""

from importlib.metadata import version as _version

from ._batches import over_devices as over_devices
from ._compare import Comparison as Comparison, compare as compare
from ._identify import identify as identify
from ._identify_each import Identifications as Identifications, identify_each as identify_each
from ._result import Identification as Identification
from ._status import Status as Status, refused as refused
from .curves._lookup import Lookup as Lookup, lookup as lookup
from .curves._times import Curves as Curves, lookup_curves as lookup_curves
from .fitting._refine import refine as refine
from .fitting._solver import BoundedLevenbergMarquardt as BoundedLevenbergMarquardt
from .layer._lti import LayerState as LayerState, LTILayer as LTILayer
from .layer._unconstrained import (
    from_unconstrained as from_unconstrained,
    to_unconstrained as to_unconstrained,
)
from .methods import METHODS as METHODS
from .models._plants import (
    FOPDT as FOPDT,
    IPDT as IPDT,
    SOPDT as SOPDT,
    EqualLag as EqualLag,
    Hudzovic as Hudzovic,
    PTn as PTn,
    Sani as Sani,
    SOPDTZero as SOPDTZero,
)
from .models._responses import MAX_ORDER as MAX_ORDER
from .records._characterise import (
    Tangent as Tangent,
    crossing_times as crossing_times,
    tangent as tangent,
)
from .records._input import InputRecord as InputRecord
from .records._preprocess import (
    noise_level as noise_level,
    preprocess as preprocess,
    sliding_average as sliding_average,
    smooth as smooth,
)
from .records._read import read_record as read_record
from .records._record import StepRecord as StepRecord, stack_records as stack_records
from .records.image._trace import trace_image as trace_image


__version__ = _version("stepax")
