"""Tables of a run folder, made from its finished rows; the same rows give the same bytes.

leaderboard.csv .... one line a track, track fitted on, and model: every metric over seeds, ranks, groups, costs
per_seed.csv ....... one line a seed
per_scene.csv ...... one line a seed and scene
leaderboard.md, leaderboard.tex .... the main columns in the layout of the paper
Columns named measured_* are times and memory, which differ between equal runs.
A packed folder (`benchmark.results.packed_runs`) keeps the first two as they were published.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmark.csv_files import Cell, Line, to_csv
from benchmark.metrics import mean_where_defined
from benchmark.ranking import text
from benchmark.ranking.columns import (
    MAIN_SCORES,
    MODEL,
    POSE_SCORES,
    RANK,
    SEEDS,
    SUMMARISED,
    VIEWS,
    Column,
    Row,
    Score,
    best_scores,
    blocks,
    group_letters,
    paper_of_track,
    scenes_title,
    table_notes,
    track_title,
    with_poses,
)
from benchmark.ranking.standings import RANKED_METRICS, ModelResult, comparable_groups, load_standings
from benchmark.results.packed_runs import is_packed
from benchmark.results.run_folder import COUNTS, RunRow
from datagen.console.progress import Tracker, untracked
from datagen.console.text import one_line
from datagen.storage.atomic import write_atomically

FILES = ("leaderboard.csv", "per_seed.csv", "per_scene.csv", "leaderboard.md", "leaderboard.tex")
PACKED = FILES[:2]
"""Tables that are part of a packed folder."""


def write(folder: Path, progress: Tracker = untracked) -> list[ModelResult]:
    """Write all tables into a run folder, and return the results that they show.

    Raises:
        CorruptFile: a finished row is damaged.
        DatagenError: a table cannot be written.
    """
    results = load_standings(folder, progress)
    texts = (
        to_csv(leaderboard_lines(progress(results, "summarising scores"))),
        to_csv(seed_lines(results)),
        to_csv(scene_lines(results)),
        markdown(results),
        latex(results),
    )
    kept = PACKED if is_packed(folder) else ()
    for name, content in zip(FILES, texts, strict=True):
        if name not in kept:
            write_atomically(folder / name, content.encode())
    return results


def leaderboard_lines(results: Iterable[ModelResult]) -> Iterator[Line]:
    """Yield the lines of leaderboard.csv, one per result; numbers of scenes and frames are those of one seed."""
    for result in results:
        yield {
            **dict(zip(("track", "fit_track", "model"), result.place, strict=True)),
            # Scores, ranks and groups.
            "kind": result.row.kind,
            "marks": result.marks,
            "rank": Row(result).rank,
            "mean_rank": result.mean_rank,
            **_metric_columns(result, SUMMARISED),
            **{f"{name}_group": found for name, found in zip(RANKED_METRICS, result.group_letters, strict=True)},
            **{name: _mean(values) for name, values in _counts(result).items()},
            # Seeds and scenes.
            "n_seeds": len(result.rows),
            "n_runs": result.n_runs,
            "n_scored": result.n_scored,
            "n_failed": result.n_failed,
            "failures": "; ".join(
                f"{r.key.seed}: {cause}" for r, cause in zip(result.rows, result.causes, strict=True) if cause
            ),
            "best_floor": result.best_floor,
            "n_scenes": result.n_scenes,
            "n_skipped": result.n_skipped,
            # Model, data and costs.
            "priors": "; ".join(result.row.priors),
            "pretrained": result.row.pretrained,
            "version": result.row.key.version,
            "track_spec": result.row.key.track_spec,
            "fit_spec": result.row.key.fit_spec,
            "parameters": max(row.parameters for row in result.rows),
            "device": _distinct(row.device for row in result.rows),
            "commit": _distinct(row.commit for row in result.rows),
            **_measured(result.rows),
            # Columns that only some results have.
            **({"views": result.views} if result.views else {}),
            **_metric_columns(result, result.further_metrics),
        }


def seed_lines(results: Iterable[ModelResult]) -> Iterator[Line]:
    """Yield the lines of per_seed.csv, with the values that were chosen for each seed."""
    for result in results:
        scores = {name: result.seed_means(name) for name in SUMMARISED}
        further = {name: result.seed_means(name) for name in result.further_metrics}
        counts = _counts(result)
        for seed, (row, cause) in enumerate(zip(result.rows, result.causes, strict=True)):
            yield {
                **_place(row),
                "status": row.status,
                "failure": cause,
                **{name: float(values[seed]) for name, values in scores.items()},
                **{name: _mean(values[[seed]]) for name, values in counts.items()},
                "n_scenes": row.n_scenes,
                "version": row.key.version,
                "config": json.dumps(row.config, sort_keys=True),
                "parameters": row.parameters,
                "device": row.device,
                "commit": row.commit,
                **_measured([row]),
                **{name: float(values[seed]) for name, values in further.items()},
            }


def scene_lines(results: Iterable[ModelResult]) -> Iterator[Line]:
    """Yield the lines of per_scene.csv."""
    runs = (run for result in results for run in zip(result.rows, result.tables, strict=True))
    counts = ("scene", "n_frames", *(name for name in COUNTS if name != "objects"))
    for row, table in runs:
        columns: dict[str, list[float]] = {}
        for name, values in (table or {}).items():
            is_count = name in counts or name.endswith("_n")
            columns[name] = (
                np.where(np.isfinite(values), values, 0).astype(int).tolist() if is_count else values.tolist()
            )
        for values in zip(*columns.values(), strict=True):
            yield {**_place(row), **dict(zip(columns, values, strict=True))}


def markdown(results: Sequence[ModelResult]) -> str:
    """Format all tables as one Markdown page."""
    # Escape the names in notes, but keep their emphasis.
    notes = [text.markdown(note).replace(r"\*", "*") for note in table_notes(results)]
    parts = ["# Leaderboard", "\n".join(f"- {note}" for note in notes)]
    for group in comparable_groups(results):
        parts.append(f"## {text.markdown(_title(group))}")
        parts += [
            f"### Poses\n\n{_markdown_table(table)}" if table.is_poses else _markdown_table(table)
            for table in _tables(group)
        ]
    return "\n\n".join(parts) + "\n"


def latex(results: Sequence[ModelResult]) -> str:
    """Format all tables as LaTeX, for documents that load booktabs, adjustbox and xcolor."""
    notes = [f"% {one_line(note)}" for note in (*table_notes(results), "Needs booktabs, adjustbox and xcolor.")]
    tables = [_latex_table(table) for group in comparable_groups(results) for table in _tables(group)]
    return "\n".join(notes) + "\n\n" + "\n".join(tables)


@dataclass(frozen=True)
class _Cell:
    """Cell of a table of text."""

    text: str
    letters: str = ""
    """Group letters, printed as a superscript."""
    bold: bool = False
    from_paper: bool = False


@dataclass(frozen=True)
class _Table:
    """Table of text, before it becomes Markdown or LaTeX."""

    caption: str
    columns: Sequence[Column | Score]
    blocks: Sequence[tuple[str, Sequence[Sequence[_Cell]]]]
    """Title and rows of each block; a table with a single untitled block has no headings between rows."""
    is_poses: bool = False


def _tables(group: Sequence[ModelResult]) -> Iterator[_Table]:
    """Yield the table of scores, and the table of poses if a model gives poses."""
    views = [VIEWS] if any(result.views for result in group) else []
    columns = [MODEL, *views, RANK, SEEDS, *MAIN_SCORES]
    best = best_scores(group)
    shown = [
        (block.title, [[_cell(row, column, best) for column in columns] for row in block.rows])
        for block in blocks(group)
    ]
    if paper := list(paper_of_track(group[0].place[0]).values()):
        names = [column.name if column is not MODEL else "paper_model" for column in columns]
        rows = [[_Cell(line.get(name, ""), from_paper=True) for name in names] for line in paper]
        shown.append((f"In the paper, on {paper[0]['paper_track']}: other data, not comparable", rows))
    yield _Table(f"Segmentation of {_title(group)}.", columns, shown)
    if rows := with_poses(group):
        pose_columns = [MODEL, SEEDS, *POSE_SCORES]
        cells = [[_Cell(column.cell(row)) for column in pose_columns] for row in rows]
        yield _Table(f"Poses of {_title(group)}.", pose_columns, [("", cells)], is_poses=True)


def _title(group: Sequence[ModelResult]) -> str:
    return f"{track_title(group)} ({scenes_title(group)})"


def _cell(row: Row, column: Column | Score, best: Mapping[str, float]) -> _Cell:
    """Build a cell; the best score of the ranked rows, as printed, is bold."""
    content = column.cell(row)
    if not isinstance(column, Score):
        return _Cell(content)
    competes = row.result.is_ranked and not row.without_failed and column.name in best
    is_best = competes and content.startswith(f"{best[column.name]:z.{column.digits}f}")
    return _Cell(content, group_letters(row, column), is_best)


def _markdown_table(table: _Table) -> str:
    aligned = ["---" if column in (MODEL, VIEWS) else "---:" for column in table.columns]
    lines = [[text.markdown(column.heading) for column in table.columns], aligned]
    for title, rows in table.blocks:
        lines += [[f"**{text.markdown(title)}**", *[""] * (len(table.columns) - 1)]] if title else []
        lines += [[_markdown_cell(*pair) for pair in zip(row, table.columns, strict=True)] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _markdown_cell(cell: _Cell, column: Column | Score) -> str:
    content = text.markdown(cell.text)
    if cell.from_paper and content:
        return f"*{content}*"
    content = f"**{content}**" if cell.bold else content
    return f"{content} <sup>{cell.letters}</sup>" if cell.letters else content


def _latex_table(table: _Table) -> str:
    aligned = ["l" if column in (MODEL, VIEWS) else "r" if column in (RANK, SEEDS) else "c" for column in table.columns]
    headings = [_latex_heading(column) for column in table.columns]
    lines = [
        r"\begin{table*}",
        r"    \centering",
        r"    \begin{adjustbox}{max width=1.0\textwidth}",
        rf"    \begin{{tabular}}{{{' '.join(aligned)}}}",
        r"        \toprule",
        rf"        {' & '.join(headings)} \\",
    ]
    # One rule above each block.
    for title, rows in table.blocks:
        lines.append(r"        \midrule")
        if title:
            lines.append(rf"        \multicolumn{{{len(aligned)}}}{{l}}{{\itshape {text.latex(title)}}} \\")
        for row in rows:
            cells = [_latex_cell(*pair) for pair in zip(row, table.columns, strict=True)]
            lines.append(rf"        {' & '.join(cells)} \\")
    lines += [r"        \bottomrule", r"    \end{tabular}", r"    \end{adjustbox}"]
    return "\n".join([*lines, rf"    \caption{{{text.latex(table.caption)}}}", r"\end{table*}", ""])


def _latex_heading(column: Column | Score) -> str:
    heading = text.latex(column.heading)
    return rf"{heading}$\uparrow$" if column in MAIN_SCORES else heading


def _latex_cell(cell: _Cell, column: Column | Score) -> str:
    if cell.from_paper and cell.text:
        return rf"\textcolor{{gray}}{{{text.latex(cell.text)}}}"
    if isinstance(column, Score) and cell.text not in ("", "–"):
        number = cell.text.replace("±", r"\pm")
        number = rf"\mathbf{{{number}}}" if cell.bold else number
        return f"${number}^{{{cell.letters}}}$" if cell.letters else f"${number}$"
    content = text.latex(cell.text)
    return rf"\textsc{{{content}}}" if column is MODEL else content


def _metric_columns(result: ModelResult, names: Iterable[str]) -> dict[str, float]:
    columns: dict[str, float] = {}
    for name in names:
        summary = result.summary(name)
        kept = result.summary(name, without_failed=True) if result.n_failed else summary
        columns |= {
            f"{name}_mean": summary.mean,
            f"{name}_std": summary.std,
            f"{name}_sample_std": summary.sample_std,
            f"{name}_ci_low": summary.low,
            f"{name}_ci_high": summary.high,
            f"{name}_mean_without_failed": kept.mean,
            f"{name}_std_without_failed": kept.std,
        }
    return columns


def _place(row: RunRow) -> dict[str, Cell]:
    key = row.key
    return {"track": key.track, "fit_track": key.fit_track, "model": key.model, "seed": key.seed}


def _counts(result: ModelResult) -> dict[str, np.ndarray]:
    """Sums over scenes, one for each seed: frames with one object, with undefined metrics, ignored pixels, frames."""
    names = {f"n_{name}": name for name in ("one_object", "undefined", "ignored")} | {"n_frames": "n_frames"}
    return {
        column: np.array([table[name].sum() if table and name in table else math.nan for table in result.tables])
        for column, name in names.items()
    }


def _mean(values: np.ndarray) -> float | int:
    """Mean of the defined values; an int if it is whole."""
    mean = mean_where_defined(values)
    return int(mean) if mean.is_integer() else mean


def _distinct(values: Iterable[str]) -> str:
    return "; ".join(dict.fromkeys(values))


def _measured(rows: Sequence[RunRow]) -> dict[str, float]:
    """Means over seeds of the times, and the largest memory; seeds that did not measure them are left out."""
    costs = [row.measured for row in rows]
    return {
        "measured_seconds_per_frame": mean_where_defined(np.array([cost.seconds_per_frame for cost in costs])),
        "measured_fit_seconds": mean_where_defined(np.array([cost.fit_seconds for cost in costs])),
        "measured_peak_mib": float(np.fmax.reduce([cost.peak_mib for cost in costs])),
    }
