"""Segment a split and store the label maps, then score them into scene tables."""

import time
from collections.abc import Callable, Collection, Mapping
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmark.clips import ClipSequence, read_truth
from benchmark.metrics import clip_scores
from benchmark.metrics.poses import pose_scores
from benchmark.models.interface import Clip, Poses, Prediction
from benchmark.results.labels import LARGEST, check_labels_fit, read_labels, write_labels
from benchmark.results.pose_files import read_poses
from benchmark.results.pose_rules import ARRAYS, pose_fault
from benchmark.results.run_folder import save_scenes, scene_line
from benchmark.tasks.true_poses import read_true_poses
from datagen.errors import DatagenError
from datagen.storage.reader import Split

Predict = Callable[[int, Clip], Prediction]
"""Function that segments a scene, given its number and its clip."""


class BadPrediction(DatagenError):
    """A model broke the contract of `benchmark.models.interface`."""


def segment_split(
    predict: Predict, clips: ClipSequence, path: Path, data: Path, extra: Mapping[str, Path] | None = None
) -> float:
    """Segment every clip of the dataset `data` and store the label maps; returns the seconds that `predict` took.

    Args:
        predict: Segments a clip.
        clips: Clips of the split.
        path: File for the label maps.
        data: Folder of the dataset.
        extra: Files for the segmentations in `Prediction.extra`, by name.

    Raises:
        BadPrediction: `predict` did not return a label for every pixel.
    """
    seconds, extra = 0.0, extra or {}
    with ExitStack() as stack:
        writer = stack.enter_context(write_labels(path, len(clips), data))
        others = {name: stack.enter_context(write_labels(place, len(clips), data)) for name, place in extra.items()}
        for index, clip in enumerate(clips):
            started = time.perf_counter()
            prediction = predict(index, clip)
            seconds += time.perf_counter() - started
            check_prediction(prediction, clip, f"scene {index}", extra)
            writer.put(index, prediction)
            for name, other in others.items():
                other.put(index, Prediction(prediction.extra[name], prediction.background_slot))
    return seconds


def score_labels(path: Path, scenes: Split, out: Path, name: str) -> int:
    """Score stored label maps, and poses if the file has some, and write the scene table.

    Returns the number of frames; each view counts as a frame. Pixels without depth are ignored, as geometry gives no
    information about them.

    Raises:
        CorruptFile: the label maps do not fit the scenes.
    """
    check_labels_fit(path, scenes)
    lines = []
    poses = read_poses(path)
    for index, (clip, (labels, slot)) in enumerate(zip(ClipSequence(scenes), read_labels(path), strict=True)):
        truth = read_truth(scenes, index)
        scores = clip_scores(truth, labels, slot, ~clip.valid)
        if poses is not None:
            true = read_true_poses(scenes, index, clip, truth)
            scores |= pose_scores(true, poses[index], truth, labels, slot, ~clip.valid)
        lines.append(scene_line(index, scores))
    save_scenes(out, name, lines)
    return int(sum(line["n_frames"] for line in lines))


def check_prediction(prediction: Prediction, clip: Clip, where: str, extra: Collection[str] = ()) -> None:
    """Check that a model gave a label for every pixel, also in each of the `extra` segmentations.

    Raises:
        BadPrediction: the prediction is invalid; the message describes it.
    """
    if not isinstance(prediction, Prediction):
        raise BadPrediction(f"In {where} the model gave a {type(prediction).__name__}; expected a Prediction.")
    if missing := sorted(set(extra) - set(prediction.extra)):
        raise BadPrediction(f"In {where} the model gave no {missing[0]!r} in `extra`, which it declares.")
    for labels in (prediction.labels, *(prediction.extra[name] for name in extra)):
        _check_labels(np.asarray(labels), prediction.background_slot, clip, where)
    if prediction.poses is not None:
        _check_poses(prediction.poses, clip, where)


def _check_labels(labels: np.ndarray, slot: int | None, clip: Clip, where: str) -> None:
    if labels.shape != clip.depth.shape or not np.issubdtype(labels.dtype, np.integer):
        nan = " with nan" if labels.dtype.kind == "f" and np.isnan(labels).any() else ""
        expected = f"integers of shape {clip.depth.shape}"
        raise BadPrediction(
            f"In {where} the model gave labels {labels.dtype} {labels.shape}{nan}; expected {expected}."
        )
    for value in (labels.min(), labels.max(), 0 if slot is None else slot):
        if not 0 <= value <= LARGEST:
            raise BadPrediction(f"In {where} the model gave label or background slot {value}; expected 0 to {LARGEST}.")


def _check_poses(poses: Poses, clip: Clip, where: str) -> None:
    frames, views = clip.depth.shape[:2]
    arrays = {name: None if (array := getattr(poses, name)) is None else np.asarray(array) for name in ARRAYS}
    if fault := pose_fault(arrays, (frames, views)):
        raise BadPrediction(f"In {where} the model gave {fault}.")
