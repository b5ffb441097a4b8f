from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.models.adapters.poses import poses_of
from datagen.pipeline.generate import generate
from datagen.storage.reader import Dataset
from datagen.verify.scene_case import Case, make_case
from obpose.geometry import unproject
from obpose.model.build import build_obpose
from obpose.model.obpose import ObPose
from obpose.scenes.clip import read_clip
from obpose.types import Boxes, Observation, SceneSegmentation
from obpose.variants import make_config
from tests.worlds import generated

FRAMES = 5


@dataclass(frozen=True, eq=False)
class Told:
    """A clip that is inferred without error: labels and boxes are the generator's, slot k is object k."""

    truth: Case
    observation: Observation
    model: ObPose
    segmentation: SceneSegmentation


def untrained(conditioning: str = "full") -> ObPose:
    torch.manual_seed(0)
    model = {"model.pose.conditioning": conditioning, "model.pose.box_size": 0.3, "model.workspace_size": 1.0}
    # All slots are in use, though a fresh pre-scope expects no object anywhere.
    return build_obpose(make_config(**model, **{"model.attention.inactive_points": 0})).eval()


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Told:
    folder: Path = tmp_path_factory.mktemp("poses") / "data"
    generate(folder, generated.recipe(frames=FRAMES), splits={"val": 1}, resolution=generated.RESOLUTION)
    truth, observation, model = make_case(Dataset(folder).split("val")[0]), read_clip(folder, "val", 0), untrained()
    found = model.segment(observation)
    poses = torch.from_numpy(truth.world_from_object).float()
    poses = torch.cat([poses, torch.eye(4).expand(FRAMES, 4 - truth.count, 4, 4)], dim=1)[None]
    boxes = Boxes(poses[..., :3, 3], poses[..., :3, :3], 0.3)
    inference = replace(found.inference, boxes=boxes, observed_center=boxes.center)
    labels = torch.from_numpy(truth.record["segmentation"]).long()[None]
    return Told(truth, observation, model, replace(found, labels=labels, inference=inference))


def test_boxes_are_the_smallest_around_their_middles_that_hold_what_is_seen(told):
    observation = told.observation
    poses = poses_of(told.model, told.segmentation, observation)
    assert poses is not None
    assert poses.center.shape == (FRAMES, 1, 5, 3)
    assert np.isnan(poses.center[:, :, 0]).all()
    points, labels = unproject(observation)[0, :, 0].double().numpy(), told.segmentation.labels[0, :, 0].numpy()
    for frame, row in np.ndindex(FRAMES, told.truth.count):
        center, rotation, size = (array[frame, 0, row + 1] for array in (poses.center, poses.rotation, poses.size))
        mine = points[frame][labels[frame] == row + 1]
        if not len(mine):
            assert np.isnan(center).all()
            continue
        assert center == pytest.approx(told.truth.world_from_object[frame, row, :3, 3], abs=1e-6)
        assert rotation == pytest.approx(told.truth.world_from_object[frame, row, :3, :3], abs=1e-6)
        assert np.abs((mine - center) @ rotation).max(axis=0) == pytest.approx(size / 2, abs=1e-5)


def test_slots_without_pixels_have_no_pose(told):
    nothing = replace(told.segmentation, labels=torch.zeros_like(told.segmentation.labels))
    poses = poses_of(told.model, nothing, told.observation)
    assert poses is not None
    assert all(np.isnan(array).all() for array in (poses.center, poses.rotation, poses.size))


def test_views_are_apart(told):
    """The batch of a segmentation of views is the axis of views."""
    inference = told.segmentation.inference
    twice = lambda values: torch.cat([values, values])  # noqa: E731
    boxes = Boxes(twice(inference.boxes.center), twice(inference.boxes.rotation), inference.boxes.size)
    both = replace(
        told.segmentation,
        labels=twice(told.segmentation.labels),
        attention=twice(told.segmentation.attention),
        inference=replace(inference, boxes=boxes),
    )
    observation = told.observation
    names = ("rgb", "depth", "valid", "k", "world_from_camera")
    doubled = replace(observation, **{name: twice(getattr(observation, name)) for name in names})
    poses = poses_of(told.model, both, doubled)
    assert poses is not None
    assert poses.center.shape[:2] == (FRAMES, 2)
    np.testing.assert_array_equal(poses.size[:, 0], poses.size[:, 1])


def test_a_model_without_poses_gives_none(told):
    model = untrained("none")
    found = model.segment(told.observation)
    assert poses_of(model, found, told.observation) is None
