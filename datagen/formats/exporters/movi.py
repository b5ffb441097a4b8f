"""MOVi: the fields of Kubric's MOVi datasets under their names, one NPZ file per clip.

Differences of convention: Kubric's depth is the distance to the camera's centre, its camera looks along -z with y up,
flow is (row, column), and image quantities of `instances` are fractions of the image's sides.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from datagen.formats.exporters.interface import CAMERAS, PIXELS, Exporter, Files
from datagen.formats.scenes import Direction, ExportScene, view_name
from datagen.geometry import invert_rigid, pixel_rays, quaternion_from_rotation

SENSOR_WIDTH = 32.0
"""Width of the sensor in millimetres, which sets the unit of `focal_length`."""

FLOOR = 65535
"""Index of the floor in collisions."""

_POSES = ("poses/position", "poses/quaternion_wxyz")
_OPTIONAL = {
    "instances/velocities": ("poses/linear_velocity", 1),
    "instances/angular_velocities": ("poses/angular_velocity", 1),
    "instances/bboxes_3d": ("boxes/box_3d", 1),
    "instances/mass": ("objects/mass", 0),
    "instances/friction": ("objects/friction", 0),
    "instances/restitution": ("objects/restitution", 0),
    "instances/size": ("objects/size", 0),
}
"""Names of instance arrays, with the fields that they copy and the position of the object axis there."""
_TEXTS = {"instances/motion": "objects/motion", "instances/material_label": "objects/material"}


def write(folder: Path, scenes: Iterable[ExportScene]) -> None:
    """Write `SPLIT/NAME.npz` files."""
    for scene in scenes:
        (folder / scene.split).mkdir(exist_ok=True)
        for view in range(scene.views):
            name = view_name(scene, view)
            np.savez_compressed(folder / scene.split / f"{name}.npz", allow_pickle=False, **clip_arrays(scene, view))


def clip_arrays(scene: ExportScene, view: int) -> dict[str, np.ndarray | np.generic]:
    """All arrays of one camera's clip, by MOVi's names with slashes between levels."""
    depth, depth_range = quantised(_distance(scene, view)[..., None])
    width, height = scene.size
    return {
        "video": scene.rgb[:, view],
        "segmentations": scene.segmentation[:, view, ..., None],
        "depth": depth,
        "metadata/depth_range": depth_range,
        **_flow(scene, view),
        **_surfaces(scene, view),
        "metadata/video_name": np.array(f"{scene.split}/{view_name(scene, view)}"),
        "metadata/width": np.int32(width),
        "metadata/height": np.int32(height),
        "metadata/num_frames": np.int32(scene.frames),
        "metadata/num_instances": np.uint16(scene.objects),
        "metadata/frame_rate": np.float32(scene.fps),
        **_camera(scene, view),
        **_instances(scene, view),
        **_collisions(scene),
    }


def quantised(values: Float[np.ndarray, "*axes"]) -> tuple[np.ndarray, np.ndarray]:
    """Convert to 16 bits that span the values' own range; the range is (least, greatest) in float32."""
    low, high = np.float32(np.min(values)), np.float32(np.max(values))
    units = (values.astype(np.float64) - low) / max(float(high) - float(low), 1e-9) * 65535
    return np.clip(np.rint(units), 0, 65535).astype(np.uint16), np.array([low, high], np.float32)


def _distance(scene: ExportScene, view: int) -> Float[np.ndarray, "frame height width"]:
    """Distance from the camera's centre in metres."""
    rays = [pixel_rays(k, *scene.size) for k in scene.k[:, view]]
    return scene.depth[:, view] * np.linalg.norm(rays, axis=-1)


def _flow(scene: ExportScene, view: int) -> dict[str, np.ndarray]:
    directions: tuple[Direction, ...] = ("forward", "backward")
    arrays: dict[str, np.ndarray] = {}
    for direction in directions:
        if scene.has_flow(direction):
            flow, span = quantised(np.nan_to_num(scene.flow(direction, view)[..., ::-1]))
            arrays |= {f"{direction}_flow": flow, f"metadata/{direction}_flow_range": span}
    return arrays


def _surfaces(scene: ExportScene, view: int) -> dict[str, np.ndarray]:
    """Normals from -1..1 and object coordinates from 0..1, both as 0 to 65535."""
    arrays: dict[str, np.ndarray] = {}
    if scene.has_normals:
        arrays["normal"] = np.rint((scene.normals(view) + 1) / 2 * 65535).astype(np.uint16)
    if scene.has_object_coordinates:
        arrays["object_coordinates"] = scene.object_coordinates(view)
    return arrays


def _camera(scene: ExportScene, view: int) -> dict[str, np.ndarray | np.generic]:
    poses = scene.world_from_camera[:, view]
    turned = poses[:, :3, :3] @ np.diag([1.0, -1.0, -1.0])
    focal, width = scene.k[0, view, 0, 0], scene.size[0]
    return {
        "camera/focal_length": np.float32(focal / width * SENSOR_WIDTH),
        "camera/sensor_width": np.float32(SENSOR_WIDTH),
        "camera/field_of_view": np.float32(2 * np.arctan(0.5 * width / focal)),
        "camera/positions": poses[:, :3, 3].astype(np.float32),
        "camera/quaternions": np.array([quaternion_from_rotation(rotation) for rotation in turned], np.float32),
        "camera/K": scene.k[:, view],
    }


