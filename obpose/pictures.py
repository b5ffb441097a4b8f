"""Pictures of a model's output: input, attention masks, segmentation, reconstruction and boxes side by side."""

import colorsys
import io
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Integer, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from datagen.storage.atomic import write_atomically
from obpose.config import Views
from obpose.data.clips import separate_views
from obpose.geometry import all_rays, sides_of_points, unproject
from obpose.model.nerf.compose import mean_colour
from obpose.trainable import Trainable
from obpose.types import Decoded, Inference, Observation, SceneSegmentation, Segmentation

TILE = 192
"""Approximate height of tiles in pixels; images are enlarged by an integer factor."""
TINT = 0.65
"""Opacity of label colours over images."""
COLUMNS = ("input", "attention masks", "segmentation", "reconstruction", "boxes")
"""Headings of the columns."""
HEADER, MARGIN, GAP = 26, 76, 4
"""Height of the headings, width of the captions of rows, and gaps between tiles, pixels."""
_HUE_STEP = 0.618034
"""Golden-ratio hue step, which keeps any number of labels distinct."""
_HUES = [colorsys.hsv_to_rgb(_HUE_STEP * label % 1, 0.85, 1) for label in range(1, 256)]
PALETTE = (255 * np.array([(0, 0, 0), *_HUES])).round().astype(np.uint8)
"""Colours of labels: black for the background, then one colour for each label; they repeat after the last."""

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
    write_atomically(path, png(Image.fromarray(picture)))


@torch.no_grad()
def draw(model: Trainable, clips: Observation) -> Picture:
    """Draw one row per frame and one column per output that the model has.

    Boxes are those of the benchmark: around the points of each label, with the inferred centre and axes.
    """
    segmentation = model.segment(clips)
    reconstruction = None
    if isinstance(model, Decodes) and isinstance(segmentation, SceneSegmentation):
        reconstruction = reconstruct(model, clips, segmentation.inference)
    edges = None
    if isinstance(segmentation, SceneSegmentation) and segmentation.inference.where is not None:
        boxes = segmentation.inference.boxes
        sides = sides_of_points(unproject(clips), segmentation.labels, boxes)
        edges = box_edges(boxes.center, boxes.rotation, sides)
    frames = sorted({0, clips.depth.shape[1] - 1})
    rows = [
        (f"clip {clip + 1}\nframe {frame + 1}", _tiles(clips, segmentation, reconstruction, edges, clip, frame))
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


def colours_of(labels: Integer[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape 3"]:
    """Colours of labels from the palette."""
    return PALETTE[np.where(labels > 0, 1 + (labels - 1) % (len(PALETTE) - 1), 0)]


def tint(image: Picture, labels: Integer[np.ndarray, "height width"], opacity: float = TINT) -> Picture:
    """Mix an image with the colours of its labels; the background stays unchanged."""
    mixed = (1 - opacity) * image + opacity * colours_of(labels)
    return np.where(labels[..., None] > 0, mixed, image).astype(np.uint8)


def box_edges(
    center: Float[Tensor, "*box 3"], rotation: Float[Tensor, "*box 3 3"], sides: Float[Tensor, "*box 3"]
) -> Float[Tensor, "*box edge 2 3"]:
    """End points of the twelve edges of boxes, world frame, metres."""
    corners = torch.cartesian_prod(*[torch.tensor([-0.5, 0.5])] * 3).to(center)
    world = (sides[..., None, :] * corners) @ rotation.mT + center[..., None, :]
    # The corners of an edge differ in one coordinate, which is one bit of their indices.
    edges = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
    return world[..., torch.tensor(edges), :]


def draw_box(
    canvas: Image.Image,
    edges: Float[Tensor, "edge 2 3"],
    label: int,
    *,
    k: Float[Tensor, "3 3"],
    pose: Float[Tensor, "4 4"],
    width: int = 1,
) -> None:
    """Draw the edges of a box in the colour of its label, except edges behind the camera at `pose`, world_from_camera.

    `k` is the camera matrix in pixels of the canvas, `width` that of the lines.
    """
    in_camera = (edges - pose[:3, 3]) @ pose[:3, :3]
    pixels = (in_camera @ k.T)[..., :2] / in_camera[..., 2:].clamp(min=1e-6)
    colour = tuple(colours_of(np.array(label)).tolist())
    for (start, end), depths in zip(pixels.tolist(), in_camera[..., 2].tolist(), strict=True):
        if min(depths) > 0:
            ImageDraw.Draw(canvas).line([tuple(start), tuple(end)], fill=colour, width=width)


def draw_numbers(canvas: Image.Image, labels: Integer[np.ndarray, "height width"], scale: int) -> None:
    """Write the number of each visible label at the median of its pixels, on an image enlarged `scale` times."""
    pen, font = ImageDraw.Draw(canvas), ImageFont.load_default(max(12, canvas.height // 32))
    for label in np.unique(labels[labels > 0]).tolist():
        row, column = (scale * (float(np.median(index)) + 0.5) for index in np.nonzero(labels == label))
        pen.text((column, row), str(label), font=font, anchor="mm", fill="white", stroke_width=1, stroke_fill="black")


def enlarged(picture: Picture, times: int) -> UInt8[np.ndarray, "rows columns 3"]:
    """Enlarge a picture by repeating its pixels."""
    return picture.repeat(times, axis=0).repeat(times, axis=1)


def to_bytes(colours: Float[Tensor, "*shape 3"]) -> UInt8[np.ndarray, "*shape 3"]:
    """Convert colours in 0..1 to 8 bits; others are clamped."""
    return (colours.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()


def png(image: Image.Image) -> bytes:
    """Encode an image as PNG."""
    file = io.BytesIO()
    image.save(file, "PNG")
    return file.getvalue()


def _tiles(
    clips: Observation,
    segmentation: Segmentation,
    reconstruction: Tensor | None,
    edges: Float[Tensor, "batch frame slot edge 2 3"] | None,
    clip: int,
    frame: int,
) -> dict[str, Picture]:
    """Enlarged pictures of one frame in the first view, by heading."""
    image = to_bytes(clips.rgb[clip, frame, 0])
    labels, attention = (maps[clip, frame, 0].cpu().numpy() for maps in (segmentation.labels, segmentation.attention))
    pictures = [image, tint(image, attention), tint(image, labels)]
    if reconstruction is not None:
        pictures.append(to_bytes(reconstruction[clip, frame, 0]))
    factor = max(1, round(TILE / image.shape[0]))
    tiles = {name: enlarged(picture, factor) for name, picture in zip(COLUMNS, pictures, strict=False)}
    if edges is not None:
        canvas = Image.fromarray(enlarged(image, factor))
        camera = {"k": factor * clips.k[clip, 0], "pose": clips.world_from_camera[clip, 0]}
        for label, box in enumerate(edges[clip, frame], start=1):
            if box.isfinite().all():
                draw_box(canvas, box, label, **camera, width=2)
        tiles[COLUMNS[-1]] = np.asarray(canvas)
    return tiles


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
