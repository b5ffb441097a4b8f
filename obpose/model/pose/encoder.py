"""Encoder of the points of an object's box (paper, section Object Location and Orientation Conditioned Encoding).

A point-wise network, a KPConv from the points onto anchors among them, and a KPConv of the anchors at the middle of the
box. The authors use the four levels of their backbone with radii of 5 to 40 mm, less than the distance of the points,
so that no point has neighbours. Our radius is in units of the box; with the default, points have neighbours if they are
closer than a fifth of its edge.

With sines and cosines of the position, and layer norms instead of the authors' group norms, codes depend on shapes
several times sooner. For the same reason, the mean of the features under the slot's mask is appended to the code.
"""

from dataclasses import dataclass

import torch
from einops import rearrange
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import elu

from obpose.config import LatentConfig
from obpose.geometry import full_precision
from obpose.model.layers.kpconv import KPConv, influence, kernel_points
from obpose.model.layers.mlp import mlp
from obpose.model.nerf.field import positional_encoding
from obpose.model.pose.crop import BoxSamples

SPREAD = 0.65
"""Scale of the target positions of anchors, which are arranged like kernel points; half the box's edge is 1."""
NEIGHBOURS = 16
"""Largest number of neighbours of an anchor."""
REACH = 1.2
"""Radius of the neighbourhood of the box's middle, in the same units."""
_POINT_WIDTH = 16
_ANCHOR_WIDTH = 32
_LEAST = 1e-3
"""Smallest divisor, for empty masks."""
_FAR = 1e4
"""Squared distance of missing samples."""
WIDTH = 64
"""Width of the encoder. [code]"""


@dataclass(frozen=True, eq=False)
class Neighbourhoods:
    """Neighbourhoods of the samples of each box, where the axis `box` is batch, frame and slot in one."""

    index: Int[Tensor, "box anchor neighbour"]
    """Index of the neighbour among the samples."""
    influences: Float[Tensor, "box anchor neighbour kernel"]
    """Influences of kernel points at the neighbours, divided by the number of neighbours in reach, so that the density
    of the cloud does not matter."""
    central: Float[Tensor, "box anchor kernel"]
    """Influences at the anchors as neighbours of the box's middle. All are 0 in a box without points."""


class ObjectEncoder(nn.Module):
    """Network from the samples of a box to one code, invariant to the order of the samples."""

    kernel: Float[Tensor, "kernel 3"]
    places: Float[Tensor, "anchor 3"]

    def __init__(self, features: int, config: LatentConfig, *, width: int = WIDTH):
        """Initialise the weights, for points with `features` channels."""
        super().__init__()
        self.config = config
        self.register_buffer("kernel", kernel_points(), persistent=False)
        self.register_buffer("places", SPREAD * kernel_points(), persistent=False)
        pooled = width + _ANCHOR_WIDTH + _POINT_WIDTH
        # Point-wise network: position, its encoding, features and mask.
        self._points = mlp(3 + 6 * config.frequencies + features + 1, _POINT_WIDTH, _POINT_WIDTH)
        # KPConv of points at anchors, then of anchors at the middle of the box.
        self._around = KPConv(_POINT_WIDTH, _ANCHOR_WIDTH)
        self._around_norm = nn.LayerNorm(_ANCHOR_WIDTH)
        self._anchors = mlp(_ANCHOR_WIDTH, _ANCHOR_WIDTH)
        self._middle = KPConv(_ANCHOR_WIDTH, width)
        self._middle_norm = nn.LayerNorm(width)
        # Code from the pooled features.
        self._code = nn.Sequential(nn.LayerNorm(pooled), mlp(pooled, width, width))
        self.size = width + (features if config.means == "given" else 0)

    def forward(self, samples: BoxSamples) -> Float[Tensor, "batch frame slot width"]:
        """Encode all boxes at once."""
        points, features, mask, valid = (
            rearrange(part, "b f slot ... -> (b f slot) ...")
            for part in (samples.points, samples.features, samples.mask, samples.valid)
        )
        # Point-wise network, then a KPConv onto the anchors.
        near = neighbourhoods(points, valid, places=self.places, kernel=self.kernel, radius=self.config.radius)
        encoded = positional_encoding(points, self.config.frequencies)
        pointwise = elu(self._points(torch.cat([points, encoded, features, mask[..., None]], dim=-1)))
        around = self._around(_neighbours(pointwise, near.index), rearrange(near.influences, "b a n k -> (b a) n k"))
        anchors = elu(self._anchors(elu(self._around_norm(around)))).unflatten(0, near.index.shape[:2])
        # Pooling: a KPConv at the middle of the box, the maximum of the anchors, the mean of the points.
        pooled = [
            elu(self._middle_norm(self._middle(anchors, near.central))),
            anchors.amax(dim=1),
            _mean(pointwise * mask[..., None], mask),
        ]
        code = self._code(torch.cat(pooled, dim=-1))
        if self.config.means == "given":
            code = torch.cat([code, _mean(features, mask)], dim=-1)
        return code.unflatten(0, samples.valid.shape[:3])


