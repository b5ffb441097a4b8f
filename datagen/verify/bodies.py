"""Check that poses, boxes and contacts are physically possible."""

from collections.abc import Iterator

import numpy as np

from datagen.shapes.shape import MESH_TOLERANCE
from datagen.verify.pixels import signed_distance
from datagen.verify.scene_case import Case, Finding

DEEPEST = 1e-3
"""Metres that objects may overlap in frame 0, as physics measures it; for later frames the recipe says it."""

GAP_ROUNDING = 1e-6
"""Metres that rounding to float32 may move a gap."""

HULL_SLACK = 1e-3
"""Metres that the hulls which physics uses may lie inside the true surface."""

BOX_TOLERANCE = 1e-5
"""Metres that rounding to float32 may move a box."""


def check_poses(case: Case) -> Iterator[Finding]:
    """Check that orientations are unit quaternions."""
    quaternions = case.record["poses/quaternion_wxyz"][:, : case.count].astype(np.float64)
    error = np.abs(np.sqrt(np.sum(quaternions**2, axis=-1)) - 1)
    if np.any(error > 1e-5):
        yield Finding("poses", f"a quaternion's length is off by {np.max(error):.2g} (allowed 1e-05)")


def check_boxes(case: Case) -> Iterator[Finding]:
    """Check that stored 3D boxes are the minimum boxes at the stored poses and hold the shapes."""
    for row, shape in enumerate(case.shapes):
        inside = (shape.vertices - shape.minimum_box.center) @ shape.minimum_box.rotation
        over = np.max(np.abs(inside) - 0.5 * shape.minimum_box.size)
        if over > BOX_TOLERANCE + MESH_TOLERANCE:
            yield Finding("boxes", f"object {row + 1} reaches {1e3 * over:.3f} mm beyond its minimum box")
        pose = case.world_from_object[:, row]
        corners = shape.minimum_box.corners @ np.swapaxes(pose[:, :3, :3], 1, 2) + pose[:, None, :3, 3]
        error = np.max(np.abs(corners - case.record["boxes/box_3d"][:, row]), axis=(1, 2))
        for frame in np.flatnonzero(error > BOX_TOLERANCE):
            message = f"box_3d of object {row + 1} is {1e3 * error[frame]:.3f} mm from its minimum box at its pose"
            yield Finding("boxes", message, frame=int(frame))


def check_overlap(case: Case) -> Iterator[Finding]:
    """Check that no overlap is deep: by stored contacts in any frame, by exact surfaces in frame 0."""
    for frame, gap in enumerate(case.record["contacts/gap"]):
        deepest = case.allowed.physics.deepest_in_motion if frame else DEEPEST
        if np.min(gap) < -deepest - GAP_ROUNDING:
            message = f"stored contacts overlap by {-1e3 * np.min(gap):.2f} mm (allowed {1e3 * deepest:.2f})"
            yield Finding("overlap", message, frame=frame)
        if np.any(gap != gap.T):
            yield Finding("overlap", "contacts/gap is not symmetric", frame=frame)
    yield from check_exact_overlap(case)


def check_exact_overlap(case: Case) -> Iterator[Finding]:
    """Check that no overlap is deep in frame 0, by the exact surfaces."""
    allowed = DEEPEST + HULL_SLACK
    for row in range(case.count):
        depth, other = _deepest(case, row)
        if depth > allowed:
            message = f"object {row + 1} reaches {1e3 * depth:.2f} mm into {other} (allowed {1e3 * allowed:.2f})"
            yield Finding("overlap", message, frame=0)


def _deepest(case: Case, row: int) -> tuple[float, str]:
    """Depth to which vertices of one object penetrate the table or another object in frame 0, metres, and its index."""
    pose = case.world_from_object[0, row]
    vertices = case.shapes[row].vertices @ pose[:3, :3].T + pose[:3, 3]
    reaches = [(-float(np.min(vertices[:, 2])), "the table")]
    for other in range(case.count):
        center = case.world_from_object[0, other, :3, 3]
        near = vertices[np.sum((vertices - center) ** 2, axis=1) < case.shapes[other].radius ** 2]
        if other != row and len(near):
            reaches.append((-float(np.min(signed_distance(case, other, 0, near))), f"object {other + 1}"))
    return max(reaches)
