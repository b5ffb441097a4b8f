from pathlib import Path

import numpy as np
import pytest

from benchmark.results.reconstructions import (
    MOST_IMAGES,
    chosen_scenes,
    load_reconstruction,
    save_reconstruction,
    shown_images,
    shown_scenes,
)
from benchmark.results.run_folder import delete_rows
from datagen.errors import CorruptFile
from tests.chosen_scores import run_row


def images(count: int, height: int = 24, width: int = 32) -> np.ndarray:
    """Images of one colour each."""
    return np.repeat(np.linspace(20, 220, count), height * width * 3).reshape(-1, height, width, 3).astype(np.uint8)


def test_scenes_and_images_are_spread_evenly():
    assert shown_scenes(300) == [0, 100, 199, 299]
    assert shown_scenes(2) == [0, 1]
    assert shown_images(2, 2) == [(0, 0), (0, 1), (1, 0), (1, 1)]
    found = shown_images(10, 3)
    assert len(found) == MOST_IMAGES
    assert (found[0], found[-1]) == ((0, 0), (9, 2))


def test_images_are_what_was_written_but_for_the_compression(tmp_path: Path):
    save_reconstruction(tmp_path, run_row(), 7, images(3))
    found = load_reconstruction(tmp_path, run_row(), 7, 3)
    assert found is not None
    assert np.abs(found.astype(int) - images(3)).max() <= 4
    assert load_reconstruction(tmp_path, run_row(), 8, 3) is None
    assert load_reconstruction(tmp_path, run_row("other"), 7, 3) is None


def test_large_images_are_subsampled(tmp_path: Path):
    save_reconstruction(tmp_path, run_row(), 0, images(2, 300, 400))
    found = load_reconstruction(tmp_path, run_row(), 0, 2)
    assert found is not None
    assert found.shape == (2, 75, 100, 3)


def test_seeds_that_make_no_difference_share_them(tmp_path: Path):
    save_reconstruction(tmp_path, run_row(seed=0, random=False), 0, images(1))
    assert load_reconstruction(tmp_path, run_row(seed=1, random=False), 0, 1) is not None
    assert load_reconstruction(tmp_path, run_row(seed=1), 0, 1) is None


def test_scenes_with_reconstructions_are_chosen_if_there_are_any(tmp_path: Path):
    rows = [run_row("a"), run_row("b")]
    assert chosen_scenes(tmp_path, rows, 10) == list(range(10))
    save_reconstruction(tmp_path, rows[1], 3, images(1))
    save_reconstruction(tmp_path, rows[1], 9, images(1))
    assert chosen_scenes(tmp_path, rows, 10) == [3, 9]


def test_deleted_rows_have_none(tmp_path: Path):
    save_reconstruction(tmp_path, run_row(), 0, images(1))
    delete_rows(tmp_path, [run_row()])
    assert list(tmp_path.rglob("*.webp")) == []


def test_damage_is_named(tmp_path: Path):
    save_reconstruction(tmp_path, run_row(), 0, images(3))
    (path,) = tmp_path.rglob("*.webp")
    with pytest.raises(CorruptFile, match="expected 7 images of equal width"):
        load_reconstruction(tmp_path, run_row(), 0, 7)
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(CorruptFile, match=r"damaged.*Delete it: it is only shown in the report\."):
        load_reconstruction(tmp_path, run_row(), 0, 3)
