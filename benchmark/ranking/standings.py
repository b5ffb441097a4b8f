"""Standings of models on each track: group a run folder's rows over seeds, detect failures, and rank.

Two models are compared only where they were scored on the same dataset and fitted the same way: each on the track
itself, or all on one other track. Floors, oracles and models that saw labels are shown and never ranked.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations, groupby
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float64

from benchmark.metrics import CLIP_METRICS, METRICS
from benchmark.metrics.poses import POSE_METRICS
from benchmark.ranking import statistics
from benchmark.ranking.failed_seeds import HEADLINE, cause_of_failure, has_finite_loss
from benchmark.ranking.statistics import Difference, Resamples, Summary
from benchmark.results.run_folder import RunRow, SceneTable, load_runs, load_scenes
from datagen.console.text import counted
from datagen.errors import CorruptFile

ALL_METRICS = (*METRICS, *CLIP_METRICS)
RANKED_METRICS = ("ari_fg", "msc_fg")
"""Models are ordered by the mean of their ranks in these."""
ORACLE_METRICS = ("miou_bg_oracle", "msc_fg_oracle_bg")
"""Metrics that choose the background slot by ground truth: marked `USES_LABELS`, and not used for ranking."""
SWITCHES = "identity_switches"
"""Identity switches per scene, summarised like a metric; fewer are better."""

USES_LABELS, TUNED, PRETRAINED = "†", "‡", "§"
"""Marks of models that see labels, of those whose values were chosen by scores on the validation split, and of those
whose weights the run did not make."""

BOOTSTRAP_SEED = 0

Item = TypeVar("Item")

Scores = tuple[Float64[np.ndarray, "seed scene"], Float64[np.ndarray, "seed scene"]]
"""Scores of one metric: each scene's mean, and the number of values behind it."""


@runtime_checkable
class Progress(Protocol):
    """Function that iterates over a sequence and shows how many items are done."""

    def __call__(self, items: Sequence[Item], title: str, /) -> Iterable[Item]:
        """Iterate over the items; `title` describes the work."""
        ...


