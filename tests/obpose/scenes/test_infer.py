from pathlib import Path

import pytest
import torch

from obpose.geometry import unproject
from obpose.model.resolution import fitting_model
from obpose.scenes.appearance.find_light import find_light
from obpose.scenes.appearance.find_table_texture import find_texture
from obpose.scenes.appearance.light import no_light
from obpose.scenes.appearance.table_texture import no_texture
from obpose.scenes.infer import fit_to_frames, infer_labelled, infer_scene, views_as_trained
from obpose.scenes.model_ref import Origin
from obpose.scenes.refine import refine
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


def test_light_and_texture_are_those_of_the_fitted_scene():
    origin = Origin(some_model(), Path("folder"), "name", "hash")
    clip = table_scene(batch=1, frames=2, height=20, width=20)
    model, refined = fitting_model(origin.model, clip), infer_scene(origin, clip, refinements=2)
    plain = refined.with_appearance(light=no_light(), texture=no_texture())
    light = find_light(model, clip, plain)
    assert torch.equal(refined.appearance.light, light)
    assert torch.equal(refined.appearance.texture, find_texture(model, clip, plain.with_appearance(light=light)))
    assert refined.appearance.texture.any()


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


def test_extents_are_those_of_what_the_frames_show_as_inferred():
    origin = Origin(some_model(), Path("folder"), "name", "hash")
    clip = table_scene(batch=1, frames=4, height=20, width=20)
    labels = torch.zeros_like(clip.valid, dtype=torch.int64)
    labels[..., 3:9, 4:9], labels[:, 2:, :, 12:16, 10:18] = 1, 2  # the second appears later
    inferred = infer_labelled(origin, clip, refinements=1, labels=labels)
    at_first, points = infer_scene(origin, clip, labels=labels), unproject(clip)[0, :, 0]
    for place, name in enumerate(inferred.scene.ids):
        shown = [(inferred.labels[frame, 0] == name) & clip.valid[0, frame, 0] for frame in range(4)]
        reaches = [
            ((points[frame][mine] - at_first.center[frame, place]) @ at_first.rotation[frame, place]).abs().amax(dim=0)
            for frame, mine in enumerate(shown)
            if mine.any()
        ]
        expected = torch.stack(reaches).quantile(0.75, dim=0) if reaches else torch.zeros(3)
        torch.testing.assert_close(inferred.scene.appearance.half_extent[place], expected)
    assert inferred.scene.appearance.half_extent.any()
