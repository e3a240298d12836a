"""Files that the command line writes: checked before the work, written whole or not at all."""

import json
import os
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple


class Outputs(NamedTuple):
    """Files to write, checked before the work and written together after it."""

    plot: Path | None
    json: Path | None

    def check(self, source: Path | None) -> None:
        """Refuse a file that cannot be written, or that is the record itself."""
        targets = [path.resolve() for path in self if path is not None]
        if len(set(targets)) < len(targets):
            raise ValueError(f"--plot and --json name the same file: {self.json}.")
        for path in targets:
            if not path.parent.is_dir():
                raise FileNotFoundError(f"There is no folder {path.parent} to write {path.name}.")
            if path.exists() and not path.is_file():
                raise OSError(f"{path} cannot be written: it is no ordinary file.")
            if source is not None and path == source.resolve():
                raise ValueError(f"{source} is the record: write to another file.")
            if not os.access(path.parent, os.W_OK):
                raise PermissionError(f"The folder {path.parent} cannot be written to.")
        if self.plot is not None:
            from matplotlib.backend_bases import FigureCanvasBase

            known = sorted(FigureCanvasBase.get_supported_filetypes())
            if self.plot.suffix[1:].lower() not in known:
                raise ValueError(
                    f"{self.plot} is no kind of picture that can be written; the endings"
                    f" are {', '.join(known)}."
                )

    def write(self, figure: Callable[[], Any], data: Callable[[], Any]) -> list[Path]:
        """Draw and write what is wanted: all of it, or in case of an error nothing."""
        contents: dict[Path, bytes] = {}
        if self.plot is not None:
            contents[self.plot] = _picture(figure(), self.plot.suffix[1:].lower())
        if self.json is not None:
            text = json.dumps(data(), indent=2, ensure_ascii=False, allow_nan=False)
            contents[self.json] = (text + "\n").encode()
        _replace(contents)
        return list(contents)


def _picture(figure, kind: str) -> bytes:
    buffer = BytesIO()
    figure.savefig(buffer, format=kind, dpi=150)
    return buffer.getvalue()


def _replace(contents: dict[Path, bytes]) -> None:
    """Write files by way of temporary ones beside them."""
    temporary: dict[Path, Path] = {}
    try:
        for path, content in contents.items():
            path = path.resolve()
            temporary[path] = path.with_name(f".{path.name}.{os.getpid()}.tmp")
            temporary[path].write_bytes(content)
        for path, written in temporary.items():
            os.replace(written, path)
    finally:
        for written in temporary.values():
            written.unlink(missing_ok=True)
