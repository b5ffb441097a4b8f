"""The tables of a run folder, made from its finished rows: the same rows give the same bytes.

leaderboard.csv .... one line a track, track fitted on, and model: every metric over seeds, ranks, groups, costs
per_seed.csv ....... one line a seed
per_scene.csv ...... one line a seed and scene
leaderboard.md, leaderboard.tex .... the same in the paper's layout
Columns named measured_* are times and memory, which no two runs share.
A packed folder (`benchmark.results.packed_runs`) keeps the first two as they were published.
"""

import csv
import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmark.metrics.poses import POSE_METRICS
from benchmark.ranking import tables
from benchmark.ranking.escaping import printable
from benchmark.ranking.standings import ALL_METRICS, RANKED_METRICS, SWITCHES, Entry, Progress, load_standings, silent
from benchmark.ranking.statistics import Summary
from benchmark.ranking.table_text import rank_in_words
from benchmark.results.packed_runs import is_packed
from benchmark.results.run_folder import COUNTS, RunRow, SceneTable
from datagen.storage.atomic import write_atomically

Cell = str | int | float
Line = Mapping[str, Cell]

FILES = ("leaderboard.csv", "per_seed.csv", "per_scene.csv", "leaderboard.md", "leaderboard.tex")
PACKED = FILES[:2]
"""Tables that are part of a packed folder."""
SUMMARISED = (*ALL_METRICS, SWITCHES)


def write(folder: Path, progress: Progress = silent) -> list[Entry]:
    """Write all tables into a run folder, and give what stands in them.

    Raises:
        CorruptFile: a finished row is damaged.
        DatagenError: a table cannot be written.
    """
    entries = load_standings(folder, progress)
    texts = (
        to_csv(leaderboard_lines(progress(entries, "summarising scores"))),
        to_csv(seed_lines(entries)),
        to_csv(scene_lines(entries)),
        tables.markdown(entries),
        tables.latex(entries),
    )
    kept = PACKED if is_packed(folder) else ()
    for name, text in zip(FILES, texts, strict=True):
        if name not in kept:
            write_atomically(folder / name, text.encode())
    return entries


def leaderboard_lines(entries: Iterable[Entry]) -> list[Line]:
    """One line an entry; numbers of scenes and frames are those of one seed."""
    return [
        {
            **dict(zip(("track", "fit_track", "model"), entry.place, strict=True)),
            "kind": entry.row.kind,
            "marks": entry.marks,
            "rank": rank_in_words(entry),
            "mean_rank": entry.mean_rank,
            **_metric_columns(entry, SUMMARISED),
            **{f"{name}_group": letters for name, letters in zip(RANKED_METRICS, entry.groups, strict=True)},
            **{name: _mean(values) for name, values in _counts(entry).items()},
            "n_seeds": len(entry.rows),
            "n_runs": entry.n_runs,
            "n_scored": entry.n_scored,
            "n_failed": entry.n_failed,
            "failures": "; ".join(f"{row.key.seed}: {cause}" for row, cause in _by_seed(entry) if cause),
            "best_floor": entry.best_floor,
            "n_scenes": entry.n_scenes,
            "n_skipped": entry.n_skipped,
            "priors": "; ".join(entry.row.priors),
            "pretrained": entry.row.pretrained,
            "version": entry.row.key.version,
            "track_spec": entry.row.key.track_spec,
            "fit_spec": entry.row.key.fit_spec,
            "parameters": max(row.parameters for row in entry.rows),
            "device": _distinct(row.device for row in entry.rows),
            "commit": _distinct(row.commit for row in entry.rows),
            **_measured(entry.rows),
            **({"views": entry.views} if entry.views else {}),
            **(_metric_columns(entry, POSE_METRICS) if entry.has_poses else {}),
        }
        for entry in entries
    ]


def seed_lines(entries: Iterable[Entry]) -> list[Line]:
    """One line a seed, with the values that were chosen for it."""
    return [line for entry in entries for line in _seed_lines(entry)]


def scene_lines(entries: Iterable[Entry]) -> list[Line]:
    """One line a seed and scene."""
    return [line for entry in entries for line in _scene_lines(entry)]


def to_csv(lines: Sequence[Line]) -> str:
    """Lines as CSV, with the columns of all of them; floats have six decimals, missing cells are empty."""
    names = list(dict.fromkeys(name for line in lines for name in line))
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([_text(line.get(name, "")) for name in names] for line in lines)
    return text.getvalue()


