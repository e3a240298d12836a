"""Functions compiled for arguments of one form: how many are held, and what is kept of them.

A process that meets records of ever other lengths would hold more and more of them, until Linux
refuses another memory map; a `Shelf` forgets those that were not used for the longest time.

JAX's persistent cache spares a new process the compilation, not the tracing, which for a comparison
takes seconds of Python. Where that cache has a folder, what is compiled quickly is exported
(`jax.export`: StableHLO, no machine code) to a file there, and the next process begins with that.
"""

import functools
import hashlib
import io
import os
import pickle
import sys
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import optimistix as optx
from jax import export


NOT_KEPT = (
    ValueError,
    TypeError,
    AttributeError,
    ImportError,
    NotImplementedError,
    pickle.PicklingError,
)
"""What exporting or pickling raise for a function or an option that cannot be kept."""

UNREADABLE = (*NOT_KEPT, OSError, EOFError, LookupError, pickle.UnpicklingError)
"""What a file raises that is missing or damaged."""

KNOWN = ("builtins", "stepax", "jax", "jaxlib", "equinox", "optimistix", "numpy", "collections")
"""Packages whose functions and classes may be part of a program: `versions` tells all of them."""


class Signature:
    """Arguments as a program knows them: their structure, the types of arrays, and all else."""

    def __init__(self, arguments: Any):
        arrays, self.rest = eqx.partition(arguments, eqx.is_array)
        leaves, self.form = jax.tree.flatten(arrays)
        self.types = tuple(jax.typeof(x) for x in leaves)
        values, form = jax.tree.flatten(self.rest)
        # 1 == 1.0 == True, but they are different options
        self._key = self.types, self.form, form, tuple((type(x), x) for x in values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Signature) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def arguments(self, leaves: Sequence[Any]) -> Any:
        """Arguments with these arrays."""
        return eqx.combine(jax.tree.unflatten(self.form, leaves), self.rest)

    def digest(self, *more: Any) -> str:
        """A name that is the same in every process."""
        form = jax.tree.unflatten(self.form, range(len(self.types)))
        text = _pickled((form, self.rest, [str(x) for x in self.types], more))
        return hashlib.sha256(text).hexdigest()[:32]


class _Traced(NamedTuple):
    """An exported program, the form of the arrays that it gives, and what is no array."""

    program: bytes
    form: Any
    rest: Any


def cache_folder() -> Path | None:
    """Where programs are kept; None unless JAX's persistent cache is in use, on this machine."""
    settings: Any = jax.config
    name = settings.jax_compilation_cache_dir
    if not name or "://" in name or not settings.jax_enable_compilation_cache:
        return None
    return Path(name) / "stepax"


class Program:
    """A function, compiled for arguments of one signature when it is called first.

    `call` takes and gives arrays alone; `results` holds, as soon as it was traced, their form and
    what else the function returns.
    """

    def __init__(self, call: Any, results: list[tuple[Any, Any]]):
        self._call, self._results = call, results

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        found = self._call(*jax.tree.leaves(eqx.filter((args, kwargs), eqx.is_array)))
        form, rest = self._results[-1]
        return eqx.combine(jax.tree.unflatten(jax.tree.structure(form), found), rest)

    def forget(self) -> None:
        """Free its memory; called again, it is compiled again."""
        self._call.clear_cache()


class Shelf:
    """The programs of a process, at most `most`: the ones used last."""

    def __init__(self, most: int):
        self._most = most
        self._programs: OrderedDict[Hashable, Program] = OrderedDict()
        self._lock = threading.Lock()

    def program(self, key: Hashable, make: Callable[[], Program]) -> Program:
        """The program of a key, made where there is none."""
        # making may mean tracing, which others need not wait for
        made = self._programs.get(key) or make()
        with self._lock:
            found = self._programs.setdefault(key, made)
            self._programs.move_to_end(key)
            excess = max(len(self._programs) - self._most, 0)
            forgotten = [self._programs.popitem(last=False)[1] for _ in range(excess)]
        for old in forgotten:
            old.forget()
        return found


def program(function: Callable[..., Any], signature: Signature, options: dict[str, Any]) -> Program:
    """`function` for all arguments of a signature. `options`: of the compiler."""
    call, results = _of_arrays(function, signature)
    return Program(jax.jit(call, compiler_options=options), results)


def kept_program(
    function: Callable[..., Any],
    signature: Signature,
    folder: Path,
    settings: tuple[Any, ...],
    options: dict[str, Any],
) -> Program | None:
    """The same, read, or traced and written; None if it cannot.

    `settings`: what else a program depends on.
    """
    if "<" in function.__qualname__:  # a function within a function, of which there may be many
        return None
    try:
        name = signature.digest(function.__module__, function.__qualname__, settings, versions())
        path = folder / f"{name}.traced"
        traced = _read(path)
        if traced is None:
            traced = _trace(function, signature)
            _write(path, traced)
        call = jax.jit(export.deserialize(bytearray(traced.program)).call, compiler_options=options)
    except NOT_KEPT:
        return None
    return Program(call, [(traced.form, traced.rest)])


@functools.cache
def versions() -> tuple[str, ...]:
    """What a traced program depends on: Python, JAX, the solver's library, every file of ours."""
    here = Path(__file__).parent
    sources = [(path, path.stat()) for path in sorted(here.rglob("*.py"))]
    files = [(str(path), state.st_size, state.st_mtime_ns) for path, state in sources]
    libraries = jax.__version__, eqx.__version__, optx.__version__
    return sys.version, *libraries, jax.default_backend(), repr(files)


def _of_arrays(
    function: Callable[..., Any], signature: Signature
) -> tuple[Callable[..., list[Any]], list[tuple[Any, Any]]]:
    """`function` of arrays alone; and a list, of what it returns beside them once it is traced."""
    results = []

    def call(*leaves: Any) -> list[Any]:
        args, kwargs = signature.arguments(leaves)
        arrays, rest = eqx.partition(function(*args, **kwargs), eqx.is_array)
        found, form = jax.tree.flatten(arrays)
        results[:] = [(jax.tree.unflatten(form, range(len(found))), rest)]
        return found

    return call, results


def _trace(function: Callable[..., Any], signature: Signature) -> _Traced:
    call, results = _of_arrays(function, signature)
    text = export.export(jax.jit(call))(*signature.types).serialize()
    return _Traced(bytes(text), *results[-1])


def _read(path: Path) -> _Traced | None:
    """What was written; the folder is the user's own, from which JAX takes machine code too."""
    try:
        return _Traced(*pickle.loads(path.read_bytes()))
    except UNREADABLE:
        return None


def _write(path: Path, traced: _Traced) -> None:
    """Under another name first: two processes may write the same file."""
    text = _pickled(tuple(traced))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(text)
        os.replace(file.name, path)
    except OSError:
        pass  # a full disk or a folder that cannot be written: it is traced again next time


class _Pickler(pickle.Pickler):
    """Refuses functions and classes of which `versions` would not know that they have changed."""

    def persistent_id(self, obj: Any) -> None:
        if callable(obj) and hasattr(obj, "__module__"):
            if (obj.__module__ or "").split(".")[0] not in KNOWN:
                raise pickle.PicklingError(f"{obj!r} is not of a known library.")


def _pickled(value: Any) -> bytes:
    file = io.BytesIO()
    pickler = _Pickler(file)
    # Without a memo: what is equal comes out equal, also where it is not the same object. As an
    # attribute of the class it would hide the one that pickling looks at.
    pickler.fast = True
    pickler.dump(value)
    return file.getvalue()
