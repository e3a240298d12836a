"""How long fits and their gradients compile: `python -m experiments.benchmarks.compiling`.

Seconds of the clock, and processor seconds of all threads, of tracing and compiling one record of
200 rows, everything free, without standard errors, fully optimised and without any cache; the
gradient is that of the dead time in the output.
"""

import argparse
import time

import jax
import jax.numpy as jnp
from rich.console import Console
from rich.table import Table

from stepax import METHODS, StepRecord


SHOWN = ("fopdt_fit", "sopdt_fit", "hudzovic_fit", "sani_fit", "ptn_fit")


def seconds(function, y) -> tuple[float, float]:
    """What one waits, and what both cores do."""
    begin, used = time.perf_counter(), time.process_time()
    jax.jit(function).lower(y).compile()
    return time.perf_counter() - begin, time.process_time() - used


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--methods", nargs="+", default=list(SHOWN), choices=list(SHOWN))
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", False)
    t = jnp.linspace(0.0, 60.0, 200)
    y = 1 - jnp.exp(-jnp.maximum(t - 3, 0) / 8) + 0.01 * jnp.sin(37 * t)
    table = Table("method", "seconds", "processor", "gradient, seconds", "processor")
    for name in options.methods:

        def delay(y, name=name):
            return METHODS[name](StepRecord(t, y), errors=False).model.delay

        row = [*seconds(delay, y), *seconds(jax.grad(delay), y)]
        table.add_row(name, *(f"{x:.1f}" for x in row))
    Console().print(table)


if __name__ == "__main__":
    main()
