import math
from typing import Any

import pytest
import torch
from torch import Tensor

from obpose.geometry import unproject
from obpose.model.attention.interface import EXCLUDED
from obpose.model.build import build_obpose
from obpose.model.nerf.compose import OUTSIDE
from obpose.model.obpose import ObPose
from obpose.model.perception import posterior_masks
from obpose.types import Decoded, Masks
from obpose.variants import make_config
from tests.worlds.observations import labels_by_colour, table_scene

POINTS, COMPONENTS = 5, 3


def masks() -> Masks:
    active = torch.ones(1, COMPONENTS - 1, dtype=torch.bool)
    return Masks(torch.zeros(1, 1, COMPONENTS, POINTS), torch.zeros(1, 1, POINTS), active)


def posterior(logits: Tensor, likelihood: Tensor, valid: Tensor | None = None) -> Tensor:
    everywhere = torch.ones(1, 1, POINTS, dtype=torch.bool)
    return posterior_masks(masks(), logits, likelihood, everywhere if valid is None else valid).log_masks.exp()


def test_masks_sum_to_one_and_nothing_is_left_over():
    found = posterior_masks(
        masks(),
        torch.randn(1, 1, COMPONENTS, POINTS) * 10,
        -torch.rand(1, 1, COMPONENTS, POINTS) * 500,
        torch.ones(1, 1, POINTS, dtype=torch.bool),
    )
    torch.testing.assert_close(found.log_masks.exp().sum(dim=2), torch.ones(1, 1, POINTS))
    assert (found.log_scope == EXCLUDED).all()


def test_equal_colours_leave_it_to_density_and_equal_densities_to_colour():
    logits, likelihood = torch.zeros(1, 1, COMPONENTS, POINTS), torch.zeros(1, 1, COMPONENTS, POINTS)
    uneven = torch.tensor([0.0, math.log(2), math.log(5)])[:, None].expand(1, 1, -1, POINTS)
    expected = torch.tensor([1 / 8, 2 / 8, 5 / 8])[:, None].expand(1, 1, -1, POINTS)
    torch.testing.assert_close(posterior(uneven, likelihood), expected)
    torch.testing.assert_close(posterior(logits, uneven), expected)


def test_what_is_outside_a_box_is_not_of_it_whatever_the_colours():
    logits, likelihood = torch.zeros(1, 1, COMPONENTS, POINTS), torch.zeros(1, 1, COMPONENTS, POINTS)
    logits[:, :, 2], likelihood[:, :, :2] = OUTSIDE, -2000.0
    assert (posterior(logits, likelihood)[:, :, 2] == 0).all()


def test_points_without_depth_are_the_backgrounds():
    logits = torch.zeros(1, 1, COMPONENTS, POINTS)
    logits[:, :, 1] = 50
    valid = torch.tensor([[[True, False, True, True, False]]])
    found = posterior(logits, torch.zeros_like(logits), valid)
    assert (found.argmax(dim=2) == torch.where(valid, 1, 0)).all()


def test_a_round_puts_objects_where_fields_that_know_them_say_whatever_the_attention_said(
    monkeypatch: pytest.MonkeyPatch,
):
    scene = table_scene(frames=1)
    points, labels = unproject(scene).view(-1, 3), labels_by_colour(scene.rgb).view(-1)

    def decode(
        _: Any,
        _inference: Any,
        at: Tensor,
        _directions: Tensor,
        colours: str = "without",
        where_background: str = "everywhere",
    ) -> Decoded:
        assert torch.equal(at.view(-1, 3), points)
        logits = torch.where(torch.arange(3)[:, None] == labels, 5.0, OUTSIDE)[None, None]
        return Decoded(logits, torch.zeros(*logits.shape, 3) if colours == "with" else None)

    monkeypatch.setattr(ObPose, "decode", decode)
    torch.manual_seed(0)
    changes = {"model.slots": 2, "model.attention.inactive_points": 0, "model.attention.posterior_refinements": 1}
    found = build_obpose(make_config(**changes)).eval().segment(scene)
    means = torch.stack([points[labels == slot].mean(dim=0) for slot in (1, 2)])
    torch.testing.assert_close(found.inference.observed_center[0, 0], means)
    assert (found.labels.view(-1) == labels).all()
    assert (found.attention.view(-1) != labels).any(), "An untrained attention knows nothing."
