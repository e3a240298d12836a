"""Reading a picture of a plot: `python -m experiments.benchmarks.picture`.

Seconds of `trace_image` for a plot of 2000 x 1300 pixels, the median of five, and the largest
memory of the process. Left out: drawing it.
"""

import resource
import tempfile
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from stepax import trace_image


def main() -> None:
    figure = Figure(figsize=(10, 6.5), dpi=200)
    axes = figure.subplots()
    t = np.linspace(0, 10, 500)
    axes.plot(t, 20 + 18 * (1 - np.exp(-t / 2)))
    axes.set_xlim(0, 10)
    axes.set_ylim(18, 40)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plot.png"
        figure.savefig(path)
        takes = []
        for _ in range(5):
            start = time.perf_counter()
            trace_image(path, x_range=(0, 10), y_range=(18, 40))
            takes.append(time.perf_counter() - start)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{np.median(takes):.2f} s, {memory:.0f} MiB")


if __name__ == "__main__":
    main()
