from dataclasses import replace

import numpy as np
import pytest

from obpose.config import Config, override
from obpose.contact.config import ContactConfig
from obpose.errors import UsageError
from obpose.rgbd.frames import GIVEN, trained_on, world_note
from obpose.systems import find_system
from tests.worlds.sphere_clips import clip_and_truth

CLIP = clip_and_truth(frames=1, resolution=(32, 24))[0]


def note(*, z: float = 0.0, degrees: float = 0.0, wall: bool = False) -> str:
    """Describe the clip in a world that is moved along z and rotated about x."""
    pose, angle = np.eye(4), np.radians(degrees)
    pose[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[2, 3] = z
    pose = pose @ CLIP.world_from_camera[0]
    depth = CLIP.depth[0, 0].copy()
    if wall:
        depth[:16] = np.where(depth[:16] > 0, depth[:16], 6)
    points = replace(CLIP, depth=depth[None, None]).points(pose[None])[0, 0][depth > 0]
    return world_note(points - pose[:3, 3], pose[:3, 3])


def test_a_table_at_z_0_needs_no_warning():
    assert note() == GIVEN
    assert note(z=0.01) == GIVEN


def test_a_wall_behind_the_table_is_not_taken_for_it():
    assert note(wall=True) == GIVEN


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"z": -0.1}, "the table in view lies at z = -0.10 m: move the world's origin onto the table"),
        ({"z": 0.05}, "lies at z = 0.05 m"),
        ({"degrees": 30}, "the table in view is tilted by 30 degrees"),
    ],
)
def test_faults_of_another_world_are_named(changes: dict[str, float], said: str):
    found = note(**changes)
    assert found.startswith(GIVEN)
    assert said in found
    assert found.endswith("results may be poor")


@pytest.mark.parametrize(
    ("center", "middle"),
    [((-0.12, 0.0, 0.07), (0.0, 0.0, 0.0)), ((0.6, -2.0, 0.1), (0.35, -1.75, 0.0))],
)
def test_the_table_middle_is_the_origin_if_that_is_in_the_workspace(
    center: tuple[float, float, float], middle: tuple[float, float, float]
):
    config = override(Config(), {"model.workspace_center": center, "model.workspace_size": 1.0, "model.spacing": 0.02})
    trained = trained_on(config)
    assert trained.center == pytest.approx(middle)
    assert trained.spacing == 0.02
    assert trained.cube == (center, 1.0)


def test_the_contact_model_has_no_bounds():
    config = override(ContactConfig(), {"model.workspace_center": (0.1, 0.2, 0.3), "model.spacing": 0.02})
    assert trained_on(config).center == (0.1, 0.2, 0.0)
    assert trained_on(config).cube is None


def test_weights_of_other_systems_are_refused():
    with pytest.raises(UsageError, match="those given are of obsurf"):
        trained_on(find_system("obsurf").config())
