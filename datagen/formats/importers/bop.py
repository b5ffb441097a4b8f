"""BOP in its scenewise layout, one folder for each scene.

    SRC/SPLIT/000000/scene_camera.json            cam_K, depth_scale (mm per unit), optional cam_R_w2c, cam_t_w2c
    SRC/SPLIT/000000/rgb/000000.png               or .jpg
    SRC/SPLIT/000000/depth/000000.png             16 bits
    SRC/SPLIT/000000/scene_gt.json                optional: obj_id, cam_R_m2c and cam_t_m2c of each object
    SRC/SPLIT/000000/mask_visib/000000_000000.png optional: visible part of each object
    SRC/models/                                   optional, also beside SRC: see `bop_models`

SPLIT begins with train, val or test. SRC may also be a folder of scenes, or one scene.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from datagen.errors import CorruptFile, UsageError
from datagen.formats.import_request import ReadOptions
from datagen.formats.importers.bop_models import METRES, Models, find_models
from datagen.formats.importers.interface import Facts, Found, Images, Recording
from datagen.geometry import invert_rigid
from datagen.rgbd.camera_pose import check_pose, is_rigid
from datagen.rgbd.files import (
    HALF_PIXEL,
    check_intrinsics,
    common_size,
    missing_file,
    numbers,
    read_ids,
    read_metres,
    read_object,
)
from datagen.rgbd.images import read_colour
from datagen.schema import SPLITS

CAMERA, TRUTH = "scene_camera.json", "scene_gt.json"
_ENDINGS = (".png", ".jpg", ".jpeg")
_NUMBER = re.compile("[0-9]{1,12}")


@dataclass(frozen=True, eq=False)
class _Image:
    """Files and facts of one image."""

    number: int
    colour: Path
    depth: Path
    masks: list[Path]
    objects: list[dict[str, Any]]
    """Entries of scene_gt.json."""
    camera: dict[str, Any]

    @property
    def obj_ids(self) -> list[int]:
        return [each["obj_id"] for each in self.objects]


def find_bop(source: Path, options: ReadOptions) -> Found:
    """Find the scenes of a BOP dataset; see `interface.Importer`."""
    models = find_models(source)
    readers = [(split, _Reader(folder, models, options)) for split, folder in _scene_folders(source)]
    if not readers:
        raise UsageError(
            f"{source} holds no scene of BOP: expected {CAMERA} in it, in folders such as 000000, or in "
            "test/000000. The imagewise layout is not supported."
        )
    found = [Recording(str(reader.folder), split, reader.survey, reader.read) for split, reader in readers]
    return Found(found, "stills", _notes(models, {number for _, reader in readers for number in reader.obj_ids}))


def _notes(models: Models | None, used: set[int]) -> tuple[str, ...]:
    nameless = [f"obj_{number:06d}" for number in sorted(used) if models and models.symmetry(number) is None]
    if not nameless:
        return ()
    return (
        f"Symmetries of {', '.join(nameless):.300} are not about z; these objects count as having none, which makes "
        "errors of orientation larger.",
    )


def _scene_folders(source: Path) -> list[tuple[str | None, Path]]:
    if not source.is_dir():
        raise UsageError(f"{source} is no folder; expected that of a BOP dataset.")
    if _is_scene(source):
        return [(_split_of(source.parent.name), source)]
    inside = [path for path in sorted(source.iterdir()) if path.is_dir()]
    if scenes := [path for path in inside if _is_scene(path)]:
        return [(_split_of(source.name), path) for path in scenes]
    return [
        (split, path)
        for folder in inside
        for split in [_split_of(folder.name)]
        for path in sorted(folder.iterdir())
        if split and _is_scene(path)
    ]


def _is_scene(folder: Path) -> bool:
    """Whether a folder is a scene, perhaps an incomplete one, which must not be left out silently."""
    return any((folder / name).exists() for name in (CAMERA, TRUTH))


def _split_of(name: str) -> str | None:
    return next((split for split in SPLITS if re.match(rf"{split}(_|$)", name)), None)


class _Reader:
    """Images of one scene."""

    def __init__(self, folder: Path, models: Models | None, options: ReadOptions):
        self.folder, self._models, self._options = folder, models, options
        cameras = _by_number(read_object(folder / CAMERA), folder / CAMERA)
        has_masks = not options.ignore_masks and (folder / TRUTH).exists() and (folder / "mask_visib").is_dir()
        truth = _by_number(read_object(folder / TRUTH), folder / TRUTH) if has_masks else {}
        self._images = [_image(folder, number, cameras[number], truth.get(number)) for number in sorted(cameras)]
        self._has_masks = has_masks
        objects = [each for image in self._images for each in image.objects]
        self.obj_ids = {each["obj_id"] for each in objects}
        self._has_poses = has_masks and all("cam_R_m2c" in each for each in objects)
        if not self._images:
            raise UsageError(f"{folder / CAMERA} lists no images.")

    def survey(self) -> Facts:
        images = self._images
        masks = [path for image in images for path in image.masks]
        size = common_size([image.colour for image in images], [image.depth for image in images], masks)
        for image in images:
            check_intrinsics(self._k(image), size, f"{self.folder / CAMERA}, image {image.number}")
        most = max(len(image.obj_ids) for image in images)
        posed = all("cam_R_w2c" in image.camera for image in images)
        return Facts(len(images), 1, size, most if self._has_masks else None, posed)

    def read(self, images: Sequence[int]) -> Images:
        chosen = [self._images[place] for place in images]
        rgb = np.stack([read_colour(image.colour)[None] for image in chosen])
        cameras = [self._camera_from_world(image) for image in chosen]
        found = Images(
            rgb=rgb,
            depth=np.stack([read_metres(image.depth, self._scale(image))[None] for image in chosen]),
            k=np.stack([self._k(image)[None] for image in chosen]),
            world_from_camera=None
            if any(pose is None for pose in cameras)
            else invert_rigid(np.array(cameras)[:, None]),
        )
        if not self._has_masks:
            return found
        obj_ids = self._obj_ids(chosen)
        found = replace(
            found,
            ids=np.stack([_ids(image, rgb.shape[2:4])[None] for image in chosen]),
            categories={row + 1: f"obj_{number:06d}" for row, number in enumerate(obj_ids)},
        )
        if not self._has_poses:
            return found
        poses = [[self._pose(image, each, "m2c") for each in image.objects] for image in chosen]
        models = [self._models.model(number) for number in obj_ids] if self._models else None
        return replace(found, camera_from_object=np.reshape(poses, (len(chosen), 1, len(obj_ids), 4, 4)), models=models)

    def _obj_ids(self, chosen: Sequence[_Image]) -> list[int]:
        """The objects of several images, which must be the same in the same order to have ids over time."""
        longest = max((image.obj_ids for image in chosen), key=len)
        for image in chosen:
            if image.obj_ids != longest:
                raise UsageError(
                    f"{self.folder / TRUTH} lists other objects for image {image.number} than for image "
                    f"{chosen[0].number}, so that they cannot be followed; import with --group stills."
                )
        return longest

    def _scale(self, image: _Image) -> float:
        scale = numbers([image.camera.get("depth_scale", 1.0)], 1, f"{self.folder / CAMERA}: depth_scale")[0]
        return self._options.depth_scale or float(scale) * METRES

    def _k(self, image: _Image) -> Float64[np.ndarray, "3 3"]:
        return numbers(image.camera.get("cam_K"), 9, f"{self.folder / CAMERA}: cam_K").reshape(3, 3) + HALF_PIXEL

    def _camera_from_world(self, image: _Image) -> Float64[np.ndarray, "4 4"] | None:
        return self._pose(image, image.camera, "w2c") if "cam_R_w2c" in image.camera else None

    def _pose(self, image: _Image, values: dict[str, Any], frames: str) -> Float64[np.ndarray, "4 4"]:
        """Read a rotation and a translation; `frames` is m2c (camera from model) or w2c (camera from world)."""
        place = f"{self.folder / (CAMERA if frames == 'w2c' else TRUTH)}, image {image.number}: cam_"
        pose = np.eye(4)
        pose[:3, :3] = numbers(values.get(f"cam_R_{frames}"), 9, f"{place}R_{frames}").reshape(3, 3)
        pose[:3, 3] = METRES * numbers(values.get(f"cam_t_{frames}"), 3, f"{place}t_{frames}")
        if not is_rigid(pose):
            raise UsageError(
                f"{place}R_{frames} is no rotation matrix; expected nine numbers, row by row: orthonormal rows and "
                "determinant 1. Remove scale and shear."
            )
        check_pose(pose, f"{place}t_{frames}")
        return pose


def _by_number(values: dict[str, Any], path: Path) -> dict[int, Any]:
    """Values by image number; names that are no numbers would lead to files elsewhere."""
    if wrong := [name for name in values if not _NUMBER.fullmatch(name)]:
        raise CorruptFile(f"{path} has the image {wrong[0]!r:.60}; expected a number.")
    return {int(name): value for name, value in values.items()}


def _image(folder: Path, number: int, camera: Any, truth: Any) -> _Image:
    stem = f"{number:06d}"
    colour = next((path for end in _ENDINGS if (path := folder / "rgb" / f"{stem}{end}").exists()), None)
    if colour is None:
        raise missing_file(folder / "rgb" / f"{stem}.png")
    objects = [] if truth is None else truth
    if type(camera) is not dict or type(objects) is not list or not all(type(each) is dict for each in objects):
        raise CorruptFile(f"{folder}: the entries of image {number} in {CAMERA} or {TRUTH} are damaged.")
    obj_ids = [each.get("obj_id") for each in objects]
    if not all(type(each) is int and 0 <= each < 10**6 for each in obj_ids):
        raise CorruptFile(f"{folder / TRUTH}: image {number} has obj_id {obj_ids!r:.60}; expected numbers.")
    masks = [folder / "mask_visib" / f"{stem}_{row:06d}.png" for row in range(len(objects))]
    return _Image(number, colour, folder / "depth" / f"{stem}.png", masks, objects, camera)


def _ids(image: _Image, shape: tuple[int, int]) -> Int64[np.ndarray, "height width"]:
    """Ids of the visible parts, row in scene_gt.json plus 1."""
    ids = np.zeros(shape, np.int64)
    for row, path in enumerate(image.masks):
        ids[read_ids(path) > 0] = row + 1
    return ids
