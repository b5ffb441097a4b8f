from dataclasses import replace

import numpy as np
import pytest
import torch

from obpose.config import override
from obpose.contact.config import check_contact_obpose_bounds
from obpose.contact.motion.boxes import boxes_over_time
from obpose.contact.scene_model import LEAST_SHARE, ContactObPose, assignment_loss, build_contact_obpose
from obpose.data.clips import ArrayClips, LabelledArrayClips, observation_of
from obpose.errors import UsageError
from obpose.geometry import unproject
from obpose.model.nerf.compose import log_share
from obpose.model.pose.orientation import standing_boxes
from obpose.systems import find_system
from obpose.training.loop import train
from obpose.types import ContactObservation, PastedObservation
from tests.worlds.sphere_clips import balls

SYSTEM = find_system("obpose-contact")
PATHS = np.array([[[-0.1, 0.05, 0.045], [0.1, -0.1 + 0.03 * step, 0.045]] for step in range(3)])
SMALL = {"train.rays": 32, "train.warmup": 0, "model.voxels": 4, "model.latent.samples": 24}


@pytest.fixture(scope="module")
def clips() -> ArrayClips:
    return ArrayClips([balls(PATHS)[0], balls(PATHS[::-1] * [1, -1, 1])[0]])


@pytest.fixture(scope="module")
def model() -> ContactObPose:
    torch.manual_seed(0)
    return build_contact_obpose(SYSTEM.config("cpu", SMALL))


def test_windows_hold_pseudo_objects_that_keep_their_labels(model: ContactObPose, clips: ArrayClips):
    window = model.training_source(clips).window(0, 1, 2)
    truth = balls(PATHS)[1][1:]
    labels = window["pseudo_labels"].numpy()
    assert {(int(a), int(b)) for a, b in zip(truth.flat, labels.flat, strict=True) if b} == {(1, 1), (2, 2)}
    assert (labels[truth > 0] > 0).mean() > 0.9


def test_windows_depend_only_on_seed_clip_and_start(model: ContactObPose, clips: ArrayClips):
    one, again, other = (model.training_source(clips).window(1, start, 2) for start in (0, 0, 1))
    assert all(torch.equal(value, again[name]) for name, value in one.items())
    assert one["pasted_depth"].shape == (6, 64, 64)
    assert not torch.equal(one["pasted_depth"], other["pasted_depth"])


def test_larger_images_are_fewer(clips: ArrayClips):
    for scale, count in ((1, 6), (2, 2), (8, 1)):
        config = SYSTEM.config("cpu", {**SMALL, "contact.image_scale": scale})
        window = build_contact_obpose(config).training_source(clips).window(0, 0, 2)
        assert len(window["pasted_depth"]) == count


def test_pasted_images_become_clips_of_one_frame(model: ContactObPose, clips: ArrayClips):
    source = model.training_source(clips)
    observation = observation_of([source.window(index, 0, 3) for index in (0, 1)], ContactObservation)
    assert type(observation.clips) is PastedObservation
    assert observation.clips.depth.shape == (2, 3, 1, 64, 64)
    assert observation.pasted.depth.shape == observation.pasted.pseudo_labels.shape == (20, 1, 1, 64, 64)
    assert torch.equal(observation.pasted.k[10, 0], observation.pasted_k[1, 0])


def test_every_weight_is_trained(model: ContactObPose, clips: ArrayClips):
    observation = observation_of([model.training_source(clips).window(0, 0, 3)], ContactObservation)
    terms = model.losses(observation, step=1, generator=torch.Generator().manual_seed(0))
    assert {"colour", "assignment", "affinity"} < terms.keys()
    terms["total"].backward()
    assert [name for name, value in model.named_parameters() if value.grad is None] == []
    model.zero_grad()


def test_fields_learn_from_the_masks(model: ContactObPose, clips: ArrayClips, monkeypatch):
    """The total depends on a factor of the assignment loss, by an amount that depends on the fields."""
    factor = torch.ones((), requires_grad=True)
    monkeypatch.setattr("obpose.contact.scene_model.assignment_loss", lambda *values: factor * assignment_loss(*values))
    observation = observation_of([model.training_source(clips).window(0, 0, 2)], ContactObservation)
    total = model.losses(observation, step=1, generator=torch.Generator().manual_seed(0))["total"]
    (part,) = torch.autograd.grad(total, factor, create_graph=True)
    gradients = torch.autograd.grad(part, [*model.object_field.parameters()], allow_unused=True)
    assert part > 0
    assert any(gradient is not None and gradient.any() for gradient in gradients)


