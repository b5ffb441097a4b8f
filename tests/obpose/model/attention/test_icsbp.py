import math
from typing import Any

import pytest
import torch

from obpose.config import AttentionConfig, ModelConfig
from obpose.model.attention.icsbp import (
    ICSBP,
    Rules,
    add_remainder_slot,
    evaluation_rules,
    initial_sigma,
    log_alpha,
    training_rules,
    whole_scope,
)
from obpose.model.attention.interface import EXCLUDED
from obpose.types import Masks

SLOTS = 4
CHANNELS = 8


def _attend(
    colour: torch.Tensor,
    valid: torch.Tensor,
    log_prescope: torch.Tensor,
    *,
    config: AttentionConfig | None = None,
    slots: int = SLOTS,
    seed: int = 0,
    **options: Any,
) -> Masks:
    module = ICSBP(ModelConfig(slots=SLOTS, attention=config or AttentionConfig()))
    rules = Rules(**{"seeds": "greedy", "inactive": "never", "division": "stick_breaking", **options})
    generator = torch.Generator().manual_seed(seed)
    return module.masks(colour, valid, log_prescope, slots=slots, rules=rules, generator=generator)


def _scene(
    *, batch: int = 2, frames: int = 3, points: int = 40, spread: float = 0.4, seed: int = 0
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    colour = spread * torch.randn((batch, frames, points, CHANNELS), generator=generator)
    valid = torch.rand((batch, frames, points), generator=generator) < 0.8
    logits = torch.randn((batch, frames, points, 2), generator=generator)
    return colour, valid, logits.log_softmax(dim=-1)


def _clusters(counts: tuple[int, ...], *, frames: int = 2) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Points of the background (the first count), then of objects far from each other, the same in all frames."""
    label = torch.repeat_interleave(torch.arange(len(counts)), torch.tensor(counts))
    colour = (5.0 * torch.eye(CHANNELS)[label]).expand(1, frames, -1, -1)
    share = torch.where(label == 0, 0.99, 0.01)
    log_prescope = torch.stack([share, 1 - share], dim=-1).log().expand(1, frames, -1, -1)
    return colour, torch.ones(1, frames, len(label), dtype=torch.bool), log_prescope


def _total(masks: Masks) -> torch.Tensor:
    return masks.log_masks.exp().sum(dim=2) + masks.log_scope.exp()


@pytest.mark.parametrize("seeds", ["greedy", "stochastic"])
@pytest.mark.parametrize("inactive", ["never", "bernoulli", "threshold"])
@pytest.mark.parametrize("division", ["stick_breaking", "softmax"])
def test_background_masks_and_scope_sum_to_one_at_every_point(seeds: str, inactive: str, division: str):
    masks = _attend(*_scene(), seeds=seeds, inactive=inactive, division=division)
    torch.testing.assert_close(_total(masks), torch.ones(2, 3, 40), rtol=0, atol=1e-5)


def _reference(colour: torch.Tensor, valid: torch.Tensor, prescope: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Masks and scope of one clip, greedy, frame by frame and point by point, as probabilities."""
    sigma = initial_sigma(SLOTS)

    def alpha(distance: float) -> float:
        value = math.exp(-(distance**2) / sigma)
        return min(max(value, 0.0), 1 - 1e-6)

    frames, points = valid.shape
    seeds: list[torch.Tensor] = []
    masks, scopes = torch.zeros(frames, SLOTS + 1, points), torch.zeros(frames, points)
    for frame in range(frames):
        scope = [float(s) if ok else -1.0 for s, ok in zip(prescope[frame, :, 1], valid[frame], strict=True)]
        for slot in range(SLOTS):
            if frame == 0:
                seeds.append(colour[0, scope.index(max(scope))])
            for point in range(points):
                if valid[frame, point]:
                    share = alpha(float((colour[frame, point] - seeds[slot]).norm()))
                    masks[frame, slot + 1, point] = scope[point] * share
                    scope[point] *= 1 - share
        masks[frame, 0] = torch.where(valid[frame], prescope[frame, :, 0], 1.0)
        scopes[frame] = torch.tensor(scope).clamp(min=0)
    return masks, scopes


def test_agrees_with_loops_over_clips_frames_slots_and_points():
    colour, valid, log_prescope = _scene(batch=2, frames=3, points=25)
    masks = _attend(colour, valid, log_prescope, config=AttentionConfig(mean_shift_steps=0))
    for clip in range(2):
        expected = _reference(colour[clip].double(), valid[clip], log_prescope[clip].double().exp())
        torch.testing.assert_close(masks.log_masks[clip].exp(), expected[0], rtol=5e-3, atol=2e-4)
        torch.testing.assert_close(masks.log_scope[clip].exp(), expected[1], rtol=5e-3, atol=2e-4)


def _extreme(case: str) -> tuple[torch.Tensor, torch.Tensor]:
    colour, _, log_prescope = _scene()
    signs = torch.sign(log_prescope - math.log(0.5))
    if case == "apart":
        return 1e4 * torch.arange(40.0)[:, None].expand_as(colour), log_prescope
    if case == "equal":
        return torch.full_like(colour, 3.0), log_prescope
    if case == "near":
        return 1e4 + 1e-3 * colour, log_prescope
    return colour, (200 * signs).log_softmax(dim=-1)


@pytest.mark.parametrize("case", ["apart", "equal", "near", "certain"])
def test_log_masks_and_their_gradients_are_finite_and_exact_sums_hold_at_extremes(case: str):
    colour, log_prescope = _extreme(case)
    valid = _scene()[1]
    module = ICSBP(ModelConfig(slots=SLOTS))
    inputs = (colour.clone().requires_grad_(), log_prescope.clone().requires_grad_(), module.log_sigma)
    masks = module.masks(
        inputs[0],
        valid,
        inputs[1],
        slots=SLOTS,
        rules=Rules("greedy", "never", "stick_breaking"),
        generator=None,
    )
    assert masks.log_masks.isfinite().all()
    assert masks.log_scope.isfinite().all()
    torch.testing.assert_close(_total(masks), torch.ones(2, 3, 40), rtol=0, atol=1e-5)
    gradients = torch.autograd.grad(masks.log_masks.sum() + masks.log_scope.sum(), inputs)
    assert all(gradient.isfinite().all() for gradient in gradients)


def test_excluded_is_less_than_any_mask_in_use():
    colour, log_prescope = _extreme("apart")
    masks = _attend(colour, torch.ones(2, 3, 40, dtype=torch.bool), (400 * log_prescope).log_softmax(dim=-1))
    assert masks.log_masks.min() > EXCLUDED


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_inputs_give_finite_single_precision_masks(dtype: torch.dtype):
    colour, valid, log_prescope = _scene()
    masks = _attend((300 * colour).to(dtype), valid, log_prescope.to(dtype))
    assert masks.log_masks.dtype == torch.float32
    assert masks.log_masks.isfinite().all()


def test_stochastic_seeds_are_distributed_as_the_argmax_of_uniform_times_scope():
    scope, draws = torch.tensor([0.9, 0.6, 0.2]), 20000
    colour = (100 * torch.arange(3.0))[:, None].expand(draws, 1, 3, CHANNELS)
    log_prescope = torch.stack([1 - scope, scope], dim=-1).log().expand(draws, 1, 3, 2)
    everywhere = torch.ones(draws, 1, 3, dtype=torch.bool)
    masks = _attend(colour, everywhere, log_prescope, slots=1, seeds="stochastic", seed=3)
    frequency = masks.log_masks[:, 0, 1].argmax(dim=-1).bincount(minlength=3) / draws
    torch.testing.assert_close(frequency, _chances(scope.tolist()), rtol=0, atol=0.012)


def _chances(scope: list[float]) -> torch.Tensor:
    """How often u_i s_i is the largest: the integral of its density times the chance of the others to stay below."""
    value = torch.linspace(0, 1, 10001)
    chances = []
    for own, s in enumerate(scope):
        below = [(value / other).clamp(max=1) for place, other in enumerate(scope) if place != own]
        chances.append(torch.where(value <= s, torch.stack(below).prod(dim=0) / s, 0.0).mean())
    return torch.stack(chances)


def _sliding(step: float, *, gone: tuple[int, ...] = ()) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Background and two objects, the first of which slides by `step` a frame, for eight frames; some without it."""
    colour, valid, log_prescope = (part.clone() for part in _clusters((6, 5, 5), frames=8))
    colour[0, :, 6:11, 7] += step * torch.arange(8.0)[:, None]
    valid[0, list(gone), 6:11] = False
    return colour, valid, log_prescope


def _of_sliding_object(masks: Masks) -> torch.Tensor:
    """How much of the sliding object its own slot has in each frame."""
    of_object = masks.log_masks[0, :, :, 6:11].exp().mean(dim=-1)
    return of_object[:, of_object[0].argmax()]


def test_a_seed_follows_an_object_that_slides_out_of_the_mask_of_the_first_frame():
    still = _of_sliding_object(_attend(*_sliding(0.2), config=AttentionConfig(mean_shift_steps=0)))
    assert still[-1] < 0.1
    assert (_of_sliding_object(_attend(*_sliding(0.2))) > 0.85).all()


def test_a_seed_waits_while_its_object_is_out_of_sight():
    masks = _attend(*_sliding(0.2, gone=(3, 4)))
    assert (_of_sliding_object(masks)[[0, 1, 2, 5]] > 0.3).all()


def test_seeds_come_to_rest_at_the_means_under_their_sharpened_masks():
    colour, valid, log_prescope = _scene(batch=1, frames=2, points=80, spread=0.05)
    colour[:, :, ::2, 0] += 0.7
    log_prescope[:, 0] += math.log(0.03)  # Of so little some slots find nothing in the first frame and are idle.
    looks = AttentionConfig(mean_shift_steps=30)
    drawn = (_attend(colour, valid, log_prescope, config=looks, inactive="bernoulli", seed=seed) for seed in range(50))
    masks = next(masks for masks in drawn if masks.active[0].tolist()[:3] == [True, False, True])
    left, sigma = log_prescope[0, 1, :, 1].exp() * valid[0, 1], initial_sigma(SLOTS)
    for slot in (0, 2):
        mask = masks.log_masks[0, 1, 1 + slot].exp()
        weight = mask**3
        assert weight.sum() > 0.5
        alpha = torch.exp(-(colour[0, 1] - weight @ colour[0, 1] / weight.sum()).square().sum(-1) / sigma)
        torch.testing.assert_close(mask, left * alpha, rtol=1e-3, atol=1e-4)
        left = left * (1 - alpha)


def test_gradient_reaches_the_embedding_of_a_seed_from_a_later_frame():
    colour, valid, log_prescope = _scene()
    colour.requires_grad_()
    later = _attend(colour, valid, log_prescope, config=AttentionConfig(mean_shift_steps=0)).log_masks[:, 2, 1].sum()
    (gradient,) = torch.autograd.grad(later, colour)
    assert gradient[:, 0].abs().sum(dim=-1).count_nonzero(dim=-1).tolist() == [1, 1]
    assert gradient[:, 1].eq(0).all()


def test_gradient_reaches_the_embeddings_that_a_seed_is_the_mean_of():
    colour, valid, log_prescope = _scene()
    colour = (colour / 4).requires_grad_()
    # The mask at one point depends on that point and on where the seed is in its frame.
    at_a_point = _attend(colour, valid, log_prescope).log_masks[0, 1, 1, valid[0, 1]][0]
    (gradient,) = torch.autograd.grad(at_a_point, colour)
    assert gradient[0, 1].abs().sum(dim=-1).count_nonzero() == valid[0, 1].count_nonzero()
    assert gradient[0, [0, 2]].eq(0).all()


def _edge_and_middle() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """One object, a row of embeddings, the first of which has the largest scope; and another, of two points."""
    colour = torch.zeros(1, 1, 33, CHANNELS)
    colour[0, 0, :31, 0] = torch.linspace(0, 1.2, 31)
    colour[0, 0, 31:, 1] = 9.0
    scope = torch.full((33,), 0.95)
    scope[0] = 0.99
    return colour, torch.ones(1, 1, 33, dtype=torch.bool), torch.stack([1 - scope, scope], dim=-1).log()[None, None]


def test_seeds_move_from_the_edge_of_an_object_to_its_middle():
    at_edge, moved = (
        _attend(*_edge_and_middle(), config=AttentionConfig(mean_shift_steps=looks), slots=1)
        .log_masks[0, 0, 1, :31]
        .exp()
        for looks in (0, 3)
    )
    assert at_edge.argmax() == 0
    assert 6 <= moved.argmax() <= 15
    assert moved.sum() > 1.2 * at_edge.sum()


def test_what_a_slot_leaves_is_what_is_left_around_where_its_seed_moves():
    """From its end a seed reaches half of the row, from its middle all of it."""
    row = [part[:, :, :31] for part in _edge_and_middle()]
    still, moved = (
        _attend(
            row[0], row[1], row[2], config=AttentionConfig(mean_shift_steps=looks), slots=2, inactive="threshold"
        ).active[0]
        for looks in (0, 30)
    )
    assert still.tolist() == [True, True]
    assert moved.tolist() == [True, False]


def test_densest_seeds_are_in_the_middle_of_large_objects_first():
    masks = _attend(*_edge_and_middle(), config=AttentionConfig(mean_shift_steps=0), slots=2, seeds="densest")
    first, second = masks.log_masks[0, 0, 1:]
    assert first.argmax() == 15
    # What is left of the row is denser than the pair, but none of it has a scope over the threshold.
    assert second.argmax() in (31, 32)


def test_shares_divide_what_sticks_take():
    sticks, shares = (_attend(*_scene(), division=division) for division in ("stick_breaking", "softmax"))
    torch.testing.assert_close(shares.log_scope, sticks.log_scope)
    torch.testing.assert_close(shares.log_masks[:, :, 0], sticks.log_masks[:, :, 0])
    assert not torch.allclose(shares.log_masks, sticks.log_masks)


def _neighbours(apart: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Two objects of eight points with embeddings so far apart, the first with a little more scope."""
    colour = torch.zeros(1, 1, 16, CHANNELS)
    colour[0, 0, 8:, 0] = apart
    scope = torch.full((16,), 0.98)
    scope[:8] = 0.99
    return colour, torch.ones(1, 1, 16, dtype=torch.bool), torch.stack([1 - scope, scope], dim=-1).log()[None, None]


def test_in_shares_the_first_slot_does_not_take_its_neighbour():
    sticks, shares = (
        _attend(*_neighbours(0.7), slots=2, division=division).log_masks[0, 0, 1, 8:].exp().mean()
        for division in ("stick_breaking", "softmax")
    )
    assert sticks > 0.2
    assert shares < 0.05


def test_in_shares_a_slot_on_what_others_left_has_next_to_nothing():
    colour, valid, log_prescope = _neighbours(9.0)
    masks = _attend(colour, valid, log_prescope, slots=4, division="softmax").log_masks[0, 0, 1:].exp()
    # Four slots for two objects: two sit on an object that is taken.
    assert masks.amax(dim=0).min() > 0.9


@pytest.mark.parametrize(("objects", "in_use"), [((), 0), ((5,), 1), ((5, 5), 2), ((5, 5, 1), 2), ((5, 5, 5, 5, 5), 4)])
def test_threshold_leaves_slots_without_object_idle_in_all_frames(objects: tuple[int, ...], in_use: int):
    colour, valid, log_prescope = _clusters((8, *objects), frames=3)
    log_prescope = log_prescope.clone()
    log_prescope[:, 2] = log_prescope[:, 2].flip(-1)  # the last frame has scope everywhere: too late
    masks = _attend(colour, valid, log_prescope, inactive="threshold")
    assert masks.active.sum() == in_use
    assert masks.active[0, :in_use].all()
    assert (masks.log_masks[:, :, 1 + in_use :] == EXCLUDED).all()
    torch.testing.assert_close(_total(masks), torch.ones_like(masks.log_scope), rtol=0, atol=1e-5)


def test_no_threshold_no_idle_slots():
    masks = _attend(*_clusters((8, 5)), config=AttentionConfig(inactive_points=0), inactive="threshold")
    assert masks.active.all()


def test_bernoulli_leaves_a_slot_idle_as_often_as_a_draw_of_the_scope_finds_no_point():
    draws, scope = 20000, torch.tensor([0.3, 0.2, 0.1])
    log_prescope = torch.stack([1 - scope, scope], dim=-1).log().expand(draws, 1, 3, 2)
    colour = torch.zeros(draws, 1, 3, CHANNELS)
    masks = _attend(
        colour, torch.ones(draws, 1, 3, dtype=torch.bool), log_prescope, slots=2, inactive="bernoulli", seed=4
    )
    expected = 1 - 0.7 * 0.8 * 0.9
    assert masks.active[:, 0].float().mean().item() == pytest.approx(expected, abs=0.015)
    # The first slot takes all there is; where it is idle the second has the same chance again.
    second = (~masks.active[:, 0] & masks.active[:, 1]).float().mean().item()
    assert second == pytest.approx((1 - expected) * expected, abs=0.015)
    assert not (masks.active[:, 0] & masks.active[:, 1]).any()


@pytest.mark.parametrize("seeds", ["greedy", "stochastic"])
@pytest.mark.parametrize("inactive", ["never", "bernoulli", "threshold"])
def test_invalid_points_are_background_never_seed_and_change_nothing(seeds: str, inactive: str):
    colour, valid, log_prescope = _scene()
    tempting = torch.tensor([-200.0, 0.0])
    other = torch.where(valid[..., None], colour, 7.0), torch.where(valid[..., None], log_prescope, tempting)
    plain = _attend(colour, valid, log_prescope, seeds=seeds, inactive=inactive)
    masks = _attend(other[0], valid, other[1], seeds=seeds, inactive=inactive)
    assert torch.equal(plain.log_masks, masks.log_masks)
    assert torch.equal(plain.log_scope, masks.log_scope)
    assert torch.equal(plain.active, masks.active)
    nowhere = masks.log_masks.movedim(2, -1)[~valid]
    assert (nowhere[:, 0] == 0).all()
    assert (nowhere[:, 1:] == EXCLUDED).all()


@pytest.mark.parametrize("inactive", ["never", "bernoulli", "threshold"])
def test_a_clip_that_starts_without_points_is_all_background(inactive: str):
    colour, valid, log_prescope = _scene()
    valid[0, 0] = False
    masks = _attend(colour, valid, log_prescope, inactive=inactive)
    assert not masks.active[0].any()
    assert masks.log_masks.isfinite().all()
    torch.testing.assert_close(_total(masks), torch.ones(2, 3, 40), rtol=0, atol=1e-5)


@pytest.mark.parametrize("division", ["stick_breaking", "softmax"])
def test_without_a_background_slots_and_the_remainder_sum_to_one(division: str):
    colour, valid, _ = _scene()
    masks = add_remainder_slot(_attend(colour, valid, whole_scope(valid), division=division))
    assert masks.log_masks.shape[2] == 1 + SLOTS + 1
    shares = masks.log_masks.exp()
    torch.testing.assert_close(shares[:, :, 1:].sum(dim=2)[valid], torch.ones(int(valid.sum())))
    assert (shares[:, :, 0][valid] == 0).all()
    assert (shares[:, :, 0][~valid] == 1).all()
    assert masks.log_scope.exp().eq(0).all()
    assert masks.active.shape == (2, SLOTS + 1)


def test_a_higher_power_draws_seeds_to_where_masks_are_certain():
    colour = torch.zeros(1, 1, 41, CHANNELS)
    colour[..., 1:, 0] = 0.5
    valid, prescope = torch.ones(1, 1, 41, dtype=torch.bool), whole_scope(torch.ones(1, 1, 41, dtype=torch.bool))
    own = [
        _attend(
            colour, valid, prescope, config=AttentionConfig(mask_exponent=power, mean_shift_steps=1), slots=1
        ).log_masks[0, 0, 1, 0]
        for power in (1.0, 3.0)
    ]
    assert own[0] < own[1]


def test_rules_at_evaluation_are_deterministic_and_those_of_training_the_papers():
    config = AttentionConfig(inactive_in_training="bernoulli")
    assert training_rules(config) == Rules("stochastic", "bernoulli", "stick_breaking")
    assert evaluation_rules(config) == Rules("densest", "threshold", "softmax")


def test_alpha_is_one_half_at_the_initial_bandwidth_and_never_one_or_zero():
    distances, log_sigma = torch.tensor([0.0, SLOTS**-0.5, 1e6]), torch.tensor(math.log(initial_sigma(SLOTS)))
    assert log_alpha(distances, log_sigma)[1].exp().item() == pytest.approx(0.5, abs=1e-5)
    assert log_alpha(distances, log_sigma).tolist()[0] < 0
    assert log_alpha(distances, log_sigma).tolist()[2] == -1e3
