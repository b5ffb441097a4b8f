import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from datagen.config import Recipe
from datagen.sampling.cameras import sample_cameras
from obpose.errors import UsageError
from obpose.model.nerf.detail import EDGE
from obpose.model.nerf.field import Conditioning
from obpose.model.obpose import ObPose
from obpose.scenes.bounds import shape_extent
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.codes import CodePrior
from obpose.scenes.priors.flow import Flow, sample_grids
from obpose.scenes.priors.flow_prior import FlowObjects
from obpose.scenes.priors.gaussian import learned_prior
from obpose.scenes.priors.grids import Grids, facing
from obpose.scenes.priors.interface import ScenePrior
from obpose.scenes.priors.sample import default_camera, sample_scene
from obpose.scenes.rendering import conditioning
from obpose.scenes.scene import Scene
from tests.obpose.analytic_fields import BallField
from tests.obpose.scenes.small_scenes import CAMERA, some_model, some_tables

RADIUS = 0.4
"""Radius of the balls, in half edges of the box of 20 cm."""


def origin(**changes: object) -> Origin:
    """A model all of whose objects are balls of 4 cm."""
    model = some_model(**changes)
    model.object_field = BallField(RADIUS, latent=32)
    return Origin(model, Path("folder"), "name", "hash")


def sampled(objects: int, seed: int = 0, room: float = 1.0, **changes: object) -> Scene:
    of = origin(**changes)
    prior = learned_prior(of)
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


def test_objects_stand_on_a_table_that_is_elsewhere():
    raised, usual = sampled(3, **{"model.table": 0.201}), sampled(3)
    torch.testing.assert_close(raised.center - usual.center, torch.tensor([0.0, 0.0, 0.2]).expand(1, 3, 3))


class SomeBalls(BallField):
    """Balls of the codes whose first number is above something; of the others nothing, or some at the top of boxes."""

    def __init__(self, least: float = 0.0, *, others: float | None = None) -> None:
        super().__init__(RADIUS, latent=32)
        self.least, self.others = least, others
        with torch.no_grad():
            self.codes.weight.zero_()[0, 0] = 1

    def density(self, points: torch.Tensor, codes: Conditioning) -> tuple[torch.Tensor, torch.Tensor]:
        logits, hidden = super().density(points, codes)
        others = -30.0
        if self.others is not None:
            others, _ = super().density(points - torch.tensor([0.0, 0.0, self.others]), codes)
        return torch.where(codes.first[..., 0] > self.least, logits, others), hidden


@pytest.mark.parametrize("others", [None, 0.6])
def test_objects_that_are_nowhere_or_above_the_middle_are_drawn_again(others: float | None):
    of = origin()
    of.model.object_field = SomeBalls(others=others)
    prior = learned_prior(of)
    assert isinstance(prior.objects, CodePrior)
    generator = torch.Generator().manual_seed(0)
    drawn = prior.objects.what.draw(6, torch.Generator().manual_seed(0))
    scene = sample_scene(of, prior, objects=6, cameras=(CAMERA,), generator=generator)
    assert (drawn[:, 0] <= 0).any()
    assert (scene.what[0, :, 0] > 0).all()


def test_there_may_be_none_and_there_may_be_too_many():
    assert sampled(0).ids == ()
    with pytest.raises(UsageError, match="no room for"):
        sampled(8, room=0.2)


def test_objects_that_have_no_room_are_drawn_again():
    """One of the eight seeds places the first two objects such that the third has no room."""
    for seed in range(8):
        assert len(sampled(3, seed=seed, room=0.25).ids) == 3


def test_the_extent_is_that_of_the_field():
    extent = extent_of(origin().model)
    assert extent.norm(dim=-1).max() == pytest.approx(0.1 * RADIUS, abs=0.007)
    empty = some_model()
    empty.object_field = BallField(-10.0, latent=32)
    assert torch.equal(extent_of(empty), torch.zeros(1, 3))


def extent_of(model: ObPose) -> torch.Tensor:
    return shape_extent(model, model.object_field.condition(torch.zeros(32)), torch.eye(3))


