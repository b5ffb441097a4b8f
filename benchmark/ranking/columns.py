"""Columns, rows, blocks and notes of the leaderboard, from which every table is rendered.

The terminal, Markdown, LaTeX and HTML tables choose from these columns and define none of their own. leaderboard.csv is
more detailed: it has several columns for each score, in the order in which the metrics are computed.
"""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from benchmark.names import explain_suffixes
from benchmark.ranking.standings import (
    ALL_METRICS,
    PRETRAINED,
    RANKED_METRICS,
    SWITCHES,
    TUNED,
    USES_LABELS,
    ModelResult,
    best_first,
)
from datagen.console.text import brief, counted


@dataclass(frozen=True)
class Row:
    """One line of a table: a model on a track."""

    result: ModelResult
    without_failed: bool = False
    """Whether failed seeds are left out; such a line stands below the line of all seeds."""

    @property
    def label(self) -> str:
        """Name of the model with its marks, or the number of failed seeds that this line leaves out."""
        result = self.result
        if not self.without_failed:
            return f"{result.row.key.model} {result.marks}".strip()
        reasons = ", ".join(dict.fromkeys(brief(cause, 80) for cause in result.causes if cause))
        return f"– without the {self._failed} failed of {counted(result.n_runs, 'seed')} ({reasons})"

    @property
    def rank(self) -> str:
        """Rank, such as 1, or 2.5 if two models share places 2 and 3; empty if the model is not ranked."""
        return f"{self.result.rank:g}" if self.result.rank and not self.without_failed else ""

    @property
    def seeds(self) -> str:
        """Number of seeds that the means are over, and of all seeds if they differ."""
        covered, runs = self.result.n_scored, self.result.n_runs
        if self.without_failed:
            return f"{runs - self._failed} of {runs}"
        return str(covered) if covered == runs else f"{covered} of {runs}"

    @property
    def _failed(self) -> int:
        return min(self.result.n_failed, self.result.n_runs)


@dataclass(frozen=True)
class Column:
    """Column of the tables: a heading, and the text of each row's cell."""

    name: str
    heading: str
    cell: Callable[[Row], str]
    note: str = ""
    """Explanation of the heading, shown below a table or as a tooltip."""


@dataclass(frozen=True)
class Score:
    """Column of a score, printed as mean±standard deviation over seeds."""

    name: str
    """Name in leaderboard.csv."""
    heading: str
    note: str = ""
    digits: int = 2
    scale: float = 1.0
    """Factor from the stored unit to the printed one."""

    def cell(self, row: Row) -> str:
        """Format the score of a row."""
        mean, std = (value * self.scale for value in row.result.score(self.name, without_failed=row.without_failed))
        return mean_and_std(mean, std, self.digits)

    @property
    def is_oracle(self) -> bool:
        """Whether the background slot is chosen by ground truth; such scores rank nothing and are never bold."""
        return USES_LABELS in self.heading


MODEL = Column("model", "model", lambda row: row.label)
VIEWS = Column(
    "views",
    "views",
    lambda row: "" if row.without_failed else row.result.views,
    "Views: how many of a frame's views a model is given, and how many supervise it in training.",
)
RANK = Column("rank", "rank", lambda row: row.rank, "Rank by the mean of the ranks in ARI-FG and MSC-FG.")
SEEDS = Column("seeds", "seeds", lambda row: row.seeds, "Seeds that the means are over.")

