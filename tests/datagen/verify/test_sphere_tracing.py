import numpy as np
import pytest

from datagen.shapes.shape import OrientedBox
from datagen.verify.sphere_tracing import clip_to_box, trace

RADIUS = 0.05


def sphere(points: np.ndarray) -> np.ndarray:
    return np.sqrt(np.sum(points**2, axis=1)) - RADIUS


def parallel_rays(offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    origins = np.stack([offsets, np.zeros_like(offsets), np.full_like(offsets, -1.0)], axis=1)
    return origins, np.tile([0.0, 0.0, 2.0], (len(offsets), 1))


def test_hits_lie_at_the_asked_depth_below_the_surface_and_misses_tell_how_near_they_came():
    offsets = np.linspace(0, 0.1, 101)
    origins, directions = parallel_rays(offsets)
    hit, closest = trace(sphere, origins, directions, np.zeros(101), np.ones(101), 1e-4)
    meets = offsets < RADIUS - 1.1e-4
    np.testing.assert_array_equal(np.isfinite(hit), meets)
    depth = sphere(origins[meets] + hit[meets, None] * directions[meets])
    # One least step of 0.05 mm at most beyond the depth that was asked for.
    assert np.all((depth <= -1e-4) & (depth > -1.6e-4))
    misses = offsets > RADIUS
    assert np.all(closest[misses] >= offsets[misses] - RADIUS - 1e-12)
    assert np.all(closest[misses] <= 2 * (offsets[misses] - RADIUS) + 1.1e-4)


def test_nothing_is_hit_outside_the_stretch():
    origins, directions = parallel_rays(np.zeros(3))
    near, far = np.array([0.0, 0.6, 0.6]), np.array([0.4, 1.0, 0.5])
    hit, closest = trace(sphere, origins, directions, near, far, 1e-4)
    assert np.all(np.isinf(hit))
    np.testing.assert_allclose(closest[0], 0.2 - RADIUS)  # where the stretch ends


def test_a_surface_just_before_the_stretch_ends_is_not_stepped_over():
    miss = 5e-5
    near = np.linspace(0.3, 0.49, 200)
    origins, directions = parallel_rays(np.full(200, miss))
    _, closest = trace(lambda p: np.sqrt(np.sum(p**2, axis=1)), origins, directions, near, np.full(200, 0.5), 1e-4)
    assert np.max(closest) <= 2 * miss + 1e-4


def test_rays_that_stay_undecided_may_touch():
    def floor_and_wall(points: np.ndarray) -> np.ndarray:
        return np.minimum(points[:, 0], 0.5 - points[:, 2])

    origins, directions = parallel_rays(np.array([4e-4]))
    hit, closest = trace(floor_and_wall, origins, directions, np.zeros(1), np.ones(1), 1e-4)
    assert np.isinf(hit[0])
    assert closest[0] <= 0


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_rays_are_clipped_to_a_turned_box(angle: float):
    c, s = np.cos(angle), np.sin(angle)
    box = OrientedBox(
        np.array([0.1, 0.0, 0.2]), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([0.2, 0.1, 0.4])
    )
    origins = np.array([[0.1, 0.0, -1.0], [0.6, 0.0, -1.0]])
    near, far = clip_to_box(box, origins, np.tile([0.0, 0.0, 1.0], (2, 1)), 0.01)
    np.testing.assert_allclose([near[0], far[0]], [0.99, 1.41], atol=1e-12)
    assert near[1] > far[1]
