"""Analysis of one track beyond its scores, from the label maps and the dataset."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float64, UInt8

from benchmark.report.gallery import Card, disagreements, telling_image, typical_scenes, worst_scenes
from benchmark.report.observations import Objects, Outcome, Truth, outcome_of_scene, read_truth, scene_tables
from benchmark.results.labels import check_labels_fit, labels_path, read_labels
from benchmark.results.run_folder import RunRow, load_scenes
from datagen.errors import UsageError
from datagen.storage.reader import Split

Maps = tuple[UInt8[np.ndarray, "frame view height width"], int]
"""Label maps of a scene and the background slot."""


@dataclass(frozen=True, eq=False)
class Analysis:
    """Object-by-object analysis of one track and one fitting track. Models are numbered as in the report."""

    scenes: Split
    objects: Objects
    rows: dict[int, RunRow]
    """Run of each model that pictures show: its first seed that has label maps."""
    scores: dict[int, Float64[np.ndarray, "scene"]]
    """MSC-FG of the runs in `rows` by scene; nan in scenes without objects."""
    outcomes: dict[int, Outcome]
    """Per-object outcomes of the runs in `rows`."""
    means: dict[int, Outcome]
    """Per-object outcomes of each model, averaged over all its seeds."""


def analyse(folder: Path, scenes: Split, objects: Objects, seeds: Mapping[int, Sequence[RunRow]]) -> Analysis:
    """Analyse all label maps of every model; `seeds` holds each model's finished runs.

    Raises:
        UsageError: no run has label maps, or no scene shows an object.
        CorruptFile: label maps are damaged, or of other scenes.
    """
    with_maps = {model: [row for row in rows if labels_path(folder, row).exists()] for model, rows in seeds.items()}
    kept = {model: rows if rows[0].random else rows[:1] for model, rows in with_maps.items() if rows}
    if not kept:
        raise UsageError("The run folder holds no label maps of this track.")
    if not len(objects.scene):
        raise UsageError("No scene shows an object.")
    for row in (row for rows in kept.values() for row in rows):
        check_labels_fit(labels_path(folder, row), scenes)
    truths = [read_truth(scenes, index) for index in range(len(scenes))]
    found = {
        model: [outcome(truths, read_labels(labels_path(folder, r))) for r in rows] for model, rows in kept.items()
    }
    first = {model: rows[0] for model, rows in kept.items()}
    return Analysis(
        scenes,
        objects,
        first,
        {model: scene_scores(folder, row) for model, row in first.items()},
        {model: outcomes[0] for model, outcomes in found.items()},
        {model: _mean(outcomes) for model, outcomes in found.items()},
    )


def scene_scores(folder: Path, row: RunRow) -> Float64[np.ndarray, "scene"]:
    """MSC-FG of every scene; nan in scenes without objects."""
    table = load_scenes(folder, row)
    return np.where(table["msc_fg_n"] > 0, table["msc_fg"], np.nan)


def outcome(truths: Sequence[Truth], predictions: Iterable[Maps]) -> Outcome:
    """Outcome of one run for all objects of a split."""
    parts = [
        outcome_of_scene(scene_tables(*truth, labels, slot), slot)
        for truth, (labels, slot) in zip(truths, predictions, strict=True)
    ]
    return Outcome(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]).astype(np.float64))


def choose_cards(
    analysis: Analysis, *, worst: int, pairs: int, paired: Iterable[int]
) -> tuple[dict[int, list[Card]], dict[tuple[int, int], list[Card]]]:
    """Choose the worst scenes of every model, and the largest disagreements between any two `paired` models."""
    objects, outcomes = analysis.objects, analysis.outcomes
    bad = {
        model: [
            Card(telling_image(objects, scene, -outcomes[model].overlap), (model,))
            for scene in worst_scenes(scores, worst)
        ]
        for model, scores in analysis.scores.items()
    }
    apart = {
        (a, b): [
            Card(_most_apart(objects, scene, outcomes[a].overlap - outcomes[b].overlap), (a, b))
            for scene in disagreements(analysis.scores[a], analysis.scores[b], pairs)
        ]
        for a, b in combinations(sorted(set(paired) & set(outcomes)), 2)
    }
    return bad, apart


def choose_clips(analysis: Analysis, count: int) -> list[int]:
    """Choose the scenes whose clips are shown for all models."""
    return typical_scenes(list(analysis.scores.values()), count)


def read_maps(folder: Path, row: RunRow, wanted: set[int]) -> dict[int, Maps]:
    """Read the label maps of the wanted scenes of a run."""
    found: dict[int, Maps] = {}
    for scene, maps in enumerate(read_labels(labels_path(folder, row))):
        if scene in wanted:
            found[scene] = maps
        if len(found) == len(wanted):
            break
    return found


def _most_apart(objects: Objects, scene: int, difference: np.ndarray) -> tuple[int, int, int]:
    """The image whose mean difference is largest in the direction in which the whole scene differs."""
    inside = difference[objects.scene == scene]
    return telling_image(objects, scene, difference if inside.sum() >= 0 else -difference)


def _mean(outcomes: Sequence[Outcome]) -> Outcome:
    return Outcome(
        np.mean([outcome.overlap for outcome in outcomes], axis=0),
        np.mean([outcome.errors for outcome in outcomes], axis=0),
    )
