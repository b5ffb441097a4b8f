"""U-Net of KPConv layers on the organised point cloud (paper, section Encoder; Thomas et al. 2019).

The neighbours of a point are those of its 3x3 window on the image grid, weighted by their positions in space; the paper
searches balls in space. The geometry of a level is computed once and shared by its layers. The input layer is applied
to single points and the authors' to neighbourhoods, because a KPConv costs most at full resolution. Internally, the
points of all images are one flat list, image by image and row by row.
"""

from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import torch
import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from obpose.config import BackboneConfig
from obpose.model.layers.grid import Grid, Windows, all_places, on_grid, subsample, upsample, windows
from obpose.model.layers.kpconv import KPConv, influence, kernel_points
from obpose.model.layers.mlp import Linear

WIDTHS = (16, 32, 64, 64)
"""Channels of each level; each level has half the resolution of the previous one. [code]"""
RADIUS = 2.0
"""Radius of a KPConv neighbourhood in units of the distance between neighbouring points of the level. [ours, that of a
3x3 window; code: 0.025 m where points are some 6 mm apart, then both doubled]"""
EMBEDDING = 16
"""D: channels of the point embeddings. [code]"""


@dataclass(frozen=True, eq=False)
class BackboneOutput:
    """The grid of embeddings."""

    points: Float[Tensor, "image height width 3"]
    """Surface points, world frame, metres; 0 where not valid."""
    valid: Bool[Tensor, "image height width"]
    rgb: Float[Tensor, "image height width 3"]
    """Standardised colours (`standard_colours`)."""
    embedding: Float[Tensor, "image height width embedding"]
    """zeta."""
    scene: Float[Tensor, "image scene"]
    """Code of the whole image; without channels if the backbone has none."""


