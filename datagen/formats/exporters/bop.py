"""BOP, scenewise: images, poses, masks and models in millimetres, as bop_toolkit reads them.

BOP's camera matrices place the first pixel's centre at (0, 0), so that the principal point moves by half a pixel.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from datagen.edits.edit_context import Stage
from datagen.formats.exporters.interface import CAMERAS, PIXELS, Exporter, Files
from datagen.formats.images import depth_units, write_png
from datagen.formats.scenes import ExportScene, plain
from datagen.formats.silhouettes import silhouettes, stage_of_scene
from datagen.geometry import invert_rigid
from datagen.rgbd.files import HALF_PIXEL
from datagen.schema import DEPTH_SCALE
from datagen.shapes.shape import Shape
from datagen.shapes.symmetry import is_continuous, symmetry_rotations

MILLIMETRES = 1000.0

_AXES = {"SO3": ([1, 0, 0], [0, 1, 0], [0, 0, 1])}
"""Axes about which a group turns freely, if that is not z alone."""


def write(folder: Path, scenes: Iterable[ExportScene]) -> None:
    """Write `SPLIT/SCENE/`, `models/` and `camera.json`."""
    models = _Models(folder / "models")
    for scene in scenes:
        if not (folder / "camera.json").exists():
            (folder / "camera.json").write_text(json.dumps(_camera(scene), indent=2) + "\n")
        _write_scene(folder / scene.split / scene.name, scene, models)
    models.close()


def _camera(scene: ExportScene) -> dict[str, float]:
    """Camera of the first image; every image has its own in `scene_camera.json`."""
    k, (width, height) = scene.k[0, 0] - HALF_PIXEL, scene.size
    units = {"depth_scale": DEPTH_SCALE * MILLIMETRES, "width": width, "height": height}
    return {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], **units}


def _write_scene(folder: Path, scene: ExportScene, models: "_Models") -> None:
    # Each frame of each view is an image.
    stage = stage_of_scene(scene)
    numbers = [models.add(body_key, shape) for body_key, shape in zip(_keys(stage), stage.shapes, strict=True)]
    images = [(frame, view) for frame in range(scene.frames) for view in range(scene.views)]
    depth = depth_units(scene.depth, DEPTH_SCALE)
    cameras: dict[str, Any] = {}
    truth: dict[str, list[Any]] = {str(image): [] for image in range(len(images))}
    information: dict[str, list[Any]] = {str(image): [] for image in range(len(images))}
    for image, (frame, view) in enumerate(images):
        write_png(folder / "rgb" / f"{image:06d}.png", scene.rgb[frame, view])
        write_png(folder / "depth" / f"{image:06d}.png", depth[frame, view])
        rotation, translation = _rigid(invert_rigid(scene.world_from_camera[frame, view]))
        cameras[str(image)] = {
            "cam_K": plain((scene.k[frame, view] - HALF_PIXEL).ravel()),
            "cam_R_w2c": rotation,
            "cam_t_w2c": translation,
            "depth_scale": DEPTH_SCALE * MILLIMETRES,
        }
    # Object by object: masks, poses and facts of visibility.
    for row, masks in enumerate(silhouettes(scene, stage)):
        for image, (frame, view) in enumerate(images):
            silhouette, visible = masks[frame, view], scene.segmentation[frame, view] == row + 1
            name = f"{image:06d}_{row:06d}.png"
            write_png(folder / "mask" / name, silhouette.astype(np.uint8) * 255)
            write_png(folder / "mask_visib" / name, visible.astype(np.uint8) * 255)
            pose = invert_rigid(scene.world_from_camera[frame, view]) @ stage.world_from_object[frame, row]
            rotation, translation = _rigid(pose)
            truth[str(image)].append({"cam_R_m2c": rotation, "cam_t_m2c": translation, "obj_id": numbers[row]})
            information[str(image)].append(_information(silhouette, visible, depth[frame, view] > 0))
    for name, values in (("camera", cameras), ("gt", truth), ("gt_info", information)):
        (folder / f"scene_{name}.json").write_text(_one_a_line(values))


def _keys(stage: Stage) -> list[str]:
    """Names of the models: equal shapes of one category share one."""
    return [
        f"{body.category} {json.dumps([body.shape.family, body.shape.parameters], sort_keys=True)}"
        for body in stage.scene.bodies
    ]


def _rigid(pose: Float[np.ndarray, "4 4"]) -> tuple[list[float], list[float]]:
    """Rotation, row by row, and translation in millimetres."""
    return plain(pose[:3, :3].ravel()), plain(MILLIMETRES * pose[:3, 3])


def _information(
    silhouette: Bool[np.ndarray, "height width"],
    visible: Bool[np.ndarray, "height width"],
    has_depth: Bool[np.ndarray, "height width"],
) -> dict[str, Any]:
    everything, seen = int(np.count_nonzero(silhouette)), int(np.count_nonzero(visible))
    return {
        "bbox_obj": _box(silhouette),
        "bbox_visib": _box(visible),
        "px_count_all": everything,
        "px_count_valid": int(np.count_nonzero(silhouette & has_depth)),
        "px_count_visib": seen,
        "visib_fract": seen / everything if everything else 0.0,
    }


def _box(mask: Bool[np.ndarray, "height width"]) -> list[int]:
    """Box (x, y, width, height) of a mask; -1 four times if it is empty."""
    if not mask.any():
        return [-1, -1, -1, -1]
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return [int(columns[0]), int(rows[0]), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1]


def _one_a_line(values: dict[str, Any]) -> str:
    lines = (f"{json.dumps(key)}: {json.dumps(value)}" for key, value in values.items())
    return "{\n  " + ",\n  ".join(lines) + "\n}\n"


class _Models:
    """Models of all shapes in an export, numbered from 1 in the order in which they appear."""

    def __init__(self, folder: Path):
        self._folder, self._numbers, self._information = folder, dict[str, int](), dict[str, Any]()
        folder.mkdir()

    def add(self, key: str, shape: Shape) -> int:
        """Number of a shape's model, which is written when it appears for the first time."""
        if key not in self._numbers:
            number = self._numbers[key] = len(self._numbers) + 1
            _write_ply(self._folder / f"obj_{number:06d}.ply", shape)
            self._information[str(number)] = {**_model_facts(shape), "name": key.partition(" ")[0]}
        return self._numbers[key]

    def close(self) -> None:
        """Write the list of models."""
        (self._folder / "models_info.json").write_text(_one_a_line(self._information))


