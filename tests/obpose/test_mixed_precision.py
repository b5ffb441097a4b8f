"""Networks may compute in half precision, but geometry must not: a percent of a metre is more than an object's edge."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from obpose.baselines.obsurf.encoder import project
from obpose.baselines.ogc import rigid_motions
from obpose.config import LatentConfig
from obpose.contact.images import images_of
from obpose.geometry import from_box, to_box, unproject, view_directions
from obpose.model.layers.kpconv import influence, kernel_points
from obpose.model.nerf.voxels import observed_free
from obpose.model.pose.encoder import neighbourhoods
from obpose.model.pose.location import observed_center
from tests.obpose.clouds import random_rotations
from tests.worlds.observations import table_scene

SCENE = table_scene(frames=1)


def draw(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def box() -> tuple[Tensor, Tensor, float]:
    return draw(1, 3, seed=1), random_rotations(1, torch.Generator().manual_seed(2)), 0.2


COMPUTATIONS: dict[str, Callable[[], Tensor]] = {
    "points": lambda: unproject(SCENE),
    "rays": lambda: view_directions(SCENE),
    "into a box": lambda: to_box(draw(1, 50, 3), *box()),
    "out of a box": lambda: from_box(draw(1, 50, 3), *box()),
    "into an image": lambda: project(64 * draw(1, 50, 3), SCENE.k[:, 0], SCENE.world_from_camera[:, 0])[0],
    "what is free": lambda: observed_free(draw(1, 1, 1, 5000, 3) - 0.5, SCENE),
    "influences": lambda: influence(draw(50, 3), kernel_points()),
    "neighbours": lambda: (
        neighbourhoods(
            draw(2, 40, 3),
            torch.ones(2, 40, dtype=torch.bool),
            places=draw(8, 3, seed=3),
            kernel=kernel_points(),
            radius=LatentConfig().radius,
        ).influences
    ),
    "contact inputs": lambda: images_of(SCENE, center=torch.zeros(3), table=0.0).inputs(),
    "rigid motions": lambda: rigid_motions(draw(20, 3), draw(20, 3, seed=1), draw(2, 20, seed=2))[0],
    "centres": lambda: observed_center(
        draw(1, 1, 3, 500).log_softmax(dim=2),
        draw(1, 1, 500, 3, seed=4),
        torch.ones(1, 1, 500, dtype=torch.bool),
        min_points=1,
        exponent=3.0,
    ),
}


@pytest.mark.parametrize("name", COMPUTATIONS)
def test_geometry_is_the_same_in_mixed_precision(name: str):
    expected = COMPUTATIONS[name]()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(COMPUTATIONS[name](), expected)


def test_half_precision_reaches_what_is_not_protected():
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert (draw(5, 3) @ draw(3, 3)).dtype == torch.bfloat16
