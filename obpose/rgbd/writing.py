"""What a model found in a recording, as files: label images, images with the labels laid over them, poses as JSON."""

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
from obpose.rgbd.reading import Recording
from obpose.rgbd.world import Pose

OBJECTS = "objects.json"
OPACITY = 0.5
"""Of the labels over the image."""
GOLDEN = 0.618034
"""Hues that many turns apart are told apart, however many there are."""


@dataclass(frozen=True, eq=False)
class Found:
    """An object in one frame."""

    label: int
    pixels: int
    """That bear the label."""
    center: Float64[np.ndarray, "3"]
    """World frame, metres."""
    rotation: Float64[np.ndarray, "3 3"]
    """world_from_object."""
    box_size: float | None
    """Edge of its cube, metres; None where the model has none."""

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "label": self.label,
            "pixels": self.pixels,
            "center": _rounded(self.center),
            "rotation": _rounded(self.rotation),
            "box_size": self.box_size,
        }


def write_results(
    out: Path,
    recording: Recording,
    labels: Int[np.ndarray, "frame height width"],
    found: list[list[Found]],
    pose: Pose,
    facts: dict[str, Any],
) -> Path:
    """Write all files into a folder, numbered as the frames are; gives the JSON file.

    Args:
        out: The folder.
        recording: What was segmented.
        labels: 0 = background.
        found: The objects of each frame.
        pose: world_from_camera.
        facts: What else the JSON file says.
    """
    frames = []
    for i, (image, frame_labels, objects) in enumerate(zip(recording.rgb, labels, found, strict=True)):
        names = {"labels": f"{i:04d}_labels.png", "overlay": f"{i:04d}_overlay.png"}
        write_atomically(out / names["labels"], _png(label_image(frame_labels)))
        write_atomically(out / names["overlay"], _png(overlay(image, frame_labels, objects, recording.k, pose)))
        plain = [each.plain() for each in objects]
        frames.append({"rgb": str(recording.files[i]), **names, "objects": plain})
    page = {**facts, "world_from_camera": _rounded(pose), "frames": frames}
    write_atomically(out / OBJECTS, (json.dumps(page, indent=1) + "\n").encode())
    return out / OBJECTS


def label_image(labels: Int[np.ndarray, "height width"]) -> Image.Image:
    """Eight bits with a palette: a pixel's number is its label."""
    image = Image.fromarray(labels.astype(np.uint8))
    image.putpalette(colours(int(labels.max()) + 1).tobytes())
    return image


def overlay(
    rgb: UInt8[np.ndarray, "height width 3"],
    labels: Int[np.ndarray, "height width"],
    objects: list[Found],
    k: Float64[np.ndarray, "3 3"],
    pose: Pose,
) -> Image.Image:
    """The image with the objects in colours and the edges of their boxes."""
    palette = colours(int(max([labels.max(), *(each.label for each in objects)])) + 1)
    mixed = (1 - OPACITY) * rgb + OPACITY * palette[labels]
    image = Image.fromarray(np.where(labels[..., None] > 0, mixed, rgb).astype(np.uint8))
    draw = ImageDraw.Draw(image)
    for each in objects:
        for line in _box_edges(each, k, pose):
            draw.line(line, fill=tuple(palette[each.label].tolist()))
    return image


def colours(count: int) -> UInt8[np.ndarray, "label 3"]:
    """Colours of so many labels; the background's is black."""
    hues = [colorsys.hsv_to_rgb(GOLDEN * i % 1, 0.85, 1) for i in range(1, count)]
    return (255 * np.array([(0, 0, 0), *hues])).round().astype(np.uint8)


def _box_edges(each: Found, k: Float64[np.ndarray, "3 3"], pose: Pose) -> list[list[tuple[float, float]]]:
    """Edges of a box in pixels; none of a box that reaches behind the camera."""
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
