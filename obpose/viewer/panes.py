"""The picture of the page's panel: the input on the left, the scene on the right; colour above, depth below."""

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont
from torch import Tensor

from obpose.scenes.rendering import Image

Picture = UInt8[np.ndarray, "height width 3"]
"""sRGB."""

TILE = 320
"""Images are enlarged or reduced to so many pixels of width."""
_GAP, _TITLE = 6, 22
_PAPER, _INK, _NOTHING = (255, 255, 255), (60, 60, 60), 238


def panes(image: Image, rgb: Float[Tensor, "h w 3"] | None, depth: Float[Tensor, "h w"] | None) -> Picture:
    """The scene beside what was observed, if anything was; both depths in the same greys, near is bright."""
    seen = image.depth if depth is None else depth
    reach = _reach(seen, seen > 0)
    rendered = _column("scene", _bytes(image.rgb), _bytes(greys(image.depth, reach)))
    if rgb is None or depth is None:
        nothing = np.full_like(_bytes(image.rgb), _NOTHING)
        observed = _column("no input", nothing, nothing)
    else:
        observed = _column("input", _bytes(rgb), _bytes(greys(depth, reach)))
    return np.concatenate([observed, _blank(len(rendered), _GAP), rendered], axis=1)


def greys(depth: Float[Tensor, "h w"], reach: tuple[float, float]) -> Float[Tensor, "h w 3"]:
    """Near is white, far is dark, nothing is black; metres."""
    near, far = reach
    grey = 0.1 + 0.9 * ((far - depth) / max(far - near, 1e-6)).clamp(0, 1)
    return torch.where(depth > 0, grey, 0.0)[..., None].expand(*depth.shape, 3)


def resized(picture: Picture, width: int) -> UInt8[np.ndarray, "rows columns 3"]:
    """Small images keep their pixels visible."""
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    method = Pillow.Resampling.NEAREST if width > picture.shape[1] else Pillow.Resampling.BOX
    return np.asarray(Pillow.fromarray(picture).resize((width, height), method))


def _reach(depth: Float[Tensor, "h w"], valid: Bool[Tensor, "h w"]) -> tuple[float, float]:
    known = depth[valid]
    return (float(known.min()), float(known.max())) if known.numel() else (0.0, 1.0)


def _column(title: str, above: Picture, below: Picture) -> UInt8[np.ndarray, "rows columns 3"]:
    tiles = [resized(picture, TILE) for picture in (above, below)]
    return np.concatenate([_line(title), tiles[0], _blank(_GAP, TILE), tiles[1]])


def _line(title: str) -> UInt8[np.ndarray, "rows columns 3"]:
    canvas = Pillow.new("RGB", (TILE, _TITLE), _PAPER)
    ImageDraw.Draw(canvas).text((2, 1), title, fill=_INK, font=ImageFont.load_default(15))
    return np.asarray(canvas)


def _blank(height: int, width: int) -> UInt8[np.ndarray, "rows columns 3"]:
    return np.full((height, width, 3), _PAPER, np.uint8)


def _bytes(values: Float[Tensor, "h w 3"]) -> Picture:
    return (values.clamp(0, 1) * 255).round().to(torch.uint8).numpy()
