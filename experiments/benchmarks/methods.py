"""Least-squares methods as a user calls them: `python -m experiments.benchmarks.methods`.

Simulated records of 0 to 60 time units: two lags (3 to 9, and 0.1 to 1 of that), dead time, gain
and offset drawn, 2 % white noise (`--noise`); everything free. Each method by the plain
`jit(vmap(lambda y: identify(StepRecord(t, y), method)))`, float64, one device, in turn with

- hand: the fastest `lax.map(..., batch_size=16, 32, 64, 256)` over the same function (`--hand`;
  above 1 the plain call is faster);
- devices: the plain call through `stepax.over_devices`, one device a core;
- scipy: `curve_fit` (MINPACK) with the analytic model in NumPy, from the same start, all orders
  that the method tries, in a loop on one core; pool: the same in a process on each core, once,
  after the others.

Costs are computed again from the models by one formula; `best` is the share of the records within
1e-6 of the best cost that anyone found for the order kept.

Left out: compilation, which `compile` counts apart, and drawing the records.
"""

import argparse
import functools
import os
import resource
import time
from concurrent.futures import ProcessPoolExecutor

import jax
import numpy as np
from rich.console import Console
from rich.table import Table


NOISE, TURNS, LOOPED = 0.02, 5, 400
SLOW = 30.0
"""Seconds of a call, compiled, from which all are timed once, and not `TURNS` times."""
METHODS = ("fopdt_fit", "sopdt_fit", "hudzovic_fit", "sani_fit")
ORDERS = range(2, 9)


def records(
    count: int, samples: int, seed: int = 0, noise: float = NOISE
) -> tuple[np.ndarray, np.ndarray]:
    """Times, and a row a record."""
    draw = np.random.default_rng(seed)
    t = np.linspace(0.0, 60.0, samples)
    slow = draw.uniform(3, 9, (count, 1))
    fast = slow * draw.uniform(0.1, 0.99, (count, 1))
    delay, gain, offset = (draw.uniform(*ends, (count, 1)) for ends in ((0, 5), (0.5, 3), (-1, 1)))
    x = np.maximum(t - delay, 0)
    g = 1 - (slow * np.exp(-x / slow) - fast * np.exp(-x / fast)) / (slow - fast)
    return t, offset + gain * (g + noise * draw.standard_normal(g.shape))


# SciPy


def fopdt(t, K, b, L, T):
    return b + K * -np.expm1(-np.maximum(t - L, 0) / T)


def sopdt(t, K, b, L, zeta, omega_n):
    x = np.maximum(t - L, 0) * omega_n
    root = np.sqrt(abs(zeta * zeta - 1) or 1e-12)
    if zeta >= 1:
        slow, fast = np.exp((root - zeta) * x), np.exp((-root - zeta) * x)
        return b + K * (1 - (slow + fast) / 2 - zeta * (slow - fast) / (2 * root))
    return b + K * (1 - np.exp(-zeta * x) * (np.cos(root * x) + zeta / root * np.sin(root * x)))


def chain(family, n, t, K, b, L, total, contrast):
    from experiments.benchmarks.fit import parameters, sani_response
    from experiments.numpy_responses import hudzovic_response

    response = hudzovic_response if family.__name__ == "Hudzovic" else sani_response
    T, r = parameters(family, np.exp(total), contrast, n)
    return b + K * response(np.maximum(t - L, 0), T, r, n)


def starts(method: str, t: np.ndarray, y: np.ndarray) -> list[np.ndarray]:
    """Parameters from which SciPy starts, an array for each order: those of our own start."""
    from experiments.benchmarks.fit import coordinates
    from stepax import Hudzovic, Sani, StepRecord
    from stepax.methods import _starts

    def each(start):
        return jax.jit(jax.vmap(lambda y: start(StepRecord(t, y))))(y)

    first, last = y[:, 0], y[:, -1]
    common = [last - first, first]
    if method == "fopdt_fit":
        model = each(lambda r: _starts.first_order_start(r, ()))
        return [np.stack([*common, model.delay, model.T], 1)]
    if method == "sopdt_fit":
        model = each(lambda r: _starts.second_order_start(r, ()))
        return [np.stack([*common, model.delay, model.zeta, model.omega_n], 1)]
    family = Hudzovic if method == "hudzovic_fit" else Sani
    rows = []
    for n in ORDERS:
        model = each(lambda r, n=n: _starts.chain_start(family, r, jax.numpy.asarray(n), ()))
        pairs = [coordinates(family, T, r, n) for T, r in zip(model.T, model.r, strict=True)]
        own = np.array([(np.log(total), contrast) for total, contrast in pairs])
        rows.append(np.column_stack([*common, model.delay, own]))
    return rows


def functions(method: str):
    """Models as SciPy takes them, one for each order."""
    from stepax import Hudzovic, Sani

    if method in ("fopdt_fit", "sopdt_fit"):
        return [fopdt if method == "fopdt_fit" else sopdt]
    family = Hudzovic if method == "hudzovic_fit" else Sani
    return [functools.partial(chain, family, n) for n in ORDERS]


def by_scipy(method: str, t: np.ndarray, y: np.ndarray, begin: list[np.ndarray]) -> np.ndarray:
    """Costs of a loop, a row a record, a column an order; infinite where it fails."""
    from scipy.optimize import curve_fit

    found = np.full((len(y), len(begin)), np.inf)
    for k, (model, start) in enumerate(zip(functions(method), begin, strict=True)):
        for i, row in enumerate(y):
            try:
                x, _ = curve_fit(model, t, row, start[i], method="lm", maxfev=2000)
                delay_kept = x[2] >= 0
                found[i, k] = np.sum((model(t, *x) - row) ** 2) if delay_kept else np.inf
            except (RuntimeError, ValueError):
                pass
    return found


