import pytest
import torch

from obpose.model.layers.gaussian import draw_gaussian, mean_and_std


def test_samples_have_the_mean_and_the_standard_deviation():
    generator = torch.Generator().manual_seed(0)
    mean, std = torch.tensor([-1.0, 0.0, 2.0]), torch.tensor([0.1, 1.0, 0.5])
    z = draw_gaussian(mean.expand(40_000, 3), std.expand(40_000, 3), draw="sample", generator=generator)
    torch.testing.assert_close(z.mean(dim=0), mean, atol=0.02, rtol=0)
    torch.testing.assert_close(z.std(dim=0), std, atol=0.02, rtol=0)


def test_a_generator_in_the_same_state_draws_the_same():
    mean, std = torch.zeros(5), torch.ones(5)
    draws = [draw_gaussian(mean, std, draw="sample", generator=torch.Generator().manual_seed(3)) for _ in range(2)]
    assert torch.equal(*draws)


def test_the_mean_is_drawn_without_chance():
    mean, generator = torch.randn(5, generator=torch.Generator().manual_seed(0)), torch.Generator().manual_seed(1)
    before = generator.get_state()
    assert torch.equal(draw_gaussian(mean, torch.ones(5), draw="mean", generator=generator), mean)
    assert torch.equal(generator.get_state(), before)


def test_samples_are_differentiable_in_mean_and_standard_deviation():
    mean, std = torch.zeros(4, requires_grad=True), torch.ones(4, requires_grad=True)
    z = draw_gaussian(mean, std, draw="sample", generator=torch.Generator().manual_seed(0))
    by_mean, by_std = torch.autograd.grad(z.sum(), (mean, std))
    assert torch.equal(by_mean, torch.ones(4))
    assert torch.equal(by_std, z.detach())


def test_standard_deviations_are_positive_however_negative_the_numbers():
    mean, std = mean_and_std(torch.tensor([1.0, 2.0, -1e4, 1e4]), typical_std=0.1)
    assert torch.equal(mean, torch.tensor([1.0, 2.0]))
    assert 0 < std[0] < 1e-3
    torch.testing.assert_close(std[1], torch.tensor(1e4), rtol=1e-3, atol=0)


@pytest.mark.parametrize("typical", [0.01, 0.7, 3.0])
def test_zeros_stand_for_the_typical_standard_deviation(typical: float):
    _, std = mean_and_std(torch.zeros(8), typical_std=typical)
    torch.testing.assert_close(std, torch.full((4,), typical), atol=1e-4 + 1e-6, rtol=0)
