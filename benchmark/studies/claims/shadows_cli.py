"""How much of a model's error lies in shadows, which the paper blames for a low ARI over all pixels.

python -m benchmark.studies.claims.shadows_cli RUN/labels/FILE.h5 --without DIR

DIR holds the same scenes rendered without shadows; a pixel of the background lies in a shadow where it is darker in the
dataset that the labels are of. `obpose-datagen --recipe R --lighting.no-shadows ...` makes such a dataset.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from jaxtyping import Bool, Integer, UInt8

from benchmark.clips import ClipSequence
from benchmark.metrics import score
from benchmark.results.labels import check_labels, dataset_of, read_labels
from benchmark.studies.claims.command import run_command
from datagen.errors import EXIT_OK, UsageError
from datagen.storage.reader import Dataset

PROGRAM = "python -m benchmark.studies.claims.shadows_cli"
SPLIT = "test"
DARKER = 3
"""Least difference of the summed channels, of 765, that is a shadow: rounding alone makes 3 at most, each way."""


@dataclass(frozen=True)
class Arguments:
    """Options of the command."""

    labels: Annotated[Path, tyro.conf.Positional]
    """Label maps of a test split, as a run of obpose-bench leaves them."""
    without: Path
    """The same scenes without shadows."""
    data: Path | None = None
    """The dataset that the labels are of, if it has moved since."""


@dataclass(frozen=True)
class Shadows:
    """Pixels of one scene by kind, and its scores."""

    background: int
    shadow: int
    """Of the background."""
    leaked: int
    """Of the background, given to an object."""
    leaked_in_shadow: int
    missed: int
    """Of objects, given to the background."""
    ari: float
    ari_without_shadows: float
    """The same where pixels in shadows do not count."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; give the exit code."""
    return run_command(run, Arguments, arguments, program=PROGRAM, about=__doc__)


def run(values: Arguments) -> int:
    """Over all scenes of the labels."""
    check_labels(values.labels)
    scenes = list(read_scenes(values.labels, values.data or dataset_of(values.labels), values.without))
    counts = {field.name: sum(getattr(scene, field.name) for scene in scenes) for field in fields(Shadows)}
    leaked, missed, in_shadow = counts["leaked"], counts["missed"], counts["leaked_in_shadow"]
    aris = np.nanmean([(scene.ari, scene.ari_without_shadows) for scene in scenes], axis=0)
    print(f"{len(scenes)} scenes; {_share(counts['shadow'], counts['background'])} of the background lies in shadows.")
    print(f"Wrong between background and objects: {leaked + missed} pixels, {missed} missed and {leaked} leaked.")
    wrong_there, leaked_there = _share(in_shadow, leaked + missed), _share(in_shadow, leaked)
    print(f"In shadows: {wrong_there} of the wrong pixels, {leaked_there} of the leaked.")
    print(f"ARI {aris[0]:.3f}; {aris[1]:.3f} where pixels in shadows do not count.")
    return EXIT_OK


def read_scenes(labels: Path, data: Path, without: Path) -> Iterator[Shadows]:
    """What is wrong in each scene.

    Raises:
        UsageError: the two datasets are not of the same scenes.
    """
    shaded, plain = Dataset(data).split(SPLIT), Dataset(without).split(SPLIT)
    clips = ClipSequence(shaded)
    names = ("rgb", "segmentation")
    for index, (found, background_slot) in enumerate(read_labels(labels)):
        if index >= len(plain):
            raise UsageError(f"{without} has {len(plain)} scenes in its split {SPLIT}, expected {len(shaded)}.")
        one, other = shaded.read(index, names), plain.read(index, names)
        if not np.array_equal(one["segmentation"], other["segmentation"]):
            raise UsageError(
                f"Scene {index} of {without} is another than in {data}; expected the same but for shadows."
            )
        shadow = in_shadow(one["rgb"], other["rgb"])
        yield compare(one["segmentation"], found, background_slot, shadow, unseen=~clips[index].valid)


def in_shadow(
    rgb: UInt8[np.ndarray, "*pixels 3"], without: UInt8[np.ndarray, "*pixels 3"]
) -> Bool[np.ndarray, "*pixels"]:
    """Where the image is darker than without shadows."""
    return without.astype(int).sum(axis=-1) - rgb.astype(int).sum(axis=-1) > DARKER


def compare(
    truth: Integer[np.ndarray, "frame view height width"],
    labels: Integer[np.ndarray, "frame view height width"],
    background_slot: int,
    shadow: Bool[np.ndarray, "frame view height width"],
    unseen: Bool[np.ndarray, "frame view height width"],
) -> Shadows:
    """Counts and scores of one scene; only the background's shadows count, and pixels in `unseen` never do."""
    background, given = (truth == 0) & ~unseen, labels == background_slot
    shadow = shadow & background
    images = (array.reshape(-1, *array.shape[2:]) for array in (truth, labels, unseen, unseen | shadow))
    true, found, ignored, ignored_or_dark = images
    return Shadows(
        background=int(background.sum()),
        shadow=int(shadow.sum()),
        leaked=int((background & ~given).sum()),
        leaked_in_shadow=int((shadow & ~given).sum()),
        missed=int(((truth > 0) & ~unseen & given).sum()),
        ari=score(true, found, background_slot, ignore=ignored)["ari"],
        ari_without_shadows=score(true, found, background_slot, ignore=ignored_or_dark)["ari"],
    )


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.1%}" if whole else "none"


if __name__ == "__main__":
    raise SystemExit(main())
