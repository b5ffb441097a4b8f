"""What each command of `obpose-bench` does, and what it prints."""

import math
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from benchmark import arguments, outputs
from benchmark import rescore as rescoring
from benchmark.adapters.predictions import PredictionFolder
from benchmark.isolation import Limits
from benchmark.machine import machine_mib
from benchmark.plan import Plan, Request, check_places, make_plan
from benchmark.registry import GROUPS, discover, expand, find_model
from benchmark.results import RunRow, check_runs, delete_rows, load_runs
from benchmark.runner import SPLIT
from benchmark.schedule import repeat_rows, run_jobs
from benchmark.tracks import SIZES, DataFolder, Source, all_tracks, find_track
from datagen.errors import EXIT_INCOMPLETE, EXIT_OK, EXIT_VERIFICATION, UsageError

MEMORY_SHARE = 0.9
"""Of the machine's memory, for all jobs together."""


def run(values: arguments.Run) -> int:
    """Make the rows that are missing, then tables and report."""
    if values.list:
        _print_lists()
        return EXIT_OK
    request = _request(values)
    rows = load_runs(values.out)
    plan = make_plan(request, rows, values.out)
    rows = _make_room(values, plan, rows)
    plan = make_plan(request, rows, values.out)
    _prepare(plan, values)
    _check_predictions(request)
    failed = _run_jobs(plan, values)
    repeat_rows(plan.keys, values.out)
    outputs.write(values.out, [source.folder for source in request.sources])
    return EXIT_INCOMPLETE if failed else EXIT_OK


def rescore(values: arguments.Rescore) -> int:
    """Compute scene tables from label maps, then tables and report."""
    count = rescoring.rescore(values.folder, check_runs(values.folder), values.data)
    print(f"{count} rows scored again.")
    outputs.write(values.folder, values.data)
    return EXIT_OK


def report(values: arguments.Report) -> int:
    """Write tables and report."""
    check_runs(values.folder)
    outputs.write(values.folder, values.data)
    return EXIT_OK


def compare(values: arguments.Compare) -> int:
    """Print paired differences."""
    from benchmark import comparison

    comparison.print_comparison(values.run, values.one, values.other)
    return EXIT_OK


def selftest(_values: arguments.Selftest) -> int:
    """Check the metrics."""
    from benchmark import selftest as golden

    wrong = golden.run()
    for line in wrong:
        print(line)
    print(f"{len(golden.golden()['cases'])} golden cases: {f'{len(wrong)} values differ' if wrong else 'all hold'}.")
    return EXIT_VERIFICATION if wrong else EXIT_OK


def _request(values: arguments.Run) -> Request:
    if bool(values.model) == bool(values.predictions) or bool(values.track) == (values.data is not None):
        raise UsageError(
            "Name what to score and where: --model NAME [NAME ...] or --predictions DIR, and --track NAME [NAME ...] "
            "or --data DIR; --list shows models and tracks."
        )
    for flag, number in (("seeds", values.seeds), ("workers", values.workers), ("steps", values.steps or 1)):
        if number < 1:
            raise UsageError(f"--{flag} is {number}; expected 1 or more.")
    for flag, number in (("time-limit", values.time_limit), ("budget", values.budget)):
        if not number > 0:
            raise UsageError(f"--{flag} is {number:g}; expected more than 0.")
    if values.out.exists() and not values.out.is_dir():
        raise UsageError(f"{values.out} is a file; give a folder with --out.")
    sources = [DataFolder(values.data)] if values.data else [find_track(name) for name in dict.fromkeys(values.track)]
    if values.predictions:
        return _predictions_request(values, sources)
    models = tuple(expand(values.model))
    if values.deterministic and values.steps is None and any(find_model(name).kind == "learned" for name in models):
        raise UsageError("--deterministic counts budgets in steps; say how many with --steps.")
    return Request(
        models=models,
        sources=tuple(sources),
        seeds=values.seeds,
        fit_source=find_track(values.fit_track) if values.fit_track else None,
        seconds=values.budget,
        steps=values.steps,
    )


