import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from obpose.errors import UsageError
from obpose.model.nerf.detail import EDGE
from obpose.model.nerf.field import Conditioning
from obpose.model.obpose import ObPose
from obpose.scenes.appearance.table_texture import pattern_like
from obpose.scenes.extent import shape_extent
from obpose.scenes.infer import infer_scene
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.flow import Flow, sample_grids
from obpose.scenes.priors.flow_prior import FlowPrior
from obpose.scenes.priors.gaussian import learned_prior
from obpose.scenes.priors.grids import Grids, facing
from obpose.scenes.priors.object_bank import FoundObjects, find_objects
from obpose.scenes.priors.sample import sample_scene
from obpose.scenes.rendering import conditioning
from obpose.scenes.scene import Scene
from tests.obpose.analytic_fields import BallField
from tests.obpose.scenes.small_scenes import CAMERA, some_model, some_scene, some_tables
from tests.worlds.observations import table_scene

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
    with pytest.raises(UsageError, match="no room for"):
        sampled(8, room=0.2)


def test_objects_that_have_no_room_are_drawn_again():
    """Of eight seeds one puts the first two such that the third has no room."""
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


def found(*, objects: int = 3) -> FoundObjects:
    """Balls with details and rotations of their own."""
    scene = some_scene(objects=objects)
    corner = torch.tensor([0.5, 0.5])
    parts = (
        scene.what[0],
        scene.rotation[0],
        0.01 * (1 + torch.arange(objects)),
        scene.detail,
        scene.background,
        replace(some_tables(), spots=some_tables().spots * torch.tensor([1.0, 3.0])[:, None, None, None]),
    )
    return FoundObjects(*parts, low=-corner, high=corner)


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


def flow_prior(flow: Flow, model: ObPose) -> FlowPrior:
    rest = learned_prior(model)
    return FlowPrior(flow, some_tables(), rest.background, rest.low, rest.high)


def test_objects_of_a_flow_stand_on_the_table_and_face_the_camera():
    model = some_model()
    of, edge = Origin(model, Path("folder"), "name", "hash"), 0.12
    known = Known(edge)
    source = flow_prior(known, model)
    draw = lambda: sample_scene(  # noqa: E731
        of, source, objects=4, cameras=(CAMERA,), generator=torch.Generator().manual_seed(0)
    )
    scene = draw()
    assert torch.equal(draw().center, scene.center)
    assert torch.equal(scene.what[0], source.flow.code.expand(4, -1))
    torch.testing.assert_close(scene.detail, known.only.values.expand(4, -1, -1, -1, -1))
    torch.testing.assert_close(scene.alone, torch.full((4,), edge / 0.2))
    assert (source.tables.lights == scene.light).all(dim=1).any()
    assert scene.pattern.std() > 0.1
    # Points of the lattice are 8 mm apart; what is dense begins half a step below the first, in the middle.
    assert (scene.center[0, :, 2]).abs().max() < 0.005
    for place in range(4):
        camera = CAMERA.world_from_camera[:3, 3]
        torch.testing.assert_close(scene.rotation[0, place], facing(scene.center[0, place], camera))
        codes = conditioning(model, scene.what[0, place], scene.detail[place], scene.alone[place])
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
    monkeypatch.setattr("obpose.scenes.priors.sample.sample_grids", lambda *_: next(drawn))
    of = Origin(model, Path("folder"), "name", "hash")
    source = flow_prior(known, model)
    scene = sample_scene(of, source, objects=1, cameras=(CAMERA,), generator=torch.Generator().manual_seed(0))
    assert scene.detail[0, 8, 8, 10, 0] > scene.detail[0, 8, 8, 1, 0] + 5
    assert next(drawn, None) is None


def test_found_objects_are_what_they_were_with_their_details():
    of, source = origin(), found()
    generator = torch.Generator().manual_seed(0)
    scene = sample_scene(of, source, objects=5, cameras=(CAMERA,), generator=generator)
    for place in range(5):
        (same,) = (source.what == scene.what[0, place]).all(dim=1).nonzero()
        assert torch.equal(scene.detail[place], source.detail[same[0]])
        assert scene.center[0, place, 2] == source.height[same[0]]
        # Turned about the vertical: what was level, or up, stays so.
        turn = scene.rotation[0, place] @ source.rotation[same[0]].T
        torch.testing.assert_close(turn[2], torch.tensor([0.0, 0.0, 1.0]), atol=1e-5, rtol=0)
    ((at,),) = (source.background == scene.background[0]).all(dim=1).nonzero()
    assert torch.equal(scene.light, source.tables.lights[at])
    of_that, of_other = (pattern_like(source.tables.spots[place], torch.Generator()) for place in (at, 1 - at))
    assert (scene.pattern.std() - of_that.std()).abs() < (scene.pattern.std() - of_other.std()).abs()


def test_what_found_objects_have_below_the_table_needs_no_room():
    """Balls of 4 cm: all but their tops below the table, many more fit beside each other than where they stand."""
    sunk = replace(found(), height=torch.full((3,), -0.035), low=torch.full((2,), -0.05), high=torch.full((2,), 0.05))
    draw = lambda source: sample_scene(  # noqa: E731
        origin(), source, objects=5, cameras=(CAMERA,), generator=torch.Generator().manual_seed(0)
    )
    assert len(draw(sunk).ids) == 5
    with pytest.raises(UsageError, match="no room for"):
        draw(replace(sunk, height=torch.full((3,), 0.04)))


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


def test_objects_are_found_as_scenes_are_inferred():
    # Codes that do not depend on the field, so that it can be chosen by them.
    of = Origin(some_model(**{"model.attention.posterior_refinements": 0}), Path("folder"), "name", "hash")
    clips = [table_scene(batch=1, frames=2, height=16, width=16, seed=seed) for seed in (0, 1)]
    scenes = [infer_scene(of, clip) for clip in clips]
    middle = float(torch.stack([scene.what[-1, :, 0] for scene in scenes]).median())
    of.model.object_field = SomeBalls(middle)
    source = find_objects(of, clips, refinements=0)
    scenes = [infer_scene(of, clip) for clip in clips]
    there = [
        (scene, place)
        for scene in scenes
        for place in range(4)
        # Its highest voxel, of the ball's half edges of 10 cm, is above the table.
        if scene.what[-1, place, 0] > middle and scene.center[-1, place, 2] + 0.1 * RADIUS > 0.02
    ]
    assert 0 < len(there) < 8
    assert torch.equal(source.what, torch.stack([scene.what[-1, place] for scene, place in there]))
    assert torch.equal(source.rotation, torch.stack([scene.rotation[-1, place] for scene, place in there]))
    assert torch.equal(source.height, torch.stack([scene.center[-1, place, 2] for scene, place in there]))
    assert torch.equal(source.background, torch.stack([scene.background[-1] for scene in scenes]))
    # Too few to say where objects are.
    torch.testing.assert_close(source.high - source.low, torch.full((2,), of.model.config.model.workspace_size / 2))
    of.model.object_field = BallField(-10.0, latent=32)
    with pytest.raises(UsageError, match="No objects were found in 2 clips"):
        find_objects(of, clips, refinements=0)