def _model_facts(shape: Shape) -> dict[str, Any]:
    from scipy.spatial import ConvexHull
    from scipy.spatial.distance import pdist

    points = MILLIMETRES * shape.vertices
    low, size = np.min(points, axis=0), np.ptp(points, axis=0)
    facts = {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    facts |= {f"size_{axis}": float(value) for axis, value in zip("xyz", size, strict=True)}
    return {
        "diameter": float(np.max(pdist(points[ConvexHull(points).vertices]))),
        **facts,
        **symmetries(shape.symmetry),
    }


def symmetries(group: str) -> dict[str, Any]:
    """Symmetries of a rotation group, as bop_toolkit names them."""
    if not is_continuous(group):
        turns = [plain(_turn(rotation)) for rotation in symmetry_rotations(group)[1:]]
        return {"symmetries_discrete": turns} if turns else {}
    axes = [{"axis": axis, "offset": [0, 0, 0]} for axis in _AXES.get(group, ([0, 0, 1],))]
    flip = {"symmetries_discrete": [plain(_turn(np.diag([1.0, -1.0, -1.0])))]} if group == "Dinf" else {}
    return {"symmetries_continuous": axes, **flip}


def _turn(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "16"]:
    pose = np.eye(4)
    pose[:3, :3] = rotation
    return pose.ravel()


def _write_ply(path: Path, shape: Shape) -> None:
    """Write a mesh in millimetres; corners with different normals become different vertices.

    Surfaces with holes are written once, although they are drawn from both sides.
    """
    front = len(shape.faces) - shape.backs
    positions, normals = MILLIMETRES * shape.vertices[shape.faces[:front]], shape.normals[:front]
    corners = np.concatenate([positions, normals], axis=-1).reshape(-1, 6)
    vertices, places = np.unique(np.round(corners, 5), axis=0, return_inverse=True)
    faces = places.reshape(-1, 3)
    properties = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    header = (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with path.open("w", encoding="ascii") as file:
        file.write(header)
        np.savetxt(file, vertices, fmt="%.5g")
        np.savetxt(file, np.column_stack([np.full(len(faces), 3), faces]), fmt="%d")


EXPORTER = Exporter(
    title="BOP (scenewise)",
    write=write,
    needs=(*PIXELS, *CAMERAS, "scene/description", "poses/position", "poses/quaternion_wxyz"),
    files={
        "rgb": Files("*/*/rgb/*.png", "image/png", "Colour images."),
        "depth": Files("*/*/depth/*.png", "image/png", "16-bit planar depth; depth_scale in scene_camera.json."),
        "masks": Files("*/*/mask/*.png", "image/png", "Silhouettes, IMAGE_OBJECT.png."),
        "visible-masks": Files("*/*/mask_visib/*.png", "image/png", "Visible parts, IMAGE_OBJECT.png."),
        "annotations": Files("*/*/scene_*.json", "application/json", "Cameras, poses and visibility of each image."),
        "models": Files("models/*.ply", "model/ply", "Meshes in millimetres."),
    },
    loading="""\
import json
from pathlib import Path

scene = Path("{folder}/{split}/000000")
poses = json.loads((scene / "scene_gt.json").read_text())["0"]  # of image 0
cameras = json.loads((scene / "scene_camera.json").read_text())""",
    layout="""\
The [scenewise layout of BOP](https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md), in
millimetres: `SPLIT/SCENE/` with `rgb`, `depth`, `mask`, `mask_visib`, `scene_camera.json`, `scene_gt.json` and
`scene_gt_info.json`; `models/` with `models_info.json`; `camera.json`.

- Image *i* of a scene is frame *i* // views of view *i* % views.
- `cam_K` places the first pixel's centre at 0, 0, as OpenCV does.
- Boxes and pixel counts of silhouettes end at the image's border. `visib_fract` counts pixels of the label images.
- The origin of a model is its centre of mass. Each shape has its own model; equal shapes share one.""",
    loses="Colours of models, velocities, contacts, materials, lights, flow and edits are left out. Symmetries are "
    "those of the shapes, without regard to colours.",
)
