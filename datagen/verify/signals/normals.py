"""Check stored normals against those of the exact shapes."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from datagen.schema import NORMAL_SCALE
from datagen.verify.scene_case import Case, Finding
from datagen.verify.signals.occlusion import surface_normals

LENGTH = 1e-4
"""Largest deviation of a normal's length from one."""

PLANE = 1e-4
"""Largest deviation of a component of the table's normal."""

ANGLE, MEDIAN = 23.0, 12.0
"""Degrees between the stored normal and that of the solid, where the latter is the same all around the pixel's point.

Stored normals are those that shade the image. They smooth the bends of turned shapes up to 40 degrees, and are then up
to half of it from the solid's; elsewhere they are closer than a degree.
"""

STEADY = 3.0
"""Largest change in degrees of the solid's normal within `AROUND` of a point; elsewhere there is an edge."""

AROUND = 6e-4
"""Distance at which the solid's normal is compared, metres."""

SHARE, FEW = 0.02, 5
"""Share and number of an object's compared pixels that may be off."""


def check_normals(case: Case) -> Iterator[Finding]:
    """Check that normals have unit length, and are those of the table and of the solids."""
    for frame, view in case.images:
        normals = case.record["normals"][frame, view].astype(np.float64) / NORMAL_SCALE
        moment, depth, labels = case.at(frame), case.depth(frame, view), case.segmentation(frame, view)
        rotation = moment.record["camera/world_from_camera"][view, :3, :3]
        surface = depth > 0
        length = np.sqrt(np.sum(normals**2, axis=-1))
        if np.any(np.abs(length - surface) > LENGTH):
            worst = np.max(np.abs(length - surface))
            message = f"a normal's length is off by {worst:.2g}, expected 1 on surfaces and 0 elsewhere"
            yield Finding("normals", message, frame=frame, view=view)
        table = np.abs(normals - rotation[2])[surface & (labels == 0)]
        if np.max(table, initial=0) > PLANE:
            message = f"the table's normal is off by {np.max(table):.2g} (allowed {PLANE:.2g})"
            yield Finding("normals", message, frame=frame, view=view)
        world = moment.center(view) + depth[..., None] * moment.rays[view]
        for row in range(case.count):
            own = labels == row + 1
            pose = case.world_from_object[frame, row]
            local, rays = (world[own] - pose[:3, 3]) @ pose[:3, :3], moment.rays[view][own] @ pose[:3, :3]
            yield from _off(case, row, local, rays, normals[own] @ rotation.T @ pose[:3, :3], frame, view)


def _off(
    case: Case,
    row: int,
    points: Float[np.ndarray, "pixel 3"],
    rays: Float[np.ndarray, "pixel 3"],
    normals: Float[np.ndarray, "pixel 3"],
    frame: int,
    view: int,
) -> Iterator[Finding]:
    """Compare an object's normals with its solid's at points in its frame."""
    if not len(points):
        return
    exact = surface_normals(case.shapes[row], points, rays)
    steady = np.ones(len(points), bool)
    for side in _sides(exact):
        steady &= _cosine(surface_normals(case.shapes[row], points + AROUND * side, rays), exact) > np.cos(
            np.radians(STEADY)
        )
    off = steady & (_cosine(normals, exact) < np.cos(np.radians(ANGLE)))
    if np.count_nonzero(off) > FEW + int(SHARE * np.count_nonzero(steady)):
        worst = np.degrees(np.arccos(np.clip(np.min(_cosine(normals, exact)[off]), -1, 1)))
        message = (
            f"{np.count_nonzero(off)} of {np.count_nonzero(steady)} normals of object {row + 1} are off by up to "
            f"{worst:.1f} degrees (allowed {ANGLE:.1f})"
        )
        yield Finding("normals", message, frame=frame, view=view)
    elif np.count_nonzero(steady) > FEW:
        median = np.degrees(np.arccos(np.clip(np.median(_cosine(normals, exact)[steady]), -1, 1)))
        if median > MEDIAN:
            message = f"the median normal of object {row + 1} is off by {median:.1f} degrees (allowed {MEDIAN:.1f})"
            yield Finding("normals", message, frame=frame, view=view)


def _sides(normals: Float[np.ndarray, "pixel 3"]) -> list[Float[np.ndarray, "pixel 3"]]:
    """Four directions along the surface."""
    helper = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    along = np.cross(normals, helper)
    along /= np.maximum(np.sqrt(np.sum(along**2, axis=1, keepdims=True)), 1e-9)
    across = np.cross(normals, along)
    return [along, -along, across, -across]


def _cosine(a: Float[np.ndarray, "pixel 3"], b: Float[np.ndarray, "pixel 3"]) -> Float[np.ndarray, "pixel"]:
    return np.sum(a * b, axis=1)
