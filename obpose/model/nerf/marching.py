"""Volume rendering that leaves out empty space: the picture of `obpose.model.nerf.render`, of far fewer points.

Each component has a grid of cells that may hold something, made from its field once. Rays are marched front to back,
some samples at a time; a component is evaluated only at samples in such cells (an object's within its box), colours
only where light comes from, and rays that nothing shines through any more stop.

Each cell is asked at a few points, so what is thinner than they lie apart, and away from cells that are full, can be
left out. Tables, and most of the fog that a background's field has where no camera of training looked, are flat and
thin: a background is asked at many heights. Lumps of that fog can be missed, and their pictures have less of it.
"""

import math
from dataclasses import dataclass, replace

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
"""Samples of a ray that are evaluated before it is asked whether it goes on."""
_DARK = 1e-3
"""A ray that lets through less than this stops; light below a tenth of it has no colour."""
_LEAST, _LESS = 1e-3, 0.25
"""Cells in and around which the density over sigma_max is less than this, or than this share of the threshold, are
empty."""
_BALL = 0.8661
"""Radius of the ball around a cube, in its edges: a little more than sqrt(3) / 2."""
_CHUNK = 1 << 17
"""Points of a grid that are evaluated at once, so that memory does not grow with it."""


@dataclass(frozen=True, eq=False)
class Component:
    """The field of one object or of the background, and where it may be dense."""

    field: Field
    codes: Conditioning
    """Of a single code."""
    center: Float[Tensor, "3"]
    rotation: Float[Tensor, "3 3"]
    """World from the box's frame."""
    size: float
    """Edge of the field's cube, metres."""
    bounded: bool
    """Whether the field ends with its cube, as an object's does."""
    cells: Bool[Tensor, "x y z"]
    """Which cells of the cube may hold something."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What a camera sees; light that meets nothing is black, and its depth that of the far end."""

    colours: Float[Tensor, "component ray 3"]
    """What each component adds to the colour, 0..1."""
    depths: Float[Tensor, "component ray"]
    """What each adds to the mean planar depth, metres: its share of the light times the mean depth of that share."""
    weights: Float[Tensor, "component ray"]
    """Share of the light that comes from each component; together the opacity."""
    far: float
    """Planar depth of the far end, metres."""

    @property
    def colour(self) -> Float[Tensor, "ray 3"]:
        """0..1."""
        return self.colours.sum(dim=0)

    @property
    def depth(self) -> Float[Tensor, "ray"]:
        """Mean planar depth at which light comes from, metres."""
        return self.depths.sum(dim=0) + (1 - self.weights.sum(dim=0)) * self.far


@torch.no_grad()
def make_component(
    field: Field,
    codes: Conditioning,
    *,
    center: Float[Tensor, "3"],
    rotation: Float[Tensor, "3 3"],
    size: float,
    bounded: bool,
    resolution: int,
    layers: int = 1,
    threshold: float = 0.0,
) -> Component:
    """Look for the cells of the field's cube, `resolution` along each edge, that are not empty for this threshold.

    `codes` is of a single code. Each cell is asked at so many points, one above another along the cube's last axis.
    """
    steps = (torch.arange(layers).to(codes.first) + 0.5) / layers - 0.5
    within = F.pad(steps[:, None] * (2 / resolution), (2, 0))
    points = (lattice_points(resolution, None, codes.first)[:, None] + within).flatten(0, 1)
    logits = torch.cat([field.density(part, codes)[0] for part in points.split(_CHUNK)])
    dense = (log_density(logits[None]).exp() > max(_LEAST, _LESS * threshold)).unflatten(0, (-1, layers)).any(dim=-1)
    grid = dense.view(1, 1, resolution, resolution, resolution).to(points.dtype)
    cells = F.max_pool3d(grid, 3, stride=1, padding=1)[0, 0] > 0
    return Component(field, codes, center, rotation, size, bounded, cells)


def moved(component: Component, center: Float[Tensor, "3"], rotation: Float[Tensor, "3 3"]) -> Component:
    """The same elsewhere; nothing has to be looked for again."""
    return replace(component, center=center, rotation=rotation)


