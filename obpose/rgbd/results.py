"""Files of a segmented recording: label images, overlays, and object poses as JSON."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64, Int, UInt8
from PIL import Image

from datagen.rgbd.camera_pose import Pose
from datagen.storage.atomic import write_atomically
from obpose.pictures import PALETTE, box_edges, draw_box, png, tint
from obpose.rgbd.recording import Recording

OBJECTS_FILE = "objects.json"
OPACITY = 0.5
"""Opacity of labels in overlays."""


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

    Labels are 0 for the background, `pose` is world_from_camera, and `facts` are additional entries of the JSON file.
    """
    frames = []
    for i, (image, frame_labels, frame_objects) in enumerate(zip(recording.rgb, labels, objects, strict=True)):
        names = {"labels": f"{i:04d}_labels.png", "overlay": f"{i:04d}_overlay.png"}
        write_atomically(out / names["labels"], png(label_image(frame_labels)))
        write_atomically(out / names["overlay"], png(overlay(image, frame_labels, frame_objects, recording.k, pose)))
        plain = [each.to_json() for each in frame_objects]
        frames.append({"rgb": str(recording.files[i]), **names, "objects": plain})
    page = {**facts, "world_from_camera": _rounded(pose), "frames": frames}
    write_atomically(out / OBJECTS_FILE, (json.dumps(page, indent=1) + "\n").encode())
    return out / OBJECTS_FILE


def label_image(labels: Int[np.ndarray, "height width"]) -> Image.Image:
    """Make an 8-bit image with a palette, whose pixel values are the labels."""
    image = Image.fromarray(labels.astype(np.uint8))
    image.putpalette(PALETTE.tobytes())
    return image


def overlay(
    rgb: UInt8[np.ndarray, "height width 3"],
    labels: Int[np.ndarray, "height width"],
    objects: list[SegmentedObject],
    k: Float64[np.ndarray, "3 3"],
    pose: Pose,
) -> Image.Image:
    """Draw the labels over the image, and the edges of the objects' boxes."""
    image = Image.fromarray(tint(rgb, labels, OPACITY))
    intrinsics, camera = torch.from_numpy(k), torch.from_numpy(pose)
    for each in objects:
        if each.box_size is not None:
            box = torch.from_numpy(each.center), torch.from_numpy(each.rotation)
            draw_box(image, box_edges(*box, each.box_size), each.label, k=intrinsics, pose=camera)
    return image


def _rounded(values: np.ndarray) -> list[Any]:
    return np.asarray(values, np.float64).round(6).tolist()
