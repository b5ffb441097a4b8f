"""Pictures read back: label maps are exact, and a slot has one colour over a clip."""

import base64
import io

import numpy as np
from PIL import Image

from benchmark.report.pictures import EDGES, GAP, box_corners, boxes_picture, label_picture, photograph, slot_colors
from datagen.inspect.preview import label_colors


def test_label_maps_are_exact_to_the_pixel() -> None:
    labels = np.random.default_rng(0).integers(0, 4, (2, 6, 5))
    colors = label_colors(4)
    pixels = read(label_picture(list(labels), colors))
    assert pixels.shape == (6, 10 + GAP, 4)
    assert np.array_equal(pixels[:, :5, :3], colors[labels[0]])
    assert np.array_equal(pixels[:, 5 + GAP :, :3], colors[labels[1]])
    assert not pixels[:, 5 : 5 + GAP, 3].any()


def test_photographs_stay_close_to_the_image() -> None:
    image = np.full((32, 48, 3), (200, 120, 40), np.uint8)
    assert np.abs(read(photograph([image]))[..., :3].astype(int) - image).max() < 12


def test_a_slot_has_the_colour_of_the_object_that_it_covers_best_over_the_clip() -> None:
    tables = np.zeros((2, 3, 4), np.int64)
    tables[:, 0, 3] = 50
    tables[0, 1, 0], tables[1, 1, 1] = 10, 4
    tables[:, 2, 1] = 10
    truth = label_colors(7)
    found = slot_colors(tables, background_slot=3)
    assert np.array_equal(found[[3, 0, 1]], truth[[0, 1, 2]])
    assert found[2].tolist() not in truth[:3].tolist()


def test_false_segments_and_the_background_have_no_colour_of_an_object() -> None:
    tables = np.zeros((1, 3, 4), np.int64)
    tables[0, 0] = [40, 0, 0, 9]
    tables[0, 1] = [30, 5, 0, 0]
    tables[0, 2] = [20, 0, 0, 0]
    truth = label_colors(7)
    found = slot_colors(tables, background_slot=0)
    assert np.array_equal(found[:2], truth[:2])
    assert not {*map(tuple, found[2:].tolist())} & {*map(tuple, truth[:3].tolist())}


def test_every_slot_has_another_colour() -> None:
    tables = np.random.default_rng(1).integers(0, 9, (4, 6, 9))
    assert len(np.unique(slot_colors(tables, background_slot=2), axis=0)) == 9


def test_the_corners_of_a_box_are_projected_and_boxes_behind_the_camera_are_left_out() -> None:
    k = np.array([[100.0, 0, 32], [0, 100.0, 24], [0, 0, 1]])
    center = np.array([[0, 0, 2.0], [0, 0, -2.0], [np.nan] * 3])
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    rotation = np.broadcast_to(turned, (3, 3, 3))
    size = np.broadcast_to([0.2, 0.4, 0.0], (3, 3))
    corners = box_corners(center, rotation, size, k, np.eye(4))
    np.testing.assert_allclose(corners[0].min(axis=0), [32 - 10, 24 - 5])
    np.testing.assert_allclose(corners[0].max(axis=0), [32 + 10, 24 + 5])
    assert np.isnan(corners[1:]).all()
    assert len(EDGES) == 12


def test_boxes_are_drawn_in_the_colour_of_their_slot() -> None:
    corners = np.full((2, 8, 2), np.nan)
    corners[1] = [(8, 8), (8, 40), (24, 8), (24, 40)] * 2
    pixels = read(boxes_picture([np.zeros((64, 64, 3), np.uint8)], [corners], label_colors(2)))
    assert pixels.shape[:2] == (128, 128)
    line = pixels[40, 16, :3].astype(int)
    assert line.argmax() == label_colors(2)[1].argmax()
    assert line.max() > 180
    assert np.abs(pixels[100, 100, :3].astype(int) - 64).max() < 12


def read(uri: str) -> np.ndarray:
    data = base64.b64decode(uri.removeprefix("data:image/webp;base64,"))
    return np.asarray(Image.open(io.BytesIO(data)))
