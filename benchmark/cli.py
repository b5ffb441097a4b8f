"""`obpose-bench`: score models on a dataset and keep the results in one table."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from benchmark import leaderboard
from benchmark.registry import MODELS, find_model
from benchmark.runner import DEFAULT_BUDGET, Result, run
from datagen.errors import EXIT_INCOMPLETE, EXIT_INTERRUPTED, EXIT_OK, DatagenError, UsageError
from datagen.storage import Dataset

SHOWN = ("ari_fg", "msc_fg", "miou_bg", "ari")
"""Metrics in the printed table; the file has them all."""


@dataclass(frozen=True)
class Arguments:
    """Score a model on a dataset, every frame by itself, and write the result into a table."""

    model: str | None = None
    """Name of the model; --list shows them."""
    data: Path | None = None
    """Folder of a dataset made by obpose-datagen."""
    split: Literal["train", "val", "test"] = "test"
    """The split to score on; models are fitted on train and val."""
    seeds: int = 1
    """How many runs, with seeds 0, 1, ..."""
    budget: float = DEFAULT_BUDGET
    """Seconds that each run may train for."""
    out: Path = Path("leaderboard.csv")
    """The table to add to; rows of the same model, version, dataset, split and seed are replaced."""
    list: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Show the models and leave."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the console script; leaves with an exit code of `datagen.errors`."""
    sys.exit(_guarded(tyro.cli(Arguments, prog="obpose-bench", args=arguments)))


def _guarded(arguments: Arguments) -> int:
    try:
        return _main(arguments)
    except DatagenError as error:
        return _fail(str(error), error.exit_code)
    except OSError as error:
        return _fail(f"{error.filename or arguments.out}: {error.strerror or error}.", EXIT_INCOMPLETE)
    except KeyboardInterrupt:
        return _fail("Interrupted; the table is as it was.", EXIT_INTERRUPTED)


def _fail(message: str, code: int) -> int:
    print(f"obpose-bench: {message}", file=sys.stderr)
    return code


def _main(arguments: Arguments) -> int:
    console = Console()
    if arguments.list:
        console.print(_models_table())
        return EXIT_OK
    if arguments.model is None or arguments.data is None:
        raise UsageError(
            "Name a model and a dataset: obpose-bench --model plane-dbscan --data DIR; --list shows models."
        )
    if arguments.seeds < 1:
        raise UsageError(f"--seeds is {arguments.seeds}; expected 1 or more.")
    leaderboard.read_rows(arguments.out)
    results = _run_all(arguments.model, arguments.data, arguments)
    leaderboard.update(arguments.out, results)
    console.print(_results_table(results))
    console.print(f"Leaderboard: {arguments.out.resolve()}", soft_wrap=True, highlight=False)
    return EXIT_OK


def _run_all(model: str, data: Path, arguments: Arguments) -> list[Result]:
    find_model(model)
    scenes = len(Dataset(data).split(arguments.split))
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        results = []
        for seed in range(arguments.seeds):
            bar = bars.add_task(f"{model}, seed {seed}", total=scenes)
            results.append(
                run(
                    model,
                    data,
                    seed=seed,
                    split=arguments.split,
                    budget=arguments.budget,
                    progress=lambda done, bar=bar: bars.update(bar, completed=done),
                )
            )
    return results


def _models_table() -> Table:
    table = Table("model", "version", "what it is", box=None)
    for name, spec in sorted(MODELS.items()):
        table.add_row(name, str(spec.version), spec.description)
    return table


def _results_table(results: Sequence[Result]) -> Table:
    first = results[0]
    table = Table(title=f"{first.dataset}, {first.split} split: {first.scenes} scenes", title_justify="left")
    for name in ("model", "seed", *SHOWN, "ms/frame"):
        table.add_column(name, justify="left" if name == "model" else "right", no_wrap=True)
    for result in results:
        metrics = [f"{result.scores[name]:.3f}" for name in SHOWN]
        table.add_row(result.model, str(result.seed), *metrics, f"{1000 * result.seconds_per_frame:.1f}")
    return table


if __name__ == "__main__":
    main()
