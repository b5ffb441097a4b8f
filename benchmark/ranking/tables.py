"""The leaderboard with the paper's columns, as Markdown and as LaTeX: mean±std over seeds, in blocks by kind.

Within a block the best comes first, and the block with the best model stands on top. The best row without training is
repeated among the learned ones. The paper's own figures stand in a grey column. Failed seeds count in a row; the row
beneath leaves them out.
"""

import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from benchmark.ranking import pose_tables
from benchmark.ranking.escaping import latex as latex_text
from benchmark.ranking.escaping import markdown as markdown_text
from benchmark.ranking.escaping import one_line
from benchmark.ranking.published import PAPER_MODELS, PAPER_TRACKS, paper_cells, paper_metrics
from benchmark.ranking.standings import (
    ORACLE_METRICS,
    PRETRAINED,
    RANKED_METRICS,
    TUNED,
    USES_LABELS,
    Entry,
    best_first,
    best_without_training,
    fields,
    in_order_of_rank,
)
from benchmark.ranking.table_text import (
    free_of_slots,
    mean_and_std,
    rank_in_words,
    run_once,
    seeds_covered,
    seeds_in_words,
    views_explained,
    without_floor,
)
from datagen.console.text import counted

SHOWN = {
    "miou_bg": "mIoU-BG",
    "ari_fg": "ARI-FG",
    "msc_fg": "MSC-FG",
    "ari": "ARI",
    "miou_bg_oracle": f"mIoU-BG{USES_LABELS}",
    "msc_fg_oracle_bg": f"MSC-FG{USES_LABELS}",
}
"""Metrics in the tables; the CSV has them all."""

BLOCKS = {
    "classical": "Without training",
    "predictions": "Given label maps",
    "learned": "Learned",
    "floor": "Floors",
    "oracle": f"Oracles and models that use labels {USES_LABELS}: not ranked",
}

NOTES = (
    "Ranked by the mean of the ranks in ARI-FG and MSC-FG; bold is the best of the ranked rows.",
    "Rows that share a letter cannot be told apart in that column (paired by scene, Holm-corrected, 5 %).",
    f"{USES_LABELS} in a heading: with the slot as background that suits the truth best; no model is ranked by it, and "
    "none is bold.",
    f"{USES_LABELS} behind a name: uses labels, and is not ranked. {TUNED} labels of the validation split were used "
    f"for tuning, and the number of values or short runs that were compared stands behind it. {PRETRAINED} weights "
    "that ship with the package or were given, of one seed.",
    "A seed failed if its loss or a score was nan, its mIoU-BG is under 0.5 (swap), or its MSC-FG is within 0.05 of "
    "the best floor's (collapse). A model whose every seed failed is not ranked.",
    "Seeds are those that a mean is over; failed ones that have scores count until the row beneath leaves them out.",
)
GREY = "in the paper (other data: not comparable)"


@dataclass(frozen=True)
class Line:
    """One row of a table."""

    label: str
    rank: str
    seeds: str
    """Number of seeds that the means are over."""
    cells: tuple[str, ...]
    """One for each of `SHOWN`."""
    groups: tuple[str, ...]
    """Letters for each cell."""
    bold: tuple[bool, ...]
    paper: str
    """The paper's figures; empty where it has none."""
    views: str = ""
    """Views of a frame that the model is given and that supervise it; empty if it does not declare them."""


@dataclass(frozen=True)
class Block:
    """Rows of one kind."""

    title: str
    lines: tuple[Line, ...]


@dataclass(frozen=True)
class Board:
    """One table: a track, and what the models were fitted on."""

    track: str
    title: str
    blocks: tuple[Block, ...]

    @property
    def has_paper(self) -> bool:
        """Whether the paper has figures for this track."""
        return self.track in PAPER_TRACKS

    @property
    def has_views(self) -> bool:
        """Whether some row says how many views its model uses."""
        return any(line.views for block in self.blocks for line in block.lines)


def boards(entries: Iterable[Entry]) -> list[Board]:
    """The tables of a run folder's entries."""
    return [_board(field) for field in fields(entries)]


def markdown(entries: Iterable[Entry]) -> str:
    """All tables as one Markdown page."""
    entries = list(entries)
    parts = ["# Leaderboard", "\n".join(f"- {note}" for note in _notes(entries, markdown_text))]
    for field in fields(entries):
        board = _board(field)
        parts += [f"## {markdown_text(board.title)}", "\n".join(_markdown_rows(board)), *pose_tables.markdown(field)]
    return "\n\n".join(parts) + "\n"


