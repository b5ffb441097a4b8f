from typing import Literal

import pytest
import torch

from obpose.config import AttentionConfig, LatentConfig, ModelConfig
from obpose.model.attention.interface import EXCLUDED, Attended
from obpose.model.attention.slot import POSITION_FREQUENCIES, SlotAttention
from obpose.model.nerf.field import positional_encoding
from obpose.types import Embeddings

FEATURES, SLOTS, WIDTH = 5, 3, 8


def module(
    *,
    background: bool = True,
    distribution: Literal["learned", "untrained"] = "learned",
    weights: Literal["orthogonal", "uniform"] = "orthogonal",
    means: Literal["given", "none"] = "none",
    iterations: int = 3,
    width: int = WIDTH,
) -> SlotAttention:
    torch.manual_seed(0)
    config = ModelConfig(
        slots=SLOTS if background else SLOTS - 1,
        background="component" if background else "none",
        attention=AttentionConfig(kind="slots", slot_distribution=distribution),
        latent=LatentConfig(means=means),
        weights=weights,
    )
    return SlotAttention(config, features=FEATURES, width=width, iterations=iterations)


Scene = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


def scene(batch: int = 2, frames: int = 3, points: int = 30) -> Scene:
    generator = torch.Generator().manual_seed(1)
    shape = (batch, frames, points)
    features = torch.randn(*shape, FEATURES, generator=generator)
    valid = torch.rand(shape, generator=generator) < 0.8
    return 2 * torch.rand(*shape, 3, generator=generator) - 1, valid, features


def attend(net: SlotAttention, inputs: Scene | None = None, *, seed: int = 0) -> Attended:
    position, valid, features = inputs or scene()
    nothing = position[..., :0]
    embeddings = Embeddings(position, valid, position, position, nothing, features, nothing[:, :, 0], None)
    return net(embeddings, torch.Generator().manual_seed(seed))


def codes(found: Attended) -> torch.Tensor:
    assert found.slot_codes is not None
    return found.slot_codes


@pytest.mark.parametrize("background", [True, False])
def test_masks_sum_to_one_and_points_that_are_not_valid_are_nobodys(background: bool):
    masks, valid = attend(module(background=background)).masks, scene()[1]
    torch.testing.assert_close(masks.log_masks.exp().sum(dim=2), torch.ones(2, 3, 30))
    assert masks.log_masks.shape[2] == 1 + SLOTS
    assert (masks.log_masks[:, :, 0][~valid] == 0).all()
    assert (masks.log_masks[:, :, 0][valid] == EXCLUDED).all().item() == (not background)
    assert (masks.log_scope == EXCLUDED).all()
    assert masks.active.all()


def test_one_iteration_is_the_papers():
    net = module(background=False, iterations=1).eval()
    points, valid, features = scene(batch=1, frames=1)
    found = attend(net, (points, valid, features))
    position = net.position(torch.cat([points, positional_encoding(points, POSITION_FREQUENCIES)], dim=-1))
    kind, tokens = net.objects, net.tokens(net.features(features) + position)[0, 0][valid[0, 0]]
    slots = kind.mean + kind.log_std.exp() * kind.noise
    logits = tokens @ net.key.weight.T @ kind.query(slots).T / WIDTH**0.5
    shares = logits.softmax(dim=1) + 1e-8
    torch.testing.assert_close(found.masks.log_masks[0, 0, 1:, valid[0, 0]].exp().T, logits.softmax(dim=1))
    updates = (shares / shares.sum(dim=0)).T @ (tokens @ kind.value.weight.T)
    moved = kind.update(updates, slots)
    torch.testing.assert_close(codes(found)[0, 0], moved + kind.refine(moved))


def test_means_under_the_masks_end_the_codes():
    plain, found = attend(module().eval()), attend(module(means="given").eval())
    position, valid, features = scene()
    torch.testing.assert_close(codes(found)[..., :WIDTH], codes(plain))
    assert found.background_code is not None
    weights = found.masks.log_masks[0, 0, 0].exp() * valid[0, 0]
    mean = (weights[:, None] * torch.cat([features, position], dim=-1)[0, 0]).sum(dim=0) / weights.sum()
    torch.testing.assert_close(found.background_code[0, 0, WIDTH:], mean)


