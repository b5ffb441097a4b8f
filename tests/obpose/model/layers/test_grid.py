import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from obpose.model.layers.grid import Grid, all_places, on_grid, subsample, upsample, windows
from obpose.model.layers.kpconv import KPConv, influence, kernel_points

RADIUS = 0.03


def rough_table(images: int = 2, height: int = 7, width: int = 6, *, holes: float = 0.2, seed: int = 0) -> Grid:
    """Points 1.5 cm apart, uneven by 2 cm; `holes` is the share that is not valid."""
    generator = torch.Generator().manual_seed(seed)
    y, x = torch.meshgrid(0.015 * torch.arange(height), 0.015 * torch.arange(width), indexing="ij")
    z = 0.02 * torch.rand((images, height, width), generator=generator)
    valid = torch.rand(z.shape, generator=generator) >= holes
    points = torch.stack([x.expand_as(z), y.expand_as(z), z], dim=-1)
    return Grid(points * valid[..., None], valid)


def convolve(grid: Grid, features: Tensor, layer: KPConv, radius: float = RADIUS) -> Tensor:
    around = windows(grid, all_places(grid), radius=radius, kernel=kernel_points())
    flat = features.flatten(0, 2)
    return on_grid(layer(around.gather(flat), around.influences), grid)


def slow_window(grid: Grid, features: Tensor, layer: KPConv, image: int, y: int, x: int) -> Tensor:
    """One point's KPConv over its window, neighbour by neighbour."""
    total = torch.zeros(layer.weight.shape[0])
    height, width = grid.valid.shape[1:]
    for row in range(max(0, y - 1), min(height, y + 2)):
        for column in range(max(0, x - 1), min(width, x + 2)):
            if grid.valid[image, row, column]:
                offset = (grid.points[image, row, column] - grid.points[image, y, x]) / RADIUS
                weights = influence(offset[None], kernel_points())
                total += layer(features[image, row, column][None, None], weights[None])[0]
    return total


def noise(grid: Grid, channels: int, *, seed: int = 0) -> Tensor:
    return torch.randn((*grid.valid.shape, channels), generator=torch.Generator().manual_seed(seed))


@torch.no_grad()
def test_windows_are_the_valid_neighbours_within_the_border():
    grid, layer = rough_table(), KPConv(3, 4)
    features = noise(grid, 3)
    found = convolve(grid, features, layer)
    for image, y, x in grid.valid.nonzero().tolist():
        torch.testing.assert_close(
            found[image, y, x], slow_window(grid, features, layer, image, y, x), atol=2e-3, rtol=1e-3
        )


@torch.no_grad()
def test_scaling_cloud_and_radius_together_changes_nothing():
    grid, layer = rough_table(), KPConv(3, 4)
    features = noise(grid, 3)
    larger = convolve(Grid(3 * grid.points, grid.valid), features, layer, radius=3 * RADIUS)
    torch.testing.assert_close(larger, convolve(grid, features, layer), atol=2e-3, rtol=0)


@torch.no_grad()
def test_neighbours_out_of_reach_do_not_count():
    """A point of an object far in front of the table behind it."""
    grid, layer = rough_table(holes=0.0), KPConv(3, 4)
    grid.points[0, 3, 3, 2] += 1
    features = noise(grid, 3)
    before = convolve(grid, features, layer)
    features[0, 3, 3] += 100
    changed = (convolve(grid, features, layer) != before).any(dim=-1)
    assert changed.nonzero().tolist() == [[0, 3, 3]]


def test_windows_of_some_points_are_theirs_among_all():
    grid = rough_table()
    some = torch.tensor([3, 41, 7, 80])
    every = windows(grid, all_places(grid), radius=RADIUS, kernel=kernel_points()).at(some)
    found = windows(grid, some, radius=RADIUS, kernel=kernel_points())
    assert torch.equal(found.neighbours, every.neighbours)
    assert torch.equal(found.influences, every.influences)


@pytest.mark.parametrize(("height", "width"), [(8, 8), (7, 5), (1, 9)])
def test_subsampling_keeps_the_first_valid_point_of_each_cell(height: int, width: int):
    grid = rough_table(3, height, width, holes=0.6)
    coarse, kept = subsample(grid)
    assert coarse.valid.shape == (3, -(-height // 2), -(-width // 2))
    kept = kept.view(coarse.valid.shape)
    for image, row, column in torch.cartesian_prod(*map(torch.arange, coarse.valid.shape)).tolist():
        cell = grid.valid[image, 2 * row : 2 * row + 2, 2 * column : 2 * column + 2].nonzero().tolist()
        assert bool(coarse.valid[image, row, column]) == bool(cell)
        if cell:
            place = int(kept[image, row, column]) - image * height * width
            assert [place // width - 2 * row, place % width - 2 * column] == cell[0]
            assert torch.equal(coarse.points[image, row, column], grid.points.view(-1, 3)[kept[image, row, column]])


@pytest.mark.parametrize(("height", "width"), [(8, 8), (7, 5), (1, 1)])
def test_upsampling_without_holes_is_bilinear(height: int, width: int):
    fine = rough_table(2, height, width, holes=0.0)
    coarse, _ = subsample(fine)
    features = noise(coarse, 3)
    expected = F.interpolate(features.movedim(-1, 1), scale_factor=2, mode="bilinear").movedim(1, -1)
    found = upsample(features, coarse.valid, like=fine)
    torch.testing.assert_close(found, expected[:, :height, :width])


def test_upsampling_leaves_out_what_is_not_valid():
    fine = rough_table(2, 12, 9, holes=0.0)
    coarse = rough_table(2, 6, 5, holes=0.3)
    features = torch.where(coarse.valid[..., None], 7.0, 1e4)
    found = upsample(features, coarse.valid, like=fine)
    assert torch.equal(found > 0, (found - 7).abs() < 1e-4)
    assert (found[:, ::2, ::2][coarse.valid] > 0).all()


def test_upsampling_of_nothing_is_zero():
    fine = rough_table(1, 4, 4)
    nothing = torch.zeros(1, 2, 2, dtype=torch.bool)
    assert torch.equal(upsample(torch.ones(1, 2, 2, 3), nothing, like=fine), torch.zeros(1, 4, 4, 3))
