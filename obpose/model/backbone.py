"""U-Net of KPConv layers on the organised point cloud (paper, section Encoder; Thomas et al. 2019).

The neighbours of a point are those of its 3x3 window on the image grid, weighted by where they lie in space; the paper
searches balls in space. The geometry of a level is computed once and shared by its layers. The input layer looks at
single points, the authors' at neighbourhoods: at full resolution a KPConv costs most. Within, the points of all images
stand in one row, image by image and row by row.
"""

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, Literal

import torch
import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from obpose.config import BackboneConfig
from obpose.model.layers.grid import Grid, Windows, all_places, on_grid, thin, upsample, windows
from obpose.model.layers.kernel_points import kernel_points
from obpose.model.layers.kpconv import KPConv, influence
from obpose.model.layers.mlp import Linear


@dataclass(frozen=True, eq=False)
class BackboneOutput:
    """The grid of embeddings."""

    points: Float[Tensor, "image height width 3"]
    """World frame, metres; 0 where not valid."""
    valid: Bool[Tensor, "image height width"]
    rgb: Float[Tensor, "image height width 3"]
    """Their colours, standardised (`standard_colours`)."""
    embedding: Float[Tensor, "image height width embedding"]
    """zeta."""
    scene: Float[Tensor, "image scene"]
    """One code of the whole image."""


