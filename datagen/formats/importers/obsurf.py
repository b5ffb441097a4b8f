"""CLEVR-3D and MultiShapeNet in the layout of ObSuRF: metadata.npz, and one PNG for each scene and view.

    metadata.npz                       shape (scene, object), camera_pos (scene, view, 3); MultiShapeNet: shape_file
    images/img_SCENE_VIEW.png          colour
    depths/depths_SCENE_VIEW.png       16 bits, 1/1638.4 scene units; Euclidean, planar in MultiShapeNet
    masks/masks_SCENE_VIEW.png         ids, 0 = background; only needed in val and test

Cameras look at the origin; their focal length is 35/32 of the image's width.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Integer

from datagen.console.text import counted
from datagen.errors import CorruptFile, UsageError
from datagen.formats.import_request import ReadOptions
from datagen.formats.importers.interface import Facts, Found, Images, Recording
from datagen.geometry import look_at
from datagen.rgbd.camera_pose import check_pose
from datagen.rgbd.files import camera_matrix, check_unit, common_size, missing_file, planar_depth, read_ids, read_opaque
from datagen.rgbd.images import read_depth
from datagen.storage.safe_io import npz_headers, read_npz

METADATA = "metadata.npz"
UNIT = 0.1
"""Metres per scene unit: cubes of CLEVR, 1.4 or 0.7 units wide, become 14 or 7 cm wide as in recipe clevr3d."""
MOST_OBJECTS = 6
"""Scenes with more objects are left out, as ObSuRF and ObPose do."""
_UNITS_PER_STEP = 1 / (65536 * 0.025)
_FOCAL = 35 / 32
_CLEVR = {"train": range(70_000), "val": range(70_000, 70_500), "test": range(85_000, 100_000)}
_MULTISHAPENET = {"train": range(80_000), "val": range(80_000, 80_500), "test": range(90_000, 100_000)}
"""Published splits."""


@dataclass(frozen=True, eq=False)
class _Scenes:
    """Metadata of all scenes."""

    folder: Path
    objects: Integer[np.ndarray, "scene"]
    camera_pos: Float64[np.ndarray, "scene view 3"]
    planar: bool
    unit: float
    masks: bool

    @property
    def views(self) -> int:
        return self.camera_pos.shape[1]

    def files(self, scene: int, kind: str) -> list[Path]:
        """Files of all views; `kind` is images, depths or masks."""
        stem = {"images": "img"}.get(kind, kind)
        return [self.folder / kind / f"{stem}_{scene}_{view}.png" for view in range(self.views)]


def find_obsurf(source: Path, options: ReadOptions) -> Found:
    """Find the scenes of CLEVR-3D or MultiShapeNet; see `interface.Importer`."""
    scenes, multishapenet = _read_metadata(source, options)
    most = MOST_OBJECTS if options.most_objects is None else options.most_objects
    splits = _MULTISHAPENET if multishapenet else _CLEVR
    images = source / "images"
    there = set(os.listdir(images)) if images.is_dir() else set()
    found, absent, full = [], 0, 0
    for split, numbers in splits.items():
        for scene in numbers[: max(0, len(scenes.objects) - numbers.start)]:
            if there.isdisjoint(f"img_{scene}_{view}.png" for view in range(scenes.views)):
                absent += 1
            elif scenes.objects[scene] > most:
                full += 1
            else:
                reader = _Reader(scenes, scene)
                found.append(Recording(f"{source} scene {scene}", split, reader.survey, reader.read))
    if not found:
        raise UsageError(f"{source} holds no scene: expected images/img_SCENE_VIEW.png for scenes of {METADATA}.")
    kind = "MultiShapeNet" if multishapenet else "CLEVR-3D"
    notes = [f"{kind}: 1 scene unit becomes {scenes.unit:g} m; published splits by scene number."]
    if full:
        notes.append(f"{counted(full, 'scene')} left out with more than {most} objects; see --most-objects.")
    if absent:
        notes.append(f"{counted(absent, 'scene')} of {METADATA} left out: their images are not there.")
    return Found(found, "views", tuple(notes))


def _read_metadata(source: Path, options: ReadOptions) -> tuple[_Scenes, bool]:
    path = source / METADATA
    try:
        multishapenet = "shape_file" in npz_headers(path, ["shape_file"])
        arrays = read_npz(path, ["shape", "camera_pos"])
    except (FileNotFoundError, NotADirectoryError):
        raise UsageError(f"{path} is missing; expected the folder of CLEVR-3D or MultiShapeNet.") from None
    shapes = {name: arrays[name].shape for name in arrays}
    fits = len(shapes) == 2 and shapes["camera_pos"][2:] == (3,) and shapes["shape"][:1] == shapes["camera_pos"][:1]
    numeric = fits and arrays["shape"].dtype.kind in "iu" and arrays["camera_pos"].dtype.kind in "iuf"
    if not numeric or len(shapes["shape"]) != 2 or shapes["camera_pos"][1] < 1:
        raise CorruptFile(
            f"{path} has arrays of shapes {shapes}; expected shape (scene, object), integers, and camera_pos (scene, "
            "view, 3), numbers."
        )
    planar = multishapenet if options.depth_type is None else options.depth_type == "planar"
    objects = np.count_nonzero(arrays["shape"] > 0, axis=1)
    unit = options.depth_scale or UNIT
    camera_pos = arrays["camera_pos"].astype(np.float64)
    return _Scenes(source, objects, camera_pos, planar, unit, not options.ignore_masks), multishapenet


class _Reader:
    """Images of one scene."""

    def __init__(self, scenes: _Scenes, scene: int):
        self._scenes, self._scene = scenes, scene
        masks = scenes.files(scene, "masks") if scenes.masks else []
        self._masks = masks if any(path.exists() for path in masks) else []

    def survey(self) -> Facts:
        scenes = self._scenes
        size = common_size(
            scenes.files(self._scene, "images"), scenes.files(self._scene, "depths"), self._masks
        )  # fmt: skip
        objects = max((int(read_ids(path).max()) for path in self._masks), default=0) if self._masks else None
        return Facts(scenes.views, 1, size, objects, posed=True)

    def read(self, images: Sequence[int]) -> Images:
        files = {kind: self._scenes.files(self._scene, kind) for kind in ("images", "depths")}
        for path in (files[kind][number] for kind in files for number in images):
            if not path.exists():
                raise missing_file(path)
        rgb = np.stack([read_opaque(files["images"][number])[None] for number in images])
        height, width = rgb.shape[2:4]
        k = camera_matrix(_FOCAL * width, _FOCAL * width, width / 2, height / 2)
        return Images(
            rgb=rgb,
            depth=np.stack([self._depth(files["depths"][number], k)[None] for number in images]),
            k=np.broadcast_to(k, (len(images), 1, 3, 3)),
            world_from_camera=np.stack([self._pose(number)[None] for number in images]),
            ids=np.stack([read_ids(self._masks[number])[None] for number in images]) if self._masks else None,
        )

    def _depth(self, path: Path, k: Float64[np.ndarray, "3 3"]) -> np.ndarray:
        depth = read_depth(path, _UNITS_PER_STEP * self._scenes.unit)
        check_unit(depth, self._scenes.unit, str(path))
        return depth if self._scenes.planar else planar_depth(depth, k)

    def _pose(self, view: int) -> Float64[np.ndarray, "4 4"]:
        name = f"{self._scenes.folder / METADATA}: camera_pos of scene {self._scene}"
        try:
            pose = look_at(self._scenes.camera_pos[self._scene, view] * self._scenes.unit, np.zeros(3))
        except ValueError as error:
            raise CorruptFile(f"{name}: {error}") from None
        check_pose(pose, f"{name}, view {view}")
        return pose
