"""How functions are compiled: in full or quickly, for which lengths, one by one or side by side."""

import contextlib
import functools
import gc
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer

from ._programs import Program, Shelf, Signature, cache_folder, kept_program, program


FORM = jax.make_user_context("written")
"""Form of the sums over the poles of the contour, part of the key under which JAX keeps what it
compiled: "written" out, which runs fastest; a "loop"; or "products", to compile quickly."""

QUICK: dict[str, Any] = {
    "xla_llvm_disable_expensive_passes": True,
}
if jax.__version_info__[:2] == (0, 10):  # an XLA that does not know an option refuses to compile
    QUICK["xla_cpu_use_fusion_emitters"] = False
    # Passes that cost a tenth of compiling and save nothing in running programs that are used a few
    # times. The first makes two loops of every sum, which rounds less; without it there are half as
    # many loops, each of which is a memory map.
    QUICK["xla_disable_hlo_passes"] = ",".join(
        (
            "tree_reduction_rewriter",
            "simplify-while-loops",
            "while-loop-invariant-code-motion",
            "while-loop-constant-sinking",
            "simplify-conditional",
            "reshape-mover",
            "dynamic-dimension-simplifier",
            "post_scatter_expansion_simplification",
        )
    )

PROGRAMS = Shelf(96)
"""What was compiled quickly: comparisons for five rungs of lengths, or `identify` for twelve.

Each program takes up to 340 memory maps, of which Linux gives 65 530, and up to 40 MB."""


CONTEXTS: dict[str, Callable[[Any], AbstractContextManager]] = {
    "enable_x64": jax.enable_x64,
    "default_device": jax.default_device,
    "default_matmul_precision": jax.default_matmul_precision,
    "numpy_rank_promotion": jax.numpy_rank_promotion,
    "debug_nans": jax.debug_nans,
    "disable_jit": jax.disable_jit,
}
"""Contexts of JAX's that a user may have entered, by the name of their setting."""


def quick_compilation() -> AbstractContextManager[None]:
    """Within it, the sums over the poles of the contour are products, and not written out.

    What `compiled` has made is compiled with few optimisations, too. For a process that identifies
    a few records: it compiles several times faster and runs up to five times slower. Results are
    the same to rounding. It holds for the thread that enters it; functions that were compiled
    outside are compiled anew inside, and kept outside.
    """
    return FORM("products")


def compiled(function: Callable[..., Any], effort: int = 0) -> Callable[..., Any]:
    """`function`, compiled; within `quick_compilation`, and outside of a trace, quickly.

    `effort` 2 compiles twice as long then and runs four times as fast, for what runs long. Where
    JAX has a persistent cache, what was traced is kept there too (`_programs`).
    """
    full = eqx.filter_jit(function)
    options = QUICK | {"xla_backend_optimization_level": effort}

    @functools.wraps(function)
    def run(*args: Any, **kwargs: Any) -> Any:
        if FORM.value != "products" or is_traced((args, kwargs)):
            return full(*args, **kwargs)
        settings = contexts()
        if settings["disable_jit"]:
            return full(*args, **kwargs)
        signature, folder = Signature((args, kwargs)), cache_folder()
        state = tuple(settings.values())

        def make() -> Program:
            kept = folder and kept_program(function, signature, folder, state, options)
            return kept or program(function, signature, options)

        return PROGRAMS.program((run, signature, folder, state), make)(*args, **kwargs)

    return run


def contexts() -> dict[str, Any]:
    """Values of JAX's contexts in this thread."""
    return {name: getattr(jax.config, f"jax_{name}") for name in CONTEXTS}


def is_traced(tree: Any) -> bool:
    """Whether a value is part of a computation that JAX is tracing, or this is within one."""
    # within a trace even a constant of JAX's is traced
    return any(isinstance(leaf, Tracer) for leaf in [jnp.zeros(()), *jax.tree.leaves(tree)])


def rung(size: int) -> int:
    """The least length of a ladder that holds so many rows: 8, 12, 17, 24, 33, 45, 61, 82, ...

    Each is at most a third longer than any record it holds, so that records of other lengths seldom
    compile anew.
    """
    length = 8
    while length < size:
        length = 4 * (length + 1) // 3
    return length


def coarse_rung(size: int) -> int:
    """The same for many records: 8, 32, 128, 512, ...

    Compiling takes seconds and fitting milliseconds: for a folder of files it pays to fill short
    records up four times as long.
    """
    length = 8
    while length < size:
        length *= 4
    return length


def side_by_side(tasks: Iterable[Callable[[], Any]]) -> list[Any]:
    """Results of tasks, each in a thread: compiling, most of a first answer, uses all cores.

    A thread does not inherit the contexts of its maker, such as `with jax.enable_x64(True)`: each
    enters them again.
    """
    form, values = FORM.value, contexts()

    def run(task: Callable[[], Any]) -> Any:
        with contextlib.ExitStack() as stack:
            stack.enter_context(FORM(form))
            for name, value in values.items():
                stack.enter_context(CONTEXTS[name](value))
            return task()

    with no_collection(), ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(run, tasks))


@contextlib.contextmanager
def no_collection() -> Iterator[None]:
    """Within it the process does not look for cyclic garbage.

    Tracing makes little of it, and so many objects to look at that this took a thirtieth of the
    time of a comparison.
    """
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