@torch.no_grad()
def march(
    components: list[Component],
    origin: Float[Tensor, "ray 3"],
    direction: Float[Tensor, "ray 3"],
    *,
    near: float,
    far: float,
    samples: int,
    sigma_max: float,
    floor: float | None,
    threshold: float = 0.0,
    behind: float = 0.0,
) -> Picture:
    """Render the composed components.

    Where `behind` is 0 and no full cell is missed, the values are those of `obpose.model.nerf.render.render`.

    Args:
        components: The background first, if there is one.
        origin: Camera centres, world frame, metres.
        direction: Per metre of planar depth.
        near: Planar depth to begin at, metres.
        far: Planar depth to end at, metres.
        samples: Points along a ray, in the middles of equal intervals.
        sigma_max: Density of an opaque point per metre of planar depth.
        floor: Bounded components are nowhere below this height in the world, metres; None for no floor.
        threshold: Density over sigma_max below which nothing is there; no more than that of the components.
        behind: Colours are those of so much more planar depth, metres: half of what they are trained on lies up to
            `loss.jitter` behind the surface, and light mostly comes from before it.
    """
    rays, length = len(origin), (far - near) / samples
    colours = origin.new_zeros(len(components), rays, 3)
    depth = origin.new_zeros(len(components), rays)
    weights = origin.new_zeros(len(components), rays)
    passed = origin.new_ones(rays)
    alive = torch.arange(rays, device=origin.device)
    for first in range(0, samples, _AT_ONCE):
        count = min(_AT_ONCE, samples - first)
        depths = near + (first + torch.arange(count, dtype=origin.dtype, device=origin.device) + 0.5) * length
        points = origin[alive, None] + direction[alive, None] * depths[:, None]
        look = _Look(sigma_max * length, floor, threshold, behind)
        lit = _evaluate(components, points, direction[alive], passed[alive], look)
        if lit is None:
            continue
        met = alive[lit.ray]
        colours[:, met] += lit.colours
        depth[:, met] += (lit.weights * depths).sum(dim=-1)
        weights[:, met] += lit.weights.sum(dim=-1)
        passed[met] = lit.passed
        alive = alive[passed[alive] > _DARK]
        if not len(alive):
            break
    return Picture(colours, depth, weights, far)


@torch.no_grad()
def thickness_towards(
    components: list[Component],
    origin: Float[Tensor, "ray 3"],
    direction: Float[Tensor, "3"],
    *,
    step: float,
    sigma_max: float,
    floor: float | None,
    threshold: float,
) -> Float[Tensor, "ray"]:
    """Optical thickness of bounded components, composed as in `march`, on the way from points towards one direction.

    What is opaque may have less than it has.

    Args:
        components: All bounded.
        origin: World frame, metres.
        direction: Of length 1.
        step: Distance of samples, metres.
        sigma_max: Density of an opaque point per metre.
        floor: As in `march`.
        threshold: As in `march`.
    """
    total = origin.new_zeros(len(origin))
    first, last = _between(components, origin, direction)
    alive = (last > first).nonzero()[:, 0]
    chunk = (torch.arange(_AT_ONCE, dtype=origin.dtype, device=origin.device) + 0.5) * step
    while len(alive):
        points = origin[alive, None] + (first[alive, None] + chunk)[..., None] * direction
        met = _meet(components, points, _Look(sigma_max * step, floor, threshold, 0.0))
        if met is not None:
            total[alive[met.ray]] += met.optical.sum(dim=(0, 2))
        first = first + _AT_ONCE * step
        alive = alive[(first[alive] < last[alive]) & (total[alive] < -math.log(_DARK))]
    return total


@dataclass(frozen=True)
class _Look:
    """How fields are seen; see `march`."""

    thickness: float
    """Optical thickness of a sample of density 1."""
    floor: float | None
    threshold: float
    behind: float


@dataclass(frozen=True, eq=False)
class _Met:
    """Of the rays that meet anything."""

    ray: Int[Tensor, " ray"]
    """Their places among all that were asked for."""
    places: list[Int[Tensor, " _"]]
    """Of each component, its samples among those of these rays."""
    optical: Float[Tensor, "component ray sample"]
    """Optical thickness."""


@dataclass(frozen=True, eq=False)
class _Lit:
    """Of the rays that meet anything."""

    ray: Int[Tensor, " ray"]
    """Their places among all that were asked for."""
    colours: Float[Tensor, "component ray 3"]
    weights: Float[Tensor, "component ray sample"]
    passed: Float[Tensor, "ray"]


