from pathlib import Path

import numpy as np
import torch

from obpose.geometry import unproject
from obpose.scenes.infer import infer_scene
from obpose.scenes.model_ref import Origin
from obpose.scenes.rendering import Renderer
from obpose.viewer.point_clouds import observed_clouds, slot_colour, tinted
from tests.obpose.scenes.small_scenes import some_model
from tests.worlds.observations import table_scene


def test_points_belong_to_the_objects_of_the_segmentation_and_lie_where_they_were_seen():
    origin, clip = Origin(some_model(), Path("folder"), "name", "hash"), table_scene(batch=1, frames=2)
    scene = infer_scene(origin, clip)
    clouds = observed_clouds(Renderer(origin.model), scene, 1, clip)
    labels = origin.model.segment(clip).labels[0, 1][clip.valid[0, 1]]
    points = unproject(clip)[0, 1][clip.valid[0, 1]]
    assert sum(len(cloud.points) for cloud in clouds.values()) == len(points)
    for name, cloud in clouds.items():
        assert len(cloud.points) == int((labels == name).sum())
        world = torch.from_numpy(cloud.points)
        if name:
            place = scene.place(name)
            world = world @ scene.rotation[1, place].T + scene.center[1, place]
        torch.testing.assert_close(world, points[labels == name], atol=1e-4, rtol=0)


def test_colours_are_those_of_names_mixed_with_what_was_seen():
    clip = table_scene(batch=1, frames=1)
    origin = Origin(some_model(), Path("folder"), "name", "hash")
    cloud = observed_clouds(Renderer(origin.model), infer_scene(origin, clip), 0, clip)[0]
    away = np.abs(tinted(cloud, 3).astype(float) - slot_colour(3)).mean()
    assert away < np.abs(cloud.colours.astype(float) - slot_colour(3)).mean()
    assert slot_colour(1) == slot_colour(256)
