from dataclasses import replace

import pytest
import torch

from obpose.contact.config import SMOOTHED
from obpose.data.clean_depth import clean_depth, depth_noise, fill_holes, inverse_depth_noise, smooth_depth
from obpose.types import Observation

NOISE = 0.002
"""Standard deviation of inverse depth, 1/m."""


def tilted_plane(edge: float = 0.0) -> torch.Tensor:
    """Inverse depth of a plane, linear in the image, with a jump of `edge` in its middle."""
    rows, columns = torch.meshgrid(torch.arange(48.0), torch.arange(64.0), indexing="ij")
    return 0.9 + 0.004 * rows - 0.002 * columns + edge * (columns >= 32)


def observed(inverse: torch.Tensor, noise: float = NOISE, clips: int = 1, holes: float = 0.0) -> Observation:
    """Clips of two noisy frames of one view."""
    generator = torch.Generator().manual_seed(0)
    images = inverse + noise * torch.randn((clips, 2, 1, *inverse.shape), generator=generator)
    valid = torch.rand(images.shape, generator=generator) >= holes
    return Observation(
        rgb=torch.zeros(*images.shape, 3),
        depth=torch.where(valid, 1 / images, 0),
        valid=valid,
        k=torch.eye(3).expand(clips, 1, 3, 3),
        world_from_camera=torch.eye(4).expand(clips, 1, 4, 4),
    )


def smoothed_errors(noisy: Observation, inverse: torch.Tensor) -> torch.Tensor:
    """Errors of inverse depth inside of the images after smoothing; nan where there is no depth."""
    depth = smooth_depth(noisy.depth, noisy.valid, torch.full((1, 1, 1), NOISE))
    return torch.where(noisy.valid, 1 / depth - inverse, torch.nan)[..., 1:-1, 1:-1]


@pytest.mark.parametrize(("edge", "holes"), [(0.0, 0.0), (0.3, 0.0), (0.0, 0.4)])
def test_noise_is_measured_whatever_the_edges_and_holes(edge: float, holes: float):
    noisy = observed(tilted_plane(edge), holes=holes)
    assert float(inverse_depth_noise(noisy.depth, noisy.valid)) == pytest.approx(NOISE, rel=0.1)


def test_noise_of_depth_is_that_at_the_median_depth():
    clips = observed(tilted_plane(), clips=2)
    one_exact = replace(clips, depth=torch.stack([clips.depth[0], (1 / tilted_plane()).expand(2, 1, 48, 64)]))
    noisy, exact = depth_noise(one_exact).tolist()
    assert noisy == pytest.approx(NOISE / tilted_plane().median().item() ** 2, rel=0.1)
    assert exact == 0
    nothing = replace(clips, valid=torch.zeros_like(clips.valid), depth=torch.zeros_like(clips.depth))
    assert depth_noise(nothing).tolist() == [0, 0]


def test_images_without_three_pixels_in_a_row_have_no_noise():
    assert inverse_depth_noise(torch.ones(2, 2), torch.ones(2, 2, dtype=torch.bool)) == 0


def test_exact_depth_without_holes_is_left_as_it_is():
    exact = observed(tilted_plane(), noise=1e-4)
    assert clean_depth(exact) is exact


def test_clips_have_noise_of_their_own():
    both = observed(tilted_plane(), clips=2)
    one_exact = replace(both, depth=torch.stack([(1 / tilted_plane()).expand(2, 1, 48, 64), both.depth[1]]))
    cleaned = clean_depth(one_exact)
    assert torch.equal(cleaned.depth[0], one_exact.depth[0])
    torch.testing.assert_close(cleaned.depth[1], clean_depth(both).depth[1])
    assert not torch.equal(cleaned.depth[1], both.depth[1])


def test_noise_of_planes_falls_to_about_a_third_without_bias():
    errors = smoothed_errors(observed(tilted_plane()), tilted_plane())
    assert errors.std() == pytest.approx(NOISE / SMOOTHED, rel=0.15)
    assert errors.mean().abs() < 0.02 * NOISE


def test_edges_are_not_blurred():
    """Where the depth jumps by 20 standard deviations, errors are hardly larger than elsewhere."""
    inverse = tilted_plane(edge=20 * NOISE)
    along = smoothed_errors(observed(inverse), inverse)[..., 29:33]
    assert along.mean(dim=(0, 1, 2, 3)).abs().max() < 0.2 * NOISE
    assert along.std(dim=(0, 1, 2, 3)).max() < 0.8 * NOISE


def test_pixels_without_depth_do_not_pull_their_neighbours():
    errors = smoothed_errors(observed(tilted_plane(), holes=0.4), tilted_plane())
    known = errors[~errors.isnan()]
    assert known.mean().abs() < 0.05 * NOISE
    assert known.std() < 0.8 * NOISE


def test_holes_take_the_depth_of_the_neighbour_of_similar_colour():
    depth, rgb = torch.ones(5, 8), torch.zeros(5, 8, 3)
    depth[:, 4:], rgb[:, 4:] = 2.0, 1.0
    valid = torch.ones(5, 8, dtype=torch.bool)
    valid[:, 3:5] = False
    filled = fill_holes(depth, valid, rgb)
    assert torch.equal(filled, depth)
    # Pixels without a neighbour with depth stay holes.
    valid[:, 2:6] = False
    filled = fill_holes(depth, valid, rgb)
    assert torch.equal(filled == 0, torch.tensor([False, False, False, True, True, False, False, False]).expand(5, 8))


def test_filled_pixels_are_valid_and_others_keep_their_depth():
    holed = observed(tilted_plane(), noise=0.0, holes=0.3)
    cleaned = clean_depth(holed)
    assert torch.equal(cleaned.depth[holed.valid], holed.depth[holed.valid])
    assert torch.equal(cleaned.valid, cleaned.depth > 0)
    assert cleaned.valid.float().mean() > 0.99