def test_parameters_are_grouped_in_their_order(model: ContactObPose):
    (others, slow), (contact, fast) = model.parameter_groups()
    assert [*map(id, others + contact)] == [*map(id, model.parameters())]
    assert [*map(id, contact)] == [*map(id, model.contact.parameters())]
    assert fast > slow


def test_objects_are_those_of_the_contact_model_however_many(model: ContactObPose, clips: ArrayClips):
    observation = observation_of([clips.window(0, 0, 3)])
    truth = torch.from_numpy(balls(PATHS)[1].astype(np.int64))[None]
    few = model.eval().segment(observation, truth)
    many = model.segment(observation, truth * 4)
    assert torch.equal(few.labels, truth)
    assert few.inference.what.z.shape[2] == 2
    assert many.inference.masks.active[0].tolist() == [False, False, False, True] * 2
    torch.testing.assert_close(many.inference.boxes.center[:, :, [3, 7]], few.inference.boxes.center)
    assert torch.equal(model.segment(observation).labels, model.contact.segment(observation).labels)


def test_boxes_are_those_of_the_whole_clip_unless_a_translation_is_learned(
    model: ContactObPose, monkeypatch: pytest.MonkeyPatch
):
    """A learned translation is relative to the boxes of single frames. The ball moves on a table at a height of 1 m."""
    clip, truth = balls(np.array([[[0.0, 0.0, 0.045]], [[0.0, 0.02, 0.045]]]), 16, eye=(0.16, 0.0, 0.12))
    clip.world_from_camera[:, 2, 3] += 1
    observation = observation_of([ArrayClips([clip]).window(0, 0, 2)])
    labels, points = torch.from_numpy(truth.astype(np.int64))[None], unproject(observation)
    single = standing_boxes(points, labels, slots=1, table=1.0)[:2]
    fused = boxes_over_time(points, observation.rgb, labels, single, table=1.0)
    assert not torch.allclose(fused[0], single[0], atol=1e-3)
    for translation, expected in ((0.0, fused), (0.05, single)):
        changes = {"model.table": 1.0, "model.pose.max_translation": translation}
        monkeypatch.setattr(model, "config", override(model.config, changes))
        found = model.eval().segment(observation, labels).inference
        torch.testing.assert_close((found.observed_center, found.boxes.rotation), expected)


def test_without_a_segmentation_there_are_no_objects(model: ContactObPose, clips: ArrayClips):
    assert not model.infer(observation_of([clips.window(0, 0, 1)])).masks.active.any()


def test_the_assignment_loss_is_the_cross_entropy_of_the_shares_of_density():
    logits = torch.tensor([[0.0, 3.0], [2.0, -1.0], [-1e4, -1e4]])[None, None].requires_grad_()
    weight = torch.tensor([[[1.0, 3.0]]])
    owners = torch.full((1, 1, 3, 2), -1e4)
    owners[..., 0, 0] = owners[..., 1, 1] = 0
    loss = assignment_loss(owners, logits, weight)
    shares = log_share(logits)
    torch.testing.assert_close(loss, -(shares[0, 0, 0, 0] + 3 * shares[0, 0, 1, 1]) / 4)
    (gradient,) = torch.autograd.grad(loss, logits)
    assert gradient[0, 0, 0, 0] < 0 < gradient[0, 0, 1, 0]
    # An owner without density, outside of its box, does not pull.
    owners = torch.full((1, 1, 3, 2), -1e4)
    owners[..., 2, :] = 0
    assert assignment_loss(owners, logits, weight).item() == -LEAST_SHARE


def test_labels_of_the_dataset_do_not_reach_the_training():
    scenes = [balls(PATHS), balls(PATHS[::-1])]
    config = SYSTEM.config("cpu", {**SMALL, "train.steps": 2, "train.frames": 2})
    trained = []
    for factor in (0, 1):
        labelled = [replace(clip, truth=(factor * truth).astype(np.uint8)) for clip, truth in scenes]
        trained.append(train(LabelledArrayClips(labelled), None, config).model.state_dict())
    assert all(torch.equal(value, trained[1][name]) for name, value in trained[0].items())


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("model.attention.kind", "icsbp", "expected given"),
        ("train.views", "separate", "expected random"),
        ("train.views", "all", "expected random"),
        ("contact.table", 0.4, "expected the table's height, 0 by model.table"),
        ("model.table", 0.4, "expected the table's height, 0.399 by model.table"),
        ("contact.gap", 0.0, "expected more than 0"),
        ("contact.image_scale", 65, "expected at most 64"),
        ("train.rays", -1, "expected 0 or more"),
    ],
)
def test_settings_that_cannot_work_are_refused(name: str, value: object, message: str):
    with pytest.raises(UsageError, match=message):
        check_contact_obpose_bounds(SYSTEM.config("cpu", {name: value}))
