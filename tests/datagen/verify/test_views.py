import numpy as np
import pytest

from datagen.scene import Scene, ShapeSpec
from datagen.schema import DEPTH_SCALE, SceneRecord
from datagen.verify import views
from datagen.verify.scene_case import make_case
from tests.worlds import rendered

GEAR = ShapeSpec("gear", {"teeth": 8, "outer_radius": 0.12, "inner_radius": 0.08, "tooth_share": 0.5, "height": 0.02})


def world(count: int = 2) -> Scene:
    return rendered.scene(views=count, frames=1)


def found(record: SceneRecord) -> list[str]:
    return [finding.message for finding in views.check_views(make_case(record))]


def test_patches_lie_on_the_planes_that_they_show():
    case = make_case(rendered.record(world(1)))
    patches = views.find_patches(case, 0, 0)
    assert len(patches.label) > 500
    pose = case.record["camera/world_from_camera"][0]
    points = pose[:3, 3] + patches.middle @ pose[:3, :3].T
    on_table = patches.label == 0
    assert np.max(np.abs(points[on_table, 2])) < DEPTH_SCALE
    np.testing.assert_allclose(np.sum(patches.plane * patches.middle, axis=1), 1, atol=1e-9)
    normals = patches.plane[on_table] @ pose[:3, :3].T
    normals /= np.sqrt(np.sum(normals**2, axis=1, keepdims=True))
    assert np.min(np.abs(normals[:, 2])) > 0.98


def test_patches_have_one_label_and_no_edge():
    record = rendered.record(world(1))
    before = len(views.find_patches(make_case(record), 0, 0).label)
    record["segmentation"][0, 0, 5, 5] = 1
    record["depth"][0, 0, 5, 20] += 20
    assert len(views.find_patches(make_case(record), 0, 0).label) == before - 18


def test_a_view_that_looks_through_a_surface_is_found():
    record = rendered.record(world())
    assert found(record) == []
    hole = record["depth"][0, 1, 45:57, 28:40]
    hole += (0.05 / DEPTH_SCALE * np.ones_like(hole)).astype(np.uint16)
    (message,) = found(record)
    assert "view 1 also covers lie in front of what it shows" in message


def test_an_object_that_one_view_shows_with_another_label_is_found():
    record = rendered.record(world())
    ids = record["segmentation"][0, 1]
    ids[ids == 1] = 2
    one, other = found(record)
    assert "patches with id 1 that view 1 also covers carry another label there" in one
    assert "patches with id 2 that view 0 also covers carry another label there" in other


def test_what_shows_in_one_view_and_between_the_pixels_of_another_is_no_contradiction():
    # Pegs of 8 mm in images whose pixels are 6 cm wide.
    peg = ShapeSpec("box", {"size": [0.008, 0.008, 0.08]})
    pegs = [(peg, (0.2 + 0.06 * x, -0.1 + 0.06 * y, 0.04)) for x in range(2) for y in range(2)]
    assert found(rendered.record(rendered.scene(pegs, views=6, frames=1), resolution=(12, 12))) == []


@pytest.mark.parametrize("size", [(10, 10), (16, 12), (24, 24)])
def test_gaps_between_teeth_are_no_contradiction(size: tuple[int, int]):
    gears = [(GEAR, (0.28, 0.0, 0.01 + 0.1 * level)) for level in range(3)]
    assert found(rendered.record(rendered.scene(gears, views=8, frames=1), resolution=size)) == []
