"""What commands share: the options that say what to read and how, and the reading itself."""

import contextlib
import functools
import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer
from rich.console import Console

from ._cli_picture import OPTIONS, picture_record


if TYPE_CHECKING:
    from .records._input import InputRecord
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
Report = Annotated[
    Path | None, typer.Option("--report", help="Write a page to hand over, as HTML.")
]
Example = Annotated[str | None, typer.Option(help="Use a record of the package: heater.")]
AllRows = Annotated[
    bool, typer.Option("--all-rows", help="Use every row of a long log, however long it takes.")
]
Number = float | None

_READING: dict[str, Any] = {
    "time": Annotated[str | None, typer.Option(help="Column of the time: name, or number from 1.")],
    "output": Annotated[str | None, typer.Option(help="Column of the output.")],
    "input": Annotated[
        str | None, typer.Option(help="Column of the input, where the step is found.")
    ],
    "step": Annotated[int | None, typer.Option(help="Which step of the input; -1 is the last.")],
    "step_time": Annotated[
        str | None, typer.Option(help="Time of the step, where no column tells it.")
    ],
    "step_size": Annotated[float | None, typer.Option(help="Its size; 1 if not given.")],
    "initial": Annotated[
        float | None, typer.Option(help="Known level of the output before the step.")
    ],
    "final": Annotated[
        float | None, typer.Option(help="Known level of the output after all transients.")
    ],
    "begin": Annotated[str | None, typer.Option("--from", help="Leave out rows before this time.")],
    "end": Annotated[str | None, typer.Option("--to", help="Leave out rows after this time.")],
    "whole": Annotated[
        bool, typer.Option("--whole", help="Use the whole log with its input as it is.")
    ],
    "hold": Annotated[
        str | None, typer.Option(help="With --whole: input between samples, zero or first.")
    ],
    "moving": Annotated[
        bool, typer.Option("--moving", help="With --whole: not at rest at the first row.")
    ],
    "drift": Annotated[
        bool, typer.Option("--drift", help="With --whole: find a linear drift, too.")
    ],
    "dayfirst": Annotated[
        bool, typer.Option("--dayfirst", help="Dates have the day before the month.")
    ],
}
"""Options that say how a table is read, by their names in `read_record`."""

_OF_PICTURES = {name: option for name, option in OPTIONS.items() if name not in _READING}
"""Options that only pictures have."""

_OF_BOTH = ("step_time", "step_size")

READING = _READING | _OF_PICTURES
"""Options that say how a file is read."""


def grouped(argument: str, options: dict[str, Any]) -> Callable[[Callable], Callable]:
    """A decorator: one argument of a command is a dictionary of options by name.

    They are False or None where they are not given.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        own = [p for name, p in inspect.signature(function).parameters.items() if name != argument]
        shared = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=False if get_args(kind)[0] is bool else None,
                annotation=kind,
            )
            for name, kind in options.items()
        ]

        @functools.wraps(function)
        def command(**given: Any) -> Any:
            return function(**{argument: {name: given.pop(name) for name in options}}, **given)

        command.__signature__ = inspect.Signature([*own, *shared])  # type: ignore[attr-defined]
        return command

    return decorate


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


def read(
    file: Path | None, example: str | None, reading: dict[str, Any]
) -> "StepRecord | InputRecord":
    """The record of a file or an example."""
    with _record_file(file, example) as path, waiting(f"Reading {path.name} ..."):
        return read_file(path, reading)


def read_file(path: Path, reading: dict[str, Any]) -> "StepRecord | InputRecord":
    """The record of a table or of a picture."""
    from .records.image._picture import SUFFIXES

    given = [name for name, value in reading.items() if value is not None and value is not False]
    if path.suffix.lower() in SUFFIXES:
        asked = [name for name in given if name in _READING and name not in _OF_BOTH]
        if asked:
            option = asked[0].replace("_", "-")
            raise ValueError(f"{path.name} is a picture, without columns: leave out --{option}.")
        return picture_record(path, {name: reading[name] for name in OPTIONS})
    asked = [name for name in given if name in _OF_PICTURES]
    if asked:
        option = asked[0].replace("_", "-")
        raise ValueError(f"{path.name} is no picture: --{option} is for pictures of a plot.")
    from .records._read import read_record

    options = {name: reading[name] for name in _READING}
    options["at_rest"] = not options.pop("moving")
    asked = [name for name in ("hold", "moving", "drift") if reading[name]]
    if asked and not reading["whole"]:
        raise ValueError(f"--{asked[0]} is for the whole log: give --whole too.")
    return read_record(
        path, **options | {"whole": options["whole"] or None, "hold": options["hold"] or "zero"}
    )


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
