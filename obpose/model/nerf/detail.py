"""What a field does not know of one thing: values on a lattice in its box, which belong to that thing alone.

An addition: a field that all objects share is one that was learned in minutes, and draws most of them smooth and in one
colour. Explicit lattices are fitted within seconds (Sun, Sun and Chen 2022). They correct the field, or stand for it.
"""

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from obpose.model.nerf.compose import OUTSIDE

EDGE = 16
"""Points of the lattice along each edge, the outermost on the faces of its cube."""

Lattices = Float[Tensor, "thing edge edge edge 4"]
"""Logits of density and colours, or what is added to the field's; axes are x, y, z of the box, `edge` is `EDGE`."""


@dataclass(frozen=True, eq=False)
class Detail:
    """Of one or more things, and whose are whose."""

    lattices: Lattices
    owner: Int[Tensor, "*code"]
    """Of each code, the place of its thing."""
    alone: Float[Tensor, "thing"] | None = None
    """Where positive, there is nothing of the thing but its lattice, in a cube around the box's middle of so many times
    the box's edge; elsewhere, and where None, lattices are as large as the box, and correct the field."""

    def at(self, owner: Int[Tensor, " n"]) -> "Detail":
        """One for each of a flat list of points; `owner` is the place of a point's code."""
        return replace(self, owner=self.owner[owner])

    def corrects(self) -> Float[Tensor, "*code 1"] | float:
        """What the field's own logits are multiplied with: 0 where the lattice is alone, else 1."""
        return 1.0 if self.alone is None else (self.alone[self.owner, None] <= 0).to(self.alone.dtype)

    def of(self, points: Float[Tensor, "*points 3"]) -> Float[Tensor, "*points 4"]:
        """Values at points of the box, -1..1, trilinear.

        Beyond a face corrections are those at the face; of things that are alone nothing is dense there. Codes
        broadcast to points, as in `obpose.model.nerf.field`.
        """
        alone = None if self.alone is None else self.alone[self.owner][..., None]
        if alone is not None:
            points = points / torch.where(alone > 0, alone, 1.0)
        steps = ((points + 1) * ((EDGE - 1) / 2)).clamp(0, EDGE - 1)
        low = steps.detach().floor().clamp(max=EDGE - 2)
        upper = steps - low
        x, y, z = torch.stack([1 - upper, upper], dim=-1).unbind(dim=-2)
        weights = x[..., :, None, None] * y[..., None, :, None] * z[..., None, None, :]
        first = (low.long() * low.new_tensor([EDGE**2, EDGE, 1], dtype=torch.long)).sum(dim=-1)
        index = (first + self.owner * EDGE**3)[..., None] + _corners(points.device)
        table = self.lattices.flatten(0, 3)
        found = F.embedding_bag(index.flatten(0, -2), table, per_sample_weights=weights.reshape(-1, 8), mode="sum")
        found = found.view(*points.shape[:-1], 4)
        if alone is None:
            return found
        beyond = (alone > 0) & (points.abs() > 1).any(dim=-1, keepdim=True)
        return found.masked_fill(beyond & (torch.arange(4, device=found.device) == 0), OUTSIDE)


def no_detail(things: int, like: Tensor) -> Lattices:
    """No corrections, of the same kind of numbers as `like`."""
    return like.new_zeros(things, EDGE, EDGE, EDGE, 4)


def roughness(lattices: Lattices, *, neighbours: float, size: float) -> Float[Tensor, ""]:
    """Minus the log of a Gaussian prior, but for a constant.

    Args:
        lattices: Corrections.
        neighbours: Standard deviation of differences of neighbouring points, logits.
        size: Standard deviation of corrections themselves, logits.
    """
    differences = sum((lattices.diff(dim=axis).square().sum() for axis in (1, 2, 3)), start=lattices.new_zeros(()))
    return differences / (2 * neighbours**2) + lattices.square().sum() / (2 * size**2)


def _corners(device: torch.device) -> Int[Tensor, "8"]:
    """Places of a cell's corners in a lattice, relative to the first."""
    ends = torch.tensor([0, 1], device=device)
    return (ends[:, None, None] * EDGE**2 + ends[:, None] * EDGE + ends).flatten()
