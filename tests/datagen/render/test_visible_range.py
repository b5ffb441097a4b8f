import dataclasses

import numpy as np
import pytest

from datagen.errors import UsageError
from datagen.geometry import rigid
from datagen.render import kernels, make_renderer
from datagen.render.renderer import NEAREST
from datagen.render.visible_range import check_range, clip, near_object, table_fault
from datagen.scene import Camera, ShapeSpec
from datagen.schema import MAX_DEPTH
from datagen.shapes import build
from tests.worlds import rendered

SPHERE = build(ShapeSpec("sphere", {"radius": 0.04}))
CUP = build(ShapeSpec("torus", {"ring_radius": 0.2, "tube_radius": 0.02}))
FIELD = float(np.radians(60))


def camera(position: tuple[float, float, float], target: tuple[float, float, float], field: float = FIELD) -> Camera:
    return Camera(position, target, field)


def pose(x: float, y: float, z: float) -> np.ndarray:
    return rigid(np.array([[[x, y, z]]]), np.array([[[1.0, 0.0, 0.0, 0.0]]]))


def test_the_kernels_cut_away_what_is_nearer():
    assert kernels.NEAR == NEAREST


@pytest.mark.parametrize(
    ("gap", "is_near"), [(-0.09, False), (-0.04, True), (0.0, True), (0.049, True), (0.0502, False), (0.1, False)]
)
def test_a_ball_before_the_camera_is_near_up_to_five_centimetres(gap: float, is_near: bool):
    # From behind the camera, through it, to a gap before it.
    eye = camera((0.0, 0.0, 0.5), (1.0, 0.0, 0.5))
    found = near_object(eye, [SPHERE], pose(gap + 0.04, 0.0, 0.5), 64, 64)
    assert found == ((0, 0) if is_near else None)


def test_near_is_what_is_in_the_image_and_nothing_else():
    eye = camera((0.0, 0.0, 0.5), (1.0, 0.0, 0.5))
    beside = pose(0.04, 0.1, 0.5)
    assert near_object(eye, [SPHERE], beside, 64, 64) is None
    assert near_object(eye, [SPHERE], beside, 256, 64) == (0, 0), "a wide image also shows what lies beside the frame"
    wide = dataclasses.replace(eye, field_of_view=float(np.radians(150)))
    assert near_object(wide, [SPHERE], beside, 64, 64) == (0, 0)
    # In the hole of a ring nothing is near, although its centre is.
    assert near_object(camera((0.0, 0.0, 0.5), (0.5, 0.0, 0.5)), [CUP], pose(0.0, 0.0, 0.5), 64, 64) is None


def test_the_frame_in_which_an_object_comes_near_is_named():
    eye = camera((0.0, 0.0, 0.5), (1.0, 0.0, 0.5))
    way = np.concatenate([pose(1.0, 0.0, 0.5), pose(0.5, 0.0, 0.5), pose(0.07, 0.0, 0.5)])
    poses = np.concatenate([pose(2.0, 0.0, 0.5).repeat(3, 0), way], axis=1)
    assert near_object(eye, [SPHERE, SPHERE], poses, 64, 64) == (2, 1)


