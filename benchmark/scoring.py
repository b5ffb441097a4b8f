"""From a model's answers to the scene table: segment and store, then score what is stored."""

import time
from collections.abc import Callable, Collection, Mapping
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmark.clips import ClipSequence, read_truth
from benchmark.interface import Clip, Poses, Prediction
from benchmark.labels import LARGEST, read_labels, write_labels
from benchmark.metrics import clip_scores
from benchmark.metrics.poses import pose_scores
from benchmark.pose_files import read_poses
from benchmark.results import save_scenes, scene_line
from benchmark.true_poses import read_true_poses
from datagen.errors import CorruptFile, DatagenError
from datagen.storage import Split

UNIT_TOLERANCE = 1e-3
"""By which the columns of a rotation may miss being orthogonal and of unit length."""

Predict = Callable[[int, Clip], Prediction]
"""Gives the segmentation of a scene, by its number and its clip."""


class BadPrediction(DatagenError):
    """A model broke the contract of `benchmark.interface`."""


def segment_split(
    predict: Predict, clips: ClipSequence, path: Path, data: Path, extra: Mapping[str, Path] | None = None
) -> float:
    """Segment every clip of the dataset `data` and store the label maps; returns the seconds that `predict` took.

    Args:
        predict: Segments a clip.
        clips: Of the split.
        path: Where the label maps go.
        data: Folder of the dataset.
        extra: Where those in `Prediction.extra` go, by their names.

    Raises:
        BadPrediction: something else than a label for every pixel came back.
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
    """Score stored label maps, and poses where the file has some, and write the scene table.

    Returns the number of frames, views counted apart. Pixels without depth are left out: nothing can be known of them
    from geometry.

    Raises:
        CorruptFile: the label maps do not fit the scenes.
    """
    lines = []
    poses = read_poses(path)
    try:
        for index, (clip, (labels, slot)) in enumerate(zip(ClipSequence(scenes), read_labels(path), strict=True)):
            truth = read_truth(scenes, index)
            if labels.shape != truth.shape:
                raise ValueError(f"shape {labels.shape} where the dataset has {truth.shape}")
            scores = clip_scores(truth, labels, slot, ~clip.valid)
            if poses is not None:
                true = read_true_poses(scenes, index, clip, truth)
                scores |= pose_scores(true, poses[index], truth, labels, slot, ~clip.valid)
            lines.append(scene_line(index, scores))
    except ValueError as error:
        raise CorruptFile(f"{path} does not fit the dataset's scenes ({error}); run the model again.") from None
    save_scenes(out, name, lines)
    return int(sum(line["n_frames"] for line in lines))


def check_prediction(prediction: Prediction, clip: Clip, where: str, extra: Collection[str] = ()) -> None:
    """Check that a model gave a label for every pixel, and so in each of the `extra` segmentations.

    Raises:
        BadPrediction: says what it gave instead.
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
    labels = poses.center.shape[2] if poses.center.ndim == 4 else "labels"
    expected = {"center": (frames, views, labels, 3), "rotation": (frames, views, labels, 3, 3)}
    expected["size"] = expected["center"]
    there = np.isfinite(poses.center).all(axis=-1)
    for name, shape in expected.items():
        array = getattr(poses, name)
        if array is None:
            continue
        if array.shape != shape or array.dtype.kind != "f":
            found = f"{array.dtype} {array.shape}"
            raise BadPrediction(f"In {where} the model gave a {name} of poses {found}; expected floats of {shape}.")
        if not np.isfinite(array[there]).all():
            raise BadPrediction(f"In {where} a pose has a center and no {name}; expected both, or nan in both.")
    if poses.size is not None and (poses.rotation is None or np.any(poses.size[there] < 0)):
        raise BadPrediction(f"In {where} the model gave boxes without rotation, or of negative size.")
    if poses.rotation is not None and not _are_rotations(poses.rotation[there]):
        raise BadPrediction(f"In {where} a rotation is none: expected orthogonal columns of length 1, right-handed.")


def _are_rotations(matrices: np.ndarray) -> bool:
    squares = np.swapaxes(matrices, -1, -2) @ matrices
    return bool(np.all(np.abs(squares - np.eye(3)) < UNIT_TOLERANCE) and np.all(np.linalg.det(matrices) > 0))
