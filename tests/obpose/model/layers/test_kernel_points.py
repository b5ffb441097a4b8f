import pytest
import torch

from obpose.model.layers.kernel_points import SHELL, kernel_points


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
    """Of so many charges on the unit sphere (Thomson's problem)."""
    directions = kernel_points(count)[1:].double() / SHELL
    inverse = torch.pdist(directions).reciprocal().sum()
    assert float(inverse) == pytest.approx(energy, rel=1e-6)


def test_the_same_every_time_and_not_shared():
    first = kernel_points()
    first.zero_()
    assert kernel_points()[1:].abs().sum() > 0
