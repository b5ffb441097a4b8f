"""Checks of imported scenes: cameras, depths, ids and what follows from them; their truth is unknown."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from datagen import schema
from datagen.geometry import invert_rigid, rigid, transform, unproject
from datagen.shapes.shape import OrientedBox
from datagen.verify.scene_case import Finding

_TOLERANCE = 1e-3
"""Largest deviation of a rotation from orthonormal; given poses are rounded."""
_BEYOND = 0.02
"""Largest distance from an object's box of half of its visible points, metres; sensors and labels by hand are rough."""


def verify_imported(record: Mapping[str, np.ndarray], fields: Sequence[str]) -> Iterator[Finding]:
    """Check one scene's arrays, which must be those named by `fields`."""
    if {*record} != {*fields}:
        differing = sorted({*record} ^ {*fields})
        yield Finding("schema", f"fields differ from those of dataset.json: {', '.join(differing)}")
        return
    lengths: dict[str, int] = {}
    try:
        for name, array in record.items():
            schema.check_field(schema.FIELDS[name], array.dtype, array.shape, lengths)
    except schema.SchemaError as error:
        yield Finding("schema", str(error))
        return
    yield from _check_cameras(record)
    if "segmentation" in record:
        yield from _check_counts(record)
    if "boxes/box_3d" in record:
        yield from _check_boxes(record)


def _check_cameras(record: Mapping[str, np.ndarray]) -> Iterator[Finding]:
    for view, (k, pose) in enumerate(zip(record["camera/K"], record["camera/world_from_camera"], strict=True)):
        if not (np.isfinite(k).all() and k[0, 0] > 0 and k[1, 1] > 0 and np.array_equal(k[2], [0, 0, 1])):
            yield Finding("camera", "camera/K is no camera matrix", view=view)
        rotation = pose[:3, :3]
        rigid = np.isfinite(pose).all() and np.allclose(rotation @ rotation.T, np.eye(3), atol=_TOLERANCE)
        if not rigid or np.linalg.det(rotation) < 0 or not np.array_equal(pose[3], [0, 0, 0, 1]):
            yield Finding("camera", "camera/world_from_camera is no rigid pose", view=view)


def _check_counts(record: Mapping[str, np.ndarray]) -> Iterator[Finding]:
    ids, count = record["segmentation"], int(record["objects/count"])
    found = {int(one) for one in np.unique(ids)} - {0}
    if found != {*range(1, count + 1)}:
        yield Finding("counts", f"segmentation has the ids {sorted(found)}, objects/count is {count}")
        return
    pixels, boxes = record["visibility/visible_pixels"], record["boxes/box_2d"]
    for frame, view, row in np.ndindex(*pixels.shape):
        rows, columns = np.nonzero(ids[frame, view] == row + 1)
        ends = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1) if len(rows) else (0, 0, 0, 0)
        if pixels[frame, view, row] != len(rows) or tuple(boxes[frame, view, row]) != ends:
            yield Finding("counts", f"pixels or box of object {row + 1} do not fit its mask", frame=frame, view=view)


def _check_boxes(record: Mapping[str, np.ndarray]) -> Iterator[Finding]:
    """Check that boxes are where the poses put them, and that they hold what the depth shows."""
    count = int(record["objects/count"])
    poses = rigid(record["poses/position"][:, :count], record["poses/quaternion_wxyz"][:, :count])
    depth, ids = schema.decode_depth(record["depth"]), record["segmentation"]
    for frame, row in np.ndindex(len(poses), count):
        box = OrientedBox(*(record[f"objects/minimum_box_{part}"][row] for part in ("center", "rotation", "size")))
        if np.max(np.abs(transform(poses[frame, row], box.corners) - record["boxes/box_3d"][frame, row])) > _TOLERANCE:
            yield Finding("boxes", f"box_3d of object {row + 1} is not its minimum box at its pose", frame=frame)
        for view, camera in enumerate(zip(record["camera/K"], record["camera/world_from_camera"], strict=True)):
            shown = unproject(depth[frame, view], *camera)[(ids[frame, view] == row + 1) & (depth[frame, view] > 0)]
            local = (transform(invert_rigid(poses[frame, row]), shown) - box.center) @ box.rotation
            beyond = float(np.median(np.max(np.abs(local) - box.size / 2, axis=1))) if len(shown) else 0.0
            if beyond > _BEYOND:
                message = f"half of object {row + 1} shows {1e3 * beyond:.0f} mm or more outside of its box"
                yield Finding("boxes", message, frame=frame, view=view)
