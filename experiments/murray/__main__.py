"""All figures and tables of Murray (2016): `python -m experiments.murray [--quick]`."""

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from experiments.murray.runner import parser, run_script, settings_of, show


SCRIPTS = (
    "figures_1_2",
    "figures_3_6",
    "figure_8",
    "figure_9",
    "failures",
    "single_records",
    "figure_picture",
    "figures_13_14",
    "table_resolution",
    "figure_10",
    "figure_11",
    "figure_12",
    "statements",
)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--only", nargs="+", choices=SCRIPTS, metavar="NAME", default=SCRIPTS)
    chosen = options.parse_args()
    settings = settings_of(chosen)
    columns = TextColumn("{task.description:20}"), BarColumn(), MofNCompleteColumn()
    finished = []
    with Progress(*columns, TimeElapsedColumn()) as progress:
        task = progress.add_task("", total=len(chosen.only))
        for name in chosen.only:
            progress.update(task, description=name)
            finished.append(run_script(name, settings))
            progress.advance(task)
        progress.update(task, description="done")
    show(finished, settings)


if __name__ == "__main__":
    main()
