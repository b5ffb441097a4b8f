"""Facts that hold for every model without training."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from benchmark.metrics import clip_scores
from benchmark.models.interface import LARGEST_LABEL, Clip, Segmenter
from benchmark.models.registry import MODELS, expand
from tests.worlds.sphere_clips import arbitrary, clip_and_truth, turned, with_holes, with_noise

SLOTS = 4
EVERY = expand(["training-free", "stronger"])
CLASSICAL = expand(["classical", "stronger"])
GEOMETRIC = ["plane-dbscan", "plane-dbscan-tracked", "plane-hdbscan", "plane-components"]
PLANE = [*GEOMETRIC, "plane-dbscan-colour", "clip-tracker", "convexity"]
VALUES = [(name, value) for name in EVERY for value in (MODELS[name].grid or ({},))]


def fitted(name: str, seed: int = 0, **options: Any) -> Segmenter:
    model = MODELS[name].build({"slots": SLOTS, **MODELS[name].default, **options})
    model.fit([], [], seed=seed, budget=1.0)
    return model


def segment(name: str, clip: Clip, seed: int = 0) -> np.ndarray:
    """Labels of one clip; it carries the truth only if the model may see it."""
    truth = clip.truth if MODELS[name].uses_labels else None
    return fitted(name, seed).segment(dataclasses.replace(clip, truth=truth)).labels


def same_partition(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.all(clip_scores(one, other)["ari"] == 1))


def blind(clip: Clip) -> Clip:
    return dataclasses.replace(clip, depth=np.zeros_like(clip.depth), valid=np.zeros_like(clip.valid))


@pytest.mark.parametrize(("name", "value"), VALUES, ids=str)
def test_every_pixel_gets_a_label_with_every_value_of_the_grid(name: str, value: dict[str, Any]):
    for clip in (arbitrary(0), arbitrary(1, frames=1, views=1), blind(arbitrary(2))):
        prediction = fitted(name, **value).segment(clip)
        assert prediction.labels.shape == clip.depth.shape
        assert np.issubdtype(prediction.labels.dtype, np.integer)
        assert prediction.labels.min() >= 0
        assert prediction.labels.max() <= LARGEST_LABEL
        assert prediction.background_slot in (0, None)


@pytest.mark.parametrize("name", [name for name in EVERY if "slots" in MODELS[name].priors])
def test_slots_are_no_more_than_given(name: str):
    assert len(np.unique(segment(name, arbitrary(0)))) == SLOTS


@pytest.mark.parametrize("name", EVERY)
def test_equal_seeds_give_equal_labels_whatever_came_before(name: str):
    clip, other = (with_noise(clip_and_truth(seed, uses_labels=True)[0]) for seed in range(2))
    model = fitted(name, seed=5)
    first = model.segment(clip).labels
    model.segment(other)
    assert np.array_equal(model.segment(clip).labels, first)
    assert np.array_equal(fitted(name, seed=5).segment(clip).labels, first)


@pytest.mark.parametrize("name", EVERY)
def test_seeds_make_a_difference_where_the_registry_says_so(name: str):
    # Where there is no table, RANSAC finds another plane each time.
    clip = arbitrary(0, size=(24, 24))
    rough = np.where(clip.valid, 1 + clip.depth / 20, 0).astype(np.float32)
    clip = dataclasses.replace(clip, depth=rough)
    seeds = [segment(name, clip, seed) for seed in range(4)]
    assert any(not np.array_equal(seeds[0], labels) for labels in seeds) == MODELS[name].random


@pytest.mark.parametrize("name", CLASSICAL)
@pytest.mark.parametrize("angle", [0.3, 1.5, 3.0])
def test_turning_the_world_changes_no_partition(name: str, angle: float):
    clip, _ = clip_and_truth(views=2, frames=2)
    assert same_partition(segment(name, clip), segment(name, turned(clip, angle)))


@pytest.mark.parametrize("name", CLASSICAL)
def test_colour_counts_where_it_is_used(name: str):
    clip, _ = clip_and_truth()
    noise = np.random.default_rng(0).integers(0, 256, clip.rgb.shape, dtype=np.uint8)
    labels = [segment(name, dataclasses.replace(clip, rgb=rgb)) for rgb in (np.zeros_like(noise), noise)]
    assert same_partition(*labels) == (name in GEOMETRIC)


@pytest.mark.parametrize("name", PLANE)
@pytest.mark.parametrize("seed", range(2))
def test_separate_objects_are_found_exactly(name: str, seed: int):
    clip, truth = clip_and_truth(seed, spheres=4)
    clip = dataclasses.replace(clip, rgb=np.repeat(50 * truth[..., None], 3, axis=-1).astype(np.uint8))
    scores = clip_scores(truth, segment(name, clip), 0)
    assert np.all(scores["ari_fg"] == 1)
    assert np.mean(scores["msc_fg"]) > 0.97
    assert np.mean(scores["miou_bg"]) > 0.99


@pytest.mark.parametrize("name", PLANE)
def test_holes_are_background_and_harm_nothing_else(name: str):
    clip, truth = clip_and_truth(spheres=4)
    clip = dataclasses.replace(clip, rgb=np.repeat(50 * truth[..., None], 3, axis=-1).astype(np.uint8))
    holed = with_holes(clip, 0.2)
    labels = segment(name, holed)
    assert np.all(labels[~holed.valid] == 0)
    scores = clip_scores(truth, labels, 0, ~holed.valid)
    assert np.mean(scores["ari_fg"]) > 0.95
    assert np.mean(scores["msc_fg"]) > 0.93


@pytest.mark.parametrize("name", PLANE)
def test_an_empty_table_and_a_clip_without_depth_are_all_background(name: str):
    clip, _ = clip_and_truth(spheres=0)
    assert not np.any(segment(name, clip))
    assert not np.any(segment(name, blind(clip)))


@pytest.mark.parametrize("name", PLANE)
def test_noise_of_the_sensor_raises_no_table(name: str):
    clip, truth = clip_and_truth()
    assert np.mean(clip_scores(truth, segment(name, with_noise(clip)), 0)["miou_bg"]) > 0.99
