from decimal import Decimal, localcontext

import pytest
import torch

from obpose.model.layers.numerics import log1mexp, log_sum_exp

ARGUMENTS = (-1e-30, -1e-7, -1e-3, -0.5, -0.6931, -0.6932, -1.0, -10.0, -40.0, -80.0)


def _exact(x: float) -> tuple[float, float]:
    with localcontext() as context:
        context.prec = 80
        rest = 1 - Decimal(x).exp()
        return float(rest.ln()), float(-Decimal(x).exp() / rest)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 3e-7), (torch.float64, 1e-15)])
def test_value_and_gradient_have_all_digits_from_the_smallest_to_the_largest_share(
    dtype: torch.dtype, tolerance: float
):
    x = torch.tensor(ARGUMENTS, dtype=dtype, requires_grad=True)
    value = log1mexp(x)
    (gradient,) = torch.autograd.grad(value.sum(), x)
    expected = torch.tensor([_exact(argument) for argument in x.tolist()], dtype=torch.float64)
    torch.testing.assert_close(value.double(), expected[:, 0], rtol=tolerance, atol=0)
    torch.testing.assert_close(gradient.double(), expected[:, 1], rtol=tolerance, atol=0)


def test_finite_far_beyond_the_range_of_the_exponential():
    x = torch.tensor([-1e3, -1e30], requires_grad=True)
    value = log1mexp(x)
    (gradient,) = torch.autograd.grad(value.sum(), x)
    assert value.eq(0).all()
    assert gradient.eq(0).all()


def test_sum_of_exponentials_is_torchs_where_some_terms_are_nothing():
    x = torch.tensor([[0.3, -2.0, -79.0, -81.0, -1e4], [-3e4, -3e4, -3e4 - 1, -1e5, -1e6]], requires_grad=True)
    value, expected = log_sum_exp(x, dim=1), torch.logsumexp(x, dim=1)
    (gradient,), (other,) = (torch.autograd.grad(total.sum(), x) for total in (value, expected))
    assert value.equal(expected)
    torch.testing.assert_close(gradient, other, rtol=0, atol=1e-30)
    assert gradient[:, 0].gt(0).all()