class Known(Flow):
    """Knows one object alone: a cube of so many metres, dense in its upper half, and nothing beneath."""

    def __init__(self, edge: float) -> None:
        super().__init__(latent=32)
        values = torch.zeros(1, EDGE, EDGE, EDGE, 4)
        values[..., 0] = -6.0
        values[:, 2:-2, 2:-2, EDGE // 2 : -2, 0] = 6.0
        self.only = Grids(values, torch.tensor([edge / 2]))
        self.shapes.mean.copy_(values[..., 0].flatten())
        self.plain_mean[3] = math.log(edge / 2)

    def forward(self, noisy: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
        return torch.zeros_like(noisy)


def flow_prior(flow: Flow, of: Origin) -> ScenePrior:
    return replace(learned_prior(of), objects=FlowObjects(flow), tables=some_tables())


def test_objects_of_a_flow_stand_on_the_table_and_face_the_camera():
    model = some_model()
    of, edge = Origin(model, Path("folder"), "name", "hash"), 0.12
    known = Known(edge)
    source = flow_prior(known, of)
    draw = lambda: sample_scene(  # noqa: E731
        of, source, objects=4, cameras=(CAMERA,), generator=torch.Generator().manual_seed(0)
    )
    scene = draw()
    assert torch.equal(draw().center, scene.center)
    assert torch.equal(scene.what[0], known.code.expand(4, -1))
    torch.testing.assert_close(scene.appearance.detail, known.only.values.expand(4, -1, -1, -1, -1))
    torch.testing.assert_close(scene.appearance.own_scale, torch.full((4,), edge / 0.2))
    assert (source.tables.lights == scene.appearance.light).all(dim=1).any()
    assert scene.appearance.texture.std() > 0.1
    # Points of the lattice are 8 mm apart; what is dense begins half a step below the first, in the middle.
    assert (scene.center[0, :, 2]).abs().max() < 0.005
    for place in range(4):
        camera = CAMERA.world_from_camera[:3, 3]
        torch.testing.assert_close(scene.rotation[0, place], facing(scene.center[0, place], camera))
        codes = conditioning(
            model, scene.what[0, place], scene.appearance.detail[place], scene.appearance.own_scale[place]
        )
        extent = shape_extent(model, codes, torch.eye(3))
        low, high = extent.amin(dim=0), extent.amax(dim=0)
        # Middles of voxels of 7.5 mm within 48 mm.
        assert (high - torch.tensor([0.044, 0.044, 0.044])).abs().max() < 0.004
        assert (low - torch.tensor([-0.044, -0.044, 0.0])).abs().max() < 0.004


def test_objects_of_a_flow_that_are_nowhere_are_drawn_again(monkeypatch: pytest.MonkeyPatch):
    model, known = some_model(), Known(0.12)
    grids, empty = (sample_grids(known, 1, torch.Generator()) for _ in range(2))
    empty.values[..., 0] = -6.0
    drawn = iter([empty, empty, grids])
    monkeypatch.setattr("obpose.scenes.priors.flow_prior.sample_grids", lambda *_: next(drawn))
    of = Origin(model, Path("folder"), "name", "hash")
    source = flow_prior(known, of)
    scene = sample_scene(of, source, objects=1, cameras=(CAMERA,), generator=torch.Generator().manual_seed(0))
    assert scene.appearance.detail[0, 8, 8, 10, 0] > scene.appearance.detail[0, 8, 8, 1, 0] + 5
    assert next(drawn, None) is None


def test_extents_are_those_of_fields_with_their_details():
    model, code = some_model(), torch.zeros(32)
    with torch.no_grad():
        model.object_field.density_logit.bias.fill_(10)
    detail = torch.zeros(16, 16, 16, 4)
    detail[:, :, 8:, 0] = -100.0
    whole, lower = (
        shape_extent(model, conditioning(model, code, some, torch.zeros(())), torch.eye(3))
        for some in (torch.zeros_like(detail), detail)
    )
    assert whole[:, 2].max() > 0.09
    assert lower[:, 2].min() < -0.09
    assert lower[:, 2].max() < 0.01


def test_the_default_camera_is_that_of_the_recipe_moving():
    camera, (expected,) = default_camera(), sample_cameras(Recipe(), np.random.default_rng(0))
    np.testing.assert_allclose(camera.world_from_camera, expected.world_from_camera, atol=1e-5)
    np.testing.assert_allclose(camera.k, expected.k(128, 128), rtol=1e-5)
