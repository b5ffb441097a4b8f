"""`obpose-bench pack`: add the rows of run folders to a packed folder, in the form of `benchmark.results.packed_runs`.

Contents already stored in the packed folder, or in another one of the same tree, become references. The tree is
everything below the topmost of nested packed folders, such as docs/results. Stored contents are never moved or changed,
so that references to them stay valid.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from benchmark.csv_files import Curve, to_csv
from benchmark.ranking import leaderboard
from benchmark.ranking.leaderboard import leaderboard_lines, seed_lines
from benchmark.ranking.manifest import MANIFEST, write_manifest
from benchmark.ranking.standings import load_standings
from benchmark.results.packed_runs import (
    CURVES_FILE,
    ROWS_FILE,
    SCENES_FILE,
    Columns,
    Fields,
    Part,
    is_packed,
    score_text,
    stored_curves,
    stored_rows,
    stored_scenes,
    write_curves,
    write_rows,
    write_scenes,
)
from benchmark.results.run_folder import RUNS, RunRow, check_runs, digest, load_runs, load_scenes, plain_values
from datagen.errors import UsageError
from datagen.storage.atomic import target_name, updated_folder, write_atomically

PACKED_FILES = (ROWS_FILE, SCENES_FILE, CURVES_FILE)


@dataclass(frozen=True, eq=False)
class Result:
    """A row with its per-scene scores."""

    row: RunRow
    scenes: Columns | None
    """Scores scene by scene; None if the run failed."""

    @property
    def name(self) -> str:
        """Name of the row."""
        return self.row.key.name

    @cached_property
    def scenes_digest(self) -> str:
        """Digest of the per-scene scores as they are stored."""
        return _scenes_digest(self.scenes or {})

    @cached_property
    def digest(self) -> str:
        """Digest of everything; results with equal digests are stored once."""
        parts = (self.scenes_digest, _curve_digest(self.row.learning_curve or []))
        return digest({"row": self.name, **plain_values(self.row), "parts": parts})


def pack(runs: Sequence[Path], out: Path) -> int:
    """Add all rows of run folders to a packed folder, made if missing; the same rows give the same bytes.

    The tables are always written again. An interrupt leaves no new folder, and keeps what an old one has.

    Returns:
        The number of rows that were added; the others were there already.

    Raises:
        UsageError: no run folder is given, one has no rows, or the packed folder holds other files or another result
            in the place of a new one.
        CorruptFile: a row or a table is damaged.
        DatagenError: a file cannot be written.
    """
    if not runs:
        raise UsageError("No run folder is named; give those whose rows are to be packed.")
    _check_target(out)
    new = sorted((result for run in runs for result in _results(run, check_runs(run))), key=lambda found: found.row.key)
    archive = _Archive(out)
    added = sum([archive.add(result) for result in new])
    archive.write()
    return added


class _Archive:
    """Contents of a packed folder, and an index of all contents stored in the same tree."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        self.rows: dict[str, Fields] = {}
        self.scenes: dict[str, Columns] = {}
        self.curves: dict[str, Curve] = {}
        self.results: dict[tuple[str, str, str, int], Result] = {}
        self.homes: dict[str, tuple[Path, str]] = {}
        """Storage location (folder, name) of each row, table or curve, by its digest."""
        if is_packed(self.folder):
            self.rows = dict(stored_rows(self.folder))
            self.scenes, self.curves = dict(stored_scenes(self.folder)), dict(stored_curves(self.folder))
            self.results = {found.row.key.place: found for found in _results(self.folder, load_runs(self.folder))}
            self._index(self.folder)
        for other in _others(self.folder):
            self._index(other)

    def _index(self, folder: Path) -> None:
        """Index everything that a packed folder stores itself."""
        lines = stored_rows(folder)
        rows = [row for row in load_runs(folder) if "in" not in lines[row.key.name]]
        digests = {found.digest: found.name for found in _results(folder, rows)}
        digests |= {_scenes_digest(table): name for name, table in stored_scenes(folder).items()}
        digests |= {_curve_digest(curve): name for name, curve in stored_curves(folder).items()}
        for value, name in digests.items():
            self.homes.setdefault(value, (folder, name))

    def add(self, result: Result) -> bool:
        """Add a result, by reference as far as possible; tell whether it was new."""
        if there := self.results.get(result.row.key.place):
            if there.digest == result.digest:
                return False
            raise UsageError(
                f"{self.folder} has another result in the place of {result.name}; packed results are read-only. Pack "
                "into another folder, or delete this one and pack all of its runs again."
            )
        # The first folder that has a result keeps it; others refer to it.
        self.results[result.row.key.place] = result
        home, _ = self.homes.setdefault(result.digest, (self.folder, result.name))
        if home == self.folder:
            self.rows[result.name] = {"name": result.name, **plain_values(result.row), **self._parts(result)}
        else:
            self.rows[result.name] = {"name": result.name, "in": self._relative(home)}
        return True

    def _parts(self, result: Result) -> dict[Part, str]:
        """Store the scores and the curve of a result; returns references to those that are stored already."""
        references: dict[Part, str] = {}
        scenes, curve = result.scenes, result.row.learning_curve
        if scenes:
            references |= self._part("scenes", self.scenes, result.name, scenes, result.scenes_digest)
        if curve:
            references |= self._part("curve", self.curves, result.name, curve, _curve_digest(curve))
        return references

    def _part(self, part: Part, stored: dict[str, Any], name: str, value: Any, value_digest: str) -> dict[Part, str]:
        folder, owner = self.homes.setdefault(value_digest, (self.folder, name))
        if (folder, owner) == (self.folder, name):
            stored[name] = value
            return {}
        return {part: owner if folder == self.folder else f"{self._relative(folder)}/{owner}"}

    def _relative(self, folder: Path) -> str:
        return Path(os.path.relpath(folder, self.folder)).as_posix()

    def write(self) -> None:
        """Write all files; the rows after scores and curves, which they refer to."""
        with updated_folder(self.folder, (*reversed(PACKED_FILES), *leaderboard.PACKED, MANIFEST)) as folder:
            write_scenes(folder, self.scenes)
            write_curves(folder, self.curves)
            write_rows(folder, self.rows.values())
            entries = load_standings(folder)
            for name, lines in (("leaderboard.csv", leaderboard_lines(entries)), ("per_seed.csv", seed_lines(entries))):
                write_atomically(folder / name, to_csv(lines).encode())
            there = [name for name in (*leaderboard.PACKED, *PACKED_FILES) if (folder / name).exists()]
            write_manifest(folder, entries, there)


def _results(folder: Path, rows: Sequence[RunRow]) -> Iterator[Result]:
    for row in rows:
        yield Result(row, load_scenes(folder, row) if row.status == "ok" else None)


def _others(folder: Path) -> list[Path]:
    """Find the other packed folders of a folder's tree, without those of killed processes."""
    root = folder
    while is_packed(root.parent):
        root = root.parent
    found = sorted(path.parent for path in root.rglob(ROWS_FILE) if path.parent != folder)
    return [other for other in found if target_name(other) == other.name]


def _check_target(folder: Path) -> None:
    if is_packed(folder):
        return
    if taken := [name for name in (RUNS, *leaderboard.FILES, MANIFEST) if (folder / name).exists()]:
        raise UsageError(
            f"{folder} holds {taken[0]} and is not a packed folder; nothing was written. Give a new folder with --out."
        )


def _scenes_digest(table: Columns) -> str:
    return digest({"scenes": {name: [score_text(value) for value in values] for name, values in table.items()}})


def _curve_digest(curve: Curve) -> str:
    return digest({"curve": curve})
