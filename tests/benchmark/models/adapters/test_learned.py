from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.models.adapters.learned import LearnedSegmenter, poses_of
from benchmark.models.interface import Clip, Segmenter
from benchmark.models.registry import find_model
from benchmark.models.validation import ValidationScorer
from benchmark.ranking.failed_seeds import has_finite_loss
from datagen.errors import UsageError
from datagen.pipeline.generate import generate
from datagen.storage.reader import Dataset
from datagen.verify.scene_case import Case, make_case
from obpose.geometry import unproject
from obpose.model.build import build_obpose
from obpose.model.obpose import ObPose
from obpose.scenes.clip import read_clip
from obpose.types import Boxes, Observation, SceneSegmentation
from obpose.variants import make_config
from tests.chosen_scores import run_row
from tests.worlds import generated
from tests.worlds.sphere_clips import clip_and_truth, with_holes

SIZE = (32, 24)


def clips(count: int, **recipe: object) -> list[Clip]:
    return [clip_and_truth(seed, **{"frames": 2, "resolution": SIZE, **recipe})[0] for seed in range(count)]


def fitted(options: dict[str, object], train: Sequence[Clip], *, seed: int = 0) -> LearnedSegmenter:
    model = find_model("obpose-loc").build({"slots": 4, "steps": 2, **options})
    model.fit(train, train[:1], seed=seed, budget=60.0)
    assert isinstance(model, LearnedSegmenter)
    return model


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("run") / "own"


@pytest.fixture(scope="module")
def model(folder: Path) -> LearnedSegmenter:
    return fitted({"folder": folder}, clips(2))


def test_it_is_a_segmenter_of_as_many_slots_as_offered(model: LearnedSegmenter):
    assert isinstance(model, Segmenter)
    clip = with_holes(clips(1)[0], 0.2)
    found = model.segment(clip)
    assert found.background_slot == 0
    for labels in (found.labels, found.extra["att"]):
        assert labels.shape == clip.depth.shape
        assert not labels[~clip.valid].any()
        assert set(np.unique(labels)) <= set(range(4))


def test_it_says_what_the_rows_need(model: LearnedSegmenter):
    assert model.parameters > 10_000
    assert model.fit_seconds > 0
    assert model.learning_curve
    assert {"step", "seconds", "loss"} <= set(model.learning_curve[0])
    assert has_finite_loss(run_row(learning_curve=model.learning_curve))
    assert not has_finite_loss(run_row(learning_curve=[{**model.learning_curve[0], "air loss": float("nan")}]))


def test_equal_clips_get_equal_labels_whatever_came_between(model: LearnedSegmenter):
    first, other = clips(2)
    before = model.segment(first)
    model.segment(other)
    after = model.segment(first)
    np.testing.assert_array_equal(before.labels, after.labels)
    np.testing.assert_array_equal(before.extra["att"], after.extra["att"])


def test_a_run_that_is_made_again_goes_on_in_its_folder(model: LearnedSegmenter, folder: Path):
    again = fitted({"folder": folder}, clips(2))
    assert again.fit_seconds == model.fit_seconds
    assert again.learning_curve == model.learning_curve
    np.testing.assert_array_equal(again.segment(clips(1)[0]).labels, model.segment(clips(1)[0]).labels)


def test_it_states_what_it_was_fitted_with(model: LearnedSegmenter, folder: Path):
    found = model.fitted_settings
    assert found
    assert (found["model"]["slots"], found["train"]["steps"], found["train"]["minutes"]) == (3, 2, 1.0)
    assert found["model"]["workspace_center"] != find_model("obpose-loc").settings["model"]["workspace_center"]
    assert fitted({"checkpoint": folder}, []).fitted_settings == found


def test_a_checkpoint_stands_in_for_training(model: LearnedSegmenter, folder: Path):
    loaded = LearnedSegmenter("obpose-loc", slots=9, checkpoint=folder)
    loaded.fit([], [], seed=5, budget=0.0)
    assert loaded.parameters == model.parameters
    assert loaded.learning_curve is None
    np.testing.assert_array_equal(loaded.segment(clips(1)[0]).labels, model.segment(clips(1)[0]).labels)


