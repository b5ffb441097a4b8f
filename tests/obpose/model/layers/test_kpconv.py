import pytest
import torch
from torch import Tensor

from obpose.model.layers.kpconv import EXTENT, SHELL, KPConv, influence, kernel_points


def slow_kpconv(features: Tensor, offsets: Tensor, valid: Tensor, kernel: Tensor, weight: Tensor) -> Tensor:
    """The definition (Thomas et al., eq. 1 to 3), pair by pair; `weight` is "output input kernel"."""
    result = torch.zeros(len(features), len(weight), dtype=torch.float64)
    for point in range(len(features)):
        for neighbour in range(features.shape[1]):
            for index, place in enumerate(kernel.double()):
                reach = 1 - float((offsets[point, neighbour].double() - place).norm()) / EXTENT
                if valid[point, neighbour] and reach > 0:
                    result[point] += reach * weight[..., index].double() @ features[point, neighbour].double()
    return result


def draw(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed)) * 2 - 1


def test_influence_is_that_of_the_definition():
    offsets, kernel = draw(200, 3), kernel_points()
    distances = (offsets.double()[:, None] - kernel.double()).norm(dim=-1)
    torch.testing.assert_close(
        influence(offsets, kernel).double(), (1 - distances / EXTENT).clamp(min=0), atol=1e-4, rtol=0
    )


def test_influence_falls_linearly_from_one_at_the_kernel_point_to_zero_at_the_extent():
    kernel = kernel_points()
    away = torch.tensor([0.0, 0.12, 0.24, 0.48, 5.0, 1e6])[:, None] * torch.tensor([0.0, 0.6, 0.8])
    found = influence(away, kernel)[:, 0]
    torch.testing.assert_close(found, torch.tensor([1.0, 0.75, 0.5, 0.0, 0.0, 0.0]), atol=1e-3, rtol=0)
    torch.testing.assert_close(influence(kernel, kernel).diagonal(), torch.ones(15), atol=2e-3, rtol=0)


def test_the_point_itself_reaches_the_centre_alone():
    assert influence(torch.zeros(1, 3), kernel_points())[0].tolist() == [1.0] + [0.0] * 14


def test_influence_takes_no_gradient_and_keeps_its_digits_in_mixed_precision():
    offsets, kernel = draw(50, 3).requires_grad_(), kernel_points()
    full = influence(offsets, kernel)
    assert not full.requires_grad
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(influence(offsets, kernel), full)


def test_kpconv_agrees_with_the_slow_one():
    features, offsets, kernel = draw(7, 9, 5), draw(7, 9, 3, seed=1), kernel_points()
    valid = draw(7, 9, seed=2) > -0.5
    layer = KPConv(5, 4)
    influences = influence(offsets, kernel) * valid[..., None]
    expected = slow_kpconv(features, offsets, valid, kernel, layer.weight.detach().unflatten(1, (5, 15)))
    torch.testing.assert_close(layer(features, influences).double(), expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize("inputs", [4, 8, 64])
def test_a_new_layer_keeps_the_size_of_features(inputs: int):
    """With neighbours as on a flat grid of half the radius."""
    grid = torch.tensor([[x / 2, y / 2, 0.0] for y in (-1, 0, 1) for x in (-1, 0, 1)])
    torch.manual_seed(0)
    features = torch.randn(500, 9, inputs)
    size = KPConv(inputs, 64)(features, influence(grid, kernel_points()).expand(500, 9, 15)).std()
    assert 0.5 < size < 2


def test_one_at_the_centre_and_the_others_on_a_shell():
    points = kernel_points()
    assert points.shape == (15, 3)
    assert points[0].tolist() == [0, 0, 0]
    torch.testing.assert_close(points[1:].norm(dim=-1), torch.full((14,), SHELL))


def test_near_evenly_spread_and_balanced():
    """The disposition of Thomas et al. has its nearest neighbours at 0.589 to 0.654 of the radius."""
    points = kernel_points().double()
    nearest = (torch.cdist(points, points) + 9 * torch.eye(15)).amin(dim=-1)
    assert nearest.min() > 0.58
    assert nearest.max() < 0.69
    torch.testing.assert_close(points.mean(dim=0), torch.zeros(3, dtype=torch.float64), atol=1e-6, rtol=0)


@pytest.mark.parametrize(("count", "energy"), [(15, 69.306363297), (13, 49.165253058), (25, 223.347074052)])
def test_the_energy_is_the_least_known(count: int, energy: float):
    """Least energies of charges on the unit sphere are known (Thomson's problem)."""
    directions = kernel_points(count)[1:].double() / SHELL
    inverse = torch.pdist(directions).reciprocal().sum()
    assert float(inverse) == pytest.approx(energy, rel=1e-6)


def test_the_same_every_time_and_not_shared():
    first = kernel_points()
    kept = first.clone()
    first.zero_()
    assert torch.equal(kernel_points(), kept)
