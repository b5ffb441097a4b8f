from dataclasses import replace

import numpy as np
import pytest
import torch

from obpose.config import override
from obpose.data.clips import ArrayClips
from obpose.data.scene_stats import measure_scene
from obpose.model.build import build_obpose
from obpose.model.obpose import ObPose
from obpose.rgbd.frames import GIVEN, table_middle, world_note
from obpose.systems import find_system
from obpose.types import Observation
from tests.worlds.sphere_clips import clip_and_truth

CLIP = clip_and_truth(frames=1, resolution=(32, 24))[0]
MEASURES = find_system("obpose").known(measure_scene(ArrayClips([CLIP])).changes())


@pytest.fixture(scope="module")
def model() -> ObPose:
    """Untrained model with the statistics of the clip."""
    return build_obpose(find_system("obpose").config("cpu", MEASURES))


def observed(pose: np.ndarray) -> Observation:
    """Observe the clip in a moved world."""
    values = (CLIP.rgb / 255, CLIP.depth, CLIP.k, pose @ CLIP.world_from_camera)
    rgb, depth, k, world_from_camera = (torch.from_numpy(np.asarray(value, np.float32))[None] for value in values)
    return Observation(
        rgb=rgb, depth=depth, valid=torch.from_numpy(CLIP.valid)[None], k=k, world_from_camera=world_from_camera
    )


def moved(x: float = 0.0, z: float = 0.0, degrees: float = 0.0) -> np.ndarray:
    """Make a world_from_world transform, rotated about x."""
    pose, angle = np.eye(4), np.radians(degrees)
    pose[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[0, 3], pose[2, 3] = x, z
    return pose


def test_the_world_of_the_training_needs_no_warning(model: ObPose):
    assert world_note(observed(moved()), model) == GIVEN
    assert world_note(observed(moved(x=0.05, z=0.01)), model) == GIVEN


def test_a_wall_behind_the_table_is_not_taken_for_it(model: ObPose):
    observation = observed(moved())
    wall = torch.arange(24)[:, None] < 16
    far = replace(observation, depth=observation.depth.masked_fill(wall, 6), valid=observation.valid | wall)
    assert world_note(far, model) == GIVEN


@pytest.mark.parametrize(
    ("center", "middle"),
    [((-0.12, 0.0, 0.07), (0.0, 0.0, 0.0)), ((0.6, -2.0, 0.1), (0.35, -1.75, 0.0))],
)
def test_the_table_middle_is_the_origin_if_that_is_in_the_workspace(
    model: ObPose, center: tuple[float, float, float], middle: tuple[float, float, float]
):
    config = override(model.config, {"model.workspace_center": center, "model.workspace_size": 1.0})
    assert table_middle(build_obpose(config)) == pytest.approx(middle)


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        (moved(x=5), "100 % of it outside the 1.47 m around (-0.18, 0.00, 0.04) that the model was"),
        (moved(x=5), "the middle of the table in view lies at (5.0"),
        (moved(z=-0.1), "the table in view lies at z = -0.10 m: move the world's origin onto the table"),
        (moved(z=0.05), "lies at z = 0.05 m"),
        (moved(degrees=30), "the table in view is tilted by 30 degrees"),
    ],
)
def test_faults_of_another_world_are_named(model: ObPose, pose: np.ndarray, said: str):
    note = world_note(observed(pose), model)
    assert note.startswith(GIVEN)
    assert said in note
    assert note.endswith("results may be poor")
