"""Identification methods by name: each takes a record and options and returns an Identification."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._result import Identification
from ..models._abstract import AbstractPlant
from ..models._plants import FOPDT, SOPDT, EqualLag, Hudzovic, PTn, Sani
from ..records._record import StepRecord
from ._areas import area_fopdt, moments_fopdt, moments_ptn, moments_sopdt
from ._charts import harriott, smith
from ._fits import fopdt_fit, hudzovic_fit, ptn_fit, sani_fit, sopdt_fit
from ._lookup import (
    hudzovic_t10_t50_t90,
    hudzovic_tu_tg,
    sani_interpolation,
    sani_t10_t50_t90,
    sani_tu_tg,
)
from ._tables import latzel, strejc
from ._tangents import oldenbourg_sartorius, tangent_63, ziegler_nichols_tangent
from ._three_points import alfaro_overdamped, rangaiah_krishnaswamy
from ._two_points import (
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


_GIVES: dict[Callable[..., Identification], type[AbstractPlant]] = {
    # lookups
    hudzovic_tu_tg: Hudzovic,
    hudzovic_t10_t50_t90: Hudzovic,
    sani_tu_tg: Sani,
    sani_t10_t50_t90: Sani,
    sani_interpolation: Sani,
    # the seven classical methods
    viteckova_1: FOPDT,
    viteckova_2: EqualLag,
    latzel: EqualLag,
    harriott: PTn,
    smith: PTn,
    strejc: PTn,
    sundaresan_krishnaswamy: FOPDT,
    # further points
    smith_1972: FOPDT,
    broida: FOPDT,
    chen_yang: FOPDT,
    ho: FOPDT,
    alfaro_1: FOPDT,
    alfaro_2: EqualLag,
    viteckova: EqualLag,
    alfaro_overdamped: PTn,
    rangaiah_krishnaswamy: SOPDT,
    # tangents
    ziegler_nichols_tangent: FOPDT,
    tangent_63: FOPDT,
    oldenbourg_sartorius: PTn,
    # areas and moments
    area_fopdt: FOPDT,
    moments_fopdt: FOPDT,
    moments_sopdt: PTn,
    moments_ptn: EqualLag,
    # least squares
    hudzovic_fit: Hudzovic,
    sani_fit: Sani,
    ptn_fit: PTn,
    fopdt_fit: FOPDT,
    sopdt_fit: SOPDT,
}


def _compiled(method: Callable[..., Identification]) -> Callable[..., Identification]:
    """`method`, compiled: `delay` is traced, in the record's dtype; other numbers are static."""
    call = eqx.filter_jit(method)

    @functools.wraps(method)
    def run(record: StepRecord, **options: Any) -> Identification:
        options = jax.tree.map(lambda x: x.item() if isinstance(x, np.generic) else x, options)
        if isinstance(options.get("delay"), int | float | np.ndarray | jax.Array):
            options["delay"] = jnp.asarray(options["delay"], record.t.dtype)
        return call(record, **options)

    return run


METHODS: dict[str, Callable[..., Identification]] = {
    method.__name__: _compiled(method) for method in _GIVES
}
"""Every method by its name, compiled; an option that is a Python or NumPy number is static."""

MODELS: dict[str, type[AbstractPlant]] = {
    method.__name__: model for method, model in _GIVES.items()
}
"""The class of models that each method gives; `smith(underdamped=True)` alone gives a SOPDT."""
