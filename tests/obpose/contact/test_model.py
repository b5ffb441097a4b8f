from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from scipy.ndimage import binary_dilation

from obpose.config import override
from obpose.contact.clip import Image as ClipImage
from obpose.contact.config import LEAST_FLOOR, ContactConfig, ContactModelConfig, check_contact_bounds
from obpose.contact.images import Images, augmented, cropped, images_of
from obpose.contact.losses import PULL_MARGIN
from obpose.contact.model import ContactModel, Outputs
from obpose.data.clean_depth import clean_depth, depth_noise
from obpose.data.clips import ArrayClips, LabelledArrayClips, observation_of
from obpose.errors import UsageError
from obpose.geometry import unproject
from obpose.systems import find_system
from obpose.training.loop import train
from obpose.types import Observation, PastedObservation
from tests.obpose.contact.test_grouping import affinities
from tests.worlds.sphere_clips import arbitrary, balls

ORIGIN = torch.zeros(3)


@pytest.fixture(scope="module")
def observation() -> PastedObservation:
    places = np.array([[[-0.1, 0.05, 0.045], [0.08, -0.1, 0.045]], [[-0.1, 0.05, 0.045], [0.08, -0.06, 0.045]]])
    clip, truth = balls(places)
    window = ArrayClips([clip]).window(0, 0, 2) | {"pseudo_labels": torch.from_numpy(truth.astype(np.int64))}
    return observation_of([window], PastedObservation)


def arranged(observation: Observation) -> Images:
    return images_of(observation, center=ORIGIN, table=0.0)


def test_inputs_do_not_depend_on_the_side_from_which_the_camera_looks(observation: PastedObservation):
    angle = torch.tensor(2.0)
    turn = torch.eye(4)
    turn[:2, :2] = torch.tensor([[angle.cos(), -angle.sin()], [angle.sin(), angle.cos()]])
    other = replace(observation, world_from_camera=turn @ observation.world_from_camera)
    torch.testing.assert_close(arranged(other).inputs(), arranged(observation).inputs(), atol=1e-4, rtol=1e-4)


def test_inputs_are_measured_from_the_middle_of_the_workspace_and_from_the_table(observation: PastedObservation):
    shift, unseen = torch.tensor([0.3, -0.2, 0.1]), torch.tensor([0.0, 0.0, 9.0])
    pose = observation.world_from_camera.clone()
    pose[..., :3, 3] += shift
    moved = images_of(replace(observation, world_from_camera=pose), center=shift + unseen, table=0.1)
    torch.testing.assert_close(moved.inputs(), arranged(observation).inputs(), atol=1e-4, rtol=1e-4)


def test_normals_of_the_table_point_upwards(observation: PastedObservation):
    images = arranged(observation)
    flat = (images.labels == 0) & images.valid
    for axis, shift in ((1, 1), (1, -1), (2, 1), (2, -1)):
        flat &= (images.labels == 0).roll(shift, axis)
    flat[:, [0, -1]] = flat[:, :, [0, -1]] = False
    torch.testing.assert_close(
        images.normals.movedim(1, -1)[flat], torch.tensor([0.0, 0, 1]).expand(int(flat.sum()), 3), atol=1e-3, rtol=0
    )


def test_pixels_without_depth_have_neither_a_position_nor_a_normal(observation: PastedObservation):
    valid = torch.ones_like(observation.valid)
    valid[..., 30, 20:40] = False
    holed = replace(observation, valid=valid, depth=observation.depth * valid)
    images = images_of(holed, center=torch.ones(3), table=-1.0)
    for values in (images.points, images.normals):
        assert (values.abs().sum(dim=1) > 0)[:, 1:-1, 1:-1].equal(images.valid[:, 1:-1, 1:-1])


def test_inputs_resolve_millimetres_above_the_table(observation: PastedObservation):
    """One input rises by most of its range over 4 mm, and saturates above: inputs of geometry stay in -1..1."""
    images = arranged(observation)
    low, high = (replace(images, points=torch.full_like(images.points, z)).inputs() for z in (0.0, 0.004))
    assert ((high - low).amax(dim=1) > 0.7).all()
    higher = replace(images, points=torch.full_like(images.points, 0.05)).inputs()
    assert (higher[:, 3:].abs() <= 1).all()


