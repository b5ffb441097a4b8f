"""Small observations made from formulas, for tests of the model."""

import math
from dataclasses import replace

import torch

from obpose.geometry import unproject
from obpose.types import Observation


def table_scene(
    *,
    batch: int = 1,
    frames: int = 2,
    views: int = 1,
    height: int = 32,
    width: int = 32,
    spheres: int = 2,
    holes: float = 0.0,
    anywhere: bool = False,
    seed: int = 0,
) -> Observation:
    """Coloured spheres of 3 to 5 cm radius on the table z = 0, apart, seen as in the `moving` recipe.

    They stand from left to right; or `anywhere`, half as far from each other, so that no division of the table serves
    all scenes.
    """
    generator = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.rand(shape, generator=generator)  # noqa: E731
    centers = torch.stack([torch.linspace(-0.18, 0.18, spheres).expand(batch, -1), 0.1 * draw(batch, spheres)], -1)
    radii = 0.03 + 0.02 * draw(batch, spheres)
    colours, table = draw(batch, spheres, 3), draw(batch, 3)
    if anywhere:
        angles = 2 * math.pi * draw(batch)[:, None]
        x, y = (centers / 2).unbind(-1)
        turned = torch.stack([angles.cos() * x - angles.sin() * y, angles.sin() * x + angles.cos() * y], -1)
        centers = turned + 0.3 * (draw(batch, 1, 2) - 0.5)
    k, poses = _cameras(batch, views, height, width)
    rgb, depth = [], []
    for frame in range(frames):
        moved = centers + 0.01 * frame
        rgb_frame, depth_frame = _trace(k, poses, moved, radii, colours, table, height, width)
        rgb.append(rgb_frame)
        depth.append(depth_frame)
    valid = torch.rand((batch, frames, views, height, width), generator=generator) >= holes
    return Observation(torch.stack(rgb, 1), torch.stack(depth, 1) * valid, valid, k, poses)


def labels_by_colour(rgb: torch.Tensor) -> torch.Tensor:
    """Which of the scene's colours each pixel of shape (..., 3) has; 0 is the most frequent, the table's."""
    _, labels, counts = rgb.flatten(0, -2).unique(dim=0, return_inverse=True, return_counts=True)
    return counts.argsort(descending=True).argsort()[labels].view(rgb.shape[:-1])


def pairs_of_balls(count: int, *, size: int) -> tuple[Observation, torch.Tensor]:
    """Two halves of balls of 7 to 12 cm radius, one at x < 0, one at x > 0, and nothing else; labels 1 and 2."""
    draw = lambda *shape: torch.rand(shape, generator=generator)  # noqa: E731
    generator = torch.Generator().manual_seed(0)
    centers, radii = 0.3 * (draw(count, 2, 2) - 0.5), 0.07 + 0.05 * draw(count, 2)
    centers[..., 0] = 0.2 * centers[..., 0] + torch.tensor([-0.13, 0.13])
    k, poses = _cameras(count, 1, size, size)
    colours = draw(count, 2, 3)
    rgb, depth = _trace(k, poses, centers, radii, colours, draw(count, 3), size, size)
    alone, points, seen = _without_table(Observation(rgb[:, None], depth[:, None], depth[:, None] > 0, k, poses))
    return alone, seen.long() * (1 + (points[..., 0] > 0))


def balls_in_depth(count: int, *, size: int) -> tuple[Observation, torch.Tensor]:
    """Halves of balls of 10 cm radius on 20 x 40 cm, and nothing else; labels 1 and 2.

    One ball in the first half of the scenes, two in the others, one behind the other as the camera sees them.
    """
    draw = lambda *shape: torch.rand(shape, generator=generator)  # noqa: E731
    generator = torch.Generator().manual_seed(0)
    tries = torch.tensor([0.2, 0.4]) * (draw(count, 400, 2, 2) - 0.5)
    apart = (tries[:, :, 0, 1] - tries[:, :, 1, 1]).abs() > 0.2
    centers = tries[torch.arange(count), apart.float().argmax(1)]
    radii = torch.full((count, 2), 0.1)
    radii[: count // 2, 1] = 1e-6
    k, poses = _cameras(count, 1, size, size, distance=0.8)
    rgb, depth = _trace(k, poses, centers, radii, draw(count, 2, 3), torch.full((count, 3), 0.5), size, size)
    alone, points, seen = _without_table(Observation(rgb[:, None], depth[:, None], depth[:, None] > 0, k, poses))
    distance = (points[..., None, :2] - centers[:, None, None, None, None]).norm(dim=-1)
    return alone, seen.long() * (1 + distance.argmin(-1))


def _without_table(on_table: Observation) -> tuple[Observation, torch.Tensor, torch.Tensor]:
    """Observation without its table, the points, and which of them are not the table's."""
    points = unproject(on_table)
    seen = points[..., 2] > 1e-4
    alone = replace(on_table, rgb=on_table.rgb * seen[..., None], depth=on_table.depth * seen, valid=seen)
    return alone, points, seen


def _cameras(
    batch: int, views: int, height: int, width: int, *, distance: float = 1.03
) -> tuple[torch.Tensor, torch.Tensor]:
    focal = height / 2 / math.tan(math.radians(20))
    k = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]).expand(batch, views, 3, 3)
    tilt = math.radians(55)
    poses = torch.zeros(batch, views, 4, 4)
    for view in range(views):
        turn = 2 * math.pi * view / views
        forward = torch.tensor([0.0, math.cos(tilt), -math.sin(tilt)])
        right = torch.tensor([1.0, 0.0, 0.0])
        rotation = torch.stack([right, torch.linalg.cross(forward, right), forward], dim=1)
        spin = torch.tensor([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1.0]])
        poses[:, view, :3, :3] = spin @ rotation
        poses[:, view, :3, 3] = spin @ (-distance * forward)
        poses[:, view, 3, 3] = 1
    return k.clone(), poses


def _trace(
    k: torch.Tensor,
    poses: torch.Tensor,
    centers: torch.Tensor,
    radii: torch.Tensor,
    colours: torch.Tensor,
    table: torch.Tensor,
    height: int,
    width: int,
) -> tuple[torch.Tensor, torch.Tensor]:
    batch, views = k.shape[:2]
    u, v = torch.meshgrid(torch.arange(width) + 0.5, torch.arange(height) + 0.5, indexing="xy")
    in_camera = torch.stack([(u - width / 2) / k[0, 0, 0, 0], (v - height / 2) / k[0, 0, 1, 1], torch.ones_like(u)], -1)
    direction = torch.einsum("bvij,hwj->bvhwi", poses[..., :3, :3], in_camera)
    origin = poses[:, :, None, None, :3, 3]
    depth = -origin[..., 2] / direction[..., 2]
    rgb = table[:, None, None, None].expand(batch, views, height, width, 3)
    for i in range(radii.shape[1]):
        middle = torch.cat([centers[:, i], radii[:, i, None]], -1)[:, None, None, None]
        to = origin - middle
        a, b = (direction**2).sum(-1), (direction * to).sum(-1)
        c = (to**2).sum(-1) - radii[:, i, None, None, None] ** 2
        root = b**2 - a * c
        hit_depth = (-b - root.clamp(min=0).sqrt()) / a
        hit = (root > 0) & (hit_depth < depth)
        depth = torch.where(hit, hit_depth, depth)
        rgb = torch.where(hit[..., None], colours[:, i, None, None, None], rgb)
    return rgb, depth
