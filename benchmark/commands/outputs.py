"""Output of a run folder: tables, manifest and report, and a short table on the screen."""

import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from datetime import date
from functools import partial
from pathlib import Path

from rich.console import Console, Group
from rich.table import Table

from benchmark import report
from benchmark.ranking import leaderboard
from benchmark.ranking.columns import (
    FAILED_SEEDS,
    FRACTIONAL_RANKS,
    HEADLINE_POSES,
    HEADLINE_SCORES,
    RANK,
    SEEDS,
    Column,
    Row,
    Score,
    caveats,
    marks_explained,
    suffixes_explained,
    with_poses,
)
from benchmark.ranking.manifest import commands_of, write_manifest
from benchmark.ranking.standings import ModelResult, best_first, comparable_groups
from benchmark.ranking.text import terminal
from benchmark.results.labels import locate
from benchmark.results.packed_runs import is_packed
from benchmark.results.run_folder import RunRow, load_runs
from datagen.console.progress import busy, status_console, track_progress, tracked
from datagen.console.text import printable
from datagen.tracks import Source

FILE_WIDTH = 160
"""Characters per line if the output goes to a file or pipe."""


def write(folder: Path, data: Sequence[Path], *, made_rows: bool = False) -> None:
    """Write all tables and reports of a run folder, and print the means and the paths of the files.

    The manifest and the report keep the commands that made the rows; this one joins them if it `made_rows`.
    """
    results = leaderboard.write(folder, tracked)
    commands: list[str] = []
    if not is_packed(folder):
        commands = commands_of(folder)
        if made_rows and (command := _this_command()) not in commands:
            commands.append(command)
        write_manifest(folder, results, commands=commands)
    with busy("writing the report"):
        find = partial(_dataset, folder, load_runs(folder), data)
        page = report.write(folder, results, find, command="; ".join(commands), date=date.today().isoformat())
    console = wide_console()
    console.print(means_table(results))
    if poses := poses_table(results):
        console.print(poses)
    console.print()
    print_path(console, "Table:  ", folder / leaderboard.FILES[0])
    print_path(console, "Report: ", page)


def _this_command() -> str:
    """Command line of this process; bytes that are no text become question marks."""
    return printable(shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]))


def _dataset(folder: Path, rows: Sequence[RunRow], data: Sequence[Path], track: str, track_spec: str) -> Path | None:
    """Find the dataset of that track and hash; failed rows and rows without label maps do not record it."""
    there = (locate(folder, row, data) for row in rows if (row.key.track, row.key.track_spec) == (track, track_spec))
    return next(filter(None, there), None)


def print_path(console: Console, title: str, path: Path) -> None:
    """Print where a file is, in one line."""
    console.print(terminal(f"{title}{path.resolve()}"), soft_wrap=True)


def wide_console() -> Console:
    """Create a console of standard output; if that is no terminal, wide enough for every table."""
    return Console(width=None if Console().is_terminal else FILE_WIDTH)


def means_table(results: Sequence[ModelResult]) -> Group:
    """Mean over seeds of every model on every track, the best first, and explanations below."""
    table = _empty_table("", RANK, SEEDS, *HEADLINE_SCORES)
    for group in comparable_groups(results):
        for row in map(Row, best_first(group)):
            result = row.result
            failures = min(result.n_failed, result.n_runs) - (result.n_runs - result.n_scored)
            seeds = SEEDS.cell(row) + (f", {failures} failed" if failures else "")
            means = [result.mean(score.name) for score in HEADLINE_SCORES]
            cells = ["–" if math.isnan(mean) else f"{mean:z.3f}" for mean in means]
            table.add_row(*map(terminal, (*_names(result), result.marks, RANK.cell(row), seeds, *cells)))
        table.add_section()
    marks = [f"{mark} {meaning}." for mark, meaning in marks_explained(results)]
    shared = [FRACTIONAL_RANKS] if any(result.rank and result.rank % 1 for result in results) else []
    failed = [FAILED_SEEDS] if any(result.n_failed for result in results) else []
    return Group(table, *map(terminal, (*shared, *marks, *suffixes_explained(results), *failed, *caveats(results))))


def poses_table(results: Sequence[ModelResult]) -> Group | None:
    """Scores of poses on every track; None if no model gives poses."""
    table = _empty_table(*HEADLINE_POSES)
    for group in comparable_groups(results):
        for row in with_poses(group):
            table.add_row(*map(terminal, (*_names(row.result), *(score.cell(row) for score in HEADLINE_POSES))))
        table.add_section()
    return Group("\nPoses", table) if table.row_count else None


def _empty_table(*columns: Column | Score | str) -> Table:
    """Create a table with columns for track and model and these columns."""
    table = Table(box=None)
    for heading in ("track", "model", *(column if isinstance(column, str) else column.heading for column in columns)):
        table.add_column(heading, justify="left" if heading in ("track", "model", "") else "right", no_wrap=True)
    return table


def _names(result: ModelResult) -> tuple[str, str]:
    track, fit_track, model = result.place
    fitted = f"{track} ({'trained' if result.row.pretrained else 'fitted'} on {fit_track})"
    return track if fit_track == track else fitted, model


def prepare(splits: Mapping[Source, tuple[str, ...]], *, workers: int) -> None:
    """Generate the missing scenes of these splits, and report it.

    Raises:
        DatagenError: scenes could not be made.
    """
    console = status_console()
    for source, names in splits.items():
        source.prepare(names, workers=workers, progress=partial(track_progress, console, source.name, source.folder))
