"""What a user waits for: `python -m experiments.benchmarks.first_answer [--only PART ...]`.

Each part runs in new processes, compilation included, float64, as a user types it:

- `cold`: a new process without any cache: import, first `identify` auto, first `compare`.
- `warm`: the same with JAX's persistent cache filled by a run before.
- `command`: `stepax identify FILE`, cold, warm, and warm for a file of another length on that rung.
- `lengths`: in one process, 50 records of 50 lengths from 60 to 2000 rows: `identify` auto of those
  whose rung was met before; `compare` at another length.
- `files`: 40 files of 40 lengths (60 to 1240 rows) by `stepax identify FOLDER`, cold.
- `scipy`: `curve_fit` of first and second order plus dead time (closed form in NumPy, one start as
  good as ours) on the same records, for scale: two families of the four, without choosing an order.
- `long`: records of 10^5 and 10^6 rows by the command, cold; peak memory in GB.
- `growth`: 300 records of 300 lengths, `identify` auto and `compare` in turn: memory maps and
  resident memory over the records, as a picture (`--out FOLDER`).

Left out: reading of files but in `command` and `files`; plots.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import curve_fit


REPETITIONS = 3
HEAD = """
import time; begin = time.perf_counter()
import jax; jax.config.update("jax_enable_x64", True)
import stepax; imported = time.perf_counter() - begin
from experiments.benchmarks.first_answer import simulated
"""


def simulated(rows: int, seed: int = 0):
    """A simulated record of two lags and a dead time, 1 % noise."""
    from stepax import StepRecord

    return StepRecord(*arrays(rows, seed))


def arrays(rows: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    t = np.linspace(0.0, 60.0, rows)
    x = np.maximum(t - 2.0, 0.0)
    y = 1 + 2 * (1 - (8 * np.exp(-x / 8) - 3 * np.exp(-x / 3)) / 5)
    return t, y + 0.02 * np.random.default_rng(seed).standard_normal(rows)


def in_new_process(code: str, cache: Path | None = None) -> dict[str, float]:
    """Run code that prints a line of JSON."""
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    if cache is not None:
        environment |= {
            "JAX_COMPILATION_CACHE_DIR": str(cache),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.05",
        }
    done = subprocess.run(
        [sys.executable, "-c", HEAD + code], env=environment, stdout=subprocess.PIPE, text=True
    )
    done.check_returncode()
    return json.loads(done.stdout.splitlines()[-1])


FIRST = """
import json
record = simulated(300)
a = time.perf_counter(); stepax.identify(record); b = time.perf_counter()
print(json.dumps({"import": imported, "identify": b - a, "both": imported + b - a}))
"""
COMPARE = """
import json
record = simulated(300)
a = time.perf_counter(); stepax.compare(record); b = time.perf_counter()
print(json.dumps({"compare": b - a, "both": imported + b - a}))
"""


def median(runs: list[dict[str, float]]) -> dict[str, float]:
    return {name: float(np.median([run[name] for run in runs])) for name in runs[0]}


def cold(out: Path) -> dict[str, float]:
    first = median([in_new_process(FIRST) for _ in range(REPETITIONS)])
    every = median([in_new_process(COMPARE) for _ in range(REPETITIONS)])
    return {
        "import": first["import"],
        "import + first identify (goal 6)": first["both"],
        "import + first compare (goal 20)": every["both"],
    }


def warm(out: Path) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as cache:
        in_new_process(FIRST, Path(cache))
        in_new_process(COMPARE, Path(cache))
        first = median([in_new_process(FIRST, Path(cache)) for _ in range(REPETITIONS)])
        every = median([in_new_process(COMPARE, Path(cache)) for _ in range(REPETITIONS)])
    return {
        "import + first identify (goal 2.5)": first["both"],
        "import + first compare (goal 5)": every["both"],
    }


def written(folder: Path, rows: int) -> Path:
    path = folder / f"run_{rows}.csv"
    np.savetxt(path, np.stack(arrays(rows, rows)).T, delimiter=",", header="time,y", comments="")
    return path


def timed(cache: str, *arguments, what: str = "identify") -> float:
    return resources(cache, *arguments, what=what)[0]


def resources(cache: str, *arguments, what: str = "identify") -> tuple[float, float]:
    """Seconds of the command, and its peak memory in GB."""
    begin = time.perf_counter()
    command = subprocess.Popen(
        [sys.executable, "-c", "from stepax._cli import main; main()", what, *arguments],
        env=os.environ | {"XDG_CACHE_HOME": cache},
        stdout=subprocess.DEVNULL,
    )
    _, status, used = os.wait4(command.pid, 0)
    assert status == 0
    return time.perf_counter() - begin, used.ru_maxrss / 1e6


def command(out: Path) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as cache:
        known, other = (str(written(Path(folder), rows)) for rows in (300, 340))
        first = timed(cache, known)
        again = float(np.median([timed(cache, known) for _ in range(REPETITIONS)]))
        unseen = float(np.median([timed(cache, other) for _ in range(REPETITIONS)]))
    return {"cold": first, "warm (goal 3)": again, "warm, another length (goal 3)": unseen}


LENGTHS = """
import json, numpy as np
from stepax._compilation import rung
sizes = np.random.default_rng(0).permutation(np.linspace(60, 2000, 50).astype(int)).tolist()
met, times = set(), []
for rows in sizes:
    record = simulated(rows, rows)
    a = time.perf_counter(); stepax.identify(record); took = time.perf_counter() - a
    if rung(rows) in met:
        times.append(took)
    met.add(rung(rows))
