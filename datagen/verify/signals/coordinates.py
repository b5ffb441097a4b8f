"""Check object coordinates: seen through the stored poses and camera, they are where the pixel and its depth are."""

from collections.abc import Iterator

import numpy as np

from datagen.schema import COORDINATE_SCALE, DEPTH_SCALE
from datagen.shapes.shape import MESH_TOLERANCE
from datagen.verify.scene_case import Case, Finding

STEPS = 0.7
"""Steps of depth that stored depth may be off, see `datagen.verify.pixels.SURFACE_STEPS`."""

RESERVE = 0.02
"""Pixels that a point may lie beside the pixel's centre, besides the rounding of its coordinates."""

SHARE, FEW = 0.05, 3
"""Share and number of an object's pixels that a renderer which moves corners sideways may draw beside its mesh."""


def check_coordinates(case: Case) -> Iterator[Finding]:
    """Check that coordinates are in the object's box, at the pixel's centre and depth; the background's are zero."""
    for frame, view in case.images:
        stored, labels = case.record["object_coordinates"][frame, view], case.segmentation(frame, view)
        if np.any(stored[labels == 0]):
            yield Finding("coordinates", "the background has coordinates", frame=frame, view=view)
        y, x = np.indices(labels.shape) + 0.5
        moment, depth = case.at(frame), case.depth(frame, view)
        for row, shape in enumerate(case.shapes):
            own, box, pose = labels == row + 1, shape.minimum_box, case.world_from_object[frame, row]
            local = box.center + (stored[own] / COORDINATE_SCALE - 0.5) * box.size @ box.rotation.T
            pixels, z = moment.project(local @ pose[:3, :3].T + pose[:3, 3], view)
            beside = np.max(np.abs(pixels - np.stack([x[own], y[own]], axis=-1)), axis=1, initial=0)
            rounding = float(np.sqrt(np.sum(box.size**2))) / COORDINATE_SCALE
            focal = np.max(case.record["camera/K"][view, [0, 1], [0, 1]])
            off = beside > RESERVE + focal * rounding / np.maximum(z, 1e-9)
            # A mesh may reach beyond the box by its tolerance; coordinates end at its sides.
            clipped = np.any((stored[own] == 0) | (stored[own] == COORDINATE_SCALE), axis=1)
            off |= np.abs(z - depth[own]) > STEPS * DEPTH_SCALE + rounding + clipped * MESH_TOLERANCE
            allowed = FEW + int(SHARE * len(off)) if case.allowed.precision.snap else 0
            if np.count_nonzero(off) > allowed:
                message = (
                    f"{np.count_nonzero(off)} of {len(off)} pixels of object {row + 1} are up to {np.max(beside):.2f} "
                    f"pixels beside their centre or {1e3 * np.max(np.abs(z - depth[own])):.2f} mm off their depth"
                )
                yield Finding("coordinates", message, frame=frame, view=view)
