"""Observations sorted into classes, on values small enough to sort by hand."""

import numpy as np
import pytest

from benchmark.report.observations import Objects, nearest_gap, object_pixels, outcome_of_scene, scene_tables
from benchmark.report.slices import MOST_FRAMES, Missing, Slicing, by_count, by_frame, by_size, slicings


def test_means_are_taken_class_by_class() -> None:
    slicing = by_count(np.array([2, 3, 3, 5]))
    assert slicing.names == ("2", "3", "5")
    assert slicing.counts.tolist() == [1, 2, 1]
    assert slicing.means(np.array([0.5, 0.2, 0.4, 1.0])) == pytest.approx([0.5, 0.3, 1.0])


def test_empty_classes_between_others_have_no_mean() -> None:
    slicing = by_size(np.array([5, 40]))
    assert slicing.names == ("<8", "8+", "16+", "32+")
    assert np.isnan(slicing.means(np.ones(2))).tolist() == [False, True, True, False]


@pytest.mark.parametrize(("pixels", "name"), [(7, "<8"), (8, "8+"), (15, "8+"), (16, "16+"), (5000, "1024+")])
def test_sizes_fall_into_doubling_classes(pixels: int, name: str) -> None:
    assert by_size(np.array([pixels])).names == (name,)


def test_long_clips_are_gathered_into_few_classes_that_keep_their_order() -> None:
    slicing = by_frame(np.arange(50))
    assert isinstance(slicing, Slicing)
    assert len(slicing.names) == MOST_FRAMES
    assert all(slicing.counts > 0)
    firsts = [int(np.flatnonzero(slicing.members == i)[0]) for i in range(MOST_FRAMES)]
    assert slicing.names == tuple(map(str, firsts))


def test_occlusion_and_contact_have_classes_where_the_dataset_knows_them() -> None:
    found = slicings(objects(hidden=np.array([0.0, 0.3, 0.9]), gap=np.array([-0.001, 0.004, np.inf])))
    occlusion, contact = found[2], found[3]
    assert isinstance(occlusion, Slicing)
    assert isinstance(contact, Slicing)
    assert [occlusion.names[i] for i in occlusion.members] == ["none", "to 50%", "more"]
    assert [contact.names[i] for i in contact.members] == ["touching", "to 5 mm", "farther"]


def test_what_the_dataset_does_not_know_is_missing_with_a_reason() -> None:
    found = slicings(objects(hidden=None, gap=None))
    assert [slicing.title for slicing in found if isinstance(slicing, Missing)] == ["Occlusion", "Contact"]


def test_the_nearest_gap_is_to_another_object_and_not_to_the_table() -> None:
    gaps = np.array([[[0.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.01, 0.02], [0.0, 0.01, -1.0, 0.015], [0.0, 0.02, 0.015, -1]]])
    assert nearest_gap(gaps)[0] == pytest.approx([0.01, 0.01, 0.015])
    assert np.isinf(nearest_gap(gaps[:, :2, :2])).all()


def test_pixels_are_counted_for_each_object_in_each_image() -> None:
    truth = np.array([[[[0, 1, 1], [2, 0, 1]]], [[[0, 0, 0], [2, 2, 2]]]], np.uint8)
    assert object_pixels(truth).tolist() == [[[3, 1]], [[0, 3]]]


def test_overlap_leaves_the_background_slot_out_and_ignored_pixels_do_not_count() -> None:
    truth = np.array([[[[0, 1, 1, 2, 2, 2]]]])
    labels = np.array([[[[0, 0, 0, 1, 1, 0]]]])
    ignore = np.zeros(truth.shape, bool)
    overlap, errors = outcome_of_scene(scene_tables(truth, ignore, labels, 0), 0)
    assert overlap == pytest.approx([0.0, 2 / 3])
    assert errors.shape == (2, 5)
    ignore[..., -1] = True
    assert outcome_of_scene(scene_tables(truth, ignore, labels, 0), 0)[0] == pytest.approx([0.0, 1.0])


def objects(hidden: np.ndarray | None, gap: np.ndarray | None) -> Objects:
    place = np.zeros(3, np.int64)
    return Objects(place, np.arange(3), place, np.array([1, 2, 2]), np.array([10, 20, 30]), hidden, gap)
