import dataclasses
import json

import numpy as np
import pytest

from datagen import schema
from datagen.config import Sensor
from datagen.errors import UsageError
from datagen.geometry import project
from datagen.pipeline.records import pixel_record, scene_and_trajectory, simulation_record, with_scene
from datagen.render.renderer import Image
from datagen.scene import Camera
from datagen.shapes import build
from tests.worlds import rendered

WORLD = rendered.scene(views=2)
RECORD = rendered.record(WORLD, sensor=True)
COUNT = len(WORLD.bodies)


def test_scene_and_trajectory_survive_the_record():
    scene, trajectory = scene_and_trajectory(RECORD)
    expected = rendered.trajectory(WORLD)
    assert scene == WORLD
    for name in (
        "position",
        "quaternion_wxyz",
        "linear_velocity",
        "angular_velocity",
        "contact_gap",
        "contact_impulse",
    ):
        np.testing.assert_array_equal(getattr(trajectory, name), getattr(expected, name))


def test_the_record_of_what_was_read_is_the_same_record():
    scene, trajectory = scene_and_trajectory(RECORD)
    built = [build(body.shape) for body in scene.bodies]
    again = simulation_record(scene, built, trajectory, rows=rendered.ROWS, attempts=1, rejections={})
    assert schema.scene_hash(again) == schema.scene_hash({name: RECORD[name] for name in again})


def test_rows_that_are_not_in_use_are_padding():
    assert RECORD["objects/count"] == COUNT == rendered.ROWS - 1
    for name in RECORD:
        for axis, kind in enumerate(schema.FIELDS[name].axes):
            if kind in ("object", "object+1"):
                spare = RECORD[name].take(-1, axis)
                padding = {"S": b"", "f": np.inf if name == "contacts/gap" else 0}.get(spare.dtype.kind, 0)
                assert np.all(spare == padding), name


def test_visible_pixels_are_counted_and_never_exceed_amodal_ones():
    segmentation, visible = RECORD["segmentation"], RECORD["visibility/visible_pixels"]
    for frame, view, row in np.ndindex(3, 2, COUNT):
        assert visible[frame, view, row] == np.sum(segmentation[frame, view] == row + 1)
    amodal, fraction = RECORD["visibility/amodal_pixels"], RECORD["visibility/visible_fraction"]
    assert np.all(visible <= amodal)
    np.testing.assert_allclose(fraction[..., :COUNT], visible[..., :COUNT] / amodal[..., :COUNT], rtol=1e-6)


def test_a_2d_box_is_the_smallest_one_around_the_visible_pixels():
    for frame, view, row in np.ndindex(3, 2, COUNT):
        y, x = np.nonzero(RECORD["segmentation"][frame, view] == row + 1)
        expected = (x.min(), y.min(), x.max() + 1, y.max() + 1)
        assert tuple(RECORD["boxes/box_2d"][frame, view, row]) == expected


def test_an_object_out_of_view_has_an_empty_box_and_no_visible_fraction():
    world = rendered.scene([*rendered.STANDING[:2], (rendered.SPHERE, (0.28, 0.6, 0.04))])
    record = rendered.record(world)
    assert np.all(record["boxes/box_2d"][:, :, 2] == 0)
    assert np.all(record["visibility/visible_fraction"][:, :, 2] == 0)
    assert np.all(record["boxes/box_2d"][:, :, 0].any(axis=-1))


def test_a_3d_box_holds_what_is_seen_of_the_object():
    for frame, view, row in np.ndindex(3, 2, COUNT):
        corners, k = RECORD["boxes/box_3d"][frame, row].astype(np.float64), RECORD["camera/K"][view]
        pixels, depth = project(corners, k, RECORD["camera/world_from_camera"][view])
        x0, y0, x1, y1 = RECORD["boxes/box_2d"][frame, view, row]
        assert np.all(pixels.min(axis=0) <= (x0 + 0.5, y0 + 0.5))
        assert np.all(pixels.max(axis=0) >= (x1 - 0.5, y1 - 0.5))
        seen = schema.decode_depth(RECORD["depth"][frame, view])[RECORD["segmentation"][frame, view] == row + 1]
        assert depth.min() - 1e-4 <= seen.min() <= seen.max() <= depth.max() + 1e-4


def test_mass_is_density_times_volume_and_parameters_build_the_shape_again():
    for row, body in enumerate(WORLD.bodies):
        shape = build(body.shape)
        assert RECORD["objects/mass"][row] == pytest.approx(body.density * shape.volume)
        assert json.loads(RECORD["objects/parameters"][row]) == {
            "family": body.shape.family,
            "parameters": body.shape.parameters,
        }


def test_other_cameras_change_the_description_and_the_poses_alone():
    camera = Camera((1.0, 0.5, 1.0), (0.0, 0.0, 0.0), 0.5)
    world = dataclasses.replace(WORLD, cameras=(camera,))
    changed = with_scene(RECORD, world)
    assert scene_and_trajectory(changed)[0] == world
    assert {name for name in RECORD if not np.array_equal(RECORD[name], changed[name])} == {
        "camera/world_from_camera",
        "scene/description",
    }


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("objects/count", lambda count: count + 1, "objects in"),
        ("poses/position", lambda position: position[:-1], "frames"),
        ("poses/position", lambda position: position * np.float32(np.nan), "poses/position holds values"),
        ("poses/quaternion_wxyz", lambda quaternion: quaternion / np.float32(0), "poses/quaternion_wxyz holds values"),
        ("scene/description", lambda _text: np.asarray(b"[" * 1000), "nested"),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_description_that_does_not_fit_its_poses_is_an_error(name: str, change, message: str):
    with pytest.raises(ValueError, match=message):
        scene_and_trajectory({**RECORD, name: np.asarray(change(RECORD[name]))})


class Far:
    """A renderer that sees nothing but a wall 7 m away."""

    name, version = "far", 1

    def load(self, scene, shapes) -> None:
        pass

    def render(self, world_from_object, camera, width: int, height: int) -> Image:
        depth = np.full((height, width), 7, np.float32)
        ids = np.zeros((height, width), np.uint8)
        return Image(np.zeros((height, width, 3), np.uint8), depth, ids, np.zeros(len(world_from_object), int))


def test_a_depth_beyond_the_format_is_an_error_and_never_wraps():
    with pytest.raises(UsageError, match=r"7\.000 m do not fit the format, which holds 0 to 6\.55"):
        rendered.record(WORLD, renderer=Far())


def test_sensor_noise_comes_from_the_generator_alone():
    built = [build(body.shape) for body in WORLD.bodies]
    path = rendered.trajectory(WORLD)

    def sensed(seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        sensor = Sensor(enabled=True)
        record = pixel_record(
            WORLD, built, path, rendered.make_renderer("raster"), resolution=(32, 32), rows=4, sensor=sensor, rng=rng
        )
        return record["sensor_depth"]

    np.testing.assert_array_equal(sensed(0), sensed(0))
    assert np.any(sensed(0) != sensed(1))
    assert np.any(sensed(0)[0] != sensed(0)[1])
