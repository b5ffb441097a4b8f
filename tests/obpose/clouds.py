"""Clouds of points on known shapes in random orientations, metres."""

from collections.abc import Callable

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from datagen.catalog import CATEGORIES, sample_shape
from datagen.shapes import build
from obpose.model.pose.minimum_volume import find_candidates, gather_clouds
from obpose.model.pose.rotations import rotation_from_quaternion

EVERY_SIDE = np.zeros(3)


def random_boxes(
    count: int, points: int, seed: int = 0
) -> tuple[Float[Tensor, "box point 3"], Float[Tensor, "box 3 3"], Float[Tensor, "box 3"]]:
    """Points on the surfaces of boxes, the boxes' orientations and sizes."""
    rng = np.random.default_rng(seed)
    sizes = rng.uniform(0.03, 0.16, (count, 3))
    rotations = Rotation.random(count, rng=rng).as_matrix()
    clouds = [box_surface(rng, points, size) @ rotation.T for size, rotation in zip(sizes, rotations, strict=True)]
    return as_tensor(clouds), as_tensor(rotations), as_tensor(sizes)


def random_shapes(count: int, points: int, seed: int = 0) -> Float[Tensor, "shape point 3"]:
    """Clouds of all kinds in `KINDS` in turn, each rotated and moved."""
    rng = np.random.default_rng(seed)
    kinds = list(KINDS.values())
    clouds = []
    for number in range(count):
        cloud = kinds[number % len(kinds)](rng, points)
        clouds.append(cloud @ Rotation.random(rng=rng).as_matrix().T + rng.uniform(-0.3, 0.3, 3))
    return as_tensor(clouds)


def box_surface(
    rng: np.random.Generator, points: int, size: np.ndarray, toward: np.ndarray = EVERY_SIDE
) -> Float[np.ndarray, "point 3"]:
    """Points on those sides of a box that face a direction; on all where that is 0."""
    sides = [(axis, sign) for axis in range(3) for sign in (-1, 1) if sign * toward[axis] >= 0]
    areas = np.array([np.prod(np.delete(size, axis)) for axis, _ in sides])
    cloud = rng.uniform(-0.5, 0.5, (points, 3))
    for row, side in enumerate(rng.choice(len(sides), points, p=areas / areas.sum())):
        axis, sign = sides[side]
        cloud[row, axis] = 0.5 * sign
    return cloud * size


def trimesh_volumes(clouds: Float[Tensor, "shape point 3"]) -> Float[Tensor, "shape"]:
    """Volumes of the smallest boxes that trimesh finds."""
    edges = as_tensor([trimesh.bounds.oriented_bounds(cloud)[1] for cloud in clouds.double().numpy()])
    return edges.prod(dim=1)


def as_tensor(values: list[np.ndarray] | np.ndarray) -> Tensor:
    return torch.tensor(np.array(values), dtype=torch.float32)


def _whole_box(rng: np.random.Generator, points: int) -> np.ndarray:
    return box_surface(rng, points, rng.uniform(0.03, 0.16, 3))


def _visible_box(rng: np.random.Generator, points: int) -> np.ndarray:
    return box_surface(rng, points, rng.uniform(0.03, 0.16, 3), rng.normal(size=3))


def _blob(rng: np.random.Generator, points: int) -> np.ndarray:
    return rng.normal(size=(points, 3)) * rng.uniform(0.01, 0.05, 3)


def _hull(rng: np.random.Generator, points: int) -> np.ndarray:
    corners = rng.normal(size=(rng.integers(6, 25), 3)) * rng.uniform(0.02, 0.05, 3)
    return _on_surface(trimesh.convex.convex_hull(corners), rng, points)


def _object(rng: np.random.Generator, points: int) -> np.ndarray:
    shape = build(sample_shape(str(rng.choice(list(CATEGORIES))), rng, (0.05, 0.16)))
    return _on_surface(trimesh.Trimesh(shape.vertices, shape.faces), rng, points)


def _on_surface(mesh: trimesh.Trimesh, rng: np.random.Generator, points: int) -> np.ndarray:
    return np.asarray(trimesh.sample.sample_surface(mesh, points, seed=int(rng.integers(2**31)))[0])


KINDS: dict[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    "box": _whole_box,
    "visible sides of a box": _visible_box,
    "Gaussian blob": _blob,
    "random hull": _hull,
    "catalogue": _object,
}


def random_rotations(count: int, generator: torch.Generator | None = None) -> torch.Tensor:
    """Drawn uniformly from SO(3)."""
    return rotation_from_quaternion(torch.randn((count, 4), generator=generator))


def minimum_volume_rotation(points: torch.Tensor, valid: torch.Tensor, **search: int) -> torch.Tensor:
    """World from box, for the tightest box around each cloud, in any of its 24 equivalent orientations."""
    clouds = gather_clouds(points.float(), valid)
    candidates = find_candidates(clouds, **search)
    edges = torch.einsum("pbi,bcij->pbcj", clouds.points, candidates)
    thickened = edges.amax(dim=0) - edges.amin(dim=0) + clouds.thickness[:, None, None]
    return candidates[torch.arange(len(candidates)), thickened.prod(dim=-1).argmin(dim=-1)]
