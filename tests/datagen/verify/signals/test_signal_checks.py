"""The checks of signals find their faults, and are silent without cause."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from datagen import shapes
from datagen.meshes.distance import MeshSolid
from datagen.scene import Scene, ShapeSpec
from datagen.schema import HIDDEN, SHOWN, SIGNALS, SceneRecord
from datagen.shapes.shape import Shape
from datagen.storage.run_lengths import decode_mask, encode_mask
from datagen.verify import verify_record
from tests.worlds import moving_cameras, rendered

GROUPS = (*rendered.GROUPS, *SIGNALS)
MOVING = ("simulation", "moving_camera", "pixels", *SIGNALS)


class Triangles:
    """The staged shapes as closed meshes; the file's name is that of the family."""

    def shape(self, parameters: Mapping[str, Any]) -> Shape:
        """The triangles of a staged shape."""
        shape = next(shapes.build(spec) for spec, _ in rendered.STANDING if spec.family == parameters["file"])
        return dataclasses.replace(shape, solids=(MeshSolid(shape.vertices, shape.faces, closed=True),))


def of_meshes(world: Scene) -> Scene:
    """The scene with its shapes as meshes."""
    unread = {"sha256": "0" * 64, "scale": 1.0, "up": "z"}
    specs = [ShapeSpec("mesh", {"file": body.shape.family, **unread}) for body in world.bodies]
    bodies = [dataclasses.replace(body, shape=spec) for body, spec in zip(world.bodies, specs, strict=True)]
    return dataclasses.replace(world, bodies=tuple(bodies))


@pytest.fixture(scope="module", params=["solids", "meshes"])
def clip(request: pytest.FixtureRequest) -> SceneRecord:
    world = moving_cameras.orbiting()
    return rendered.record(
        of_meshes(world) if request.param == "meshes" else world, signals=SIGNALS, meshes=Triangles()
    )


def test_correct_signals_pass(clip: SceneRecord):
    assert verify_record(clip, MOVING, meshes=Triangles()) == []
    assert verify_record(rendered.record(rendered.scene(views=2, frames=2), signals=SIGNALS), GROUPS) == []


def test_a_renderer_that_draws_beside_the_mesh_passes(clip: SceneRecord):
    assert verify_record(clip, MOVING, renderer="pyrender", meshes=Triangles()) == []


def object_pixel(record: SceneRecord) -> tuple[int, ...]:
    y, x = np.argwhere(record["segmentation"][0, 0] > 0)[40]
    return 0, 0, int(y), int(x)


def one_flow(record: SceneRecord, array: np.ndarray) -> None:
    array[(*object_pixel(record), 0)] += 0.1


def swapped(record: SceneRecord, array: np.ndarray) -> None:
    array[...] = array[..., ::-1].copy()


def never_hidden(record: SceneRecord, array: np.ndarray) -> None:
    array[array == HIDDEN] = SHOWN


def always_hidden(record: SceneRecord, array: np.ndarray) -> None:
    array[array == SHOWN] = HIDDEN


def hidden_objects(record: SceneRecord, array: np.ndarray) -> None:
    array[(array == SHOWN) & (record["segmentation"] > 0)] = HIDDEN


def turned(record: SceneRecord, array: np.ndarray) -> None:
    objects = record["segmentation"] > 0
    array[objects] = array[objects][..., [1, 2, 0]]


def in_the_world(record: SceneRecord, array: np.ndarray) -> None:
    rotation = record["camera/world_from_camera_of_frame"][:, 0, :3, :3]
    array[...] = np.einsum("fij,fvhwj->fvhwi", rotation, array)


def one_coordinate(record: SceneRecord, array: np.ndarray) -> None:
    array[(*object_pixel(record), 1)] ^= 1 << 11


def shifted_mask(record: SceneRecord, array: np.ndarray) -> None:
    mask = decode_mask(bytes(array[0, 0, 1]), 64, 64)
    array[0, 0, 1] = encode_mask(np.roll(mask, 1, axis=1))


def no_code(record: SceneRecord, array: np.ndarray) -> None:
    array[0, 0, 1] = b"~~"


def one_place(record: SceneRecord, array: np.ndarray) -> None:
    array.reshape(-1)[7] += 0.1


def lifted(record: SceneRecord, array: np.ndarray) -> None:
    array[record["tracks/object"] > 0, ..., 2] += 0.002


def inverted(record: SceneRecord, array: np.ndarray) -> None:
    array[...] = 1 - array


@pytest.mark.parametrize(
    ("field", "change", "check", "words"),
    [
        ("flow/forward", one_flow, "flow", "1 of 4096 pixels are off"),
        ("flow/backward", swapped, "flow", "pixels are off"),
        ("flow/forward_occlusion", never_hidden, "flow", "count as shown, but lie behind a surface"),
        ("flow/backward_occlusion", always_hidden, "flow", "count as hidden, but nothing lies in front"),
        ("flow/forward_occlusion", hidden_objects, "flow", "count as hidden, but nothing lies in front"),
        ("normals", turned, "normals", "are off by up to"),
        ("normals", in_the_world, "normals", "the table's normal is off"),
        ("object_coordinates", one_coordinate, "coordinates", "1 of"),
        ("amodal/rle", shifted_mask, "amodal", "at its outline"),
        ("amodal/rle", no_code, "amodal", "cannot be decoded"),
        ("tracks/position_3d", one_place, "tracks", "mm in its frame"),
        ("tracks/position_3d", lifted, "tracks", "2.000 mm off its surface"),
        ("tracks/position_2d", one_place, "tracks", "from where their positions project"),
        ("tracks/occluded", inverted, "tracks", "hidden at its query"),
        ("tracks/query", one_place, "tracks", "not where its query is"),
    ],
)
def test_a_wrong_signal_is_found(
    clip: SceneRecord, field: str, change: Callable[[SceneRecord, np.ndarray], None], check: str, words: str
):
    record = {**clip, field: clip[field].copy()}
    change(record, record[field])
    found = [finding for finding in verify_record(record, MOVING, meshes=Triangles()) if finding.check == check]
    assert words in " ".join(finding.message for finding in found)


def test_wrong_poses_of_moving_cameras_are_found(clip: SceneRecord):
    record = {**clip, "camera/world_from_camera_of_frame": clip["camera/world_from_camera_of_frame"].copy()}
    record["camera/world_from_camera_of_frame"][1, 0, 2, 3] += 0.01
    findings = verify_record(record, MOVING, meshes=Triangles())
    assert {"description", "table", "flow"} <= {finding.check for finding in findings}
