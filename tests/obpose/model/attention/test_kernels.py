import math

import pytest
import torch

from obpose.model.attention.kernels import NEVER_ALL, NEVER_NONE, Kernel, initial_sigma, log_alpha

KERNELS: tuple[Kernel, ...] = ("gaussian", "laplacian", "epanechnikov")


def _log_sigma(kernel: Kernel, slots: int = 4) -> torch.Tensor:
    return torch.tensor(math.log(initial_sigma(kernel, slots=slots)))


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("slots", [1, 4, 9])
def test_alpha_starts_at_one_half_at_a_squared_distance_of_one_by_the_number_of_slots(kernel: Kernel, slots: int):
    distance = torch.tensor([slots**-0.5])
    alpha = log_alpha(distance, _log_sigma(kernel, slots), kernel).exp()
    torch.testing.assert_close(alpha, torch.tensor([0.5]), rtol=3e-3, atol=0)


@pytest.mark.parametrize("kernel", KERNELS)
def test_agrees_with_the_formula_where_that_is_safe(kernel: Kernel):
    distance, sigma = torch.linspace(0.05, 0.65, 13, dtype=torch.float64), initial_sigma(kernel, slots=4)
    formulas = {
        "gaussian": torch.exp(-(distance**2) / sigma),
        "laplacian": torch.exp(-distance / sigma),
        "epanechnikov": torch.relu(1 - distance**2 / sigma),
    }
    alpha = log_alpha(distance, _log_sigma(kernel).double(), kernel).exp()
    torch.testing.assert_close(alpha, formulas[kernel], rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("kernel", KERNELS)
def test_falls_with_distance_within_its_bounds(kernel: Kernel):
    distance = torch.cat([torch.zeros(1), torch.logspace(-6, 15, 200)])
    value = log_alpha(distance, _log_sigma(kernel), kernel)
    assert value.diff().le(0).all()
    assert value.max() <= -NEVER_ALL
    assert value.min() >= -NEVER_NONE


@pytest.mark.parametrize("kernel", KERNELS)
def test_gradient_at_the_seed_is_zero_not_undefined(kernel: Kernel):
    distance = torch.zeros(1, requires_grad=True)
    (gradient,) = torch.autograd.grad(log_alpha(distance, _log_sigma(kernel), kernel).sum(), distance)
    assert gradient.item() == 0


@pytest.mark.parametrize("kernel", KERNELS)
def test_points_out_of_reach_draw_a_seed_nearer(kernel: Kernel):
    distance = torch.tensor([0.8, 1.5, 3.0], requires_grad=True)
    value = log_alpha(distance, _log_sigma(kernel), kernel)
    (gradient,) = torch.autograd.grad(value.sum(), distance)
    assert (gradient < -1).all()
    if kernel == "epanechnikov":
        assert (value.exp() <= 1e-6).all()