_ORACLE_NOTE = "The background slot is the one that suits the ground truth best: an upper bound, never ranked."
SCORES = (
    Score("ari_fg", "ARI-FG", "Adjusted Rand index of the object pixels; blind to segments that leak into background."),
    Score("msc_fg", "MSC-FG", "Mean over objects of the best IoU with a segment other than the background slot."),
    Score("miou_bg", "mIoU-BG", "IoU of the background slot with the true background."),
    Score("ari", "ARI", "Adjusted Rand index of all pixels."),
    Score("miou_bg_oracle", f"mIoU-BG{USES_LABELS}", _ORACLE_NOTE),
    Score("msc_fg_oracle_bg", f"MSC-FG{USES_LABELS}", _ORACLE_NOTE),
    Score("msc_fg_allslots", "MSC-FG, all slots (mBO)"),
    Score("miou_fg_hungarian", "mIoU-FG (Hungarian)"),
    Score("ari_video", "ARI, clip"),
    Score("ari_fg_video", "ARI-FG, clip"),
    Score("msc_fg_video", "MSC-FG, clip"),
)
"""Segmentation scores of all results, the most important first."""
SUMMARISED = (*(name for name in ALL_METRICS if name in {score.name for score in SCORES}), SWITCHES)
"""Names of `SCORES` in the order of leaderboard.csv, with the identity switches, which no other table shows."""
OTHER_SCORES = (
    Score("hota", "HOTA", "Higher-order tracking accuracy: geometric mean of detection and association."),
    Score("idf1", "IDF1", "F1 of frames in which an object has its one slot of the clip, with an IoU of at least 0.5."),
    Score("j_and_f", "J&F", "Mean of IoU and boundary F1, objects matched to slots for the whole clip."),
    Score("ap50", "AP@50", "Precision times recall of segments with an IoU above 0.5: segments have no confidence."),
    Score("pq", "PQ", "Panoptic quality of objects: F1 times the mean IoU of the matches."),
    Score("f1", "F1", "F1 of objects and segments matched with an IoU above 0.5."),
    Score("ami", "AMI", "Adjusted mutual information of all pixels."),
    Score("ami_fg", "AMI-FG", "Adjusted mutual information of the object pixels."),
)
"""Scores of other benchmarks, which older results do not have; they have no influence on ranks."""
HEADLINE_SCORES, MAIN_SCORES = SCORES[:4], SCORES[:6]
"""Scores of the terminal table, and of the Markdown and LaTeX tables."""
HEADINGS = {score.name: score.heading for score in (*SCORES, *OTHER_SCORES)}

POSE_SCORES = (
    Score("posed", "found"),
    Score("translation_median", "translation, median (mm)", digits=1, scale=1000.0),
    Score("translation_error", "mean (mm)", digits=1, scale=1000.0),
    Score("translation_error_visible", "from visible points (mm)", digits=1, scale=1000.0),
    Score("orientation_median", "orientation, median (°)", digits=1),
    Score("orientation_error", "mean (°)", digits=1),
    Score("orientation_error_named", "axes named (°)", digits=1),
    Score("box_iou", "box IoU"),
)
"""Scores of the models that give poses; they have no influence on ranks."""
HEADLINE_POSES = tuple(POSE_SCORES[place] for place in (0, 1, 4, 7))
"""Scores of the terminal table of poses."""

MARKS = {
    USES_LABELS: "uses ground-truth labels, and is not ranked",
    TUNED: "settings were chosen on labelled validation scenes; the number is that of values or short runs compared",
    PRETRAINED: "pretrained: one set of weights, which ships with the package or was given",
}
GROUP_LETTERS = (
    "Models that share a letter do not differ significantly (paired by scene, Holm-corrected, 5 %). A low score that "
    "varies much between scenes can share the letter of a high one."
)
FRACTIONAL_RANKS = "A rank of 2.5 means that two models share places 2 and 3."
FAILED_SEEDS = (
    "A seed failed if its loss was nan or infinite, its mIoU-BG is below 0.5 (swap), or its MSC-FG is within 0.05 of "
    "the best floor's (collapse). A model whose every seed failed is not ranked."
)
NOTES = (
    f"Ranked by the mean of the ranks in ARI-FG and MSC-FG; bold is the best of the ranked rows. {FRACTIONAL_RANKS}",
    f"Letters behind scores: {GROUP_LETTERS}",
    f"{USES_LABELS} in a heading: {_ORACLE_NOTE}",
    *(f"{mark} behind a name: {meaning}." for mark, meaning in MARKS.items()),
    FAILED_SEEDS,
    "Failed seeds that have scores count in a row; the row below leaves them out.",
)
POSE_NOTES = (
    "Poses have no influence on ranks. *Found* is the share of the objects in view that a slot with a pose covers with "
    "an IoU above 0.5. Errors are over found objects; box IoU is over all objects and 0 where none was found.",
    "Translation: from the centre of the object's true bounding box of least volume. *From visible points*: from their "
    "mean, which favours models that average what they see. Medians are taken per scene and averaged over scenes.",
    "Orientation: modulo the object's exact symmetries and the 24 ways to name the axes of a box, which are not "
    "observable. *Axes named*: modulo the symmetries alone. Random orientations of objects without symmetries have "
    "errors of 41° and 126°. Spheres are left out.",
)