@dataclass(frozen=True, eq=False)
class Entry:
    """One model on one track, all seeds together."""

    rows: tuple[RunRow, ...]
    """Ordered by seed; they differ in the seed only, and in their contents where they are label maps made elsewhere."""
    causes: tuple[str, ...]
    """Reason why each seed failed; empty if it did not."""
    tables: tuple[SceneTable | None, ...]
    """Each seed's scores scene by scene; None if the run gave none."""
    best_floor: float = np.nan
    """Largest MSC-FG of a floor on the same dataset; nan if none was scored, so that collapse cannot be detected."""
    mean_rank: float = np.nan
    """Mean of the ranks in `RANKED_METRICS`; nan where the model is not ranked."""
    rank: float | None = None
    """Place by mean rank; ties share the mean of their places; None if the model is not ranked."""
    groups: tuple[str, ...] = ("",) * len(RANKED_METRICS)
    """Group letters for each of `RANKED_METRICS`; models that share a letter do not differ significantly."""

    @property
    def row(self) -> RunRow:
        """Row of the first seed, for fields that are equal in all seeds."""
        return self.rows[0]

    @property
    def place(self) -> tuple[str, str, str]:
        """Track, track fitted on, model."""
        return self.row.key.track, self.row.key.fit_track, self.row.key.model

    @property
    def marks(self) -> str:
        """`USES_LABELS`, `TUNED` with the number of trials, and `PRETRAINED`, where they apply."""
        row = self.row
        tuned = f"{TUNED}{row.trials or ''}" if row.tuned else ""
        return f"{USES_LABELS * row.uses_labels}{tuned}{PRETRAINED * bool(row.pretrained)}"

    @property
    def views(self) -> str:
        """Views of a frame that the model is given and that supervise it; empty if it does not declare them."""
        return next((row.views for row in self.rows if row.views), "")

    @property
    def has_poses(self) -> bool:
        """Whether all runs that gave scores gave poses."""
        tables = [table for table in self.tables if table is not None]
        return bool(tables) and all(POSE_METRICS[0] in table for table in tables)

    @property
    def is_ranked(self) -> bool:
        """Whether the model may be ranked: it uses no labels, is no floor or oracle, and not every seed failed."""
        knows = self.row.kind in ("floor", "oracle") or self.row.uses_labels
        return not knows and self.n_failed < len(self.rows)

    @property
    def n_runs(self) -> int:
        """Number of seeds that were run; 1 if seeds make no difference."""
        return len(self.rows) if self.row.random else 1

    @property
    def n_scored(self) -> int:
        """Number of runs that gave scores; means are over these."""
        return min(sum(row.status == "ok" for row in self.rows), self.n_runs)

    @property
    def n_failed(self) -> int:
        """Number of seeds that failed, by the failure rule or for lack of scores."""
        return sum(map(bool, self.causes))

    @property
    def n_scenes(self) -> int:
        """Number of scenes that each seed was scored on."""
        return max(row.n_scenes for row in self.rows)

    @property
    def n_skipped(self) -> int:
        """Number of scenes without an object in any frame; they count in no ranked metric."""
        counted = [self.scores(name)[1].any(axis=0) for name in RANKED_METRICS]
        return self.n_scenes - int(np.any(counted, axis=0).sum())

    def scores(self, metric: str, *, without_failed: bool = False) -> Scores:
        """Scores of a metric for all seeds that have some, optionally without failed seeds."""
        tables = [
            table
            for table, cause in zip(self.tables, self.causes, strict=True)
            if table is not None and not (without_failed and cause)
        ]
        shape = (len(tables), self.n_scenes)
        if not tables or any(metric not in table for table in tables):
            return np.full(shape, np.nan), np.zeros(shape)
        return np.stack([table[metric] for table in tables]), np.stack([_weights(table, metric) for table in tables])

    def summary(self, metric: str, *, without_failed: bool = False) -> Summary:
        """Mean, spread and interval of a metric."""
        scores, weights = self.scores(metric, without_failed=without_failed)
        if not self.row.random:
            scores, weights = scores[:1], weights[:1]
        if scores.size == 0:
            return Summary(*[np.nan] * 5)
        summary = statistics.summarise(scores, weights, resamples(*scores.shape))
        return summary if self.row.random else replace(summary, sample_std=0.0 if len(self.rows) > 1 else np.nan)

    def seed_means(self, metric: str) -> Float64[np.ndarray, "seed"]:
        """Pooled means of a metric, one for each of `rows`; nan where there are no scores."""
        return np.array([_pooled(table, metric) for table in self.tables])

    def spread(self, metric: str, *, without_failed: bool = False) -> tuple[float, float]:
        """Mean and population standard deviation over the runs; the latter is nan where only one run has a score."""
        causes = self.causes[: self.n_runs]
        kept = [not (without_failed and cause) for cause in causes]
        mean, deviation, sample_deviation = statistics.spread(self.seed_means(metric)[: self.n_runs][kept])
        return mean, np.nan if np.isnan(sample_deviation) else deviation

    def best_known(self, metric: str) -> float:
        """Mean of a metric over seeds, by which entries are compared."""
        return statistics.spread(self.seed_means(metric))[0]


def silent(items: Sequence[Item], title: str) -> Iterable[Item]:
    """Show no progress; a `Progress`."""
    return items


def load_standings(folder: Path, progress: Progress = silent) -> list[Entry]:
    """Load all entries of a run folder, ordered by track, track fitted on and model, judged and ranked.

    Raises:
        CorruptFile: a row or its scene table is damaged.
    """
    return ranked(load_entries(folder, progress), progress)


def load_entries(folder: Path, progress: Progress = silent) -> list[Entry]:
    """Load all entries of a run folder, judged but not ranked; order and errors as in `load_standings`."""
    rows = load_runs(folder)
    _check_scenes(folder, rows)
    return judged(
        rows, [load_scenes(folder, row) if row.status == "ok" else None for row in progress(rows, "reading scores")]
    )


