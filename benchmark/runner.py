"""One model on one dataset: fit, segment the split, score every frame."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from benchmark.clips import ClipSequence, read_truth
from benchmark.interface import Clip, Prediction, Segmenter
from benchmark.metrics import FrameScores, frame_scores, summarise
from benchmark.registry import find_model
from datagen import storage
from datagen.errors import DatagenError, UsageError

DEFAULT_BUDGET = 600.0
"""Seconds that a model may train for."""


@dataclass(frozen=True)
class Result:
    """How one model with one seed did on one split."""

    model: str
    version: int
    """Of the model."""
    dataset: str
    """Name of the recipe."""
    spec_hash: str
    """Identity of the dataset."""
    split: str
    seed: int
    scenes: int
    scores: dict[str, float]
    """As `benchmark.metrics.summarise` gives them, all frames of the split pooled."""
    seconds_per_frame: float
    """Wall time of `segment`, reading and scoring left out."""


class BadPrediction(DatagenError):
    """A model broke the contract of `benchmark.interface`."""


def run(
    model: str,
    data: str | Path,
    *,
    seed: int,
    split: str = "test",
    budget: float = DEFAULT_BUDGET,
    progress: Callable[[int], None] = lambda scenes: None,
) -> Result:
    """Fit a registered model on a dataset's train and val splits and score it on `split`.

    Raises:
        UsageError: the model, the dataset or the split does not exist, or the split is empty.
        BadPrediction: the model returned something else than labels for every pixel.
        CorruptFile: the dataset is damaged.
    """
    spec, dataset = find_model(model), storage.Dataset(data)
    scenes = dataset.split(split)
    if len(scenes) == 0:
        raise UsageError(f"Split {split!r} of {data} has no scenes; generate some, or choose another split.")
    segmenter = spec.build()
    train, val = (ClipSequence(dataset.split(name)) for name in ("train", "val"))
    segmenter.fit(train, val, seed=seed, budget=budget)
    frames, seconds = [], 0.0
    for done, (scores, elapsed) in enumerate(score_scenes(segmenter, scenes), start=1):
        frames.append(scores)
        seconds += elapsed
        progress(done)
    pooled = {name: np.concatenate([scores[name] for scores in frames]) for name in frames[0]}
    scores = summarise(pooled)
    return Result(
        model=model,
        version=spec.version,
        dataset=dataset.spec["recipe"]["name"],
        spec_hash=dataset.spec["spec_hash"],
        split=split,
        seed=seed,
        scenes=len(scenes),
        scores=scores,
        seconds_per_frame=seconds / scores["n_frames"],
    )


def score_scenes(segmenter: Segmenter, scenes: storage.Split) -> Iterator[tuple[FrameScores, float]]:
    """For each scene the scores of its frames (views count as frames) and the seconds that `segment` took.

    Pixels without depth are left out: nothing can be known of them from geometry.
    """
    for index, clip in enumerate(ClipSequence(scenes)):
        start = time.perf_counter()
        prediction = segmenter.segment(clip)
        elapsed = time.perf_counter() - start
        check_prediction(prediction, clip, f"scene {index}")
        truth = read_truth(scenes, index)
        labels, ignore = as_frames(prediction.labels), as_frames(~clip.valid)
        yield frame_scores(as_frames(truth), labels, background_slot(prediction), ignore), elapsed


def check_prediction(prediction: Prediction, clip: Clip, where: str) -> None:
    """Check that a model gave a label for every pixel.

    Raises:
        BadPrediction: says what it gave instead.
    """
    labels, slot = np.asarray(prediction.labels), prediction.background_slot
    if labels.shape != clip.depth.shape or not np.issubdtype(labels.dtype, np.integer):
        expected = f"integers of shape {clip.depth.shape}"
        raise BadPrediction(f"In {where} the model gave labels {labels.dtype} {labels.shape}; expected {expected}.")
    if labels.min() < 0 or (slot is not None and slot < 0):
        raise BadPrediction(
            f"In {where} the model gave label {labels.min()} and background slot {slot}; both start at 0."
        )


def background_slot(prediction: Prediction) -> int:
    """The slot that the model declares as background; where it declares none, the one with most pixels in the clip."""
    if prediction.background_slot is not None:
        return prediction.background_slot
    names, counts = np.unique(prediction.labels, return_counts=True)
    return int(names[np.argmax(counts)])


def as_frames(maps: Shaped[np.ndarray, "frame view height width"]) -> Shaped[np.ndarray, "frame*view height width"]:
    """Views as frames of their own."""
    return maps.reshape(-1, *maps.shape[2:])
