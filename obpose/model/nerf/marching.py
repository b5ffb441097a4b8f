"""Volume rendering that skips empty space: the images of `obpose.model.nerf.render`, with far fewer evaluations.

Each component has an occupancy grid, computed from its field once. Rays are marched front to back, some samples at a
time. A component is evaluated only at samples in occupied cells (an object's within its box), and colours only where
light comes from. Opaque rays stop.

A cell is tested at a few points, so that thin structures away from occupied cells can be missed. Tables are thin, and
so is most of the fog of a background's field outside the views of training. Backgrounds are therefore tested at many
heights. Lumps of fog can be missed, and are then absent from the image.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.geometry import to_box
from obpose.model.nerf.compose import OUTSIDE, log_density, solid_share
from obpose.model.nerf.field import Conditioning, Field
from obpose.model.nerf.render import light_from
from obpose.model.nerf.voxels import lattice_points

_AT_ONCE = 16
"""Number of samples of a ray between two tests of whether it stops."""
_DARK = 1e-3
"""Transmittance below which a ray stops; colours are not computed for a tenth of it."""
_LEAST, _LESS = 1e-3, 0.25
"""Density over sigma_max, and share of the threshold, below which cells are empty if their neighbours are, too."""
_BALL = 0.8661
"""Radius of the ball around a cube, in edges: slightly more than sqrt(3) / 2."""
_CHUNK = 1 << 15
"""Number of points of a grid that are evaluated at once, to bound memory."""

Point = Float[Tensor, "3"]
OfRays = Float[Tensor, "ray"]
Vectors = Float[Tensor, "ray 3"]
"""A point or a direction for each ray."""
Samples = Float[Tensor, "ray sample 3"]
"""Points along rays, world frame, metres."""


@dataclass(frozen=True, eq=False)
class Component:
    """Field of one object or of the background, with its occupancy grid."""

    field: Field
    codes: Conditioning
    """Conditioning on a single code."""
    center: Point
    rotation: Float[Tensor, "3 3"]
    """World from the box's frame."""
    size: float
    """Edge of the field's cube, metres."""
    bounded: bool
    """Whether the field ends at its cube, like an object's."""
    cells: Bool[Tensor, "x y z"]
    """Whether a cell of the cube may be occupied."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Rendered image by component. Light from beyond the far end is black."""

    colours: Float[Tensor, "component ray 3"]
    """Contribution of each component to the colour, 0..1."""
    depths: Float[Tensor, "component ray"]
    """Contribution of each component to the mean planar depth, metres: its share of the light times the mean depth."""
    weights: Float[Tensor, "component ray"]
    """Share of the light that comes from each component; together the opacity."""
    far: float
    """Planar depth of the far end, metres."""

    @property
    def colour(self) -> Vectors:
        """Colour, 0..1."""
        return self.colours.sum(dim=0)

    @property
    def depth(self) -> OfRays:
        """Mean planar depth of the light's origin, metres."""
        return self.depths.sum(dim=0) + (1 - self.weights.sum(dim=0)) * self.far


@torch.no_grad()
def make_component(
    field: Field,
    codes: Conditioning,
    *,
    center: Point,
    rotation: Float[Tensor, "3 3"],
    size: float,
    bounded: bool,
    resolution: int,
    layers: int = 1,
    threshold: float = 0.0,
) -> Component:
    """Compute the occupancy grid of a field, with `resolution` cells along each edge, for a threshold.

    `codes` is the conditioning on a single code. Each cell is tested at `layers` points along the cube's last axis.
    """
    # Points of each cell, one above another.
    steps = (torch.arange(layers).to(codes.first) + 0.5) / layers - 0.5
    within = F.pad(steps[:, None] * (2 / resolution), (2, 0))
    points = (lattice_points(resolution, None, codes.first)[:, None] + within).flatten(0, 1)
    # A cell is dense if one of its points is.
    logits = torch.cat([field.density(part, codes)[0] for part in points.split(_CHUNK)])
    dense = (log_density(logits[None]).exp() > max(_LEAST, _LESS * threshold)).unflatten(0, (-1, layers)).any(dim=-1)
    # A cell is occupied if it or a neighbour is dense.
    grid = dense.view(1, 1, resolution, resolution, resolution).to(points.dtype)
    cells = F.max_pool3d(grid, 3, stride=1, padding=1)[0, 0] > 0
    return Component(field, codes, center, rotation, size, bounded, cells)


