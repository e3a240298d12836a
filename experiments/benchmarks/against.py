"""This checkout against another: `python -m experiments.benchmarks.against FOLDER [--rounds 3]`.

FOLDER is a checkout of another commit. Both are timed in turn, in processes of their own, by the
same code, which uses public names alone: step responses, least-squares fits and point methods in
batches, float64, all cores as XLA uses them. Printed: the median time of this checkout, and the
ratio other / this (above 1: this one is faster) as the median over the rounds with its range.

Left out: compilation, which `first` counts apart, and importing.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table


HERE = Path(__file__).parents[2]
REPETITIONS = 5


def cases():
    """Name -> function without arguments, compiled at its first call."""
    import jax
    import jax.numpy as jnp

    import stepax
    from stepax import METHODS, Hudzovic, PTn, Sani, StepRecord, refine

    t = jnp.linspace(0.0, 60.0, 200)
    key = jax.random.key(0)
    draw = lambda k, n, a, b: jax.random.uniform(  # noqa: E731
        jax.random.fold_in(key, k), (n,), minval=a, maxval=b
    )

    def responses(model):
        call = jax.jit(jax.vmap(lambda m: m.step_response(t)))
        return lambda: jax.block_until_ready(call(model))

    many = 10_000
    lags = jax.random.uniform(key, (many, 4), minval=1.0, maxval=9.0)
    plants = {
        "response PTn 4": jax.vmap(lambda lags: PTn(lags=lags))(lags),
        "response Sani 4": jax.vmap(lambda T, r: Sani(T=T, r=r, n=4))(
            draw(1, many, 1, 9), draw(2, many, 0.1, 1)
        ),
        "response Hudzovic 4": jax.vmap(lambda T, r: Hudzovic(T=T, r=r, n=4))(
            draw(1, many, 1, 9), draw(2, many, 0.0, 0.3)
        ),
        "response SOPDT": jax.vmap(lambda z, w: stepax.SOPDT(zeta=z, omega_n=w))(
            draw(1, many, 0.1, 3), draw(2, many, 0.1, 1)
        ),
    }
    yield from ((name, responses(model)) for name, model in plants.items())

    count = 2_000
    T, r, delay = draw(3, count, 1, 5), draw(4, count, 0.1, 0.9), draw(5, count, 0, 5)
    clean = jax.vmap(lambda T, r, d: Sani(T=T, r=r, n=3, delay=d).step_response(t))(T, r, delay)
    y = clean + 0.02 * jax.random.normal(key, clean.shape)

    def fits(family, fixed):
        span = 1.0 if family is Sani else 1 / 3

        def fit(row):
            y, T, r, d = row
            start = family(T=1.2 * T, r=0.8 * r * span, n=4, delay=d)
            return refine(StepRecord(t, y), start, fixed, errors=False).model

        call = jax.jit(lambda rows: jax.lax.map(fit, rows, batch_size=32))
        return lambda: jax.block_until_ready(call((y, T, r, delay)))

    known = ("gain", "offset", "delay")
    yield "fit Hudzovic 4: T, r", fits(Hudzovic, known)
    yield "fit Hudzovic 4: all", fits(Hudzovic, ())
    yield "fit Sani 4: all", fits(Sani, ())

    def methods(names, size, **options):
        run = lambda y: [METHODS[n](StepRecord(t, y), **options).model for n in names]  # noqa: E731
        call = jax.jit(jax.vmap(run))
        return lambda: jax.block_until_ready(call(y[:size]))

    yield "fopdt_fit", methods(["fopdt_fit"], 1_000)
    yield "sopdt_fit", methods(["sopdt_fit"], 500)
    yield "hudzovic_fit auto", methods(["hudzovic_fit"], 200)
    classical = "viteckova_1 viteckova_2 latzel harriott smith strejc sundaresan_krishnaswamy"
    yield "seven classical methods", methods(classical.split(), count)


def measure() -> None:
    """In a process of its own: times of all cases, as JSON."""
    import jax

    jax.config.update("jax_enable_x64", True)
    times = {}
    for name, call in cases():
        begin = time.perf_counter()
        call()
        first = time.perf_counter() - begin
        runs = []
        for _ in range(REPETITIONS):
            begin = time.perf_counter()
            call()
            runs.append(time.perf_counter() - begin)
        times[name] = (float(np.median(runs)), first)
    print(json.dumps(times))


def run(checkout: Path) -> dict[str, tuple[float, float]]:
    """Times of a checkout's package by this file."""
    environment = os.environ | {"PYTHONPATH": f"{checkout / 'src'}{os.pathsep}{HERE}"}
    command = [sys.executable, "-m", "experiments.benchmarks.against", "--measure"]
    done = subprocess.run(command, env=environment, cwd=HERE, stdout=subprocess.PIPE, text=True)
    done.check_returncode()
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        return measure()
    if options.folder is None or not (options.folder / "src" / "stepax").is_dir():
        parser.error("give the folder of a checkout of another commit")
    ours, theirs = [], []
    for _ in track(range(options.rounds), description="rounds", console=Console(stderr=True)):
        ours.append(run(HERE))
        theirs.append(run(options.folder.resolve()))
    table = Table("case", "this, ms", "other / this", "range", "first: other / this")
    for name in ours[0]:
        ratios = [b[name][0] / a[name][0] for a, b in zip(ours, theirs, strict=True)]
        first = np.median([b[name][1] / a[name][1] for a, b in zip(ours, theirs, strict=True)])
        milliseconds = 1e3 * np.median([a[name][0] for a in ours])
        table.add_row(
            name, f"{milliseconds:.1f}", f"{np.median(ratios):.3f}",
            f"{min(ratios):.3f} .. {max(ratios):.3f}", f"{first:.2f}",
        )  # fmt: skip
    Console(width=100).print(table)
    return None


if __name__ == "__main__":
    main()
