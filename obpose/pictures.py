"""What a model makes of clips, as one picture: image, attention masks, segmentation, reconstruction, boxes."""

import io
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from PIL import Image, ImageDraw
from torch import Tensor

from datagen.storage.atomic import write_atomically
from obpose.config import Views
from obpose.data.clips import views_apart
from obpose.geometry import all_rays, from_box
from obpose.model.nerf.compose import mean_colour
from obpose.trainable import Trainable
from obpose.types import Boxes, Decoded, Inference, Observation, SceneSegmentation, Segmentation

TILE = 192
"""Images are enlarged by a whole number to about so many pixels."""
TINT = 0.65
"""How much of a labelled pixel's colour is its label's."""
COLUMNS = ("image", "attention", "segmentation", "reconstruction", "boxes")
HEADER = 16
PALETTE = np.array(
    [
        (0, 0, 0),
        (230, 60, 60),
        (60, 130, 230),
        (70, 190, 80),
        (245, 190, 40),
        (170, 80, 200),
        (40, 200, 200),
        (245, 120, 30),
        (220, 110, 180),
        (140, 160, 40),
        (130, 90, 60),
    ],
    np.uint8,
)
"""Colours of labels; the background has none, more slots begin again at the second."""

Picture = UInt8[np.ndarray, "height width 3"]
"""sRGB."""


@runtime_checkable
class Decodes(Protocol):
    """A model whose fields have colours, and which can be reconstructed from."""

    def decode(
        self, inference: Inference, points: Tensor, directions: Tensor, colours: Literal["with", "without"]
    ) -> Decoded:
        """Densities and colours at world points."""
        ...


def write_picture(path: Path, model: Trainable, clips: Observation, views: Views) -> None:
    """Draw first and last frame of each clip, in every view where models are given one view at a time."""
    was_training = model.training
    model.eval()
    try:
        picture = draw(model, clips if views == "together" else views_apart(clips))
    finally:
        model.train(was_training)
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "png")
    write_atomically(path, file.getvalue())


@torch.no_grad()
def draw(model: Trainable, clips: Observation) -> Picture:
    """One row for each shown frame, under a line of titles."""
    segmentation = model.segment(clips)
    rebuilt = None
    if isinstance(model, Decodes) and isinstance(segmentation, SceneSegmentation):
        rebuilt = reconstruct(model, clips, segmentation.inference)
    last = clips.depth.shape[1] - 1
    rows = [
        np.concatenate(_row(clips, segmentation, rebuilt, clip, frame), axis=1)
        for clip in range(len(clips.depth))
        for frame in sorted({0, last})
    ]
    shown = {"reconstruction": rebuilt is not None, "boxes": isinstance(segmentation, SceneSegmentation)}
    names = [name for name in COLUMNS if shown.get(name, True)]
    return np.concatenate([_titles(names, rows[0].shape[1]), *rows])


def reconstruct(
    model: Decodes, clips: Observation, inference: Inference
) -> Float[Tensor, "batch frame view height width 3"]:
    """Colours of the composed fields at the observed surfaces, 0 where nothing was observed."""
    rays = all_rays(clips)
    points = rays.origin + rays.direction * rays.depth[..., None]
    decoded = model.decode(inference, points, rays.direction, "with")
    assert decoded.colours is not None
    colours = mean_colour(decoded.logits, decoded.colours) * rays.valid[..., None]
    return colours.reshape(clips.rgb.shape)


def tint(image: Picture, labels: Int[np.ndarray, "height width"]) -> Picture:
    """An image with its labels' colours; the background stays as it is."""
    place = np.where(labels > 0, 1 + (labels - 1) % (len(PALETTE) - 1), 0)
    mixed = (1 - TINT) * image + TINT * PALETTE[place]
    return np.where(labels[..., None] > 0, mixed, image).astype(np.uint8)


def box_edges(boxes: Boxes, clip: int, frame: int) -> Float[Tensor, "slot edge 2 3"]:
    """Both ends of the twelve edges of each box, world frame, metres."""
    corners = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3).to(boxes.center)
    slots = boxes.center.shape[2]
    world = from_box(corners.expand(slots, 8, 3), boxes.center[clip, frame], boxes.rotation[clip, frame], boxes.size)
    # Corners of an edge differ in one coordinate, which is one bit of their numbers.
    edges = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
    return world[:, torch.tensor(edges)]


def _row(
    clips: Observation, segmentation: Segmentation, rebuilt: Tensor | None, clip: int, frame: int
) -> list[Picture]:
    image = _bytes(clips.rgb[clip, frame, 0])
    labels = segmentation.labels[clip, frame, 0].cpu().numpy()
    attention = segmentation.attention[clip, frame, 0].cpu().numpy()
    tiles = [image, tint(image, attention), tint(image, labels)]
    if rebuilt is not None:
        tiles.append(_bytes(rebuilt[clip, frame, 0]))
    factor = max(1, round(TILE / image.shape[0]))
    large = [_enlarge(tile, factor) for tile in tiles]
    if not isinstance(segmentation, SceneSegmentation):
        return large
    shown = segmentation.labels[clip].unique().tolist()
    boxes = _draw_boxes(_enlarge(image, factor), factor, clips, segmentation.inference.boxes, clip, frame, shown)
    return [*large, boxes]


def _draw_boxes(
    image: Picture, factor: int, clips: Observation, boxes: Boxes, clip: int, frame: int, shown: list[int]
) -> Picture:
    """Wires of the boxes of slots that are seen in the clip, as far as they lie before the camera."""
    canvas = Image.fromarray(image)
    pen = ImageDraw.Draw(canvas)
    pose, k = clips.world_from_camera[clip, 0], clips.k[clip, 0]
    in_camera = (box_edges(boxes, clip, frame) - pose[:3, 3]) @ pose[:3, :3]
    pixels = (in_camera @ k.T)[..., :2] / in_camera[..., 2:].clamp(min=1e-6) * factor
    for slot in range(len(pixels)):
        if slot + 1 not in shown:
            continue
        colour = tuple(PALETTE[1 + slot % (len(PALETTE) - 1)].tolist())
        for ends, depths in zip(pixels[slot].tolist(), in_camera[slot, :, :, 2].tolist(), strict=True):
            if min(depths) > 0:
                pen.line([tuple(end) for end in ends], fill=colour, width=2)
    return np.asarray(canvas)


def _titles(names: list[str], width: int) -> Picture:
    canvas = Image.new("RGB", (width, HEADER), (255, 255, 255))
    pen = ImageDraw.Draw(canvas)
    for number, name in enumerate(names):
        pen.text((number * width // len(names) + 4, 2), name, fill=(0, 0, 0))
    return np.asarray(canvas)


def _enlarge(image: Picture, factor: int) -> np.ndarray:
    return image.repeat(factor, axis=0).repeat(factor, axis=1)


def _bytes(colours: Float[Tensor, "height width 3"]) -> Picture:
    return (colours.cpu().numpy().clip(0, 1) * 255 + 0.5).astype(np.uint8)