def moved(component: Component, center: Point, rotation: Float[Tensor, "3 3"]) -> Component:
    """Move a component, with its occupancy grid."""
    return replace(component, center=center, rotation=rotation)


@torch.no_grad()
def march(
    components: list[Component],
    origin: Vectors,
    direction: Vectors,
    *,
    near: float,
    far: float,
    samples: int,
    sigma_max: float,
    floor: float | None,
    threshold: float = 0.0,
    behind: float = 0.0,
) -> Picture:
    """Render the composed components, like `obpose.model.nerf.render.render` if no occupied cell is missed.

    The background is the first component. Rays and samples are as in `render`. Bounded components are empty below the
    height `floor` in the world, metres; None for no floor. The `threshold` is at most that of the components. Colours
    are evaluated `behind` metres of planar depth farther along the ray: they are trained up to
    `obpose.model.nerf.along.JITTER` behind the surface, and light mostly comes from before it.
    """
    length = (far - near) / samples
    colours = origin.new_zeros(len(components), len(origin), 3)
    depth, weights = torch.zeros_like(colours[..., 0]), torch.zeros_like(colours[..., 0])
    passed = torch.ones_like(origin[:, 0])
    alive = torch.arange(len(origin), device=origin.device)
    for first in range(0, samples, _AT_ONCE):
        # The next samples of the rays that are not opaque yet.
        count = min(_AT_ONCE, samples - first)
        depths = near + (first + torch.arange(count, dtype=origin.dtype, device=origin.device) + 0.5) * length
        points = origin[alive, None] + direction[alive, None] * depths[:, None]
        met = _meet(components, points, sigma_max * length, floor=floor, threshold=threshold)
        if met is None:
            continue
        # Light of each sample and component: Mildenhall et al. 2020, eq. 3.
        ray = alive[met.ray]
        light = passed[ray, None] * light_from(met.thickness)
        colours[:, ray] += _colours(components, points[met.ray], direction[ray], met.places, light, behind)
        depth[:, ray] += (light * depths).sum(dim=-1)
        weights[:, ray] += light.sum(dim=-1)
        # Opaque rays stop.
        passed[ray] *= torch.exp(-met.thickness.sum(dim=(0, 2)))
        alive = alive[passed[alive] > _DARK]
        if not len(alive):
            break
    return Picture(colours, depth, weights, far)


@torch.no_grad()
def thickness_towards(
    components: list[Component],
    origin: Vectors,
    direction: Point,
    *,
    step: float,
    sigma_max: float,
    floor: float | None,
    threshold: float,
) -> OfRays:
    """Optical thickness of bounded components between points and a distant light; a lower bound where it is opaque.

    Components are composed as in `march`. `direction` is the unit vector towards the light, `step` the distance between
    samples in metres, and `sigma_max` the density of an opaque point per metre.
    """
    total = origin.new_zeros(len(origin))
    # Rays between the components and the light.
    first, last = _between(components, origin, direction)
    alive = (last > first).nonzero()[:, 0]
    # Sum of the optical thickness of the next samples, until it is opaque or past the last component.
    chunk = (torch.arange(_AT_ONCE, dtype=origin.dtype, device=origin.device) + 0.5) * step
    while len(alive):
        points = origin[alive, None] + (first[alive, None] + chunk)[..., None] * direction
        met = _meet(components, points, sigma_max * step, floor=floor, threshold=threshold)
        if met is not None:
            total[alive[met.ray]] += met.thickness.sum(dim=(0, 2))
        first = first + _AT_ONCE * step
        alive = alive[(first[alive] < last[alive]) & (total[alive] < -math.log(_DARK))]
    return total


class _Met(NamedTuple):
    """Densities along the rays that meet occupied cells."""

    ray: Int[Tensor, " ray"]
    """Indices of these rays among all."""
    places: list[Int[Tensor, " _"]]
    """Indices of each component's samples in occupied cells, among those of these rays."""
    thickness: Float[Tensor, "component ray sample"]
    """Optical thickness of each component at each sample."""