def latex(entries: Iterable[Entry]) -> str:
    """All tables as LaTeX, for documents that load booktabs, adjustbox and xcolor."""
    entries = list(entries)
    notes = [f"% {note}" for note in (*_notes(entries, one_line), "Needs booktabs, adjustbox and xcolor.")]
    tables = [
        table
        for field in fields(entries)
        for table in (_latex_table(_board(field)), *pose_tables.latex(field, _board(field).title))
    ]
    return "\n".join(notes) + "\n\n" + "\n".join(tables)


def _notes(entries: Sequence[Entry], escaped: Callable[[str], str]) -> Iterator[str]:
    """Notes on all tables; names in them are escaped."""
    seeds, once = seeds_in_words(entries), run_once(entries)
    yield (
        "Mean±population standard deviation over seeds, of one seed the score alone; leaderboard.csv has all metrics, "
        "and 95 % bootstrap intervals over seeds and scenes"
        + (f"; with few seeds these under-cover, and here models have {seeds}." if seeds else ".")
    )
    if once:
        yield f"Run once, as seeds make no difference to them: {escaped(once)}."
    yield from NOTES
    if any(entry.has_poses for entry in entries):
        yield from pose_tables.NOTES
    said = views_explained(entries), free_of_slots(entries), without_floor(entries)
    yield from (escaped(note) for note in said if note)


def _board(field: Sequence[Entry]) -> Board:
    track, fit_track, _ = field[0].place
    key = field[0].row.key
    fitted = "weights trained" if all(entry.row.pretrained for entry in field) else "models fitted"
    title = track if fit_track == track else f"{track}, {fitted} on {fit_track}"
    scenes = max(entry.n_scenes for entry in field)
    skipped = max(entry.n_skipped for entry in field)
    without = f", {skipped} without any object" if skipped else ""
    blocks = tuple(block for block in _blocks(track, field) if block.lines)
    return Board(track, f"{title} ({counted(scenes, 'scene')}{without}; dataset {key.track_spec[:8]})", blocks)


def _blocks(track: str, field: Sequence[Entry]) -> Iterator[Block]:
    best, free = _best_cells(field), best_without_training(field)
    members = {kind: [entry for entry in field if _block_of(entry) == kind] for kind in BLOCKS}
    for kind in in_order_of_rank(members):
        repeated = [free] if free and kind == "learned" and members[kind] else []
        lines = [
            line
            for entry in best_first([*members[kind], *repeated])
            for line in _lines(entry, best, prefix="best without training: " if entry in repeated else "")
        ]
        yield Block(BLOCKS[kind], tuple(lines))
    missing = set(PAPER_MODELS) - {entry.row.key.model for entry in field}
    others = [model for model in PAPER_MODELS if model in missing and paper_cells(track, model)]
    yield Block("In the paper, not run here", tuple(_paper_line(track, model) for model in others))


def _block_of(entry: Entry) -> str:
    return "oracle" if entry.row.uses_labels else entry.row.kind


def _best_cells(field: Iterable[Entry]) -> dict[str, str]:
    """The best mean of each metric that is fair to all among ranked rows, as printed."""
    ranked = [entry for entry in field if entry.is_ranked]
    fair = [name for name in SHOWN if name not in ORACLE_METRICS]
    return {name: f"{max((entry.best_known(name) for entry in ranked), default=math.nan):z.2f}" for name in fair}


def _lines(entry: Entry, best: Mapping[str, str], prefix: str = "") -> list[Line]:
    """The entry's row, and beneath it the one without failed seeds, if some failed."""
    label = f"{prefix}{entry.row.key.model} {entry.marks}".strip()
    cells = _cells(entry, without_failed=False)
    groups: dict[str, str] = dict(zip(RANKED_METRICS, entry.groups, strict=True))
    bold = tuple(
        entry.is_ranked and name in best and cell.startswith(best[name])
        for name, cell in zip(SHOWN, cells, strict=True)
    )
    paper = " ".join(paper_cells(entry.row.key.track, entry.row.key.model).values())
    letters = tuple(groups.get(name, "") for name in SHOWN)
    line = Line(label, rank_in_words(entry), seeds_covered(entry), cells, letters, bold, paper, entry.views)
    if not entry.n_failed:
        return [line]
    failed = min(entry.n_failed, entry.n_runs)
    left = entry.n_runs - failed
    reasons = ", ".join(dict.fromkeys(_brief(cause) for cause in entry.causes if cause))
    label = f"without the {failed} failed of {counted(entry.n_runs, 'seed')} ({reasons})"
    cells = _cells(entry, without_failed=True) if left else ("–",) * len(SHOWN)
    seeds = f"{left} of {entry.n_runs}"
    return [line, Line(f"– {label}", "", seeds, cells, ("",) * len(SHOWN), (False,) * len(SHOWN), "")]


