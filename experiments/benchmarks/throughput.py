"""Throughput of step responses: `python -m experiments.benchmarks.throughput [--json OUT.json]`.

10 000 random plants with 200 samples each in one compiled call, beside the formula that everyone
writes first, partial fractions: y = 1 - sum_j exp(-t/T_j) prod_k T_j/(T_j - T_k). Medians over
interleaved repetitions. The lags are distinct, so that partial fractions work; the error is the
difference from another implementation in float64.

Left out: compilation, transfer to a device, building the plants, derivatives.
"""

import argparse
import json
import os
import platform
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from stepax import Hudzovic, PTn, Sani


PLANTS, SAMPLES, ORDER, REPETITIONS = 10_000, 200, 4, 11
COLUMNS = ("model", "dtype", "ns per sample", "ratio to naive", "max abs error")


def naive(t, lags):
    """Partial fractions, in the fastest of several ways to write them: one fused sum."""
    same = jnp.eye(len(lags), dtype=t.dtype)
    factors = lags[:, None] / (lags[:, None] - lags[None, :] + same)
    residues = jnp.prod(jnp.where(same == 1, 1, factors), axis=1)
    return 1 - sum(residues[j] * jnp.exp(-t / lags[j]) for j in range(len(lags)))


def contour(t, lags):
    return PTn(lags=lags).step_response(t)


def hudzovic(t, T, r, n=ORDER):
    return Hudzovic(T=T, r=r, n=n).step_response(t)


def sani(t, T, r, n=ORDER):
    return Sani(T=T, r=r, n=n).step_response(t)


def batched(response):
    """Compiled, over plants at the same times."""
    return jax.jit(lambda t, *plants: jax.vmap(lambda *p: response(t, *p))(*plants))


def cases():
    """Name, function and its parameters; function and parameters to compare with."""
    random = np.random.default_rng(0)
    T, position = random.uniform(1, 3, PLANTS), random.uniform(0.2, 0.9, PLANTS)
    n = random.integers(2, 9, PLANTS)
    spaced, mixed = (T, position / (ORDER - 1)), (T, position / (n - 1), n)
    lags = (jax.vmap(lambda T, r: Hudzovic(T=T, r=r, n=ORDER).lags)(*spaced),)
    sani_lags = (jax.vmap(lambda T, r: Sani(T=T, r=r, n=ORDER).lags)(T, position),)
    mixed_lags = (jax.vmap(lambda T, r, n: Hudzovic(T=T, r=r, n=n).lags)(*mixed),)
    return [
        ("naive partial fractions", naive, lags, hudzovic, spaced),
        ("PTn: contour", contour, lags, hudzovic, spaced),
        ("Sani: contour", sani, (T, position), naive, sani_lags),
        ("Hudzovic: closed form", hudzovic, spaced, contour, lags),
        ("PTn, n = 2...8: contour", contour, mixed_lags, hudzovic, mixed),
        ("Hudzovic, n = 2...8: closed form", hudzovic, mixed, contour, mixed_lags),
    ]


def prepare(dtype):
    """Rows to fill, each with a call that is compiled already."""
    t = np.linspace(0, 60, SAMPLES)
    for name, function, parameters, other, others in cases():
        arrays = (jnp.asarray(x) for x in (t, *parameters))
        inputs = [x if jnp.issubdtype(x.dtype, jnp.integer) else x.astype(dtype) for x in arrays]
        function = batched(function)
        error = float(jnp.max(jnp.abs(function(*inputs) - batched(other)(t, *others))))
        row = {"model": name, "dtype": np.dtype(dtype).name, "max abs error": error}
        yield row, lambda f=function, x=inputs: jax.block_until_ready(f(*x))


def measure():
    """All rows, with medians of interleaved repetitions."""
    prepared = [pair for dtype in (np.float64, np.float32) for pair in prepare(dtype)]
    seconds = np.empty((REPETITIONS, len(prepared)))
    for i, j in np.ndindex(seconds.shape):
        start = time.perf_counter()
        prepared[j][1]()
        seconds[i, j] = time.perf_counter() - start
    rows, base = [row for row, _ in prepared], {}
    for row, median in zip(rows, np.median(seconds, axis=0), strict=True):
        row["ns per sample"] = float(median) / (PLANTS * SAMPLES) * 1e9
        first = base.setdefault(row["dtype"], row["ns per sample"])  # the naive one
        row["ratio to naive"] = row["ns per sample"] / first
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    path = parser.parse_args().json
    jax.config.update("jax_enable_x64", True)
    device = f"{jax.devices()[0].device_kind}, {os.cpu_count()} {platform.machine()} CPUs"
    machine = f"{device}, jax {jax.__version__}, load {os.getloadavg()[0]:.1f}"
    rows = measure()
    table = Table(*COLUMNS, title=f"{PLANTS} plants, {SAMPLES} samples, n = {ORDER}\n{machine}")
    for row in rows:
        values = (row[name] for name in COLUMNS)
        table.add_row(*(f"{x:.3g}" if isinstance(x, float) else x for x in values))
    Console(width=100).print(table)
    if path:
        path.write_text(json.dumps({"machine": machine, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
