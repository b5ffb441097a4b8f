"""Do shadows explain a low ARI, as the paper says of its own on CLEVR-3D?

Scores label maps with shadows counted as background, as part of the object that casts them, and not at all. Also counts
the errors between objects and background, and those in shadows.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Integer, UInt8

from benchmark.clips import ClipSequence
from benchmark.metrics import clip_scores
from benchmark.metrics.score import summarise
from benchmark.ranking.leaderboard import Cell, Line
from benchmark.ranking.statistics import Summary, draw
from benchmark.ranking.statistics import summarise as summarise_seeds
from benchmark.results.labels import check_labels, dataset_of, read_labels
from benchmark.studies.inputs import LabelFlags
from datagen.errors import UsageError
from datagen.schema import effect_mask
from datagen.storage.reader import Dataset

SPLIT = "test"
METRICS = ("ari", "ari_fg")
DARKER = 3
"""Difference of the summed channels, of 765, above which a pixel is in shadow; rounding alone causes up to 3."""


@dataclass(frozen=True, kw_only=True)
class Flags(LabelFlags):
    """Options of the study."""

    effects: Path | None = None
    """Dataset of the same scenes with effect masks, as `obpose-datagen render --from DATA --edits remove` makes it.

    Default: the dataset that was segmented."""
    without: Path | None = None
    """Dataset of the same scenes made with `--lighting.no-shadows`, to be used instead of effect masks."""


Scores = Mapping[str, Mapping[str, float]]
"""Scores by whose pixels shadows are."""


def run(flags: Flags) -> Iterator[Line]:
    """Score each file in each way of counting shadows, with 95 % bootstrap intervals over scenes; count errors."""
    check_labels(*flags.labels)
    if flags.effects is not None and flags.without is not None:
        raise UsageError("--effects and --without: expected one of the two.")
    for path in flags.labels:
        data = flags.data or dataset_of(path)
        source, by_brightness = flags.without or flags.effects or data, flags.without is not None
        counts, scores = zip(*measure_scenes(path, data, source, by_brightness=by_brightness), strict=True)
        pixels = {name: sum(each[name] for each in counts) for name in counts[0]}
        for way in scores[0]:
            line: dict[str, Cell] = {"labels": path.stem, "shadows are the": way, "scenes": len(scores)}
            for name in METRICS:
                found = summarise_scenes([scene[way][name] for scene in scores])
                line |= {name: found.mean, f"{name} low": found.low, f"{name} high": found.high}
            yield line | pixels


def measure_scenes(
    labels: Path, data: Path, shadows: Path, *, by_brightness: bool
) -> Iterator[tuple[dict[str, int], Scores]]:
    """Count the errors of each scene and score it; `shadows` has no shadows, or else effect masks."""
    scenes, others = Dataset(data).split(SPLIT), Dataset(shadows).split(SPLIT)
    clips = ClipSequence(scenes)
    for index, (found, background_slot) in enumerate(read_labels(labels)):
        if index >= len(others):
            raise UsageError(f"{shadows} has {len(others)} scenes in its split {SPLIT}, expected {len(scenes)}.")
        record = scenes.read(index, ["rgb", "segmentation"])
        fields = ["rgb"] if by_brightness else ["edits/remove/effects", "objects/count"]
        other = others.read(index, ["segmentation", *fields])
        truth, unseen = record["segmentation"], ~clips[index].valid
        if not np.array_equal(truth, other["segmentation"]):
            raise UsageError(f"Scene {index} of {shadows} differs from that of {data}; expected the same scenes.")
        if by_brightness:
            shadow, owners = in_shadow(record["rgb"], other["rgb"]) & (truth == 0), None
        else:
            owners = shadow_owners(truth, other["edits/remove/effects"], int(other["objects/count"]))
            shadow = owners > 0
        counts = count_pixels(truth, found, background_slot, shadow, unseen)
        yield counts, score_ways(truth, found, background_slot, shadow, owners, unseen)


def in_shadow(
    rgb: UInt8[np.ndarray, "*pixels 3"], without: UInt8[np.ndarray, "*pixels 3"]
) -> Bool[np.ndarray, "*pixels"]:
    """Whether an image is darker than the same image without shadows."""
    return without.astype(int).sum(axis=-1) - rgb.astype(int).sum(axis=-1) > DARKER


def shadow_owners(
    truth: UInt8[np.ndarray, "*image"], effects: UInt8[np.ndarray, "*image byte"], count: int
) -> UInt8[np.ndarray, "*image"]:
    """Id of the object whose shadow lies on each pixel of the background, 0 for none; the first of several objects."""
    owners = np.zeros_like(truth)
    for name in range(count, 0, -1):
        owners[effect_mask(effects, name) & (truth == 0)] = name
    return owners


def count_pixels(
    truth: Integer[np.ndarray, "*image"],
    labels: Integer[np.ndarray, "*image"],
    background_slot: int,
    shadow: Bool[np.ndarray, "*image"],
    unseen: Bool[np.ndarray, "*image"],
) -> dict[str, int]:
    """Count the pixels of one scene, except those in `unseen`.

    Pixels of objects labelled as background are missed; those of the background labelled as an object are leaked.
    """
    background, given = (truth == 0) & ~unseen, labels == background_slot
    masks = {
        "background": background,
        "in shadow": background & shadow,
        "missed": (truth > 0) & ~unseen & given,
        "leaked": background & ~given,
        "leaked in shadow": background & shadow & ~given,
    }
    return {name: int(mask.sum()) for name, mask in masks.items()}


def score_ways(
    truth: UInt8[np.ndarray, "frame view height width"],
    labels: Integer[np.ndarray, "frame view height width"],
    background_slot: int,
    shadow: Bool[np.ndarray, "frame view height width"],
    owners: UInt8[np.ndarray, "frame view height width"] | None,
    unseen: Bool[np.ndarray, "frame view height width"],
) -> Scores:
    """Score one scene in each way of counting shadows, means over frames and views."""
    ways = {"background's": (truth, unseen)}
    if owners is not None:
        ways["object's"] = (np.where(shadow, owners, truth), unseen)
    ways["nobody's"] = (truth, unseen | shadow)
    return {way: summarise(clip_scores(true, labels, background_slot, out)) for way, (true, out) in ways.items()}


def summarise_scenes(scores: Sequence[float]) -> Summary:
    """Mean over scenes with its bootstrap interval; undefined scores do not count."""
    values = np.array([scores])
    return summarise_seeds(values, (~np.isnan(values)).astype(float), draw(1, len(scores), np.random.default_rng(0)))
