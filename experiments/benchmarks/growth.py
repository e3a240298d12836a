"""Time of a study against its size: `python -m experiments.benchmarks.growth --out DIR`.

A lookup and the fit of T and r from it, on random plants of order 4 with 2 % noise: 10^3 to 10^6
plants of 250 samples, and 10^4 plants of 50 to 2000 samples; float64, in chunks of 1000. Each by
one device and by one device a core (a process each, since JAX counts devices once). Compilation,
which does not grow, is left out: a first chunk is computed before the clock starts. Exponents are
slopes of a line through the points on logarithmic axes.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from experiments.drawing import new_figure, quiet
from stepax import Study, run_study


METHODS = {
    "hudzovic_t10_t50_t90": {},
    "hudzovic_fit": {"order": "hudzovic_t10_t50_t90", "fixed": ("delay",)},
}
PLANTS, SAMPLES = (1_000, 10_000, 100_000, 1_000_000), (50, 250, 700, 2000)
PLANTS_OF_SAMPLES, SAMPLES_OF_PLANTS, CHUNK = 10_000, 250, 1000


def seconds(plants: int, samples: int) -> float:
    """Time of a study without its compilation."""
    study = Study(METHODS, orders=[4], plants=plants, noise=[0.02], samples=samples)
    run_study(study, chunk=CHUNK, chunks=slice(0, 1))
    start = time.perf_counter()
    run_study(study, chunk=CHUNK)
    return time.perf_counter() - start


def measured(devices: int, largest: int) -> None:
    """All points on a number of devices, as JSON on stdout."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", devices)
    plants = {n: seconds(n, SAMPLES_OF_PLANTS) for n in PLANTS if n <= largest}
    samples = {n: seconds(min(PLANTS_OF_SAMPLES, largest), n) for n in SAMPLES}
    print(json.dumps({"plants": plants, "samples": samples}))


def exponent(points: dict[str, float]) -> float:
    x, y = (np.log(np.array(list(values), float)) for values in (points, points.values()))
    return float(np.polyfit(x, y, 1)[0])


def picture(found: dict[int, dict[str, dict[str, float]]]) -> Figure:
    figure = new_figure((11, 4.5))
    panels = figure.subplots(1, 2)
    looks = zip(found.items(), (("#1f5fa8", "o-"), ("#d2560a", "s--")), strict=False)
    for (devices, of), (color, style) in looks:
        for axes, kind in zip(panels, ("plants", "samples"), strict=True):
            points = of[kind]
            label = f"{devices} device{'s' * (devices > 1)}: exponent {exponent(points):.2f}"
            x = [int(n) for n in points]
            axes.loglog(x, list(points.values()), style, color=color, label=label)
    panels[0].set(xlabel=f"plants, {SAMPLES_OF_PLANTS} samples each", ylabel="seconds")
    panels[1].set(xlabel=f"samples, of {PLANTS_OF_SAMPLES:,} plants", ylabel="seconds")
    for axes in panels:
        axes.legend(frameon=False)
    quiet(panels)
    figure.suptitle("Time of a study: a lookup and a fit of T and r, float64")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks"))
    parser.add_argument("--largest", type=int, default=PLANTS[-1], help="most plants")
    parser.add_argument("--measure", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        measured(options.measure, options.largest)
        return
    options.out.mkdir(parents=True, exist_ok=True)
    found = {}
    for devices in sorted({1, os.cpu_count() or 1}):
        own = [sys.executable, "-m", "experiments.benchmarks.growth", "--measure", str(devices)]
        command = [*own, "--largest", str(options.largest)]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
        found[devices] = json.loads(done.stdout)
    (options.out / "growth.json").write_text(json.dumps(found, indent=1))
    picture(found).savefig(options.out / "growth.png", dpi=150)
    table = Table("", *(f"{n} devices, s" for n in found), "us a plant", "ratio")
    for kind in ("plants", "samples"):
        for size in found[1][kind]:
            times = [of[kind][size] for of in found.values()]
            plants = int(size) if kind == "plants" else min(PLANTS_OF_SAMPLES, options.largest)
            row = [f"{x:.3g}" for x in (*times, 1e6 * times[-1] / plants, times[0] / times[-1])]
            table.add_row(f"{int(size):,} {kind}", *row)
        table.add_row("exponent", *(f"{exponent(of[kind]):.2f}" for of in found.values()))
        table.add_section()
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
