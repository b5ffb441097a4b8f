"""RGB-D recordings in plain image files: colour, depth, a camera, and optional poses and masks.

SRC is a recording, or holds recordings, or train/, val/ and test/ with recordings. A recording is a folder or an NPZ
file with the frames of a camera (`datagen.rgbd.layouts`), and:

    camera.json       intrinsics, unit of depth; here or in the folder above
    objects.json      optional names, [{"id": 1, "category": "mug"}, ...]

or it holds folders view*, each such a recording, of cameras that took the same frames.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from datagen.console.text import counted
from datagen.errors import CorruptFile, UsageError
from datagen.formats.import_request import ReadOptions
from datagen.formats.importers.interface import Facts, Found, Images, Recording
from datagen.rgbd.camera_file import CAMERA, Camera, read_camera
from datagen.rgbd.files import check_intrinsics, check_unit, common_size, read_ids
from datagen.rgbd.frame_files import sort_frames
from datagen.rgbd.images import holds_floats, read_colour
from datagen.rgbd.layouts import FrameFiles, find_frames
from datagen.schema import SPLITS
from datagen.storage.safe_io import read_json

OBJECTS = "objects.json"


def find_rgbd(source: Path, options: ReadOptions) -> Found:
    """Find recordings of RGB-D image files; see `interface.Importer`."""
    found, left_out, no_truth = [], 0, 0
    for split, name, views in _recordings(source):
        views = [_view(view, source, options) for view in views]
        cameras = [_camera(view, options) for view in views]
        kind = cameras[0].masks if views[0].masks else ""
        if options.predicted_masks and kind != "predicted":
            continue
        if not options.predicted_masks and kind in ("predicted", "foreground"):
            views, no_truth = [replace(view, masks=[]) for view in views], no_truth + 1
        left_out += sum(view.left_out for view in views)
        reader = _Reader(views, cameras)
        found.append(Recording(str(name), split, reader.survey, reader.read, reader.cameras[0].fps))
    if not found and options.predicted_masks:
        raise UsageError(f"{source} holds no recording whose {CAMERA} has a `mask` that begins with predicted.")
    if not found:
        raise UsageError(
            f"{source} holds no recording: expected rgb/*.png, depth/*.png and {CAMERA}, in it or in folders below it, "
            "or another layout of docs/import.md."
        )
    notes = []
    if left_out:
        notes.append(f"{counted(left_out, 'image')} without depth or pose at their time left out.")
    if no_truth:
        masks = f"Masks of {counted(no_truth, 'recording')} left out"
        notes.append(f"{masks}: predictions (see --predicted-masks), or objects are not told apart.")
    return Found(found, "clip", tuple(notes))


def _recordings(source: Path) -> list[tuple[str | None, Path, list[FrameFiles]]]:
    """Find split, place and views of all recordings."""
    if not source.exists():
        raise UsageError(f"{source} does not exist; expected a folder with recordings.")
    if views := _views(source):
        return [(None, source, views)]
    places = [(name, source / name) for name in SPLITS if (source / name).is_dir()] or [(None, source)]
    inside = [(split, path) for split, place in places if place.is_dir() for path in sorted(place.iterdir())]
    return [(split, path, views) for split, path in inside if (views := _views(path))]


def _views(place: Path) -> list[FrameFiles]:
    """Find the views of a recording; none if it is no recording."""
    if place.name.startswith("."):
        return []
    if views := sort_frames([path for path in place.glob("view*") if path.is_dir()]):
        found = [find_frames(view) for view in views]
        if None in found:
            raise UsageError(f"{views[found.index(None)]} holds no colour images; expected rgb/*.png or rgb.png.")
        return [view for view in found if view is not None]
    found = find_frames(place)
    return [] if found is None else [found]


def _view(view: FrameFiles, source: Path, options: ReadOptions) -> FrameFiles:
    camera = view.camera or next((path for path in (source / CAMERA,) if path.exists()), None)
    if camera is None and options.camera is None:
        raise UsageError(
            f"{view.place / CAMERA} is missing; it holds fx, fy, cx, cy and depth_scale, see docs/import.md."
        )
    return replace(view, masks=[] if options.ignore_masks else view.masks, camera=options.camera or camera)


def _camera(view: FrameFiles, options: ReadOptions) -> Camera:
    assert view.camera is not None
    scale, kind = options.depth_scale, options.depth_type
    return read_camera(view.camera, depth_scale=scale, depth_type=kind, default_scale=view.depth_scale)


class _Reader:
    """Images of one recording."""

    def __init__(self, views: list[FrameFiles], cameras: list[Camera]):
        self._views, self.cameras = views, cameras

    def survey(self) -> Facts:
        sizes = {view.place: common_size(view.colour, view.depth, view.masks) for view in self._views}
        first = self._views[0]
        for view, camera in zip(self._views, self.cameras, strict=True):
            if len(view.colour) != len(first.colour) or sizes[view.place] != sizes[first.place]:
                raise UsageError(
                    f"{view.place} has {len(view.colour)} images of {sizes[view.place]} pixels, but {first.place} "
                    f"has {len(first.colour)} of {sizes[first.place]}; expected equal numbers and sizes in all views."
                )
            if bool(view.masks) != bool(first.masks):
                raise UsageError(f"{view.place} and {first.place} differ in having masks; give masks for both.")
            if len(camera.lenses) not in (1, view.images):
                raise UsageError(
                    f"{view.camera}: K holds {len(camera.lenses)} matrices for {view.images} images; expected one for "
                    "all images, or one for each."
                )
            for k in camera.lenses:
                check_intrinsics(k, sizes[view.place], str(view.camera))
        masks = [path for view in self._views for path in view.masks]
        ids = {int(one) for path in masks for one in np.unique(read_ids(path))} - {0}
        posed = bool(first.poses) or self.cameras[0].poses is not None
        objects = len(ids) if masks else None
        return Facts(len(first.colour), len(self._views), sizes[first.place], objects, posed)

    def read(self, images: Sequence[int]) -> Images:
        views = list(zip(self._views, self.cameras, strict=True))
        poses = [[view.pose(frame, camera) for view, camera in views] for frame in images]
        known = [pose is not None for row in poses for pose in row]
        if any(known) and not all(known):
            raise UsageError(f"{self._views[0].place}: some views have poses and some have none; give all or none.")
        return Images(
            rgb=np.stack([[read_colour(view.colour[frame]) for view, _ in views] for frame in images]),
            depth=np.stack([[_depth(view, camera, frame) for view, camera in views] for frame in images]),
            k=np.stack([[camera.k(view.number(frame)) for view, camera in views] for frame in images]),
            world_from_camera=np.array(poses, np.float64) if all(known) else None,
            ids=np.stack([[read_ids(view.masks[frame]) for view, _ in views] for frame in images])
            if self._views[0].masks
            else None,
            categories=_categories(self._views[0].place) if self._views[0].masks else None,
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


def _depth(view: FrameFiles, camera: Camera, frame: int) -> np.ndarray:
    path = view.depth[frame]
    depth = camera.depth(path, view.number(frame))
    check_unit(depth, camera.float_scale if holds_floats(path) else camera.depth_scale, str(path))
    return depth
