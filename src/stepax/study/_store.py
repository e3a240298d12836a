"""A study's folder: one file a chunk, moved into place when it is whole, and what the study is.

Parquet where `pyarrow` is installed, else NumPy's .npz with the same columns. Names with an
underscore or a point in front are no data for readers of Parquet folders, so that
pandas.read_parquet(FOLDER) reads exactly the chunks.
"""

import errno
import json
import os
import secrets
import warnings
import zipfile
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ._study import digest


STUDY = "_study.json"
HASH = "stepax_study"


class Store:
    """Chunks of one study in a folder, which any number of processes may fill.

    `description`: everything that decides the results. `chunk`: records of a chunk, which a folder
    that was begun already keeps. An existing folder of another study is a
    `ValueError`, one that cannot be written an `OSError`, before anything is computed.
    """

    def __init__(self, folder: str | os.PathLike, description: dict[str, Any], chunk: int):
        self.folder, self.chunk = Path(folder), chunk
        self.hash = digest(description)
        self.suffix = ".parquet" if find_spec("pyarrow") else ".npz"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not (self.folder / STUDY).exists():
                strangers = [p.name for p in self.folder.iterdir() if p.suffix in SUFFIXES]
                if strangers:
                    raise ValueError(
                        f"{self.folder} holds {strangers[0]} and no {STUDY}: it is no folder of a"
                        " study. Take another one."
                    )
                self._write_description(description)
            self._check(description)
        except OSError as error:
            raise _sentence(error, self.folder, "cannot hold a study") from error

    def _write_description(self, description: dict[str, Any]) -> None:
        from importlib.metadata import version

        versions = {name: version(name) for name in ("stepax", "jax", "numpy")}
        text = {"hash": self.hash, "versions": versions, "format": self.suffix, "chunk": self.chunk}
        content = json.dumps(text | {"study": description}, indent=1, default=repr)
        self._move_into_place(STUDY, lambda path: path.write_text(content))

    def _check(self, description: dict[str, Any]) -> None:
        try:
            known = json.loads((self.folder / STUDY).read_text())
            there, self.suffix, self.chunk = (known[x] for x in ("hash", "format", "chunk"))
        except (ValueError, KeyError, TypeError):
            raise ValueError(
                f"{self.folder / STUDY} is damaged; its chunks cannot be told from another study's."
                " Remove the folder, or take another one."
            ) from None
        if there != self.hash:
            old, new = known.get("study", {}), json.loads(json.dumps(description, default=repr))
            names = [n for n in new if old.get(n) != new[n]] or ["something"]
            raise ValueError(
                f"{self.folder} holds another study: {', '.join(names)} differ. Take another"
                " folder, or remove this one."
            )
        if self.suffix == ".parquet" and not find_spec("pyarrow"):
            raise ImportError(f'{self.folder} holds Parquet files: pip install "stepax[study]".')

    def path(self, chunk: int) -> Path:
        """File of a chunk."""
        return self.folder / f"chunk-{chunk:07d}{self.suffix}"

    def has(self, chunk: int) -> bool:
        """Whether a chunk has a file."""
        return self.path(chunk).exists()

    def usable(self, chunk: int, rows: int) -> bool:
        """Whether a chunk's file is there, whole and of this study; one that is not is told."""
        if not self.has(chunk):
            return False
        try:
            found, known = _facts(self.path(chunk))
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            found, known = 0, ""
        if found == rows and known == self.hash:
            return True
        warnings.warn(
            f"{self.path(chunk)} is damaged or not of this study; it is computed again.",
            stacklevel=3,
        )
        return False

    def write(self, chunk: int, columns: Mapping[str, Any]) -> None:
        """A chunk's file, whole or not at all; `columns` as `Categories` or arrays."""
        try:
            self._move_into_place(self.path(chunk).name, lambda path: self._save(path, columns))
        except OSError as error:
            raise _sentence(error, self.folder, "cannot take more chunks") from error

    def read(self, chunk: int, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Some columns of a chunk, categories as their numbers."""
        return _load(self.path(chunk), names)

    def _move_into_place(self, name: str, write) -> None:
        temporary = self.folder / f".{name}.{os.getpid()}-{secrets.token_hex(4)}"
        try:
            write(temporary)
            with open(temporary, "rb") as file:
                os.fsync(file.fileno())
            os.replace(temporary, self.folder / name)
        finally:
            temporary.unlink(missing_ok=True)

    def _save(self, path: Path, columns: Mapping[str, Any]) -> None:
        if self.suffix == ".npz":
            arrays: dict[str, Any] = {HASH: np.array(self.hash)}
            for name, x in columns.items():
                if isinstance(x, Categories):
                    arrays |= {name: x.codes, f"{name}_names": np.array(x.names)}
                else:
                    arrays[name] = x
            with open(path, "wb") as file:
                np.savez_compressed(file, **arrays)
            return
        import pyarrow as pa
        import pyarrow.parquet as pq

        arrays = {
            name: pa.DictionaryArray.from_arrays(pa.array(x.codes), pa.array(x.names))
            if isinstance(x, Categories)
            else pa.array(x)
            for name, x in columns.items()
        }
        table = pa.table(arrays).replace_schema_metadata({HASH: self.hash})
        with open(path, "wb") as file:
            pq.write_table(table, file)


SUFFIXES = (".parquet", ".npz")


class Categories:
    """A column of few texts: their names, and a number a row."""

    def __init__(self, codes: np.ndarray, names: list[str]):
        self.codes, self.names = codes, names


def _facts(path: Path) -> tuple[int, str]:
    """Number of rows of a chunk's file, and the hash of its study."""
    if path.suffix == ".npz":
        with np.load(path) as file:
            return file["rmse"].size, str(file[HASH])
    import pyarrow.parquet as pq

    facts = pq.read_metadata(path)
    return facts.num_rows, (facts.metadata or {}).get(HASH.encode(), b"").decode()


def _load(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    if path.suffix == ".npz":
        with np.load(path) as file:
            return {name: file[name] for name in names}
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.ParquetFile(path).read(columns=list(names))
    found = {}
    for name in names:
        column = table[name].combine_chunks()
        dictionary = isinstance(column, pa.DictionaryArray)
        found[name] = (column.indices if dictionary else column).to_numpy(zero_copy_only=False)
    return found


def _sentence(error: OSError, folder: Path, what: str) -> OSError:
    """The same error, said of the folder."""
    reason = error.strerror or str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        reason = "no space is left. What is there stays good: free some and run the same again"
    return type(error)(error.errno, f"{reason} ({folder} {what})", error.filename or str(folder))
