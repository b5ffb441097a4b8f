"""The commands of `obpose-bench`."""

import math
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmark.commands import arguments, outputs
from benchmark.commands import selftest as golden_cases
from benchmark.commands.editing import score_edits
from benchmark.commands.outputs import prepare
from benchmark.commands.request import job_limits, places, request_of
from benchmark.execution.jobs import repeat_rows, run_all
from benchmark.execution.plan import Plan, check_places, estimate, make_plan, superseded
from benchmark.models.registry import GROUPS, discover
from benchmark.ranking import compare as paired
from benchmark.ranking import pack as packing
from benchmark.ranking.leaderboard import FILES
from benchmark.ranking.manifest import MANIFEST, commands_of
from benchmark.ranking.text import terminal
from benchmark.report.page import REPORT
from benchmark.results import scoring as rescoring
from benchmark.results.packed_runs import refuse_packed
from benchmark.results.run_folder import RUNS, RunRow, check_runs, delete_rows, load_runs
from benchmark.results.scoring import SPLIT
from datagen import tracks
from datagen.console.progress import progress_bar, status_console, tracked
from datagen.console.text import counted
from datagen.errors import EXIT_INCOMPLETE, EXIT_OK, EXIT_VERIFICATION, UsageError
from datagen.storage.atomic import remove_abandoned
from datagen.tracks import SIZES, Profile, all_tracks


def run(values: arguments.Run) -> int:
    """Make the missing rows, then tables and report."""
    if values.list:
        _print_lists(values.profile)
        return EXIT_OK
    refuse_packed(values.out)
    _refuse_foreign(values.out)
    request = request_of(values)
    if values.task == "editing":
        return score_edits(values, request)
    for folder in request.predictions:
        folder.check(request.sources[0].labels_shape(SPLIT))
    # Rows that are missing, after those that are in the way are removed.
    remove_abandoned(values.out, recursive=True)
    rows, commands = load_runs(values.out), commands_of(values.out)
    plan = make_plan(request, rows, values.out)
    rows = _make_room(values, plan, rows)
    plan = make_plan(request, rows, values.out)
    if values.dask is None and (found := estimate(plan, values.workers)):
        status_console().print(str(found))
    elif not plan.jobs:
        status_console().print("All rows are there; writing tables and report.")
    # Datasets, jobs, tables.
    prepare(plan.splits, workers=values.workers)
    _run_jobs(plan, values)
    repeat_rows(plan.keys, values.out)
    made_rows = bool(plan.jobs) or not commands
    outputs.write(values.out, [source.folder for source in request.sources], made_rows=made_rows)
    failed = [row for row in load_runs(values.out) if row.key in plan.keys and row.status == "failed"]
    if failed:
        status_console().print(f"{len(failed)} of these rows failed; --retry makes them again.")
    return EXIT_INCOMPLETE if failed else EXIT_OK


def rescore(values: arguments.Rescore) -> int:
    """Compute scene tables from label maps, then tables and report."""
    refuse_packed(values.folder)
    count = rescoring.rescore(values.folder, check_runs(values.folder), values.data, progress=tracked)
    Console().print(f"{counted(count, 'row')} scored again.")
    outputs.write(values.folder, values.data)
    return EXIT_OK


def report(values: arguments.Report) -> int:
    """Write tables and report."""
    check_runs(values.folder)
    outputs.write(values.folder, values.data)
    return EXIT_OK


def compare(values: arguments.Compare) -> int:
    """Print paired differences."""
    found = paired.compare(values.run, values.one, values.other, progress=tracked, fit_track=values.fit_track)
    outputs.wide_console().print(paired.comparison_table(found, values.one, values.other))
    return EXIT_OK


def pack(values: arguments.Pack) -> int:
    """Add rows to a packed folder."""
    try:
        added = packing.pack(values.run, values.out)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("Interrupted; rows packed before are kept. Run the same command again.") from None
    rows = len(load_runs(values.out))
    Console().print(terminal(f"{counted(added, 'row')} added to {values.out}, which has {rows} now."), soft_wrap=True)
    return EXIT_OK


