"""Identification methods by name: each takes a record and options and returns an Identification."""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._compilation import compiled
from .._result import Identification, judged
from ..curves._times import LEVELS
from ..models._abstract import AbstractPlant
from ..models._plants import FOPDT, IPDT, SOPDT, EqualLag, Hudzovic, PTn, Sani, SOPDTZero
from ..records._record import StepRecord
from ._areas import area_fopdt, moments_fopdt, moments_ptn, moments_sopdt
from ._charts import HARRIOTT_LEVELS, SMITH_LEVELS, STREJC, harriott, smith
from ._fits import (
    fopdt_fit,
    hudzovic_fit,
    ipdt_fit,
    ptn_fit,
    sani_fit,
    sopdt_fit,
    sopdt_zero_fit,
)
from ._lookup import (
    hudzovic_t10_t50_t90,
    hudzovic_tu_tg,
    sani_interpolation,
    sani_t10_t50_t90,
    sani_tu_tg,
)
from ._method import Method, compiled_method
from ._rdkam import rdkam, rdkam_fopdt, rdkam_oscillatory, rdkam_sopdt
from ._reading import ByHand, shared_readings, time_name
from ._regression import wang_guo_zhang
from ._tables import LATZEL_LEVELS, latzel, strejc
from ._tangents import ONE_LAG, oldenbourg_sartorius, tangent_63, ziegler_nichols_tangent
from ._three_points import (
    ALFARO_LEVELS,
    RANGAIAH_LEVELS,
    alfaro_overdamped,
    rangaiah_krishnaswamy,
)
from ._two_points import (
    TWO_POINTS,
    VITECKOVA_LEVELS,
    alfaro_1,
    alfaro_2,
    broida,
    chen_yang,
    ho,
    smith_1972,
    sundaresan_krishnaswamy,
    viteckova,
    viteckova_1,
    viteckova_2,
)


# A new method is its function and one row here.
_ROWS: dict[Callable[..., Identification], Method] = {
    # lookups
    hudzovic_tu_tg: Method(Hudzovic, "nth", order_found=True, has_tangent=True),
    hudzovic_t10_t50_t90: Method(Hudzovic, "nth", order_found=True, levels=LEVELS),
    sani_tu_tg: Method(Sani, "nth", order_found=True, has_tangent=True),
    sani_t10_t50_t90: Method(Sani, "nth", order_found=True, levels=LEVELS),
    sani_interpolation: Method(Sani, "nth", order_found=True, levels=LEVELS),
    # the seven classical methods
    viteckova_1: Method(FOPDT, "first", levels=VITECKOVA_LEVELS),
    viteckova_2: Method(EqualLag, "second", levels=VITECKOVA_LEVELS),
    latzel: Method(EqualLag, "nth", order_found=True, levels=LATZEL_LEVELS),
    harriott: Method(PTn, "second", levels=HARRIOTT_LEVELS, points=(("t_read", "y_read"),)),
    smith: Method(PTn, "second", levels=SMITH_LEVELS),
    strejc: Method(
        PTn,
        "nth",
        order_found=True,
        levels=(STREJC.level,),
        points=(("t_read", "y_read"), ("t_i", "y_i")),
        has_tangent=True,
    ),
    sundaresan_krishnaswamy: Method(
        FOPDT, "first", levels=TWO_POINTS["sundaresan_krishnaswamy"].levels
    ),
    # further points
    smith_1972: Method(FOPDT, "first", levels=TWO_POINTS["smith_1972"].levels),
    broida: Method(FOPDT, "first", levels=TWO_POINTS["broida"].levels),
    chen_yang: Method(FOPDT, "first", levels=TWO_POINTS["chen_yang"].levels),
    ho: Method(FOPDT, "first", levels=TWO_POINTS["ho"].levels),
    alfaro_1: Method(FOPDT, "first", levels=TWO_POINTS["alfaro_1"].levels),
    alfaro_2: Method(EqualLag, "second", levels=TWO_POINTS["alfaro_2"].levels),
    viteckova: Method(EqualLag, "nth", order_found=True, levels=VITECKOVA_LEVELS),
    alfaro_overdamped: Method(PTn, "second", levels=ALFARO_LEVELS),
    rangaiah_krishnaswamy: Method(SOPDT, "second", levels=RANGAIAH_LEVELS),
    # tangents
    ziegler_nichols_tangent: Method(FOPDT, "first", has_tangent=True),
    tangent_63: Method(FOPDT, "first", levels=(ONE_LAG,), has_tangent=True),
    oldenbourg_sartorius: Method(PTn, "second", has_tangent=True),
    # areas and moments
    area_fopdt: Method(FOPDT, "first"),
    moments_fopdt: Method(FOPDT, "first"),
    moments_sopdt: Method(PTn, "second"),
    moments_ptn: Method(EqualLag, "nth", order_found=True),
    # areas for every dead time, and integrals
    rdkam_fopdt: Method(FOPDT, "first"),
    rdkam_sopdt: Method(SOPDT, "second"),
    rdkam_oscillatory: Method(SOPDT, "second"),
    rdkam: Method(SOPDT, "second"),
    wang_guo_zhang: Method(SOPDT, "second"),
    # least squares
    hudzovic_fit: Method(Hudzovic, "nth", order_found=True),
    sani_fit: Method(Sani, "nth", order_found=True),
    ptn_fit: Method(PTn, "nth", order_found=True),
    fopdt_fit: Method(FOPDT, "first"),
    sopdt_fit: Method(SOPDT, "second"),
    sopdt_zero_fit: Method(SOPDTZero, "second"),
    ipdt_fit: Method(IPDT, "second"),
}

