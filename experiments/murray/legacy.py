"""What the author's MATLAB code did, in NumPy and SciPy, errors included.

The numbers E1, E2, ... are those of the errata in the README. What `step()` of MATLAB did is known
only in part: the interval dt = ln(1e4) min(Tmin/50, Tmax/200) is, the end of the response is not;
here it is the time of 99.9 %.
"""

import functools
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from experiments.murray.plants import PT4_LAGS, settling_time
from experiments.numpy_responses import chain_lags, chain_response
from stepax import Hudzovic, Sani


ORDERS = range(2, 9)
RESOLUTION = 50
"""Points of the author's lookup tables."""
LONGEST = 2000
"""Most samples of a simulated response; only tables of very unequal lags reach it."""


class Model(NamedTuple):
    """A result: where `fallback` holds, T and r are the code's default values (E6)."""

    family: type
    T: float
    r: float
    n: int
    fallback: bool = False

    def response(self, t):
        """Step response; infinite where a lag is not positive, as the unstable model's is."""
        lags = chain_lags(self.family, self.T, self.r, self.n)
        if not np.all(lags > 0):
            return np.full_like(t, np.inf)
        return chain_response(t, lags)


# records


def step_interval(lags):
    """Sampling interval of MATLAB's `step`."""
    lags = lags[lags > 0]
    return np.log(1e4) * min(lags.min() / 50, lags.max() / 200)


def simulated(lags):
    """Times and response of a plant as `step` returns them, cut at the end, not yet scaled."""
    end = settling_time(lags)
    dt = max(step_interval(lags), end / LONGEST)
    t = dt * np.arange(np.floor(end / dt) + 1)
    return t, chain_response(t, lags[lags > 0])


def pt4_record():
    """Times and response of the plant of figures 10 and 12, whose length is known: 253 samples."""
    t = step_interval(PT4_LAGS) * np.arange(253)
    return t, chain_response(t, PT4_LAGS)


def cut(y):
    """Response divided by its last value, although it has not settled (E8)."""
    return (y - y[0]) / (y[-1] - y[0])


def loess(y, span=0.2):
    """MATLAB's `smooth(..., span, 'loess')` on equispaced times."""
    windows, weights = _smoother(len(y), int(np.ceil(span * len(y))))
    return np.sum(weights * y[windows], axis=1)


