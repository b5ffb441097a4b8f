from dataclasses import replace
from pathlib import Path

import pytest
import torch

from obpose.creation.origin import Origin
from obpose.creation.prior import learned_prior
from obpose.creation.sample import sample_scene, shape_extent
from obpose.creation.scene import Scene
from obpose.errors import UsageError
from obpose.nerf.field import Conditioning
from tests.obpose.analytic_fields import BallField
from tests.obpose.creation.scenes import CAMERA, some_model

RADIUS = 0.4
"""Of the balls, in half edges of the box of 20 cm."""


def origin() -> Origin:
    """A model all of whose objects are balls of 4 cm."""
    model = some_model()
    model.object_field = BallField(RADIUS, latent=32)
    return Origin(model, Path("folder"), "name", "hash")


def sampled(objects: int, seed: int = 0, room: float = 1.0) -> Scene:
    of = origin()
    prior = learned_prior(of.model)
    prior = replace(prior, low=prior.low * room, high=prior.high * room)
    generator = torch.Generator().manual_seed(seed)
    return sample_scene(of, prior, objects=objects, cameras=(CAMERA,), generator=generator)


def test_objects_stand_on_the_table_beside_each_other():
    scene = sampled(6)
    # Voxels of 12.5 mm know the ball's radius to about half of that.
    assert (scene.center[0, :, 2] - 0.1 * RADIUS).abs().max() < 0.01
    away = torch.cdist(scene.center[0, :, :2], scene.center[0, :, :2]) + 10 * torch.eye(6)
    assert away.min() > 2 * 0.1 * RADIUS - 0.02
    torch.testing.assert_close(scene.rotation[0, :, 2, 2], torch.ones(6))


class SomeBalls(BallField):
    """Balls of the codes whose first number is positive, and nothing of the others."""

    def __init__(self) -> None:
        super().__init__(RADIUS, latent=32)
        with torch.no_grad():
            self.codes.weight.zero_()[0, 0] = 1

    def density(self, points: torch.Tensor, codes: Conditioning) -> tuple[torch.Tensor, torch.Tensor]:
        logits, hidden = super().density(points, codes)
        return torch.where(codes.first[..., 0] > 0, logits, -30.0), hidden


def test_objects_that_are_nowhere_are_drawn_again():
    of = origin()
    of.model.object_field = SomeBalls()
    prior = learned_prior(of.model)
    generator = torch.Generator().manual_seed(0)
    drawn = prior.what.draw(6, torch.Generator().manual_seed(0))
    scene = sample_scene(of, prior, objects=6, cameras=(CAMERA,), generator=generator)
    assert (drawn[:, 0] <= 0).any()
    assert (scene.what[0, :, 0] > 0).all()


def test_the_same_seed_gives_the_same_scene():
    assert torch.equal(sampled(3).what, sampled(3).what)
    assert torch.equal(sampled(3).center, sampled(3).center)
    assert not torch.equal(sampled(3).center, sampled(3, seed=1).center)


def test_there_may_be_none_and_there_may_be_too_many():
    assert sampled(0).ids == ()
    with pytest.raises(UsageError, match="no room for object"):
        sampled(8, room=0.2)


def test_the_extent_is_that_of_the_field():
    extent = shape_extent(origin().model, torch.zeros(32), torch.eye(3))
    assert extent.norm(dim=-1).max() == pytest.approx(0.1 * RADIUS, abs=0.007)
    empty = some_model()
    empty.object_field = BallField(-10.0, latent=32)
    assert torch.equal(shape_extent(empty, torch.zeros(32), torch.eye(3)), torch.zeros(1, 3))