@torch.no_grad()
@full_precision
def neighbourhoods(
    points: Float[Tensor, "box sample 3"],
    valid: Bool[Tensor, "box sample"],
    *,
    places: Float[Tensor, "anchor 3"],
    kernel: Float[Tensor, "kernel 3"],
    radius: float,
) -> Neighbourhoods:
    """Choose as anchors the samples nearest to `places` in the box, and as neighbours those nearest within `radius`.

    One sample may be the anchor of several places.
    """
    missing = torch.where(valid, 0, _FAR)[:, None]
    # Anchors: the nearest samples to the target positions.
    anchor = (_square_distances(places.expand(len(points), -1, -1), points) + missing).argmin(dim=-1)
    at = points.gather(1, anchor[..., None].expand(-1, -1, 3))
    # Neighbours: the nearest samples to the anchors.
    count = min(NEIGHBOURS, points.shape[1])
    near = (_square_distances(at, points) + missing).topk(count, dim=-1, largest=False, sorted=False)
    offsets = _neighbours(points, near.indices).unflatten(0, anchor.shape) - at[:, :, None]
    return Neighbourhoods(
        index=near.indices,
        influences=_averaging(influence(offsets / radius, kernel), near.values < radius**2),
        central=_averaging(influence(at / REACH, kernel), valid.gather(1, anchor)),
    )


def _square_distances(
    targets: Float[Tensor, "box target 3"], points: Float[Tensor, "box sample 3"]
) -> Float[Tensor, "box target sample"]:
    squares = targets.square().sum(-1)[..., None] + points.square().sum(-1)[:, None]
    return torch.baddbmm(squares, targets, points.mT, alpha=-2)


def _averaging(
    influences: Float[Tensor, "*shape neighbour kernel"], there: Bool[Tensor, "*shape neighbour"]
) -> Float[Tensor, "*shape neighbour kernel"]:
    share = there / there.sum(dim=-1, keepdim=True).clamp(min=1)
    return influences * share[..., None]


def _mean(weighted: Float[Tensor, "box sample width"], mask: Float[Tensor, "box sample"]) -> Float[Tensor, "box width"]:
    """Mean of features that were multiplied by the mask; 0 for an empty mask."""
    return weighted.sum(dim=1) / mask.sum(dim=1, keepdim=True).clamp(min=_LEAST)


def _neighbours(
    table: Float[Tensor, "box sample width"], index: Int[Tensor, "box anchor neighbour"]
) -> Float[Tensor, "points neighbour width"]:
    """Select rows of a flat table, which is differentiated fast; `points` are box and anchor in one."""
    first = torch.arange(table.shape[0], device=table.device) * table.shape[1]
    rows = index + first[:, None, None]
    return table.flatten(0, 1).index_select(0, rows.flatten()).view(-1, index.shape[2], table.shape[2])