def _instances(scene: ExportScene, view: int) -> dict[str, np.ndarray]:
    boxes, frames = _boxes(scene, view)
    arrays = {
        "instances/category": np.array(scene.categories, np.str_),
        "instances/visibility": _visible(scene, view).astype(np.uint16).T,
        "instances/bboxes": boxes,
        "instances/bbox_frames": frames,
        **{
            name: np.moveaxis(scene.per_object(field, axis), axis, 0)
            for name, (field, axis) in _OPTIONAL.items()
            if scene.has(field)
        },
        **{name: np.array(scene.texts(field), np.str_) for name, field in _TEXTS.items() if scene.has(field)},
    }
    if scene.has("objects/motion"):
        arrays["instances/is_dynamic"] = np.array([motion != "rest" for motion in scene.texts("objects/motion")])
    if scene.has(*_POSES):
        positions, quaternions = (np.moveaxis(scene.per_object(field, 1), 1, 0) for field in _POSES)
        arrays |= {
            "instances/positions": positions,
            "instances/quaternions": quaternions,
            "instances/image_positions": _image_positions(scene, view, positions),
        }
    return arrays


def _visible(scene: ExportScene, view: int) -> np.ndarray:
    """Number of visible pixels, [frame object]."""
    ids = np.arange(1, scene.objects + 1)
    return np.count_nonzero(scene.segmentation[:, view, ..., None] == ids, axis=(1, 2))


def _boxes(scene: ExportScene, view: int) -> tuple[np.ndarray, np.ndarray]:
    """Boxes (top, left, bottom, right) in the frames where an object is visible, and these frames.

    Rows of one object come first and are followed by padding, whose frame is -1.
    """
    width, height = scene.size
    boxes = np.zeros((scene.objects, scene.frames, 4), np.float32)
    frames = np.full((scene.objects, scene.frames), -1, np.int32)
    for row in range(scene.objects):
        masks = scene.segmentation[:, view] == row + 1
        for place, frame in enumerate(np.flatnonzero(masks.any(axis=(1, 2)))):
            rows, columns = np.nonzero(masks[frame])
            edges = (rows.min() / height, columns.min() / width, (rows.max() + 1) / height, (columns.max() + 1) / width)
            boxes[row, place], frames[row, place] = edges, frame
    return boxes, frames


def _image_positions(scene: ExportScene, view: int, positions: np.ndarray) -> np.ndarray:
    """Places of the centres of mass in the image (x, y) as fractions of its sides, [object frame 2]."""
    camera_from_world = invert_rigid(scene.world_from_camera[:, view])
    local = np.einsum("fij,ofj->ofi", camera_from_world[:, :3, :3], positions) + camera_from_world[:, :3, 3]
    pixels = np.einsum("fij,ofj->ofi", scene.k[:, view], local)
    return (pixels[..., :2] / pixels[..., 2:] / np.array(scene.size)).astype(np.float32)


def _collisions(scene: ExportScene) -> dict[str, np.ndarray]:
    """Pairs that exchange an impulse, once per frame."""
    if not scene.has("contacts/impulse"):
        return {}
    rows = scene.objects + 1
    impulse = np.triu(scene.read("contacts/impulse")[:, :rows, :rows], k=1)
    frame, first, second = np.nonzero(impulse > 0)
    instances = np.stack([first, second], axis=-1) - 1
    return {
        "events/collisions/instances": np.where(instances < 0, FLOOR, instances).astype(np.uint16),
        "events/collisions/frame": frame.astype(np.int32),
        "events/collisions/force": impulse[frame, first, second].astype(np.float32),
    }


EXPORTER = Exporter(
    title="MOVi (NPZ)",
    write=write,
    needs=(*PIXELS, *CAMERAS),
    files={"clips": Files("*/*.npz", "application/x-npz", "Arrays of one camera's clip.")},
    loading="""\
import numpy as np

clip = np.load("{folder}/{split}/000000.npz")  # files of several views: 000000-0.npz
low, high = clip["metadata/depth_range"]
depth = clip["depth"] / 65535 * (high - low) + low  # as for MOVi""",
    layout="""\
`SPLIT/NAME.npz` holds the arrays of one clip. Names are those of MOVi with a slash between levels, such as `video`,
`segmentations`, `instances/positions` and `camera/quaternions`. Conventions are MOVi's:

- `depth` is the distance to the camera's centre, 16 bits over `metadata/depth_range`; the least value is 0 where a
  pixel has no return.
- `forward_flow` and `backward_flow` are (row, column) in pixels, 16 bits over their ranges, if the dataset has flow.
- `normal` (world axes, -1 to 1 as 0 to 65535) and `object_coordinates` (in the minimum-volume box) exist if the dataset
  has them.
- The camera looks along its -z axis, with y up. Quaternions are (w, x, y, z).
- Ids are rows of `instances/` plus 1. `bboxes` and `bbox_frames` list the frames in which an object is visible,
  followed by padding with frame -1.
- `events/collisions/force` is an impulse in N s; the floor has index 65535.""",
    loses="Depth and flow are rounded to 1/65535 of their range in the clip. Positions and normals of collisions, "
    "shape parameters, colours, lights and edits are left out. `asset_id`, `scale` and `background` do not exist.",
)
