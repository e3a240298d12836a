"""Responses to a sampled input: `python -m experiments.benchmarks.respond [--json OUT.json]`.

64 chains of four lags, 4096 samples each, zero-order hold, float64; forward, and forward and
backward (slopes with respect to lags and input). The same linear equation is answered by

- `respond`: `model.respond`, a difference equation in blocks;
- `scan`: a plain `jax.lax.scan` over the samples, discretised by `jax.scipy.linalg.expm`;
- `diffrax`: `diffeqsolve` with Tsit5 at tolerances of 1e-8, the input held between samples;
- `lsim`: `scipy.signal.lsim` in a loop over the plants (forward only).

Medians over interleaved repetitions, one where that takes more than 5 s, compilation left out.
Memory is what XLA says it needs beside arguments and results. `--million`: peak memory of a process
that answers 10^6 samples in one call.
"""

import argparse
import json
import os
import platform
import resource
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import signal

from stepax import PTn


PLANTS, SAMPLES, ORDER, REPETITIONS = 64, 4096, 4, 9
SLOW = 5.0
"""Seconds from which once is enough."""
COLUMNS = ("answered by", "what", "ms", "times respond", "MB", "error")


def respond(lags, u):
    return PTn(lags=lags).respond(np.arange(u.shape[0]), u)


def state_space(lags):
    """A and b of a chain."""
    rates = 1 / lags
    return jnp.diag(rates[1:], -1) - jnp.diag(rates), rates[0] * (jnp.arange(ORDER) == 0)


def scan(lags, u):
    A, b = state_space(lags)
    both = jnp.block([[A, b[:, None]], [jnp.zeros((1, ORDER + 1))]])
    E = jax.scipy.linalg.expm(both)
    F, b = E[:ORDER, :ORDER], E[:ORDER, ORDER]
    return jax.lax.scan(lambda x, u: (F @ x + b * u, x[-1]), jnp.zeros(ORDER), u)[1]


def with_diffrax(lags, u):
    import diffrax  # pyright: ignore[reportMissingImports] (of no extra)

    A, b = state_space(lags)
    times = jnp.arange(u.shape[0], dtype=u.dtype)

    def slope(t, x, _):
        return A @ x + b * u[jnp.clip(t.astype(int), 0, u.shape[0] - 1)]

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(slope),
        diffrax.Tsit5(),
        times[0],
        times[-1],
        0.1,
        jnp.zeros(ORDER),
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=diffrax.ClipStepSizeController(
            diffrax.PIDController(rtol=1e-8, atol=1e-8), jump_ts=times
        ),
        max_steps=8 * u.shape[0],
    )
    return jnp.asarray(solution.ys)[:, -1]


def lsim(lags, u):
    """All plants, one after the other."""
    t = np.arange(u.shape[1])
    plants = [signal.lti([], -1 / x, np.prod(1 / x)) for x in lags]
    return np.stack([signal.lsim(p, x, t, interp=False)[1] for p, x in zip(plants, u, strict=True)])


def backward(function):
    """Value and slopes of the sum of squares."""
    return jax.value_and_grad(lambda lags, u: jnp.sum(function(lags, u) ** 2), (0, 1))


def prepare(lags, u, names):
    """Rows to fill, each with a call that is compiled already."""
    truth = lsim(lags, u)
    host, (lags, u) = (lags, u), jax.device_put((lags, u))
    ours = {"respond": respond, "scan": scan, "diffrax": with_diffrax}
    for name in [name for name in ours if name in names]:
        for what, function in (("forward", ours[name]), ("and backward", backward(ours[name]))):
            compiled = jax.jit(jax.vmap(function)).lower(lags, u).compile()
            row: dict[str, Any] = {"answered by": name, "what": what}
            needs: Any = compiled.memory_analysis()
            row["MB"] = needs.temp_size_in_bytes / 1e6
            y = jax.block_until_ready(compiled(lags, u))
            if what == "forward":
                row["error"] = float(np.max(np.abs(y - truth)) / np.max(np.abs(truth)))
            yield row, lambda f=compiled: jax.block_until_ready(f(lags, u))
    if "lsim" in names:
        yield {"answered by": "lsim", "what": "forward"}, lambda: lsim(*host)


def measure(names, repetitions):
    """All rows; ratios to `respond`."""
    random = np.random.default_rng(0)
    lags = random.uniform(2, 50, (PLANTS, ORDER))
    u = np.sign(random.normal(size=(PLANTS, SAMPLES)))
    prepared = list(prepare(lags, u, names))
    seconds = np.full((repetitions, len(prepared)), np.nan)
    for i, j in np.ndindex(seconds.shape):
        if i and seconds[0, j] > SLOW:
            continue
        start = time.perf_counter()
        prepared[j][1]()
        seconds[i, j] = time.perf_counter() - start
    rows: list[dict[str, Any]] = [row for row, _ in prepared]
    base: dict[str, float] = {}
    for row, median in zip(rows, np.nanmedian(seconds, axis=0), strict=True):
        row["ms"] = float(median) * 1e3
        row["times respond"] = row["ms"] / base.setdefault(row["what"], row["ms"])
    return rows


def million():
    """Peak memory of this process before and after 10^6 samples in one call, in MB."""
    jax.block_until_ready(respond(jnp.ones(ORDER), jnp.ones(10)))
    peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3  # noqa: E731
    before = peak()
    t, u = np.arange(1e6), np.sign(np.sin(np.arange(1e6) / 50))
    jax.block_until_ready(PTn(lags=np.array([5.0, 30, 70, 200]), delay=3.3).respond(t, u))
    return before, peak()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--million", action="store_true")
    parser.add_argument("--repetitions", type=int, default=REPETITIONS)
    parser.add_argument("--only", default="respond,scan,diffrax,lsim", help="names, by commas")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if options.million:
        before, after = million()
        print(f"10^6 samples in one call: peak of the process {after:.0f} MB, {before:.0f} before")
        return
    rows = measure(options.only.split(","), options.repetitions)
    device = f"{jax.devices()[0].device_kind}, {os.cpu_count()} {platform.machine()} CPUs"
    machine = f"{device}, jax {jax.__version__}, load {os.getloadavg()[0]:.1f}"
    table = Table(*COLUMNS, title=f"{PLANTS} plants, {SAMPLES} samples, n = {ORDER}\n{machine}")
    for row in rows:
        values = (row.get(name, "") for name in COLUMNS)
        table.add_row(*(f"{x:.3g}" if isinstance(x, float) else x for x in values))
    Console(width=100).print(table)
    if options.json:
        options.json.write_text(json.dumps({"machine": machine, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
