"""Files of a segmented recording: label images, overlays, point clouds, and boxes as JSON."""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from jaxtyping import Float, Integer, UInt8
from PIL import Image, ImageDraw

from datagen.geometry import invert_rigid, transform
from datagen.inspect.preview import save_mp4
from datagen.rgbd.camera_pose import Pose
from datagen.storage.atomic import check_new_folder, new_folder
from obpose.errors import UsageError
from obpose.pictures import PALETTE, Picture, box_edges, draw_box, draw_numbers, enlarged, png, tint
from obpose.rgbd.boxes import Box, upright_box
from obpose.rgbd.frames import PreparedFrames
from obpose.scenes.pictures import write_gif, write_png

OBJECTS_FILE, SUMMARY, ANIMATION, CLOUDS = "objects.json", "summary.png", "overlay", "clouds"
OPACITY = 0.5
"""Opacity of labels in overlays."""
WIDEST = 0.35
"""Greatest width of the upright box of an object in 100 validation scenes of `desk`, metres."""
LEAST_POINTS = 4
"""Objects with fewer pixels in a frame have no box and no point cloud there."""
_NEAREST = 0.01
"""Distance from the camera in metres below which nothing is drawn."""
LEAST_WIDTH = 320
"""Least width of overlays, pixels; narrower images are enlarged by a whole number, so that lines and digits fit."""
FPS = 10.0
"""Frames per second of the animation."""

_OWN = re.compile(
    rf"\d{{4,}}_(labels|overlay)\.png|{SUMMARY}|{ANIMATION}\.(mp4|gif)|{OBJECTS_FILE}|{CLOUDS}/\d{{4,}}_\d{{2,}}\.ply"
)
"""Paths of the files of a result, relative to its folder."""

Labels = Integer[np.ndarray, "height width"]


@dataclass(frozen=True, eq=False)
class SegmentedObject:
    """An object in one frame."""

    label: int
    pixels: int
    """Number of pixels with this label."""
    box: Box

    def to_json(self) -> dict[str, Any]:
        """Convert to plain JSON values."""
        values = {name: np.round(value, 6).tolist() for name, value in vars(self.box).items()}
        return {"label": self.label, "pixels": self.pixels, **values}


def objects_of(labels: Labels, points: Float[np.ndarray, "height width 3"]) -> list[SegmentedObject]:
    """Find the boxes of all objects of a frame, by label; points in the world frame, metres."""
    sizes = np.bincount(labels.ravel())
    return [
        SegmentedObject(int(label), int(sizes[label]), upright_box(points[labels == label]))
        for label in np.flatnonzero(sizes)
        if label > 0 and sizes[label] >= LEAST_POINTS
    ]


def width_warnings(objects: Sequence[Sequence[SegmentedObject]]) -> list[str]:
    """Warn, for the user, of objects that are wider than `WIDEST` in some frame; one list of objects per frame."""
    wide = sorted({each.label for found in objects for each in found if each.box.size[:2].max() > WIDEST})
    if not wide:
        return []
    where = "" if len(objects) == 1 else "in some frame "
    names = ", ".join(map(str, wide))
    these, they = (f"Label {names} is", "It") if len(wide) == 1 else (f"Labels {names} are", "Each")
    return [
        f"{these} {where}wider than any object of the dataset desk, {100 * WIDEST:.0f} cm. {they} may be several "
        "objects, or a part of a floor or wall; see --workspace and --depth-max."
    ]


def write_results(
    out: Path,
    frames: PreparedFrames,
    labels: UInt8[np.ndarray, "frame height width"],
    objects: Sequence[Sequence[SegmentedObject]],
    facts: dict[str, Any],
    *,
    overwrite: bool = False,
) -> None:
    """Write all files into a new folder, numbered by frame.

    `objects` are those of each frame, and `facts` additional entries of the JSON file. With `overwrite`, an earlier
    result in the folder is replaced once the new one is complete.

    Raises:
        UsageError: the folder is not empty, and holds other things than an earlier result.
        DatagenError: it cannot be written.
    """
    check_target(out, overwrite=overwrite)
    with new_folder(out, replace=overwrite) as folder:
        _write(folder, frames, labels, objects, facts)
        check_target(out, overwrite=overwrite)


def check_target(out: Path, *, overwrite: bool) -> None:
    """Check that results may be written to a folder.

    Raises:
        UsageError: it is not empty, and `overwrite` is not set, or it holds other things than an earlier result.
    """
    if not out.is_dir() or not any(out.iterdir()):
        check_new_folder(out)
        return
    inside = [path for path in (*out.iterdir(), *(out / CLOUDS).glob("*")) if path != out / CLOUDS]
    names = {path.relative_to(out).as_posix(): path for path in inside}
    foreign = sorted(name for name, path in names.items() if not (_OWN.fullmatch(name) and path.is_file()))
    earlier = not foreign and (out / OBJECTS_FILE).is_file()
    if not overwrite and earlier:
        raise UsageError(
            f"{out} already exists and is not empty; give another --out, or --overwrite to replace the earlier result, "
            "nothing was changed."
        )
    if not overwrite:
        check_new_folder(out)
    elif not earlier:
        what = f"also holds {foreign[0]}" if foreign else f"holds no {OBJECTS_FILE}"
        raise UsageError(
            f"--overwrite replaces earlier results of obpose-segment only, and {out} {what}; give another --out, "
            "nothing was changed."
        )


