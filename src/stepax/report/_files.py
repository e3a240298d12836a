"""Files that the command line writes: checked before the work, written whole or not at all."""

import json
import os
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from ._told import FileOutcome


class Outputs(NamedTuple):
    """Files to write, checked before the work and written together after it."""

    plot: Path | None
    json: Path | None
    report: Path | None = None

    def check(self, source: Path | None) -> None:
        """Refuse a file that cannot be written, or that is the record itself."""
        given = {f"--{name}": path for name, path in self._asdict().items() if path is not None}
        targets = [path.resolve() for path in given.values()]
        if len(set(targets)) < len(targets):
            twice = [name for name, path in given.items() if targets.count(path.resolve()) > 1]
            path = given[twice[0]]
            raise ValueError(f"{' and '.join(twice)} name the same file: {path}.")
        for path in targets:
            if not path.parent.is_dir():
                raise FileNotFoundError(f"There is no folder {path.parent} to write {path.name}.")
            if path.exists() and not path.is_file():
                raise OSError(f"{path} cannot be written: it is no ordinary file.")
            if source is not None and path == source.resolve():
                raise ValueError(f"{source} is the record: write to another file.")
            if not os.access(path.parent, os.W_OK):
                raise PermissionError(f"The folder {path.parent} cannot be written to.")
        check_kind_of(self.report, ".html")
        if self.plot is not None:
            from matplotlib.backend_bases import FigureCanvasBase

            known = sorted(FigureCanvasBase.get_supported_filetypes())
            if self.plot.suffix[1:].lower() not in known:
                raise ValueError(
                    f"{self.plot} is no kind of picture that can be written; the endings"
                    f" are {', '.join(known)}."
                )

    def write(
        self,
        figure: Callable[[], Any],
        data: Callable[[], Any],
        page: Callable[[], str] | None = None,
    ) -> list[Path]:
        """Draw and write what is wanted: all of it, or in case of an error nothing."""
        contents: dict[Path, bytes] = {}
        if self.plot is not None:
            contents[self.plot] = _picture(figure(), self.plot.suffix[1:].lower())
        if self.json is not None:
            text = json.dumps(data(), indent=2, ensure_ascii=False, allow_nan=False)
            contents[self.json] = (text + "\n").encode()
        if self.report is not None and page is not None:
            contents[self.report] = page().encode()
        return write_files(contents)


def _picture(figure, kind: str) -> bytes:
    buffer = BytesIO()
    figure.savefig(buffer, format=kind, dpi=150)
    return buffer.getvalue()


def write_files(contents: dict[Path, bytes]) -> list[Path]:
    """Write files by way of temporary ones beside them: all, or in case of an error none."""
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
    return list(contents)


def check_kind_of(path: Path | None, suffix: str) -> None:
    """Refuse a file with another ending than the kind that is written."""
    if path is not None and path.suffix.lower() != suffix:
        raise ValueError(
            f"{path} is written as {suffix[1:].upper()}: let its name end in {suffix}."
        )


# Of several files


def check_folder(folder: Path | None) -> None:
    """Refuse a folder for pictures that cannot be written to."""
    if folder is None:
        return
    if folder.exists() and not folder.is_dir():
        raise OSError(f"{folder} is no folder: of several files each picture is a file in it.")
    if not folder.exists() and not folder.parent.is_dir():
        raise FileNotFoundError(f"There is no folder {folder.parent} to make {folder.name} in.")
    place = folder if folder.exists() else folder.parent
    if not os.access(place, os.W_OK):
        raise PermissionError(f"The folder {place} cannot be written to.")


def check_table(path: Path | None, sources: list[Path]) -> None:
    """Refuse a table that cannot be written, or that is one of the records."""
    if path is None:
        return
    for source in sources:
        Outputs(None, path).check(source)


def write_pictures(outcomes: Sequence[FileOutcome], folder: Path | None) -> list[Path]:
    """A picture of each model, named after its file; files of one name are told apart by number.

    No number makes the name of another file: `run.csv` twice beside `run_2.csv` gives `run_3.png`.
    """
    if folder is None:
        return []
    folder.mkdir(exist_ok=True)
    names = {Path(file.source).stem for file in outcomes}
    written: list[Path] = []
    for file in outcomes:
        if not file.has_model or file.result is None:
            continue
        name = Path(file.source).stem
        path, number = folder / f"{name}.png", 1
        while path in written or (number > 1 and path.stem in names):
            number += 1
            path = folder / f"{name}_{number}.png"
        write_files({path: _picture(file.result.plot(), "png")})
        written.append(path)
    return written


def write_table(found: Any, path: Path | None) -> list[Path]:
    """The table of all files, which has a `to_frame`, as CSV."""
    if path is None:
        return []
    return write_files({path: found.to_frame().to_csv(index=False).encode()})


def write_page(page: str, path: Path) -> None:
    """A page as a file of its own, whose name ends in .html."""
    check_kind_of(path, ".html")
    Outputs(None, None, path).check(None)
    write_files({path: page.encode()})
