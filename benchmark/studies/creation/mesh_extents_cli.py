"""Extents of the meshes of inferred objects, compared with the generator's sizes, for several surface densities.

python -m benchmark.studies.creation.mesh_extents_cli --track moving --split val --scenes 20
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from benchmark.ranking.leaderboard import Line
from benchmark.studies.claims.command import run_command
from benchmark.studies.creation.subject import Subject
from datagen.errors import EXIT_OK, UsageError
from datagen.geometry import rotation_from_quaternion
from datagen.storage.reader import Dataset
from obpose.model.obpose import ObPose
from obpose.scenes.clip import read_clip
from obpose.scenes.infer import Inferred, infer_labelled
from obpose.scenes.meshes import object_mesh
from obpose.scenes.refine import STEPS

PROGRAM = "python -m benchmark.studies.creation.mesh_extents_cli"
DENSITIES = (0.5, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98)
LEAST_PIXELS, LEAST_IOU = 30, 0.7
"""Objects are compared if they have this many pixels, and an inferred mask of this overlap."""


@dataclass(frozen=True)
class Arguments(Subject):
    """Options of the command."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return the exit code."""
    return run_command(run, Arguments, arguments, program=PROGRAM, about=__doc__)


def run(values: Arguments) -> int:
    """Measure one model on one dataset."""
    values.check(scenes=1)
    origin, folder = values.origin(), values.folder()
    records = Dataset(folder).split(values.split)
    lines: list[Line] = []
    for index in range(min(values.scenes, len(records))):
        inferred = infer_labelled(origin, read_clip(folder, values.split, index), refinements=STEPS)
        frames = inferred.scene.frames
        for frame in sorted({frames // 3, 2 * frames // 3, frames - 1}):
            lines += [{"scene": index, **line} for line in _compare(origin.model, inferred, records[index], frame)]
    for row in table(lines):
        print(row)
    values.write_csv(origin, lines)
    return EXIT_OK


def _compare(model: ObPose, inferred: Inferred, record: dict[str, np.ndarray], frame: int) -> Iterator[Line]:
    """Give one line for each object of a frame that was found, density, and whether meshes are cut at the table."""
    truth, found = record["segmentation"][frame, 0], inferred.labels[frame, 0].numpy()
    count = int(record["objects/count"])
    rotation = rotation_from_quaternion(record["poses/quaternion_wxyz"][frame, :count].astype(float))
    for row, name in match(truth, found):
        size = record["objects/size"][row].astype(float)
        for density in DENSITIES:
            for floor in (None, model.config.model.table):
                try:
                    mesh = object_mesh(model, inferred.scene, name, frame=frame, floor=floor, surface=density)
                except UsageError:  # nowhere that dense
                    continue
                extents = np.ptp(mesh.vertices @ rotation[row], axis=0)
                errors = dict(zip(("x", "y", "z"), (extents / size - 1).tolist(), strict=True))
                yield {"frame": frame, "object": row, "density": density, "cut": floor is not None, **errors}


def match(truth: Int[np.ndarray, "height width"], found: Int[np.ndarray, "height width"]) -> list[tuple[int, int]]:
    """Match true objects (row in `objects/`) with the inferred ones (name) whose masks overlap them enough."""
    pairs = []
    for value in np.unique(truth[truth > 0]):
        mine = truth == value
        overlaps = {
            int(name): (mine & (found == name)).sum() / (mine | (found == name)).sum()
            for name in np.unique(found[mine])
        }
        overlaps.pop(0, None)
        best = max(overlaps, key=overlaps.__getitem__, default=0)
        if mine.sum() >= LEAST_PIXELS and overlaps.get(best, 0) >= LEAST_IOU:
            pairs.append((int(value) - 1, best))
    return pairs


def table(lines: Sequence[Line]) -> Iterator[str]:
    """Format the errors as Markdown."""
    yield "| density | objects | whole: median error | signed | cut at the table: median error | signed |"
    yield f"|{'---:|' * 6}"
    for density in DENSITIES:
        cells: list[str] = []
        count = 0
        for cut in (False, True):
            chosen = [line for line in lines if line["density"] == density and line["cut"] == cut]
            errors: Float[np.ndarray, "object 3"] = np.array([[line[axis] for axis in "xyz"] for line in chosen], float)
            count = len(chosen)
            cells += [f"{np.median(np.abs(errors)):.1%}", f"{np.median(errors):+.1%}"] if count else ["", ""]
        yield f"| {density} | {count} | {' | '.join(cells)} |"


if __name__ == "__main__":
    raise SystemExit(main())