@pytest.mark.parametrize("seed", range(30))
def test_near_is_where_the_renderer_would_cut(seed: int):
    rng = np.random.default_rng(seed)
    shape = build(ShapeSpec("box", {"size": [0.3, 0.02, 0.05]}))
    eye = camera((0.0, 0.0, 0.5), (1.0, 0.2, 0.4), float(np.radians(rng.uniform(30, 120))))
    quaternion = rng.normal(size=4)
    place = rigid(np.array([[0.05 * rng.normal(size=3) + (0.05, 0.0, 0.5)]])[0][None], quaternion[None, None])
    world = rendered.scene([(ShapeSpec("box", {"size": [0.3, 0.02, 0.05]}), (0.0, 0.0, 0.0))])
    renderer = make_renderer("raster")
    renderer.load(world, [shape])
    whole = renderer.render(place[0], eye, 48, 48)
    # Rays from the camera that meet the surface at less than the nearest depth.
    rays = np.stack(np.meshgrid(np.arange(48) + 0.5, np.arange(48) + 0.5), -1).reshape(-1, 2)
    k = eye.k(48, 48)
    local = np.concatenate([(rays - k[:2, 2]) / (k[0, 0], k[1, 1]), np.ones((len(rays), 1))], axis=1)
    depths = np.linspace(1e-4, NEAREST, 200)
    points = eye.world_from_camera[:3, 3] + (local[:, None] * depths[None, :, None]) @ eye.world_from_camera[:3, :3].T
    inside = shape.signed_distance((points.reshape(-1, 3) - place[0, 0, :3, 3]) @ place[0, 0, :3, :3]) < 0
    if np.any(inside):
        assert near_object(eye, [shape], place, 48, 48) == (0, 0)
    elif near_object(eye, [shape], place, 48, 48) is None:
        assert np.min(whole.depth[whole.segmentation > 0], initial=1.0) > NEAREST


@pytest.mark.parametrize(
    ("eye", "fault"),
    [
        (camera((1.0, 0.0, 0.5), (0.0, 0.0, 0.0)), None),
        (camera((1.0, 0.0, 0.1), (0.0, 0.0, 0.1)), None),
        (camera((0.5, 0.0, -0.1), (0.0, 0.0, 0.0)), "10.0 cm below the table"),
        (camera((0.5, 0.0, 0.0), (0.0, 0.1, 0.0)), "0.0 cm below the table"),
        (camera((0.5, 0.0, 0.02), (0.0, 0.0, 0.0)), "sees the table from 3"),
        (camera((1.2, 0.0, 0.02), (2.0, 0.0, 0.02)), None),
        (camera((5.5, 0.0, 2.0), (0.0, 0.0, 0.0)), "sees the table at 6.7"),
        (camera((5.5, 0.0, 2.0), (9.0, 0.0, 2.0)), None),
    ],
)
def test_the_table_must_be_seen_from_above_and_within_range(eye: Camera, fault: str | None):
    found = table_fault(eye, 2.0, 64, 64)
    assert found is None if fault is None else fault in (found or "")


def test_a_higher_image_shows_the_table_from_nearer():
    eye = camera((0.5, 0.0, 0.08), (0.0, 0.0, 0.05))
    assert table_fault(eye, 2.0, 64, 64) is None
    assert "sees the table from" in (table_fault(eye, 2.0, 16, 128) or "")


def test_the_part_of_a_polygon_behind_planes():
    square = np.array([[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])
    half = clip(square, np.array([[1.0, 0.0, 0.0]]))
    assert sorted(map(tuple, half.tolist())) == [(-1, -1, 1), (-1, 1, 1), (0, -1, 1), (0, 1, 1)]
    assert len(clip(square, np.array([[1.0, 0.0, 2.0]]))) == 0
    np.testing.assert_array_equal(clip(square, np.array([[1.0, 0.0, -2.0]])), square)


def test_scenes_that_cannot_be_rendered_are_refused_with_the_settings_to_change():
    world = rendered.scene()
    shapes = [build(body.shape) for body in world.bodies]
    poses = rendered.trajectory(world).world_from_object
    check_range(world, shapes, poses, (64, 64))
    inside = dataclasses.replace(world, cameras=(camera((0.2, -0.05, 0.03), (0.5, 0.0, 0.0)),))
    with pytest.raises(UsageError, match=r"Camera 0 is inside object 1 in frame 0, .*--rig.distance"):
        check_range(inside, shapes, poses, (64, 64))
    far = dataclasses.replace(world, cameras=(camera((0.0, 7.0, 2.0), (0.0, 0.0, 0.0)),))
    with pytest.raises(UsageError, match=f"expected at most {MAX_DEPTH:.4f} m"):
        check_range(far, shapes, poses, (64, 64))
