"""Each check finds its fault in a staged scene whose other arrays are made to fit, and is silent without cause."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from datagen import geometry, schema, shapes
from datagen.config import Physics, Sensor
from datagen.pipeline import records
from datagen.scene import Camera, Scene, ShapeSpec, scene_from_json
from datagen.schema import SceneRecord
from datagen.sensor import sense
from datagen.verify import verify_record
from datagen.verify.bodies import check_boxes, check_exact_overlap
from datagen.verify.scene_case import make_case
from tests.worlds import rendered

FAMILIES = [
    ShapeSpec("box", {"size": [0.05, 0.05, 0.05]}),
    ShapeSpec("sphere", {"radius": 0.02}),
    ShapeSpec("cylinder", {"radius": 0.03, "height": 0.08}),
    ShapeSpec("frustum", {"low_radius": 0.04, "high_radius": 0.0, "height": 0.08}),
    ShapeSpec("capsule", {"radius": 0.02, "length": 0.06}),
    ShapeSpec("torus", {"ring_radius": 0.04, "tube_radius": 0.015}),
    ShapeSpec("ellipsoid", {"half_axes": [0.05, 0.03, 0.02]}),
]


@pytest.fixture(scope="module")
def video() -> SceneRecord:
    return rendered.record(rendered.scene())


@pytest.fixture(scope="module")
def views() -> SceneRecord:
    return rendered.record(rendered.scene(views=3, frames=1))


def copy(record: SceneRecord) -> SceneRecord:
    return {name: array.copy() for name, array in record.items()}


def checks(record: SceneRecord, groups: tuple[str, ...] = rendered.GROUPS) -> set[str]:
    return {finding.check for finding in verify_record(record, groups)}


def recount(record: SceneRecord) -> SceneRecord:
    """Make all that can be counted in the ids fit them."""
    count = int(record["objects/count"])
    visible = records.visible_pixels(record["segmentation"], count)
    record["visibility/visible_pixels"][..., :count] = visible
    record["visibility/amodal_pixels"][..., :count] = np.maximum(
        record["visibility/amodal_pixels"][..., :count], visible
    )
    fraction = visible / np.maximum(record["visibility/amodal_pixels"][..., :count], 1)
    record["visibility/visible_fraction"][..., :count] = fraction
    record["boxes/box_2d"][:, :, :count] = records.boxes_2d(record["segmentation"], count)
    return record


def rebox(record: SceneRecord) -> SceneRecord:
    """Make the 3D boxes fit the poses."""
    world, path = records.scene_and_trajectory(record)
    built = [shapes.build(body.shape) for body in world.bodies]
    record["boxes/box_3d"][:, : len(built)] = records._boxes_3d(built, path)
    return record


def test_clean_scenes_give_no_finding(video: SceneRecord, views: SceneRecord):
    assert verify_record(video, rendered.GROUPS) == []
    assert verify_record(views, rendered.GROUPS) == []


@pytest.mark.parametrize("shape", FAMILIES, ids=lambda shape: shape.family)
def test_no_family_gives_findings_however_it_lies(shape: ShapeSpec):
    radius = shapes.build(shape).radius
    world = rendered.scene([(shape, (0.15 + 0.2 * x, 0.2 * y, radius + 0.01)) for x in (0, 1) for y in (-0.5, 0.5)])

    def tumbling(world):
        path = rendered.trajectory(world)
        path.quaternion_wxyz[:] = np.random.default_rng(0).normal(size=path.quaternion_wxyz.shape)
        path.quaternion_wxyz[:] /= np.linalg.norm(path.quaternion_wxyz, axis=-1, keepdims=True)
        return path

    record = rendered.record(world, resolution=(128, 128), motion=tumbling)
    assert verify_record(record, rendered.GROUPS) == []


def test_the_table_may_end_within_the_image():
    assert verify_record(rendered.record(rendered.scene(table=0.8)), rendered.GROUPS) == []


def test_sensor_fields_are_checked():
    record = rendered.record(rendered.scene(), sensor=True)
    groups = (*rendered.GROUPS, "sensor")
    assert verify_record(record, groups) == []
    record["sensor_valid"][0, 0, 40, 40] ^= 1
    assert checks(record, groups) == {"sensor"}


def swap_labels(record: SceneRecord) -> None:
    ids = record["segmentation"]
    record["segmentation"] = np.where(ids == 1, 2, np.where(ids == 2, 1, ids)).astype(np.uint8)
    recount(record)


def swap_labels_in_one_frame(record: SceneRecord) -> None:
    part = {**record, "segmentation": record["segmentation"][-1:]}
    ids = part["segmentation"]
    record["segmentation"][-1:] = np.where(ids == 2, 3, np.where(ids == 3, 2, ids))
    recount(record)


def lift_depth(record: SceneRecord) -> None:
    record["depth"] += (10 * (record["depth"] > 0)).astype(np.uint16)


def lift_depth_of_one_object(record: SceneRecord) -> None:
    record["depth"] += (10 * (record["segmentation"] == 3)).astype(np.uint16)


def turn(axis: int) -> Callable[[SceneRecord], None]:
    def turn_the_box(record: SceneRecord) -> None:
        w, xyz = np.cos(np.radians(0.5)), np.sin(np.radians(0.5)) * np.eye(3)[axis]
        for frame in record["poses/quaternion_wxyz"]:
            frame[0] = multiply(np.array([w, *xyz]), frame[0].astype(float))
        rebox(record)

    return turn_the_box


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def shift_camera(axis: int) -> Callable[[SceneRecord], None]:
    def shift_the_principal_point(record: SceneRecord) -> None:
        record["camera/K"][0, axis, 2] += 1

    return shift_the_principal_point


def turn_camera(record: SceneRecord) -> None:
    """By one pixel about its vertical axis, the description along with it."""
    angle = 1 / record["camera/K"][0, 0, 0]
    yaw = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    pose = record["camera/world_from_camera"][0]
    pose[:3, :3] = pose[:3, :3] @ yaw


def erase_an_object(record: SceneRecord) -> None:
    record["segmentation"][record["segmentation"] == 2] = 0
    recount(record)


def paint_over_an_object(record: SceneRecord) -> None:
    """With the table that is behind it, depth and all."""
    mask = record["segmentation"] == 2
    erase_an_object(record)
    pose = record["camera/world_from_camera"][0]
    rays = geometry.pixel_rays(record["camera/K"][0], 64, 64) @ pose[:3, :3].T
    plane = np.broadcast_to(schema.encode_depth(-pose[2, 3] / rays[..., 2]), mask.shape)
    record["depth"] = np.where(mask, plane, record["depth"])


def hide_the_table(record: SceneRecord) -> None:
    record["depth"][:, :, 0, 0] = 0


def move_amodal(record: SceneRecord) -> None:
    record["visibility/amodal_pixels"][0, 0, 1] = record["visibility/amodal_pixels"][0, 0, 1] * 1.3 + 10
    recount(record)


@pytest.mark.parametrize(
    ("tamper", "expected"),
    [
        (swap_labels, "surface"),
        (swap_labels_in_one_frame, "surface"),
        (lift_depth, "table"),
        (lift_depth, "surface"),
        (lift_depth_of_one_object, "surface"),
        (turn(0), "surface"),
        (turn(1), "surface"),
        (turn(2), "surface"),
        (shift_camera(0), "surface"),
        (shift_camera(1), "surface"),
        (shift_camera(1), "table"),
        (turn_camera, "surface"),
        (erase_an_object, "table"),
        (paint_over_an_object, "label"),
        (hide_the_table, "table"),
        (move_amodal, "amodal"),
    ],
)
def test_geometry_tells_what_was_tampered_with(
    video: SceneRecord, tamper: Callable[[SceneRecord], None], expected: str
):
    record = copy(video)
    tamper(record)
    assert expected in checks(record)


def test_a_hidden_object_labelled_instead_of_the_one_before_it_is_found():
    world = rendered.scene([(rendered.SPHERE, (0.34, 0.0, 0.04)), (rendered.BOX, (0.2, 0.0, 0.03))])
    front, alone = rendered.record(world), rendered.record(rendered.scene([(rendered.BOX, (0.2, 0.0, 0.03))]))
    assert verify_record(front, rendered.GROUPS) == []
    behind = alone["segmentation"] == 1
    front["segmentation"][behind] = 2
    front["depth"][behind] = alone["depth"][behind]
    assert checks(recount(front)) == {"label"}


@pytest.mark.parametrize("view", [0, 1, 2])
def test_views_that_disagree_are_found_without_the_shapes(views: SceneRecord, view: int):
    record = copy(views)
    lifted = record["camera/world_from_camera"][view].copy()
    lifted[2, 3] += 0.01
    record["camera/world_from_camera"][view] = lifted
    assert "views" in checks(record)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("visibility/visible_pixels", "counts"),
        ("visibility/visible_fraction", "counts"),
        ("boxes/box_2d", "counts"),
        ("boxes/box_3d", "boxes"),
        ("objects/mass", "description"),
        ("objects/category", "description"),
        ("objects/symmetry", "description"),
        ("objects/minimum_box_size", "description"),
        ("camera/K", "description"),
        ("lights/direction", "description"),
        ("poses/quaternion_wxyz", "poses"),
        ("objects/count", "description"),
    ],
)
def test_every_stored_fact_is_compared(video: SceneRecord, name: str, expected: str):
    record = copy(video)
    first = (0,) * record[name].ndim
    record[name][first] = b"other" if record[name].dtype.kind == "S" else record[name][first] + 1
    assert expected in checks(record)


def test_a_shape_that_reaches_beyond_its_box_is_found(video: SceneRecord):
    case = make_case(video)
    first, *others = case.shapes
    box = dataclasses.replace(first.minimum_box, size=first.minimum_box.size - 4e-4)
    found = check_boxes(dataclasses.replace(case, shapes=[dataclasses.replace(first, minimum_box=box), *others]))
    assert "object 1 reaches 0.200 mm beyond its minimum box" in {finding.message for finding in found}


def test_visible_pixels_are_counted(video: SceneRecord):
    record = copy(video)
    record["visibility/visible_pixels"][0, 0, 0] -= 1
    amodal = record["visibility/amodal_pixels"][0, 0, 0]
    record["visibility/visible_fraction"][0, 0, 0] = record["visibility/visible_pixels"][0, 0, 0] / amodal
    assert checks(record) == {"counts"}


def test_padding_and_finiteness_are_checked(video: SceneRecord):
    record = copy(video)
    record["objects/mass"][3] = 1
    assert checks(record) == {"schema"}
    record = copy(video)
    record["poses/position"][0, 0, 0] = np.nan
    assert checks(record) == {"schema"}


def messages(record: SceneRecord) -> str:
    return "\n".join(finding.message for finding in verify_record(record, rendered.GROUPS))


def test_depth_where_the_table_has_ended_is_found():
    record = rendered.record(rendered.scene(table=0.8))
    beyond = np.argwhere(record["depth"][0, 0] == 0)[0]
    pose = record["camera/world_from_camera"][0]
    rays = geometry.pixel_rays(record["camera/K"][0], 64, 64) @ pose[:3, :3].T
    record["depth"][0, 0][tuple(beyond)] = schema.encode_depth(-pose[2, 3] / rays[..., 2])[tuple(beyond)]
    assert "return a depth beyond the table" in messages(record)


def test_an_object_s_pixel_without_depth_is_found(video: SceneRecord):
    record = copy(video)
    record["depth"][0, 0][tuple(np.argwhere(record["segmentation"][0, 0] == 1)[0])] = 0
    assert "pixels of objects without depth" in messages(record)


def test_an_object_that_reaches_into_the_table_is_found():
    sunk = rendered.scene([(rendered.SPHERE, (0.2, 0.05, 0.034))])
    assert "object 1 reaches 6.06 mm into the table" in messages(rendered.record(sunk))


def test_deep_overlap_is_found_by_contacts_and_by_surfaces():
    world = rendered.scene([(rendered.BOX, (0.2, 0.0, 0.03)), (rendered.SPHERE, (0.2, 0.05, 0.04))])
    assert checks(rendered.record(world)) == {"overlap"}
    record = rendered.record(rendered.scene())
    record["contacts/gap"][0, 1, 2] = record["contacts/gap"][0, 2, 1] = -0.0011
    assert checks(record) == {"overlap"}


@pytest.mark.parametrize(("depth", "is_found"), [(0.0015, False), (0.0025, True)])
def test_surfaces_may_overlap_by_two_millimetres(depth: float, is_found: bool):
    beside = rendered.scene([(rendered.SPHERE, (0.2, 0.0, 0.04)), (rendered.SPHERE, (0.2, 0.08 - depth, 0.04))])
    assert any(check_exact_overlap(make_case(rendered.record(beside)))) == is_found


def test_contacts_of_later_frames_may_be_as_deep_as_the_recipe_says(video: SceneRecord):
    def found(depth: float, physics: Physics) -> list[tuple[str, int | None]]:
        record = copy(video)
        record["contacts/gap"][2, 1, 2] = record["contacts/gap"][2, 2, 1] = -depth
        return [(finding.check, finding.frame) for finding in verify_record(record, rendered.GROUPS, physics)]

    assert found(0.0019, Physics(deepest_in_motion=0.002)) == []
    assert found(0.0021, Physics(deepest_in_motion=0.002)) == [("overlap", 2)]
    assert found(0.0021, Physics(deepest_in_motion=0.003)) == []
    record = copy(video)
    record["contacts/gap"][1, 1, 2] = 0.01
    assert checks(record) == {"overlap"}


def test_nonsense_becomes_a_finding(video: SceneRecord):
    for description in (b"", b"{}", b'{"bodies": [1]}'):
        assert checks({**video, "scene/description": np.asarray(description)}) == {"description"}
    singular = copy(video)
    singular["camera/K"][:] = 0
    assert checks(singular)
    assert checks({name: array for name, array in video.items() if name != "rgb"}) == {"schema"}
    assert scene_from_json(video["scene/description"].item().decode()).frames == 3


def test_the_camera_of_the_checks_is_the_project_s(video: SceneRecord):
    from datagen.verify.scene_case import rigid_poses

    case = make_case(video)
    points = geometry.unproject(
        case.depth(1, 0).astype(np.float32), video["camera/K"][0], video["camera/world_from_camera"][0]
    )
    mine = case.center(0) + case.depth(1, 0)[..., None] * case.rays[0]
    np.testing.assert_allclose(mine, points, atol=1e-6)
    pixels, z = case.project(points.reshape(-1, 3), 0)
    np.testing.assert_allclose(pixels.reshape(64, 64, 2)[10, 20], [20.5, 10.5], atol=1e-3)
    np.testing.assert_allclose(z.reshape(64, 64), case.depth(1, 0), atol=1e-6)
    quaternions = np.random.default_rng(0).normal(size=(5, 2, 4)).astype(np.float32)
    positions = np.zeros((5, 2, 3), np.float32)
    np.testing.assert_allclose(rigid_poses(positions, quaternions), geometry.rigid(positions, quaternions), atol=1e-12)


def wide(field_of_view: float, views: int = 1) -> Scene:
    """The staged scene from half a metre, seen at an angle in degrees."""
    world = rendered.scene(views=views, frames=1)
    cameras = [
        dataclasses.replace(
            camera,
            position=tuple(np.round(0.55 * np.array(camera.position) + (0.13, 0.0, 0.0), 6).tolist()),
            field_of_view=float(np.radians(field_of_view)),
        )
        for camera in world.cameras
    ]
    return dataclasses.replace(world, cameras=tuple(cameras))


WIDE = [(angle, size) for angle in (1, 100, 120, 150, 165) for size in ((64, 64), (40, 9))]
WIDE += [(angle, (9, 40)) for angle in (1, 100, 120)]  # wider ones would show the table from too near


@pytest.mark.parametrize(("field_of_view", "size"), WIDE)
def test_no_angle_of_view_gives_findings(field_of_view: float, size: tuple[int, int]):
    record = rendered.record(wide(field_of_view, views=2), resolution=size)
    assert verify_record(record, rendered.GROUPS) == []


@pytest.mark.parametrize("field_of_view", [100, 120, 150])
@pytest.mark.parametrize(
    ("tamper", "expected"),
    [(lift_depth, "table"), (lift_depth_of_one_object, "surface"), (turn(1), "surface"), (swap_labels, "surface")],
)
def test_wide_views_are_still_checked(field_of_view: float, tamper: Callable[[SceneRecord], None], expected: str):
    record = rendered.record(wide(field_of_view), resolution=(96, 96))
    tamper(record)
    assert expected in checks(record)


@pytest.mark.parametrize("size", [(8, 8), (12, 9), (16, 16), (31, 8)])
@pytest.mark.parametrize("views", [3, 24])
def test_small_images_of_many_views_give_no_finding(size: tuple[int, int], views: int):
    record = rendered.record(rendered.scene(views=views, frames=1), resolution=size)
    assert verify_record(record, rendered.GROUPS) == []


@pytest.mark.parametrize(("size", "views"), [((16, 16), 3), ((24, 24), 3), ((24, 24), 24), ((24, 24), 40)])
def test_views_that_disagree_are_found_in_small_images_and_among_many(size: tuple[int, int], views: int):
    record = rendered.record(rendered.scene(views=views, frames=1), resolution=size)
    record["camera/world_from_camera"][1, 2, 3] += 0.01
    assert "views" in checks(record)


def sensed(record: SceneRecord, sensor: Sensor) -> SceneRecord:
    """With the depth of a sensor."""
    rng, depths, masks = np.random.default_rng(0), [], []
    for depth, rgb in zip(record["depth"][:, 0], record["rgb"][:, 0], strict=True):
        noisy, valid = sense(schema.decode_depth(depth), rgb, record["camera/K"][0], sensor, rng)
        depths.append(schema.encode_depth(noisy))
        masks.append(valid.astype(np.uint8))
    return {**copy(record), "sensor_depth": np.stack(depths)[:, None], "sensor_valid": np.stack(masks)[:, None]}


def noise_findings(record: SceneRecord, sensor: Sensor) -> list[str]:
    return [str(finding) for finding in verify_record(record, (*rendered.GROUPS, "sensor"), sensor=sensor)]


@pytest.mark.parametrize(
    ("axial_noise", "quantisation"), [(0.0, 0.0), (0.0019, 0.001), (0.02, 0.0), (0.1, 0.001), (0.0, 0.1), (0.1, 0.1)]
)
def test_every_noise_that_a_recipe_can_have_is_verified(video: SceneRecord, axial_noise: float, quantisation: float):
    for edges, grazing, dark in [(0.5, 75.0, 0.05), (1.0, 0.0, 1.0), (0.0, 90.0, 0.0)]:
        sensor = Sensor(True, axial_noise, edges, grazing, dark, quantisation)
        assert noise_findings(sensed(video, sensor), sensor) == []


@pytest.mark.parametrize("axial_noise", [0.0019, 0.02])
def test_sensor_depth_that_the_noise_does_not_explain_is_found(video: SceneRecord, axial_noise: float):
    sensor = Sensor(enabled=True, axial_noise=axial_noise)
    clean = sensed(video, sensor)
    valid = clean["sensor_valid"].astype(bool)
    biased, one = copy(clean), copy(clean)
    biased["sensor_depth"][valid] = np.rint(clean["sensor_depth"][valid] * 1.02)
    assert any("the median of sensor_depth" in text for text in noise_findings(biased, sensor))
    one["sensor_depth"][tuple(np.argwhere(valid)[0])] *= 2
    assert ["1 pixels are up to" in text for text in noise_findings(one, sensor)] == [True]
    exact = {**clean, "sensor_depth": np.where(valid, clean["depth"], 0).astype(np.uint16)}
    assert noise_findings(exact, sensor) == [], "less noise is no contradiction"


def test_sensor_depth_from_outside_of_the_range_is_found(video: SceneRecord):
    sensor = Sensor(enabled=True)
    record = sensed(video, sensor)
    far = schema.decode_depth(record["depth"][record["sensor_valid"] > 0])
    middle = float(np.median(far))
    for limits in ({"farthest": middle}, {"nearest": middle}):
        found = noise_findings(record, dataclasses.replace(sensor, **limits))
        assert ["outside of the sensor's range" in text for text in found] == [True]


def test_objects_at_the_side_of_a_wide_view_are_verified_and_still_checked():
    ball = ShapeSpec("sphere", {"radius": 0.1})
    camera = Camera((0.0, 0.0, 0.25), (1.0, 0.0, 0.25), float(np.radians(165)), 200 / 60)
    world = rendered.scene([(ball, (0.12, 0.6, 0.1)), (ball, (0.1, -0.5, 0.1))], frames=1)
    record = rendered.record(dataclasses.replace(world, cameras=(camera,)), resolution=(200, 60))
    case = make_case(record)
    sideways = np.sqrt(np.sum(case.rays[0][record["segmentation"][0, 0] > 0] ** 2, axis=-1))
    assert np.max(sideways) > 5
    assert verify_record(record, rendered.GROUPS) == []
    record["depth"] += (10 * (record["segmentation"] == 1)).astype(np.uint16)
    assert "surface" in checks(record)