def test_whoever_watches_sees_it_segment_while_it_learns(tmp_path: Path):
    seen, truths = zip(*(clip_and_truth(seed, frames=2, resolution=SIZE) for seed in range(2)), strict=True)
    watch = ValidationScorer(seen, truths, tmp_path / "seen.csv")
    model = fitted({"watch": watch}, clips(2))
    curve = watch.added_to(model.learning_curve or [])
    assert [point["step"] for point in curve if "msc_fg" in point] == [1, 2]
    watch(model.segment, step=2, seconds=0.0)
    assert watch.added_to([{"step": 2.0}])[0]["msc_fg"] == curve[-1]["msc_fg"]


def test_settings_are_changed_by_dotted_name():
    model = fitted({"changes": {"model.object_field.width": 24}}, clips(2))
    assert model.parameters < fitted({}, clips(2)).parameters


def test_settings_can_be_changed_after_training_and_the_model_stays_as_it_was():
    model = find_model("ic-sbp").build({"slots": 4, "steps": 2})
    model.fit(clips(2), [], seed=0, budget=60.0)
    assert isinstance(model, LearnedSegmenter)
    clip, settings, labels = clips(1)[0], model.fitted_settings, model.segment(clips(1)[0]).labels
    fewer = model.with_changes({"model.slots": 2})
    assert fewer.segment(clip).labels.max() == labels.max() - 1
    assert fewer.fitted_settings
    assert fewer.fitted_settings["model"]["slots"] == 2
    # The weights are the same, and the model itself is not changed.
    np.testing.assert_array_equal(fewer.with_changes({"model.slots": 3}).segment(clip).labels, labels)
    np.testing.assert_array_equal(model.segment(clip).labels, labels)
    assert model.fitted_settings == settings


def test_clips_of_other_sizes_lengths_and_views_are_segmented(model: LearnedSegmenter):
    clip = clips(1, frames=1, views=2, resolution=(48, 36))[0]
    assert model.segment(clip).labels.shape == clip.depth.shape


def test_a_clip_without_any_depth_is_background(model: LearnedSegmenter):
    found = model.segment(with_holes(clips(1)[0], 1.0))
    assert not found.labels.any()


@pytest.mark.parametrize("views", ["all", "separate"])
def test_it_renders_the_images_that_are_asked_for(views: str):
    clip = clips(1, views=2, resolution=(64, 48))[0]
    model = fitted({"changes": {"train.views": views}}, [clip])
    images = [(0, 0), (1, 1), (0, 1)]
    found = model.reconstruct_images(clip, images)
    assert found is not None
    assert (found.shape, found.dtype) == ((3, 48, 64, 3), np.uint8)
    for picture, image in zip(found, images, strict=True):
        alone = model.reconstruct_images(clip, [image])
        assert alone is not None
        np.testing.assert_array_equal(picture, alone[0])
    assert not np.array_equal(found[0], found[2])


def test_large_images_are_rendered_small():
    found = fitted({}, clips(1)).reconstruct_images(clips(1, resolution=(256, 96))[0], [(0, 0)])
    assert found is not None
    assert found.shape == (1, 48, 128, 3)


@pytest.mark.parametrize("name", ["slot-attention", "obsurf", "contact-masks"])
def test_models_without_posed_objects_render_nothing(name: str):
    model = find_model(name).build({"slots": 4, "steps": 1})
    model.fit(clips(1), [], seed=0, budget=60.0)
    assert isinstance(model, LearnedSegmenter)
    assert model.reconstruct_images(clips(1)[0], [(0, 0)]) is None


def test_a_model_without_a_background_says_so_and_segments_each_view():
    clip = with_holes(clips(1, views=2)[0], 0.2)
    model = find_model("obsurf").build({"slots": 4, "steps": 2})
    model.fit([clip], [clip], seed=0, budget=60.0)
    found = model.segment(clip)
    assert found.background_slot is None
    assert found.labels.shape == found.extra["att"].shape == clip.depth.shape
    assert not found.labels[~clip.valid].any()


def test_a_model_that_learns_from_labels_gets_them():
    seen, truth = clip_and_truth(0, frames=2, resolution=SIZE)
    clip = replace(seen, truth=truth)
    model = find_model("supervised").build({"slots": 4, "steps": 2})
    with pytest.raises(UsageError, match="learns from"):
        model.fit([seen], [], seed=0, budget=60.0)
    model.fit([clip], [clip], seed=0, budget=60.0)
    assert model.segment(seen).labels.shape == clip.depth.shape


def test_a_dataset_without_training_scenes_is_named():
    model = find_model("obpose-loc").build({"slots": 4, "steps": 2})
    with pytest.raises(UsageError, match="no training scenes; expected some to learn from"):
        model.fit([], clips(1), seed=0, budget=60.0)


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
