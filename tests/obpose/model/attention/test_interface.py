import torch

from obpose.model.attention.interface import mean_under, not_largest


def test_it_is_the_mean_of_the_valid_points_weighted_by_the_mask():
    generator = torch.Generator().manual_seed(0)
    masks, values = torch.rand(2, 3, 4, 10, generator=generator), torch.randn(2, 3, 10, 5, generator=generator)
    valid = torch.rand(2, 3, 10, generator=generator) < 0.7
    found = mean_under(masks.log(), valid, values.masked_fill(~valid[..., None], torch.nan))
    chosen, weight = values[1, 2][valid[1, 2]], masks[1, 2, 3][valid[1, 2]]
    torch.testing.assert_close(found[1, 2, 3], (chosen * weight[:, None]).sum(dim=0) / weight.sum())


def test_masks_get_a_gradient_and_nothing_valid_is_zero():
    log_masks = torch.rand(1, 1, 2, 6).log().requires_grad_()
    mean_under(log_masks, torch.ones(1, 1, 6, dtype=torch.bool), torch.randn(1, 1, 6, 3)).sum().backward()
    assert log_masks.grad is not None
    assert log_masks.grad.abs().sum() > 0
    assert (mean_under(log_masks, torch.zeros(1, 1, 6, dtype=torch.bool), torch.randn(1, 1, 6, 3)) == 0).all()


def test_objects_are_where_the_largest_component_of_the_whole_clip_is_not():
    # In the first frame the second component is larger, in both together the third.
    first = [[0.0, 0.0, 0.0, 0.0], [1.0, 0.9, 0.8, 0.0], [0.0, 0.1, 0.2, 1.0]]
    second = [[0.0, 0.2, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [1.0, 0.8, 1.0, 1.0]]
    other_clip = [[0.7, 0.7, 0.7, 0.7], [0.3, 0.3, 0.3, 0.3], [0.0, 0.0, 0.0, 0.0]]
    masks = torch.tensor([[first, second], [other_clip, other_clip]])
    expected = [[[1.0, 0.9, 0.8, 0.0], [0.0, 0.2, 0.0, 0.0]], [[0.3] * 4, [0.3] * 4]]
    torch.testing.assert_close(not_largest(masks.log()), torch.tensor(expected))
