"""Analysis of one track beyond its scores, from the label maps and the dataset."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Float64, UInt8

from benchmark.report.observations import Objects, Outcome, Truth, outcome_of_scene, read_truth, scene_tables
from benchmark.results.labels import check_labels_fit, labels_path, read_labels, read_poses
from benchmark.results.run_folder import RunRow, load_scenes
from datagen.errors import UsageError
from datagen.storage.reader import Split


@dataclass(frozen=True, eq=False)
class Maps:
    """Output of one run for one scene."""

    labels: UInt8[np.ndarray, "frame view height width"]
    background_slot: int
    boxes: tuple[np.ndarray, np.ndarray, np.ndarray] | None
    """Centres, rotations and sizes of bounding boxes by frame, view and label; None if the model gives none."""


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
    # Runs with label maps; one run stands for all seeds of a model without randomness.
    with_maps = {model: [row for row in rows if labels_path(folder, row).exists()] for model, rows in seeds.items()}
    kept = {model: rows if rows[0].random else rows[:1] for model, rows in with_maps.items() if rows}
    if not kept:
        raise UsageError("The run folder holds no label maps of this track.")
    if not len(objects.scene):
        raise UsageError("No scene shows an object.")
    for row in (row for rows in kept.values() for row in rows):
        check_labels_fit(labels_path(folder, row), scenes)
    # Outcomes of every model, and their means over seeds.
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
        {
            model: Outcome(np.mean([o.overlap for o in seeds], axis=0), np.mean([o.errors for o in seeds], axis=0))
            for model, seeds in found.items()
        },
    )


def scene_scores(folder: Path, row: RunRow) -> Float64[np.ndarray, "scene"]:
    """Read the MSC-FG of every scene; nan in scenes without objects."""
    table = load_scenes(folder, row)
    return np.where(table["msc_fg_n"] > 0, table["msc_fg"], np.nan)


def outcome(
    truths: Sequence[Truth], predictions: Iterable[tuple[UInt8[np.ndarray, "frame view height width"], int]]
) -> Outcome:
    """Compute the outcome of one run for all objects of a split, from its label maps and background slots."""
    parts = [
        outcome_of_scene(scene_tables(*truth, labels, slot), slot)
        for truth, (labels, slot) in zip(truths, predictions, strict=True)
    ]
    return Outcome(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]).astype(np.float64))


def read_maps(folder: Path, row: RunRow, wanted: set[int]) -> dict[int, Maps]:
    """Read the label maps, and the boxes if there are any, of the wanted scenes of a run."""
    path, scenes = labels_path(folder, row), sorted(wanted)
    every = read_poses(path, scenes) or [None] * len(scenes)
    boxes = {
        scene: (poses.center, poses.rotation, poses.size)
        for scene, poses in zip(scenes, every, strict=True)
        if poses is not None and poses.rotation is not None and poses.size is not None
    }
    found = (item for item in enumerate(read_labels(path)) if item[0] in wanted)
    return {scene: Maps(labels, slot, boxes.get(scene)) for scene, (labels, slot) in islice(found, len(wanted))}
