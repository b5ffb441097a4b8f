"""What a person gets of a run folder: tables, manifest and report, and a short table on the screen."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmark import leaderboard, report
from benchmark.manifest import write_manifest
from benchmark.results import load_runs
from benchmark.standings import Entry
from benchmark.whereabouts import locate

SHOWN = ("ari_fg", "msc_fg", "miou_bg", "ari")
"""Metrics on the screen; the files have them all."""
FILE_WIDTH = 160
"""Characters a line where the output goes into a file or pipe."""


def write(folder: Path, data: Sequence[Path]) -> None:
    """Write everything that is made from a run folder's rows, and print the means and where the files are."""
    entries, rows = leaderboard.write(folder), load_runs(folder)
    write_manifest(folder, rows, leaderboard.FILES)
    page = report.write(folder, {row.key.track: locate(folder, row, data) for row in rows})
    console = wide_console()
    console.print(means_table(entries))
    console.print(f"\nTable:  {folder.resolve() / leaderboard.FILES[0]}", soft_wrap=True, highlight=False)
    console.print(f"Report: {page.resolve()}", soft_wrap=True, highlight=False)


def wide_console() -> Console:
    """Standard output; wide enough for every table where it is no terminal."""
    return Console(width=None if Console().is_terminal else FILE_WIDTH)


def means_table(entries: Iterable[Entry]) -> Table:
    """Mean over seeds of every model on every track."""
    table = Table(box=None)
    for name in ("track", "model", "", "seeds", "rank", *SHOWN):
        table.add_column(name, justify="left" if name in ("track", "model", "") else "right", no_wrap=True)
    before = None
    for entry in entries:
        track, fit_track, model = entry.place
        if before not in (None, entry.place[:2]):
            table.add_section()
        before = entry.place[:2]
        fitted = "" if fit_track == track else f" (fitted on {fit_track})"
        seeds = f"{len(entry.rows) - entry.n_failed} of {len(entry.rows)}" if entry.n_failed else str(len(entry.rows))
        values = [f"{entry.best_known(name):.3f}" for name in SHOWN]
        table.add_row(f"{track}{fitted}", model, entry.marks, seeds, str(entry.rank or ""), *values)
    return table
