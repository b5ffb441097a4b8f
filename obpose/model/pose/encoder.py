"""Encodes the points of an object's box (paper, section Object Location and Orientation Conditioned Encoding).

A point-wise network, a KPConv from the points onto anchors among them, and a KPConv of the anchors at the middle of the
box. The authors use the four levels of their backbone with radii of 5 to 40 mm, less than the distance of the points:
each point is its own only neighbour. Ours are in units of the box and with the default radius hold neighbours wherever
points are closer than a fifth of its edge to each other. Sines and cosines of the position and layer norms (where the
authors have group norms) are there because codes start to depend on shapes several times sooner with them. For the same
reason the mean of the features over the slot's mask, colours among them, ends the code as it is.
"""

from dataclasses import dataclass

import torch
from einops import rearrange
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import elu

from obpose.config import LatentConfig
from obpose.model.layers.kernel_points import kernel_points
from obpose.model.layers.kpconv import KPConv, influence
from obpose.model.layers.mlp import mlp
from obpose.model.layers.numerics import all_digits
from obpose.model.nerf.field import positional_encoding
from obpose.model.pose.crop import BoxSamples

SPREAD = 0.65
"""Scale of the places near which anchors are looked for, laid out like kernel points; half the box's edge is 1."""
NEIGHBOURS = 16
"""The nearest so many samples are an anchor's neighbours, as far as they are in reach."""
REACH = 1.2
"""Radius of the neighbourhood of the box's middle, in the same units."""
_POINT_WIDTH = 16
_ANCHOR_WIDTH = 32
_LITTLE = 1e-3
"""Masks that sum to less than this count as this."""
_FAR = 1e4
"""Distance squared of samples that there are not."""


@dataclass(frozen=True, eq=False)
class Neighbourhoods:
    """How the samples of each box, the axis `box` being batch, frame and slot in one, lie to each other."""

    index: Int[Tensor, "box anchor neighbour"]
    """Which sample is the neighbour."""
    influences: Float[Tensor, "box anchor neighbour kernel"]
    """Of the neighbours' kernel points, over the number of neighbours in reach: denser clouds are not louder."""
    central: Float[Tensor, "box anchor kernel"]
    """The same of the anchors as neighbours of the box's middle. All are 0 in a box without points."""


class ObjectEncoder(nn.Module):
    """From the samples of a box to one code; the order of the samples does not matter."""

    kernel: Float[Tensor, "kernel 3"]
    places: Float[Tensor, "anchor 3"]

    def __init__(self, features: int, config: LatentConfig):
        super().__init__()
        self.config, width = config, config.encoder
        self.register_buffer("kernel", kernel_points(), persistent=False)
        self.register_buffer("places", SPREAD * kernel_points(), persistent=False)
        pooled = width + _ANCHOR_WIDTH + _POINT_WIDTH
        self._points = mlp(3 + 6 * config.frequencies + features + 1, _POINT_WIDTH, _POINT_WIDTH)
        self._around = KPConv(_POINT_WIDTH, _ANCHOR_WIDTH)
        self._around_norm = nn.LayerNorm(_ANCHOR_WIDTH)
        self._anchors = mlp(_ANCHOR_WIDTH, _ANCHOR_WIDTH)
        self._middle = KPConv(_ANCHOR_WIDTH, width)
        self._middle_norm = nn.LayerNorm(width)
        self._code = nn.Sequential(nn.LayerNorm(pooled), mlp(pooled, width, width))
        self.size = width + (features if config.means == "given" else 0)

    def forward(self, samples: BoxSamples) -> Float[Tensor, "batch frame slot width"]:
        """The codes of all boxes at once."""
        points, features, mask, valid = (
            rearrange(part, "b f slot ... -> (b f slot) ...")
            for part in (samples.points, samples.features, samples.mask, samples.valid)
        )
        near = neighbourhoods(points, valid, places=self.places, kernel=self.kernel, radius=self.config.radius)
        encoded = positional_encoding(points, self.config.frequencies)
        pointwise = elu(self._points(torch.cat([points, encoded, features, mask[..., None]], dim=-1)))
        around = self._around(_neighbours(pointwise, near.index), rearrange(near.influences, "b a n k -> (b a) n k"))
        anchors = elu(self._anchors(elu(self._around_norm(around)))).unflatten(0, near.index.shape[:2])
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
@all_digits
def neighbourhoods(
    points: Float[Tensor, "box sample 3"],
    valid: Bool[Tensor, "box sample"],
    *,
    places: Float[Tensor, "anchor 3"],
    kernel: Float[Tensor, "kernel 3"],
    radius: float,
) -> Neighbourhoods:
    """Anchors are the samples nearest to some places in the box, their neighbours the nearest to them within `radius`.

    One sample may be the anchor of several places.
    """
    missing = torch.where(valid, 0, _FAR)[:, None]
    anchor = (_square_distances(places.expand(len(points), -1, -1), points) + missing).argmin(dim=-1)
    at = points.gather(1, anchor[..., None].expand(-1, -1, 3))
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
    """Of features that were multiplied by the mask; 0 where it is."""
    return weighted.sum(dim=1) / mask.sum(dim=1, keepdim=True).clamp(min=_LITTLE)


def _neighbours(
    table: Float[Tensor, "box sample width"], index: Int[Tensor, "box anchor neighbour"]
) -> Float[Tensor, "points neighbour width"]:
    """Rows of one flat table, which is what differentiates fast; `points` are box and anchor in one."""
    first = torch.arange(table.shape[0], device=table.device) * table.shape[1]
    rows = index + first[:, None, None]
    return table.flatten(0, 1).index_select(0, rows.flatten()).view(-1, index.shape[2], table.shape[2])
