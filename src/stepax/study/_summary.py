"""Groups of results in numbers."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._status import Status
from ._store import Categories


if TYPE_CHECKING:
    import pandas as pd


def summarised(
    columns: Mapping[str, Any], by: Sequence[str], quantiles: Sequence[float], bootstrap: int
) -> "pd.DataFrame":
    """See `StudyResults.summary`."""
    import pandas as pd

    by = [by] if isinstance(by, str) else list(by)
    for name in by:
        if name not in columns or name in ("rmse", "status"):
            known = ", ".join(x for x in columns if x not in ("rmse", "status"))
            raise ValueError(f"There is no column {name!r} to group by; there are {known}.")
    keys = [_codes(columns[name]) for name in by]
    rmse, status = columns["rmse"], columns["status"]
    plants = _codes(columns["order"])[0] * (columns["plant"].max(initial=0) + 1) + columns["plant"]
    group, shape = _groups([codes for codes, _ in keys], rmse.size)
    arrangement = np.lexsort((plants, group))
    starts = np.flatnonzero(np.diff(group[arrangement], prepend=-1))
    rows = []
    for rows_of in np.split(arrangement, starts[1:]) if rmse.size else []:
        place = np.unravel_index(group[rows_of[0]], shape) if by else ()
        row = {n: names[k] for n, (_, names), k in zip(by, keys, place, strict=True)}
        errors, codes = rmse[rows_of], status.codes[rows_of]
        row |= _numbers(errors, plants[rows_of], quantiles, bootstrap)
        row["refused"] = float(np.mean(codes >= int(Status.nonfinite_data._value)))
        shares = np.bincount(codes, minlength=len(status.names)) / codes.size
        row |= {name: float(x) for name, x in zip(status.names, shares, strict=True)}
        rows.append(row)
    frame = pd.DataFrame(rows)
    counts = np.bincount(status.codes, minlength=len(status.names))
    return frame.drop(
        columns=[n for n, k in zip(status.names, counts, strict=True) if rows and not k]
    )


def _codes(column: Any) -> tuple[np.ndarray, list[Any]]:
    """A column as numbers of its values, and these."""
    if isinstance(column, Categories):
        return column.codes.astype(np.int64), column.names
    values, codes = np.unique(column, return_inverse=True)
    return codes, values.tolist()


def _groups(codes: list[np.ndarray], size: int) -> tuple[np.ndarray, tuple[int, ...]]:
    """One number a row that tells its group, and by which shape it came about."""
    shape = tuple(int(x.max(initial=0)) + 1 for x in codes)
    return np.ravel_multi_index(codes, shape) if codes else np.zeros(size, int), shape


def _numbers(errors: np.ndarray, plants: np.ndarray, quantiles, bootstrap: int) -> dict[str, Any]:
    """Quantiles with refusals as infinite; mean and root mean square of the rest."""
    there = errors[np.isfinite(errors)].astype(float)
    ranked = np.where(np.isfinite(errors), errors, np.inf).astype(float)
    row = {
        "count": errors.size,
        "mean": float(there.mean()) if there.size else np.nan,
        "rms": float(np.sqrt(np.mean(there**2))) if there.size else np.nan,
    }
    row |= {f"q{100 * q:02.0f}": quantile(ranked, q) for q in quantiles}
    if bootstrap:
        medians = _resampled_medians(ranked, plants, bootstrap)
        row |= {"median_low": quantile(medians, 0.025), "median_high": quantile(medians, 0.975)}
    return row


def quantile(values: np.ndarray, share: float) -> float:
    """Linear between order statistics; infinite where the upper one is."""
    ordered = np.sort(values)
    place = share * (ordered.size - 1)
    low, rest = int(place), place - int(place)
    if rest == 0 or not np.isfinite(ordered[low + 1]):
        return float(ordered[low + (rest > 0)])
    return float(ordered[low] + rest * (ordered[low + 1] - ordered[low]))


def _resampled_medians(ranked: np.ndarray, plants: np.ndarray, count: int) -> np.ndarray:
    """Medians of samples of the plants, which are drawn the same way for every group."""
    starts = np.flatnonzero(np.diff(plants, prepend=plants[0] - 1))
    draw = np.random.default_rng(0)
    if starts.size == plants.size:
        return np.median(ranked[draw.integers(0, ranked.size, (count, ranked.size))], axis=1)
    parts = np.split(ranked, starts[1:])
    picks = draw.integers(0, len(parts), (count, len(parts)))
    return np.array([np.median(np.concatenate([parts[k] for k in pick])) for pick in picks])