def standard_colours(rgb: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3"]:
    """Colours in 0..1 to about mean 0 and deviation 1."""
    return (rgb - 0.5) * 5


def plain_colours(standardised: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3"]:
    """Back to 0..1."""
    return standardised / 5 + 0.5


@dataclass(frozen=True, eq=False)
class Level:
    """A grid with its geometry."""

    grid: Grid
    around: Windows | None
    """Of all points; None where no block needs them."""
    kept: Int[Tensor, " kept"]
    """Which points the next level keeps."""
    around_kept: Windows
    """Of those."""


class Backbone(nn.Module):
    """Encoder over all levels, decoder back to the `output_level`, and a code of the scene from the deepest."""

    kernel: Tensor

    def __init__(self, config: BackboneConfig, *, scene: Literal["coded", "left out"] = "coded"):
        """With fresh weights; the code of the scene can be left out where nothing reads it."""
        super().__init__()
        self.config = config
        widths = config.widths
        self.register_buffer("kernel", kernel_points(), persistent=False)
        self.input = nn.Sequential(Linear(6, widths[0]), nn.LayerNorm(widths[0]), nn.ReLU())
        self.down = nn.ModuleList(Block(fine, coarse) for fine, coarse in pairwise(widths))
        self.blocks = nn.ModuleList(
            nn.ModuleList(Block(width, width) for _ in range(count))
            for width, count in zip(widths, config.blocks, strict=True)
        )
        self.up = nn.ModuleList(Up(coarse, fine) for fine, coarse in pairwise(widths[config.output_level :]))
        last = widths[config.output_level]
        self.head = nn.Sequential(
            nn.Linear(last, last), nn.LayerNorm(last), nn.LeakyReLU(0.1), nn.Linear(last, config.embedding)
        )
        self.scene = SceneCode(widths, means=config.scene_means == "given") if scene == "coded" else NoSceneCode()

    def forward(
        self,
        points: Float[Tensor, "image height width 3"],
        rgb: Float[Tensor, "image height width 3"],
        valid: Bool[Tensor, "image height width"],
        *,
        spacing: float,
        center: Float[Tensor, "3"],
        workspace_radius: float = 1.0,
    ) -> BackboneOutput:
        """Points, in world coordinates and metres, with colours, to embeddings.

        `spacing` is the distance of neighbouring points of the whole image, `center` the middle of the workspace,
        `workspace_radius` the radius of the scene's code, all in metres.
        """
        grid, kept = thin(Grid(points, valid), self.config.input_stride)
        rgb = standard_colours(rgb).reshape(-1, 3)[kept].masked_fill(~grid.valid.view(-1, 1), 0)
        position = (grid.points.view(-1, 3) - center) / workspace_radius
        features = torch.cat([rgb, position], dim=-1).masked_fill(~grid.valid.view(-1, 1), 0)
        levels = self._levels(grid, spacing)
        skips = self._encode(levels, features)
        grids = [level.grid for level in levels]
        images = [on_grid(values, at) for values, at in zip(skips, grids, strict=True)]
        scene = self.scene(grids, images, on_grid(rgb, grid), self.kernel, center=center, radius=workspace_radius)
        embedding = self.head(self._decode(levels, skips))
        for level in levels[: self.config.output_level]:
            rgb = rgb[level.kept]
        at = levels[self.config.output_level].grid
        return BackboneOutput(at.points, at.valid, on_grid(rgb, at), embedding, scene)

    def grid_size(self, height: int, width: int) -> tuple[int, int]:
        """Rows and columns of the embeddings of an image of that size."""
        stride = 2**self.config.output_level * self.config.input_stride
        return -(-height // stride), -(-width // stride)

    @torch.no_grad()
    def _levels(self, grid: Grid, spacing: float) -> list[Level]:
        levels = []
        for depth, blocks in enumerate(self.config.blocks):
            radius = self.config.radius * spacing * self.config.input_stride * 2**depth
            geometry = partial(windows, grid, radius=radius, kernel=self.kernel)
            coarse, kept = thin(grid, 2)
            around = geometry(all_places(grid)) if blocks else None
            levels.append(Level(grid, around, kept, around.at(kept) if around else geometry(kept)))
            grid = coarse
        return levels

    def _encode(self, levels: list[Level], features: Float[Tensor, "point 6"]) -> list[Tensor]:
        features = self.input(features)
        skips = []
        for depth, level in enumerate(levels):
            if depth:
                finer = levels[depth - 1]
                features = self.down[depth - 1](features, finer.around_kept, finer.kept)
            for block in self.blocks[depth]:  # pyright: ignore[reportGeneralTypeIssues]
                features = block(features, level.around)
            skips.append(features)
        return skips

    def _decode(self, levels: list[Level], skips: list[Tensor]) -> Float[Tensor, "image height width channel"]:
        features = on_grid(skips[-1], levels[-1].grid)
        for depth in range(len(levels) - 2, self.config.output_level - 1, -1):
            fine = on_grid(skips[depth], levels[depth].grid)
            features = self.up[depth - self.config.output_level](
                features, levels[depth + 1].grid, fine, levels[depth].grid
            )
        return features


class SceneCode(nn.Module):
    """One code of an image: a KPConv of the deepest level around the workspace's middle, means of levels, mean colour.

    The mean colour stands there as it is. The authors only have the KPConv, as a sum; the background's latent then
    hardly hears of what a scene has of its own, the table's colour above all, and collapses to its prior.
    """

    def __init__(self, widths: tuple[int, ...], *, means: bool = True):
        """Means and mean colour can be left out."""
        super().__init__()
        self.means = means
        self.around = KPConv(widths[-1], widths[-1])
        inputs = widths[-1] + (sum(widths) if means else 0)
        self.out = nn.Sequential(nn.Linear(inputs, widths[-1]), nn.LayerNorm(widths[-1]))
        self.size = widths[-1] + (3 if means else 0)

    def forward(
        self, grids: list[Grid], features: list[Tensor], rgb: Tensor, kernel: Tensor, *, center: Tensor, radius: float
    ) -> Float[Tensor, "image scene"]:
        """From the features of all levels and the colours of the first; `center` and `radius` in metres."""
        deepest = grids[-1]
        weights = influence((deepest.points - center) / radius, kernel) * deepest.valid[..., None]
        shares = weights / weights.sum(dim=(1, 2), keepdim=True).clamp(min=1e-3)
        around = self.around(
            rearrange(features[-1], "image y x channel -> image (y x) channel"),
            rearrange(shares, "image y x kernel -> image (y x) kernel"),
        )
        if not self.means:
            return self.out(around)
        means = [masked_mean(level, grid.valid) for level, grid in zip(features, grids, strict=True)]
        code = self.out(torch.cat([around, *means], dim=-1))
        return torch.cat([code, masked_mean(rgb, grids[0].valid)], dim=-1)


class NoSceneCode(nn.Module):
    """In its place where nothing reads it."""

    size = 0

    def forward(self, grids: list[Grid], *_: Any, **__: Any) -> Float[Tensor, "image 0"]:
        """Of every image, nothing."""
        points = grids[0].points
        return points.new_zeros(len(points), 0)


def masked_mean(
    features: Float[Tensor, "image height width channel"], valid: Bool[Tensor, "image height width"]
) -> Float[Tensor, "image channel"]:
    """Mean over the valid places; 0 without any."""
    weights = valid[..., None].to(features.dtype)
    return (features * weights).sum(dim=(1, 2)) / weights.sum(dim=(1, 2)).clamp(min=1)


class Block(nn.Module):
    """Narrow KPConv with a skip; at some of the points where their places are given.

    As the authors' but for its norms and its skip. Features are normalised point by point, so that nothing depends on
    how many points there are, and only once, at the end of the branch, where theirs are after three layers. The skip
    takes the point itself, theirs the largest neighbour.
    """

    def __init__(self, inputs: int, outputs: int):
        super().__init__()
        narrow = outputs // 4
        self.before = nn.Linear(inputs, narrow)
        self.convolution = KPConv(narrow, narrow)
        self.after = Linear(narrow, outputs)
        self.norm = nn.LayerNorm(outputs)
        self.skip = nn.Linear(inputs, outputs)

    def forward(
        self, features: Float[Tensor, "point inputs"], around: Windows, kept: Int[Tensor, " kept"] | None = None
    ) -> Float[Tensor, "kept outputs"]:
        """Features of a level to features of the windows' points."""
        neighbours = around.gather(F.relu(self.before(features)))
        branch = F.relu(self.norm(self.after(self.convolution(neighbours, around.influences))))
        own = features if kept is None else features.index_select(0, kept)
        return branch + self.skip(own)


class Up(nn.Module):
    """Adds the features of a coarser level to those of a finer one."""

    def __init__(self, coarse: int, fine: int):
        super().__init__()
        self.coarse = nn.Sequential(nn.Linear(coarse, fine), nn.LayerNorm(fine), nn.ReLU())
        self.fine = nn.Sequential(nn.Linear(fine, fine), nn.LayerNorm(fine), nn.ReLU())

    def forward(
        self,
        coarse: Float[Tensor, "image rows columns coarse"],
        coarse_grid: Grid,
        fine: Float[Tensor, "image height width fine"],
        fine_grid: Grid,
    ) -> Float[Tensor, "image height width fine"]:
        """Upsamples the one and adds the other."""
        return upsample(self.coarse(coarse), coarse_grid.valid, like=fine_grid) + self.fine(fine)
