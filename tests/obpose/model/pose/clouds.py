"""Samples of one box, as object encoders get them, of a small solid on a table."""

import torch

from obpose.model.pose.crop import BoxSamples, gather_box
from obpose.types import Boxes

EDGE = 0.06
"""Edge of the solid, metres."""


def half_a_cube(spacing: float) -> torch.Tensor:
    """The three faces of a cube that a camera sees, points `spacing` metres apart, "point 3", metres."""
    steps = torch.arange(spacing / 2, EDGE, spacing) - EDGE / 2
    a, b = (grid.flatten() for grid in torch.meshgrid(steps, steps, indexing="ij"))
    face = torch.full_like(a, EDGE / 2)
    faces = [torch.stack(columns, dim=-1) for columns in ((a, b, face), (face, a, b), (a, -face, b))]
    return _shaken(torch.cat(faces))


def table(spacing: float) -> torch.Tensor:
    """Points of the plane under the cube that it does not cover, "point 3", metres."""
    steps = torch.arange(-0.3, 0.3, spacing)
    a, b = (grid.flatten() for grid in torch.meshgrid(steps, steps, indexing="ij"))
    free = torch.maximum(a.abs(), b.abs()) > EDGE / 2
    return _shaken(torch.stack([a, b, torch.full_like(a, -EDGE / 2)], dim=-1)[free])


def crop(
    cube: torch.Tensor,
    around: torch.Tensor,
    *,
    samples: int = 160,
    rotation: torch.Tensor | None = None,
) -> BoxSamples:
    """One box, "1 1 1 sample", around the mean of the cube's points, whose masks are larger than the others'."""
    points = torch.cat([cube, around])
    values = torch.randn(len(points), 4, generator=torch.Generator().manual_seed(0))
    log_mask = torch.cat([torch.full((len(cube),), -0.1), torch.linspace(-2, -3, len(around))])
    rotation = torch.eye(3) if rotation is None else rotation
    boxes = Boxes(cube.mean(dim=0)[None, None, None], rotation[None, None, None], 0.2)
    valid = torch.ones(1, 1, len(points), dtype=torch.bool)
    cloud = points[None, None], valid, values[None, None], log_mask[None, None, None]
    return gather_box(*cloud, boxes, samples=samples, whose="own")


def _shaken(points: torch.Tensor) -> torch.Tensor:
    """By a millimetre or two: on a lattice many points are equally near, and rounding would choose among them."""
    return points + 0.001 * torch.randn(points.shape, generator=torch.Generator().manual_seed(1))