BLOCKS = {
    "learned": "Learned models",
    "predictions": "Given label maps",
    "classical": "Training-free baselines",
    "labels": f"Models that use labels {USES_LABELS}: not ranked",
    "floor": "Floors: trivial segmentations, not ranked",
    "oracle": f"Oracles {USES_LABELS}: limited or perturbed ground truth, not ranked",
}
"""Kinds of models, in the order in which tables show them."""


@dataclass(frozen=True)
class Block:
    """Models of one kind on one track."""

    kind: str
    title: str
    rows: tuple[Row, ...]
    """Best model first; a row of a model with failed seeds is followed by the row without these seeds."""


def blocks(group: Iterable[ModelResult]) -> list[Block]:
    """Arrange comparable results in blocks by kind; empty blocks are left out."""
    members: dict[str, list[Row]] = {kind: [] for kind in BLOCKS}
    for result in best_first(group):
        both = [Row(result), Row(result, without_failed=True)]
        members[kind_of(result)] += both if result.n_failed else both[:1]
    return [Block(kind, BLOCKS[kind], tuple(rows)) for kind, rows in members.items() if rows]


def kind_of(result: ModelResult) -> str:
    """Key in `BLOCKS` of a model."""
    competes = result.row.kind not in ("floor", "oracle")
    return "labels" if competes and result.row.uses_labels else result.row.kind


def with_poses(group: Iterable[ModelResult]) -> list[Row]:
    """Rows of the models that give poses, best segmentation first."""
    return [Row(result) for result in best_first(group) if result.has_poses]


def best_scores(group: Iterable[ModelResult]) -> dict[str, float]:
    """Largest mean of each score among ranked models; oracle scores are left out."""
    ranked = [result for result in group if result.is_ranked]
    fair = [score.name for score in MAIN_SCORES if not score.is_oracle]
    return {name: max((result.mean(name) for result in ranked), default=math.nan) for name in fair}


def group_letters(row: Row, score: Score) -> str:
    """Letters of the models that do not differ significantly from this one in a ranked score; empty for others."""
    letters: dict[str, str] = dict(zip(RANKED_METRICS, row.result.group_letters, strict=True))
    return "" if row.without_failed else letters.get(score.name, "")


def mean_and_std(mean: float, std: float, digits: int = 2) -> str:
    """Format a score as in the paper; the deviation is left out if it is nan, as for one seed."""
    if math.isnan(mean):
        return "–"
    return f"{mean:z.{digits}f}" if math.isnan(std) else f"{mean:z.{digits}f}±{std:.{digits}f}"


def place_title(track: str, fit_track: str, fitted: str = "fitted") -> str:
    """Name a track, and the track fitted on if it is another one."""
    return track if fit_track == track else f"{track}, {fitted} on {fit_track}"


def track_title(group: Sequence[ModelResult]) -> str:
    """Name the track, and the track fitted on if it is another one."""
    fitted = "weights trained" if all(result.row.pretrained for result in group) else "models fitted"
    return place_title(*group[0].place[:2], fitted)


