"""Pictures of a model's output: input, attention masks, segmentation, reconstruction and boxes side by side."""

import io
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from datagen.storage.atomic import write_atomically
from obpose.config import Views
from obpose.data.clips import separate_views
from obpose.geometry import all_rays, from_box
from obpose.model.nerf.compose import mean_colour
from obpose.trainable import Trainable
from obpose.types import Boxes, Decoded, Inference, Observation, SceneSegmentation, Segmentation

TILE = 192
"""Approximate height of tiles in pixels; images are enlarged by an integer factor."""
TINT = 0.65
"""Opacity of label colours over images."""
COLUMNS = ("input", "attention masks", "segmentation", "reconstruction", "boxes")
"""Headings of the columns."""
HEADER, MARGIN, GAP = 26, 76, 4
"""Height of the headings, width of the captions of rows, and gaps between tiles, pixels."""
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
"""Colours of labels; the background has none, and colours repeat after the last."""

Picture = UInt8[np.ndarray, "height width 3"]
"""sRGB picture."""


@runtime_checkable
class Decodes(Protocol):
    """A model that reconstructs colours."""

    def decode(
        self, inference: Inference, points: Tensor, directions: Tensor, colours: Literal["with", "without"]
    ) -> Decoded:
        """Decode densities and colours at world points."""
        ...


def write_picture(path: Path, model: Trainable, clips: Observation, views: Views) -> None:
    """Draw the first and last frame of each clip; in every view, if the model takes one view at a time."""
    was_training = model.training
    model.eval()
    try:
        picture = draw(model, clips if views == "all" else separate_views(clips))
    finally:
        model.train(was_training)
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "png")
    write_atomically(path, file.getvalue())


@torch.no_grad()
def draw(model: Trainable, clips: Observation) -> Picture:
    """Draw one row per frame and one column per output that the model has."""
    segmentation = model.segment(clips)
    reconstruction = None
    if isinstance(model, Decodes) and isinstance(segmentation, SceneSegmentation):
        reconstruction = reconstruct(model, clips, segmentation.inference)
    frames = sorted({0, clips.depth.shape[1] - 1})
    rows = [
        (f"frame {frame + 1}", _tiles(clips, segmentation, reconstruction, clip, frame))
        for clip in range(len(clips.depth))
        for frame in frames
    ]
    return _grid(rows)


def reconstruct(
    model: Decodes, clips: Observation, inference: Inference
) -> Float[Tensor, "batch frame view height width 3"]:
    """Decode the colours of the composed fields at the observed surfaces; pixels without depth are black."""
    rays = all_rays(clips)
    points = rays.origin + rays.direction * rays.depth[..., None]
    decoded = model.decode(inference, points, rays.direction, "with")
    assert decoded.colours is not None
    colours = mean_colour(decoded.logits, decoded.colours) * rays.valid[..., None]
    return colours.reshape(clips.rgb.shape)


def tint(image: Picture, labels: Int[np.ndarray, "height width"]) -> Picture:
    """Mix an image with the colours of its labels; the background stays unchanged."""
    place = np.where(labels > 0, 1 + (labels - 1) % (len(PALETTE) - 1), 0)
    mixed = (1 - TINT) * image + TINT * PALETTE[place]
    return np.where(labels[..., None] > 0, mixed, image).astype(np.uint8)


def box_edges(boxes: Boxes, clip: int, frame: int) -> Float[Tensor, "slot edge 2 3"]:
    """End points of the twelve edges of each box, world frame, metres."""
    corners = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3).to(boxes.center)
    slots = boxes.center.shape[2]
    world = from_box(corners.expand(slots, 8, 3), boxes.center[clip, frame], boxes.rotation[clip, frame], boxes.size)
    # The corners of an edge differ in one coordinate, which is one bit of their indices.
    edges = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
    return world[:, torch.tensor(edges)]


def _tiles(
    clips: Observation, segmentation: Segmentation, reconstruction: Tensor | None, clip: int, frame: int
) -> dict[str, Picture]:
    """Enlarged pictures of one frame in the first view, by heading."""
    image = _bytes(clips.rgb[clip, frame, 0])
    labels, attention = (maps[clip, frame, 0].cpu().numpy() for maps in (segmentation.labels, segmentation.attention))
    pictures = [image, tint(image, attention), tint(image, labels)]
    if reconstruction is not None:
        pictures.append(_bytes(reconstruction[clip, frame, 0]))
    factor = max(1, round(TILE / image.shape[0]))
    tiles = {name: _enlarge(picture, factor) for name, picture in zip(COLUMNS, pictures, strict=False)}
    if isinstance(segmentation, SceneSegmentation):
        used = segmentation.labels[clip].unique().tolist()
        boxes = segmentation.inference.boxes
        tiles[COLUMNS[-1]] = _draw_boxes(_enlarge(image, factor), factor, clips, boxes, clip, frame, used)
    return tiles


def _draw_boxes(
    image: Picture, factor: int, clips: Observation, boxes: Boxes, clip: int, frame: int, used: list[int]
) -> Picture:
    """Draw the edges of the boxes of used labels, except edges behind the camera."""
    canvas = Image.fromarray(image)
    pen = ImageDraw.Draw(canvas)
    pose, k = clips.world_from_camera[clip, 0], clips.k[clip, 0]
    in_camera = (box_edges(boxes, clip, frame) - pose[:3, 3]) @ pose[:3, :3]
    pixels = (in_camera @ k.T)[..., :2] / in_camera[..., 2:].clamp(min=1e-6) * factor
    for slot in range(len(pixels)):
        if slot + 1 not in used:
            continue
        colour = tuple(PALETTE[1 + slot % (len(PALETTE) - 1)].tolist())
        for ends, depths in zip(pixels[slot].tolist(), in_camera[slot, :, :, 2].tolist(), strict=True):
            if min(depths) > 0:
                pen.line([tuple(end) for end in ends], fill=colour, width=2)
    return np.asarray(canvas)


def _grid(rows: list[tuple[str, dict[str, Picture]]]) -> UInt8[np.ndarray, "rows columns 3"]:
    """Arrange tiles on white, with a caption before each row and headings above the columns."""
    headings = list(rows[0][1])
    height, width = rows[0][1][headings[0]].shape[:2]
    size = (MARGIN + len(headings) * (width + GAP), HEADER + len(rows) * (height + GAP))
    canvas = Image.new("RGB", size, (255, 255, 255))
    pen = ImageDraw.Draw(canvas)
    text = {"fill": (0, 0, 0), "font": ImageFont.load_default(16)}
    for column, heading in enumerate(headings):
        pen.text((MARGIN + column * (width + GAP), 2), heading, **text)
    for row, (caption, tiles) in enumerate(rows):
        top = HEADER + row * (height + GAP)
        pen.text((4, top), caption, **text)
        for column, tile in enumerate(tiles.values()):
            canvas.paste(Image.fromarray(tile), (MARGIN + column * (width + GAP), top))
    return np.asarray(canvas)


def _enlarge(image: Picture, factor: int) -> np.ndarray:
    return image.repeat(factor, axis=0).repeat(factor, axis=1)


def _bytes(colours: Float[Tensor, "height width 3"]) -> Picture:
    return (colours.cpu().numpy().clip(0, 1) * 255 + 0.5).astype(np.uint8)
