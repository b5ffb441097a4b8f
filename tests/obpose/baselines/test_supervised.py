import math
from dataclasses import fields

import pytest
import torch

from obpose.baselines.supervised import Supervised, build_supervised, matched_cross_entropy
from obpose.config import SupervisedConfig, override
from obpose.data.clips import ArrayClips, LabelledArrayClips, observation_of, separate_views, stack
from obpose.errors import UsageError
from obpose.model.obpose import ObPose
from obpose.trainable import Trainable
from obpose.types import LabelledObservation, Observation
from tests.obpose.toy import ToyClips
from tests.worlds.observations import table_scene
from tests.worlds.sphere_clips import clip_and_truth


def _model() -> Supervised:
    torch.manual_seed(0)
    return build_supervised(override(SupervisedConfig(), {"model.spacing": 0.024}))


def _labelled(labels: torch.Tensor | None = None, *, frames: int = 2, holes: float = 0.0) -> LabelledObservation:
    """Spheres on a table, told by their colour."""
    scene = table_scene(frames=frames, spheres=2, holes=holes)
    if labels is None:
        _, labels = scene.rgb.flatten(0, -2).unique(dim=0, return_inverse=True)
    parts = {field.name: getattr(scene, field.name) for field in fields(scene)}
    return LabelledObservation(**parts, segmentation=labels.view(scene.depth.shape))


def _log_masks(*shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(0)).log_softmax(dim=2)


def test_the_numbers_of_the_objects_do_not_matter_but_that_of_the_background_does():
    log_masks, labels = _log_masks(1, 2, 4, 50), torch.arange(100).view(1, 2, 50) % 4
    plain = matched_cross_entropy(log_masks, labels)
    renamed = torch.tensor([0, 70, 5, 12])[labels]
    torch.testing.assert_close(matched_cross_entropy(log_masks, renamed), plain)
    with_another_background = torch.tensor([1, 0, 2, 3])[labels]
    assert not torch.isclose(matched_cross_entropy(log_masks, with_another_background), plain)


def test_objects_keep_their_slot_over_the_clip_and_the_best_matching_counts():
    labels = torch.tensor([[[0, 1, 1, 2], [2, 2, 1, 0]]])
    truth = torch.nn.functional.one_hot(torch.tensor([0, 2, 1])[labels], 3).float()
    perfect = (truth * 0.98 + 0.01).mT.log()
    torch.testing.assert_close(matched_cross_entropy(perfect, labels), torch.tensor(0.99).log().neg())
    swapped = perfect.clone()
    swapped[:, 1, 1:] = swapped[:, 1, 1:].flip(1)
    assert matched_cross_entropy(swapped, labels) > 1


def test_an_object_is_of_the_slot_that_has_most_of_it_though_one_pixel_is_out_of_its_reach():
    reaches, everywhere = torch.full((10,), 0.9), torch.full((10,), 0.05)
    reaches[-1] = 1e-30
    log_masks = torch.stack([1 - reaches - everywhere, everywhere, reaches]).clamp(min=1e-30).log()[None, None]
    found = matched_cross_entropy(log_masks, torch.ones(1, 1, 10, dtype=torch.long))
    assert found.item() == pytest.approx((12 - 9 * math.log(0.9)) / 10, abs=1e-4)


def test_pixels_that_do_not_count_and_objects_beyond_the_slots_have_no_say():
    log_masks = _log_masks(1, 1, 3, 6).requires_grad_()
    labels = torch.tensor([[[0, 1, 2, 3, -1, 1]]])
    matched_cross_entropy(log_masks, labels).backward()
    assert log_masks.grad is not None
    touched = log_masks.grad[0, 0].abs().sum(dim=0) > 0
    assert touched.tolist()[4] is False
    assert touched[1:4].sum() == 2, "Two slots, three objects."
    assert matched_cross_entropy(log_masks, torch.full((1, 1, 6), -1)) == 0


