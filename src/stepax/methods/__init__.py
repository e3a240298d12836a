"""Identification methods by name: each takes a record and options and returns an Identification."""

from collections.abc import Callable

import equinox as eqx

from .._result import Identification
from ._fits import fopdt_fit, hudzovic_fit, ptn_fit, sani_fit, sopdt_fit
from ._lookup import (
    hudzovic_t10_t50_t90,
    hudzovic_tu_tg,
    sani_interpolation,
    sani_t10_t50_t90,
    sani_tu_tg,
)


METHODS: dict[str, Callable[..., Identification]] = {
    method.__name__: eqx.filter_jit(method)
    for method in (
        hudzovic_tu_tg,
        hudzovic_t10_t50_t90,
        sani_tu_tg,
        sani_t10_t50_t90,
        sani_interpolation,
        hudzovic_fit,
        sani_fit,
        ptn_fit,
        fopdt_fit,
        sopdt_fit,
    )
}
"""Every method by its name, compiled; an option that is a Python number is static."""
