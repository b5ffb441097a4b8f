"""Standings of models on each track: group a run folder's rows over seeds, detect failed seeds, and rank.

Two models are compared only if they were scored on the same dataset and fitted the same way: each on the track itself,
or all on one other track. Floors, oracles and models that use labels are shown and never ranked.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations, groupby
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from benchmark.metrics import CLIP_METRICS, METRICS, OTHER_METRICS
from benchmark.metrics.poses import POSE_METRICS
from benchmark.ranking import statistics
from benchmark.ranking.failed_seeds import cause_of_failure, has_finite_loss
from benchmark.ranking.statistics import Difference, Resamples, Summary
from benchmark.results.run_folder import RunRow, SceneTable, load_runs, load_scenes
from datagen.console.progress import Tracker, untracked
from datagen.console.text import counted
from datagen.errors import CorruptFile

ALL_METRICS = (*METRICS, *CLIP_METRICS, *OTHER_METRICS)
RANKED_METRICS = ("ari_fg", "msc_fg")
"""Models are ordered by the mean of their ranks in these."""
SWITCHES = "identity_switches"
"""Identity switches per scene, summarised like a metric; fewer are better."""

USES_LABELS, TUNED, PRETRAINED = "†", "‡", "§"
"""Marks of models that use labels, are tuned on the labels of the validation split, and have pretrained weights."""

BOOTSTRAP_SEED = 0

Scores = tuple[Float64[np.ndarray, "seed scene"], Float64[np.ndarray, "seed scene"]]
"""Scores of one metric: each scene's mean, and the number of values behind it."""


@dataclass(frozen=True, eq=False)
class ModelResult:
    """Results of one model on one track, over all seeds."""

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
    group_letters: tuple[str, ...] = ("",) * len(RANKED_METRICS)
    """Letters for each of `RANKED_METRICS`; models that share a letter do not differ significantly."""
    _summaries: dict[tuple[str, bool], Summary] = field(init=False, repr=False, default_factory=dict)
    """Cache of `summary`, which several tables show; each takes a bootstrap."""

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
        # Failed runs record no tuning.
        trials = max(row.trials for row in self.rows)
        tuned = f"{TUNED}{trials or ''}" if any(row.tuned for row in self.rows) else ""
        return f"{USES_LABELS * self.row.uses_labels}{tuned}{PRETRAINED * bool(self.row.pretrained)}"

    @property
    def views(self) -> str:
        """Views of a frame that the model is given and that supervise it; empty if it does not declare them."""
        return next((row.views for row in self.rows if row.views), "")

    @property
    def has_poses(self) -> bool:
        """Whether all runs that gave scores gave poses."""
        return POSE_METRICS[0] in self.further_metrics

    @property
    def further_metrics(self) -> list[str]:
        """Metrics that not all results have, but all runs of this one that gave scores: newer metrics, and poses."""
        tables = [table for table in self.tables if table is not None]
        return [name for name in (*OTHER_METRICS, *POSE_METRICS) if tables and all(name in table for table in tables)]

    @property
    def failures(self) -> list[tuple[RunRow, str]]:
        """Failed runs with their causes; seeds that make no difference count once."""
        runs = list(zip(self.rows, self.causes, strict=True))[: self.n_runs]
        return [(row, cause) for row, cause in runs if cause]

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
        """Mean, standard deviations and interval of a metric; computed once."""
        if (metric, without_failed) not in self._summaries:
            self._summaries[metric, without_failed] = self._summarise(metric, without_failed=without_failed)
        return self._summaries[metric, without_failed]

    def _summarise(self, metric: str, *, without_failed: bool) -> Summary:
        scores, weights = self.scores(metric, without_failed=without_failed)
        if not self.row.random:
            scores, weights = scores[:1], weights[:1]
        if scores.size == 0:
            return Summary(*[np.nan] * 5)
        summary = statistics.summarise(scores, weights, resamples(*scores.shape))
        return summary if self.row.random else replace(summary, sample_std=0.0 if len(self.rows) > 1 else np.nan)

    def seed_means(self, metric: str) -> Float64[np.ndarray, "seed"]:
        """Pooled means of a metric, one for each of `rows`; nan where there are no scores."""
        return np.array([pooled(table, metric) for table in self.tables])

    def score(self, metric: str, *, without_failed: bool = False) -> tuple[float, float]:
        """Mean and population standard deviation over the runs; the latter is nan where only one run has a score."""
        causes = self.causes[: self.n_runs]
        kept = [not (without_failed and cause) for cause in causes]
        mean, deviation, sample_deviation = statistics.spread(self.seed_means(metric)[: self.n_runs][kept])
        return mean, np.nan if np.isnan(sample_deviation) else deviation

    def mean(self, metric: str) -> float:
        """Mean of a metric over seeds, by which results are compared."""
        return statistics.spread(self.seed_means(metric))[0]


