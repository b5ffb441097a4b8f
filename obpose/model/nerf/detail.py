"""Residual grid of an object: corrections of the field on a lattice in its box.

An addition: a field that all objects share and that was trained for minutes draws most of them smooth and in one
colour. Explicit lattices are fitted within seconds (Sun, Sun and Chen 2022). They correct the field, or replace it.
"""

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from obpose.model.nerf.compose import OUTSIDE

EDGE = 16
"""Number of lattice points along each edge; the outermost are on the faces of the cube."""

Lattices = Float[Tensor, "thing edge edge edge 4"]
"""Logits of density and colours, or corrections of the field's; axes are x, y, z of the box, `edge` is `EDGE`."""


@dataclass(frozen=True, eq=False)
class Detail:
    """Residual grids of one or more objects."""

    lattices: Lattices
    owner: Int[Tensor, "*code"]
    """Index of the grid of each code."""
    own_scale: Float[Tensor, "thing"] | None = None
    """If positive, the grid replaces the field, in a cube around the box's middle whose edge is this multiple of the
    box's edge. Elsewhere, or if None, grids are as large as the box and correct the field."""

    def at(self, owner: Int[Tensor, " n"]) -> "Detail":
        """Select a grid for each of a flat list of points; `owner` is the index of a point's code."""
        return replace(self, owner=self.owner[owner])

    def corrects(self) -> Float[Tensor, "*code 1"] | float:
        """Factor on the field's own logits: 0 if the grid replaces the field, else 1."""
        return 1.0 if self.own_scale is None else (self.own_scale[self.owner, None] <= 0).to(self.own_scale.dtype)

    def of(self, points: Float[Tensor, "*points 3"]) -> Float[Tensor, "*points 4"]:
        """Trilinear values at points of the box, -1..1; codes broadcast to points, as in `obpose.model.nerf.field`.

        Beyond a face, corrections are those at the face, and grids that replace the field are empty.
        """
        scale = None if self.own_scale is None else self.own_scale[self.owner][..., None]
        if scale is not None:
            points = points / torch.where(scale > 0, scale, 1.0)
        # Cell of each point, and the weights of its corners.
        steps = ((points + 1) * ((EDGE - 1) / 2)).clamp(0, EDGE - 1)
        low = steps.detach().floor().clamp(max=EDGE - 2)
        upper = steps - low
        x, y, z = torch.stack([1 - upper, upper], dim=-1).unbind(dim=-2)
        weights = x[..., :, None, None] * y[..., None, :, None] * z[..., None, None, :]
        # Weighted sum of the values at the corners.
        first = (low.long() * low.new_tensor([EDGE**2, EDGE, 1], dtype=torch.long)).sum(dim=-1)
        index = (first + self.owner * EDGE**3)[..., None] + _corners(points.device)
        table = self.lattices.flatten(0, 3)
        found = F.embedding_bag(index.flatten(0, -2), table, per_sample_weights=weights.reshape(-1, 8), mode="sum")
        found = found.view(*points.shape[:-1], 4)
        if scale is None:
            return found
        # Beyond a grid that replaces the field there is no density.
        beyond = (scale > 0) & (points.abs() > 1).any(dim=-1, keepdim=True)
        return found.masked_fill(beyond & (torch.arange(4, device=found.device) == 0), OUTSIDE)


def no_detail(things: int, like: Tensor) -> Lattices:
    """Grids of zeros, with the type and device of `like`."""
    return like.new_zeros(things, EDGE, EDGE, EDGE, 4)


def roughness(lattices: Lattices, *, neighbours: float, size: float) -> Float[Tensor, ""]:
    """Negative log of a Gaussian prior, up to a constant.

    Standard deviations are those of differences of `neighbours`, and of the corrections themselves (`size`), in logits.
    """
    differences = sum((lattices.diff(dim=axis).square().sum() for axis in (1, 2, 3)), start=lattices.new_zeros(()))
    return differences / (2 * neighbours**2) + lattices.square().sum() / (2 * size**2)


def _corners(device: torch.device) -> Int[Tensor, "8"]:
    """Indices of a cell's corners in a lattice, relative to the first."""
    ends = torch.tensor([0, 1], device=device)
    return (ends[:, None, None] * EDGE**2 + ends[:, None] * EDGE + ends).flatten()
