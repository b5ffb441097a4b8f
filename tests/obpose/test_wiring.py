"""Arguments that the parts of the model pass to each other; the parts have tests of their own."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from einops import repeat

from obpose.geometry import all_rays, from_box, unproject
from obpose.model import obpose as modelling
from obpose.model.backbone import plain_colours
from obpose.model.build import build_obpose
from obpose.model.losses.observation import colour_log_likelihood
from obpose.model.obpose import ObPose
from obpose.model.pose.rotations import rotation_from_vector
from obpose.types import Observation
from obpose.variants import make_config
from tests.worlds.observations import table_scene

STEP = 1000
"""After the warm-up."""


@pytest.fixture
def scene() -> Observation:
    return table_scene(frames=3)


@pytest.fixture
def model() -> ObPose:
    """Untrained, but that its pre-scope expects objects everywhere."""
    torch.manual_seed(0)
    model = build_obpose(make_config("obpose", **{"model.spacing": 0.024, "model.background_size": 3.0}))
    assert model.heads.prescope is not None
    with torch.no_grad():
        model.heads.prescope[-1].bias.copy_(torch.tensor([0.0, 5.0]))
    return model


class Calls:
    """Listens to the calls of a function and lets them through."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, module: Any, name: str):
        self.arguments: list[tuple[Any, ...]] = []
        self.options: list[dict[str, Any]] = []
        function = getattr(module, name)

        def listen(*arguments: Any, **options: Any) -> Any:
            self.arguments.append(arguments)
            self.options.append(options)
            return function(*arguments, **options)

        monkeypatch.setattr(module, name, listen)


@pytest.fixture
def turned(monkeypatch: pytest.MonkeyPatch) -> torch.Tensor:
    """How every box is found to be turned."""
    rotation = rotation_from_vector(torch.tensor([0.3, -0.2, 0.6]))
    monkeypatch.setattr(
        modelling, "observed_rotation", lambda points, *_, slots, **__: rotation.expand(*points.shape[:2], slots, 3, 3)
    )
    return rotation


@pytest.mark.parametrize("encoder", ["what_encoder", "where_encoder"])
def test_object_encoders_see_points_of_the_cloud_in_the_frame_of_a_box(
    model: ObPose, scene: Observation, turned: torch.Tensor, encoder: str
):
    seen: list[Any] = []
    getattr(model, encoder).register_forward_pre_hook(lambda _, arguments: seen.append(arguments[0]))
    inference = model.eval().infer(scene)
    assert torch.equal(inference.boxes.rotation, turned.expand_as(inference.boxes.rotation))
    center, rotation = inference.boxes.center, inference.boxes.rotation
    if encoder == "where_encoder":
        center, rotation = inference.observed_center, torch.eye(3).expand_as(rotation)
    (samples,) = seen
    world = from_box(samples.points, center, rotation, inference.boxes.size)
    cloud = repeat(inference.embeddings.points, "b f p c -> b f s p c", s=world.shape[2])
    nearest = torch.cdist(world, cloud, compute_mode="donot_use_mm_for_euclid_dist").amin(dim=-1)
    assert samples.valid.any()
    assert nearest[samples.valid].max() < 1e-5


def test_neighbourhoods_of_the_object_encoder_are_as_wide_as_is_configured(scene: Observation):
    codes = []
    for radius in (0.5, 0.05):
        torch.manual_seed(0)
        model = build_obpose(make_config("obpose", **{"model.spacing": 0.024, "model.latent.radius": radius})).eval()
        model.what_encoder.register_forward_hook(lambda *call: codes.append(call[2]))  # pyright: ignore
        model.infer(scene)
    assert not torch.allclose(codes[0], codes[1], atol=1e-3)


def test_orientations_are_of_the_pixels_of_their_own_slots(
    model: ObPose, scene: Observation, monkeypatch: pytest.MonkeyPatch
):
    calls = Calls(monkeypatch, modelling, "observed_rotation")
    inference = model.eval().infer(scene)
    points, owners = calls.arguments[0]
    assert torch.equal(points, unproject(scene))
    assert torch.equal(owners, model.pixel_owners(inference.masks, inference.embeddings, scene))


def test_rays_are_drawn_where_the_prescope_expects_objects(
    model: ObPose, scene: Observation, monkeypatch: pytest.MonkeyPatch
):
    calls = Calls(monkeypatch, modelling, "sample_rays_where")
    model.losses(scene, step=STEP, generator=torch.Generator().manual_seed(0))
    _, _, interest = calls.arguments[0][:3]
    assert interest.min() > 0.9
    assert calls.options[0]["share"] == model.config.train.object_rays


def test_shapes_are_looked_for_in_the_boxes_as_they_are_turned_in_any_frame(
    model: ObPose, scene: Observation, turned: torch.Tensor, monkeypatch: pytest.MonkeyPatch
):
    calls = Calls(monkeypatch, modelling, "estimate_shape")
    model.config = replace(model.config, model=replace(model.config.model, table=0.101))
    for seed in range(8):
        model.losses(scene, step=STEP, generator=torch.Generator().manual_seed(seed))
    for _, boxes, _, what, _ in calls.arguments:
        assert torch.equal(boxes.rotation, turned.expand_as(boxes.rotation))
        assert what.shape[1] == scene.depth.shape[1]
    assert len({int(options["frame"]) for options in calls.options}) > 1
    assert calls.options[0]["table"] == pytest.approx(0.1)


def test_posteriors_compare_the_colours_that_the_camera_sees(
    model: ObPose, scene: Observation, monkeypatch: pytest.MonkeyPatch
):
    calls = Calls(monkeypatch, modelling, "posterior_masks")
    with torch.no_grad():
        first = model.eval().infer(scene)
    model.segment(scene)
    _, logits, likelihood, _ = calls.arguments[0]
    rays = all_rays(scene)
    points = rays.origin + rays.direction * rays.depth[..., None]
    with torch.no_grad():
        seen = model.decode(first, points, rays.direction, "with", "in boxes")
    assert seen.colours is not None
    colours = plain_colours(first.embeddings.rgb)
    expected = colour_log_likelihood(seen.colours, colours).sum(dim=-1)
    torch.testing.assert_close(logits, seen.logits, atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(likelihood, expected, atol=1e-2, rtol=1e-2)


def test_the_background_lives_in_the_cube_that_holds_the_cameras_too(model: ObPose, scene: Observation):
    inference = model.eval().infer(scene)
    at = 0.3 * torch.randn(1, 3, 50, 3, generator=torch.Generator().manual_seed(0))
    along = torch.ones_like(at)
    half = build_obpose(make_config("obpose", **{"model.background_size": 1.5})).eval()
    half.load_state_dict(model.state_dict())
    with torch.no_grad():
        one = model.decode(inference, at, along).logits[:, :, 0]
        other = half.decode(inference, at / 2, along).logits[:, :, 0]
        elsewhere = half.decode(inference, at, along).logits[:, :, 0]
    torch.testing.assert_close(one, other, atol=1e-4, rtol=1e-4)
    assert not torch.allclose(one, elsewhere, atol=1e-2)
