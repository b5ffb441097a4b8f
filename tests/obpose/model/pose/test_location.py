import torch
import torch.nn.functional as F

from obpose.config import LatentConfig, ModelConfig, PoseConfig
from obpose.model.layers.latent import LATENT
from obpose.model.pose.encoder import ObjectEncoder
from obpose.model.pose.location import Where, count_points, observed_center
from tests.obpose.model.pose.clouds import crop, half_a_cube, table

SLOTS = 3


def hard_masks(owner: torch.Tensor) -> torch.Tensor:
    """Log masks, "batch frame component point", of points that belong to one component each."""
    return F.one_hot(owner, SLOTS + 1).movedim(-1, 2).float().clamp(min=1e-30).log()


def clip(*shape: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Component of each point, points and their validity, "batch frame point"."""
    generator = torch.Generator().manual_seed(seed)
    owner = torch.randint(SLOTS + 1, shape, generator=generator)
    return owner, torch.randn(*shape, 3, generator=generator), torch.rand(shape, generator=generator) < 0.7


def test_with_hard_masks_it_is_the_centroid_of_the_observed_points():
    owner, points, valid = clip(2, 3, 60)
    center = observed_center(hard_masks(owner), points, valid, min_points=1, exponent=3.0)
    for batch in range(2):
        for frame in range(3):
            for slot in range(SLOTS):
                mine = valid[batch, frame] & (owner[batch, frame] == slot + 1)
                torch.testing.assert_close(center[batch, frame, slot], points[batch, frame, mine].mean(dim=0))


def test_with_soft_masks_it_is_the_mean_weighted_by_their_cubes():
    _, points, valid = clip(1, 1, 50)
    masks = torch.randn(1, 1, SLOTS + 1, 50, generator=torch.Generator().manual_seed(1)).softmax(dim=2)
    weights = masks[0, 0, 1:] ** 3 * valid[0, 0]
    expected = (weights @ points[0, 0]) / weights.sum(dim=-1, keepdim=True)
    torch.testing.assert_close(observed_center(masks.log(), points, valid, min_points=0, exponent=3.0)[0, 0], expected)


def test_points_that_are_not_observed_do_not_count():
    owner, points, valid = clip(1, 2, 60)
    moved = torch.where(valid[..., None], points, 1e6)
    masks = hard_masks(owner)
    assert torch.equal(
        observed_center(masks, moved, valid, min_points=1, exponent=3.0),
        observed_center(masks, points, valid, min_points=1, exponent=3.0),
    )
    assert torch.equal(count_points(masks, valid).sum(dim=-1), (valid & (owner > 0)).sum(dim=-1))


def test_a_slot_with_too_few_points_stays_where_it_was():
    _, points, _ = clip(1, 5, 40)
    valid = torch.ones(1, 5, 40, dtype=torch.bool)
    owner = torch.zeros(1, 5, 40, dtype=torch.long)
    for frame, count in enumerate([2, 9, 3, 0, 4]):
        owner[0, frame, :count] = 2
    center = observed_center(hard_masks(owner), points, valid, min_points=4, exponent=3.0)[0, :, 1]
    torch.testing.assert_close(center[0], points[0, 0, :2].mean(dim=0))
    torch.testing.assert_close(center[1], points[0, 1, :9].mean(dim=0))
    assert torch.equal(center[2], center[1])
    assert torch.equal(center[3], center[1])
    torch.testing.assert_close(center[4], points[0, 4, :4].mean(dim=0))


def test_a_slot_that_is_never_seen_stays_at_its_first_location():
    owner, points, valid = clip(1, 3, 40)
    center = observed_center(hard_masks(owner), points, valid, min_points=1000, exponent=3.0)
    assert torch.equal(center, center[:, :1].expand_as(center))


def test_idle_slots_and_empty_frames_have_finite_locations():
    _, points, valid = clip(2, 2, 40)
    valid[0] = False
    idle = torch.full((2, 2, SLOTS + 1, 40), -1e4)
    idle[:, :, 0] = 0
    center = observed_center(idle, points, valid, min_points=10, exponent=3.0)
    assert center.isfinite().all()
    torch.testing.assert_close(center[1, 0], points[1, 0, valid[1, 0]].mean(dim=0).expand(SLOTS, 3))


def test_traces_of_a_mask_elsewhere_pull_at_a_low_power_alone():
    points = torch.cat([torch.zeros(1, 1, 10, 3), torch.ones(1, 1, 1000, 3)], dim=2)
    mine = torch.cat([torch.full((10,), 0.9), torch.full((1000,), 0.01)])
    log_masks = torch.stack([1 - mine, mine])[None, None].log()
    near, far = (
        observed_center(log_masks, points, torch.ones(1, 1, 1010, dtype=torch.bool), min_points=1, exponent=power)[
            0, 0, 0, 0
        ]
        for power in (3.0, 1.0)
    )
    assert near < 0.001
    torch.testing.assert_close(far, torch.tensor(10 / 19))


CODE = ObjectEncoder(4, LatentConfig()).size


def where(max_translation: float = 0.05) -> Where:
    torch.manual_seed(0)
    return Where(CODE, ModelConfig(pose=PoseConfig(max_translation=max_translation)))


def test_translations_stay_within_their_maximum_and_reach_it():
    z = 1e4 * torch.randn(4, 2, 3, LATENT, generator=torch.Generator().manual_seed(0))
    largest = where(0.03).translation(z).abs().max()
    torch.testing.assert_close(largest, torch.tensor(0.03))


def test_a_small_latent_is_translated_in_proportion_to_the_maximum():
    z = 0.1 * torch.randn(1, 1, 1, LATENT, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(where(0.1).translation(z), 2 * where(0.05).translation(z))


def test_the_translation_trains_the_encoder():
    torch.manual_seed(0)
    encoder, module = ObjectEncoder(4, LatentConfig()), where()
    latent = module(encoder(crop(half_a_cube(0.025), table(0.025))), "sample", torch.Generator().manual_seed(0))
    assert latent.z.shape == (1, 1, 1, LATENT)
    corrected = torch.zeros(3) + module.translation(latent.z)
    corrected.square().sum().backward()
    for name, parameter in encoder.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name


def test_the_first_prior_is_standard_normal():
    latent = where()(torch.ones(1, 2, 3, CODE), "mean")
    assert (latent.prior_mean[:, 0] == 0).all()
    assert (latent.prior_std[:, 0] == 1).all()
