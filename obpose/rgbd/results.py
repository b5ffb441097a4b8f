"""Files of a segmented recording: label images, overlays, and object poses as JSON."""

import colorsys
import json
from dataclasses import dataclass
from io import BytesIO
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int, UInt8
from PIL import Image, ImageDraw

from datagen.storage.atomic import write_atomically
from obpose.rgbd.camera_pose import Pose
from obpose.rgbd.recording import Recording

OBJECTS_FILE = "objects.json"
OPACITY = 0.5
"""Opacity of labels in overlays."""
HUE_STEP = 0.618034
"""Golden-ratio hue step, which keeps any number of labels distinct."""


@dataclass(frozen=True, eq=False)
class SegmentedObject:
    """An object in one frame."""

    label: int
    pixels: int
    """Number of pixels with this label."""
    center: Float64[np.ndarray, "3"]
    """World frame, metres."""
    rotation: Float64[np.ndarray, "3 3"]
    """world_from_object."""
    box_size: float | None
    """Edge length of its cube, metres; None if the model has no boxes."""

    def to_json(self) -> dict[str, Any]:
        """Convert to plain JSON values."""
        return {**vars(self), "center": _rounded(self.center), "rotation": _rounded(self.rotation)}


def write_results(
    out: Path,
    recording: Recording,
    labels: Int[np.ndarray, "frame height width"],
    objects: list[list[SegmentedObject]],
    pose: Pose,
    facts: dict[str, Any],
) -> Path:
    """Write all files into a folder, numbered by frame, and give the path of the JSON file.

    Args:
        out: The folder.
        recording: The segmented frames.
        labels: Labels of all pixels, 0 = background.
        objects: Objects of each frame.
        pose: world_from_camera.
        facts: Additional entries of the JSON file.
    """
    frames = []
    for i, (image, frame_labels, frame_objects) in enumerate(zip(recording.rgb, labels, objects, strict=True)):
        names = {"labels": f"{i:04d}_labels.png", "overlay": f"{i:04d}_overlay.png"}
        write_atomically(out / names["labels"], _png(label_image(frame_labels)))
        write_atomically(out / names["overlay"], _png(overlay(image, frame_labels, frame_objects, recording.k, pose)))
        plain = [each.to_json() for each in frame_objects]
        frames.append({"rgb": str(recording.files[i]), **names, "objects": plain})
    page = {**facts, "world_from_camera": _rounded(pose), "frames": frames}
    write_atomically(out / OBJECTS_FILE, (json.dumps(page, indent=1) + "\n").encode())
    return out / OBJECTS_FILE


def label_image(labels: Int[np.ndarray, "height width"]) -> Image.Image:
    """Make an 8-bit image with a palette, whose pixel values are the labels."""
    image = Image.fromarray(labels.astype(np.uint8))
    image.putpalette(label_colours(int(labels.max()) + 1).tobytes())
    return image


def overlay(
    rgb: UInt8[np.ndarray, "height width 3"],
    labels: Int[np.ndarray, "height width"],
    objects: list[SegmentedObject],
    k: Float64[np.ndarray, "3 3"],
    pose: Pose,
) -> Image.Image:
    """Draw the labels over the image, and the edges of the objects' boxes."""
    palette = label_colours(int(max([labels.max(), *(each.label for each in objects)])) + 1)
    mixed = (1 - OPACITY) * rgb + OPACITY * palette[labels]
    image = Image.fromarray(np.where(labels[..., None] > 0, mixed, rgb).astype(np.uint8))
    draw = ImageDraw.Draw(image)
    for each in objects:
        for line in _box_edges(each, k, pose):
            draw.line(line, fill=tuple(palette[each.label].tolist()))
    return image


def label_colours(count: int) -> UInt8[np.ndarray, "label 3"]:
    """Colours of the labels 0 to `count - 1`; the background is black."""
    hues = [colorsys.hsv_to_rgb(HUE_STEP * i % 1, 0.85, 1) for i in range(1, count)]
    return (255 * np.array([(0, 0, 0), *hues])).round().astype(np.uint8)


def _box_edges(each: SegmentedObject, k: Float64[np.ndarray, "3 3"], pose: Pose) -> list[list[tuple[float, float]]]:
    """Project the edges of a box to pixels; empty if the box reaches behind the camera."""
    if each.box_size is None:
        return []
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    corners = each.center + signs * each.box_size / 2 @ each.rotation.T
    local = (corners - pose[:3, 3]) @ pose[:3, :3] @ k.T
    if local[:, 2].min() <= 0:
        return []
    pixels = [(float(x), float(y)) for x, y in local[:, :2] / local[:, 2:]]
    return [[pixels[a], pixels[b]] for a, b in combinations(range(8), 2) if np.sum(signs[a] != signs[b]) == 1]


def _png(image: Image.Image) -> bytes:
    file = BytesIO()
    image.save(file, "PNG")
    return file.getvalue()


def _rounded(values: np.ndarray) -> list[Any]:
    return np.asarray(values, np.float64).round(6).tolist()
