"""The command `stepax study`: a Monte Carlo study into a folder, and a picture of it."""

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer


if TYPE_CHECKING:
    from .study._results import StudyResults


def set_up_study(single: bool) -> None:
    """Double precision unless `single`, and a JAX device for each core."""
    import jax

    jax.config.update("jax_enable_x64", not single)
    with contextlib.suppress(RuntimeError):  # JAX runs already, in a process that does more
        jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)


def study(
    methods: Annotated[str, typer.Option(help="Names, by commas; see `stepax methods`.")],
    out: Annotated[Path, typer.Option(help="Folder of the results; one that is there goes on.")],
    orders: Annotated[str, typer.Option(help="Orders of the plants: 2-8, or 2,4.")] = "2,4",
    noise: Annotated[str, typer.Option(help="Standard deviations over the change.")] = "0,0.02",
    plants: Annotated[int, typer.Option(help="Random plants of each order.")] = 100,
    draws: Annotated[int, typer.Option(help="Draws of noise for each plant and level.")] = 1,
    samples: Annotated[int, typer.Option(help="Samples of each record.")] = 250,
    span: Annotated[
        float | None, typer.Option(help="Smooth over this share, for all methods but fits.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the random numbers.")] = 0,
    chunk: Annotated[int | None, typer.Option(help="Records computed together.")] = None,
    chunks: Annotated[
        str | None, typer.Option(help="Only chunks FIRST::STEP, one of STEP jobs, or FROM:TO.")
    ] = None,
    uniform: Annotated[
        bool, typer.Option("--uniform", help="Noise is uniform, its levels peak to peak.")
    ] = False,
    single: Annotated[bool, typer.Option("--float32", help="Single precision.")] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Picture of the summary; OUT.png if not given.")
    ] = None,
) -> list[str]:
    """Monte Carlo: random plants identified by several methods under noise, into a folder."""
    set_up_study(single)
    from .methods import FITS
    from .study._noise import UniformNoise
    from .study._run import run_study
    from .study._study import Study

    names = [name.strip() for name in methods.split(",")]
    options: dict[str, dict[str, Any]] = {
        name: {} if span is None or name in FITS else {"span": span} for name in names
    }
    levels: list[Any] = [_number(x, "--noise") for x in noise.split(",")]
    asked = Study(
        options,
        orders=_whole_numbers(orders),
        noise=[UniformNoise(x) for x in levels] if uniform else levels,
        plants=plants,
        draws=draws,
        samples=samples,
    )
    picture = plot or out.with_name(out.name + ".png")
    if not picture.parent.is_dir():
        raise FileNotFoundError(f"There is no folder {picture.parent} for {picture.name}.")
    try:
        found = run_study(
            asked, key=seed, chunk=chunk, store=out, progress=True, chunks=_chunks(chunks)
        )
    except KeyboardInterrupt:
        said = f"stepax: interrupted. Finished chunks are in {out}: the same command goes on."
        typer.echo(said, err=True)
        raise typer.Exit(130) from None
    if len(found):
        found.plot().savefig(picture, dpi=150)
    return [*_table(found), f"Written: {out}, {picture}" if len(found) else f"Written: {out}"]


def _table(found: "StudyResults") -> list[str]:
    """Medians and refusals by method and noise, in lines."""
    if not found.complete:
        share = found.records.size / found.study.records
        return [f"{100 * share:.1f} % of the records are there."]
    frame = found.summary(by=("method", "noise"), quantiles=(0.5,))
    lines = [f"{'method':24} {'noise':>7} {'median RMSE':>12} {'95 % interval':>21} {'refused':>8}"]
    for row in frame.head(MOST_LINES).to_dict("records"):
        interval = f"{row['median_low']:.5f} to {row['median_high']:.5f}"
        lines.append(
            f"{row['method']:24} {row['noise']:7.4g} {row['q50']:12.5f} {interval:>21}"
            f" {100 * row['refused']:6.1f} %"
        )
    return lines + ["..."] * (len(frame) > MOST_LINES)


MOST_LINES = 60


def _number(text: str, option: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{option} takes numbers by commas, got {text!r}.") from None


def _whole_numbers(text: str) -> list[int]:
    """2,4 and 2-8, also together."""
    found: list[int] = []
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if not first.isdigit() or not (last or first).isdigit():
            raise ValueError(f"--orders takes whole numbers such as 2-8 or 2,4, got {text!r}.")
        found += range(int(first), int(last or first) + 1)
    return found


def _chunks(text: str | None) -> slice | None:
    """A slice as Python writes it."""
    if text is None:
        return None
    parts = text.split(":")
    if not 2 <= len(parts) <= 3 or not all(x == "" or x.isdigit() for x in parts):
        raise ValueError(f"--chunks takes FIRST::STEP, such as 3::10, got {text!r}.")
    if len(parts) == 3 and parts[2] and int(parts[2]) == 0:
        raise ValueError("--chunks FIRST::STEP needs a STEP of at least 1.")
    return slice(*(int(x) if x else None for x in parts))