@functools.cache
def _smoother(samples, count):
    """The `count` nearest samples of each, and their weights in the local quadratic regression."""
    windows = np.clip(np.arange(samples) - count // 2, 0, samples - count)[:, None]
    windows = windows + np.arange(count)
    x = windows - np.arange(samples)[:, None]
    x = x / np.max(np.abs(x), axis=1, keepdims=True)
    root = np.sqrt((1 - np.abs(x) ** 3) ** 3)
    basis = root[..., None] * x[..., None] ** np.arange(3)
    return windows, np.linalg.pinv(basis)[:, 0] * root


# characterisation


def tangent_times(t, y):
    """Tu and Tg: slope by differences, levels at the first and last sample."""
    slopes = np.diff(y) / (t[1] - t[0])
    place = np.argmax(slopes)
    slope = slopes[place]
    Tu = t[place] - (y[place] - y[0]) / slope - t[0]
    return Tu, (y[-1] - y[0]) / slope


def level_times(t, y, low=0.0, high=1.0):
    """t10, t50, t90 by a spline of t over y, which sorts a noisy y first (E12).

    Of the given limits only the distance is used, from the first sample on (E11).
    """
    thresholds = y[0] + np.array([0.1, 0.5, 0.9]) * (high - low)
    try:
        return spline(y, t)(thresholds)
    except ValueError:  # two samples are equal: the first samples above
        return np.array([t[np.argmax(y > q)] if np.any(y > q) else np.nan for q in thresholds])


def spline(x, y):
    """MATLAB's `spline`: not-a-knot, abscissae sorted; equal ones are an error."""
    order = np.argsort(x)
    return CubicSpline(x[order], y[order])


# lookup


class Table:
    """Curves of one family and order, and the splines through them."""

    def __init__(self, r, tu_tg, inv_tg, lam, inv_t50):
        self.r, self.tu_tg, self.inv_tg, self.lam, self.inv_t50 = r, tu_tg, inv_tg, lam, inv_t50
        self.r_of_tu_tg, self.r_of_lam = spline(tu_tg, r), spline(lam, r)
        self.inv_tg_of_r, self.inv_t50_of_r = spline(r, inv_tg), spline(r, inv_t50)


def r_grid(family, n, resolution=RESOLUTION):
    """Hudzovic's from 0 up to, not at, 1/(n-1); Sani's from above 0 to below 1."""
    if family is Hudzovic:
        return np.linspace(0, 1 / (n - 1), resolution + 1)[:-1]
    return np.linspace(0, 1, resolution + 2)[1:-1]


@functools.cache
def tables(family, resolution=RESOLUTION):
    """The author's tables for orders 2 to 8, from simulated responses."""
    return [_table(family, n, resolution) for n in ORDERS]


def _table(family, n, resolution):
    r, rows = r_grid(family, n, resolution), []
    for value in r:
        t, y = simulated(chain_lags(family, 1.0, value, n))
        Tu, Tg = tangent_times(t, y)
        t10, t50, t90 = level_times(t, y)
        rows.append([Tu / Tg, 1 / Tg, (t90 - t10) / t50, 1 / t50])
    return Table(r, *np.array(rows).T)


def _equal_lag_end(family, curve):
    return curve[0 if family is Hudzovic else -1]


def _order(matches):
    """The first order that matches; the last one where none does (E21)."""
    return next((n for n, match in zip(ORDERS, matches, strict=True) if match), ORDERS[-1])


def lookup_tangent(family, curves, Tu, Tg):
    """From Tu and Tg, by splines through the tables `curves`."""
    ratio = Tu / Tg
    n = _order(ratio <= _equal_lag_end(family, table.tu_tg) for table in curves)
    table = curves[n - 2]
    r = float(table.r_of_tu_tg(ratio))
    return _checked(family, float(table.inv_tg_of_r(r)) * Tg, r, n)


def lookup_levels(family, curves, t10, t50, t90):
    """From t10, t50 and t90, by splines through the tables `curves`."""
    lam = (t90 - t10) / t50
    n = _order(lam >= _equal_lag_end(family, table.lam) for table in curves)
    table = curves[n - 2]
    r = float(table.r_of_lam(lam))
    return _checked(family, float(table.inv_t50_of_r(r)) * t50, r, n)


def lookup_formulae(t10, t50, t90):
    """Sani's formulae (Murray 2016, eqs. 2.17-2.19), solved by the author's bisection."""
    lam = (t90 - t10) / t50
    n = _order(lam >= formula_lam(1 - 1e-6, n) for n in ORDERS)
    r = bisection(lambda r: formula_lam(r, n), lam)
    return _checked(Sani, t50 / formula_t50(r, n), r, n)


def formula_t50(r, n):
    """t50/T, eq. 2.17."""
    return np.log(2) - 1 + (1 - r**n) / (1 - r)


def formula_lam(r, n):
    """(t90 - t10)/t50, eq. 2.19."""
    return 1.315 * np.sqrt(3.8 * (1 - r ** (2 * n)) / (1 - r * r) - 1) / formula_t50(r, n)


def bisection(function, target):
    """20 halvings from 0.25 with a first step of 0.25: r stays between -0.25 and 0.75 (E1)."""
    x, step = 0.25, 0.5
    for _ in range(20):
        step /= 2
        x += step if function(x) > target else -step
    return x


def _checked(family, T, r, n):
    """Default values, not in the unit of the data, where r is out of range (E6)."""
    if family is Hudzovic and (r < 0 or r >= 1 / (n - 1)):
        return Model(family, 1.0, 1 / (n - 1) / 2, n, True)
    if family is Sani and (r < 0 or r > 1):
        return Model(family, 1.0, 0.5, n, True)
    return Model(family, T, r, n)


# fits and all methods


def fit(start: Model, t, y):
    """T and r by least squares without bounds (E19), at the order and from the values given."""

    def residual(x):
        return start._replace(T=x[0], r=x[1]).response(t) - y

    try:
        with np.errstate(invalid="ignore"):  # from unstable trial steps, which are infinite
            start_values = [start.T, start.r]
            x = least_squares(residual, start_values, ftol=1e-6, xtol=1e-6, gtol=1e-6).x
    except ValueError:  # the start, or a neighbour of it, is unstable
        return start._replace(T=np.nan, r=np.nan, fallback=False)
    return start._replace(T=x[0], r=x[1], fallback=False)


def identify(t, y, smoothed, fits=True) -> dict[str, Model]:
    """Every method on a record between 0 and 1; lookups from the smoothed one, fits from y."""
    times, (Tu, Tg) = level_times(t, smoothed), tangent_times(t, smoothed)
    found = {
        "hudzovic_tu_tg": lookup_tangent(Hudzovic, tables(Hudzovic), Tu, Tg),
        "hudzovic_t10_t50_t90": lookup_levels(Hudzovic, tables(Hudzovic), *times),
        "sani_tu_tg": lookup_tangent(Sani, tables(Sani), Tu, Tg),
        "sani_interpolation": lookup_formulae(*times),
        "sani_t10_t50_t90": lookup_levels(Sani, tables(Sani), *times),
    }
    if fits:
        found["hudzovic_fit"] = fit(found["hudzovic_t10_t50_t90"], t, y)
        found["sani_fit"] = fit(found["sani_interpolation"], t, y)
    return found


def rmse(model: Model, t, clean):
    """Root mean square distance of a model's response from a clean response; NaN if unstable."""
    value = np.sqrt(np.mean((model.response(t) - clean) ** 2))
    return value if np.isfinite(value) else np.nan


def errors(t, clean, noise=None, fits=True):
    """Rows (method, rmse, status, n, T, r) of one plant; with noise, smoothed as in figure 12.

    The status is "successful", "fallback", or "unstable", where the model has no response.
    """
    clean = cut(clean)
    y = clean if noise is None else clean + noise
    smoothed = y if noise is None else loess(y)
    rows = []
    for method, model in identify(t, y, smoothed, fits).items():
        error = rmse(model, t, clean)
        status = "fallback" if model.fallback else "successful"
        status = status if np.isfinite(error) else "unstable"
        rows.append((method, error, status, model.n, model.T, model.r))
    return rows