FITS = frozenset(method.__name__ for method in _ROWS if method.__module__ == fopdt_fit.__module__)
"""Methods that minimise the squared error; all others read points, tangents or areas of a step."""

METHODS: dict[str, Callable[..., Identification]] = {
    method.__name__: compiled_method(method, method.__name__ not in FITS) for method in _ROWS
}
"""Every method by its name, compiled; an option that is a Python or NumPy number is static."""

SCANS = frozenset(method.__name__ for method in _ROWS if method.__module__ == rdkam.__module__)
"""Methods that scan the dead time; they share one scan."""

ROWS: dict[str, Method] = {method.__name__: row for method, row in _ROWS.items()}
"""What there is to know about each method."""

MODELS: dict[str, type[AbstractPlant]] = {name: row.gives for name, row in ROWS.items()}
"""The class of models that each method gives; `smith(underdamped=True)` alone gives a SOPDT."""


ALL_LEVELS = sorted({level for row in ROWS.values() for level in row.levels})
"""Levels that some method reads."""


@compiled
def read_by_all(
    record: StepRecord, names: tuple[str, ...], by_hand: ByHand | None = None
) -> list[Identification]:
    """Results of several methods that are no fits, as one: what they share is read once.

    `by_hand` has times of `ALL_LEVELS`.
    """
    plain = {method.__name__: method for method in _ROWS}
    levels = [level for name in names for level in ROWS[name].levels]
    with shared_readings(record, levels if by_hand is None else ALL_LEVELS, by_hand):
        results = [plain[name](record) for name in names]
    return judged(record, results)


def as_by_hand(marks: Mapping[str, float], dtype: Any) -> ByHand:
    """Times read by hand, from the step, by their names in `.details`: t33, Tu, Tg.

    A `ValueError` for a name that no method reads, or a time that is no number.
    """
    names = [*map(time_name, ALL_LEVELS), "Tu", "Tg"]
    for name, value in marks.items():
        if name not in names:
            raise ValueError(f"No method reads a mark {name!r}; known are {', '.join(names)}.")
        if not np.isfinite(value):
            raise ValueError(f"The mark {name!r} must be a time, got {value!r}.")
    *times, Tu, Tg = (jnp.asarray(marks.get(name, np.nan), dtype) for name in names)
    return ByHand(jnp.stack(times), Tu, Tg)