def _brief(cause: str) -> str:
    return textwrap.shorten(cause, 80, placeholder=" ...")


def _cells(entry: Entry, *, without_failed: bool) -> tuple[str, ...]:
    return tuple(mean_and_std(*entry.spread(name, without_failed=without_failed)) for name in SHOWN)


def _paper_line(track: str, model: str) -> Line:
    empty = ("",) * len(SHOWN)
    return Line(model, "", "", empty, empty, (False,) * len(SHOWN), " ".join(paper_cells(track, model).values()))


def _markdown_rows(board: Board) -> Iterator[str]:
    grey = [f"*{_paper_header(board)}*"] if board.has_paper else []
    views = ["views"] if board.has_views else []
    header = ["model", *views, "rank", "seeds", *SHOWN.values(), *grey]
    yield _markdown_row(header)
    yield _markdown_row(["---", *("---" for _ in views), *["---:"] * (len(header) - len(views) - 1)])
    for block in board.blocks:
        yield _markdown_row([f"**{block.title}**", *[""] * (len(header) - 1)])
        for line in block.lines:
            paper = [f"*{line.paper}*" if line.paper else ""] if board.has_paper else []
            said = [markdown_text(line.label), *(markdown_text(line.views) for _ in views), line.rank, line.seeds]
            yield _markdown_row([*said, *map(_markdown_cell, line.cells, line.groups, line.bold), *paper])


def _markdown_row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _markdown_cell(cell: str, groups: str, bold: bool) -> str:
    text = f"**{cell}**" if bold else cell
    return f"{text} <sup>{groups}</sup>" if groups else text


def _paper_header(board: Board) -> str:
    names = " ".join(SHOWN[name] for name in paper_metrics(board.track))
    return f"{names} of {PAPER_TRACKS[board.track]} {GREY}"


def _latex_table(board: Board) -> str:
    grey = [_grey(_paper_header(board))] if board.has_paper else []
    views = ["views"] if board.has_views else []
    columns = "l " + "l " * len(views) + "r r " + " ".join("c" * (len(SHOWN) + len(grey)))
    header = ["", *views, "rank", "seeds", *(rf"{latex_text(name)}$\uparrow$" for name in SHOWN.values()), *grey]
    lines = [
        r"\begin{table*}",
        r"    \centering",
        r"    \begin{adjustbox}{max width=1.0\textwidth}",
        rf"    \begin{{tabular}}{{{columns}}}",
        r"        \toprule",
        f"        {' & '.join(header)} \\\\",
    ]
    for block in board.blocks:
        lines += [
            r"        \midrule",
            rf"        \multicolumn{{{len(header)}}}{{l}}{{\itshape {latex_text(block.title)}}} \\",
        ]
        lines += [f"        {_latex_row(line, board)}" for line in block.lines]
    lines += [r"        \bottomrule", r"    \end{tabular}", r"    \end{adjustbox}"]
    caption = rf"    \caption{{Segmentation of {latex_text(board.title)}.}}"
    return "\n".join([*lines, caption, r"\end{table*}", ""])


def _latex_row(line: Line, board: Board) -> str:
    cells = map(_latex_cell, line.cells, line.groups, line.bold)
    paper = [_grey(line.paper) if line.paper else ""] if board.has_paper else []
    views = [latex_text(line.views)] if board.has_views else []
    return " & ".join([rf"\textsc{{{latex_text(line.label)}}}", *views, line.rank, line.seeds, *cells, *paper]) + r" \\"


def _latex_cell(cell: str, groups: str, bold: bool) -> str:
    if cell in ("", "–"):
        return "--" if cell else ""
    number = cell.replace("±", r"\pm")
    number = rf"\mathbf{{{number}}}" if bold else number
    return f"${number}^{{{groups}}}$" if groups else f"${number}$"


def _grey(text: str) -> str:
    return rf"\textcolor{{gray}}{{{latex_text(text)}}}"