def scenes_title(group: Sequence[ModelResult]) -> str:
    """State the number of scenes and the dataset."""
    scenes, skipped = (max(getattr(result, name) for result in group) for name in ("n_scenes", "n_skipped"))
    without = f", {skipped} without any object" if skipped else ""
    return f"{counted(scenes, 'test scene')}{without}; dataset {group[0].row.key.track_spec[:8]}"


def table_notes(results: Sequence[ModelResult]) -> Iterator[str]:
    """Yield all notes on the Markdown and LaTeX tables of these results."""
    seeds = seeds_in_words(results)
    yield (
        "Mean±population standard deviation over seeds; the score alone for one seed. leaderboard.csv has all metrics, "
        "and 95 % bootstrap intervals over seeds and scenes"
        + (f", which under-cover with few seeds; here models have {seeds}." if seeds else ".")
    )
    yield from NOTES
    yield from suffixes_explained(results)
    if any(result.has_poses for result in results):
        yield from POSE_NOTES
    yield from caveats(results)


def caveats(results: Sequence[ModelResult]) -> list[str]:
    """Explain what is special about these results, such as a missing floor; most results need none of this."""
    once = {result.row.key.model for result in results if result.n_runs < len(result.rows)}
    models = [result.row for result in results if result.row.kind in ("classical", "learned") and result.n_scenes]
    free = {row.key.model for row in models if "slots" not in row.priors}
    said = {
        f"Run once, because they do not depend on the seed: {_listed(once)}.": once,
        VIEWS.note: any(result.views for result in results),
        f"Not limited to the track's number of slots, because they find the number of objects: {_listed(free)}.": free,
        without_floor(results): True,
    }
    return [note for note, applies in said.items() if note and applies]


def without_floor(results: Iterable[ModelResult]) -> str:
    """Name the tracks on which models compete without a floor, in a sentence; empty if there are none."""
    blind = [r for r in results if r.row.kind not in ("floor", "oracle") and math.isnan(r.best_floor)]
    tracks = _listed({result.row.key.track for result in blind})
    return f"No floor was scored on {tracks}: collapsed seeds cannot be detected; add --model floors." if blind else ""


def marks_explained(results: Sequence[ModelResult]) -> list[tuple[str, str]]:
    """List the marks that occur, with their meanings."""
    return [(mark, meaning) for mark, meaning in MARKS.items() if any(mark in result.marks for result in results)]


def suffixes_explained(results: Sequence[ModelResult]) -> list[str]:
    """Explain the suffixes of row names that occur."""
    return explain_suffixes(result.row.key.model for result in results)


def seeds_in_words(results: Iterable[ModelResult]) -> str:
    """Number of seeds of the models that depend on seeds; empty if there is no such model."""
    numbers = {result.n_runs for result in results if result.row.random}
    if not numbers:
        return ""
    fewest, most = min(numbers), max(numbers)
    return f"{'' if fewest == most else f'{fewest} to '}{counted(most, 'seed')}"


@cache
def paper_scores() -> Mapping[tuple[str, str], dict[str, str]]:
    """Scores printed in the paper by our names of track and model; its datasets differ, so they rank nothing.

    Besides scores, each line has `paper_track` and `paper_model`, the names in the paper.
    """
    text = files("benchmark.ranking").joinpath("paper.csv").read_text(encoding="utf-8")
    lines = [{name: cell for name, cell in line.items() if cell} for line in csv.DictReader(text.splitlines())]
    return {(line.pop("track"), line.pop("model")): line for line in lines}


def paper_of_track(track: str) -> dict[str, dict[str, str]]:
    """Lines of `paper_scores` on a track by our names of the models; empty if the paper has no such track."""
    return {model: line for (name, model), line in paper_scores().items() if name == track}


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names))
