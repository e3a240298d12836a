"""What commands share: the options that say what to read and how, and the reading itself."""

import contextlib
import functools
import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console


if TYPE_CHECKING:
    from .records._record import StepRecord

EXAMPLES = {"heater": "heater.csv"}
SIMULATED = "This record is simulated: it comes with stepax as an example and was not measured."


File = Annotated[Path | None, typer.Argument(help="CSV, text table, Excel or MAT file.")]
Files = Annotated[
    list[Path] | None,
    typer.Argument(help="CSV, text table, Excel or MAT file; several, or a folder."),
]
Plot = Annotated[Path | None, typer.Option(help="Write a plot: PNG, PDF, SVG, ...")]
Json = Annotated[Path | None, typer.Option("--json", help="Write the result as JSON.")]
Example = Annotated[str | None, typer.Option(help="Use a record of the package: heater.")]
AllRows = Annotated[
    bool, typer.Option("--all-rows", help="Use every row of a long log, however long it takes.")
]
Number = float | None

# Name in `read_record`, type and option; each is None where it is not given.
_READING: dict[str, tuple[Any, Any]] = {
    "time": (str, typer.Option(help="Column of the time: name, or number from 1.")),
    "output": (str, typer.Option(help="Column of the output.")),
    "input": (str, typer.Option(help="Column of the input, where the step is found.")),
    "step": (int, typer.Option(help="Which step of the input; -1 is the last.")),
    "step_time": (str, typer.Option(help="Time of the step, where no column tells it.")),
    "step_size": (float, typer.Option(help="Its size; 1 if not given.")),
    "initial": (float, typer.Option(help="Known level of the output before the step.")),
    "final": (float, typer.Option(help="Known level of the output after all transients.")),
    "begin": (str, typer.Option("--from", help="Leave out rows before this time.")),
    "end": (str, typer.Option("--to", help="Leave out rows after this time.")),
    "dayfirst": (bool, typer.Option("--dayfirst", help="Dates have the day before the month.")),
}


def reads_record(function: Callable[..., None]) -> Callable[..., None]:
    """A command whose argument `reading` holds the options that say how a record is read."""
    own = [p for name, p in inspect.signature(function).parameters.items() if name != "reading"]
    shared = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=False if kind is bool else None,
            annotation=Annotated[kind if kind is bool else kind | None, option],
        )
        for name, (kind, option) in _READING.items()
    ]

    @functools.wraps(function)
    def command(**given: Any) -> None:
        reading = {name: given.pop(name) for name in _READING}
        function(reading=reading, **given)

    command.__signature__ = inspect.Signature([*own, *shared])  # type: ignore[attr-defined]
    return command


# The record


@contextlib.contextmanager
def _record_file(file: Path | None, example: str | None) -> Iterator[Path]:
    """The record to read: a file, or one of the package."""
    if (file is None) == (example is None):
        raise ValueError("Give a FILE or --example NAME" + (", not both." if file else "."))
    if file is not None:
        yield file
        return
    if example not in EXAMPLES:
        known = ", ".join(EXAMPLES)
        raise KeyError(f"There is no example {example!r}; the known ones are: {known}.")
    from importlib.resources import as_file, files

    with as_file(files("stepax") / "examples" / EXAMPLES[example]) as path:
        yield path


def read(file: Path | None, example: str | None, reading: dict[str, Any]) -> "StepRecord":
    """The record of a file or an example."""
    from .records._read import read_record

    with _record_file(file, example) as path, waiting(f"Reading {path.name} ..."):
        return read_record(path, **reading)


def waiting(what: str):
    """A spinner and the time that has passed, on stderr where that is a terminal."""
    terminal = Console(stderr=True)
    if not terminal.is_terminal:
        return contextlib.nullcontext()
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    progress = Progress(*columns, console=terminal, transient=True)
    progress.add_task(what, total=None)
    return progress
