"""The command line: `stepax identify`, `compare`, `trace`, `study`, `methods`, `lookup`.

Heavy imports stand inside the functions that need them, so that `stepax --help` is quick. Bad
input ends with code 2 and one paragraph on stderr; no file is written then.
"""

import contextlib
import functools
import logging
import os
import shlex
import sys
import warnings
from collections.abc import Callable
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from ._cli_lookup import lookup as look_up
from ._cli_picture import OPTIONS, trace as trace_picture
from ._cli_study import study as run_study
from ._options import (
    READING,
    SIMULATED,
    AllRows,
    Example,
    File,
    Files,
    Json,
    Number,
    Plot,
    Report,
    grouped,
    read,
    read_file,
    waiting,
)
from ._setup import set_up_jax as set_up_jax
from .report._files import Outputs


if TYPE_CHECKING:
    from .records._abstract import AbstractRecord
    from .report._origin import Origin


app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _show_version(wanted: bool) -> bool:
    """Print the version and end."""
    if wanted:
        from importlib.metadata import version

        print(version("stepax"))
        raise typer.Exit
    return wanted


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Version.")
    ] = False,
) -> None:
    """Transfer functions from recorded step responses."""


ClickException: type[Exception] = typer.BadParameter.__mro__[2]
"""Wrong usage; newer versions of typer bring their own click, older ones import it."""


def main() -> None:
    """Entry point of the command `stepax`."""
    warnings.simplefilter("ignore")  # on stderr there is one paragraph, or nothing
    logging.getLogger("jax").setLevel(logging.ERROR)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError):
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit code."""
    _ARGUMENTS.set(tuple(arguments))
    try:
        code = app(arguments, prog_name="stepax", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except ClickException as error:
        if type(error).__name__ == "NoArgsIsHelpError":  # its message is the help
            print(error.format_message(), file=sys.stderr)  # type: ignore[attr-defined]
        else:
            complain(error.format_message())  # type: ignore[attr-defined]
        return 2
    except typer.Abort:
        complain("interrupted.")
        return 130


def complain(message: str) -> None:
    """One paragraph on stderr."""
    print("stepax:", " ".join(message.split()), file=sys.stderr)


def _sentence(error: Exception) -> str:
    """What an exception says."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'The file'} cannot be used: {error.strerror}."
    return str(error.args[0]) if error.args else type(error).__name__


def _command(function: Callable) -> Callable:
    """A command: JAX set up, and what goes wrong in one paragraph, with exit code 2."""
    from ._compilation import quick_compilation

    @functools.wraps(function)
    def quickly(*args, **kwargs):
        set_up_jax()
        with quick_compilation():
            function(*args, **kwargs)

    return _plain_command(quickly)


def _plain_command(function: Callable) -> Callable:
    """A command that sets JAX up itself."""

    @app.command(function.__name__.rstrip("_"))
    @functools.wraps(function)
    def command(*args, **kwargs):
        try:
            function(*args, **kwargs)
            sys.stdout.flush()
        except BrokenPipeError:  # the reader has seen enough, as in `stepax methods | head`
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        except (ValueError, TypeError, KeyError, OSError, ImportError) as error:
            complain(_sentence(error))
            raise typer.Exit(2) from None

    return command


# Terminal


def console() -> Console:
    """Standard output; into a pipe or a file nothing is cut, wrapped or coloured."""
    if sys.stdout.isatty():
        return Console()
    return Console(width=1000, no_color=True, force_terminal=False)


def _show(*parts: Any, written: list[Path] = []) -> None:  # noqa: B006 (not changed)
    out = console()
    for part in parts:
        if isinstance(part, str):
            out.print(part, markup=False, highlight=False)
        else:
            out.print(part)
    for path in written:
        out.print(f"Written: {path}", markup=False, highlight=False)


def _heading(record: "AbstractRecord", example: str | None) -> str:
    """What was read, in a line or two."""
    from .report._content import record_line

    return f"{record_line(record)}\n{SIMULATED}" if example else record_line(record)


_ARGUMENTS: ContextVar[tuple[str, ...]] = ContextVar("arguments of the command line", default=())


def _origin(example: str | None, reading: dict[str, Any]) -> "Origin":
    """What a report says of where it comes from."""
    from .report._origin import Origin

    command = shlex.join(["stepax", *_ARGUMENTS.get()])
    return Origin(command, SIMULATED if example else "", reading["step"])


# Commands


@_command
@grouped("reading", READING)
def identify(
    reading: dict[str, Any],
    files: Files = None,
    method: Annotated[str, typer.Option(help="See `stepax methods`.")] = "auto",
    loss: Annotated[str | None, typer.Option(help="Of fits: squares, or huber.")] = None,
    span: Annotated[Number, typer.Option(help="Of tangents: share of rows to smooth over.")] = None,
    fixed: Annotated[
        list[str] | None, typer.Option(help="Of fits: a parameter to hold; may be repeated.")
    ] = None,
    all_rows: AllRows = False,
    plot: Plot = None,
    json: Json = None,
    report: Report = None,
    csv: Annotated[Path | None, typer.Option(help="Several files: write the table as CSV.")] = None,
    example: Example = None,
) -> None:
    """Identify a transfer function from a recorded step response, or one from each of several."""
    options = {"loss": loss, "span": span, "fixed": tuple(fixed) if fixed else None}
    options = {name: value for name, value in options.items() if value is not None}
    options |= {"all_rows": True} if all_rows else {}
    if files is not None and (len(files) > 1 or files[0].is_dir()):
        if json or example:
            raise ValueError("Several files give a table: --csv OUT.csv, and --plot FOLDER.")
        _identify_files(files, reading, method, options, plot, csv, report)
    elif csv is not None:
        raise ValueError("--csv is for several files; of one --json has all numbers.")
    else:
        file = files[0] if files else None
        _identify_file(file, example, reading, method, options, Outputs(plot, json, report))