def test_augmentation_mirrors_images_with_their_geometry(observation: PastedObservation):
    images = arranged(observation)
    many = replace(images, **{each.name: torch.cat([getattr(images, each.name)] * 8) for each in fields(images)})
    changed = augmented(many, torch.Generator().manual_seed(0))
    mirrored = [not torch.equal(a, b) for a, b in zip(changed.labels, many.labels, strict=True)]
    assert 2 < sum(mirrored) < 14
    for index, turned in enumerate(mirrored):
        for name in ("points", "normals"):
            found, expected = getattr(changed, name)[index], getattr(many, name)[index].clone()
            expected[0] *= -1 if turned else 1
            torch.testing.assert_close(found.flip(-1) if turned else found, expected)
        # Right is where the first coordinate is larger, as before.
        assert changed.points[index, 0, 30, 40] > changed.points[index, 0, 30, 20]


def test_augmentation_permutes_the_colours_of_half_and_changes_brightness_and_balance():
    """Images of one column look the same when mirrored."""
    rgb = torch.rand(200, 3, 6, 1, generator=torch.Generator().manual_seed(0))
    images = Images(rgb, 0 * rgb, 0 * rgb, rgb[:, 0] > 0, 0 * rgb[:, 0].long())
    changed = augmented(images, torch.Generator().manual_seed(0)).rgb
    # New colours as linear functions of the old ones: rows belong to old colours, and the last one is the offset.
    columns = torch.cat([rgb, torch.ones_like(rgb[:, :1])], dim=1)[..., 0].mT
    found = torch.linalg.lstsq(columns, changed[..., 0].mT).solution
    gains, offsets = found[:, :3], found[:, 3]
    used = gains.abs() > 1e-3
    assert (torch.cat([used.sum(dim=1), used.sum(dim=2)]) == 1).all()
    permuted = (used != torch.eye(3, dtype=torch.bool)).any(dim=2).any(dim=1)
    assert permuted.float().mean() == pytest.approx(0.5, abs=0.1)
    assert [gains[used].min().item(), gains[used].max().item()] == pytest.approx([0.8, 1.2], abs=0.01)
    assert (gains.sum(dim=1).std(dim=1) > 0.01).float().mean() > 0.9
    assert [offsets.min().item(), offsets.max().item()] == pytest.approx([-0.05, 0.05], abs=0.01)
    torch.testing.assert_close(offsets, offsets[:, :1].expand(-1, 3), atol=1e-4, rtol=0)


@pytest.mark.parametrize("seed", range(4))
def test_crops_hold_the_objects(observation: PastedObservation, seed: int):
    images = arranged(observation)
    cut = cropped(images, 40, torch.Generator().manual_seed(seed))
    assert cut.rgb.shape[2:] == cut.labels.shape[1:] == (40, 40)
    assert torch.equal((cut.labels > 0).sum((1, 2)), (images.labels > 0).sum((1, 2)))
    assert cropped(images, 64, None) is images


@pytest.mark.parametrize(
    ("objects", "starts"),
    [(1, {(row, column) for row in range(4) for column in (2, 3)}), (0, {*np.ndindex(5, 4)})],
    ids=["an object", "nothing"],
)
def test_crops_are_drawn_from_all_windows_that_hold_the_objects(objects: int, starts: set[tuple[int, int]]):
    """Windows of 4x4 pixels of images of 8x7 pixels, whose points are the indices of the pixels."""
    labels = torch.zeros(300, 8, 7, dtype=torch.int64)
    labels[:, 3, 5] = objects
    index = torch.from_numpy(np.indices((3, 8, 7))[[1, 2, 0], 0]).float().expand(300, -1, -1, -1)
    cut = cropped(Images(index, index, index, labels == 0, labels), 4, torch.Generator().manual_seed(0))
    assert {*map(tuple, cut.points[:, :2, 0, 0].int().tolist())} == starts


@pytest.mark.parametrize(("places", "colours", "apart"), [(1, 0, True), (0, 1, True), (0, 0, False)])
def test_objects_differ_by_place_and_colour_whatever_the_network_says(
    observation: PastedObservation, places: int, colours: int, apart: bool
):
    model = ContactModel(ContactConfig())
    for weights in model.network.head[-1].parameters():
        torch.nn.init.zeros_(weights)
    images = arranged(observation)
    rgb = 0.5 * colours * images.labels[:, None].expand_as(images.rgb)
    embedding = model.outputs(replace(images, points=places * images.points, rgb=rgb)).embedding.movedim(1, -1)
    first, second = (embedding[images.labels == label].mean(dim=0) for label in (1, 2))
    assert ((first - second).norm() > 2 * PULL_MARGIN) == apart


