"""Tables of poses, for the models that give poses; they have no influence on ranks."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from benchmark.ranking import escaping
from benchmark.ranking.standings import Entry, best_first
from benchmark.ranking.table_text import mean_and_std, seeds_covered


@dataclass(frozen=True)
class Column:
    """Display format of one pose score."""

    name: str
    title: str
    per_unit: float = 1.0
    """Factor from the stored unit to the shown one."""
    digits: int = 2


COLUMNS = (
    Column("posed", "found"),
    Column("translation_median", "translation, median (mm)", 1000.0, 1),
    Column("translation_error", "mean (mm)", 1000.0, 1),
    Column("translation_error_visible", "from visible points (mm)", 1000.0, 1),
    Column("orientation_median", "orientation, median (°)", 1.0, 1),
    Column("orientation_error", "mean (°)", 1.0, 1),
    Column("orientation_error_named", "axes named (°)", 1.0, 1),
    Column("box_iou", "box IoU"),
)

NOTES = (
    "Poses rank nothing. *Found* is the share of the objects in view that a slot with "
    "a pose covers by more than half (IoU of pixels); errors are of these, box IoU is of all, 0 where none was found.",
    "Translation: from the middle of the object's true box of least volume; *from visible points*: from their mean, "
    "where a model that only averages what it sees is good. Medians are of a scene, and means over scenes follow.",
    "Orientation: modulo the object's exact symmetries and the 24 ways of naming a box's axes, which no image tells; "
    "*axes named*: modulo the symmetries alone. Random orientations of what has no symmetry have 41° and 126°. Balls "
    "are left out.",
)


HEADER = ("seeds", *(column.title for column in COLUMNS))
"""Headings of the cells that `pose_cells` returns."""


def posed(field: Iterable[Entry]) -> list[Entry]:
    """Select the models of a track that give poses, the best segmentation first."""
    return [entry for entry in best_first(field) if entry.has_poses]


def pose_cells(entry: Entry) -> list[str]:
    """Format the number of seeds, and each score as mean and standard deviation over seeds."""
    return [seeds_covered(entry), *(_cell(entry, column) for column in COLUMNS)]


def markdown(field: Sequence[Entry]) -> list[str]:
    """Format the table of one track as Markdown, with its heading; empty if no model gives poses."""
    rows = _rows(field)
    if not rows:
        return []
    lines = [f"| {' | '.join(map(escaping.markdown, cells))} |" for cells in rows]
    return ["### Poses", "\n".join([lines[0], f"|---|{'---:|' * len(HEADER)}", *lines[1:]])]


def latex(field: Sequence[Entry], title: str) -> list[str]:
    """Format the table of one track as LaTeX, with the title in its caption; empty if no model gives poses."""
    rows = [" & ".join(escaping.latex(cell).replace("°", r"$^\circ$") for cell in cells) for cells in _rows(field)]
    if not rows:
        return []
    lines = [
        r"\begin{table*}",
        r"    \centering",
        r"    \begin{adjustbox}{max width=1.0\textwidth}",
        rf"    \begin{{tabular}}{{l {'r ' * len(HEADER)}}}",
        r"        \toprule",
        rf"        {rows[0]} \\",
        r"        \midrule",
        *(rf"        {row} \\" for row in rows[1:]),
        r"        \bottomrule",
        r"    \end{tabular}",
        r"    \end{adjustbox}",
        rf"    \caption{{Poses of {escaping.latex(title)}.}}",
        r"\end{table*}",
        "",
    ]
    return ["\n".join(lines)]


def _rows(field: Iterable[Entry]) -> list[tuple[str, ...]]:
    """Header row and model rows, the best segmentation first; empty if no model gives poses."""
    rows = [(f"{entry.row.key.model} {entry.marks}".strip(), *pose_cells(entry)) for entry in posed(field)]
    return [("model", *HEADER), *rows] if rows else []


def _cell(entry: Entry, column: Column) -> str:
    mean, std = (value * column.per_unit for value in entry.spread(column.name))
    return mean_and_std(mean, std, column.digits)
