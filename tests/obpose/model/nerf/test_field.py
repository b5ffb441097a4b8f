import math

import pytest
import torch

from obpose.config import FieldConfig
from obpose.model.nerf.field import Field, positional_encoding
from tests.obpose.analytic_fields import SMALL


def some(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def test_the_encoding_has_a_sine_and_a_cosine_of_every_octave():
    points = torch.rand(50, 3, dtype=torch.float64) * 2 - 1
    expected = [f(2**i * math.pi * points) for f in (torch.sin, torch.cos) for i in range(6)]
    encoded = positional_encoding(points, 6)
    assert encoded.shape == (50, 36)
    in_turn = torch.stack(expected, dim=-1).flatten(1)
    torch.testing.assert_close(encoded, in_turn)


def test_the_encoding_is_precise_at_the_authors_ten_octaves():
    points = torch.rand(1000, 3) * 2 - 1
    error = positional_encoding(points, 10).double() - positional_encoding(points.double(), 10)
    assert error.abs().max() < 2e-4


def test_points_under_one_code_are_as_points_with_codes_of_their_own():
    field, codes, points, directions = Field(SMALL, 5), some(2, 3, 5), some(2, 3, 7, 3), some(2, 3, 7, 3, seed=1)
    shared = field.condition(codes).of_all_points()
    logits, hidden = field.density(points, shared)
    colours = field.colour(hidden, directions, shared)
    owner = torch.arange(6).repeat_interleave(7)
    own = field.condition(codes.flatten(0, 1)).at(owner)
    flat_logits, flat_hidden = field.density(points.flatten(0, 2), own)
    torch.testing.assert_close(logits.flatten(), flat_logits)
    torch.testing.assert_close(colours.flatten(0, 2), field.colour(flat_hidden, directions.flatten(0, 2), own))


@pytest.mark.parametrize("depth", [2, 3, 4, 8])
def test_every_weight_is_used(depth: int):
    field = Field(FieldConfig(16, depth, 2, 1), 5)
    codes = field.condition(some(4, 5))
    logits, hidden = field.density(some(4, 3), codes)
    (logits.sum() + field.colour(hidden, some(4, 3), codes).sum()).backward()
    assert all(weight.grad is not None and weight.grad.abs().sum() > 0 for weight in field.parameters())


def test_the_point_and_the_latent_enter_again_after_the_middle():
    field, points, codes = Field(SMALL, 5), some(4, 3), some(4, 5)
    with torch.no_grad():
        field.first.weight.zero_()
    assert field.density(points, field.condition(codes))[0].std() > 0
    assert field.density(points[:1].expand(4, 3), field.condition(codes))[0].std() > 0


def test_the_latent_adds_to_three_layers():
    field, points = Field(SMALL, 5), some(4, 3)
    added = field.condition(some(4, 5))
    logits, hidden = field.density(points, added)
    total = logits.sum() + field.colour(hidden, points, added).sum()
    for gradient in torch.autograd.grad(total, (added.first, added.again, added.colour)):
        assert (gradient != 0).any(dim=-1).all()


def test_colours_depend_on_where_they_are_seen_from_and_are_between_0_and_1():
    field, points, codes = Field(SMALL, 5), some(1, 3).expand(9, 3), some(1, 5)
    shared = field.condition(codes)
    _, hidden = field.density(points, shared)
    colours = field.colour(hidden, some(9, 3), shared)
    assert (colours.std(dim=0) > 0).all()
    assert ((colours > 0) & (colours < 1)).all()


def test_plain_weights_leave_codes_as_pytorch_draws_them():
    for weights, orthogonal in (("orthogonal", True), ("uniform", False)):
        codes = Field(SMALL, 5, weights).codes.weight
        assert torch.allclose(codes.T @ codes, torch.eye(5), atol=1e-4) == orthogonal
