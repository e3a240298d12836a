"""Dead-time scan of the area methods per second: `python -m experiments.benchmarks.areas`.

1 000 noisy records of random plants (four classes, 5 % noise) through `rdkam`, both branches, in
one compiled batch on one core and on all, for 200, 500, 1000 and 2000 samples; beside it the same
scan as a NumPy loop, one record and one dead time after the other (the paper's listing, first
branch only), on the first few. Compilation is left out; medians.
"""

import argparse
import os
import time

import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from experiments.cores import use_all_cores
from experiments.maxim.plants import random_records
from stepax import METHODS, StepRecord, over_devices


RECORDS, CHUNK, LOOPED, REPETITIONS = 1000, 25, 2, 3
SIZES = (200, 500, 1000, 2000)
GRID = np.r_[np.arange(50, 100), np.arange(101, 301)] / 100


def scan(name):
    def one(case):
        model = METHODS[name](StepRecord(*case, initial=0.0)).model
        return model.gain, model.delay

    def chunked(*rows):
        parts = [x.reshape(-1, CHUNK, x.shape[-1]) for x in rows]
        return jax.lax.map(jax.vmap(one), tuple(parts))

    return chunked


def looped(t, y):
    """The listing, first branch: the best dead time of all samples."""
    interval, best, Z = t[1] - t[0], (np.inf, 0.0), (GRID - np.sqrt(GRID**2 - 1 + 0j)) ** 2
    gain = np.mean(y[-len(y) // 20 :])
    with np.errstate(all="ignore"):
        for d in range(len(y) - 1):
            s = y[d:]
            area = interval * np.sum(gain - s)
            tau = area / gain
            if tau <= 0:
                continue
            since = interval * np.arange(len(s))
            apart = gain * -np.expm1(-since / tau) - s
            signal = np.append(0, np.cumsum(interval * (apart[1:] + apart[:-1]) / 2))
            k = np.argmax(np.abs(signal))
            a = since[k] / tau
            bracket = 1 - np.exp(-a * Z) / (1 - Z**2) - np.exp(-a / Z) / (1 - Z**-2)
            zeta = GRID[np.nanargmin(np.abs(signal[k] / area - (np.exp(-a) * bracket).real))]
            omega = 2 * zeta / tau
            p = omega * (-zeta + np.sqrt(zeta**2 - 1 + 0j))
            q = omega**2 / p
            g = 1 + ((q * np.exp(p * since) - p * np.exp(q * since)) / (p - q)).real
            square = np.sum((s - gain * g) ** 2) + np.sum(y[:d] ** 2)
            best = min(best, (square, d * interval))
    return best


def seconds(function, rows):
    """Time by the clock and time of the processor, which others on the machine move less."""
    jax.block_until_ready(function(*rows))
    runs = []
    for _ in range(REPETITIONS):
        begin = time.perf_counter(), time.process_time()
        jax.block_until_ready(function(*rows))
        runs.append((time.perf_counter() - begin[0], time.process_time() - begin[1]))
    return np.median(runs, axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    options = parser.parse_args()
    use_all_cores()
    heads = ("one program, ms", "of a core, ms", "all cores, ms", "records/s", "NumPy loop, ms")
    table = Table(
        "samples", *heads, "ratio", title=f"rdkam, both branches; load {os.getloadavg()[0]:.1f}"
    )
    for samples in options.sizes:
        _, t, clean = random_records(3, RECORDS // 20, samples)
        y = clean + 0.05 * np.random.default_rng(0).standard_normal(clean.shape)
        rows = [np.tile(x, (5, 1)) for x in (t, y)]
        rows[1] = rows[1] + 0.02 * np.random.default_rng(1).standard_normal(rows[1].shape)
        alone, busy = seconds(jax.jit(scan("rdkam")), rows) / RECORDS
        together = seconds(over_devices(scan("rdkam")), rows)[0] / RECORDS
        begin = time.process_time()
        for k in range(LOOPED):
            looped(t[k], y[k])
        loop = (time.process_time() - begin) / LOOPED
        numbers = (1e3 * alone, 1e3 * busy, 1e3 * together, 1 / together, 1e3 * loop, loop / busy)
        table.add_row(str(samples), *(f"{x:.3g}" for x in numbers))
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
