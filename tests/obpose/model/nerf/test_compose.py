import math

import pytest
import torch

from obpose.config import LossConfig
from obpose.model.nerf.compose import OUTSIDE, air_density, log_density, log_share, mean_colour, solid_share

SATURATION = LossConfig().air_saturation
assert SATURATION is not None
EXTREMES = (-1e4, -200.0, -30.0, -3.0, 0.0, 3.0, 30.0, 1e4, OUTSIDE)


def logits_of(*values: float, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    return torch.tensor(values, dtype=dtype)[:, None].requires_grad_()


def direct_density(logits: torch.Tensor) -> torch.Tensor:
    return torch.tanh(torch.log1p(logits.double().exp()).sum(dim=-2))


def test_it_is_the_papers_formula_where_that_is_safe():
    logits = 12 * torch.rand(5, 3000, generator=torch.Generator().manual_seed(0)) - 8
    expected = direct_density(logits)
    torch.testing.assert_close(log_density(logits).double(), expected.log(), atol=2e-6, rtol=1e-5)
    torch.testing.assert_close(
        log_share(logits).exp().double(), expected * torch.softmax(logits.double(), dim=0), atol=1e-6, rtol=1e-5
    )


def test_it_is_exact_in_double_precision_down_to_faint_fog():
    logits = torch.linspace(-18, 5, 500, dtype=torch.float64)[None]
    torch.testing.assert_close(log_density(logits), direct_density(logits).log(), atol=1e-8, rtol=1e-8)


def test_density_is_bounded_and_grows_with_every_logit():
    steps = torch.linspace(-50, 50, 2001)
    for others in (-30.0, -1.0, 2.0):
        log = log_density(torch.stack([steps, torch.full_like(steps, others)]))
        assert (log <= 0).all()
        assert (log.diff() >= -1e-6).all()
        assert log[0] < log[-1]


def test_shares_add_up_to_the_joint_density():
    logits = 30 * torch.randn(2, 3, 5, 100, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(torch.logsumexp(log_share(logits), dim=-2), log_density(logits), atol=1e-5, rtol=1e-5)


def test_everything_is_finite_at_extreme_logits():
    grid = torch.cartesian_prod(*[torch.tensor(EXTREMES)] * 3).T.contiguous().requires_grad_()
    for value in (log_density(grid), log_share(grid), air_density(grid, saturation=SATURATION)):
        assert value.isfinite().all()
        (gradient,) = torch.autograd.grad(value.sum(), grid)
        assert gradient.isfinite().all()


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_the_sentinel_is_finite_in_half_precision(dtype: torch.dtype):
    assert torch.tensor(OUTSIDE, dtype=dtype).isfinite()
    assert log_share(torch.tensor([[0.0], [OUTSIDE]], dtype=dtype)).isfinite().all()


def test_what_is_outside_takes_no_share_from_the_faintest_inside():
    faint = logits_of(-1e4, OUTSIDE)
    assert (log_share(faint) - log_density(faint)).exp().flatten().tolist() == [1, 0]
    torch.testing.assert_close(log_density(logits_of(-1.0, OUTSIDE)), log_density(logits_of(-1.0)))


def test_the_surface_term_lifts_empty_space():
    logits = logits_of(-200.0, -210.0)
    (gradient,) = torch.autograd.grad(log_density(logits).sum(), logits)
    torch.testing.assert_close(gradient[0, 0], torch.tensor(1.0), atol=1e-3, rtol=0)


def test_the_air_term_clears_dense_fog():
    logits = logits_of(25.0, 25.0)
    (gradient,) = torch.autograd.grad(air_density(logits, saturation=SATURATION).sum(), logits)
    assert (gradient > 1e-3).all()


def test_the_air_term_is_the_density_below_saturation_and_goes_on_smoothly():
    total = torch.linspace(0.01, 2 * SATURATION, 1001, dtype=torch.float64)
    logits = total.expm1().log()[None].requires_grad_()
    air = air_density(logits, saturation=SATURATION)
    below = total <= SATURATION
    torch.testing.assert_close(air[below], total.tanh()[below])
    assert (air.diff() > 0).all()
    slopes = air.diff() / total.diff()
    assert slopes.diff().max() <= 1e-9, "concave, without a step in its slope"
    assert (air - total.tanh()).max() < 0.05


@pytest.mark.parametrize("saturation", [0.5, 1.0, SATURATION, 6.0])
def test_beyond_saturation_the_air_term_goes_on_along_the_tangent(saturation: float):
    """Slope sech^2(saturation), by finite differences and by autograd, up to the switch and everywhere beyond it."""
    total = torch.tensor([saturation, 1.001 * saturation, 1.5 * saturation, 4 * saturation, 30.0], dtype=torch.float64)
    logits = total.expm1().log()[None].requires_grad_()
    air = air_density(logits, saturation=saturation)
    slope = 1 / math.cosh(saturation) ** 2
    torch.testing.assert_close(air, math.tanh(saturation) + slope * (total - saturation), atol=1e-12, rtol=0)
    (gradient,) = torch.autograd.grad(air.sum(), logits)
    softplus_slope = torch.sigmoid(logits.detach())
    torch.testing.assert_close(gradient[:, 1:], slope * softplus_slope[:, 1:], atol=1e-12, rtol=1e-9)
    step = 1e-6
    around = torch.tensor([saturation - step, saturation, saturation + step], dtype=torch.float64)
    left, right = (air_density(around.expm1().log()[None], saturation=saturation).diff() / step).tolist()
    assert left == pytest.approx(slope, rel=1e-4)
    assert right == pytest.approx(slope, rel=1e-4)


def test_without_saturation_the_air_term_is_the_density_and_dense_fog_is_dead():
    logits = logits_of(25.0, 25.0)
    density = air_density(logits, saturation=None)
    torch.testing.assert_close(density, log_density(logits).exp())
    (gradient,) = torch.autograd.grad(density.sum(), logits)
    assert (gradient == 0).all()


def test_the_mean_colour_leans_to_the_densest_component():
    colours = torch.tensor([[[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]])
    torch.testing.assert_close(mean_colour(logits_of(30.0, 10.0), colours), torch.tensor([[1.0, 0.0, 0.0]]))
    even = mean_colour(logits_of(10.0, 10.0), colours)
    torch.testing.assert_close(even, torch.tensor([[0.5, 0.5, 0.0]]))
    faint = mean_colour(logits_of(-3.0, -3.0), colours)
    torch.testing.assert_close(faint.sum(), log_density(logits_of(-3.0, -3.0)).exp().sum())


def test_what_is_thinner_than_the_threshold_is_not_there():
    logits = torch.tensor([[0.0, -4.0, 0.5], [-1.0, -4.0, 0.5]])
    share = log_share(logits).exp()
    assert torch.equal(solid_share(logits, 0.0), share)
    kept = share.sum(dim=0) >= 0.5
    assert kept.tolist() == [True, False, True]
    assert torch.equal(solid_share(logits, 0.5), share * kept)
