"""Fields and observations given by formulas, to compare what is estimated of them with what they are."""

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.config import FieldConfig
from obpose.geometry import view_directions
from obpose.model.nerf.field import Conditioning, Field, Hidden
from obpose.types import Boxes, Observation

SMALL = FieldConfig(width=16, depth=4, position_frequencies=2, direction_frequencies=1)


class BallField(Field):
    """A ball of the same colour everywhere; its radius, and where in the box it is, in box coordinates."""

    def __init__(self, radius: float, latent: int = 2, middle: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        super().__init__(SMALL, latent)
        self.radius, self.middle = radius, torch.tensor(middle)

    def density(self, points: Float[Tensor, "*shape 3"], codes: Conditioning) -> tuple[Tensor, Hidden]:
        logits = (400 * (self.radius - (points - self.middle).norm(dim=-1))).clamp(-20, 20)
        return logits, Hidden(points.new_zeros(*logits.shape, 16), None)

    def colour(self, hidden: Hidden, directions: Float[Tensor, "*shape 3"], codes: Conditioning) -> Tensor:
        return torch.tensor([1.0, 0.5, 0.25]).expand_as(directions)


def empty_field() -> Field:
    """One that is nowhere dense."""
    return BallField(-10.0)


def random_boxes(batch: int, frames: int, slots: int, size: float = 0.2, seed: int = 0) -> Boxes:
    """Boxes in any orientation, their centres less than 10 cm from the origin in each direction."""
    generator = torch.Generator().manual_seed(seed)
    center = 0.2 * torch.rand(batch, frames, slots, 3, generator=generator) - 0.1
    rotation = torch.linalg.qr(torch.randn(batch, frames, slots, 3, 3, generator=generator))[0]
    return Boxes(center, rotation * torch.linalg.det(rotation)[..., None, None], size)


def upright_box(center: tuple[float, float, float], size: float = 0.2) -> Boxes:
    return Boxes(torch.tensor(center).view(1, 1, 1, 3), torch.eye(3).view(1, 1, 1, 3, 3), size)


def blind(batch: int = 1, frames: int = 1) -> Observation:
    """A camera that sees nothing."""
    depth = torch.zeros(batch, frames, 1, 4, 4)
    k = torch.eye(3).expand(batch, 1, 3, 3)
    return Observation(torch.zeros(*depth.shape, 3), depth, depth > 0, k, torch.eye(4).expand(batch, 1, 4, 4))


def ball_on_table(center: tuple[float, float, float], radius: float, size: int = 64) -> Observation:
    """A ball over the table z = 0, seen obliquely from above, 60 cm away."""
    pose = torch.eye(4)
    pose[:3, :3] = torch.tensor([[1.0, 0, 0], [0, -0.6, 0.8], [0, -0.8, -0.6]])
    pose[:3, 3] = torch.tensor([0.0, -0.48, 0.36])
    k = torch.tensor([[1.5 * size, 0, size / 2], [0, 1.5 * size, size / 2], [0, 0, 1]])
    depth = torch.ones(1, 1, 1, size, size)
    scene = Observation(torch.zeros(*depth.shape, 3), depth, depth > 0, k[None, None], pose[None, None])
    direction = view_directions(scene)
    return Observation(scene.rgb, _depth(pose[:3, 3], direction, center, radius)[:, None], *_rest(scene))


def _rest(scene: Observation) -> tuple[Tensor, Tensor, Tensor]:
    return scene.valid, scene.k, scene.world_from_camera


def _depth(origin: Tensor, direction: Tensor, center: tuple[float, float, float], radius: float) -> Tensor:
    table = -origin[2] / direction[..., 2]
    to = origin - torch.tensor(center)
    a, b, c = direction.square().sum(-1), direction @ to, to.square().sum() - radius**2
    root = b.square() - a * c
    return torch.where(root > 0, (-b - root.clamp(min=0).sqrt()) / a, table)
