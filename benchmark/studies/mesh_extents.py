"""How much larger than the generator's objects are the meshes of inferred ones?

Objects are compared in up to three frames of each clip, if their inferred mask overlaps the true one enough. Errors are
relative errors of the extents along the three axes of the true object.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Integer

from benchmark.ranking.leaderboard import Line
from benchmark.studies.inputs import ModelFlags, TableFlags
from datagen.errors import UsageError
from datagen.geometry import rotation_from_quaternion
from datagen.storage.reader import Dataset
from obpose.model.obpose import ObPose
from obpose.scenes.clip import read_clip
from obpose.scenes.infer import Inferred, infer_labelled
from obpose.scenes.meshes import SURFACE, SURFACE_OF_FIELD, object_mesh
from obpose.scenes.refine import STEPS

DENSITIES = (SURFACE, 0.7, SURFACE_OF_FIELD)
LEAST_PIXELS, LEAST_IOU = 30, 0.7
"""Objects are compared if they have this many pixels, and an inferred mask of this overlap."""

_FIELDS = ("segmentation", "poses/quaternion_wxyz", "objects/size")


@dataclass(frozen=True, kw_only=True)
class Flags(ModelFlags, TableFlags):
    """Options of the study."""

    refine: int = STEPS
    """Steps in which scenes are fitted to their frames, as by `obpose-edit infer --refine`."""


def run(flags: Flags) -> list[Line]:
    """Compare meshes of several surface densities, as the field has them and shrunk to what the frames show."""
    for name, least in (("scenes", 1), ("refine", 0)):
        if (value := getattr(flags, name)) < least:
            raise UsageError(f"--{name} {value}: expected {least} or more.")
    origin, folder = flags.origin(), flags.folder()
    split = Dataset(folder).split(flags.split)
    if not split.has(*_FIELDS):
        raise UsageError(
            f"{folder} lacks masks, poses or sizes of objects; expected a dataset with {', '.join(_FIELDS)}."
        )
    errors: dict[tuple[float, bool], list[np.ndarray]] = {}
    for index in range(min(flags.scenes, len(split))):
        inferred = infer_labelled(origin, read_clip(folder, flags.split, index), refinements=flags.refine)
        for density, shrunk, error in compare(origin.model, inferred, split[index]):
            errors.setdefault((density, shrunk), []).append(error)
    return [
        {
            "density": density,
            "mesh": "shrunk to what frames show" if shrunk else "as the field",
            "objects": len(found),
            "median error": float(np.median(np.abs(found))),
            "median signed error": float(np.median(found)),
            "90 % of errors below": float(np.quantile(np.abs(found), 0.9)),
        }
        for (density, shrunk), found in sorted(errors.items())
    ]


def compare(
    model: ObPose, inferred: Inferred, record: dict[str, np.ndarray]
) -> Iterator[tuple[float, bool, Float[np.ndarray, "3"]]]:
    """Yield density, whether the mesh is shrunk, and the errors of each object that both have in the same frame."""
    scene, unknown = inferred.scene, torch.zeros_like(inferred.scene.appearance.half_extent)
    for frame in sorted({scene.frames // 3, 2 * scene.frames // 3, scene.frames - 1}):
        for row, name in match(record["segmentation"][frame, 0], inferred.labels[frame, 0].numpy()):
            rotation = rotation_from_quaternion(record["poses/quaternion_wxyz"][frame, row].astype(float))
            for density in DENSITIES:
                for shrunk, made in ((False, scene.with_appearance(half_extent=unknown)), (True, scene)):
                    try:
                        mesh = object_mesh(
                            model, made, name, frame=frame, floor=model.config.model.table, surface=density
                        )
                    except UsageError:  # nowhere that dense
                        continue
                    extents = np.ptp(mesh.vertices @ rotation, axis=0)
                    yield density, shrunk, extents / record["objects/size"][row].astype(float) - 1


def match(
    truth: Integer[np.ndarray, "height width"], found: Integer[np.ndarray, "height width"]
) -> Iterator[tuple[int, int]]:
    """Yield the row of each true object, and the name of the inferred one whose mask overlaps it enough."""
    for value in np.unique(truth[truth > 0]):
        mine = truth == value
        overlaps = {
            int(name): (mine & (found == name)).sum() / (mine | (found == name)).sum()
            for name in np.unique(found[mine & (found > 0)])
        }
        best = max(overlaps, key=overlaps.__getitem__, default=0)
        if mine.sum() >= LEAST_PIXELS and overlaps.get(best, 0) >= LEAST_IOU:
            yield int(value) - 1, best
