"""`obpose-bench search`: run the missing trials, write the table, and print the choice."""

import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmark.arguments import Search
from benchmark.console import prepare, progress_bar, status
from benchmark.duration import estimate_trainings, in_words, time_limit
from benchmark.escaping import brief, terminal
from benchmark.files import remove_abandoned
from benchmark.flag_limits import check_flag
from benchmark.isolation import LOGS, Limits, limits, run_isolated
from benchmark.outputs import print_path, wide_console
from benchmark.registry import expand
from benchmark.schedule import side_by_side
from benchmark.search import table
from benchmark.search.plan import make_trials, missing
from benchmark.search.trial import TRIALS, Outcome, Trial, load_outcomes, save_outcome
from benchmark.tracks import DEFAULT, Source, find_data_folder, find_tracks
from datagen.errors import EXIT_INCOMPLETE, EXIT_OK, UsageError
from datagen.wording import counted

SPLITS = ("train", "val")
"""Splits that a search reads; the test split is never used."""


def search(values: Search) -> int:
    """Run the missing trials, then write and print the table; returns the exit code."""
    _check(values)
    sources: list[Source] = [find_data_folder(values.data)] if values.data else _tracks(values)
    trials = make_trials(
        expand(values.model),
        sources,
        seconds=60 * values.minutes,
        steps=values.steps,
        profile=values.profile,
        out=values.out,
    )
    remove_abandoned(values.out)
    left = missing(trials, _kept(values))
    scenes = sum(source.missing(SPLITS) for source in sources)
    if found := estimate_trainings(left, scenes, values.workers):
        status().print(in_words(found))
    if left:
        prepare(dict.fromkeys(sources, SPLITS), workers=values.workers)
    _run(left, values)
    outcomes = load_outcomes(values.out)
    console = wide_console()
    console.print(table.shown(outcomes), highlight=False)
    console.print()
    print_path(console, "Table: ", table.write(values.out, outcomes))
    names = {trial.name for trial in trials}
    return EXIT_INCOMPLETE if any(outcome.reason for outcome in outcomes if outcome.name in names) else EXIT_OK


def _check(values: Search) -> None:
    if values.track and values.data:
        raise UsageError("Name tracks with --track or a dataset with --data, not both.")
    check_flag("workers", values.workers)
    check_flag("steps", values.steps)
    check_flag("minutes", values.minutes)
    check_flag("memory-limit", values.memory_limit)
    if values.out.exists() and not values.out.is_dir():
        raise UsageError(f"{values.out} is a file; give a folder with --out.")
    if (values.out / "dataset.json").exists():
        raise UsageError(f"{values.out} is a dataset; give another folder with --out.")
    if (values.out / table.SEARCH).exists() and not (values.out / TRIALS).exists():
        raise UsageError(
            f"{values.out} holds the table of a search without its trials, which would be overwritten. Give another "
            "folder with --out."
        )


def _tracks(values: Search) -> list[Source]:
    return [*find_tracks(values.track or (DEFAULT,), values.profile)]


def _kept(values: Search) -> list[Outcome]:
    """The outcomes that stay: with --retry, those that did not fail."""
    outcomes = load_outcomes(values.out)
    again = [outcome for outcome in outcomes if values.retry and outcome.reason]
    for outcome in again:
        (values.out / TRIALS / f"{outcome.name}.json").unlink()
    return [outcome for outcome in outcomes if outcome not in again]


def _run(trials: Sequence[Trial], values: Search) -> None:
    """Make trials side by side, with a line for each."""
    console = status()
    with progress_bar(console, "trials", len(trials)) as advance:

        def hear(outcome: Outcome) -> None:
            console.print(terminal(_line(outcome)))
            advance()

        def do(trial: Trial, stop: threading.Event) -> list[Trial]:
            share = limits(time_limit(trial), workers=values.workers, memory_mib=values.memory_limit)
            make(trial, share, stop, hear)
            return []

        side_by_side(trials, do, values.workers)


def make(trial: Trial, share: Limits, stop: threading.Event, hear: Callable[[Outcome], None]) -> None:
    """Run a trial in its own process; one that fails has an outcome, too, and one that is interrupted has none."""
    ending = run_isolated(trial, share, _log(trial), stop, lambda event: None)
    if trial.name not in ending.events:
        if stop.is_set():
            return
        save_outcome(trial.out, Outcome.of(trial, reason=brief(ending.reason)))
    hear(next(outcome for outcome in load_outcomes(trial.out) if outcome.name == trial.name))


def _log(trial: Trial) -> Path:
    return trial.out / LOGS / f"{trial.name}.log"


def _line(outcome: Outcome) -> str:
    place = f"{outcome.track}, {outcome.model}, trial {outcome.trial}"
    if outcome.reason:
        return f"{place}: FAILED, {outcome.reason}"
    steps = counted(outcome.steps, "step")
    return f"{place}: {steps} in {outcome.seconds:.1f} s, validation loss {outcome.validation_loss:.4f}"