def _check_scenes(folder: Path, rows: Iterable[RunRow]) -> None:
    """Check that all finished rows of a dataset have the same scenes, by which they are paired."""
    first: dict[str, RunRow] = {}
    for row in rows:
        other = first.setdefault(row.key.track_spec, row) if row.status == "ok" else row
        if row.n_scenes != other.n_scenes:
            raise CorruptFile(
                f"{folder} has {counted(row.n_scenes, 'scene')} in the row {row.key.name} and {other.n_scenes} in "
                f"{other.key.name}, of the same dataset; expected equally many. Delete the wrong row in runs/ and run "
                "it again."
            )


def standings(rows: Sequence[RunRow], tables: Sequence[SceneTable | None]) -> list[Entry]:
    """Judge and rank rows, given with their scene tables; the result is that of `load_standings`."""
    return ranked(judged(rows, tables))


def judged(rows: Sequence[RunRow], tables: Sequence[SceneTable | None]) -> list[Entry]:
    """Group rows over seeds, and determine which seeds failed."""
    pairs = sorted(zip(rows, tables, strict=True), key=lambda pair: (_group(pair[0]), pair[0].key.seed))
    entries = [_entry(list(members)) for _, members in groupby(pairs, key=lambda pair: _group(pair[0]))]
    floors = _best_floors(entries)
    defined = _defined(entries)
    return [_judged(entry, floors.get(entry.row.key.track_spec, np.nan), defined) for entry in entries]


def ranked(entries: Sequence[Entry], progress: Progress = silent) -> list[Entry]:
    """Rank judged entries within each field; those that may not be ranked stay as they are."""
    found = [entry for field in progress(fields(entries), "ranking models") for entry in _ranked(field)]
    return sorted(found, key=lambda entry: _group(entry.row))


def compare_entries(one: Entry, two: Entry, metric: str) -> Difference:
    """Difference of two entries of the same track in a metric, paired by scene."""
    return statistics.difference(one.scores(metric), two.scores(metric), resamples(1, one.n_scenes))


def best_first(entries: Iterable[Entry]) -> list[Entry]:
    """Sort entries by mean rank if there is one, then by MSC-FG, then by name."""

    def order(entry: Entry) -> tuple[float, float, tuple[str, str, str]]:
        rank, score = np.nan_to_num([entry.mean_rank, -entry.best_known("msc_fg")], nan=np.inf)
        return float(rank), float(score), entry.place

    return sorted(entries, key=order)


def in_order_of_rank(blocks: Mapping[str, Sequence[Entry]]) -> list[str]:
    """Sort blocks of entries by their best rank; unranked blocks come last."""

    def best_rank(block: str) -> float:
        return min((entry.rank for entry in blocks[block] if entry.rank is not None), default=np.inf)

    return sorted(blocks, key=best_rank)


def best_without_training(field: Iterable[Entry]) -> Entry | None:
    """Find the best ranked model without training, the baseline for models that learn."""
    classical = [entry for entry in field if entry.is_ranked and entry.row.kind == "classical"]
    return best_first(classical)[0] if classical else None


def fields(entries: Iterable[Entry]) -> list[list[Entry]]:
    """Group comparable entries: scored on one dataset, and all fitted on it or all on one other track."""

    def field(entry: Entry) -> tuple[str, str, str]:
        key = entry.row.key
        return key.track, key.track_spec, "" if key.fit_track == key.track else key.fit_track

    return [list(members) for _, members in groupby(sorted(entries, key=field), key=field)]


@cache
def resamples(n_seeds: int, n_scenes: int) -> Resamples:
    """Bootstrap resamples, shared by all models and metrics, so that all intervals rest on equal draws of scenes."""
    return statistics.draw(n_seeds, n_scenes, np.random.default_rng(BOOTSTRAP_SEED))


def _group(row: RunRow) -> tuple[str | int, ...]:
    """Key shared by the seeds of one entry. Label maps made elsewhere ignore `config_hash`, which differs by seed."""
    key = row.key
    settings = "" if row.kind == "predictions" else key.config_hash
    return key.track, key.fit_track, key.model, key.track_spec, key.fit_spec, key.version, settings


def _entry(pairs: Sequence[tuple[RunRow, SceneTable | None]]) -> Entry:
    rows, tables = zip(*pairs, strict=True)
    return Entry(rows, ("",) * len(rows), tables)