def _meet(
    components: list[Component], points: Samples, opaque: float, *, floor: float | None, threshold: float
) -> _Met | None:
    """Compute optical thicknesses at samples of each ray, `opaque` at density 1; None if all are empty."""
    # Samples in occupied cells, and the rays they are on.
    found = [_inside(component, points, floor) for component in components]
    rays, count, _ = points.shape
    met = torch.zeros(rays, dtype=torch.bool, device=points.device)
    for index, _ in found:
        met[index // count] = True
    if not met.any():
        return None
    number = met.cumsum(dim=0) - 1
    places = [number[index // count] * count + index % count for index, _ in found]
    # Logits there; elsewhere components are empty.
    logits = points.new_full((len(components), int(met.sum()) * count), OUTSIDE)
    for own, component, place, (_, at) in zip(logits, components, places, found, strict=True):
        own[place] = component.field.density(at, component.codes)[0]
    thickness = opaque * solid_share(logits, threshold)
    return _Met(met.nonzero()[:, 0], places, thickness.unflatten(1, (-1, count)))


def _colours(
    components: list[Component],
    points: Samples,
    direction: Vectors,
    places: list[Int[Tensor, " _"]],
    light: Float[Tensor, "component ray sample"],
    behind: float,
) -> Float[Tensor, "component ray 3"]:
    """Sum the colours of the samples `places` of each component, weighted by light; dark samples are left out."""
    # Samples as a flat list, ray by ray.
    flat, count = points.flatten(0, 1), points.shape[1]
    colours = points.new_zeros(len(components), len(points), 3)
    unit = F.normalize(direction, dim=-1)
    for component, share, index, colour in zip(components, light.flatten(1), places, colours, strict=True):
        index = index[share[index] > _DARK / 10]
        owner = index // count
        # Colours behind the surface, where they were trained, in the frame of the component.
        at = flat[index] + behind * direction[owner]
        _, hidden = component.field.density(in_box(component, at), component.codes)
        seen = component.field.colour(hidden, unit[owner] @ component.rotation, component.codes)
        colour.index_add_(0, owner, share[index, None] * seen)
    return colours


def _inside(
    component: Component, points: Samples, floor: float | None
) -> tuple[Int[Tensor, " m"], Float[Tensor, "m 3"]]:
    """Find the points in occupied cells, ray by ray, and their coordinates in the component's cube."""
    # Rays that pass the ball around the cube; unbounded components are met by all.
    count = points.shape[1]
    rays = _passing(component, points) if component.bounded else torch.arange(len(points), device=points.device)
    flat = points[rays].flatten(0, 1)
    at = in_box(component, flat)
    resolution = len(component.cells)
    # Occupancy of the cells of the points.
    within = (at.abs() <= 1).all(dim=-1)
    cell = ((at + 1) * (resolution / 2)).floor().long().clamp(0, resolution - 1)
    there = component.cells[cell[:, 0], cell[:, 1], cell[:, 2]]
    if component.bounded:
        there = there & within
        if floor is not None:
            there = there & (flat[:, 2] > floor)
    else:
        there = there | ~within
    index = there.nonzero()[:, 0]
    return rays[index // count] * count + index % count, at[index]


def _passing(component: Component, points: Samples) -> Int[Tensor, " n"]:
    """Find the rays whose samples pass through the ball around the component's cube."""
    first, along = points[:, 0], points[:, -1] - points[:, 0]
    share = ((component.center - first) * along).sum(dim=-1) / along.square().sum(dim=-1).clamp(min=1e-12)
    nearest = first + share.clamp(0, 1)[:, None] * along
    return ((nearest - component.center).norm(dim=-1) <= component.size * _BALL).nonzero()[:, 0]


def _between(components: list[Component], origin: Vectors, direction: Point) -> tuple[OfRays, OfRays]:
    """Distances at which a ray enters the first ball around a component's cube and leaves the last, metres."""
    first, last = origin.new_full((len(origin),), math.inf), origin.new_zeros(len(origin))
    for component in components:
        to = component.center - origin
        along = to @ direction
        # Half of the chord of the ray in the ball.
        half = ((component.size * _BALL) ** 2 - to.square().sum(dim=-1) + along.square()).clamp(min=0).sqrt()
        met = (half > 0) & (along + half > 0)
        first = torch.where(met, torch.minimum(first, (along - half).clamp(min=0)), first)
        last = torch.where(met, torch.maximum(last, along + half), last)
    return first, last


def in_box(component: Component, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Convert world points to coordinates of the component's field, -1..1 in its cube."""
    return to_box(points, component.center, component.rotation, component.size)
