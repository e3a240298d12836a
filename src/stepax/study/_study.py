"""What a study computes: plain data, the same in every process that works on it."""

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from ..methods import METHODS, ROWS
from ..methods._fits import CHAINS
from ..methods._method import option_names
from ..records._preprocess import window_of
from ..records._record import MIN_SAMPLES
from ._noise import AbstractNoise, NoiseTable, as_noise, noise_table, shape_of
from ._plants import Distribution, UniformLags, check_order


Methods = Sequence[str] | Mapping[str, Mapping[str, Any]]


@dataclasses.dataclass(frozen=True)
class Study:
    """Random plants, noise, and the methods that identify each record.

    - `methods`: names in `METHODS`, or a mapping from names to options. `span`, of any method,
        smooths its records by LOESS, once for all methods with the same span. A chain's fit takes
        `order="sani_t10_t50_t90"`, or another method of this study whose models it can start from:
        it then has the order of that method's model and starts there, with the parameters of
        `refine`; a record that the other method refuses it refuses too. `errors=False` is the
        default of fits here.
    - `orders`: a list of orders; of each there are `plants` plants, from `distribution` (see
        `random_plants`). Gain 1, no dead time.
    - `noise`: a list of levels, the standard deviation of white Gaussian noise as a share of the
        change, or of noise models such as `UniformNoise(0.1) + Quantisation(0.01)`.
    - `draws`: of noise, for each plant and level.
    - `samples`: of each record, evenly spaced from the step, at 0, to the time at which 99.9 % of
        the change is done.
    - `known_levels`: whether the methods are told that the output goes from 0 to 1, as in Murray
        (2016); else they estimate it.

    The error is the RMSE of the identified model from the response without noise, over all samples.
    """

    methods: Methods
    # lists are kept as tuples, numbers of NumPy's as Python's
    orders: Any = (2, 4)
    plants: Any = 100
    noise: Any = (0.0, 0.02)
    draws: Any = 1
    samples: Any = 250
    distribution: Distribution = UniformLags()  # noqa: RUF009 (immutable)
    known_levels: bool = True

    def __post_init__(self) -> None:
        def keep(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        if isinstance(self.methods, str):
            raise TypeError(f"methods must be a list of names, such as [{self.methods!r}].")
        given = self.methods
        options = given if isinstance(given, Mapping) else {name: {} for name in given}
        keep("methods", {name: dict(more) for name, more in options.items()})
        for name, more in self.options.items():
            self._check_method(name, more)
        keep("orders", tuple(check_order(_whole(n)) for n in self._several("orders")))
        keep("noise", tuple(as_noise(_number(x)) for x in self._several("noise")))
        for name, least in (("plants", 1), ("draws", 1), ("samples", MIN_SAMPLES)):
            value = _whole(getattr(self, name))
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ValueError(
                    f"{name} of a Study must be a whole number of at least {least}, got {value!r}."
                )
            keep(name, value)
        for more in self.options.values():
            if more.get("span") is not None:
                window_of(self.samples, more["span"])
        if not callable(self.distribution):
            raise TypeError("distribution of a Study must be a function of (key, order).")

    def _several(self, name: str) -> list[Any]:
        values = getattr(self, name)
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise TypeError(f"{name} of a Study must be a list, got {values!r}.")
        values = list(values)
        if not values:
            raise ValueError(f"{name} of a Study must not be empty.")
        if name == "orders" and len(set(values)) < len(values):
            raise ValueError(f"orders of a Study must differ, got {values}.")
        return values

    def _check_method(self, name: str, options: Mapping[str, Any]) -> None:
        if name not in METHODS:
            raise KeyError(f"Unknown method {name!r}; known are {', '.join(METHODS)}.")
        start = options.get("order")
        if isinstance(start, str) and start != "auto":
            names = list(self.options)
            if name not in CHAINS or start not in names[: names.index(name)]:
                raise ValueError(
                    f"order={start!r} of {name} must be 'auto', a number, or a method of the study"
                    " before it."
                )
            if ROWS[start].gives is not ROWS[name].gives:
                raise ValueError(f"{name} cannot start from a model of {start}.")
        known = ("span", *option_names(METHODS[name]))
        for option in options:
            if option not in known:
                raise ValueError(
                    f"Method {name!r} has no option {option!r}; it has {', '.join(known)}."
                )

    # what follows from it

    @property
    def options(self) -> dict[str, dict[str, Any]]:
        """Options by method, in order."""
        return self.methods  # pyright: ignore[reportReturnType]

    @property
    def models(self) -> tuple[AbstractNoise, ...]:
        """Noise models, in order."""
        return self.noise

    @property
    def table(self) -> NoiseTable:
        """All noise, by its place in the list."""
        return noise_table(self.models)

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Numbers of orders, plants of each, levels of noise, draws."""
        return len(tuple(self.orders)), self.plants, len(tuple(self.noise)), self.draws

    @property
    def records(self) -> int:
        """Number of records, each of which every method identifies."""
        return int(np.prod(self.shape))

    def places(self, records: np.ndarray) -> tuple[Any, ...]:
        """Of records by number: places of the order, the plant of it, the noise, and the draw."""
        return np.unravel_index(records, self.shape)

    def describe(self) -> dict[str, Any]:
        """Everything that decides its results, as JSON has it."""
        noise = [[shape_of(model), *jax.tree.leaves(model)] for model in self.models]
        options = {n: {k: repr(v) for k, v in x.items()} for n, x in self.options.items()}
        return {
            "methods": options,
            "orders": list(self.orders),
            "plants": self.plants,
            "noise": noise,
            "draws": self.draws,
            "samples": self.samples,
            "distribution": _said(self.distribution),
            "known_levels": self.known_levels,
        }


def digest(description: Mapping[str, Any]) -> str:
    """A short hash of a description."""
    text = json.dumps(description, sort_keys=True, default=repr)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _said(distribution: Any) -> str:
    """A distribution by its name and numbers."""
    if dataclasses.is_dataclass(distribution):
        return repr(distribution)
    module, name = (getattr(distribution, x, "") for x in ("__module__", "__qualname__"))
    return f"{module}.{name}"


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, np.integer) else value


def _number(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