def test_the_order_of_object_slots_follows_their_noise_and_nothing_else():
    net, order = module().eval(), torch.tensor([2, 0, 1])
    plain = attend(net)
    net.objects.noise.copy_(net.objects.noise[order])
    turned = attend(net)
    torch.testing.assert_close(codes(turned), codes(plain)[:, :, order])
    torch.testing.assert_close(turned.masks.log_masks[:, :, 1:], plain.masks.log_masks[:, :, 1:][:, :, order])
    assert plain.background_code is not None
    assert turned.background_code is not None
    torch.testing.assert_close(turned.background_code, plain.background_code)


def test_gradients_reach_mean_and_deviation_and_every_weight():
    net = module()
    found = attend(net)
    assert found.background_code is not None
    (codes(found).square().sum() + found.background_code.square().sum() + found.masks.log_masks.sum()).backward()
    names = [name for name, parameter in net.named_parameters() if parameter.grad is None or not parameter.grad.any()]
    assert names == []
    assert {"objects.mean", "objects.log_std", "background.mean", "background.log_std"} <= {*net.state_dict()}


def test_gradients_are_those_of_every_iteration_and_frame():
    net, (points, valid, features) = module().eval().double(), scene(batch=1, frames=2)

    def found(given: torch.Tensor) -> torch.Tensor:
        return codes(attend(net, (points.double(), valid, given)))

    assert torch.autograd.gradcheck(found, features.double().requires_grad_(), fast_mode=True)


@pytest.mark.parametrize("distribution", ["learned", "untrained"])
def test_training_draws_have_the_mean_and_deviation_of_the_distribution(distribution: Literal["learned", "untrained"]):
    net = module(distribution=distribution)
    for kind in (net.objects, net.background):
        assert kind is not None
        drawn = kind.first(20_000, torch.Generator().manual_seed(0))[:, 0]
        torch.testing.assert_close(drawn.mean(dim=0), kind.mean, rtol=0, atol=0.05)
        torch.testing.assert_close(drawn.std(dim=0), kind.log_std.exp(), rtol=0.03, atol=0)


def test_a_learned_distribution_is_saved_and_gives_the_same_slots_again():
    net = module()
    with torch.no_grad():
        net.objects.mean.add_(1.0)
    other = module()
    other.load_state_dict(net.state_dict())
    assert torch.equal(codes(attend(net.eval())), codes(attend(other.eval())))


def test_an_untrained_distribution_is_not_saved_and_another_at_evaluation():
    net = module(distribution="untrained")
    assert not [name for name in net.state_dict() if "mean" in name or "std" in name]
    assert not [name for name, _ in net.named_parameters() if "mean" in name or "std" in name]
    assert (net.objects.mean - net.objects.other_mean).abs().max() > 0.1
    many = torch.Generator().manual_seed(0)
    training = torch.cat([net.objects.first(64, many) for _ in range(64)]).mean(dim=(0, 1))
    torch.testing.assert_close(training, net.objects.mean, atol=0.2, rtol=0)
    evaluation = net.eval().objects.first(1, None)[0]
    expected = net.objects.other_mean + net.objects.other_log_std.exp() * net.objects.noise
    torch.testing.assert_close(evaluation, expected)


def test_slots_of_a_frame_begin_where_those_of_the_frame_before_ended():
    net, (points, valid, features) = module(iterations=1).eval(), scene(frames=1)
    still = torch.cat([points] * 2, dim=1), torch.cat([valid] * 2, dim=1), torch.cat([features] * 2, dim=1)
    once, twice = module(iterations=2).eval(), attend(net, still)
    torch.testing.assert_close(codes(twice)[:, 1], codes(attend(once, (points, valid, features)))[:, 0])


def test_object_slots_are_not_equal_at_evaluation():
    objects = codes(attend(module().eval()))
    assert (objects[:, :, 0] - objects[:, :, 1]).abs().max() > 1e-2


def test_what_is_not_valid_has_no_influence():
    net, (points, valid, features) = module().eval(), scene()
    spoiled = torch.where(valid[..., None], features, 50.0)
    torch.testing.assert_close(
        codes(attend(net, (points, valid, features))), codes(attend(net, (points, valid, spoiled)))
    )
    nothing = attend(net, (points, torch.zeros_like(valid), features))
    assert codes(nothing).isfinite().all()


def test_orthogonal_weights_share_the_points_out_from_the_start():
    orthogonal, uniform = (
        attend(net.eval()).masks.log_masks.exp().amax(dim=2).mean()
        for net in (module(weights="orthogonal", width=32), module(weights="uniform", width=32))
    )
    assert orthogonal > uniform + 0.2
