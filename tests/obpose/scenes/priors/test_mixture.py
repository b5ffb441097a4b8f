import pytest
import torch
from torch import Tensor

from obpose.scenes.priors.mixture import Mixture, fit_mixture


def gaussian(mean: Tensor, factor: Tensor) -> Mixture:
    return Mixture(torch.ones(1), mean[None], factor[None])


def test_a_gaussian_draws_with_its_mean_and_covariance():
    factor = torch.tensor([[2.0, 0.0], [1.0, 0.5]])
    drawn = gaussian(torch.tensor([3.0, -1.0]), factor).draw(20000, torch.Generator().manual_seed(0))
    torch.testing.assert_close(drawn.mean(dim=0), torch.tensor([3.0, -1.0]), atol=0.05, rtol=0)
    torch.testing.assert_close(drawn.T.cov(), factor @ factor.T, atol=0.1, rtol=0)


def test_a_mixture_draws_from_its_parts_by_their_weights():
    mixture = Mixture(torch.tensor([0.25, 0.75]), torch.tensor([[-9.0], [9.0]]), torch.tensor([[[1.0]], [[2.0]]]))
    drawn = mixture.draw(20000, torch.Generator().manual_seed(0))[:, 0]
    low, high = drawn[drawn < 0], drawn[drawn > 0]
    assert len(low) / len(drawn) == pytest.approx(0.25, abs=0.01)
    assert [float(low.mean()), float(low.std())] == pytest.approx([-9, 1], abs=0.05)
    assert [float(high.mean()), float(high.std())] == pytest.approx([9, 2], abs=0.05)
    assert mixture.draw(0, torch.Generator()).shape == (0, 1)


def test_a_fitted_mixture_has_as_many_parts_as_there_are_clusters():
    noise, places = torch.Generator().manual_seed(0), 10 * torch.eye(4)
    values = places.repeat(100, 1) + torch.randn(400, 4, generator=noise)
    mixture = fit_mixture(values)
    nearest = torch.cdist(places, mixture.means).min(dim=1)
    torch.testing.assert_close(mixture.weights[nearest.indices], torch.full((4,), 0.25), atol=0.01, rtol=0)
    assert nearest.values.max() < 0.4
    covariances = mixture.factors @ mixture.factors.mT
    torch.testing.assert_close(covariances[nearest.indices], torch.eye(4).expand(4, 4, 4), atol=0.5, rtol=0)
    assert torch.equal(fit_mixture(values).means, mixture.means)


def test_one_cluster_is_one_gaussian():
    values = torch.randn(400, 4, generator=torch.Generator().manual_seed(0))
    mixture = fit_mixture(values)
    assert mixture.weights.tolist() == [1]
    torch.testing.assert_close(mixture.factors[0] @ mixture.factors[0].T, values.T.cov(), atol=1e-5, rtol=0)