def _metric_columns(entry: Entry, names: Iterable[str]) -> dict[str, float]:
    columns: dict[str, float] = {}
    for name in names:
        summary = entry.summary(name)
        kept = entry.summary(name, without_failed=True) if entry.n_failed else summary
        columns |= _summary_columns(name, summary)
        columns |= {f"{name}_mean_without_failed": kept.mean, f"{name}_std_without_failed": kept.std}
    return columns


def _summary_columns(name: str, summary: Summary) -> dict[str, float]:
    return {
        f"{name}_mean": summary.mean,
        f"{name}_std": summary.std,
        f"{name}_sample_std": summary.sample_std,
        f"{name}_ci_low": summary.low,
        f"{name}_ci_high": summary.high,
    }


def _seed_lines(entry: Entry) -> Iterator[Line]:
    means = {name: entry.seed_means(name) for name in SUMMARISED}
    poses = {name: entry.seed_means(name) for name in POSE_METRICS} if entry.has_poses else {}
    counts = _counts(entry)
    for index, (row, cause) in enumerate(_by_seed(entry)):
        yield {
            **_place(row),
            "status": row.status,
            "failure": cause,
            **{name: float(values[index]) for name, values in means.items()},
            **{name: _mean(values[[index]]) for name, values in counts.items()},
            "n_scenes": row.n_scenes,
            "version": row.key.version,
            "config": json.dumps(row.config, sort_keys=True),
            "parameters": row.parameters,
            "device": row.device,
            "commit": row.commit,
            **_measured([row]),
            **{name: float(values[index]) for name, values in poses.items()},
        }


def _scene_lines(entry: Entry) -> Iterator[Line]:
    for row, table in zip(entry.rows, entry.tables, strict=True):
        if table is None:
            continue
        place, names = _place(row), list(table)
        columns = [_whole(table[name]) if _counts_things(name) else table[name].tolist() for name in names]
        for values in zip(*columns, strict=True):
            yield {**place, **dict(zip(names, values, strict=True))}


def _place(row: RunRow) -> dict[str, Cell]:
    key = row.key
    return {"track": key.track, "fit_track": key.fit_track, "model": key.model, "seed": key.seed}


def _by_seed(entry: Entry) -> list[tuple[RunRow, str]]:
    return list(zip(entry.rows, entry.causes, strict=True))


def _counts(entry: Entry) -> dict[str, np.ndarray]:
    """Sums over scenes, one for each seed: frames with one object, with undefined metrics, ignored pixels, frames."""
    names = {f"n_{name}": name for name in ("one_object", "undefined", "ignored")} | {"n_frames": "n_frames"}
    return {column: np.array([_sum(table, name) for table in entry.tables]) for column, name in names.items()}


def _sum(table: SceneTable | None, name: str) -> float:
    return float(table[name].sum()) if table is not None and name in table else math.nan


def _mean(values: np.ndarray) -> float | int:
    """Mean of the defined values; an int if it is whole."""
    defined = values[~np.isnan(values)]
    mean = float(defined.mean()) if len(defined) else math.nan
    return int(mean) if mean.is_integer() else mean


def _counts_things(name: str) -> bool:
    return name in ("scene", "n_frames") or name.endswith("_n") or (name in COUNTS and name != "objects")


def _whole(values: np.ndarray) -> list[int]:
    return [int(value) if math.isfinite(value) else 0 for value in values.tolist()]


def _distinct(values: Iterable[str]) -> str:
    return "; ".join(dict.fromkeys(values))


def _measured(rows: Sequence[RunRow]) -> dict[str, float]:
    """Means over seeds of the times, and the largest memory."""
    costs = [row.measured for row in rows]
    return {
        "measured_seconds_per_frame": float(np.mean([cost.seconds_per_frame for cost in costs])),
        "measured_fit_seconds": float(np.mean([cost.fit_seconds for cost in costs])),
        "measured_peak_mib": float(np.max([cost.peak_mib for cost in costs])),
    }


def _text(value: Cell) -> str:
    if isinstance(value, float):
        return f"{value:z.6f}"
    text = printable(str(value))
    # Spreadsheets would compute a cell that begins like a formula.
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text
