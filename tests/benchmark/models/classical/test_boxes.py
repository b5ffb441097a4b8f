import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmark.metrics.box_overlap import box_corners, box_overlap
from benchmark.models.classical.boxes import smallest_box, visible_boxes
from benchmark.models.registry import MODELS, expand
from tests.worlds.sphere_clips import arbitrary, clip_and_truth


def box_points(size: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Corners and inner points of a box that is turned and moved, and how it is turned."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=rng).as_matrix()
    inner = rng.uniform(-0.5, 0.5, (200, 3)) * size
    return np.concatenate([inner, box_corners((np.zeros(3), np.eye(3), size))]) @ rotation.T + [0.3, 0.1, 0.2], rotation


def test_a_box_is_found_again():
    size = np.array([0.1, 0.06, 0.03])
    points, rotation = box_points(size)
    assert box_overlap(smallest_box(points), (np.array([0.3, 0.1, 0.2]), rotation, size)) > 0.95


def test_flat_and_few_points_have_boxes_too():
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(-0.05, 0.05, (50, 2)), np.full(50, 0.4)])
    center, _, size = smallest_box(flat)
    assert center == pytest.approx([0, 0, 0.4], abs=0.01)
    assert sorted(size)[0] == pytest.approx(0, abs=1e-3)
    assert sorted(size)[1] > 0.08
    for few in (flat[:1], flat[:3]):
        center, rotation, size = smallest_box(few)
        np.testing.assert_array_equal(rotation, np.eye(3))
        assert np.all(np.abs(few - center) <= size / 2 + 1e-12)


def test_views_have_boxes_together_or_each_its_own():
    clip, truth = clip_and_truth(frames=1, views=2)
    together, apart = (visible_boxes(truth.astype(np.int64), clip, views=views) for views in ("together", "apart"))
    np.testing.assert_array_equal(together.center[:, 0], together.center[:, 1])
    assert not np.array_equal(apart.center[:, 0, 1:], apart.center[:, 1, 1:])
    assert np.isnan(apart.center[:, :, 0]).all()


@pytest.mark.parametrize("name", expand(["poses"]))
@pytest.mark.parametrize("blind", [False, True])
def test_whatever_the_clip_poses_are_of_labels_that_are_there(name: str, blind: bool):
    clip = arbitrary(0)
    truth = np.random.default_rng(0).integers(0, 3, clip.depth.shape).astype(np.uint8)
    valid = np.zeros_like(clip.valid) if blind else clip.valid
    model = MODELS[name].build({"slots": 4, **MODELS[name].default})
    model.fit([], [], seed=0, budget=1.0)
    found = model.segment(dataclasses.replace(clip, valid=valid, truth=truth))
    assert found.poses is not None
    for frame, view in np.ndindex(2, 2):
        there = set(np.flatnonzero(np.isfinite(found.poses.center[frame, view]).all(axis=-1)))
        seen = found.labels[frame] if name.startswith("plane") else found.labels[frame, view]
        assert there <= set(np.unique(seen)) - {0}
        assert bool(there) is not (blind or not (seen > 0).any())


@pytest.mark.parametrize("name", ["oracle-visible-boxes", "oracle-visible-means"])
def test_an_oracle_needs_the_truth(name: str):
    with pytest.raises(ValueError, match="carry the truth"):
        MODELS[name].build({}).segment(dataclasses.replace(arbitrary(0), truth=None))