def _pooled(table: SceneTable | None, metric: str) -> float:
    if table is None or metric not in table:
        return np.nan
    return float(statistics.pooled_means(table[metric][None], _weights(table, metric)[None])[0])


def _weights(table: SceneTable, metric: str) -> Float64[np.ndarray, "scene"]:
    """Number of values behind each scene's mean; identity switches count once per scene, and not in stills."""
    return (table["ari_video_n"] > 0).astype(np.float64) if metric == SWITCHES else table[f"{metric}_n"]


def _best_floors(entries: Iterable[Entry]) -> dict[str, float]:
    """Largest MSC-FG of a floor on each dataset."""
    best: dict[str, float] = {}
    for entry in entries:
        if entry.row.kind == "floor":
            dataset, score = entry.row.key.track_spec, entry.best_known("msc_fg")
            best[dataset] = float(np.fmax(best.get(dataset, np.nan), score))
    return best


def _defined(entries: Iterable[Entry]) -> set[tuple[str, str]]:
    """Datasets and the headline metrics that some run defines on them."""
    return {
        (entry.row.key.track_spec, name)
        for entry in entries
        for name in HEADLINE
        if not np.isnan(entry.seed_means(name)).all()
    }


def _judged(entry: Entry, best_floor: float, defined: Collection[tuple[str, str]]) -> Entry:
    expected = [name for name in HEADLINE if (entry.row.key.track_spec, name) in defined]
    means = {name: entry.seed_means(name) for name in HEADLINE}
    causes = tuple(
        _cause(row, {name: float(values[seed]) for name, values in means.items()}, best_floor, expected)
        for seed, row in enumerate(entry.rows)
    )
    return replace(entry, best_floor=best_floor, causes=causes)


def _cause(row: RunRow, scores: Mapping[str, float], best_floor: float, expected: Iterable[str]) -> str:
    if row.status == "failed":
        return row.reason or "no result"
    if row.kind in ("floor", "oracle"):
        return ""
    finite = has_finite_loss(row) and not any(np.isnan(scores[name]) for name in expected)
    return cause_of_failure(scores["miou_bg"], scores["msc_fg"], best_floor, finite=finite)


def _ranked(field: Sequence[Entry]) -> list[Entry]:
    """Rank the entries of a field: adds ranks and groups to those that may be ranked."""
    ranked = [entry for entry in field if entry.is_ranked]
    values = {name: np.array([entry.best_known(name) for entry in ranked]) for name in RANKED_METRICS}
    mean_ranks = statistics.mean_ranks(*(values[name] for name in RANKED_METRICS))
    letters = zip(*(_letters(ranked, name, values[name]) for name in RANKED_METRICS), strict=True)
    places = statistics.ranks(-mean_ranks)
    placed = [
        replace(entry, mean_rank=float(mean_rank), rank=float(place), groups=groups)
        for entry, mean_rank, place, groups in zip(ranked, mean_ranks, places, letters, strict=True)
    ]
    return placed + [entry for entry in field if not entry.is_ranked]


def _letters(entries: Sequence[Entry], metric: str, values: Float64[np.ndarray, "model"]) -> list[str]:
    order = np.argsort(-np.nan_to_num(values, nan=-np.inf), kind="stable")
    groups = statistics.tied_groups(_different([entries[i] for i in order], metric))
    found = [""] * len(entries)
    for letter, group in enumerate(groups):
        for member in group:
            found[order[member]] += _letter(letter)
    return found


def _letter(index: int) -> str:
    return chr(ord("a") + index % 26) + "'" * (index // 26)


def _different(entries: Sequence[Entry], metric: str) -> Bool[np.ndarray, "model model"]:
    """Matrix of the pairs that differ significantly, corrected for the number of pairs."""
    pairs = list(combinations(range(len(entries)), 2))
    p_values = np.array([compare_entries(entries[i], entries[j], metric).p_value for i, j in pairs])
    different = np.zeros((len(entries), len(entries)), bool)
    for (i, j), p_value in zip(pairs, statistics.holm(p_values), strict=True):
        different[i, j] = different[j, i] = p_value < statistics.SIGNIFICANCE
    return different
