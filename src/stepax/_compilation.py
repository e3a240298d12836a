"""How functions are compiled: in full, or quickly; one after the other, or side by side."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from typing import Any

import jax


LOOPED = jax.make_user_context(False)
"""Whether sums are compiled as loops: part of the key under which JAX keeps what it compiled."""


def quick_compilation() -> AbstractContextManager[None]:
    """Within it, the sum over the poles of the contour is compiled as a loop and not written out.

    For a process that identifies a few records and ends: it compiles several times faster and
    runs up to five times slower. Results are the same to rounding. It holds for the thread that
    enters it; functions that were compiled outside are compiled anew inside, and kept outside.
    """
    return LOOPED(True)


def side_by_side(tasks: Iterable[Callable[[], Any]]) -> list[Any]:
    """Results of tasks, each in a thread: compiling, most of a first answer, uses all cores.

    A thread does not inherit the context of its maker: each enters it again.
    """
    looped = LOOPED.value

    def run(task: Callable[[], Any]) -> Any:
        with LOOPED(looped):
            return task()

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(run, tasks))
