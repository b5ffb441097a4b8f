"""Layouts of RGB-D frames: where a folder or an NPZ file holds the colour, depth, masks and poses of one camera.

rgb/*.png, depth/*.png, masks/*.png    folders; colour is also called color, colour or image
rgb.txt, depth.txt, groundtruth.txt    lists of times and files, and poses, as in TUM RGB-D
0001-color.png, 0001-depth.png, ...    one folder; the word may also come first, as in depth_0001.png, or be alone
frames.npz                             arrays rgb, depth, masks of one frame or several, K, and world_from_camera
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from datagen.errors import CorruptFile, UsageError
from datagen.rgbd.camera_file import CAMERA, MATRIX, MILLIMETRE, Camera
from datagen.rgbd.camera_pose import Pose, check_pose, read_pose
from datagen.rgbd.frame_files import list_frames, nearest_times, pair_frames, pair_masks, sort_frames
from datagen.storage.safe_io import npz_headers, read_npz, read_text

COLOUR, DEPTH, MASK = ("rgb", "color", "colour", "image", "images"), ("depth",), ("mask", "masks", "segmentation")
COLOUR_ENDINGS, DEPTH_ENDINGS = (".png", ".jpg", ".jpeg"), (".png", ".tif", ".tiff", ".npy", ".exr")
MASK_ENDINGS, POSE_ENDINGS = (".png",), (".txt", ".json", ".npy")
TUM_SCALE = 0.0002
"""Metres per unit of depth in recordings with `depth.txt`."""
_WORD = re.compile(rf"(?:(.*)[-_. ])?({'|'.join((*COLOUR, *DEPTH, *MASK, 'label'))})(?:[-_. ](.*))?")
"""Stem of a file in a mixed folder: what it shows, before or after the name of its frame."""


@dataclass(frozen=True, eq=False)
class FrameFiles:
    """Images of one camera in time order; each list has one for every frame, or is empty."""

    place: Path
    """Folder or NPZ file, for messages."""
    colour: list[Path]
    depth: list[Path]
    masks: list[Path]
    poses: Sequence[Path | Pose] = ()
    """world_from_camera, or files with it: none, one for all frames, or one for each."""
    camera: Path | None = None
    """File with the camera."""
    depth_scale: float = MILLIMETRE
    """Metres per unit of integer depth, if the camera's file does not say."""
    left_out: int = 0
    """Number of colour images without depth or pose at their time."""
    numbers: Sequence[int] = ()
    """Index of each frame among all colour images, if some were left out."""

    @property
    def images(self) -> int:
        """Number of all colour images."""
        return len(self.colour) + self.left_out

    def number(self, frame: int) -> int:
        """Index of a frame among all colour images, for lists in the camera's file."""
        return self.numbers[frame] if self.numbers else frame

    def pose(self, frame: int, camera: Camera) -> Pose | None:
        """Find world_from_camera of a frame, here or in the camera's file; None if unknown."""
        if not self.poses:
            return camera.pose(self.number(frame), self.images)
        found = self.poses[frame if len(self.poses) > 1 else 0]
        return read_pose(found, "") if isinstance(found, Path) else found


def find_frames(place: Path) -> FrameFiles | None:
    """Find the frames in a folder or an NPZ file; None if there is no colour.

    Raises:
        UsageError: images have no partner, or differ in number.
        CorruptFile: a list or an NPZ file is damaged.
    """
    if place.suffix.lower() == ".npz" and place.is_file():
        return _archive(place)
    if not place.is_dir():
        return None
    if (place / "rgb.txt").exists() and (place / "depth.txt").exists():
        found = _listed(place)
    else:
        found = _folders(place) or _mixed(place)
    if found is None:
        return None
    camera = next((folder / CAMERA for folder in (place, place.parent) if (folder / CAMERA).exists()), None)
    return replace(found, camera=camera)


