"""Least-squares fits per second: `python -m experiments.benchmarks.fit [--json OUT] [--only K]`.

Four engines on the same records (200 samples from 0 to about 99 % of the change, 2 % white noise),
from the same starts: (a) `stepax.refine`; (b) `jax.vmap` of `optimistix.LevenbergMarquardt` on
the residuals and coordinates of (a), clipped to their bounds (in log T and logit r it is slower);
(c) SciPy `curve_fit` (MINPACK) in a loop, with the same coordinates, gain and offset among them,
and the response in NumPy: closed form for Hudzovic, contour quadrature for Sani; (d) the same with
`scipy.signal.step`. (b) to (d) stop at a tolerance of 1e-6, (a) at its own, which is tighter. (a)
is the plain `jax.vmap`, an equal share of the records on each core, (b) has XLA's threads, which is
what `jax.vmap` gives, for 1 000 plants at a time (all 10 000 are slower and for Sani need more than
20 GiB; so slow that `--engines` can leave it out);
(c) and (d) use one core, as Python loops do.

Costs are computed again from the parameters by one formula; `excess` is relative to the best of
all engines on that record, the bounds r >= 0 and delay >= 0 kept by all. `floor` is the share of
(a)'s time that evaluating residuals, derivatives and their sums takes, with the mean number of
steps. `--million` fits 1 000 000 plants, records drawn per chunk, and prints the peak memory.

Left out: compilation, drawing the records and the starts (except with `--million`).
"""

import argparse
import functools
import json
import os
import platform
import resource
import time
import warnings
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy import signal
from scipy.optimize import curve_fit

from experiments.cores import use_all_cores
from experiments.numpy_responses import chain_lags, chain_response, hudzovic_response
from stepax import Hudzovic, Sani, StepRecord, over_devices, refine
from stepax.fitting._problem import Problem
from stepax.methods._starts import chain_start


SAMPLES, NOISE, CHUNK, TOLERANCE = 200, 0.02, 32, 1e-6
PLANTS, VMAPPED, LOOPED, STEPPED = 10_000, 1_000, 2_000, 50
REPETITIONS, ENOUGH = 5, 30.0
KNOWN = ("gain", "offset", "delay")
COLUMNS = (
    "engine", "plants", "plants/s", "a is x times", "floor", "worst excess", "within 1e-6", "bound",
)  # fmt: skip


# records


def draw(family, order, everything, key):
    """One record (t, y), its start and its order: plants all over the family's range."""
    keys = jax.random.split(key, 5)
    n = jnp.asarray(order) if order else jax.random.randint(keys[0], (), 2, 9)
    r = jax.random.uniform(keys[1]) * (0.97 / (n - 1) if family is Hudzovic else 1)
    T = jax.random.uniform(keys[2], minval=1, maxval=9)
    residence = jnp.sum(family(T=T, r=r, n=n).lags)
    delay = everything * residence * jax.random.uniform(keys[3], minval=0.1, maxval=0.5)
    t = jnp.linspace(0, 1, SAMPLES) * (delay + 4.5 * residence)
    y = family(T=T, r=r, n=n, delay=delay).step_response(t)
    record = StepRecord(t, y + NOISE * jax.random.normal(keys[4], t.shape))
    start: Any = chain_start(family, record, n, () if everything else KNOWN)
    return record.t, record.y, start.T, start.r, start.delay, n


# engines: rows of T, r, gain, offset, delay


def by_stepax(family, everything, t, y, T, r, delay, n):
    """(a)"""
    start = family(T=T, r=r, n=n, delay=delay)
    result = refine(StepRecord(t, y), start, () if everything else KNOWN, errors=False)
    model: Any = result.model
    row = jnp.stack([model.T, model.r, model.gain, model.offset, model.delay])
    return row, result.details["steps"], jnp.any(result.details["at_bound"][:2])


def by_optimistix(family, everything, t, y, T, r, delay, n):
    """(b)"""
    known = () if everything else KNOWN
    fit = Problem.of(StepRecord(t, y), family(T=T, r=r, n=n, delay=delay), jnp.ones_like(y), known)
    solver = optx.LevenbergMarquardt(rtol=TOLERANCE, atol=TOLERANCE)
    found = optx.least_squares(
        lambda x, _: fit.residual(jnp.clip(x, *fit.bounds())), solver, fit.start(), throw=False
    )
    model: Any = fit.plant(jnp.clip(found.value, *fit.bounds()))[0]
    return jnp.stack([model.T, model.r, model.gain, model.offset, model.delay])


