"""What goes wrong with objects, as in a report's table of errors, along clips and by how many objects are in view.

python -m benchmark.studies.claims.errors_cli RUN/labels/FILE.h5 [...]

The label maps are of the test split.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from benchmark.metrics.errors_by_type import ERROR_TYPES, MEANINGS
from benchmark.report.analysis import outcome
from benchmark.report.observations import Objects, Outcome, observe, read_truth
from benchmark.results.labels import check_labels, dataset_of, read_labels
from benchmark.studies.claims.command import LabelMaps, run_command
from datagen.errors import EXIT_OK
from datagen.storage.reader import Dataset

PROGRAM = "python -m benchmark.studies.claims.errors_cli"
SPLIT = "test"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; give the exit code."""
    return run_command(run, LabelMaps, arguments, program=PROGRAM, about=__doc__)


def run(values: LabelMaps) -> int:
    """Every file in its turn."""
    check_labels(*values.labels)
    for name in ERROR_TYPES:
        print(f"{name}: {MEANINGS[name]}")
    for path in values.labels:
        objects, found = dealt_with(path, values.data or dataset_of(path))
        first, last = (found.overlap[objects.frame == frame].mean() for frame in (0, objects.frame.max()))
        print(f"{path.name}: {_shares(found.errors)}")
        print(f"  mean best IoU {first:.3f} in first frames, {last:.3f} in last ones")
        for count in np.unique(objects.companions):
            print(f"  {count} in view: {_shares(found.errors[objects.companions == count])}")
    return EXIT_OK


def dealt_with(path: Path, data: Path) -> tuple[Objects, Outcome]:
    """The objects of a test split in all images, and how the labels dealt with each."""
    scenes = Dataset(data).split(SPLIT)
    truths = [read_truth(scenes, index) for index in range(len(scenes))]
    return observe(scenes), outcome(truths, read_labels(path))


def _shares(errors: Float64[np.ndarray, "observation type"]) -> str:
    return ", ".join(f"{name} {share:.0%}" for name, share in zip(ERROR_TYPES, errors.mean(axis=0), strict=True))


if __name__ == "__main__":
    raise SystemExit(main())
