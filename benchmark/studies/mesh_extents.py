"""How large are the meshes of inferred objects, compared with the generator's sizes, at several surface densities?"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from benchmark.ranking.leaderboard import Line
from benchmark.studies.inputs import ModelFlags, TableFlags, first_clips, markdown
from datagen.errors import UsageError
from datagen.geometry import rotation_from_quaternion
from obpose.model.obpose import ObPose
from obpose.scenes.infer import Inferred, infer_labelled
from obpose.scenes.meshes import object_mesh
from obpose.scenes.refine import STEPS

DENSITIES = (0.5, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98)
LEAST_PIXELS, LEAST_IOU = 30, 0.7
"""Objects are compared if they have this many pixels, and an inferred mask of this overlap."""


@dataclass(frozen=True, kw_only=True)
class Flags(ModelFlags, TableFlags):
    """Options of the study."""


def run(flags: Flags) -> list[Line]:
    """Compare the meshes of three frames of each scene, and print a summary."""
    flags.check(scenes=1)
    origin, folder = flags.origin(), flags.folder()
    lines: list[Line] = []
    for index, (record, observation) in enumerate(first_clips(folder, flags.split, flags.scenes)):
        inferred = infer_labelled(origin, observation, refinements=STEPS)
        frames = inferred.scene.frames
        for frame in sorted({frames // 3, 2 * frames // 3, frames - 1}):
            lines += [{"scene": index, **line} for line in compare(origin.model, inferred, record, frame)]
    print(markdown(summary(lines)) + "\n")
    return lines


def compare(model: ObPose, inferred: Inferred, record: dict[str, np.ndarray], frame: int) -> Iterator[Line]:
    """Yield the errors of each matched object, at each density, with and without a cut at the table."""
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


def summary(lines: Sequence[Line]) -> list[Line]:
    """Give the median absolute and signed relative errors over objects and axes, one line per density."""
    rows = []
    for density in DENSITIES:
        row: dict[str, float | str] = {"density": density}
        for cut, place in ((False, "whole"), (True, "cut at the table")):
            chosen = [line for line in lines if line["density"] == density and line["cut"] == cut]
            errors: Float[np.ndarray, "object 3"] = np.array([[line[axis] for axis in "xyz"] for line in chosen], float)
            row[f"objects, {place}"] = len(chosen)
            row[f"median error, {place}"] = float(np.median(np.abs(errors))) if chosen else float("nan")
            row[f"signed, {place}"] = float(np.median(errors)) if chosen else float("nan")
        rows.append(row)
    return rows
