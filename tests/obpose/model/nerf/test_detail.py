import numpy as np
import pytest
import torch
from scipy.interpolate import RegularGridInterpolator

from obpose.model.nerf.compose import OUTSIDE
from obpose.model.nerf.detail import EDGE, Detail, no_detail, roughness
from obpose.model.nerf.field import Field
from tests.obpose.analytic_fields import SMALL


def some(things: int = 1, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(no_detail(things, torch.zeros(())).shape, generator=generator, dtype=torch.float64)


def points(count: int, seed: int = 1) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, 3, generator=generator, dtype=torch.float64) * 2 - 1


def of(lattices: torch.Tensor, at: torch.Tensor) -> torch.Tensor:
    return Detail(lattices, torch.tensor(0)).of(at)


def test_between_points_of_the_lattice_it_is_trilinear():
    steps, lattices, at = np.linspace(-1, 1, EDGE), some(), points(200)
    expected = RegularGridInterpolator((steps, steps, steps), lattices[0].numpy())(at.numpy())
    np.testing.assert_allclose(of(lattices, at).numpy(), expected, atol=1e-12)


def test_at_the_corners_it_is_the_lattice_and_beyond_the_faces_as_at_them():
    lattices, ends = some(), torch.tensor([-1.0, 1.0], dtype=torch.float64)
    corners = torch.cartesian_prod(ends, ends, ends)
    places = ((corners + 1) / 2 * (EDGE - 1)).long()
    torch.testing.assert_close(of(lattices, corners), lattices[0][tuple(places.T)])
    torch.testing.assert_close(of(lattices, 1.3 * corners), of(lattices, corners))


def test_each_point_has_the_corrections_of_its_owner():
    lattices, at, owner = some(3), points(30), torch.arange(30) % 3
    mixed = Detail(lattices, torch.arange(3)).at(owner).of(at)
    for thing in range(3):
        mine = owner == thing
        torch.testing.assert_close(mixed[mine], of(lattices[thing, None], at[mine]))


def test_points_and_lattices_have_gradients():
    lattices, at = some(2).requires_grad_(), points(5).requires_grad_()
    owner = torch.tensor([0, 1, 1, 0, 1])
    assert torch.autograd.gradcheck(lambda a: Detail(lattices, owner).of(a), (at,))
    of(lattices, at).sum().backward()
    assert lattices.grad is not None
    assert lattices.grad[0].any()
    assert not lattices.grad[1].any()


def test_roughness_is_minus_the_log_of_gaussians_but_for_a_constant():
    def log_prior(values: torch.Tensor) -> torch.Tensor:
        step, size = (torch.distributions.Normal(0.0, std) for std in (0.7, 3.0))
        steps = [step.log_prob(values.diff(dim=axis)).sum() for axis in (1, 2, 3)]
        return sum(steps) + size.log_prob(values).sum()

    one, other = some(2), some(2, seed=5)
    found = [roughness(values, neighbours=0.7, size=3.0) for values in (one, other)]
    torch.testing.assert_close(found[0] - found[1], log_prior(other) - log_prior(one))
    assert roughness(no_detail(2, one), neighbours=0.7, size=3.0) == 0


@pytest.mark.parametrize("shared", [True, False])
def test_corrections_are_added_to_the_logits_of_density_and_colour(shared: bool):
    torch.manual_seed(0)
    field, at, directions = Field(SMALL, 5).double(), points(40), points(40, seed=3)
    code = torch.randn(5, dtype=torch.float64)
    lattices = no_detail(1, code) + torch.tensor([2.0, 1.0, 0.0, -1.0], dtype=torch.float64)
    plain = field.condition(code) if shared else field.condition(code[None]).at(torch.zeros(40, dtype=torch.long))
    owner = torch.zeros(() if shared else 40, dtype=torch.long)
    corrected = plain.corrected(Detail(lattices, owner))
    (logits, hidden), (more, changed) = field.density(at, plain), field.density(at, corrected)
    torch.testing.assert_close(more, logits + 2)
    colours = field.colour(hidden, directions, plain)
    expected = torch.sigmoid(torch.logit(colours) + torch.tensor([1.0, 0.0, -1.0], dtype=torch.float64))
    torch.testing.assert_close(field.colour(changed, directions, corrected), expected)


def test_without_corrections_a_field_is_what_it_was():
    torch.manual_seed(0)
    field, at = Field(SMALL, 5), points(10).float()
    codes = field.condition(torch.randn(5))
    zero = codes.corrected(Detail(no_detail(1, at), torch.tensor(0)))
    (logits, hidden), (same, corrected) = field.density(at, codes), field.density(at, zero)
    assert torch.equal(logits, same)
    assert hidden.correction is None
    assert torch.equal(field.colour(hidden, at, codes), field.colour(corrected, at, zero))


def test_a_lattice_alone_is_a_smaller_cube_around_the_middle_and_nothing_beyond():
    lattices, at, edge = some(2), points(200), torch.tensor([0.4, 0.0], dtype=torch.float64)
    found = Detail(lattices, torch.tensor(0), edge).of(at)
    inside = at.abs().amax(dim=-1) <= 0.4
    assert 0 < inside.sum() < 100
    torch.testing.assert_close(found[inside], of(lattices, at[inside] / 0.4))
    assert (found[~inside, 0] == OUTSIDE).all()
    torch.testing.assert_close(found[~inside, 1:], of(lattices, at[~inside] / 0.4)[:, 1:])
    torch.testing.assert_close(Detail(lattices, torch.tensor(1), edge).of(at), of(lattices[1:], at))


def test_where_a_lattice_is_alone_the_field_does_not_matter():
    torch.manual_seed(0)
    field, at, code = Field(SMALL, 5).double(), points(40), torch.randn(2, 5, dtype=torch.float64)
    lattices, owner = some(2), torch.arange(40) % 2
    detail = Detail(lattices, torch.arange(2), torch.tensor([1.0, 0.0], dtype=torch.float64))
    plain, codes = field.condition(code).at(owner), field.condition(code).corrected(detail).at(owner)
    (logits, hidden), (own, _) = field.density(at, codes), field.density(at, plain)
    added = Detail(lattices, torch.arange(2)).at(owner).of(at)
    alone = owner == 0
    torch.testing.assert_close(logits, added[:, 0] + torch.where(alone, 0.0, own))
    colours = torch.logit(field.colour(hidden, at, codes))
    torch.testing.assert_close(colours[alone], added[alone, 1:])
    assert not torch.allclose(colours[~alone], added[~alone, 1:], atol=1e-3)
