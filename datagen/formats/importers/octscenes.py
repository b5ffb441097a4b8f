"""OCTScenes: tabletop scenes filmed by a camera that goes around them, 60 images each.

    image*/SCENE_FRAME.png                 colour, such as image_128x128/0000_00.png
    depth*/SCENE_FRAME.png                 16 bits, millimetres
    segment*/SCENE_FRAME.png               optional ids, 0 = background; published for the test scenes only
    pose*/SCENE_FRAME.txt                  world_from_camera, 4x4; published with the 640x480 images
    intrinsic*.txt or intrinsic*/*.txt     3x3 or 4x4 camera matrix of these images

SRC is the folder of one image size, unpacked. The poses may be copied from another size.
"""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from datagen.errors import CorruptFile, UsageError
from datagen.formats.import_request import ReadOptions
from datagen.formats.importers.interface import Facts, Found, Images, Recording
from datagen.rgbd.camera_pose import read_pose
from datagen.rgbd.files import HALF_PIXEL, check_intrinsics, common_size, missing_file, read_ids, read_metres
from datagen.rgbd.images import read_colour
from datagen.storage.safe_io import read_text

_MILLIMETRE = 0.001
_NAME = re.compile(r"([0-9]{1,9})_([0-9]{1,9})")


@dataclass(frozen=True)
class _Folders:
    """Places of the files."""

    image: Path
    depth: Path
    segment: Path | None
    pose: Path | None
    intrinsic: Path


def find_octscenes(source: Path, options: ReadOptions) -> Found:
    """Find the scenes of OCTScenes; see `interface.Importer`."""
    folders = _folders(source, options)
    frames: defaultdict[int, list[Path]] = defaultdict(list)
    for path in sorted(folders.image.iterdir()):
        if match := _NAME.fullmatch(path.stem):
            frames[int(match[1])].append(path)
    if not frames:
        raise UsageError(f"{folders.image} holds no images called SCENE_FRAME.png, such as 0000_00.png.")
    recordings = []
    for scene in sorted(frames):
        reader = _Reader(folders, frames[scene], options)
        split = "test" if reader.has_masks else "train"
        recordings.append(Recording(f"{source} scene {scene}", split, reader.survey, reader.read))
    notes = (
        "Scenes with masks are the test split, the others the training split: published are test scenes 3100 to 3199 "
        "of OCTScenes-A and 4900 to 4999 of OCTScenes-B.",
    )
    return Found(recordings, "views" if folders.pose else "stills", notes)


def _folders(source: Path, options: ReadOptions) -> _Folders:
    if not source.is_dir():
        raise UsageError(f"{source} is no folder; expected that of one image size of OCTScenes, unpacked.")
    image, depth = _folder(source, "image"), _folder(source, "depth")
    if image is None or depth is None:
        raise UsageError(
            f"{source} has no folder {'depth*' if image else 'image*'}; expected the folder of one image size of "
            "OCTScenes, unpacked."
        )
    intrinsic = options.camera or next(iter(sorted(source.glob("intrinsic*"))), None)
    if intrinsic is None:
        raise UsageError(f"{source} has no intrinsic*.txt; unpack it there, or name such a file with --camera.")
    segment = _folder(source, "segment") if not options.ignore_masks else None
    return _Folders(image, depth, segment, _folder(source, "pose"), intrinsic)


def _folder(source: Path, name: str) -> Path | None:
    return next((path for path in sorted(source.glob(f"{name}*")) if path.is_dir()), None)


class _Reader:
    """Images of one scene."""

    def __init__(self, folders: _Folders, colours: list[Path], options: ReadOptions):
        self._folders, self._colours = folders, colours
        self._scale = options.depth_scale or _MILLIMETRE
        masks = [folders.segment / path.name for path in colours] if folders.segment else []
        self._masks = masks if any(path.exists() for path in masks) else []

    @property
    def has_masks(self) -> bool:
        return bool(self._masks)

    def survey(self) -> Facts:
        depths = [self._folders.depth / path.name for path in self._colours]
        size = common_size(self._colours, depths, self._masks)
        check_intrinsics(self._k(self._colours[0]), size, str(self._folders.intrinsic))
        for path in self._colours:
            if self._folders.pose and not self._pose_file(path).exists():
                raise missing_file(self._pose_file(path))
        ids = {int(one) for path in self._masks for one in np.unique(read_ids(path))} - {0}
        posed = self._folders.pose is not None
        return Facts(len(self._colours), 1, size, len(ids) if self._masks else None, posed)

    def read(self, images: Sequence[int]) -> Images:
        chosen = [self._colours[number] for number in images]
        return Images(
            rgb=np.stack([read_colour(path)[None] for path in chosen]),
            depth=np.stack([read_metres(self._folders.depth / path.name, self._scale)[None] for path in chosen]),
            k=np.stack([self._k(path)[None] for path in chosen]),
            world_from_camera=np.stack([read_pose(self._pose_file(path), "")[None] for path in chosen])
            if self._folders.pose
            else None,
            ids=np.stack([read_ids(self._masks[number])[None] for number in images]) if self._masks else None,
        )

    def _pose_file(self, colour: Path) -> Path:
        assert self._folders.pose
        return self._folders.pose / f"{colour.stem}.txt"

    def _k(self, colour: Path) -> Float64[np.ndarray, "3 3"]:
        place = self._folders.intrinsic
        path = place / f"{colour.stem}.txt" if place.is_dir() else place
        if place.is_dir() and not path.exists():
            path = next(iter(sorted(place.glob("*.txt"))), path)
        if not path.exists():
            raise missing_file(path)
        try:
            rows = [[float(word) for word in line.replace(",", " ").split()] for line in read_text(path).splitlines()]
            matrix = np.array([row for row in rows if row], np.float64)
        except ValueError:
            matrix = np.zeros(0)
        if matrix.shape not in ((3, 3), (3, 4), (4, 4)):
            raise CorruptFile(f"{path} holds no camera matrix; expected three or four rows of as many numbers.")
        return matrix[:3, :3] + HALF_PIXEL
