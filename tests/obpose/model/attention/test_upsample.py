import math

import pytest
import torch
from torch.nn.functional import interpolate

from obpose.model.attention.upsample import masks_at

COMPONENTS = 5


def _masks(
    *, grid: tuple[int, int, int], batch: int = 2, frames: int = 3, valid_share: float = 0.8, scale: float = 3.0
):
    generator = torch.Generator().manual_seed(0)
    points = math.prod(grid)
    logits = scale * torch.randn((batch, frames, COMPONENTS + 1, points), generator=generator)
    valid = torch.rand((batch, frames, points), generator=generator) < valid_share
    return logits.log_softmax(dim=2), valid


def _every_pixel(*, views: int, size: tuple[int, int], batch: int = 2, frames: int = 3) -> torch.Tensor:
    return torch.arange(views * math.prod(size)).expand(batch, frames, -1)


@pytest.mark.parametrize(("grid", "size"), [((1, 8, 8), (16, 16)), ((1, 6, 10), (24, 40)), ((1, 5, 7), (5, 7))])
def test_agrees_with_bilinear_interpolation_where_all_cells_are_valid(
    grid: tuple[int, int, int], size: tuple[int, int]
):
    log_masks, valid = _masks(grid=grid, valid_share=2.0)
    found = masks_at(log_masks, valid, _every_pixel(views=1, size=size), grid=grid, size=size)
    cells = log_masks.exp().reshape(6, COMPONENTS + 1, *grid[1:])
    expected = interpolate(cells, size=size, mode="bilinear", align_corners=False)
    torch.testing.assert_close(found.exp(), expected.reshape(found.shape), rtol=0, atol=1e-5)


@pytest.mark.parametrize("valid_share", [2.0, 0.7, 0.2, -1.0])
def test_masks_and_scope_still_sum_to_one(valid_share: float):
    grid, size = (2, 8, 8), (15, 16)
    log_masks, valid = _masks(grid=grid, valid_share=valid_share)
    found = masks_at(log_masks, valid, _every_pixel(views=2, size=size), grid=grid, size=size)
    torch.testing.assert_close(found.exp().sum(dim=2), torch.ones(2, 3, 480), rtol=0, atol=1e-5)


def test_a_cell_at_the_end_that_sticks_out_does_not_stretch_the_others():
    # 5 x 3 pixels in cells of 2: a plane over the pixels is met exactly between the middles of the cells.
    cell = 0.1 + 0.1 * (2 * torch.arange(3.0) + 0.5)[:, None].expand(3, 2)
    log_masks = torch.stack([cell, 1 - cell]).log().reshape(1, 1, 2, 6)
    index = _every_pixel(views=1, size=(5, 3), batch=1, frames=1)
    found = masks_at(log_masks, torch.ones(1, 1, 6, dtype=torch.bool), index, grid=(1, 3, 2), size=(5, 3))
    expected = 0.1 + 0.1 * torch.arange(5.0).clamp(min=0.5)[:, None].expand(5, 3)
    torch.testing.assert_close(found[0, 0, 0].exp(), expected.reshape(-1))


def test_each_view_is_looked_up_in_its_own_cells():
    log_masks, valid = _masks(grid=(3, 4, 5))
    index = _every_pixel(views=3, size=(8, 10))
    together = masks_at(log_masks, valid, index, grid=(3, 4, 5), size=(8, 10)).exp()
    for view in range(3):
        cells, pixels = slice(20 * view, 20 * (view + 1)), slice(80 * view, 80 * (view + 1))
        alone = masks_at(log_masks[..., cells], valid[..., cells], index[..., :80], grid=(1, 4, 5), size=(8, 10))
        torch.testing.assert_close(together[..., pixels], alone.exp(), rtol=0, atol=1e-5)


def test_only_the_pixels_asked_for_in_their_order():
    log_masks, valid = _masks(grid=(1, 4, 4))
    everything = masks_at(log_masks, valid, _every_pixel(views=1, size=(8, 8)), grid=(1, 4, 4), size=(8, 8))
    index = torch.randint(64, (2, 3, 10), generator=torch.Generator().manual_seed(1))
    found = masks_at(log_masks, valid, index, grid=(1, 4, 4), size=(8, 8))
    expected = everything.gather(-1, index[:, :, None].expand(-1, -1, COMPONENTS + 1, -1))
    torch.testing.assert_close(found, expected)


def test_what_cells_without_a_point_say_does_not_matter():
    log_masks, valid = _masks(grid=(1, 8, 8), valid_share=0.6)
    index = _every_pixel(views=1, size=(16, 16))
    nothing = torch.full((COMPONENTS + 1, 1), -1e4)
    nothing[0] = 0
    changed = torch.where(valid[:, :, None], log_masks, nothing)
    # Only pixels of valid cells: the others may have none around them.
    inside = valid.reshape(2, 3, 8, 8).repeat_interleave(2, dim=2).repeat_interleave(2, dim=3).reshape(2, 3, 1, 256)
    plain, other = (masks_at(masks, valid, index, grid=(1, 8, 8), size=(16, 16)) for masks in (log_masks, changed))
    torch.testing.assert_close(plain * inside, other * inside)


def test_a_pixel_of_a_valid_cell_among_invalid_ones_has_the_masks_of_the_cell():
    log_masks, valid = _masks(grid=(1, 4, 4), valid_share=-1)
    valid[..., 5] = True
    index = torch.tensor([18, 19, 26, 27]).expand(2, 3, -1)
    found = masks_at(log_masks, valid, index, grid=(1, 4, 4), size=(8, 8))
    torch.testing.assert_close(found, log_masks[..., 5:6].expand_as(found), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("scale", [3.0, 500.0])
def test_values_and_gradients_are_finite_however_small_the_masks(scale: float):
    log_masks, valid = _masks(grid=(1, 8, 8), scale=scale)
    log_masks.requires_grad_()
    index = _every_pixel(views=1, size=(16, 16))
    found = masks_at(log_masks, valid, index, grid=(1, 8, 8), size=(16, 16))
    (gradient,) = torch.autograd.grad(found.sum(), log_masks)
    assert found.isfinite().all()
    assert gradient.isfinite().all()
    assert gradient.count_nonzero() > 0


def test_gradient_in_log_space_is_the_share_of_each_corner():
    # One column of two cells: the second pixel of four is a quarter of the way to the second cell.
    log_masks = torch.tensor([[0.0, -30.0], [-50.0, -60.0]]).reshape(1, 1, 2, 2).requires_grad_()
    index, valid = torch.tensor([[[1]]]), torch.ones(1, 1, 2, dtype=torch.bool)
    found = masks_at(log_masks, valid, index, grid=(1, 2, 1), size=(4, 1))
    (gradient,) = torch.autograd.grad(found.sum(), log_masks)
    for component in range(2):
        corners = log_masks[0, 0, component].detach() + torch.tensor([0.75, 0.25]).log()
        torch.testing.assert_close(found[0, 0, component, 0], corners.logsumexp(dim=0))
        torch.testing.assert_close(gradient[0, 0, component], corners.softmax(dim=0))