def _evaluate(
    components: list[Component],
    points: Float[Tensor, "ray sample 3"],
    direction: Float[Tensor, "ray 3"],
    passed: Float[Tensor, "ray"],
    look: _Look,
) -> _Lit | None:
    """Light from the next samples of each ray; None where there is nothing."""
    met = _meet(components, points, look)
    if met is None:
        return None
    points, direction, passed = points[met.ray], direction[met.ray], passed[met.ray]
    flat, (rays, count, _) = points.flatten(0, 1), points.shape
    weights = passed[:, None] * light_from(met.optical)
    colours = points.new_zeros(len(components), rays, 3)
    unit = F.normalize(direction, dim=-1)
    for component, light, index, colour in zip(components, weights.flatten(1), met.places, colours, strict=True):
        index = index[light[index] > _DARK / 10]
        owner = index // count
        at = flat[index] + look.behind * direction[owner]
        _, hidden = component.field.density(in_box(component, at), component.codes)
        seen = component.field.colour(hidden, unit[owner] @ component.rotation, component.codes)
        colour.index_add_(0, owner, light[index, None] * seen)
    return _Lit(met.ray, colours, weights, passed * torch.exp(-met.optical.sum(dim=(0, 2))))


def _meet(components: list[Component], points: Float[Tensor, "ray sample 3"], look: _Look) -> _Met | None:
    """How dense the components are at the next samples of each ray; None where there is nothing."""
    found = [_inside(component, points, look.floor) for component in components]
    ray, places = _met(points, [index for index, _ in found])
    if not len(ray):
        return None
    size = (len(ray), points.shape[1])
    logits = points.new_full((len(components), size[0] * size[1]), OUTSIDE)
    for place, (component, index, (_, at)) in enumerate(zip(components, places, found, strict=True)):
        logits[place, index] = component.field.density(at, component.codes)[0]
    return _Met(ray, places, look.thickness * solid_share(logits, look.threshold).unflatten(1, size))


def _met(
    points: Float[Tensor, "ray sample 3"], found: list[Int[Tensor, " _"]]
) -> tuple[Int[Tensor, " n"], list[Int[Tensor, " _"]]]:
    """Rays with any of the points that were found, and these points counted among the samples of such rays only."""
    rays, count, _ = points.shape
    met = torch.zeros(rays, dtype=torch.bool, device=points.device)
    for index in found:
        met[index // count] = True
    number = met.cumsum(dim=0) - 1
    return met.nonzero()[:, 0], [number[index // count] * count + index % count for index in found]


def _inside(
    component: Component, points: Float[Tensor, "ray sample 3"], floor: float | None
) -> tuple[Int[Tensor, " m"], Float[Tensor, "m 3"]]:
    """Which of the points, ray by ray, lie in cells that may hold something, and where in the component's cube."""
    count = points.shape[1]
    rays = _passing(component, points) if component.bounded else torch.arange(len(points), device=points.device)
    flat = points[rays].flatten(0, 1)
    at = in_box(component, flat)
    resolution = len(component.cells)
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


def _passing(component: Component, points: Float[Tensor, "ray sample 3"]) -> Int[Tensor, " n"]:
    """Rays whose samples, which lie on a line each, come into the ball around the component's cube."""
    first, along = points[:, 0], points[:, -1] - points[:, 0]
    share = ((component.center - first) * along).sum(dim=-1) / along.square().sum(dim=-1).clamp(min=1e-12)
    nearest = first + share.clamp(0, 1)[:, None] * along
    return ((nearest - component.center).norm(dim=-1) <= component.size * _BALL).nonzero()[:, 0]


def _between(
    components: list[Component], origin: Float[Tensor, "ray 3"], direction: Float[Tensor, "3"]
) -> tuple[Float[Tensor, "ray"], Float[Tensor, "ray"]]:
    """How far from its origin a ray first comes into a ball around a component's cube, and leaves the last, metres."""
    first, last = origin.new_full((len(origin),), math.inf), origin.new_zeros(len(origin))
    for component in components:
        to = component.center - origin
        along = to @ direction
        half = ((component.size * _BALL) ** 2 - to.square().sum(dim=-1) + along.square()).clamp(min=0).sqrt()
        met = (half > 0) & (along + half > 0)
        first = torch.where(met, torch.minimum(first, (along - half).clamp(min=0)), first)
        last = torch.where(met, torch.maximum(last, along + half), last)
    return first, last


def in_box(component: Component, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """World points in the coordinates of the component's field, -1..1 in its cube."""
    return to_box(points, component.center, component.rotation, component.size)