def coordinates(family, T, r, n):
    """Sum of the lags, and squared contrast of the extreme rates (`fitting._coordinates`)."""
    s = 1 - (n - 1) * r if family is Hudzovic else r
    return np.sum(chain_lags(family, T, r, n)), ((1 - s) / (1 + s)) ** 2


def parameters(family, residence, contrast, n):
    root = np.sqrt(min(max(contrast, 0.0), 1 - 1e-8))
    s = (1 - root) / (1 + root)
    r = (1 - s) / (n - 1) if family is Hudzovic else s
    return residence / np.sum(chain_lags(family, 1.0, r, n)), r


def sani_response(t, T, r, n):
    return chain_response(t, chain_lags(Sani, T, r, n))


def step_scipy(family, t, T, r, n):
    """`scipy.signal.step` of the chain."""
    rates = 1 - np.arange(n) * r if family is Hudzovic else r ** -np.arange(float(n))
    even = np.linspace(0, t[-1], t.size)
    _, y = signal.step(signal.ZerosPolesGain([], -rates / T, np.prod(rates / T)), T=even)
    return np.interp(t, even, y, left=0)


def by_scipy(family, everything, response, t, y, T, r, delay, n):
    """(c), (d): one record at a time."""
    rows = np.full((len(y), 5), np.nan)
    for i, row in enumerate(rows):
        order, dt = int(n[i]), t[i, 1]

        def physical(x, order=order, dt=dt):
            levels = [x[2], x[3], max(x[4], 0.0) * dt] if everything else [1.0, 0.0, 0.0]
            return [*parameters(family, np.exp(x[0]), x[1], order), *levels]

        def model(t, *x, order=order, physical=physical):
            T, r, gain, offset, delay = physical(x)
            return offset + gain * response(np.maximum(t - delay, 0), T, r, order)

        residence, contrast = coordinates(family, T[i], r[i], order)
        start = [np.log(residence), contrast]
        start += [1.0, 0.0, delay[i] / dt] if everything else []
        try:
            options = {"ftol": TOLERANCE, "xtol": TOLERANCE, "method": "lm"}
            row[:] = physical(curve_fit(model, t[i], y[i], start, **options)[0])
        except RuntimeError:  # no convergence: NaN
            pass
    return rows


def costs(family, records, rows):
    """Sum of squares of each record at the parameters an engine found."""

    def one(t, y, n, row):
        T, r, gain, offset, delay = row
        model = family(T=T, r=r, n=n, gain=gain, offset=offset, delay=delay)
        return jnp.sum((y - model.step_response(t)) ** 2)

    t, y, *_, n = records
    each = jax.jit(lambda *a: jax.lax.map(lambda a: one(*a), a, batch_size=256))
    return np.asarray(each(t, y, n, np.asarray(rows)))


# measuring


def seconds(function, records) -> tuple[float, Any]:
    """Median time of a compiled call, of several unless they are long, and its result."""
    compiled, times, result = function.lower(*records).compile(), [], None
    while len(times) < REPETITIONS and sum(times) < ENOUGH:
        start = time.perf_counter()
        result = jax.block_until_ready(compiled(*records))
        times.append(time.perf_counter() - start)
    return float(np.median(times)), result


def chunked(engine, size=CHUNK):
    return lambda *records: jax.lax.map(lambda a: engine(*a), records, batch_size=size)


def evaluation(family, everything, evaluations, t, y, T, r, delay, n):
    """As many evaluations of residuals, derivatives and their sums as a fit needs, no more."""
    known = () if everything else KNOWN
    fit = Problem.of(StepRecord(t, y), family(T=T, r=r, n=n, delay=delay), jnp.ones_like(y), known)

    def again(_, x):
        return x * (1 + 1e-9 * jnp.tanh(jnp.sum(fit.products(x, fit.first_near)[0])))

    return jax.lax.fori_loop(0, evaluations, again, fit.start())