stepax.compare(simulated(300))
a = time.perf_counter(); stepax.compare(simulated(333)); b = time.perf_counter()
print(json.dumps({"median (goal 0.04)": float(np.median(times)),
    "95th percentile (goal 0.15)": float(np.quantile(times, 0.95)),
    "compare, another length (goal 0.5)": b - a}))
"""


def lengths(out: Path) -> dict[str, float]:
    return in_new_process(LENGTHS)


def files(out: Path) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as cache:
        for rows in np.linspace(60, 1240, 40).astype(int):
            written(Path(folder), int(rows))
        return {"40 files (goal 15)": timed(cache, folder)}


def scipy(out: Path) -> dict[str, float]:
    def first_order(t, K, T, L, b):
        return b + K * -np.expm1(-np.maximum(t - L, 0) / T)

    def second_order(t, K, T, r, L, b):
        x, s = np.maximum(t - L, 0), r * T
        return b + K * (1 - (T * np.exp(-x / T) - s * np.exp(-x / s)) / (T - s))

    t, y = arrays(300)
    takes = {}
    for name, model, start in (
        ("curve_fit, first order", first_order, (2.0, 9.0, 3.0, 1.0)),
        ("curve_fit, second order", second_order, (2.0, 7.0, 0.4, 2.5, 1.0)),
    ):
        runs = []
        for _ in range(20):
            begin = time.perf_counter()
            curve_fit(model, t, y, start)
            runs.append(time.perf_counter() - begin)
        takes[name] = float(np.median(runs))
    return takes


def long(out: Path) -> dict[str, float]:
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        path, longer = (str(written(Path(folder), rows)) for rows in (100_000, 1_000_000))
        for what, file, name in (
            ("identify", path, "identify, 10^5 rows (goal 10)"),
            ("compare", path, "compare, 10^5 rows (goal 30)"),
            ("identify", longer, "identify, 10^6 rows"),
        ):
            with tempfile.TemporaryDirectory() as cache:
                found[name], memory = resources(cache, file, what=what)
    return found | {"peak of the last in GB (goal 2)": memory}


GROWTH = """
import json
def usage():
    with open("/proc/self/maps") as maps: count = sum(1 for _ in maps)
    with open("/proc/self/status") as status:
        resident = next(int(x.split()[1]) for x in status if x.startswith("VmRSS"))
    return count, resident / 1024
rows = []
for k, size in enumerate(range(60, 2160, 7)):
    record = simulated(size, k)
    stepax.compare(record) if k % 2 else stepax.identify(record)
    rows.append(usage())
print(json.dumps(rows))
"""


def growth(out: Path) -> dict[str, float]:
    from matplotlib.figure import Figure

    maps, memory = np.array(in_new_process(GROWTH)).T
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(maps, color="#0b2a4a")
    above.axhline(65530, color="0.4", linestyle="--", linewidth=0.9)
    above.set_ylabel("memory maps")
    above.text(3, 65530, "where Linux stops", va="bottom", fontsize=8)
    below.plot(memory, color="#c8500a")
    below.set_ylabel("resident memory (MiB)")
    below.set_xlabel("records of as many lengths, identify and compare in turn")
    for axes in (above, below):
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_ylim(0)
    path = out / "first_answer_growth.png"
    figure.savefig(path, dpi=150)
    print("written:", path)
    half = len(maps) // 2
    return {
        "maps after 300 records": float(maps[-1]),
        "of them from the second half": float(maps[-1] - maps[half]),
        "resident MiB": float(memory[-1]),
        "of them from the second half ": float(memory[-1] - memory[half]),
    }


PARTS = {x.__name__: x for x in (cold, warm, command, lengths, files, scipy, long, growth)}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--out", type=Path, default=Path("."), help="folder for the picture")
    options = parser.parse_args()
    table = Table("part", "what", "seconds")
    for name in options.only:
        for what, value in PARTS[name](options.out).items():
            table.add_row(name, what, f"{value:.4g}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
