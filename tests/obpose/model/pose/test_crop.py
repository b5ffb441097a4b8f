from typing import Literal

import torch
from einops import repeat

from obpose.geometry import to_box
from obpose.model.pose.crop import BoxSamples, gather_box
from obpose.types import Boxes

BATCH, FRAMES, SLOTS, POINTS, FEATURES = 2, 3, 2, 200, 4
SIZE = 0.8


class World:
    """Points in a cube of two metres, and boxes that hold a part of them."""

    def __init__(self, seed: int = 0):
        generator = torch.Generator().manual_seed(seed)
        shape = (BATCH, FRAMES, POINTS)
        self.points = 2 * torch.rand(*shape, 3, generator=generator) - 1
        self.valid = torch.rand(shape, generator=generator) < 0.8
        self.features = torch.randn(*shape, FEATURES, generator=generator)
        self.log_masks = torch.randn(BATCH, FRAMES, SLOTS, POINTS, generator=generator).sigmoid().log()
        center = 0.6 * torch.rand(BATCH, FRAMES, SLOTS, 3, generator=generator)
        rotation = torch.linalg.qr(torch.randn(BATCH, FRAMES, SLOTS, 3, 3, generator=generator)).Q
        self.boxes = Boxes(center, rotation * torch.linalg.det(rotation)[..., None, None], SIZE)

    def gather(self, samples: int, whose: Literal["own", "all"] = "own") -> BoxSamples:
        cloud = self.points, self.valid, self.features, self.log_masks
        return gather_box(*cloud, self.boxes, samples=samples, whose=whose)

    def inside(self) -> torch.Tensor:
        """Which observed points are the slot's and in its box, "batch frame slot point", from the definition."""
        each = repeat(self.points, "b f p xyz -> b f s p xyz", s=SLOTS)
        in_box = to_box(each, self.boxes.center, self.boxes.rotation, SIZE)
        mine = self.log_masks.detach().argmax(dim=2, keepdim=True) == torch.arange(SLOTS)[:, None]
        return (in_box.abs() <= 1).all(dim=-1) & self.valid[:, :, None] & mine


def rows(samples: BoxSamples, batch: int, frame: int, slot: int) -> torch.Tensor:
    """Positions and features of the samples of one box, in an order of their own."""
    place = (batch, frame, slot, samples.valid[batch, frame, slot])
    table = torch.cat([samples.points[place], samples.features[place]], dim=-1)
    return table[table[:, 0].argsort()]


def expected_rows(world: World, batch: int, frame: int, slot: int, samples: int) -> torch.Tensor:
    """Expected samples of one box, from the definition: sort the points in it by their masks."""
    log_mask = world.log_masks[batch, frame, slot]
    inside = world.inside()[batch, frame, slot].nonzero()[:, 0]
    best = inside[log_mask[inside].argsort(descending=True)][:samples]
    rotation, center = world.boxes.rotation[batch, frame, slot], world.boxes.center[batch, frame, slot]
    points = (world.points[batch, frame, best] - center) @ rotation * (2 / SIZE)
    table = torch.cat([points, world.features[batch, frame, best] * log_mask[best, None].exp()], dim=-1)
    return table[table[:, 0].argsort()]


def boxes() -> list[tuple[int, int, int]]:
    return [(batch, frame, slot) for batch in range(BATCH) for frame in range(FRAMES) for slot in range(SLOTS)]


def test_samples_are_the_points_in_the_box_with_the_largest_masks():
    world = World()
    counts = world.inside().sum(dim=-1)
    assert counts.min() < 3 < counts.max()
    samples = world.gather(3)
    for box in boxes():
        torch.testing.assert_close(rows(samples, *box), expected_rows(world, *box, samples=3))


def test_all_points_in_the_box_where_there_are_fewer_than_asked_for():
    world = World()
    for count in (100, 1000):
        samples = world.gather(count)
        assert torch.equal(samples.valid.sum(dim=-1), world.inside().sum(dim=-1))
        for box in boxes():
            torch.testing.assert_close(rows(samples, *box), expected_rows(world, *box, samples=count))


def test_places_without_a_point_hold_zeros():
    samples = World().gather(100)
    assert not samples.valid.all()
    assert (samples.points[~samples.valid] == 0).all()
    assert (samples.features[~samples.valid] == 0).all()
    assert (samples.points.abs() <= 1).all()


def test_features_have_a_gradient_masks_and_boxes_have_none():
    world = World()
    for tensor in (world.features, world.log_masks, world.boxes.center, world.boxes.rotation):
        tensor.requires_grad_()
    samples = world.gather(6)
    assert not samples.points.requires_grad
    samples.features.sum().backward()
    expected = torch.zeros(BATCH, FRAMES, POINTS)
    for batch, frame, slot in boxes():
        log_mask = world.log_masks[batch, frame, slot].masked_fill(~world.inside()[batch, frame, slot], -torch.inf)
        best = log_mask.detach().topk(6)
        expected[batch, frame, best.indices] += best.values.exp()
    assert world.features.grad is not None
    torch.testing.assert_close(world.features.grad, expected[..., None].expand_as(world.features))
    assert world.log_masks.grad is None
    assert world.boxes.center.grad is None
    assert world.boxes.rotation.grad is None


def test_all_points_of_the_box_can_be_taken_whosever_they_are():
    world = World()
    own, every = world.gather(POINTS), world.gather(POINTS, whose="all")
    each = repeat(world.points, "b f p xyz -> b f s p xyz", s=SLOTS)
    in_box = (to_box(each, world.boxes.center, world.boxes.rotation, SIZE).abs() <= 1).all(dim=-1)
    assert torch.equal(every.valid.sum(dim=-1), (in_box & world.valid[:, :, None]).sum(dim=-1))
    assert every.valid.sum() > own.valid.sum()
