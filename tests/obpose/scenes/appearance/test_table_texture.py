import torch

from obpose.scenes.appearance.table_texture import (
    EDGE,
    PATCH,
    no_texture,
    on_texture,
    patch_of,
    texture_at,
    texture_like,
)
from tests.obpose.scenes.small_scenes import some_model


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def ramp() -> torch.Tensor:
    """Texture that is linear in x and y, -1..1, for two of the colours."""
    steps = torch.linspace(-1, 1, EDGE)
    x, y = torch.meshgrid(steps, steps, indexing="ij")
    return torch.stack([x, 2 * y, torch.ones_like(x)], dim=-1)


def test_it_lies_on_the_table_and_goes_on_beyond_the_workspace():
    model = some_model()
    middle, half = model.center, model.config.model.workspace_size / 2
    points = torch.tensor([[0.0, 0.0, 0.0], [0.5, -0.25, 0.02], [1.0, 1.0, -0.02], [0.0, 0.0, 0.05], [1.01, 0.0, 0.0]])
    points[:, :2] = middle[:2] + half * points[:, :2]
    found = texture_at(model, ramp(), points)
    expected = [[0.0, 0.0, 1.0], [0.5, -0.5, 1.0], [1.0, 2.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 1.0]]
    torch.testing.assert_close(found, torch.tensor(expected), atol=1e-5, rtol=0)
    places, on_table = on_texture(model, points)
    torch.testing.assert_close(places[1], torch.tensor([0.5, -0.25]))
    assert on_table.tolist() == [True, True, True, False, False]
    assert not texture_at(model, no_texture(), points).any()


def test_a_spot_is_the_middle_of_a_pattern():
    patch = patch_of(ramp())
    assert patch.shape == (PATCH, PATCH, 3)
    torch.testing.assert_close(patch[..., 0].mean(), torch.tensor(0.0), atol=1e-6, rtol=0)
    torch.testing.assert_close(patch[-1, 0, 0], torch.tensor(63 / 127))


def test_a_pattern_is_like_its_spot():
    """Stripes across x, of two colours that are opposite: so are those that are drawn, as strong and as wide."""
    stripes = torch.sin(torch.arange(PATCH) * 2 * torch.pi / 8)[:, None].expand(PATCH, PATCH)
    patch = 5 + torch.stack([stripes, -stripes, 0 * stripes], dim=-1)
    drawn = torch.stack([texture_like(patch, seeded(seed)) for seed in range(8)])
    assert drawn.shape == (8, EDGE, EDGE, 3)
    assert 0.6 < drawn[..., 0].std() / patch[..., 0].std() < 1.6
    assert drawn.mean().abs() < 0.05
    torch.testing.assert_close(drawn[..., 0], -drawn[..., 1], atol=1e-5, rtol=0)
    assert drawn[..., 2].abs().max() < 1e-5
    along, across = (drawn[..., 0].diff(dim=axis).std() for axis in (2, 1))
    assert along < 0.2 * across
    power = torch.fft.rfft(drawn[..., 0], dim=1).abs().square().mean(dim=(0, 2))
    assert abs(int(power.argmax()) - EDGE // 8) <= 1


def test_what_changes_slowly_or_sticks_out_is_not_taken_for_the_pattern():
    stripes = 0.1 * torch.sin(torch.arange(PATCH) * 2 * torch.pi / 8)[:, None, None].expand(PATCH, PATCH, 3)
    glow = 0.3 * torch.linspace(-1, 1, PATCH)[:, None, None] ** 2
    stain = torch.zeros(PATCH, PATCH, 3)
    stain[20:24, 30:34] = -2.0
    plain, odd = (texture_like(patch, seeded(0)) for patch in (stripes, stripes + glow + stain))
    assert (texture_like(glow + stain, seeded(0))).std() < 0.5 * plain.std()
    assert (odd - plain).std() < 0.5 * plain.std()