def test_training_steps_reduce_the_loss(observation: PastedObservation):
    torch.manual_seed(0)
    model = ContactModel(ContactConfig())
    optimizer = torch.optim.Adam(model.parameters(), 3e-3)
    losses = []
    for step in range(12):
        terms = model.losses(observation, step=step, generator=torch.Generator().manual_seed(0))
        optimizer.zero_grad()
        terms["total"].backward()
        optimizer.step()
        losses.append(terms["total"].item())
    assert losses[-1] < 0.8 * losses[0]


def test_the_loss_is_the_weighted_sum_of_its_terms(observation: PastedObservation):
    torch.manual_seed(0)
    terms = ContactModel(ContactConfig()).losses(observation, step=0, generator=torch.Generator().manual_seed(0))
    weights = {"foreground": 2, "pull": 1, "push": 0.5, "affinity": 2}
    assert all(terms[name] > 0 for name in weights)
    expected = sum(weight * terms[name] for name, weight in weights.items())
    torch.testing.assert_close(terms["total"].detach(), expected)


@pytest.mark.parametrize(("scale", "edge"), [(1, 48), (2, 64)])
def test_crops_and_the_distances_of_partners_grow_with_the_training_images(
    observation: PastedObservation, monkeypatch: pytest.MonkeyPatch, scale: int, edge: int
):
    """Crops of 96 pixels are the whole image; the affinities are right for partners at the distances of the scale."""
    model, shapes = ContactModel(override(ContactConfig(), {"model.image_scale": scale})), []

    def outputs(images: Images) -> Outputs:
        shapes.append(images.labels.shape)
        right = np.stack([affinities(each, 30.0, scale) for each in images.labels.numpy()])
        return Outputs(images.valid.float(), images.points, torch.from_numpy(right))

    monkeypatch.setattr(model, "outputs", outputs)
    assert model.losses(observation, step=0)["affinity"].item() == pytest.approx(0, abs=1e-6)
    assert shapes == [(2, edge, edge)]


def test_clips_are_segmented_one_by_one_as_configured(monkeypatch: pytest.MonkeyPatch):
    """Their images go by frames, then views. Every clip has its own noise."""
    observation = observation_of([ArrayClips([arbitrary(seed)]).window(0, 0, 2) for seed in (0, 1)])
    chosen = {"model.bias": 0.7, "model.gap": 0.02, "model.clean_depth": True}
    model = ContactModel(override(ContactConfig(), chosen)).eval()
    points, biases, settings = unproject(clean_depth(observation)).flatten(1, 2).numpy(), [], []

    def groups(image: ClipImage, bias: float) -> np.ndarray:
        biases.append(bias)
        return np.zeros(np.count_nonzero(image.mask), np.int64)

    def segmented(images: list[ClipImage], **given: float) -> np.ndarray:
        np.testing.assert_array_equal([image.points for image in images], points[len(settings)])
        settings.append(given)
        return np.arange(1, 5)[:, None, None] * np.ones(images[0].mask.shape, np.int64) + 10 * len(settings)

    monkeypatch.setattr(ClipImage, "groups", groups)
    monkeypatch.setattr("obpose.contact.model.segment_clip", segmented)
    found = model.segment(observation).labels
    expected = torch.tensor([[[11, 12], [13, 14]], [[21, 22], [23, 24]]])[..., None, None] * observation.valid
    torch.testing.assert_close(found, expected)
    noises = depth_noise(observation).tolist()
    assert min(noises) > 0
    assert settings == [{"bias": 0.7, "gap": 0.02, "views": 2, "noise": noise} for noise in noises]
    assert biases == [0.7] * 8


def test_segmentations_have_the_shape_of_the_clip_and_leave_out_pixels_without_depth(observation: PastedObservation):
    torch.manual_seed(0)
    model = ContactModel(ContactConfig()).eval()
    model.network.head[-1].bias.data[0] = 9.0  # everything is foreground
    valid = observation.valid.clone()
    valid[:, :, :, 24:] = False
    valid[..., 12:] = False
    found = model.segment(replace(observation, valid=valid, depth=observation.depth * valid))
    assert found.labels.shape == found.attention.shape == observation.depth.shape
    assert torch.equal(found.labels > 0, valid)


