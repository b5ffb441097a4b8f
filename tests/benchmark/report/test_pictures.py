"""Pictures read back: label maps are exact, and a slot has one colour over a clip."""

import base64
import io

import numpy as np
from PIL import Image

from benchmark.report.pictures import GAP, SIDE, label_picture, photograph, slot_colors, thin
from datagen.inspect.preview import label_colors


def test_label_maps_are_exact_to_the_pixel() -> None:
    labels = np.random.default_rng(0).integers(0, 4, (2, 6, 5))
    colors = label_colors(4)
    pixels = read(label_picture(list(labels), colors))
    assert pixels.shape == (6, 10 + GAP, 4)
    assert np.array_equal(pixels[:, :5, :3], colors[labels[0]])
    assert np.array_equal(pixels[:, 5 + GAP :, :3], colors[labels[1]])
    assert not pixels[:, 5 : 5 + GAP, 3].any()


def test_large_images_are_thinned_out() -> None:
    assert max(thin(np.zeros((300, 200, 3), np.uint8)).shape[:2]) <= SIDE
    assert thin(np.zeros((64, 64))).shape == (64, 64)


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


def test_every_slot_has_another_colour() -> None:
    tables = np.random.default_rng(1).integers(0, 9, (4, 6, 9))
    assert len(np.unique(slot_colors(tables, background_slot=2), axis=0)) == 9


def read(uri: str) -> np.ndarray:
    data = base64.b64decode(uri.removeprefix("data:image/webp;base64,"))
    return np.asarray(Image.open(io.BytesIO(data)))
