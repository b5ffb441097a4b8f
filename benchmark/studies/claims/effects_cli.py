"""ARI and ARI-FG with shadows counted as background, as part of the object that casts them, and not at all.

python -m benchmark.studies.claims.effects_cli RUN/labels/FILE.h5 [FILE.h5 ...] --effects DIR

DIR holds the same scenes with `edits/remove/effects`, as `obpose-datagen render --from DATA --edits remove` makes them
of any dataset.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from jaxtyping import Integer, UInt8

from benchmark.clips import ClipSequence
from benchmark.metrics import clip_scores
from benchmark.ranking.leaderboard import Line, to_csv
from benchmark.ranking.statistics import Summary, draw, summarise
from benchmark.results.label_files import check_labels
from benchmark.results.labels import dataset_of, read_labels
from benchmark.studies.claims.command import check_csv, run_command
from datagen.errors import EXIT_OK, UsageError
from datagen.schema import effect_mask
from datagen.storage.atomic import write_atomically
from datagen.storage.reader import Dataset

PROGRAM = "python -m benchmark.studies.claims.effects_cli"
SPLIT = "test"
METRICS = {"ari": "ARI", "ari_fg": "ARI-FG"}
WAYS = {"background": "background's", "object": "object's", "ignored": "nobody's"}
"""Whose pixels shadows are."""


@dataclass(frozen=True)
class Arguments:
    """Options of the command."""

    labels: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Label maps of test splits, as runs of obpose-bench leave them."""
    effects: Path | None = None
    """The same scenes with effect masks; the dataset that the labels are of, if left out."""
    data: Path | None = None
    """The dataset that the labels are of, if it has moved since."""
    csv: Path | None = None
    """CSV to write what is printed to, with all digits."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; give the exit code."""
    return run_command(run, Arguments, arguments, program=PROGRAM, about=__doc__)


def run(values: Arguments) -> int:
    """A line for each file and each way of counting."""
    check_labels(*values.labels)
    check_csv(values.csv)
    print("| label maps | shadows are the | " + " | ".join(METRICS.values()) + " |")
    print("|---|---|" + "---|" * len(METRICS))
    counts: set[int] = set()
    lines: list[Line] = []
    for labels in values.labels:
        data = values.data or dataset_of(labels)
        scenes = list(read_scenes(labels, data, values.effects or data))
        counts.add(len(scenes))
        for way, words in WAYS.items():
            found = [_summary([scene[way][name] for scene in scenes]) for name in METRICS]
            cells = (f"{each.mean:.3f} ({each.low:.3f} to {each.high:.3f})" for each in found)
            print(f"| {labels.stem} | {words} | {' | '.join(cells)} |")
            line: Line = {"labels": labels.stem, "shadows are the": words, "scenes": len(scenes)}
            for name, each in zip(METRICS, found, strict=True):
                line |= {name: each.mean, f"{name} low": each.low, f"{name} high": each.high}
            lines.append(line)
    print(f"\nMeans over {' or '.join(map(str, sorted(counts)))} test scenes, with 95 % bootstrap intervals.")
    if values.csv is not None:
        write_atomically(values.csv, to_csv(lines).encode())
    return EXIT_OK


def read_scenes(labels: Path, data: Path, effects: Path) -> Iterator[Mapping[str, Mapping[str, float]]]:
    """Scores of each scene, by whose pixels shadows are.

    Raises:
        UsageError: the two datasets are not of the same scenes, or the second has no effects.
    """
    scenes, shadows = Dataset(data).split(SPLIT), Dataset(effects).split(SPLIT)
    clips = ClipSequence(scenes)
    for index, (found, background_slot) in enumerate(read_labels(labels)):
        if index >= len(shadows):
            raise UsageError(f"{effects} has {len(shadows)} scenes in its split {SPLIT}, expected {len(scenes)}.")
        truth = scenes.read(index, ["segmentation"])["segmentation"]
        other = shadows.read(index, ["segmentation", "edits/remove/effects", "objects/count"])
        if not np.array_equal(truth, other["segmentation"]):
            raise UsageError(f"Scene {index} of {effects} is another than in {data}; expected the same with effects.")
        owners = shadow_owners(truth, other["edits/remove/effects"], int(other["objects/count"]))
        yield compare(truth, owners, found, background_slot, unseen=~clips[index].valid)


def shadow_owners(
    truth: UInt8[np.ndarray, "*image"], effects: UInt8[np.ndarray, "*image byte"], count: int
) -> UInt8[np.ndarray, "*image"]:
    """Id of the object whose shadow lies on each pixel of the background, 0 where none does.

    Where several objects darken a pixel it is the first one's.
    """
    owners = np.zeros_like(truth)
    for name in range(count, 0, -1):
        owners[effect_mask(effects, name) & (truth == 0)] = name
    return owners


def compare(
    truth: UInt8[np.ndarray, "frame view height width"],
    owners: UInt8[np.ndarray, "frame view height width"],
    labels: Integer[np.ndarray, "frame view height width"],
    background_slot: int,
    unseen: np.ndarray,
) -> dict[str, dict[str, float]]:
    """Scores of one scene, means over frames and views; pixels in `unseen` never count."""
    with_shadows = np.where(owners > 0, owners, truth)
    scores = {
        "background": clip_scores(truth, labels, background_slot, unseen),
        "object": clip_scores(with_shadows, labels, background_slot, unseen),
        "ignored": clip_scores(truth, labels, background_slot, unseen | (owners > 0)),
    }
    return {way: {name: _mean(found[name]) for name in METRICS} for way, found in scores.items()}


def _mean(values: np.ndarray) -> float:
    defined = values[~np.isnan(values)]
    return float(defined.mean()) if len(defined) else float("nan")


def _summary(values: Sequence[float]) -> Summary:
    scores = np.array([values])
    weights = (~np.isnan(scores)).astype(float)
    return summarise(scores, weights, draw(1, len(values), np.random.default_rng(0)))


if __name__ == "__main__":
    raise SystemExit(main())