def selftest(_values: arguments.Selftest) -> int:
    """Check the metrics."""
    wrong, console = golden_cases.run(), Console(soft_wrap=True, highlight=False)
    for line in wrong:
        console.print(line, markup=False)
    cases = len(golden_cases.golden()["cases"])
    found = f"{counted(len(wrong), 'value')} differ from what was expected" if wrong else "all hold"
    console.print(f"{counted(cases, 'golden case')}: {found}.")
    return EXIT_VERIFICATION if wrong else EXIT_OK


def _refuse_foreign(folder: Path) -> None:
    """Check that no file of somebody else would be overwritten.

    Raises:
        UsageError: the folder holds a file with the name of a table or report, but no rows.
    """
    taken = [name for name in (*FILES, MANIFEST, REPORT) if (folder / name).exists()]
    if taken and not (folder / RUNS).is_dir():
        raise UsageError(
            f"{folder} holds {taken[0]}, which would be overwritten, and no rows of a benchmark. Give another --out, "
            "or move the file."
        )


def _make_room(values: arguments.Run, plan: Plan, rows: list[RunRow]) -> list[RunRow]:
    """Delete the rows to be replaced or tried again, and return the others."""
    places = {key.place for key in plan.keys}
    # A run that serves all seeds is tried again for all of them.
    served = {*plan.keys, *(replace(key, seed=0) for key in plan.keys)}

    def is_tried_again(row: RunRow) -> bool:
        if row.kind == "predictions":
            return row.key.place in places  # corrected label maps give another row
        return values.retry and (row.key if row.random else replace(row.key, seed=0)) in served

    again = [row for row in rows if row.status == "failed" and is_tried_again(row)]
    kept = [row for row in rows if row not in again]
    if not values.overwrite:
        check_places(plan.keys, kept)
    other = superseded(plan.keys, rows) if values.overwrite else []
    delete_rows(values.out, [*other, *again])
    return [row for row in kept if row not in other]


def _run_jobs(plan: Plan, values: arguments.Run) -> None:
    """Make the missing rows, and print a line for each."""
    total = sum(len(job.targets) for job in plan.jobs)
    console = status_console()
    with progress_bar(console, "rows", total) as advance:

        def on_row(row: RunRow) -> None:
            console.print(terminal(_line(row)))
            advance()

        with places(values, plan.jobs) as workers:
            run_all(plan.jobs, lambda job: job_limits(values, job.time_limit), workers, on_row)


def _line(row: RunRow) -> str:
    place = f"{row.key.track}, {row.key.model}, seed {row.key.seed}"
    if row.status == "failed":
        return f"{place}: FAILED, {row.reason}"
    cost = row.measured
    if math.isnan(cost.fit_seconds):
        return f"{place}: scored"
    return f"{place}: fit {cost.fit_seconds:.1f} s, {1000 * cost.seconds_per_frame:.1f} ms a frame"


def _print_lists(profile: Profile) -> None:
    console = outputs.wide_console()
    models, problems = discover()
    table = Table("model", "version", "kind", "what it is", box=None)
    for name, spec in sorted(models.items(), key=lambda item: (item[1].kind, item[0])):
        table.add_row(*map(terminal, (name, str(spec.version), spec.kind, spec.description)))
    console.print(table)
    for problem in problems:
        console.print(terminal(f"{problem.name}: cannot be used: {problem.reason}"))
    for name, group in GROUPS.items():
        budget = f", {counted(group.budget, 'second')} each" if group.budget else ""
        console.print(f"\ngroup {name}: {', '.join(group.members)}{budget}", highlight=False)
    table = Table("track", "size", "slots", "what it is", box=None)
    for track in all_tracks(profile):
        table.add_row(track.name, "{}x{}".format(*track.resolution), str(track.slots), track.description)
    console.print()
    console.print(table)
    for name, members in tracks.GROUPS.items():
        console.print(f"\ngroup {name}: {', '.join(members)}", highlight=False)
    console.print(f"\nscenes of a track: {', '.join(f'{number} {split}' for split, number in SIZES.items())}")
