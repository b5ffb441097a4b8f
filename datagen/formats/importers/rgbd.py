"""RGB-D recordings in plain image files: colour, depth, a camera, and optional poses and masks.

SRC is a recording, or holds recordings, or train/, val/ and test/ with recordings. A recording is a folder:

    rgb/*.png or rgb.png          colour; also called color or image; PNG or JPEG
    depth/*.png or depth.png      PNG or TIFF of 16 bits, or TIFF or NPY of floats, usually metres
    camera.json                   intrinsics, unit of depth; here or in the folder above
    masks/*.png or mask.png       optional object ids, 0 = background
    objects.json                  optional names, [{"id": 1, "category": "mug"}, ...]
    poses/*.txt                   optional world_from_camera of each image, 4x4; or one world_from_camera.txt

or it holds folders view*, each such a recording, of cameras that took the same frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from datagen.errors import CorruptFile, UsageError
from datagen.formats.import_request import ReadOptions
from datagen.formats.importers.files import check_intrinsics, check_unit, common_size, planar_depth, read_ids
from datagen.formats.importers.interface import Facts, Found, Images, Recording
from datagen.formats.importers.rgbd_camera import RgbdCamera, read_camera
from datagen.rgbd.camera_pose import check_pose, pose_matrix, read_pose
from datagen.rgbd.frame_files import check_pairs, list_frames
from datagen.rgbd.images import holds_floats, read_colour, read_depth
from datagen.schema import SPLITS
from datagen.storage.safe_io import read_json

CAMERA, OBJECTS = "camera.json", "objects.json"
_COLOUR, _DEPTH, _MASK = ("rgb", "color", "colour", "image", "images"), ("depth",), ("mask", "masks", "segmentation")
_COLOUR_ENDINGS, _DEPTH_ENDINGS, _MASK_ENDINGS = (".png", ".jpg", ".jpeg"), (".png", ".tif", ".tiff", ".npy"), (".png",)
_POSE_ENDINGS = (".txt", ".json", ".npy")


@dataclass(frozen=True)
class _View:
    """Files of one camera."""

    folder: Path
    colour: list[Path]
    depth: list[Path]
    masks: list[Path]
    poses: list[Path]
    """None, one for all images, or one for each."""
    camera: Path


def find_rgbd(source: Path, options: ReadOptions) -> Found:
    """Find recordings of RGB-D image files; see `interface.Importer`."""
    found = [
        Recording(str(folder), split, reader.survey, reader.read, read_camera(views[0].camera, options).fps)
        for split, folder in _recording_folders(source)
        for views in [_views(folder, source, options)]
        for reader in [_Reader(views, options)]
    ]
    if not found:
        raise UsageError(
            f"{source} holds no recording: expected rgb/*.png, depth/*.png and {CAMERA}, in it or in folders below it."
        )
    return Found(found, "clip")


def _recording_folders(source: Path) -> list[tuple[str | None, Path]]:
    if not source.is_dir():
        raise UsageError(f"{source} is no folder; expected one with recordings.")
    if _is_recording(source):
        return [(None, source)]
    places = [(name, source / name) for name in SPLITS if (source / name).is_dir()] or [(None, source)]
    return [(split, folder) for split, place in places for folder in sorted(place.iterdir()) if _is_recording(folder)]


def _is_recording(folder: Path) -> bool:
    if not folder.is_dir() or folder.name.startswith("."):
        return False
    return bool(_entry(folder, _COLOUR, _COLOUR_ENDINGS) or _view_folders(folder))


def _view_folders(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("view*") if path.is_dir())


def _entry(folder: Path, names: Sequence[str], endings: Sequence[str]) -> Path | None:
    """Find the folder or the single file of one of these names."""
    candidates = [folder / f"{name}{ending}" for name in names for ending in ("", *endings)]
    return next((path for path in candidates if path.exists()), None)


def _views(folder: Path, source: Path, options: ReadOptions) -> list[_View]:
    return [_view(place, source, options) for place in _view_folders(folder) or [folder]]


def _view(folder: Path, source: Path, options: ReadOptions) -> _View:
    colour = _files(folder, _COLOUR, _COLOUR_ENDINGS)
    depth = _files(folder, _DEPTH, _DEPTH_ENDINGS)
    masks = _files(folder, _MASK, _MASK_ENDINGS) if not options.ignore_masks else []
    if not depth:
        raise UsageError(f"{folder} has colour but no depth; expected depth/*.png or depth.png.")
    for kind, files in (("depth images", depth), ("masks", masks)):
        if files and len(files) != len(colour):
            raise UsageError(
                f"{folder} has {len(colour)} colour images but {len(files)} {kind}; expected one for each. Add the "
                "missing ones, or remove the images without a partner."
            )
        if len(files) > 1:
            check_pairs(colour, files)
    camera = next((path / CAMERA for path in (folder, folder.parent, source) if (path / CAMERA).exists()), None)
    if camera is None and options.camera is None:
        raise UsageError(f"{folder / CAMERA} is missing; it holds fx, fy, cx, cy and depth_scale, see docs/import.md.")
    return _View(folder, colour, depth, masks, _pose_files(folder, len(colour)), options.camera or camera or folder)


def _files(folder: Path, names: Sequence[str], endings: Sequence[str]) -> list[Path]:
    entry = _entry(folder, names, endings)
    if entry is None:
        return []
    return list_frames([entry], endings, "In") if entry.is_dir() else [entry]


def _pose_files(folder: Path, images: int) -> list[Path]:
    single = next((folder / f"world_from_camera{ending}" for ending in _POSE_ENDINGS
                   if (folder / f"world_from_camera{ending}").exists()), None)  # fmt: skip
    if single:
        return [single]
    poses = list_frames([folder / "poses"], _POSE_ENDINGS, "In") if (folder / "poses").is_dir() else []
    if poses and len(poses) != images:
        raise UsageError(f"{folder / 'poses'} has {len(poses)} files for {images} images; expected one for each image.")
    return poses


class _Reader:
    """Images of one recording."""

    def __init__(self, views: list[_View], options: ReadOptions):
        self._views = views
        self._cameras = [read_camera(view.camera, options) for view in views]

    def survey(self) -> Facts:
        sizes = {view.folder: common_size(view.colour, view.depth, view.masks) for view in self._views}
        first = self._views[0]
        for view, camera in zip(self._views, self._cameras, strict=True):
            if len(view.colour) != len(first.colour) or sizes[view.folder] != sizes[first.folder]:
                raise UsageError(
                    f"{view.folder} has {len(view.colour)} images of {sizes[view.folder]} pixels, but {first.folder} "
                    f"has {len(first.colour)} of {sizes[first.folder]}; expected equal numbers and sizes in all views."
                )
            if bool(view.masks) != bool(first.masks):
                raise UsageError(f"{view.folder} and {first.folder} differ in having masks; give masks for both.")
            if len(camera.k) not in (1, len(view.colour)):
                raise UsageError(
                    f"{view.camera}: K holds {len(camera.k)} matrices for {len(view.colour)} images; expected one for "
                    "all images, or one for each."
                )
            for k in camera.k:
                check_intrinsics(k, sizes[view.folder], str(view.camera))
        masks = [path for view in self._views for path in view.masks]
        ids = {int(one) for path in masks for one in np.unique(read_ids(path))} - {0}
        posed = bool(first.poses) or self._cameras[0].poses is not None
        objects = len(ids) if masks else None
        return Facts(len(first.colour), len(self._views), sizes[first.folder], objects, posed)

    def read(self, images: Sequence[int]) -> Images:
        views = list(zip(self._views, self._cameras, strict=True))
        poses = [[_pose(view, camera, number) for view, camera in views] for number in images]
        known = [pose is not None for row in poses for pose in row]
        if any(known) and not all(known):
            raise UsageError(f"{self._views[0].folder}: some views have poses and some have none; give all or none.")
        return Images(
            rgb=np.stack([[read_colour(view.colour[number]) for view, _ in views] for number in images]),
            depth=np.stack(
                [[_depth(view.depth[number], camera, number) for view, camera in views] for number in images]
            ),
            k=np.stack([[camera.k_of(number) for _, camera in views] for number in images]),
            world_from_camera=np.array(poses, np.float64) if all(known) else None,
            ids=np.stack([[read_ids(view.masks[number]) for view, _ in views] for number in images])
            if self._views[0].masks
            else None,
            categories=_categories(self._views[0].folder) if self._views[0].masks else None,
        )


def _categories(folder: Path) -> dict[int, str] | None:
    """Names of objects by their ids, from the recording's folder or, for views, the one above; None if unknown."""
    path = next((place / OBJECTS for place in (folder, folder.parent) if (place / OBJECTS).exists()), None)
    if path is None:
        return None
    values = read_json(path)
    if not isinstance(values, list) or not all(type(each) is dict and type(each.get("id")) is int for each in values):
        raise CorruptFile(f"{path} is damaged: expected a list of objects with id and category.")
    return {each["id"]: str(each.get("category", "")) for each in values}


def _depth(path: Path, camera: RgbdCamera, image: int) -> np.ndarray:
    depth, scale = read_depth(path, camera.depth_scale), camera.depth_scale
    if holds_floats(path):
        scale = camera.float_scale
        depth = depth * np.float32(scale)
    check_unit(depth, scale, str(path))
    return planar_depth(depth, camera.k_of(image)) if camera.euclidean else depth


def _pose(view: _View, camera: RgbdCamera, number: int) -> Float64[np.ndarray, "4 4"] | None:
    if view.poses:
        return read_pose(view.poses[number if len(view.poses) > 1 else 0], "")
    if camera.poses is None:
        return None
    try:
        listed = camera.poses if np.ndim(camera.poses) == 2 else camera.poses[number]
    except (ValueError, TypeError, LookupError):
        raise CorruptFile(
            f"{view.camera}: world_from_camera holds no pose for image {number}; expected one 4x4 matrix, or one for "
            "each image."
        ) from None
    pose = pose_matrix(listed)
    check_pose(pose, f"{view.camera}: world_from_camera")
    return pose