def test_a_pixel_that_no_mask_explains_stops_pulling():
    log_masks = torch.tensor([[-1.0, -60.0], [-2.0, -60.0]])[None, None].requires_grad_()
    matched_cross_entropy(log_masks, torch.tensor([[[0, 0]]])).backward()
    assert log_masks.grad is not None
    torch.testing.assert_close(log_masks.grad[0, 0, 0], torch.tensor([-0.5, 0.0]), atol=1e-4, rtol=0)


def test_every_weight_learns_and_labels_are_all_that_is_learned_from():
    model, labelled = _model().train(), _labelled()
    losses = model.losses(labelled, step=0, generator=torch.Generator().manual_seed(0))
    losses["total"].backward()
    names = [name for name, weight in model.named_parameters() if weight.grad is None or not weight.grad.any()]
    assert names == []
    assert set(losses) == {"total", "cross_entropy", "scope"}
    other = model.losses(
        _labelled(torch.zeros_like(labelled.segmentation)), step=0, generator=torch.Generator().manual_seed(0)
    )
    assert other["cross_entropy"] != losses["cross_entropy"]


def test_the_total_is_ten_times_the_cross_entropy_and_a_quarter_of_the_scope():
    terms = _model().losses(_labelled(frames=1), step=0, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(terms["total"].detach(), 10 * terms["cross_entropy"] + 0.25 * terms["scope"])
    assert terms["scope"] > 0.01


def test_pixels_without_depth_do_not_count():
    model, scene = _model().eval(), _labelled(frames=1, holes=0.3)
    _, masks = model.masks(scene, None)
    log_masks = masks.log_masks
    seen = scene.valid.flatten()
    expected = matched_cross_entropy(log_masks[..., seen], scene.segmentation.view(1, 1, -1)[..., seen])
    torch.testing.assert_close(model.losses(scene, step=0)["cross_entropy"], expected.detach())


def test_labels_have_no_influence_on_a_segmentation():
    model, labelled = _model().eval(), _labelled()
    assert torch.equal(model.segment(labelled).labels, model.segment(table_scene(frames=2, spheres=2)).labels)


def test_nobody_else_sees_labels():
    others = {kind for kind in _kinds(Trainable) if kind.__module__.startswith("obpose.")} - {Supervised}
    assert ObPose in others
    assert all(kind.observation_type is Observation for kind in others)
    assert "segmentation" not in {field.name for field in fields(Observation)}
    window = ToyClips(labels=True).window(0, 0, 2)
    assert "segmentation" not in stack([window])
    assert "segmentation" in stack([window], Supervised.observation_type)


def test_without_labels_there_is_nothing_to_learn_from():
    with pytest.raises(TypeError, match="expected a LabelledObservation"):
        _model().losses(table_scene(), step=0)
    with pytest.raises(UsageError, match="no segmentation, which this model learns from"):
        stack([ToyClips().window(0, 0, 2)], Supervised.observation_type)


def test_labels_of_arrays_come_only_from_the_source_that_is_named_for_them():
    clip, truth = clip_and_truth()
    labelled = type(clip)(**{**vars(clip), "truth": truth})
    assert "segmentation" not in ArrayClips([labelled]).window(0, 0, 2)
    found = observation_of([LabelledArrayClips([labelled]).window(0, 1, 2)], LabelledObservation)
    assert torch.equal(found.segmentation[0], torch.from_numpy(truth[1:3]).long())
    with pytest.raises(UsageError, match="Clip 0 has no labels"):
        LabelledArrayClips([clip]).window(0, 0, 2)


def test_views_apart_keep_their_labels():
    clip, truth = clip_and_truth(views=2)
    source = LabelledArrayClips([type(clip)(**{**vars(clip), "truth": truth})])
    apart = separate_views(observation_of([source.window(0, 0, 2)], LabelledObservation))
    assert torch.equal(apart.segmentation[1, :, 0], torch.from_numpy(truth[:2, 1]).long())


def _kinds(kind: type) -> set[type]:
    return {kind}.union(*(_kinds(each) for each in kind.__subclasses__()))