def _identify_file(
    file: Path | None,
    example: str | None,
    reading: dict[str, Any],
    method: str,
    options: dict[str, Any],
    outputs: Outputs,
) -> None:
    """One file: the report, a picture, JSON."""
    from ._identify import identify as identify_record
    from ._status import Status, refused
    from .report._content import to_json
    from .report._terminal import report

    outputs.check(file)
    record = read(file, example, reading)
    with waiting(f"Identifying {record.labels.source} ..."):
        result = identify_record(record, method, **options)
        if bool(refused(result.status)):
            raise ValueError(f"{record.labels.source}: {Status[result.status]}")
        written = outputs.write(
            result.plot,
            lambda: to_json(result),
            lambda: _page("result_page", result, result.method, _origin(example, reading)),
        )
    said = report(result, result.method, reading["step"])
    _show(_heading(record, example), said, written=written)


def _page(kind: str, *about: Any) -> str:
    """A page of `report/_pages`, which import what draws: a second, only with --report."""
    from .report import _pages
    from .report._html import html

    return html(getattr(_pages, kind)(*about))


def _identify_files(
    files: list[Path],
    reading: dict[str, Any],
    method: str,
    options: dict[str, Any],
    plots: Path | None,
    csv: Path | None,
    page: Path | None,
) -> None:
    """Several files, or the CSV files of folders: a row each, and if wished a picture each."""
    from ._identify_each import Identifications, each_of
    from .report._content import table_of_files
    from .report._files import Outputs, check_folder, write_pictures, write_table
    from .report._terminal import table

    paths = [path for x in files for path in (sorted(x.glob("*.csv")) if x.is_dir() else [x])]
    if not paths:
        raise FileNotFoundError(f"There are no CSV files in {', '.join(map(str, files))}.")
    check_folder(plots)
    for path in paths:
        Outputs(None, csv, page).check(path)
    readers = [(str(path), functools.partial(read_file, path, reading)) for path in paths]
    shown = sys.stderr.isatty()
    found = Identifications(each_of(readers, method, shown, options))
    if not any(outcome.has_model for outcome in found.outcomes):
        first = found.outcomes[0]
        raise ValueError(f"No file could be used; {first.source}: {first.reason}")
    written = write_pictures(found.outcomes, plots) + write_table(found, csv)
    written += Outputs(None, None, page).write(
        lambda: None,
        lambda: None,
        lambda: _page("files_page", found.outcomes, _origin(None, reading)),
    )
    _show(table(table_of_files(found.outcomes)), written=written)


@_command
@grouped("reading", READING)
def compare(
    reading: dict[str, Any],
    file: File = None,
    methods: Annotated[str | None, typer.Option(help="Names, by commas; all if not given.")] = None,
    all_rows: AllRows = False,
    group: Annotated[str, typer.Option(help="all, first, second or nth order.")] = "all",
    kind: Annotated[str, typer.Option(help="Plot: response, bar or pie.")] = "response",
    plot: Plot = None,
    json: Json = None,
    report: Report = None,
    example: Example = None,
) -> None:
    """Identify by all methods and rank the models."""
    from ._compare import check_group, check_kind, compare as compare_methods
    from ._notes import notes_of
    from .report._content import to_json
    from .report._terminal import comparison_report

    check_group(group)
    check_kind(kind)
    outputs = Outputs(plot, json, report)
    outputs.check(file)
    names = None if methods is None else [name.strip() for name in methods.split(",")]
    record = read(file, example, reading)
    with waiting(f"Comparing methods on {record.labels.source} ..."):
        comparison = compare_methods(record, names, all_rows=all_rows)
        kept = comparison.models(group)
        if not comparison.models():
            raise ValueError(
                f"{record.labels.source}: no method gives a model: {comparison.rows[0].reason}"
            )
        if not kept:
            raise ValueError(f"{record.labels.source}: no method of the group {group} gives one.")
        written = outputs.write(
            lambda: comparison.plot(group, kind),
            lambda: [to_json(row.result, row.method) for row in kept],
            lambda: _page("comparison_page", comparison, group, _origin(example, reading)),
        )
    notes = [f"Note: {text}" for text in notes_of(kept[0].result, reading["step"])]
    _show(_heading(record, example), comparison_report(comparison, group), *notes, written=written)


@_command
@grouped("picture", OPTIONS)
@functools.wraps(trace_picture)
def trace(*args: Any, **kwargs: Any) -> None:
    lines, written = trace_picture(*args, **kwargs)
    _show(*lines, written=written)


@_plain_command
@functools.wraps(run_study)
def study(*args: Any, **kwargs: Any) -> None:
    _show(*run_study(*args, **kwargs))


@_command
def app_(
    file: File = None,
    browser: Annotated[bool, typer.Option(help="Open the page in a browser.")] = True,
    port: Annotated[int, typer.Option(help="Port on this machine; 0: a free one.")] = 0,
) -> None:
    """Identify with buttons: a page on this machine, with marks to drag (stepax[app])."""
    from .app._server import serve

    serve(file, browser, port)


@_command
def methods() -> None:
    """List the methods."""
    from .methods import METHODS, MODELS
    from .report._content import Table
    from .report._terminal import table

    rows = [("auto", "several", "Least-squares fits of several families; the best by AICc.")]
    for name, function in METHODS.items():
        text = (function.__doc__ or "").strip().split("\n")[0]
        rows.append((name, MODELS[name].__name__, text))
    _show(table(Table(("method", "model", "what it does"), rows)))


@_command
@functools.wraps(look_up)
def lookup(*args: Any, **kwargs: Any) -> None:
    _show(look_up(*args, **kwargs))