def in_pool(method: str, t, y, begin, cores: int) -> float:
    """Seconds of the same in a process on each core, their start left out."""
    places = np.array_split(np.arange(len(y)), cores)
    with ProcessPoolExecutor(cores) as pool:
        for _ in places:
            pool.submit(by_scipy, method, t, y[:1], [x[:1] for x in begin])
        list(pool.map(len, places))
        start = time.perf_counter()
        tasks = [
            pool.submit(by_scipy, method, t, y[part], [x[part] for x in begin]) for part in places
        ]
        for task in tasks:
            task.result()
        return time.perf_counter() - start


# ours


def figures(t, method, errors, y):
    """What a user keeps of a result."""
    import stepax

    result = stepax.identify(stepax.StepRecord(t, y), method, errors=errors)
    order = getattr(result.model, "n", 0)
    return result.rmse, result.details["steps"], order, result.std


def seconds(call, *arguments) -> float:
    """Of one call."""
    start = time.perf_counter()
    jax.block_until_ready(call(*arguments))
    return time.perf_counter() - start


def in_turn(calls) -> dict[str, float]:
    """Median seconds of each call: in turn, since a machine that drifts would else decide."""
    for call in calls.values():
        seconds(*call)  # compiles
    takes: list[list[float]] = []
    while len(takes) < (TURNS if not takes or max(takes[0]) < SLOW else 1):
        takes.append([seconds(*call) for call in calls.values()])
    return dict(zip(calls, np.median(takes, axis=0).tolist(), strict=True))


def chunked(one, size: int):
    """What a user could write instead of a plain `vmap`."""
    return jax.jit(lambda y: jax.lax.map(one, y, batch_size=size))


def measure(method: str, count: int, samples: int, errors: bool, options) -> dict[str, str]:
    """One row of the table."""
    from stepax import over_devices

    t, y = records(count, samples, noise=options.noise)
    t, y = t.astype(options.dtype), y.astype(options.dtype)
    one = functools.partial(figures, t, method, errors)  # its times have the dtype asked for
    plain, on_device = jax.jit(jax.vmap(one)), jax.device_put(y, jax.devices()[0])
    start = time.perf_counter()
    rmse, steps, order, _ = jax.block_until_ready(plain(on_device))
    first = time.perf_counter() - start
    calls: dict[str, tuple] = {"plain": (plain, on_device)}
    chunks = {f"chunk {size}": (chunked(one, size), on_device) for size in (16, 32, 64, 256)}
    if options.hand:
        calls |= chunks
    if jax.device_count() > 1:
        calls["devices"] = over_devices(jax.vmap(one)), y
    part = y[: min(LOOPED if method in METHODS[:2] else LOOPED // 4, count)].astype(float)
    t = t.astype(float)
    begin = starts(method, t, part) if options.scipy else []
    if options.scipy:
        calls["scipy"] = by_scipy, method, t, part, begin
    takes = in_turn(calls)
    row = {
        "method": method,
        "N": str(samples),
        "records": str(count),
        "errors": "yes" if errors else "no",
        "compile s": f"{first - takes['plain']:.1f}",
        "a second": f"{count / takes['plain']:.0f}",
        "steps": f"{np.median(steps):.0f}, {np.quantile(steps, 0.99):.0f}",
    }
    if options.hand:
        row["of best chunk"] = f"{min(takes[name] for name in chunks) / takes['plain']:.2f}"
    each = {name: take / count for name, take in takes.items() if name in ("plain", "devices")}
    if "devices" in each:
        row["devices"] = f"{1 / each['devices']:.0f}"
    if not options.scipy:
        return row
    loop = takes["scipy"] / len(part)
    row["scipy"] = f"{1 / loop:.0f}"
    row |= {f"{name} x scipy": f"{loop / take:.1f}" for name, take in each.items()}
    pool = in_pool(method, t, part, begin, os.cpu_count() or 1) / len(part)
    row["x pool"] = f"{pool / each['plain']:.1f}"
    ours = samples * np.asarray(rmse, float)[: len(part)] ** 2
    theirs = by_scipy(method, t, part, begin)
    kept = np.asarray(order)[: len(part)] - ORDERS[0] if len(begin) > 1 else 0
    best = np.minimum(ours, theirs[np.arange(len(part)), kept])
    return row | {"best": f"{100 * np.mean(ours <= best * (1 + 1e-6)):.1f} %"}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--methods", nargs="+", default=list(METHODS))
    parser.add_argument("--samples", nargs="+", type=int, default=[200])
    parser.add_argument("--records", nargs="+", type=int, default=[10_000])
    parser.add_argument("--noise", type=float, default=NOISE, help="over the change")
    parser.add_argument("--errors", nargs="+", choices=["yes", "no"], default=["yes"])
    parser.add_argument("--float32", action="store_true")
    parser.add_argument("--hand", action="store_true", help="chunks chosen by hand too")
    parser.add_argument("--no-scipy", dest="scipy", action="store_false")
    parser.add_argument("--devices", type=int, default=1, help="JAX devices on this CPU")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", not options.float32)
    jax.config.update("jax_num_cpu_devices", options.devices)
    options.dtype = np.float32 if options.float32 else np.float64
    rows = [
        measure(method, count, samples, errors == "yes", options)
        for method in options.methods
        for samples in options.samples
        for count in options.records
        for errors in options.errors
    ]
    table = Table(*rows[0])
    for row in rows:
        table.add_row(*row.values())
    Console(width=140).print(table)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"peak memory of this process, records and all, in GiB: {peak:.1f}")


if __name__ == "__main__":
    main()