def measure(family, order, everything, engines):
    """Rows of the table for one family, of (a) and some of the other engines."""
    keys = jax.random.split(jax.random.key(1), PLANTS)
    records = over_devices(chunked(functools.partial(draw, family, order, everything)))(keys)
    host = [np.asarray(x) for x in records]
    cost, rows = {}, {}

    engine = functools.partial(by_stepax, family, everything)
    ours = over_devices(jax.vmap(engine))
    duration, (found, steps, bound) = seconds(ours, records)
    cost["a"] = costs(family, host, found)
    rate = PLANTS / duration
    number = round(float(np.mean(steps)))
    floor = over_devices(chunked(functools.partial(evaluation, family, everything, number)))
    least = seconds(floor, records)[0]
    name = "a  stepax.refine"
    rows["a"] = {"engine": name, "plants": PLANTS, "plants/s": rate, "floor": least / duration}
    rows["a"]["bound"] = float(np.mean(bound))

    if "b" in engines:
        other = jax.jit(chunked(functools.partial(by_optimistix, family, everything), VMAPPED))
        single = jax.device_put(records, jax.devices()[0])  # where XLA has threads on all cores
        duration, found = seconds(other, single)
        cost["b"] = costs(family, host, found)
        name = "b  vmap of optimistix"
        rows["b"] = {"engine": name, "plants": PLANTS, "plants/s": PLANTS / duration}

    closed = hudzovic_response if family is Hudzovic else sani_response
    stepped = functools.partial(step_scipy, family)
    loops = [("c", "curve_fit, NumPy", closed, LOOPED), ("d", "curve_fit, lti", stepped, STEPPED)]
    for letter, name, response, count in [loop for loop in loops if loop[0] in engines]:
        some = [x[:count] for x in host]
        start = time.perf_counter()
        found = by_scipy(family, everything, response, *some)
        duration = time.perf_counter() - start
        value = costs(family, some, found)
        cost[letter] = np.append(value, np.full(PLANTS - count, np.nan))
        rows[letter] = {"engine": f"{letter}  {name}", "plants": count}
        rows[letter]["plants/s"] = count / duration

    best = functools.reduce(np.fmin, (np.asarray(x) for x in cost.values()))
    for letter, row in rows.items():
        part = slice(None, row["plants"])
        excess = np.asarray(cost[letter])[part] / best[part] - 1
        excess = np.where(np.isnan(excess), np.inf, excess)
        row["worst excess"] = float(np.max(excess))
        row["within 1e-6"] = float(np.mean(excess <= 1e-6))
        row["a is x times"] = rate / row["plants/s"]
    free = "T, r, gain, offset, delay" if everything else "T, r"
    title = f"{family.__name__}, n = {order or '2...8'}, free: {free}"
    return {"title": title, "rows": list(rows.values())}


def million(count=1_000_000):
    """Plants per second, records drawn per chunk, and the peak memory of this process."""

    def one(key):
        row, steps, _ = by_stepax(Hudzovic, False, *draw(Hudzovic, 4, False, key))
        return row[:2], steps

    compiled = over_devices(chunked(one, VMAPPED))
    keys = jax.random.split(jax.random.key(2), count)
    duration, (found, _) = seconds(compiled, [keys])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    lost = int(np.sum(~np.isfinite(found)))
    return {"plants": count, "plants/s": count / duration, "peak GiB": peak, "not converged": lost}


def show(table, machine):
    sheet = Table(*COLUMNS, title=f"{table['title']}\n{machine}")
    for row in table["rows"]:
        cells = (row.get(name, "") for name in COLUMNS)
        sheet.add_row(*(f"{x:.4g}" if isinstance(x, float) else str(x) for x in cells))
    Console(width=120).print(sheet)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    help_only = "numbers of some cases, 0 to 7: 0 is Hudzovic, n = 4, T and r"
    parser.add_argument("--only", type=int, nargs="+", help=help_only)
    parser.add_argument("--engines", default="bcd", help="beside (a), as letters")
    parser.add_argument("--million", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # curve_fit on covariances, overflow of its trial steps
    use_all_cores()
    machine = f"{jax.devices()[0].device_kind}, {os.cpu_count()} {platform.machine()} cores"
    machine += f", float64, jax {jax.__version__}, load {os.getloadavg()[0]:.1f}"
    if options.million:
        Console().print(machine, million())
        return
    cases = [(f, n, all_) for all_ in (False, True) for f in (Hudzovic, Sani) for n in (4, None)]
    cases = cases if options.only is None else [cases[k] for k in options.only]
    tables = []
    for case in track(cases, transient=True):
        tables.append(measure(*case, options.engines))
        show(tables[-1], machine)
    if options.json:
        options.json.write_text(json.dumps({"machine": machine, "tables": tables}, indent=1))


if __name__ == "__main__":
    main()