def paired(place: Path, colour: list[Path], depth: list[Path], masks: list[Path]) -> FrameFiles:
    """Pair images of three folders or lists.

    Raises:
        UsageError: as `find_frames`.
    """
    if not depth:
        raise UsageError(f"{place} has colour but no depth; expected depth/*.png or depth.png.")
    partners = pair_frames(colour, depth, "depth images", place)
    labels = pair_masks(colour, masks, place) if masks else [None] * len(colour)
    rows = list(zip(colour, partners, labels, strict=True))
    kept = [number for number, (_, depth, mask) in enumerate(rows) if depth and (mask or not masks)]
    if not kept:
        raise UsageError(f"{place}: no colour image has a depth image of about the same time.")
    columns = zip(*(rows[number] for number in kept), strict=True)
    images, depths, labelled = ([path for path in column if path] for column in columns)
    return FrameFiles(place, images, depths, labelled, left_out=len(colour) - len(kept), numbers=kept)


def _folders(place: Path) -> FrameFiles | None:
    """Read folders named rgb, depth and so on."""
    colour = _entry(place, COLOUR, COLOUR_ENDINGS)
    if not colour:
        return None
    found = paired(place, colour, _entry(place, DEPTH, DEPTH_ENDINGS), _entry(place, MASK, MASK_ENDINGS))
    return replace(found, poses=_pose_files(place, len(found.colour)))


def _entry(folder: Path, names: Sequence[str], endings: Sequence[str]) -> list[Path]:
    found = next((folder / name for name in names if (folder / name).is_dir()), None)
    if found is not None:
        return list_frames([found], endings, "In")
    files = [folder / f"{name}{ending}" for name in names for ending in endings]
    return [path for path in files if path.exists()][:1]


def read_poses(path: Path, images: int) -> list[Pose]:
    """Read world_from_camera from one file for all images, or from a folder with a file for each.

    Raises:
        UsageError: files are missing, hold no rigid pose, or differ in number from the images.
        CorruptFile: one cannot be read.
    """
    if not path.is_dir():
        return [read_pose(path)]
    return [read_pose(each) for each in _pose_folder(path, images)]


def _pose_files(folder: Path, images: int) -> list[Path]:
    """Find `world_from_camera.*`, or the files of `poses/`, one for each image."""
    single = [folder / f"world_from_camera{ending}" for ending in POSE_ENDINGS]
    if found := [path for path in single if path.exists()]:
        return found[:1]
    return _pose_folder(folder / "poses", images) if (folder / "poses").is_dir() else []


def _pose_folder(folder: Path, images: int) -> list[Path]:
    poses = list_frames([folder], POSE_ENDINGS, "In")
    if len(poses) != images:
        raise UsageError(f"{folder} has {len(poses)} files for {images} images; expected one for each image.")
    return poses


def _mixed(place: Path) -> FrameFiles | None:
    """Read one folder of files such as 0001-color.png and 0001-depth.png."""
    kinds: dict[str, dict[str, Path]] = {"colour": {}, "depth": {}, "mask": {}}
    for path in sort_frames([path for path in place.iterdir() if path.is_file() and not path.name.startswith(".")]):
        match, ending = _WORD.fullmatch(path.stem.lower()), path.suffix.lower()
        if match is None or ending not in (*COLOUR_ENDINGS, *DEPTH_ENDINGS):
            continue
        kind = "colour" if match[2] in COLOUR else "depth" if match[2] in DEPTH else "mask"
        other = kinds[kind].setdefault(f"{match[1] or ''}{match[3] or ''}", path)
        if other is not path:
            raise UsageError(f"{other} and {path.name} would be the same {kind} image; remove or rename one of them.")
    colour, depth, masks = kinds.values()
    if not colour or not depth:
        return None
    if len(colour.keys() & depth.keys()) * 2 < len(colour):  # names with times of two sensors
        found = paired(place, list(colour.values()), list(depth.values()), list(masks.values()))
    else:
        for name, path in colour.items():
            if name not in depth or (masks and name not in masks):
                kind = "mask" if name in depth else "depth image"
                raise UsageError(f"{path} has no {kind} beside it; expected one for each colour image.")
        chosen = [[files[name] for name in colour] for files in (colour, depth, masks) if files]
        found = FrameFiles(place, chosen[0], chosen[1], chosen[2] if masks else [])
    return replace(found, poses=_pose_files(place, len(found.colour)))