def standard_colours(rgb: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3"]:
    """Standardise colours in 0..1 to a mean of about 0 and a standard deviation of about 1."""
    return (rgb - 0.5) * 5


def plain_colours(standardised: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3"]:
    """Convert standardised colours back to 0..1."""
    return standardised / 5 + 0.5


@dataclass(frozen=True, eq=False)
class Level:
    """A grid with its geometry."""

    grid: Grid
    around: Windows | None
    """Windows around all points; None if no block needs them."""
    kept: Int[Tensor, " kept"]
    """Indices of the points that the next level keeps."""
    around_kept: Windows
    """Windows around the kept points."""


class Backbone(nn.Module):
    """Encoder over all levels, decoder back to the `output_level`, and a code of the scene from the deepest level."""

    kernel: Tensor

    def __init__(self, config: BackboneConfig, *, scene_code: bool = True, widths: tuple[int, ...] = WIDTHS):
        """Initialise the weights; `scene_code` says whether a code of the scene is computed."""
        super().__init__()
        self.config = config
        self.register_buffer("kernel", kernel_points(), persistent=False)
        # Encoder: colour and position, then strided blocks between levels and blocks on each level.
        self.input = nn.Sequential(Linear(6, widths[0]), nn.LayerNorm(widths[0]), nn.ReLU())
        self.down = nn.ModuleList(Block(fine, coarse) for fine, coarse in pairwise(widths))
        self.blocks = nn.ModuleList(
            nn.ModuleList(Block(width, width) for _ in range(count))
            for width, count in zip(widths, config.blocks, strict=True)
        )
        # Decoder back to the output level, and the embedding zeta.
        self.up = nn.ModuleList(Up(coarse, fine) for fine, coarse in pairwise(widths[config.output_level :]))
        last = widths[config.output_level]
        self.head = nn.Sequential(
            nn.Linear(last, last), nn.LayerNorm(last), nn.LeakyReLU(0.1), nn.Linear(last, EMBEDDING)
        )
        self.scene = SceneCode(widths, means=config.scene_means == "given") if scene_code else None

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
        """Compute embeddings of points with colours.

        `points` are in the world frame, metres, `rgb` in 0..1, and `valid` says which pixels have a point. `spacing` is
        the distance between neighbouring points of the full image, `center` the middle of the workspace, and
        `workspace_radius` the radius of the scene's code, all in metres.
        """
        grid = Grid(points.masked_fill(~valid[..., None], 0).contiguous(), valid.contiguous())
        # Input: standardised colour and position in the workspace, 0 where there is no point.
        rgb = standard_colours(rgb).reshape(-1, 3).masked_fill(~valid.reshape(-1, 1), 0)
        position = (grid.points.view(-1, 3) - center) / workspace_radius
        features = torch.cat([rgb, position], dim=-1).masked_fill(~valid.reshape(-1, 1), 0)
        # Encoder, code of the scene, decoder.
        levels = self._levels(grid, spacing)
        skips = self._encode(levels, features)
        grids = [level.grid for level in levels]
        scene = points.new_zeros(len(points), 0)
        if self.scene is not None:
            images = [on_grid(values, at) for values, at in zip(skips, grids, strict=True)]
            scene = self.scene(grids, images, on_grid(rgb, grid), self.kernel, center=center, radius=workspace_radius)
        embedding = self.head(self._decode(levels, skips))
        # Colours of the points of the output level.
        for level in levels[: self.config.output_level]:
            rgb = rgb[level.kept]
        at = grids[self.config.output_level]
        return BackboneOutput(at.points, at.valid, on_grid(rgb, at), embedding, scene)

    @property
    def scene_size(self) -> int:
        """Channels of the code of the scene."""
        return 0 if self.scene is None else self.scene.size

    def grid_size(self, height: int, width: int) -> tuple[int, int]:
        """Rows and columns of the embeddings of an image of this size."""
        stride = 2**self.config.output_level
        return -(-height // stride), -(-width // stride)

    @torch.no_grad()
    def _levels(self, grid: Grid, spacing: float) -> list[Level]:
        levels = []
        for depth, blocks in enumerate(self.config.blocks):
            # Radii double with the distance between points.
            radius = RADIUS * spacing * 2**depth
            geometry = partial(windows, grid, radius=radius, kernel=self.kernel)
            coarse, kept = subsample(grid)
            # Windows around all points serve the level's blocks, those around kept points the next level.
            around = geometry(all_places(grid)) if blocks else None
            levels.append(Level(grid, around, kept, around.at(kept) if around else geometry(kept)))
            grid = coarse
        return levels

    def _encode(self, levels: list[Level], features: Float[Tensor, "point 6"]) -> list[Tensor]:
        features = self.input(features)
        skips = []
        for depth, level in enumerate(levels):
            # Strided block from the finer level, then the blocks of this level.
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
            # Upsampled features plus those of the encoder at this level.
            fine = on_grid(skips[depth], levels[depth].grid)
            features = self.up[depth - self.config.output_level](
                features, levels[depth + 1].grid, fine, levels[depth].grid
            )
        return features


class SceneCode(nn.Module):
    """Code of an image: a KPConv of the deepest level around the workspace's middle, means of levels, and mean colour.

    The mean colour is appended unchanged. The authors have the KPConv only, as a sum. The background's latent then
    hardly depends on what distinguishes a scene, such as the table's colour, and collapses to its prior.
    """

    def __init__(self, widths: tuple[int, ...], *, means: bool = True):
        """Initialise the weights; `means` says whether means and mean colour are part of the code."""
        super().__init__()
        self.means = means
        self.around = KPConv(widths[-1], widths[-1])
        inputs = widths[-1] + (sum(widths) if means else 0)
        self.out = nn.Sequential(nn.Linear(inputs, widths[-1]), nn.LayerNorm(widths[-1]))
        self.size = widths[-1] + (3 if means else 0)

    def forward(
        self, grids: list[Grid], features: list[Tensor], rgb: Tensor, kernel: Tensor, *, center: Tensor, radius: float
    ) -> Float[Tensor, "image scene"]:
        """Compute codes from features of all levels and colours of the first; `center` and `radius` are in metres."""
        deepest = grids[-1]
        # KPConv around the middle of the workspace, with a mean over points.
        weights = influence((deepest.points - center) / radius, kernel) * deepest.valid[..., None]
        influences = weights / weights.sum(dim=(1, 2), keepdim=True).clamp(min=1e-3)
        around = self.around(
            rearrange(features[-1], "image y x channel -> image (y x) channel"),
            rearrange(influences, "image y x kernel -> image (y x) kernel"),
        )
        if not self.means:
            return self.out(around)
        # Means of all levels, and the mean colour.
        means = [masked_mean(level, grid.valid) for level, grid in zip(features, grids, strict=True)]
        code = self.out(torch.cat([around, *means], dim=-1))
        return torch.cat([code, masked_mean(rgb, grids[0].valid)], dim=-1)


def masked_mean(
    features: Float[Tensor, "image height width channel"], valid: Bool[Tensor, "image height width"]
) -> Float[Tensor, "image channel"]:
    """Mean over the valid points; 0 if there are none."""
    weights = valid[..., None].to(features.dtype)
    return (features * weights).sum(dim=(1, 2)) / weights.sum(dim=(1, 2)).clamp(min=1)


class Block(nn.Module):
    """Bottleneck KPConv with a skip connection; strided if the indices of kept points are given.

    Deviations: one point-wise layer norm at the end of the branch instead of three group norms, so that results do not
    depend on the number of points. The skip takes the point itself, the authors' the largest neighbour.
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
        """Map the features of a level to features of the windows' points."""
        # Branch and skip connection.
        neighbours = around.gather(F.relu(self.before(features)))
        branch = F.relu(self.norm(self.after(self.convolution(neighbours, around.influences))))
        own = features if kept is None else features.index_select(0, kept)
        return branch + self.skip(own)


class Up(nn.Module):
    """Sum of the upsampled features of a coarser level and those of a finer one."""

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
        """Upsample the coarse features and add the fine ones."""
        return upsample(self.coarse(coarse), coarse_grid.valid, like=fine_grid) + self.fine(fine)
