"""Encoder from an image with its rays to a grid of features, the tokens of the slot attention.

Also the Fourier code of positions, and the projection of world points into the input image.
"""

import math

import torch
import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from obpose.baselines.obsurf.config import ImageEncoderConfig
from obpose.geometry import full_precision

_GROUPS = 4
"""Groups of the norms. [ours]"""


class ImageEncoder(nn.Module):
    """Residual network without pooling, with a head on each cell.

    As published, with two exceptions. Norms are over groups of channels instead of batches, which are small here, so
    that images do not depend on each other. The code of the camera's position is added after the first convolution,
    which is equivalent except at the border, because it is the same at every pixel.
    """

    def __init__(self, config: ImageEncoderConfig, *, camera_code: int):
        """Initialise the weights, for codes of the camera's position with `camera_code` channels."""
        super().__init__()
        self.config = config
        width = config.width
        self.stem = nn.Conv2d(10 if config.points else 6, width, 7, stride=2, padding=3, bias=False)
        self.camera = nn.Linear(camera_code, width)
        self.norm = nn.GroupNorm(_GROUPS, width)
        halves, cells = config.blocks
        strides = [1] * halves + [config.cell // 2] + [1] * (cells - 1)
        self.blocks = nn.Sequential(*(ResidualBlock(width, stride=stride) for stride in strides))
        self.head = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, width))
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(
        self,
        rgb: Float[Tensor, "image height width 3"],
        rays: Float[Tensor, "image height width 3"],
        points: Float[Tensor, "image height width 4"],
        camera: Float[Tensor, "image code"],
    ) -> Float[Tensor, "image rows columns feature"]:
        """Compute the features of the grid's cells.

        `rays` are unit vectors in the world. `points` are surface points in units with a validity channel, used only if
        the configuration says so.
        """
        seen = torch.cat([rgb, rays, points] if self.config.points else [rgb, rays], dim=-1)
        features = self.stem(rearrange(seen, "image h w c -> image c h w")) + self.camera(camera)[..., None, None]
        features = self.blocks(F.relu(self.norm(features)))
        return self.head(rearrange(features, "image c rows columns -> image rows columns c"))


class ResidualBlock(nn.Module):
    """Two convolutions with a skip connection."""

    def __init__(self, width: int, *, stride: int):
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, stride=stride, padding=1, bias=False)
        self.second = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.norms = nn.ModuleList(nn.GroupNorm(_GROUPS, width) for _ in range(2))
        self.skip = nn.Identity()
        if stride > 1:
            narrow = nn.Conv2d(width, width, 1, stride=stride, bias=False)
            self.skip = nn.Sequential(narrow, nn.GroupNorm(_GROUPS, width))

    def forward(
        self, features: Float[Tensor, "image channel height width"]
    ) -> Float[Tensor, "image channel rows columns"]:
        """Apply the block, which may halve the resolution."""
        branch = F.relu(self.norms[0](self.first(features)))
        return F.relu(self.norms[1](self.second(branch)) + self.skip(features))


FIRST_OCTAVE = -5
"""Smallest k of the Fourier code. [code]"""
_NEAREST = 1e-3
"""Smallest depth of points in the image, metres."""


def fourier_code(points: Float[Tensor, "*shape 3"], *, last: int) -> Float[Tensor, "*shape code"]:
    """Points p, and sin and cos of 2^k pi p for k from `FIRST_OCTAVE` to `last`."""
    scales = math.pi * 2.0 ** torch.arange(FIRST_OCTAVE, last + 1, dtype=points.dtype, device=points.device)
    angles = (points[..., None] * scales).flatten(start_dim=-2)
    return torch.cat([points, angles.sin(), angles.cos()], dim=-1)


def code_size(*, last: int) -> int:
    """Number of channels of `fourier_code`."""
    return 3 + 6 * (last + 1 - FIRST_OCTAVE)


@full_precision
def project(
    points: Float[Tensor, "image point 3"], k: Float[Tensor, "image 3 3"], world_from_camera: Float[Tensor, "image 4 4"]
) -> tuple[Float[Tensor, "image point 2"], Bool[Tensor, "image point"]]:
    """Pixel coordinates (u, v) of world points in each image, centres at +0.5, and whether they are before the camera.

    Deviation: the published code assumes a camera that looks at the origin, and one set of intrinsics.
    """
    in_camera = (points - world_from_camera[:, None, :3, 3]) @ world_from_camera[:, :3, :3]
    before = in_camera[..., 2] > _NEAREST
    on_plane = in_camera / in_camera[..., 2:].clamp(min=_NEAREST)
    return (on_plane @ k.mT)[..., :2], before


def nearest_cells(
    pixels: Float[Tensor, "image point 2"], *, size: tuple[int, int], grid: tuple[int, int]
) -> Int[Tensor, "image point"]:
    """Indices of the cells of a feature grid that contain pixels; beyond the border, of the nearest cell.

    `size` and `grid` are heights and widths, of the image and of the grid that covers it.
    """
    (height, width), (rows, columns) = size, grid
    column = (pixels[..., 0] * (columns / width)).floor().clamp(0, columns - 1).long()
    row = (pixels[..., 1] * (rows / height)).floor().clamp(0, rows - 1).long()
    return row * columns + column
