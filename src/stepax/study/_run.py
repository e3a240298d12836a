"""Running a study: chunk by chunk, here or on an executor, into memory or a folder."""

import contextlib
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from itertools import islice
from os import PathLike
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._batches import GROUP
from ._chunk import Columns, Task, compute
from ._results import StudyResults, columns_of
from ._store import Store
from ._study import Study


CHUNK = 16 * GROUP
"""Records that are computed together: 250 samples of each take about 100 MB on the way."""

IN_FLIGHT = 64
"""Chunks handed to an executor at once, so that what waits there stays small."""


def run_study(
    study: Study,
    *,
    key: Any = 0,
    chunk: int | None = None,
    store: str | PathLike | None = None,
    progress: bool = False,
    executor: Executor | None = None,
    chunks: slice | None = None,
) -> StudyResults:
    """Identify every record of a study by every method.

    Each plant and its noise depend on the key and the plant's number alone: they are the same to
    the last bit, and results to rounding, for any `chunk`, number of devices or processes, and
    after a resume. Results are float64 under `jax_enable_x64`, else float32. In a process all
    JAX devices take an equal share of a chunk (`over_devices`).

    **Arguments:**

    - `key`: of JAX, or a number for `jax.random.key`.
    - `chunk`: records that are computed together, which bounds the memory; default 16384, at most
        all. A store keeps the one that it was begun with.
    - `store`: a folder, in which each finished chunk is a file at once; a run that was stopped, by
        whatever, goes on with the chunks that are missing. pandas.read_parquet(store) reads it.
        Several processes may work on one folder. Parquet needs `stepax[study]`; without it the
        files are .npz. Of another study it is a `ValueError`, if it cannot be written an `OSError`.
    - `progress`: a bar on stderr with the rate and the time that remains.
    - `executor`: computes the chunks: any executor of Python's, or of a cluster, such as Dask's
        Client(...).get_executor(). A process pool needs the start method "spawn": JAX has
        threads, with which a fork may hang.
    - `chunks`: only these, such as `slice(3, None, 10)` for the fourth of ten jobs; others that the
        store has are read, too.

    **Returns:** `StudyResults`.
    """
    if not isinstance(study, Study):
        raise TypeError(f"run_study needs a Study, got {type(study).__name__}.")
    tasks, folder = _tasks(study, _as_key(key), chunk, store)
    found: dict[int, Columns] = {}
    missing = []
    for number, task in enumerate(tasks):
        if folder is not None and folder.usable(number, _rows(task)):
            found[number] = _read(folder, number, task)
        else:
            missing.append(number)
    wanted = set(range(len(tasks))[chunks or slice(None)])
    missing = [number for number in missing if number in wanted]
    with _progress(progress, study, tasks, len(tasks) - len(missing)) as advance:
        if executor is None:
            results = _here(tasks, missing, folder)
        else:
            results = _elsewhere(tasks, missing, executor)
        for number, columns, fresh in results:
            if folder is not None and fresh:
                records = np.arange(tasks[number].first, tasks[number].last)
                folder.write(number, columns_of(study, records, columns))
            found[number] = columns
            advance(number)
    return _joined(study, tasks, found)


def _as_key(key: Any) -> jax.Array:
    if isinstance(key, int | np.integer) and not isinstance(key, bool):
        return jax.random.key(int(key))
    if isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        if key.ndim == 0:
            return key
    elif isinstance(key, jax.Array | np.ndarray) and key.shape == (2,):
        return jax.random.wrap_key_data(jnp.asarray(key, jnp.uint32))
    raise TypeError(f"key must be a number or jax.random.key(...), got {key!r}.")


def _tasks(
    study: Study, key: jax.Array, chunk: int | None, store: Any
) -> tuple[list[Task], Store | None]:
    """The chunks of a study, and its store."""
    if chunk is not None and (isinstance(chunk, bool) or not isinstance(chunk, int) or chunk < 1):
        raise ValueError(f"chunk must be a whole number of records, got {chunk!r}.")
    data, implementation = np.asarray(jax.random.key_data(key)), str(jax.random.key_impl(key))
    double = bool(jax.config.read("jax_enable_x64"))
    folder = None
    if store is not None:
        precision = "float64" if double else "float32"
        said = {"key": [implementation, *data.tolist()], "precision": precision}
        folder = Store(store, study.describe() | said, _size(study, chunk))
        if chunk is not None and _size(study, chunk) != folder.chunk:
            raise ValueError(
                f"{folder.folder} was begun with chunks of {folder.chunk} records: leave chunk out."
            )
        chunk = folder.chunk
    size = _size(study, chunk)
    return [
        Task(study, (data, implementation), first, min(first + size, study.records), size, double)
        for first in range(0, study.records, size)
    ], folder


def _size(study: Study, chunk: int | None) -> int:
    return min(CHUNK if chunk is None else chunk, study.records)


def _here(
    tasks: Sequence[Task], missing: list[int], folder: Store | None
) -> Iterator[tuple[int, Columns, bool]]:
    """Number and results of each chunk, and whether they are new: another process may have it."""
    damaged = {number for number in missing if folder is not None and folder.has(number)}
    for number in missing:
        task = tasks[number]
        new = folder is not None and number not in damaged and folder.has(number)
        if folder is not None and new and folder.usable(number, _rows(task)):
            yield number, _read(folder, number, task), False
        else:
            yield number, compute(task), True


def _elsewhere(
    tasks: Sequence[Task], missing: list[int], executor: Executor
) -> Iterator[tuple[int, Columns, bool]]:
    """As they come; what has not begun is called off where this ends early."""
    waiting = iter(missing)
    running: dict[Future, int] = {}
    try:
        while True:
            for number in islice(waiting, IN_FLIGHT - len(running)):
                running[executor.submit(compute, tasks[number])] = number
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result(), True
    finally:
        for future in running:
            future.cancel()


def _rows(task: Task) -> int:
    return (task.last - task.first) * len(task.study.options)


def _read(folder: Store, number: int, task: Task) -> Columns:
    found = folder.read(number, ("rmse", "status"))
    shape = task.last - task.first, len(task.study.options)
    return Columns(found["rmse"].reshape(shape), found["status"].reshape(shape))


def _joined(study: Study, tasks: Sequence[Task], found: dict[int, Columns]) -> StudyResults:
    numbers = sorted(found)
    records = [np.arange(tasks[n].first, tasks[n].last) for n in numbers]
    if not numbers:
        empty = np.zeros((0, len(study.options)))
        return StudyResults(study, np.zeros(0, int), empty, empty.astype(np.int8))
    rmse, status = (np.concatenate(x) for x in zip(*(found[n] for n in numbers), strict=True))
    return StudyResults(study, np.concatenate(records), rmse, status)


@contextlib.contextmanager
def _progress(shown: bool, study: Study, tasks: Sequence[Task], done: int):
    """A function that is told of each finished chunk."""
    if not shown:
        yield lambda number: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    sizes = [_rows(task) for task in tasks]
    columns = (
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} identifications"),
        BarColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        total = study.records * len(study.options)
        task = bar.add_task("", total=total, completed=total * done // len(tasks), rate="compiling")

        def advance(number: int) -> None:
            bar.advance(task, sizes[number])
            speed = bar.tasks[0].speed
            bar.update(task, rate=f"{speed:,.0f}/s" if speed else "")

        yield advance
