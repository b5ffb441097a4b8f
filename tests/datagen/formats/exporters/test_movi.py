from pathlib import Path

import numpy as np
import pytest

from datagen.formats.exporters import movi
from datagen.geometry import rotation_from_quaternion
from tests.datagen.formats.conftest import Export, source


def read(folder: Path, name: str) -> dict[str, np.ndarray]:
    with np.load(folder / "train" / f"{name}.npz", allow_pickle=False) as file:
        return dict(file)


def test_images_are_the_dataset_s(clips: Path, exported: Export):
    clip, scene = read(exported(clips, "movi"), "000000"), source(clips)
    np.testing.assert_array_equal(clip["video"], scene.rgb[:, 0])
    np.testing.assert_array_equal(clip["segmentations"][..., 0], scene.segmentation[:, 0])


def test_points_from_kubric_s_camera_and_distance_are_the_scene_s(stills: Path, exported: Export):
    """Kubric's camera looks along -z with y up; its depth is the distance to the camera's centre."""
    scene, folder = source(stills), exported(stills, "movi")
    for view in range(2):
        clip = read(folder, f"000000-{view}")
        low, high = clip["metadata/depth_range"]
        distance = clip["depth"][0, ..., 0] / 65535 * (high - low) + low
        height, width = distance.shape
        focal = clip["camera/focal_length"] / clip["camera/sensor_width"] * width
        x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
        rays = np.stack([x / focal, -y / focal, -np.ones_like(x)], axis=-1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        turn = rotation_from_quaternion(clip["camera/quaternions"][0].astype(np.float64))
        points = distance[..., None] * rays @ turn.T + clip["camera/positions"][0]
        table = (scene.segmentation[0, view] == 0) & (scene.depth[0, view] > 0)
        assert np.max(np.abs(points[table][:, 2])) < 2e-4
        box = points[clip["segmentations"][0, ..., 0] == 1]
        assert np.max(np.abs(box[:, :2] - clip["instances/positions"][0, 0, :2])) < 0.08


@pytest.mark.parametrize(("dataset", "index", "view", "objects"), [("clips", 1, 0, 2), ("stills", 0, 1, 3)])
def test_boxes_and_positions_are_fractions_of_the_image(
    dataset: str, index: int, view: int, objects: int, request: pytest.FixtureRequest
):
    scene = source(request.getfixturevalue(dataset), index)
    arrays, (width, height) = movi.clip_arrays(scene, view), scene.size
    assert np.shape(arrays["instances/bboxes"]) == (objects, scene.frames, 4)
    assert arrays["metadata/num_instances"] == objects
    for row, place in np.ndindex(objects, scene.frames):
        frame = arrays["instances/bbox_frames"][row, place]
        mask = scene.segmentation[frame, view] == row + 1
        assert arrays["instances/visibility"][row, frame] == np.count_nonzero(mask)
        rows, columns = np.nonzero(mask)
        edges = (rows.min() / height, columns.min() / width, (rows.max() + 1) / height, (columns.max() + 1) / width)
        np.testing.assert_allclose(arrays["instances/bboxes"][row, place], edges, rtol=1e-6)
        x, y = arrays["instances/image_positions"][row, frame]
        assert edges[1] <= x <= edges[3]
        assert edges[0] <= y <= edges[2]


def test_frames_without_an_object_leave_its_lists(clips: Path):
    scene = source(clips)
    hidden = scene.segmentation.copy()
    hidden[1][hidden[1] == 2] = 0
    scene.segmentation = hidden
    boxes = movi.clip_arrays(scene, 0)["instances/bbox_frames"]
    assert boxes[1].tolist() == [0, 2, -1]


def test_collisions_name_pairs_and_the_floor(clips: Path):
    scene = source(clips)
    impulse = np.zeros((3, 5, 5), np.float32)
    impulse[1, 0, 2] = impulse[1, 2, 0] = 0.5
    impulse[2, 1, 3] = impulse[2, 3, 1] = 0.25
    scene._arrays["contacts/impulse"] = impulse
    arrays = movi.clip_arrays(scene, 0)
    assert np.asarray(arrays["events/collisions/instances"]).tolist() == [[movi.FLOOR, 1], [0, 2]]
    assert np.asarray(arrays["events/collisions/frame"]).tolist() == [1, 2]
    assert np.asarray(arrays["events/collisions/force"]).tolist() == [0.5, 0.25]


def test_flow_spans_its_range(clips: Path):
    flow = np.random.default_rng(0).normal(0, 3, (3, 64, 64, 2)).astype(np.float32)
    scene = source(clips)
    scene._fields |= {"flow/backward"}
    scene._arrays["flow/backward"] = flow[:, None]
    arrays = movi.clip_arrays(scene, 0)
    low, high = arrays["metadata/backward_flow_range"]
    decoded = arrays["backward_flow"] / 65535 * (high - low) + low
    np.testing.assert_allclose(decoded[..., ::-1], flow, atol=(high - low) / 65535)
    assert "forward_flow" not in arrays


def test_normals_are_in_world_axes(clips: Path):
    scene = source(clips)
    normals = np.zeros((3, 1, 64, 64, 3), np.int16)
    normals[:] = np.rint(32767 * scene.world_from_camera[0, 0, 2, :3])  # the world's z in camera axes
    scene._fields |= {"normals"}
    scene._arrays["normals"] = normals
    decoded = movi.clip_arrays(scene, 0)["normal"] / 65535 * 2 - 1
    np.testing.assert_allclose(decoded, np.broadcast_to([0, 0, 1], decoded.shape), atol=1e-4)


def test_moving_cameras_have_their_pose_in_every_frame(clips: Path):
    scene = source(clips)
    poses = np.tile(scene.world_from_camera[0, 0], (3, 1, 1, 1))
    poses[:, 0, 0, 3] += [0.0, 0.1, 0.2]
    scene._fields |= {"camera/world_from_camera_of_frame"}
    scene._arrays["camera/world_from_camera_of_frame"] = poses
    del scene.__dict__["world_from_camera"]
    positions = movi.clip_arrays(scene, 0)["camera/positions"]
    np.testing.assert_allclose(np.diff(positions[:, 0]), 0.1, atol=1e-6)
