"""Confidence intervals of parameters; host code."""

import numpy as np
from scipy import special

from .._notes import Identified


LEVEL = 0.95
"""Confidence of the intervals in reports."""


def quantile(result: Identified, level: float = LEVEL) -> np.ndarray:
    """Half width of an interval over the standard error: of Student's t, two-sided.

    For the degrees of freedom that the noise level was found with (`degrees_of_freedom`); a result
    without them has no standard errors either, and the normal quantile.
    """
    if not 0 < level < 1:
        raise ValueError(f"The level of an interval must lie between 0 and 1, got {level!r}.")
    freedom = np.asarray(result.details.get("degrees_of_freedom", np.inf), float)
    return np.asarray(special.stdtrit(freedom, 0.5 + level / 2))


def interval(result: Identified, name: str, level: float = LEVEL) -> tuple:
    """Ends of the interval of a parameter; of a row of lags, rows of ends.

    `name` as in `.std`, or as a report has it: "lags[1]" and "lag 2" are one lag of several. A
    parameter that was fixed has an interval of no width; NaN where there is no standard error.
    """
    labels = {label: (x.name, x.place) for x in result.model.scalars for label in _labels(x)}
    known = labels | {name: (name, None) for name in result.model.parameter_names}
    if name not in known:
        raise KeyError(
            f"{type(result.model).__name__} has no parameter {name!r};"
            f" it has {', '.join(result.model.parameter_names)}."
        )
    field, place = known[name]
    value, std = np.asarray(getattr(result.model, field)), np.asarray(result.std[field])
    std = np.broadcast_to(std, value.shape)
    if place is not None:
        value, std = value[..., place], std[..., place]
    half = quantile(result, level)
    half = half.reshape(half.shape + (1,) * (std.ndim - half.ndim)) * std
    ends = value - half, value + half
    return ends if value.ndim else (float(ends[0]), float(ends[1]))


def _labels(scalar) -> list[str]:
    """Names of one lag of several."""
    return [] if scalar.place is None else [scalar.label, f"lag {scalar.place + 1}"]
