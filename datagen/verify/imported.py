"""Checks of imported scenes: cameras, depths, ids and what follows from them; their truth is unknown."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from datagen import schema
from datagen.verify.scene_case import Finding

_TOLERANCE = 1e-3
"""Largest deviation of a rotation from orthonormal; given poses are rounded."""


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