def load_standings(folder: Path, progress: Tracker = untracked) -> list[ModelResult]:
    """Load and rank all results of a run folder.

    Raises:
        CorruptFile: a row or its scene table is damaged.
    """
    return standings(*load_scores(folder, progress), progress)


def load_scores(folder: Path, progress: Tracker = untracked) -> tuple[list[RunRow], list[SceneTable | None]]:
    """Load the rows of a run folder and their scene tables."""
    rows = load_runs(folder)
    _check_scenes(folder, rows)
    watched = progress(rows, "reading scores")
    return rows, [load_scenes(folder, row) if row.status == "ok" else None for row in watched]


def _check_scenes(folder: Path, rows: Iterable[RunRow]) -> None:
    """Check that all finished rows of a dataset have equally many scenes, since models are paired by scene."""
    first: dict[str, RunRow] = {}
    for row in rows:
        other = first.setdefault(row.key.track_spec, row) if row.status == "ok" else row
        if row.n_scenes != other.n_scenes:
            raise CorruptFile(
                f"{folder} has {counted(row.n_scenes, 'scene')} in the row {row.key.name} and {other.n_scenes} in "
                f"{other.key.name}, of the same dataset; expected equally many. Delete the wrong row in runs/ and run "
                "it again."
            )


def standings(
    rows: Sequence[RunRow], tables: Sequence[SceneTable | None], progress: Tracker = untracked
) -> list[ModelResult]:
    """Build the results of rows and their scene tables, ordered by track, track fitted on and model, and rank them."""
    groups = comparable_groups(unranked(rows, tables))
    found = [result for group in progress(groups, "ranking models") for result in _ranked(group)]
    return sorted(found, key=lambda result: _seed_group(result.row))


def unranked(rows: Sequence[RunRow], tables: Sequence[SceneTable | None]) -> list[ModelResult]:
    """Group rows over seeds, and determine which seeds failed."""
    pairs = sorted(zip(rows, tables, strict=True), key=lambda pair: (_seed_group(pair[0]), pair[0].key.seed))
    groups = [list(members) for _, members in groupby(pairs, key=lambda pair: _seed_group(pair[0]))]
    results = [
        ModelResult(tuple(r for r, _ in group), ("",) * len(group), tuple(t for _, t in group)) for group in groups
    ]
    floors = _best_floors(results)
    return [_with_causes(result, floors.get(result.row.key.track_spec, np.nan)) for result in results]


def compare_results(one: ModelResult, two: ModelResult, metric: str) -> Difference:
    """Difference of two results of the same track in a metric, paired by scene."""
    return statistics.difference(one.scores(metric), two.scores(metric), resamples(1, one.n_scenes))


def best_first(results: Iterable[ModelResult]) -> list[ModelResult]:
    """Sort results by mean rank if there is one, then by MSC-FG, then by name."""

    def order(result: ModelResult) -> tuple[float, float, tuple[str, str, str]]:
        rank, score = np.nan_to_num([result.mean_rank, -result.mean("msc_fg")], nan=np.inf)
        return float(rank), float(score), result.place

    return sorted(results, key=order)


def comparable_groups(results: Iterable[ModelResult]) -> list[list[ModelResult]]:
    """Group comparable results: scored on one dataset, and all fitted on it or all on one other track."""

    def group(result: ModelResult) -> tuple[str, str, str]:
        key = result.row.key
        return key.track, key.track_spec, "" if key.fit_track == key.track else key.fit_track

    return [list(members) for _, members in groupby(sorted(results, key=group), key=group)]


