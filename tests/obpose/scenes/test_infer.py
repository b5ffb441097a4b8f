from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from obpose.data.resolution import fitting_model
from obpose.model.obpose import ObPose
from obpose.scenes import infer
from obpose.scenes.appearance.light import no_light
from obpose.scenes.appearance.table_texture import no_texture
from obpose.scenes.infer import APPEARANCE_FRAMES, fit_to_frames, infer_labelled, infer_scene, views_as_trained
from obpose.scenes.model_ref import Origin
from obpose.scenes.refine import refine
from obpose.scenes.scene import Scene
from obpose.types import Observation
from tests.obpose.scenes.small_scenes import alike, some_model
from tests.worlds.observations import table_scene


def test_a_scene_holds_the_posterior_means_of_the_objects_in_use():
    origin = Origin(some_model(), Path("folder"), "name", "hash")
    clip = table_scene(batch=1, frames=3)
    scene = infer_scene(origin, clip)
    inference = origin.model.segment(clip).inference
    assert scene.ids == (1, 2, 3, 4)
    assert torch.equal(scene.what, inference.what.mean[0])
    assert not scene.appearance.detail.any()
    assert torch.equal(scene.center, inference.boxes.center[0])
    assert (scene.model, scene.checkpoint, scene.frames) == ("hash", "name", 3)
    assert torch.equal(scene.cameras[0].world_from_camera, clip.world_from_camera[0, 0])


def test_a_scene_can_be_refined_at_once():
    origin = Origin(some_model(), Path("folder"), "name", "hash")
    clip = table_scene(batch=1, frames=2, height=20, width=20)
    model = fitting_model(origin.model, clip)
    refined = infer_scene(origin, clip, refinements=2)
    assert alike(
        refined.with_appearance(light=no_light(), texture=no_texture()),
        refine(model, clip, infer_scene(origin, clip), steps=2),
    )
    assert refined.appearance.detail.any()


def test_a_light_and_then_a_pattern_are_looked_for_in_what_was_fitted_to_the_frames(monkeypatch: pytest.MonkeyPatch):
    origin = Origin(some_model(), Path("folder"), "name", "hash")
    clip = table_scene(batch=1, frames=2, height=20, width=20)
    light, fitted = torch.tensor([0.6, 0.0, 0.8, 0.3]), []

    def found(model: ObPose, observation: Observation, scene: Scene) -> torch.Tensor:
        assert observation.depth.shape[1] == scene.frames == clip.depth.shape[1]
        fitted.append(bool(scene.appearance.detail.any()))
        return light

    def texture(model: ObPose, observation: Observation, scene: Scene) -> torch.Tensor:
        return no_texture() + scene.appearance.light[0]

    monkeypatch.setattr(infer, "find_light", found)
    monkeypatch.setattr(infer, "find_texture", texture)
    plain = infer_scene(origin, clip)
    assert torch.equal(plain.appearance.light, no_light())
    assert torch.equal(plain.appearance.texture, no_texture())
    for scene in (
        infer_scene(origin, clip, refinements=2),
        fit_to_frames(plain, origin.model, clip, refinements=2),
    ):
        assert torch.equal(scene.appearance.light, light)
        assert torch.equal(scene.appearance.texture, no_texture() + light[0])
    assert torch.equal(fit_to_frames(plain, origin.model, clip, refinements=0).appearance.light, no_light())
    assert fitted == [True, True]


def test_light_and_pattern_are_looked_for_in_some_frames_of_a_long_clip(monkeypatch: pytest.MonkeyPatch):
    origin, seen = Origin(some_model(), Path("folder"), "name", "hash"), []
    clip = table_scene(batch=1, frames=APPEARANCE_FRAMES + 3, height=16, width=16)

    def look(find: Callable[[], torch.Tensor]) -> Callable[..., torch.Tensor]:
        return lambda model, observation, scene: (seen.append((observation, scene)), find())[1]

    monkeypatch.setattr(infer, "find_light", look(no_light))
    monkeypatch.setattr(infer, "find_texture", look(no_texture))
    whole = infer_scene(origin, clip, refinements=1)
    assert whole.frames == APPEARANCE_FRAMES + 3
    assert len(seen) == 2
    for observation, scene in seen:
        assert observation.depth.shape[1] == scene.frames == APPEARANCE_FRAMES
        for part, all_of_it in (
            (observation.rgb[0], clip.rgb[0]),
            (observation.depth[0], clip.depth[0]),
            (scene.what, whole.what),
            (scene.center, whole.center),
            (scene.rotation, whole.rotation),
            (scene.background, whole.background),
        ):
            # Every 4/3rd frame, rounded.
            assert torch.equal(part[[0, 1, 2, -1]], all_of_it[[0, 1, 3, -1]])


def test_what_was_inferred_can_be_fitted_afterwards_to_the_views_that_the_model_gets():
    origin = Origin(some_model(**{"train.views": "random"}), Path("folder"), "name", "hash")
    clip = table_scene(batch=1, frames=1, views=3, height=20, width=20)
    later = fit_to_frames(infer_scene(origin, clip), origin.model, clip, refinements=2)
    assert alike(later, infer_scene(origin, clip, refinements=2))


def test_a_model_that_was_trained_on_one_view_gets_one_and_the_scene_has_all_cameras():
    origin = Origin(some_model(**{"train.views": "random"}), Path("folder"), "name", "hash")
    clip = table_scene(batch=1, frames=1, views=3)
    scene = infer_scene(origin, clip)
    assert len(scene.cameras) == 3
    alone = table_scene(batch=1, frames=1, views=3)
    alone.rgb[:, :, 1:] = 0
    torch.testing.assert_close(infer_scene(origin, alone).what, scene.what)


@pytest.mark.parametrize(("trained", "views"), [("all", 3), ("random", 1)])
def test_models_see_the_views_that_they_were_trained_with(trained: str, views: int):
    clip = table_scene(batch=1, frames=1, views=3)
    seen = views_as_trained(some_model(**{"train.views": trained}), clip)
    assert torch.equal(seen.rgb, clip.rgb[:, :, :views])


def test_labels_are_of_the_views_that_the_model_got_and_name_the_objects():
    origin = Origin(some_model(**{"train.views": "random"}), Path("folder"), "name", "hash")
    inferred = infer_labelled(origin, table_scene(batch=1, frames=2, views=3))
    assert inferred.labels.shape[:2] == (2, 1)
    assert set(inferred.labels.unique().tolist()) <= {0, *inferred.scene.ids}
