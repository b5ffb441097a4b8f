import dataclasses
import io
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from obpose.data.clips import observation_of
from obpose.geometry import sides_of_points, unproject
from obpose.pictures import (
    COLUMNS,
    GAP,
    HEADER,
    MARGIN,
    PALETTE,
    box_edges,
    draw,
    draw_box,
    reconstruct,
    tint,
    write_picture,
)
from obpose.types import Decoded
from tests.obpose.toy import SIZE, SLOTS, ToyClips, ToyModel, toy_config

FACTOR = 24


class Painted(ToyModel):
    """A toy model that reconstructs a red background."""

    def decode(self, inference, points, directions, colours):
        logits = torch.full((*points.shape[:2], 1 + SLOTS, points.shape[2]), -1e4)
        logits[:, :, 0] = 20.0
        shades = torch.zeros(*logits.shape, 3)
        shades[:, :, 0, :, 0] = 1.0
        return Decoded(logits, shades)


def clips(views: int = 1):
    return observation_of([ToyClips(views=views).window(index, 0, 3) for index in (0, 1)])


def tile(picture: np.ndarray, row: int, column: int) -> np.ndarray:
    side = SIZE * FACTOR
    top, left = HEADER + row * (side + GAP), MARGIN + column * (side + GAP)
    return picture[top : top + side, left : left + side]


def size(rows: int, columns: int) -> tuple[int, int]:
    """Height and width of a picture."""
    return HEADER + rows * (SIZE * FACTOR + GAP), MARGIN + columns * (SIZE * FACTOR + GAP)


def test_rows_are_first_and_last_frames_and_columns_are_outputs():
    picture = draw(Painted(toy_config()), clips())
    assert picture.shape == (*size(4, len(COLUMNS)), 3)
    expected = (clips().rgb[1, 2, 0].numpy() * 255).round().astype(np.uint8)
    np.testing.assert_array_equal(tile(picture, 3, 0)[::FACTOR, ::FACTOR], expected)
    np.testing.assert_array_equal(tile(picture, 3, 1), tile(picture, 3, 0))  # its attention masks are empty
    assert (tile(picture, 0, 3) == (255, 0, 0)).all()


def test_a_model_without_colours_is_drawn_without_a_reconstruction():
    picture = draw(ToyModel(toy_config()), clips())
    assert picture.shape == (*size(4, len(COLUMNS) - 1), 3)


def test_pixels_without_depth_are_black_in_reconstructions():
    seen = clips()
    valid = seen.valid.clone()
    valid[..., :4, :] = False
    seen = dataclasses.replace(seen, valid=valid)
    model = Painted(toy_config())
    colours = reconstruct(model, seen, model.segment(seen).inference)
    assert (colours[..., :4, :, :] == 0).all()
    torch.testing.assert_close(colours[..., 4:, :, 0], torch.ones(2, 3, 1, 4, SIZE))


def test_every_8_bit_label_has_a_colour_of_its_own():
    assert len(np.unique(PALETTE, axis=0)) == 256
    assert PALETTE[0].tolist() == [0, 0, 0]


def test_labels_tint_objects_only():
    image = np.full((2, 3, 3), 100, np.uint8)
    labels = np.array([[0, 1, 2], [0, len(PALETTE), 0]])
    tinted = tint(image, labels)
    assert (tinted[labels == 0] == 100).all()
    assert len({tuple(tinted[0, 1]), tuple(tinted[0, 2]), (100, 100, 100)}) == 3
    assert tuple(tinted[1, 1]) == tuple(tinted[0, 1])  # colours repeat


def test_boxes_have_twelve_edges_of_their_size():
    angle = torch.tensor(0.3)
    turn = torch.eye(3)
    turn[:2, :2] = torch.tensor([[angle.cos(), -angle.sin()], [angle.sin(), angle.cos()]])
    center = torch.tensor([0.1, 0.2, 0.3]).expand(2, 3)
    edges = box_edges(center, turn.expand(2, 3, 3), torch.tensor([0.4, 0.5, 0.6]).expand(2, 3))
    assert edges.shape == (2, 12, 2, 3)
    lengths = (edges[..., 0, :] - edges[..., 1, :]).norm(dim=-1).sort(dim=-1).values
    torch.testing.assert_close(lengths, torch.tensor([0.4] * 4 + [0.5] * 4 + [0.6] * 4).expand(2, 12))
    torch.testing.assert_close(edges.mean(dim=(1, 2)), center)


def test_sides_reach_to_the_farthest_point_of_a_label_along_the_axes_of_its_box():
    boxes = ToyModel(toy_config()).segment(clips()).inference.boxes
    turn = torch.eye(3).roll(1, dims=0)
    boxes = dataclasses.replace(boxes, rotation=turn.expand_as(boxes.rotation))
    points = unproject(clips())
    labels = torch.zeros(points.shape[:-1], dtype=torch.int64)
    labels[:, :, :, 2:4, 3:6] = 2
    sides = sides_of_points(points, labels, boxes)
    assert sides[:, :, 0].isnan().all()
    farthest = (points[0, 1, 0, 2:4, 3:6].reshape(-1, 3) - boxes.center[0, 1, 1]).abs().amax(dim=0)
    assert len(farthest.unique()) == 3
    torch.testing.assert_close(sides[0, 1, 1], 2 * farthest[[1, 2, 0]])


def test_edges_are_drawn_where_the_camera_sees_them_and_not_behind_it():
    pose = torch.eye(4)
    # The camera looks along the world's x axis, and its right is the world's y axis.
    pose[:3, :3] = torch.tensor([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    pose[:3, 3] = torch.tensor([1.0, 2.0, 3.0])
    seen = torch.tensor([[-0.5, 0.25, 1.0], [0.5, 0.25, 1.0]])
    edges = torch.stack([seen, seen * torch.tensor([1, -1, -1]), seen * torch.tensor([[1, -1, 1], [1, -1, -1]])])
    canvas = Image.new("RGB", (40, 30))
    k = torch.tensor([[20.0, 0, 20], [0, 20, 15], [0, 0, 1]])
    draw_box(canvas, edges @ pose[:3, :3].T + pose[:3, 3], 3, k=k, pose=pose)
    expected = np.zeros((30, 40, 3), np.uint8)
    expected[20, 10:31] = PALETTE[3]
    np.testing.assert_array_equal(np.asarray(canvas), expected)


def test_a_model_without_poses_is_drawn_without_boxes(monkeypatch: pytest.MonkeyPatch):
    model = ToyModel(toy_config())
    found = model.segment(clips())
    without = dataclasses.replace(found, inference=dataclasses.replace(found.inference, where=None))
    monkeypatch.setattr(model, "segment", lambda observation: without)
    assert draw(model, clips()).shape == (*size(4, len(COLUMNS) - 2), 3)


@pytest.mark.parametrize("views", ["all", "separate"])
def test_a_picture_is_written_and_the_model_returns_to_training(tmp_path: Path, views):
    model = Painted(toy_config()).train()
    write_picture(tmp_path / "new" / "a.png", model, clips(views=2), views)
    picture = Image.open(io.BytesIO((tmp_path / "new" / "a.png").read_bytes()))
    rows = 4 if views == "all" else 8
    assert picture.size == size(rows, len(COLUMNS))[::-1]
    assert model.training