def _listed(place: Path) -> FrameFiles:
    """Read lists of times and files, each colour image with the nearest depth image and pose."""
    colour, depth = (_rows(place / name, 2) for name in ("rgb.txt", "depth.txt"))
    times = [time for time, *_ in colour]
    partners = nearest_times(times, [time for time, *_ in depth])
    path = place / "groundtruth.txt"
    known = _rows(path, 8) if path.exists() else []
    placed = nearest_times(times, [time for time, *_ in known]) if known else [0] * len(times)
    rows = [
        (number, image[1], depth[partner][1], pose)
        for number, (image, partner, pose) in enumerate(zip(colour, partners, placed, strict=True))
        if partner is not None and pose is not None
    ]
    if not rows:
        raise UsageError(f"{place}: no image of rgb.txt has a depth image of about the same time in depth.txt.")
    return FrameFiles(
        place,
        colour=[place / image for _, image, _, _ in rows],
        depth=[place / partner for _, _, partner, _ in rows],
        masks=[],
        poses=[_trajectory_pose(known[pose], path) for *_, pose in rows] if known else [],
        depth_scale=TUM_SCALE,
        left_out=len(colour) - len(rows),
        numbers=[number for number, *_ in rows],
    )


def _rows(path: Path, columns: int) -> list[tuple]:
    """Read rows of a time and further columns; `#` starts a comment."""
    rows = [line.split() for line in read_text(path).splitlines() if line.strip() and not line.startswith("#")]
    try:
        if not rows or any(len(row) != columns or not math.isfinite(float(row[0])) for row in rows):
            raise ValueError
        return [(float(time), *rest) for time, *rest in rows]
    except ValueError:
        raise CorruptFile(f"{path} is damaged: expected rows of {columns} columns, a time first.") from None


def _trajectory_pose(row: tuple, path: Path) -> Pose:
    """Build a pose from a time, a translation, and a quaternion with the real part last."""
    pose = np.eye(4)
    try:
        values = np.array(row[1:], np.float64)
        pose[:3, :3], pose[:3, 3] = Rotation.from_quat(values[3:]).as_matrix(), values[:3]
    except ValueError:
        raise CorruptFile(f"{path} is damaged: the row of time {row[0]} holds no pose.") from None
    check_pose(pose, f"{path}, time {row[0]}")
    return pose


def _archive(place: Path) -> FrameFiles | None:
    """Read an NPZ file."""
    headers = npz_headers(place, (*COLOUR, *DEPTH, *MASK, *MATRIX, "world_from_camera"))
    colour, depth, mask = (next((name for name in names if name in headers), None) for names in (COLOUR, DEPTH, MASK))
    if colour is None:
        return None
    if depth is None:
        raise UsageError(f"{place} has the array {colour} but no depth; expected depth of height and width.")
    shape, count = headers[colour][0], None
    # An array of four axes holds many frames.
    if len(shape) == 4:
        count = shape[0]
        lengths = {name: headers[name][0][:1] for name in (depth, mask) if name}
        if wrong := [name for name, length in lengths.items() if length != (count,)]:
            raise UsageError(
                f"{place}: {colour} has {count} frames, {wrong[0]} another number; expected equal numbers."
            )
    if 0 in shape:
        raise UsageError(f"{place}: {colour} has shape {shape}, which holds no pixel; expected at least one frame.")
    # Frames, poses, and the file with the camera.
    lists = [_members(place, name, count) for name in (colour, depth, mask)]
    poses: list[Pose] = []
    if "world_from_camera" in headers:
        listed = read_npz(place, ["world_from_camera"])["world_from_camera"]
        if listed.dtype.kind not in "uif" or listed.shape not in ((4, 4), (1, 4, 4), (count or 1, 4, 4)):
            raise UsageError(
                f"{place}: world_from_camera has shape {listed.shape} and type {listed.dtype}; expected numbers, 4x4, "
                "or one for each frame."
            )
        poses = list(listed.reshape(-1, 4, 4).astype(np.float64))
        for pose in poses:
            check_pose(pose, f"{place}: world_from_camera")
    beside = place.parent / CAMERA
    camera = place if any(name in headers for name in MATRIX) else beside if beside.exists() else None
    return FrameFiles(place, *lists, poses=poses, camera=camera)


def _members(place: Path, name: str | None, count: int | None) -> list[Path]:
    if name is None:
        return []
    return [place / name] if count is None else [place / name / str(number) for number in range(count)]
