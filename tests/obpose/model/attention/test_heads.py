import pytest
import torch

from obpose.config import AttentionConfig, LatentConfig, ModelConfig
from obpose.model.attention.heads import HeadOutputs, Heads
from obpose.model.backbone import EMBEDDING

CENTER = torch.tensor([0.1, -0.2, 0.3])


def _heads(semi_convolution: float = 8.0, semi_colour: float = 0.3) -> Heads:
    torch.manual_seed(0)
    return Heads(
        ModelConfig(
            attention=AttentionConfig(semi_convolution=semi_convolution, semi_colour=semi_colour),
            latent=LatentConfig(colours="none"),
        )
    )


def _points() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    points, rgb = torch.randn((2, 2, 3, 20, 3), generator=generator)
    valid = torch.rand((2, 3, 20), generator=generator) < 0.8
    return points, valid, rgb, torch.randn((2, 3, 20, EMBEDDING), generator=generator)


def _assert_close(one: HeadOutputs, other: HeadOutputs) -> None:
    for a, b in zip(one, other, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-5)


def _equal(one: torch.Tensor | None, other: torch.Tensor | None) -> bool:
    return one is not None and other is not None and torch.equal(one, other)


def test_moving_points_and_workspace_together_changes_nothing():
    points, valid, rgb, embedding = _points()
    shift = torch.tensor([5.0, -7.0, 2.0])
    heads = _heads()
    here = heads(points, valid, rgb, embedding, center=CENTER)
    _assert_close(here, heads(points + shift, valid, rgb, embedding, center=CENTER + shift))


def test_semi_convolution_adds_the_scaled_position_to_three_channels_and_touches_nothing_else():
    points, valid, rgb, embedding = _points()
    with_it = _heads(8.0)(points, valid, rgb, embedding, center=CENTER)
    without = _heads(0.0)(points, valid, rgb, embedding, center=CENTER)
    added = with_it.colour - without.colour
    expected = 8.0 * (points - CENTER) * valid[..., None]
    torch.testing.assert_close(added[..., :3], expected, rtol=1e-5, atol=1e-5)
    assert added[..., 3:].eq(0).all()
    assert _equal(with_it.log_prescope, without.log_prescope)
    assert torch.equal(with_it.features, without.features)


def test_semi_colour_adds_the_scaled_colour_to_the_next_three_channels_and_touches_nothing_else():
    points, valid, rgb, embedding = _points()
    with_it = _heads()(points, valid, rgb, embedding, center=CENTER)
    without = _heads(semi_colour=0.0)(points, valid, rgb, embedding, center=CENTER)
    added = with_it.colour - without.colour
    torch.testing.assert_close(added[..., 3:6], 0.3 * rgb, rtol=1e-5, atol=1e-5)
    assert added[..., :3].eq(0).all()
    assert added[..., 6:].eq(0).all()
    assert _equal(with_it.log_prescope, without.log_prescope)


def test_position_enters_the_colour_embedding_also_without_semi_convolution():
    points, valid, rgb, embedding = _points()
    heads = _heads(0.0)
    here, there = (heads(p, valid, rgb, embedding, center=CENTER) for p in (points, points + 1))
    assert (here.colour - there.colour)[valid].abs().amax(dim=-1).min() > 1e-3
    assert torch.equal(here.features, there.features)


def test_each_point_speaks_for_itself():
    points, valid, rgb, embedding = _points()
    heads = _heads()
    order = torch.randperm(20, generator=torch.Generator().manual_seed(2))
    shuffled = heads(points[:, :, order], valid[:, :, order], rgb[:, :, order], embedding[:, :, order], center=CENTER)
    plain = heads(points, valid, rgb, embedding, center=CENTER)
    assert plain.log_prescope is not None
    ordered = plain.colour[:, :, order], plain.features[:, :, order], plain.log_prescope[:, :, order]
    _assert_close(HeadOutputs(*ordered), shuffled)


@pytest.mark.parametrize("scale", [1.0, 1e4])
def test_prescope_sums_to_one_and_stays_finite(scale: float):
    points, valid, rgb, embedding = _points()
    embedding.requires_grad_()
    log_prescope = _heads()(points, valid, rgb, scale * embedding, center=CENTER).log_prescope
    assert log_prescope is not None
    (gradient,) = torch.autograd.grad(log_prescope.sum(), embedding)
    torch.testing.assert_close(log_prescope.exp().sum(dim=-1), torch.ones(2, 3, 20))
    assert log_prescope.isfinite().all()
    assert gradient.isfinite().all()


def test_heads_that_nobody_reads_are_not_there():
    points, valid, rgb, embedding = _points()
    for kind, background, colours, has_prescope in (
        ("icsbp", "component", 8, True),
        ("icsbp", "none", 8, False),
        ("slots", "component", 0, False),
    ):
        heads = Heads(ModelConfig(attention=AttentionConfig(kind=kind), background=background))
        found = heads(points, valid, rgb, embedding, center=CENTER)
        assert found.colour.shape[-1] == colours
        assert (found.log_prescope is not None) == has_prescope
        assert any(name.startswith("prescope") for name in heads.state_dict()) == has_prescope
