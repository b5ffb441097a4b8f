import pytest
import torch

from obpose.geometry import all_rays, sample_rays, sample_rays_where, unproject
from obpose.types import Observation
from tests.worlds.observations import labels_by_colour, table_scene

HEIGHT, WIDTH = 8, 10


def observation(*, seen: float = 0.8) -> Observation:
    """Two clips of two frames of one view, with holes, whose red is the number of the pixel."""
    generator = torch.Generator().manual_seed(0)
    size = (2, 2, 1, HEIGHT, WIDTH)
    rgb = torch.arange(float(HEIGHT * WIDTH)).view(HEIGHT, WIDTH, 1).expand(*size, 3) / (HEIGHT * WIDTH)
    k = torch.tensor([[10.0, 0, 5], [0, 10, 4], [0, 0, 1]]).expand(2, 1, 3, 3)
    valid = torch.rand(size, generator=generator) < seen
    return Observation(rgb, 1 + torch.rand(size, generator=generator), valid, k, torch.eye(4).expand(2, 1, 4, 4))


def corner() -> torch.Tensor:
    """Interest in the first rows alone."""
    interest = torch.full((2, 2, 1, HEIGHT, WIDTH), 1e-3)
    interest[:, :, :, :2] = 1
    return interest


def test_rays_of_every_view_end_at_the_surfaces_of_the_world():
    scene = table_scene(views=3)
    rays, points = all_rays(scene), unproject(scene)
    torch.testing.assert_close(rays.origin + rays.direction * rays.depth[..., None], points.flatten(2, 4))
    assert points[labels_by_colour(scene.rgb) == 0][:, 2].abs().max() < 1e-4


@pytest.mark.parametrize("count", [25, 60])
def test_pixels_are_drawn_once_and_those_without_depth_last(count: int):
    scene = observation(seen=0.5)
    rays = sample_rays(scene, count, torch.Generator().manual_seed(0))
    torch.testing.assert_close(rays.colour[..., 0] * HEIGHT * WIDTH, rays.index.float())
    assert all(len(index.unique()) == count for index in rays.index.flatten(0, 1))
    assert torch.equal(rays.valid.sum(dim=-1), scene.valid.sum(dim=(2, 3, 4)).clamp(max=count))


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_weighted_means_over_rays_drawn_where_it_matters_are_those_over_all_pixels(share: float):
    rays = [
        sample_rays_where(observation(), 40, corner(), share=share, generator=torch.Generator().manual_seed(seed))
        for seed in range(400)
    ]
    every = all_rays(observation())
    for value in (lambda r: r.colour[..., 0], lambda r: r.depth, lambda r: (r.colour[..., 0] < 0.25).float()):
        drawn = torch.stack([(value(some) * some.weight).mean() for some in rays]).mean()
        assert drawn.item() == pytest.approx(value(every)[every.valid].mean().item(), rel=0.03)
    assert max(some.weight.max() for some in rays) <= 1 / (1 - share) + 1e-5


def test_the_share_of_the_rays_is_where_the_interest_is():
    rays = sample_rays_where(observation(), 60, corner(), share=0.5, generator=torch.Generator().manual_seed(0))
    assert rays.index.shape == (2, 2, 60)
    assert 0.5 < (rays.index < 2 * WIDTH).float().mean() < 0.75
    assert rays.valid.all()


def test_a_frame_without_depth_has_no_weight():
    rays = sample_rays_where(observation(seen=0.0), 60, corner(), share=0.5, generator=torch.Generator().manual_seed(0))
    assert (rays.weight == 0).all()


def test_interests_of_a_diverged_model_can_be_drawn_from():
    generator = torch.Generator().manual_seed(0)
    rays = sample_rays_where(observation(), 5, corner() * torch.nan, share=0.5, generator=generator)
    assert rays.depth.isfinite().all()