def _write(
    folder: Path,
    frames: PreparedFrames,
    labels: UInt8[np.ndarray, "frame height width"],
    objects: Sequence[Sequence[SegmentedObject]],
    facts: dict[str, Any],
) -> None:
    recording, entries, overlays = frames.recording, [], []
    (folder / CLOUDS).mkdir()
    for i, (image, frame_labels, found) in enumerate(zip(recording.rgb, labels, objects, strict=True)):
        points = frames.points(i)
        overlays.append(overlay(image, frame_labels, found, frames, i))
        names = {"labels": f"{i:04d}_labels.png", "overlay": f"{i:04d}_overlay.png"}
        (folder / names["labels"]).write_bytes(png(label_image(frame_labels)))
        write_png(folder / names["overlay"], overlays[-1])
        plain = []
        for each in found:
            mask, cloud = frame_labels == each.label, f"{CLOUDS}/{i:04d}_{each.label:02d}.ply"
            trimesh.PointCloud(points[mask], colors=image[mask]).export(folder / cloud)
            plain.append({**each.to_json(), "cloud": cloud})
        pose = frames.world.poses[i].round(6).tolist()
        entries.append({"rgb": str(recording.files[i]), "world_from_camera": pose, **names, "objects": plain})
    first = enlarged(recording.rgb[0], _scale(recording.rgb[0]))
    write_png(folder / SUMMARY, np.concatenate([first, overlays[0]], axis=1))
    if len(overlays) > 1:
        try:
            save_mp4(folder / f"{ANIMATION}.mp4", overlays, FPS)
        except UsageError:  # there is no codec
            write_gif(folder / f"{ANIMATION}.gif", overlays, fps=FPS)
    table = {"outline": frames.workspace.outline.round(4).tolist(), "least_height": round(frames.workspace.floor, 5)}
    page = {**facts, "table": table, "frames": entries}
    (folder / OBJECTS_FILE).write_text(json.dumps(page, indent=1) + "\n")


def label_image(labels: Labels) -> Image.Image:
    """Make an 8-bit image with a palette, whose pixel values are the labels."""
    image = Image.fromarray(labels.astype(np.uint8))
    image.putpalette(PALETTE.tobytes())
    return image


def overlay(
    rgb: UInt8[np.ndarray, "height width 3"],
    labels: Labels,
    objects: Sequence[SegmentedObject],
    frames: PreparedFrames,
    number: int,
) -> UInt8[np.ndarray, "rows columns 3"]:
    """Draw the labels over the image, the outline of the table in white, and the edges of the objects' boxes.

    Images narrower than `LEAST_WIDTH` are enlarged first.
    """
    scale = _scale(rgb)
    image = Image.fromarray(enlarged(tint(rgb, labels, OPACITY), scale))
    k, pose = np.diag([scale, scale, 1.0]) @ frames.recording.k, frames.world.poses[number]
    width = max(1, image.width // LEAST_WIDTH)
    outline = np.pad(frames.workspace.outline, ((0, 0), (0, 1)))
    _draw_outline(image, outline, k, pose, width)
    for each in objects:
        box = (each.box.center, each.box.rotation, each.box.size)
        edges = box_edges(*(torch.from_numpy(array.astype(np.float64)) for array in box))
        draw_box(image, edges, each.label, k=torch.from_numpy(k), pose=torch.from_numpy(pose), width=width)
    draw_numbers(image, np.where(np.isin(labels, [each.label for each in objects]), labels, 0), scale)
    return np.asarray(image)


def _scale(image: Picture) -> int:
    return math.ceil(LEAST_WIDTH / image.shape[1])


def _draw_outline(
    image: Image.Image, corners: Float[np.ndarray, "corner 3"], k: np.ndarray, pose: Pose, width: int
) -> None:
    """Draw the visible part of a convex polygon as a closed line; along the image's border where it goes on outside."""
    right, low = (side - width for side in image.size)
    sides = np.array(
        [(0, 0, 1, -_NEAREST), (1, 0, -width, 0), (-1, 0, right, 0), (0, 1, -width, 0), (0, -1, low, 0)], np.float64
    )
    corners = transform(invert_rigid(pose), corners) @ k.T
    for *normal, offset in sides:
        corners = _clipped(corners, corners @ normal + offset)
    if len(corners):
        pixels = corners[:, :2] / corners[:, 2:]
        ImageDraw.Draw(image).line([*map(tuple, pixels.tolist()), tuple(pixels[0].tolist())], fill="white", width=width)


def _clipped(corners: Float[np.ndarray, "corner 3"], inside: Float[np.ndarray, "corner"]) -> np.ndarray:
    """Cut off the part of a polygon where a linear function is negative (Sutherland and Hodgman 1974)."""
    kept = []
    for start, end, here, there in zip(corners, np.roll(corners, -1, axis=0), inside, np.roll(inside, -1), strict=True):
        if here >= 0:
            kept.append(start)
        if (here >= 0) != (there >= 0):
            kept.append(start + here / (here - there) * (end - start))
    return np.array(kept).reshape(-1, 3)
