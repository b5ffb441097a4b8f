import numpy as np
import pytest
import torch

from obpose.baselines.ogc import Ogc, dynamic_loss, invariance_loss, rigid_motions, scene_flow, smoothness_loss
from obpose.config import override
from obpose.contact.config import OgcConfig, check_contact_bounds
from obpose.errors import UsageError
from tests.obpose.toy import ToyClips
from tests.worlds.observations import table_scene

POINTS = torch.rand(2, 40, 3, generator=torch.Generator().manual_seed(0)) * 0.1
"""Two bodies, metres."""


def turned(points: torch.Tensor, angle: float, shift: tuple[float, float, float]) -> torch.Tensor:
    c, s = np.cos(angle), np.sin(angle)
    return points @ torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float32).T + torch.tensor(shift)


def bodies() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Points, where they move, and true masks."""
    moved = torch.stack([turned(POINTS[0], 0.3, (0.05, 0, 0)), turned(POINTS[1], -0.2, (-0.05, 0.02, 0))])
    return POINTS.reshape(-1, 3), moved.reshape(-1, 3), torch.eye(2).repeat_interleave(40, dim=1)


def test_true_masks_of_rigid_bodies_have_no_loss_and_their_union_has():
    points, moved, masks = bodies()
    assert dynamic_loss(points, moved, masks) < 1e-6
    union = torch.ones(2, 80) * torch.tensor([[1.0], [0.0]])
    assert dynamic_loss(points, moved, union) > 0.01


def test_gradient_descent_on_the_loss_divides_the_bodies():
    points, moved, masks = bodies()
    logits = (0.5 * torch.randn(2, 80, generator=torch.Generator().manual_seed(1))).requires_grad_()
    optimizer = torch.optim.Adam([logits], 0.2)
    for _ in range(150):
        optimizer.zero_grad()
        dynamic_loss(points, moved, logits.softmax(dim=0)).backward()
        optimizer.step()
    same = (logits.argmax(dim=0) == masks.argmax(dim=0)).float().mean()
    assert max(same, 1 - same) > 0.95


def test_motions_are_rotations_even_of_flat_bodies():
    flat = POINTS[0] * torch.tensor([1.0, 1.0, 0.0])
    rotation, translation = rigid_motions(flat, turned(flat, 0.5, (0, 0, 0.1)), torch.ones(1, 40))
    assert torch.linalg.det(rotation[0]) == pytest.approx(1, abs=1e-5)
    torch.testing.assert_close(flat @ rotation[0].T + translation[0], turned(flat, 0.5, (0, 0, 0.1)))


def test_masks_that_differ_between_neighbours_cost_smoothness():
    points = torch.rand(60, 3, generator=torch.Generator().manual_seed(2)) * 0.02
    noise = torch.eye(2)[torch.randint(2, (60,), generator=torch.Generator().manual_seed(3))].T
    assert smoothness_loss(points, torch.eye(2)[:, :1].expand(2, 60)) == 0
    assert smoothness_loss(points, noise) > 0.5


def test_order_of_slots_is_no_change():
    masks = torch.rand(3, 20, generator=torch.Generator().manual_seed(4)).softmax(dim=0)
    assert invariance_loss(masks, masks[[2, 0, 1]]) == 0
    assert invariance_loss(masks, masks.flip(1)) > 0


def test_flow_follows_two_bodies_that_are_apart():
    """Two squares on a grid of 2 cm move by 6 mm in different directions."""
    y, x = np.mgrid[:8, :16] * 0.02
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    standing = np.zeros((8, 16), bool)
    standing[2:6, 1:6] = standing[2:6, 10:15] = True
    shift = np.where(x[..., None] < 0.16, [0.006, 0, 0], [0, -0.006, 0])
    rgb = np.zeros_like(points)
    flow = scene_flow((points, points + shift), (rgb, rgb), (standing, standing), gap=0.03) - points[standing]
    np.testing.assert_allclose(flow, shift[standing], atol=0.002)


def test_stills_are_refused():
    with pytest.raises(UsageError, match="one frame; expected two or more"):
        Ogc(OgcConfig()).training_source(ToyClips(frames=1))


@pytest.mark.parametrize("slots", [-1, 0, 255])
def test_the_number_of_masks_has_bounds(slots: int):
    with pytest.raises(UsageError, match=f"model.slots is {slots}; expected"):
        check_contact_bounds(override(OgcConfig(), {"model.slots": slots}))


def test_only_motion_counts_in_the_first_half_of_the_budget():
    scene, model = table_scene(frames=2, spheres=2), Ogc(OgcConfig())

    def losses(fraction: float) -> dict[str, torch.Tensor]:
        return model.losses(scene, step=0, fraction=fraction, generator=torch.Generator().manual_seed(0))

    early, late = losses(0.49), losses(0.5)
    assert early["total"] == 10 * early["dynamic"]
    torch.testing.assert_close(late["total"], 10 * late["dynamic"] + 0.02 * (late["smooth"] + late["invariant"]))
    assert late["invariant"] > 0


def test_masks_do_not_depend_on_the_length_of_features():
    scene, model = table_scene(frames=1, spheres=1), Ogc(OgcConfig())
    images = model.images(scene)
    before = model.masks(images)
    with torch.no_grad():
        model.mask_features.mul_(3)
    torch.testing.assert_close(model.masks(images), before)
    torch.testing.assert_close(before.sum(dim=1), torch.ones_like(before[:, 0]))
    assert (before.max(dim=1).values > 0.5).float().mean() > 0.1  # a low temperature makes fresh masks distinct


def test_a_step_learns_and_masks_cover_what_stands_on_the_table():
    scene = table_scene(frames=2, spheres=2)
    model = Ogc(OgcConfig())
    terms = model.losses(scene, step=0, fraction=0.5, generator=torch.Generator().manual_seed(0))
    terms["total"].backward()
    assert all(torch.isfinite(value) for value in terms.values())
    assert any(parameter.grad.abs().sum() > 0 for parameter in model.parameters() if parameter.grad is not None)
    found = model.segment(scene)
    assert torch.equal(model.label_objects(scene), found.labels)
    standing = model.standing(model.images(scene)).reshape(found.labels.shape)
    assert torch.equal(found.attention > 0, standing)
    assert torch.equal(found.labels > 0, standing)
    assert found.attention.max() <= model.config.model.slots


def test_pixels_without_depth_have_no_label_even_if_cleaning_fills_them(monkeypatch: pytest.MonkeyPatch):
    scene = table_scene(frames=2, holes=0.2)
    assert not scene.valid.all()
    model = Ogc(override(OgcConfig(), {"model.clean_depth": True}))
    assert model._cleaned(scene).valid.sum() > scene.valid.sum()
    followed = []
    follow = "obpose.baselines.ogc.follow_objects"
    monkeypatch.setattr(follow, lambda clouds, objects, gap: followed.extend(clouds) or objects)
    found = model.segment(scene)
    assert all(np.all((cloud.points[:, 2] > 0) & (cloud.points[:, 2] < 0.15)) for cloud in followed)
    assert (found.labels > 0).any()
    assert not found.labels[~scene.valid].any()
    assert not found.attention[~scene.valid].any()
