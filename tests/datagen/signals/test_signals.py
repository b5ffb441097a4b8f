"""Facts about flow, tracks, normals, coordinates and amodal masks of a small staged scene."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from datagen.geometry import project, rigid, transform
from datagen.schema import COORDINATE_SCALE, HIDDEN, NORMAL_SCALE, OUTSIDE, SHOWN, SIGNALS, UNKNOWN, SceneRecord
from datagen.storage.reader import Dataset
from datagen.storage.run_lengths import decode_mask
from datagen.verify import verify_record
from tests.worlds import moving_cameras, rendered

SPHERE = 3


@pytest.fixture(scope="module")
def still() -> SceneRecord:
    return rendered.record(rendered.scene(), signals=SIGNALS)


@pytest.fixture(scope="module")
def moving() -> SceneRecord:
    return rendered.record(moving_cameras.orbiting(), signals=SIGNALS)


def poses(record: SceneRecord, row: int) -> np.ndarray:
    return rigid(record["poses/position"][:, row], record["poses/quaternion_wxyz"][:, row])


def world_from_camera(record: SceneRecord, frame: int) -> np.ndarray:
    paths = record.get("camera/world_from_camera_of_frame")
    return record["camera/world_from_camera"][0] if paths is None else paths[frame, 0]


def test_a_clip_without_surfaces_has_points_that_are_hidden_everywhere(still: SceneRecord, tmp_path: Path):
    scene = rendered.scene()
    away = dataclasses.replace(scene, cameras=(dataclasses.replace(scene.cameras[0], target=(2.0, 0.0, 3.0)),))
    record = rendered.record(away, signals=["tracks"])
    assert not np.any(record["depth"])
    assert np.all(record["tracks/occluded"])
    assert verify_record(record, (*rendered.GROUPS, "tracks")) == []
    other = {name: array for name, array in still.items() if name in record}
    rendered.write_dataset(tmp_path, [record, other])
    for read, written in zip(Dataset(tmp_path).split("train"), (record, other), strict=True):
        for name, array in written.items():
            np.testing.assert_array_equal(read[name], array, err_msg=name)
    record["tracks/occluded"][0, 5, 0] = 0
    (found,) = verify_record(record, (*rendered.GROUPS, "tracks"))
    assert "visible in a clip that shows no surface" in found.message


def test_signals_leave_the_other_arrays_as_they_are(still: SceneRecord):
    plain = rendered.record(rendered.scene())
    assert set(plain) < set(still)
    for name, array in plain.items():
        np.testing.assert_array_equal(array, still[name], err_msg=name)


def test_the_table_does_not_flow_before_a_camera_that_stands(still: SceneRecord):
    table = still["segmentation"][0] == 0
    assert np.max(np.abs(still["flow/forward"][0][table])) < 1e-3


def test_there_is_no_flow_beyond_the_clip(still: SceneRecord):
    for name, frame in (("forward", -1), ("backward", 0)):
        assert np.all(still[f"flow/{name}_occlusion"][frame] == UNKNOWN)
        assert not np.any(still[f"flow/{name}"][frame])
        assert not np.any(still[f"flow/{name}_occlusion"][1] == UNKNOWN)


@pytest.mark.parametrize("world", ["still", "moving"])
def test_backward_flow_leads_back(world: str, request: pytest.FixtureRequest):
    record = request.getfixturevalue(world)
    shown = (record["flow/forward_occlusion"][0, 0] == SHOWN) & (record["segmentation"][0, 0] > 0)
    y, x = np.nonzero(shown)
    ends = np.stack([x, y], axis=1) + 0.5 + record["flow/forward"][0, 0][shown]
    column, row = np.clip(np.floor(ends).astype(int), 0, 63).T
    same = record["segmentation"][1, 0, row, column] == record["segmentation"][0, 0][shown]
    back = ends + record["flow/backward"][1, 0, row, column]
    error = np.abs(back - (np.stack([x, y], axis=1) + 0.5))[same]
    assert np.count_nonzero(same) > 0.8 * len(same)
    assert np.median(error) < 0.15, "the nearest pixel's flow differs by less than a fraction of a pixel"


def test_table_that_a_moving_object_covers_or_has_covered_is_hidden(still: SceneRecord):
    for name, frame, other in (("forward", 0, 1), ("backward", 1, 0)):
        table = still["segmentation"][frame, 0] == 0
        covered = still["segmentation"][other, 0][table] > 0
        assert np.any(covered)
        np.testing.assert_array_equal(still[f"flow/{name}_occlusion"][frame, 0][table] == HIDDEN, covered)


def test_points_that_leave_the_image_are_outside(moving: SceneRecord):
    outside = moving["flow/forward_occlusion"][0, 0] == OUTSIDE
    y, x = np.nonzero(outside)
    ends = np.stack([x, y], axis=1) + 0.5 + moving["flow/forward"][0, 0][outside]
    assert len(ends) > 10
    assert np.all(np.any((ends < 0.05) | (ends > 63.95), axis=1))


def test_a_spheres_normals_point_away_from_its_centre(moving: SceneRecord):
    own = moving["segmentation"][1, 0] == SPHERE
    camera = world_from_camera(moving, 1)
    normals = moving["normals"][1, 0][own] / NORMAL_SCALE @ camera[:3, :3].T
    box = {name: moving[f"objects/minimum_box_{name}"][SPHERE - 1] for name in ("center", "rotation", "size")}
    inside = moving["object_coordinates"][1, 0][own] / COORDINATE_SCALE - 0.5
    local = box["center"] + (inside * box["size"]) @ box["rotation"].T
    radial = transform(poses(moving, SPHERE - 1)[1], local) - moving["poses/position"][1, SPHERE - 1]
    np.testing.assert_allclose(np.sqrt(np.sum(radial**2, axis=1)), 0.04, atol=1e-4)
    assert np.max(np.abs(normals - radial / 0.04)) < 0.02


def test_normals_of_the_table_point_up(moving: SceneRecord):
    table = (moving["segmentation"][2, 0] == 0) & (moving["depth"][2, 0] > 0)
    normals = moving["normals"][2, 0][table] / NORMAL_SCALE @ world_from_camera(moving, 2)[:3, :3].T
    np.testing.assert_allclose(normals, np.broadcast_to([0, 0, 1], normals.shape), atol=1e-4)


def test_amodal_masks_hold_the_visible_pixels_and_as_many_as_counted(still: SceneRecord):
    for row in range(3):
        mask = decode_mask(bytes(still["amodal/rle"][0, 0, row]), 64, 64)
        assert np.all(mask[still["segmentation"][0, 0] == row + 1])
        assert np.count_nonzero(mask) == still["visibility/amodal_pixels"][0, 0, row]
    assert bytes(still["amodal/rle"][0, 0, 3]) == b"", "there is no fourth object"


def test_tracks_are_rigid_and_project_to_their_places(moving: SceneRecord):
    row = moving["tracks/object"].astype(int) - 1
    assert set(row) == {-1, 0, 1, 2}
    for frame in range(3):
        world = moving["tracks/position_3d"][:, frame].astype(float)
        pixels, _ = project(world, moving["camera/K"][0], world_from_camera(moving, frame))
        np.testing.assert_allclose(moving["tracks/position_2d"][0, :, frame], pixels, atol=1e-2)
    for place in range(3):
        first, last = poses(moving, place)[[0, 2]]
        start = moving["tracks/position_3d"][row == place, 0].astype(float)
        moved = transform(last @ np.linalg.inv(first), start)
        np.testing.assert_allclose(moved, moving["tracks/position_3d"][row == place, 2], atol=1e-6)


def test_every_track_shows_where_it_was_chosen(moving: SceneRecord):
    frame, point = moving["tracks/query"][:, 0].astype(int), np.arange(len(moving["tracks/query"]))
    assert not np.any(moving["tracks/occluded"][0, point, frame])
    places = moving["tracks/position_2d"][0, point, frame]
    np.testing.assert_allclose(places, moving["tracks/query"][:, [2, 1]], atol=1e-3)
