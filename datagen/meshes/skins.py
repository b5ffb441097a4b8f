"""Build the `Skin` of a mesh from its textures and colours."""

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from datagen.geometry import LINEAR
from datagen.meshes.read import RawMesh
from datagen.shapes.shape import Skin

MOST_TEXELS = 2048
"""Largest side of a texture; larger ones are halved until they fit."""

_WHITE = np.full((1, 1, 3), 255, np.uint8)


def make_skin(raw: RawMesh, vertices: Float[np.ndarray, "vertex 3"]) -> Skin:
    """The skin of all faces of a file; `vertices` are in metres."""
    pyramids = tuple(
        _pyramid(image, raw.uv[raw.image == row].astype(np.float64)) for row, image in enumerate(raw.images)
    )
    pyramids = (*pyramids, (_WHITE,))
    texture = np.where(raw.image < 0, len(raw.images), raw.image)
    sizes = np.array([levels[0].shape[1::-1] for levels in pyramids], float)[texture]
    area = _area(vertices[raw.faces])
    flat = raw.uv * sizes[:, None]
    texels = _area(np.concatenate([flat, np.zeros((*flat.shape[:2], 1))], axis=2))
    colors = raw.colors.astype(np.float32)
    return Skin(
        uv=raw.uv.astype(np.float32),
        colors=colors,
        texture=texture.astype(np.int32),
        density=np.sqrt(texels / np.maximum(area, 1e-12)).astype(np.float32),
        pyramids=pyramids,
        mean=_mean(raw, pyramids, texture, area),
    )


def reordered(skin: Skin, rows: np.ndarray, turned: Bool[np.ndarray, "face"]) -> Skin:
    """The skin of the given faces, with the corners of some in reverse order."""
    uv, colors = skin.uv[rows], skin.colors[rows]
    uv[turned], colors[turned] = uv[turned][:, ::-1], colors[turned][:, ::-1]
    return Skin(uv, colors, skin.texture[rows], skin.density[rows], skin.pyramids, skin.mean)


def _area(corners: Float[np.ndarray, "face 3 3"]) -> Float[np.ndarray, "face"]:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * np.sqrt(np.sum(across**2, axis=1))


def _mean(raw: RawMesh, pyramids: tuple, texture: np.ndarray, area: np.ndarray) -> tuple[float, float, float]:
    """Mean over the surface: of the texels at the middles of the faces, times the colours of the corners."""
    middle = np.mean(raw.uv, axis=1) % 1.0
    color = np.mean(raw.colors, axis=1)
    for row, levels in enumerate(pyramids):
        own = texture == row
        height, width = levels[0].shape[:2]
        x = np.minimum((middle[own, 0] * width).astype(int), width - 1)
        y = np.minimum((middle[own, 1] * height).astype(int), height - 1)
        color[own] *= LINEAR[levels[0][y, x]]
    total = area @ color / max(float(np.sum(area)), 1e-30)
    red, green, blue = (round(float(value), 6) for value in _encode(total) / 255)
    return red, green, blue


def _pyramid(image: UInt8[np.ndarray, "height width 3"], uv: np.ndarray) -> tuple[UInt8[np.ndarray, "_ _ 3"], ...]:
    """All levels of a texture.

    Texels that no face uses take the colour of used ones nearby. Otherwise the atlas' background would show as seams
    where a coarse texel covers both.
    """
    color, weight = LINEAR[image].astype(np.float32), _coverage(image.shape[:2], uv)
    while max(color.shape[:2]) > MOST_TEXELS:
        color, weight = _half(color, weight)
    levels = [(color, weight)]
    while max(levels[-1][0].shape[:2]) > 1:
        levels.append(_half(*levels[-1]))
    filled = levels[-1][0]
    result = [filled]
    for color, weight in levels[-2::-1]:
        height, width = color.shape[:2]
        coarse = np.repeat(np.repeat(filled, 2, axis=0)[:height], 2, axis=1)[:, :width]
        filled = np.where(weight[..., None] > 0, color, coarse)
        result.append(filled)
    return tuple(_encode(level) for level in result[::-1])


def _half(color: Float32[np.ndarray, "h w 3"], weight: Float32[np.ndarray, "h w"]) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean of blocks of 2x2 texels; an odd last row or column is repeated."""
    height, width = weight.shape
    pad = ((0, height % 2 if height > 1 else 0), (0, width % 2 if width > 1 else 0))
    color, weight = np.pad(color, (*pad, (0, 0)), mode="edge"), np.pad(weight, pad, mode="edge")
    down, across = (2 if side > 1 else 1 for side in weight.shape)
    blocks = (weight.shape[0] // down, down, weight.shape[1] // across, across)
    total = np.sum((color * weight[..., None]).reshape(*blocks, 3), axis=(1, 3))
    summed = np.sum(weight.reshape(blocks), axis=(1, 3))
    return total / np.maximum(summed, 1e-9)[..., None], summed / (down * across)


def _coverage(shape: tuple[int, int], uv: Float[np.ndarray, "face 3 2"]) -> Float32[np.ndarray, "height width"]:
    """1 for texels that a face may use, else 0."""
    from PIL import Image, ImageDraw

    height, width = shape
    if not len(uv) or np.min(uv) < -1e-3 or np.max(uv) > 1 + 1e-3:
        return np.ones(shape, np.float32)
    mask = Image.new("L", (width, height))
    draw = ImageDraw.Draw(mask)
    for corners in (uv * [width, height]).tolist():
        draw.polygon([(x, y) for x, y in corners], fill=255, outline=255)
    return (np.asarray(mask) > 0).astype(np.float32)


def _encode(linear: np.ndarray) -> UInt8[np.ndarray, "..."]:
    """SRGB bytes of linear values."""
    value = np.clip(linear, 0, 1)
    srgb = np.where(value <= 0.0031308, 12.92 * value, 1.055 * np.maximum(value, 1e-9) ** (1 / 2.4) - 0.055)
    return np.rint(255 * srgb).astype(np.uint8)