@pytest.mark.parametrize("clean", [False, True])
def test_depth_is_cleaned_only_if_so_set(observation: PastedObservation, clean: bool):
    """In what the network sees and in the points that motion is found from; labels stay where there is depth."""
    torch.manual_seed(0)
    model = ContactModel(ContactConfig(model=ContactModelConfig(clean_depth=clean))).eval()
    model.network.head[-1].bias.data[0] = 9.0  # everything is foreground
    noisy = observation.depth + 0.003 * torch.randn(observation.depth.shape)
    valid = torch.ones_like(observation.valid)
    valid[..., ::4] = False
    holed = Observation(
        observation.rgb, torch.where(valid, noisy, 0), valid, observation.k, observation.world_from_camera
    )
    (image,) = model.clip_images(holed)[:1]
    raw = unproject(holed)[0, 0, 0].numpy()
    known = valid[0, 0, 0].numpy()
    assert (np.abs(image.points - raw)[known].max() > 1e-3) == clean
    assert image.mask.all() == clean
    assert torch.equal(model.segment(holed).labels > 0, valid)
    inputs = model.images(holed)
    assert inputs.valid.all() == clean


@pytest.mark.parametrize(("noise", "grown"), [(0.0, True), (0.00005, True), (0.01, False)])
def test_exact_depth_adds_what_is_above_the_table_next_to_the_foreground(
    observation: PastedObservation, monkeypatch: pytest.MonkeyPatch, noise: float, grown: bool
):
    """The network finds every second pixel of the objects; the table seems to be a little higher than it is."""
    model = ContactModel(ContactConfig(model=ContactModelConfig(noise=noise))).eval()
    truth = observation.pseudo_labels[0, :, 0].numpy() > 0
    found = truth & (np.indices(truth.shape).sum(axis=0) % 2 == 0)
    found[1] = False  # nothing that the added pixels could be next to
    outputs = model.outputs
    logits = torch.from_numpy(np.where(found, 0.1, -0.1)).float()
    monkeypatch.setattr(model, "outputs", lambda images: outputs(images)._replace(foreground=logits))
    pose = observation.world_from_camera.clone()
    pose[..., 2, 3] += LEAST_FLOOR / 2
    masks = [image.mask for image in model.clip_images(replace(observation, world_from_camera=pose))]
    assert np.array_equal(masks[0], truth[0] & binary_dilation(found[0], np.ones((3, 3))) if grown else found[0])
    assert not masks[1].any()


@pytest.mark.parametrize("gap", [None, 0.05])
def test_distant_points_share_no_object_if_so_set(observation: PastedObservation, gap: float | None):
    """A block that is 20 cm nearer to the camera than what is around it."""
    model = ContactModel(ContactConfig(model=ContactModelConfig(division_gap=gap))).eval()
    model.network.head[-1].bias.data[0] = 9.0  # everything is foreground
    depth = torch.full_like(observation.depth, 0.8)
    depth[..., 20:40, 20:40] = 0.6
    flat = replace(observation, depth=depth, valid=torch.ones_like(observation.valid))
    image = model.clip_images(flat)[0]
    inside = (depth[0, 0, 0] < 0.7).numpy()[image.mask]
    crossing = np.not_equal(*inside[image.pairs.pixels])
    assert crossing.any() == (gap is None)
    assert np.count_nonzero(~crossing) > len(inside)


@pytest.mark.parametrize("scale", [1, 2])
def test_partners_are_as_far_away_as_in_training(observation: PastedObservation, scale: int):
    model = ContactModel(override(ContactConfig(), {"model.image_scale": scale})).eval()
    model.network.head[-1].bias.data[0] = 9.0  # everything is foreground
    image = model.clip_images(observation)[0]
    columns = np.nonzero(image.mask)[1][image.pairs.pixels]
    assert np.unique(np.abs(columns[1] - columns[0])).tolist() == [0, 1, 3 * scale, 7 * scale]


def test_settings_that_cannot_work_are_refused():
    system = find_system("contact-masks")
    for name, value, message in (("frames", 2, "expected 1"), ("views", "all", "expected separate")):
        with pytest.raises(UsageError, match=message):
            check_contact_bounds(system.config("cpu", {f"train.{name}": value}))


def test_labels_of_the_dataset_do_not_reach_the_training():
    places = np.array([[[[-0.1, 0.05, 0.045], [0.08, -0.1, 0.045]]], [[[0.0, 0.1, 0.045], [0.1, -0.1, 0.045]]]])
    clips = [balls(place) for place in places]
    config = override(ContactConfig(), {"train.steps": 2, "train.batch": 2})
    trained = []
    for truth in ([truth for _, truth in clips], [np.zeros_like(truth) for _, truth in clips]):
        labelled = [
            replace(clip, truth=labels.astype(np.uint8)) for (clip, _), labels in zip(clips, truth, strict=True)
        ]
        trained.append(train(LabelledArrayClips(labelled), None, config).model.state_dict())
    assert all(torch.equal(value, trained[1][name]) for name, value in trained[0].items())