@cache
def resamples(n_seeds: int, n_scenes: int) -> Resamples:
    """Bootstrap resamples, shared by all models and metrics, so that all intervals rest on equal draws of scenes."""
    return statistics.draw(n_seeds, n_scenes, np.random.default_rng(BOOTSTRAP_SEED))


def _seed_group(row: RunRow) -> tuple[str | int, ...]:
    """Key shared by the seeds of one model. Label maps made elsewhere ignore `config_hash`, which differs by seed."""
    key = row.key
    settings = "" if row.kind == "predictions" else key.config_hash
    return key.track, key.fit_track, key.model, key.track_spec, key.fit_spec, key.version, settings


def pooled(table: SceneTable | None, metric: str) -> float:
    """Mean of a metric over all frames of a split that define it, as in the paper; nan if none does."""
    if table is None or metric not in table:
        return np.nan
    return float(statistics.pooled_means(table[metric][None], _weights(table, metric)[None])[0])


def _weights(table: SceneTable, metric: str) -> Float64[np.ndarray, "scene"]:
    """Number of values behind each scene's mean; identity switches count once per scene, and not in stills."""
    return (table["ari_video_n"] > 0).astype(np.float64) if metric == SWITCHES else table[f"{metric}_n"]


def _best_floors(results: Iterable[ModelResult]) -> dict[str, float]:
    """Largest MSC-FG of a floor on each dataset."""
    best: dict[str, float] = {}
    for result in results:
        if result.row.kind == "floor":
            dataset, score = result.row.key.track_spec, result.mean("msc_fg")
            best[dataset] = float(np.fmax(best.get(dataset, np.nan), score))
    return best


def _with_causes(result: ModelResult, best_floor: float) -> ModelResult:
    """Add the cause of each failed seed."""
    miou_bg, msc_fg = result.seed_means("miou_bg"), result.seed_means("msc_fg")

    def cause(seed: int, row: RunRow) -> str:
        if row.status == "failed":
            return row.reason or "no result"
        if row.kind in ("floor", "oracle"):
            return ""
        return cause_of_failure(float(miou_bg[seed]), float(msc_fg[seed]), best_floor, finite=has_finite_loss(row))

    return replace(result, best_floor=best_floor, causes=tuple(cause(*pair) for pair in enumerate(result.rows)))


def _ranked(group: Sequence[ModelResult]) -> list[ModelResult]:
    """Add ranks and group letters to the results of a comparable group that may be ranked."""
    ranked = [result for result in group if result.is_ranked]
    values = {name: np.array([result.mean(name) for result in ranked]) for name in RANKED_METRICS}
    mean_ranks = statistics.mean_ranks(*(values[name] for name in RANKED_METRICS))
    letters = zip(*(letters_of_groups(_different(ranked, name), values[name]) for name in RANKED_METRICS), strict=True)
    places = statistics.ranks(-mean_ranks)
    placed = [
        replace(result, mean_rank=float(mean_rank), rank=float(place), group_letters=found)
        for result, mean_rank, place, found in zip(ranked, mean_ranks, places, letters, strict=True)
    ]
    return placed + [result for result in group if not result.is_ranked]


def letters_of_groups(different: Bool[np.ndarray, "model model"], values: Float64[np.ndarray, "model"]) -> list[str]:
    """Letters of each model's groups; models that share a letter do not differ, and `a` is the group of the best."""
    order = np.argsort(-np.nan_to_num(values, nan=-np.inf), kind="stable")
    found = [""] * len(values)
    for index, group in enumerate(statistics.tied_groups(different[np.ix_(order, order)])):
        letter = chr(ord("a") + index % 26) + "'" * (index // 26)
        for member in group:
            found[order[member]] += letter
    return found


def _different(results: Sequence[ModelResult], metric: str) -> Bool[np.ndarray, "model model"]:
    """Matrix of the pairs that differ significantly, corrected for the number of pairs."""
    pairs = list(combinations(range(len(results)), 2))
    p_values = np.array([compare_results(results[i], results[j], metric).p_value for i, j in pairs])
    different = np.zeros((len(results), len(results)), bool)
    for (i, j), p_value in zip(pairs, statistics.holm(p_values), strict=True):
        different[i, j] = different[j, i] = p_value < statistics.SIGNIFICANCE
    return different
