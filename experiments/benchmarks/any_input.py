"""What a fit to a sampled input costs: `python -m experiments.benchmarks.any_input`.

The plain `jit(vmap(...))` of a fit to records of 2000 rows of one plant, a batch of 256, 5 % noise:
answers to a step, and to a pseudo-random binary input that changes every 10 rows at most, held
between samples. Standard errors on; one core; compilation is left out. Time of the processor, which
others on the machine move less than that by the clock; the least of some runs.
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from stepax import FOPDT, METHODS, SOPDT, Hudzovic, InputRecord, Sani, StepRecord
from stepax.records._record import predict


CLOCK, NOISE = 10, 0.05
PLANTS = {
    "fopdt_fit": (FOPDT(T=8.0, gain=2.0, delay=3.3), {}),
    "sopdt_fit": (SOPDT(zeta=0.5, omega_n=0.5, gain=2.0, delay=3.3), {}),
    "hudzovic_fit": (Hudzovic(T=3.0, r=0.2, n=4, gain=2.0, delay=2.0), {"order": 4}),
    "sani_fit": (Sani(T=8.0, r=0.6, n=3, gain=2.0, delay=2.0), {"order": 3}),
}


def outputs(record, plant, lanes, random):
    """Noisy outputs of a plant that answers to the input of a record."""
    clean = np.asarray(predict(plant, record))
    noise = NOISE * np.std(clean) * random.standard_normal((lanes, clean.size))
    return jnp.asarray(clean + noise)


def seconds(fit, y, repetitions):
    """The least time, and the mean number of steps."""
    jax.block_until_ready(fit(y))
    runs, steps = [], jnp.zeros(0)
    for _ in range(repetitions):
        begin = time.process_time()
        steps = jax.block_until_ready(fit(y))
        runs.append(time.process_time() - begin)
    return min(runs), float(jnp.mean(steps))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--rows", type=int, default=2000)
    parser.add_argument("--lanes", type=int, default=256)
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--methods", nargs="+", default=list(PLANTS), choices=list(PLANTS))
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    random = np.random.default_rng(0)
    t = np.linspace(0.0, 100.0, options.rows)
    u = np.repeat(random.integers(0, 2, -(-t.size // CLOCK)), CLOCK)[: t.size].astype(float)
    kinds = {
        "step": lambda y: StepRecord(t, y),
        "input": lambda y: InputRecord(t, y, u),
        "input, first": lambda y: InputRecord(t, y, u, hold="first"),
    }
    table = Table("method", *(f"{name}, ms a fit (steps)" for name in kinds), "input / step")
    for method in options.methods:
        plant, asked = PLANTS[method]
        found = []
        for record in kinds.values():

            def fit(y, record=record, method=method, asked=asked):
                result = METHODS[method](record(y), **asked)
                return result.details["steps"] + 0 * result.std["delay"]

            y = outputs(record(t), plant, options.lanes, random)
            found.append(seconds(jax.jit(jax.vmap(fit)), y, options.repetitions))
        cells = [f"{1e3 * time / options.lanes:.2f} ({steps:.1f})" for time, steps in found]
        table.add_row(method, *cells, f"{found[1][0] / found[0][0]:.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
