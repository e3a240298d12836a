"""What there is to know about a method beside its function, and how it is called."""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from .._compilation import compiled
from .._result import Identification
from ..fitting._prior import checked_pairs
from ..models._abstract import AbstractPlant
from ..records._abstract import AbstractRecord
from ..records._input import refuse_other_input
from ._reading import time_name


class Method(NamedTuple):
    """What a method gives, and which of its details a plot can mark, with its default options.

    - `gives`: class of its models. `group`: "first" (first order plus dead time), "second" (two
        poles) or "nth" (any number of lags).
    - `order_found`: whether the order came from the record; it then counts as a parameter.
    - `levels`: shares of the change whose times are in the details; `points`: names of the details
        with the time and the height of a point; `has_tangent`: whether `Tu` and `Tg` are there.
    """

    gives: type[AbstractPlant]
    group: str
    order_found: bool = False
    levels: tuple[float, ...] = ()
    points: tuple[tuple[str, str], ...] = ()
    has_tangent: bool = False

    def marks(self, details: Mapping[str, Any]) -> list[tuple[float, float]]:
        """Points of the response that the method read: time from the step, share of the change."""
        marks = [(details[time_name(level)], level) for level in self.levels]
        marks += [(details[time], details[height]) for time, height in self.points]
        return [(float(time), float(height)) for time, height in marks]

    def tangent(self, details: Mapping[str, Any]) -> list[tuple[float, float]]:
        """Where its tangent meets both levels, as in `marks`; empty if it draws none."""
        if not self.has_tangent:
            return []
        Tu, Tg = float(details["Tu"]), float(details["Tg"])
        return [(Tu, 0.0), (Tu + Tg, 1.0)]


NUMBERS = ("delay", "gain", "period", "min_delay", "max_delay")
"""Options that are a number in the record's dtype: another value of them compiles nothing anew."""

TRACED = (*NUMBERS, "weights", "prior")
"""Options that may hold arrays."""


def compiled_method(
    method: Callable[..., Identification], needs_step: bool
) -> Callable[..., Identification]:
    """`method`, compiled: `delay` is traced, in the record's dtype; other numbers are static.

    An option that the method does not have is a `ValueError`.
    """
    call, known = compiled(method), option_names(method)

    @functools.wraps(method)
    def run(record: Any, **options: Any) -> Identification:
        if needs_step:
            refuse_other_input(record, method.__name__)
        result = call(record, **prepared(method.__name__, known, record, options))
        return dataclasses.replace(result, method=method.__name__)

    return run


def prepared(
    method: str, known: Sequence[str], record: AbstractRecord, options: dict[str, Any]
) -> dict[str, Any]:
    """Options as a compiled method takes them; a `ValueError` for one that it does not have."""
    for name in options:
        if name not in known:
            raise ValueError(
                f"Method {method!r} has no option {name!r}; it has {', '.join(known)}."
            )
    options = {k: x if k in TRACED else _static(x) for k, x in options.items()}
    for name in NUMBERS:
        if isinstance(options.get(name), int | float | np.generic | np.ndarray | jax.Array):
            options[name] = jnp.asarray(options[name], record.t.dtype)
    if options.get("prior") is not None:
        options["prior"] = checked_pairs(options["prior"], record.t.dtype)
    return options


def option_names(method: Callable[..., Any]) -> tuple[str, ...]:
    """Options of a method, by its signature; those of `**options: Unpack[...]` one by one."""
    names: list[str] = []
    for parameter in inspect.signature(method).parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY:
            names.append(parameter.name)
        elif parameter.kind is parameter.VAR_KEYWORD:
            (options,) = get_args(parameter.annotation)
            names += options.__annotations__
    return tuple(names)


def _static(value: Any) -> Any:
    """An option in plain Python, which can be hashed: arrays, ranges and sets as tuples."""
    if isinstance(value, range | set | frozenset | Iterator):
        value = tuple(value)
    elif isinstance(value, np.ndarray | jax.Array) and not isinstance(value, Tracer):
        value = tuple(value.tolist()) if value.ndim else value.item()
    return jax.tree.map(lambda x: x.item() if isinstance(x, np.generic) else x, value)