def _predictions_request(values: arguments.Run, sources: list[Source]) -> Request:
    if len(sources) > 1:
        raise UsageError("--predictions are of one track or dataset; name one.")
    if missing := [folder for folder in values.predictions if not folder.is_dir()]:
        raise UsageError(f"{missing[0]} is no folder; expected one with label maps.")
    name = values.name or values.predictions[0].resolve().name
    if name in discover()[0]:
        raise UsageError(f"{name!r} is the name of a model; give the predictions another with --name.")
    folders = tuple(PredictionFolder(folder, values.background_slot) for folder in values.predictions)
    return Request(models=(name,), sources=tuple(sources), predictions=folders)


def _make_room(values: arguments.Run, plan: Plan, rows: list[RunRow]) -> list[RunRow]:
    """The rows that stay: without those to be replaced or tried again."""
    wanted = {key.place: key for key in plan.keys}
    other = [row for row in rows if wanted.get(row.key.place, row.key) != row.key]
    if not values.overwrite:
        check_places(plan.keys, rows)
    again = [row for row in rows if values.retry and row.status == "failed" and row.key in plan.keys]
    delete_rows(values.out, [*other, *again])
    return [row for row in rows if row not in other and row not in again]


def _prepare(plan: Plan, values: arguments.Run) -> None:
    console = Console(stderr=True, soft_wrap=True, highlight=False)
    for source, splits in plan.splits.items():
        if missing := source.missing(splits):
            console.print(f"Making track {source.name}: {missing} scenes into {source.folder}")
        source.prepare(splits, workers=values.workers, show=console.is_terminal)


def _check_predictions(request: Request) -> None:
    for folder in request.predictions:
        folder.check(request.sources[0].size(SPLIT))


def _run_jobs(plan: Plan, values: arguments.Run) -> int:
    """Run what is missing, with a line for every row; returns how many failed."""
    limits = Limits(
        seconds=60 * values.time_limit,
        memory_mib=values.memory_limit or MEMORY_SHARE * machine_mib() / values.workers,
    )
    console = Console(stderr=True, soft_wrap=True, highlight=False)
    columns = (TextColumn("rows"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    total = sum(len(job.targets) for job in plan.jobs)
    failed = []
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)

        def hear(row: RunRow) -> None:
            failed.extend([row] if row.status == "failed" else [])
            bar.advance(task)
            console.print(_line(row), markup=False)

        run_jobs(plan, values.out, limits, values.workers, hear)
    return len(failed)


def _line(row: RunRow) -> str:
    place = f"{row.key.track}, {row.key.model}, seed {row.key.seed}"
    if row.status == "failed":
        return f"{place}: FAILED, {row.reason}"
    seconds = row.measured.fit_seconds
    fitted = "" if math.isnan(seconds) else f"fit {seconds:.1f} s, {1000 * row.measured.seconds_per_frame:.1f} ms a frame"
    return f"{place}: {fitted or 'scored'}"


def _print_lists() -> None:
    console = Console()
    models, problems = discover()
    table = Table("model", "version", "kind", "what it is", box=None)
    for name, spec in sorted(models.items(), key=lambda item: (item[1].kind, item[0])):
        table.add_row(name, str(spec.version), spec.kind, spec.description)
    console.print(table)
    for problem in problems:
        console.print(f"{problem.name}: cannot be used: {problem.reason}", markup=False)
    for group in GROUPS:
        console.print(f"\ngroup {group}: {', '.join(expand([group]))}", highlight=False)
    table = Table("track", "size", "slots", "what it is", box=None)
    for track in all_tracks():
        table.add_row(track.name, "{}x{}".format(*track.resolution), str(track.slots), track.description)
    console.print()
    console.print(table)
    console.print(f"\nscenes of a track: {', '.join(f'{number} {split}' for split, number in SIZES.items())}")
