"""A result as a dictionary for JSON; host code."""

import math
from importlib.metadata import version
from typing import Any

import numpy as np

from .._notes import Identified, notes_of
from .._status import status_name
from ..models._export import polynomials
from ..records._labels import Units
from ._content import parameters
from ._intervals import interval


def to_json(result: Identified, method: str | None = None) -> dict[str, Any]:
    """The result as a dictionary for JSON; NaN is None.

    `numerator` and `denominator` are coefficients of s, the highest power first, with the gain and
    without the dead time; None for a real order. `lags` are those of a chain.
    """
    model, record = result.model, result.record
    values = parameters(model)
    std = {
        name: np.broadcast_to(np.asarray(result.std.get(name, np.nan)), np.shape(values[name]))
        for name in model.parameter_names
    }
    ends = {name: np.stack(interval(result, name), axis=-1) for name in model.parameter_names}
    numerator, denominator = polynomials(model) or (None, None)
    return _finite_or_none(
        {
            "method": result.method if method is None else method,
            "model": type(model).__name__,
            "parameters": values,
            "standard_errors": {name: x.tolist() for name, x in std.items()},
            "rmse": float(result.rmse),
            "fit_percent": float(result.fit_percent),
            "status": status_name(result.status),
            "J": float(result.J),
            "aicc": float(result.details.get("aicc", np.nan)),
            "intervals": {name: x.tolist() for name, x in ends.items()},
            "lags": _lags(model),
            "numerator": numerator,
            "denominator": denominator,
            **record.input_facts(),
            "units": Units.of(record.labels)._asdict(),
            "notes": notes_of(result),
            "version": version("stepax"),
        }
    )


def _lags(model) -> list[float] | None:
    """Lags of a chain, the slowest first, without those that are 0; None for any other plant."""
    try:
        lags = np.asarray(model.lags, float)
    except (AttributeError, ValueError):  # a real order has none
        return None
    return sorted(lags[lags != 0].tolist(), reverse=True)


def _finite_or_none(tree) -> Any:
    """A tree of dictionaries and lists with None for NaN and infinity."""
    if isinstance(tree, dict):
        return {name: _finite_or_none(x) for name, x in tree.items()}
    if isinstance(tree, list):
        return [_finite_or_none(x) for x in tree]
    return None if isinstance(tree, float) and not math.isfinite(tree) else tree
