import pytest
import torch

from obpose.baselines.obsurf.slots import SlotAttention, compete, gather

SLOTS, WIDTH, TOKENS = 4, 8, 30


def attention(seed: int = 0) -> SlotAttention:
    torch.manual_seed(seed)
    return SlotAttention(slots=SLOTS, width=WIDTH)


def tokens(images: int = 2) -> torch.Tensor:
    return torch.randn(images, TOKENS, WIDTH, generator=torch.Generator().manual_seed(1))


def noise(images: int = 2) -> torch.Tensor:
    return torch.randn(images, SLOTS, WIDTH, generator=torch.Generator().manual_seed(2))


def test_each_token_is_divided_among_the_slots():
    shares = compete(noise(), tokens())
    torch.testing.assert_close(shares.sum(dim=1), torch.ones(2, TOKENS))
    found = attention()(tokens(), noise())
    assert found.attention.shape == (2, SLOTS, TOKENS)
    torch.testing.assert_close(found.attention.sum(dim=1), torch.ones(2, TOKENS))


def test_logits_are_scaled_by_the_root_of_the_width():
    queries, keys = torch.zeros(1, 2, 16), torch.ones(1, 1, 16)
    queries[0, 0] = 1 / 8
    assert torch.logit(compete(queries, keys)[0, 0, 0]).item() == pytest.approx(2 / 4, abs=1e-5)


def test_a_slots_update_is_a_mean_over_tokens():
    values = tokens()
    shares = compete(noise(), values)
    weights = shares / shares.sum(dim=-1, keepdim=True)
    torch.testing.assert_close(gather(shares, values), weights @ values, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(gather(shares, torch.ones_like(values)), torch.ones(2, SLOTS, WIDTH))
    assert gather(torch.zeros(1, 1, TOKENS), values[:1]).isfinite().all()


def test_slots_follow_their_noise_and_do_not_mind_the_order_of_tokens():
    module = attention()
    plain = module(tokens(), noise())
    order, shuffle = torch.tensor([2, 0, 3, 1]), torch.randperm(TOKENS)
    turned = module(tokens()[:, shuffle], noise()[:, order])
    torch.testing.assert_close(turned.codes, plain.codes[:, order], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(turned.attention, plain.attention[:, order][..., shuffle], rtol=1e-4, atol=1e-5)


def test_slots_that_began_equal_would_stay_equal_and_those_at_evaluation_do_not():
    module = attention()
    codes = module(tokens(1), torch.zeros(1, SLOTS, WIDTH)).codes
    torch.testing.assert_close(codes, codes[:, :1].expand_as(codes))
    told = module(tokens(1), module.evaluation_noise[None]).codes[0]
    assert torch.pdist(told).min() > 0.01


def test_the_slot_distribution_stays_what_it_was_drawn_as():
    module = attention()
    assert {"mean", "spread"}.isdisjoint(name for name, _ in module.named_parameters())
    assert not torch.equal(module.mean, attention(1).mean)
    assert not torch.equal(module.spread, attention(1).spread)


def test_first_slots_have_the_mean_and_deviation_of_the_distribution():
    module = attention()
    drawn = module.first_slots(torch.randn(20_000, WIDTH, generator=torch.Generator().manual_seed(3)))
    torch.testing.assert_close(drawn.mean(dim=0), module.mean, rtol=0, atol=0.05)
    torch.testing.assert_close(drawn.std(dim=0), torch.nn.functional.softplus(module.spread), rtol=0.03, atol=0)


def test_everything_that_decides_the_slots_is_saved():
    first, other = attention(0), attention(1)
    other.load_state_dict(first.state_dict())
    told = [module(tokens(1), module.evaluation_noise[None]).codes for module in (first, other)]
    assert torch.equal(*told)
