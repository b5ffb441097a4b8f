"""Output of a run folder: tables, manifest and report, and a short table on the screen."""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console, Group
from rich.table import Table

from benchmark import report
from benchmark.ranking import leaderboard
from benchmark.ranking.escaping import terminal
from benchmark.ranking.failed_seeds import HEADLINE
from benchmark.ranking.pose_tables import COLUMNS, HEADER, pose_cells, posed
from benchmark.ranking.standings import Entry, best_first, fields
from benchmark.ranking.table_text import free_of_slots, rank_in_words, run_once, seeds_covered, without_floor
from benchmark.report import learning
from benchmark.report.leaderboard_view import marks
from benchmark.results.dataset_lookup import locate
from benchmark.results.manifest import write_manifest
from benchmark.results.packed_runs import is_packed
from benchmark.results.run_folder import RunRow, load_runs
from datagen.console.progress import busy, tracked

HEADLINE_OF_POSES = ("posed", "translation_median", "orientation_median", "box_iou")

FILE_WIDTH = 160
"""Characters per line if the output goes to a file or pipe."""


def write(folder: Path, data: Sequence[Path]) -> None:
    """Write all tables and reports of a run folder, and print the means and the paths of the files."""
    entries = leaderboard.write(folder, tracked)
    if not is_packed(folder):
        write_manifest(folder, entries)
    with busy("writing the report"):
        page = report.write(folder, entries, partial(_dataset, folder, load_runs(folder), data))
        curves = learning.write(folder, entries)
    console = wide_console()
    console.print(means_table(entries))
    if poses := poses_table(entries):
        console.print(poses)
    console.print()
    print_path(console, "Table:  ", folder / leaderboard.FILES[0])
    print_path(console, "Report: ", page)
    if curves:
        print_path(console, "Curves: ", curves)


def _dataset(folder: Path, rows: Sequence[RunRow], data: Sequence[Path], track: str, track_spec: str) -> Path | None:
    """The dataset of that track and hash: rows that failed or have no label maps do not know where it is."""
    there = (locate(folder, row, data) for row in rows if (row.key.track, row.key.track_spec) == (track, track_spec))
    return next(filter(None, there), None)


def print_path(console: Console, title: str, path: Path) -> None:
    """Print where a file is, in one line."""
    console.print(terminal(f"{title}{path.resolve()}"), soft_wrap=True)


def wide_console() -> Console:
    """Standard output; wide enough for every table where it is no terminal."""
    return Console(width=None if Console().is_terminal else FILE_WIDTH)


def means_table(entries: Sequence[Entry]) -> Group:
    """Mean over seeds of every model on every track, the best first, and beneath it what must be known."""
    table = Table(box=None)
    for name in ("track", "model", "", "seeds", "rank", *HEADLINE):
        table.add_column(name, justify="left" if name in ("track", "model", "") else "right", no_wrap=True)
    for field in fields(entries):
        for entry in best_first(field):
            table.add_row(*map(terminal, _cells(entry)))
        table.add_section()
    return Group(table, *map(terminal, _legend(entries)))


def poses_table(entries: Sequence[Entry]) -> Group | None:
    """Scores of poses, track by track, where there are any: of the columns of the tables in files, the main ones."""
    shown = [HEADER.index(column.title) for column in COLUMNS if column.name in HEADLINE_OF_POSES]
    table = Table(box=None)
    for name in ("track", "model", *(HEADER[place] for place in shown)):
        table.add_column(name, justify="left" if name in ("track", "model") else "right", no_wrap=True)
    for field in fields(entries):
        for entry in posed(field):
            cells = pose_cells(entry)
            table.add_row(*map(terminal, (_track(entry), entry.row.key.model, *(cells[place] for place in shown))))
        table.add_section()
    return Group("\nPoses", table) if table.row_count else None


def _cells(entry: Entry) -> list[str]:
    failed = min(entry.n_failed, entry.n_runs) - (entry.n_runs - entry.n_scored)
    seeds = seeds_covered(entry) + (f", {failed} failed" if failed else "")
    means = [entry.best_known(name) for name in HEADLINE]
    values = ["–" if math.isnan(mean) else f"{mean:z.3f}" for mean in means]
    return [_track(entry), entry.row.key.model, entry.marks, seeds, rank_in_words(entry), *values]


def _track(entry: Entry) -> str:
    track, fit_track, _ = entry.place
    return (
        track if fit_track == track else f"{track} ({'trained' if entry.row.pretrained else 'fitted'} on {fit_track})"
    )


def _legend(entries: Sequence[Entry]) -> Iterator[str]:
    if once := run_once(entries):
        yield f"Seeds make no difference to these, which were run once: {once}."
    for mark, meaning in marks(entries):
        yield f"{mark} {meaning}."
    yield from filter(None, (free_of_slots(entries), without_floor(entries)))
