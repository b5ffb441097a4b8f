import numpy as np
import pytest

from datagen.config import load_recipe, recipe_to_dict
from datagen.errors import UsageError
from datagen.pipeline.make_scene import make_scene, renderer_identity
from datagen.schema import DEPTH_SCALE
from datagen.storage.spec import make_spec
from datagen.verify import pixels, verify_record
from datagen.verify.scene_case import OPENGL, PRECISION, Allowed, Precision, make_case, rounding
from tests.worlds import rendered


def test_a_step_of_depth_is_longer_along_rays_at_the_side():
    rays = np.array([[0.0, 0.0, 1.0], [3.0, 0.0, 1.0], [0.0, -4.0, 3.0]])
    np.testing.assert_allclose(rounding(rays, 0.5), 0.5 * DEPTH_SCALE * np.array([1, 10**0.5, 5]))


def test_errors_of_a_renderer_grow_with_depth():
    precision = Precision(snap=1 / 256, depth_steps=1e-6)
    np.testing.assert_allclose(precision.sideways(np.array([1.0, 2.0]), 128.0), [1 / 32768, 1 / 16384])
    np.testing.assert_allclose(precision.buffer(np.array([1.0, 2.0])), [1e-6, 4e-6])
    assert PRECISION["raster"].sideways(np.array([5.0]), 10.0) == 0


def test_what_opengl_may_move_is_a_finding_for_all_others():
    record = rendered.record(rendered.scene(frames=1), resolution=(16, 16))
    rows = record["segmentation"] == 1
    for steps, renderers in [(3, {*PRECISION} - {"pyrender"}), (50, {*PRECISION})]:
        moved = {**record, "depth": (record["depth"] + steps * rows).astype(np.uint16)}
        found = {name for name in PRECISION if any(f.check == "surface" for f in verify(moved, name))}
        assert found == renderers


def verify(record, renderer: str):
    return verify_record(record, rendered.GROUPS, renderer=renderer)


def test_a_pixel_beside_an_outline_may_carry_the_depth_of_an_extended_triangle():
    record = rendered.record(rendered.scene(frames=1), resolution=(64, 64))
    case = make_case(record, Allowed(precision=OPENGL))
    pose, radius = case.world_from_object[0, 2], 0.04
    center = pose[:3, 3] - case.center(0)
    distance = np.sqrt(center @ center)
    across = np.cross(center, [0.0, 0.0, 1.0])
    across /= np.sqrt(across @ across)
    axis = record["camera/world_from_camera"][0, :3, 2]

    def ray(miss: float) -> np.ndarray:
        """A ray per unit of depth that passes the ball at a distance from its surface."""
        angle = np.arcsin((radius + miss) / distance)
        direction = np.cos(angle) * center / distance + np.sin(angle) * across
        return direction / (direction @ axis)

    beside, inside, away = ray(2e-5), ray(-5e-4), ray(1e-3)
    rays = np.stack([beside, inside, away])
    touching = np.sqrt(distance**2 - radius**2)
    depth = touching * (rays @ axis) / np.sqrt(np.sum(rays**2, axis=1)) + 0.008
    grazes = pixels._grazes(case, 2, 0, 0, rays, depth)
    assert grazes.tolist() == [True, False, False]


@pytest.mark.parametrize("renderer", ["raster", "pyrender", "another"])
def test_clean_scenes_give_no_finding_whoever_rendered_them(renderer: str):
    record = rendered.record(rendered.scene(frames=2, views=2), resolution=(32, 32))
    assert verify(record, renderer) == []


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_scene_in_which_opengl_covers_a_pixel_beside_an_outline_is_verified():
    pytest.importorskip("pybullet", reason="simulation needs PyBullet")
    try:
        identity = renderer_identity("pyrender")
    except UsageError as error:
        pytest.skip(str(error))
    recipe = recipe_to_dict(load_recipe("static"))
    spec = make_spec(recipe, seed=0, splits={"test": 6}, resolution=(64, 64), renderer=identity)
    assert verify(make_scene(spec, "test", 5), "pyrender") == []
