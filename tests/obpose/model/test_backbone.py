from typing import Literal

import pytest
import torch
from torch import Tensor

from obpose.config import BackboneConfig
from obpose.model.backbone import EMBEDDING, Backbone, BackboneOutput, standard_colours

SPACING = 0.015


def cloud(images: int, height: int, width: int, *, holes: float = 0.2, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Points 1.5 cm apart on an uneven table, colours, validity."""
    generator = torch.Generator().manual_seed(seed)
    y, x = torch.meshgrid(torch.arange(height) - height / 2, torch.arange(width) - width / 2, indexing="ij")
    z = 0.03 * torch.rand((images, height, width), generator=generator)
    points = torch.stack([SPACING * x.expand_as(z), SPACING * y.expand_as(z), z], dim=-1)
    valid = torch.rand(z.shape, generator=generator) >= holes
    return points * valid[..., None], torch.rand(points.shape, generator=generator), valid


def encode(backbone: Backbone, points: Tensor, rgb: Tensor, valid: Tensor, center: Tensor | None = None):
    center = torch.zeros(3) if center is None else center
    return backbone(points, rgb, valid, spacing=SPACING, center=center)


def difference(one: BackboneOutput, other: BackboneOutput) -> float:
    """Largest over the valid embeddings and the codes of the scenes."""
    assert torch.equal(one.valid, other.valid)
    embeddings = (one.embedding - other.embedding)[one.valid].abs().max()
    return float(torch.maximum(embeddings, (one.scene - other.scene).abs().max()))


@pytest.fixture(scope="module")
def backbone() -> Backbone:
    torch.manual_seed(0)
    return Backbone(BackboneConfig(), widths=(8, 16, 16, 16))


@pytest.mark.parametrize(("size", "grid"), [((64, 64), (32, 32)), ((80, 60), (40, 30)), ((61, 47), (31, 24))])
def test_any_size_of_image(size: tuple[int, int], grid: tuple[int, int]):
    backbone = Backbone(BackboneConfig(output_level=1), widths=(8, 16, 16, 16))
    out = encode(backbone, *cloud(1, *size))
    assert backbone.grid_size(*size) == grid
    assert out.points.shape == (1, *grid, 3)
    assert out.embedding.shape == (1, *grid, EMBEDDING)
    assert out.scene.shape == (1, backbone.scene_size)


def test_the_points_of_the_grid_are_of_those_observed(backbone: Backbone):
    points, rgb, valid = cloud(1, 16, 12)
    out = encode(backbone, points, rgb, valid)
    observed = {tuple(point) for point in points[valid].tolist()}
    assert all(tuple(point) in observed for point in out.points[out.valid].tolist())
    assert out.points[~out.valid].abs().sum() == 0


@torch.no_grad()
def test_moving_world_and_workspace_together_changes_nothing(backbone: Backbone):
    points, rgb, valid = cloud(1, 20, 17)
    valid[:, :, 8:] = False
    shift = torch.tensor([0.4, -0.2, 0.3])
    moved = encode(backbone, (points + shift) * valid[..., None], rgb, valid, center=shift)
    assert difference(encode(backbone, points, rgb, valid), moved) < 1e-3


@torch.no_grad()
def test_colour_and_shape_both_matter(backbone: Backbone):
    points, rgb, valid = cloud(1, 20, 17)
    plain = encode(backbone, points, rgb, valid)
    assert difference(plain, encode(backbone, points, rgb.flip(1), valid)) > 0.01
    flat = points * torch.tensor([1.0, 1.0, 0.0])
    assert difference(plain, encode(backbone, flat, rgb, valid)) > 0.01


def test_every_weight_matters_to_embedding_and_scene_as_it_should(backbone: Backbone):
    """The decoder starts at the deepest level; the authors' leaves it out. The scene's code needs no decoder."""
    out = encode(backbone, *cloud(2, 32, 32))
    for name, gradient in gradients(backbone, out.embedding).items():
        assert (gradient is not None and gradient.abs().max() > 0) != name.startswith("scene"), name
    for name, gradient in gradients(backbone, out.scene).items():
        assert (gradient is not None and gradient.abs().max() > 0) != name.startswith(("up", "head")), name


@torch.no_grad()
@pytest.mark.parametrize(("means", "hears"), [("given", True), ("none", False)])
def test_the_scenes_code_hears_of_what_is_far_from_the_middle_by_its_means_alone(
    means: Literal["given", "none"], hears: bool
):
    torch.manual_seed(0)
    backbone = Backbone(BackboneConfig(scene_means=means), widths=(8, 16, 16, 16))
    points, rgb, valid = cloud(1, 64, 64, holes=0.0)
    corner = rgb.clone()
    corner[:, :6, :6] = 1 - corner[:, :6, :6]
    one, other = (
        backbone(points, colours, valid, spacing=SPACING, center=torch.zeros(3), workspace_radius=0.15).scene
        for colours in (rgb, corner)
    )
    assert one.shape == (1, backbone.scene_size)
    assert (one.sub(other).abs().max() > 0) == hears


def gradients(backbone: Backbone, output: Tensor) -> dict[str, Tensor | None]:
    names, weights = zip(*backbone.named_parameters(), strict=True)
    mixed = (output * torch.randn(output.shape, generator=torch.Generator().manual_seed(0))).sum()
    return dict(zip(names, torch.autograd.grad(mixed, weights, allow_unused=True, retain_graph=True), strict=True))


def test_gradients_are_finite_even_of_an_image_without_points(backbone: Backbone):
    points, rgb, valid = cloud(3, 16, 16)
    valid[1] = False
    valid[2] = False
    valid[2, 5, 5] = True
    out = encode(backbone, points, rgb, valid)
    assert out.embedding.isfinite().all()
    assert not out.valid[1].any()
    (out.embedding.square().sum() + out.scene.square().sum()).backward()
    assert all(weight.grad is not None and weight.grad.isfinite().all() for weight in backbone.parameters())
    backbone.zero_grad()


def test_levels_without_blocks_and_with_two():
    backbone = Backbone(BackboneConfig(blocks=(0, 2, 0)), widths=(8, 16, 16))
    assert encode(backbone, *cloud(1, 16, 16)).embedding.shape == (1, 16, 16, 16)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_embeddings_are_those_of_the_points_that_the_output_level_has(level: int):
    backbone = Backbone(BackboneConfig(blocks=(0, 1, 1), output_level=level), widths=(8, 16, 16))
    points, rgb, valid = cloud(1, 12, 10)
    out = encode(backbone, points, rgb, valid)
    assert backbone.grid_size(12, 10) == tuple(out.valid.shape[1:])
    nearest = torch.cdist(out.points[out.valid], points[valid]).min(dim=-1)
    assert (nearest.values < 1e-4).all()
    torch.testing.assert_close(out.rgb[out.valid], standard_colours(rgb)[valid][nearest.indices])
