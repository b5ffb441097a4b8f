import dataclasses
import importlib.util
import re
import subprocess
import sys
from collections import Counter
from functools import cache

import numpy as np
import pytest

from datagen.config import Layout, Objects, Recipe, load_recipe, names_without_meshes
from datagen.errors import ImpossibleScene, UsageError
from datagen.pipeline import simulate
from datagen.pipeline.simulate import Simulated, check_course, check_room, is_hopeless, simulate_scene
from datagen.render import make_renderer
from datagen.render.visible_range import near_object
from datagen.scene import scene_to_json
from datagen.schema import MAX_DEPTH
from tests.paths import ROOT

pytestmark = pytest.mark.skipif(not importlib.util.find_spec("pybullet"), reason="simulation needs PyBullet")

VIDEO = [name for name in names_without_meshes() if load_recipe(name).video]


def scenes(name: str, count: int, split: str = "train") -> list[Simulated]:
    return [scene(name, split, index) for index in range(count)]


@cache
def scene(name: str, split: str, index: int) -> Simulated:
    return simulate_scene(load_recipe(name), 0, split, index)


def fingerprint(made: Simulated) -> str:
    arrays = "".join(array.tobytes().hex() for array in vars(made.trajectory).values())
    return f"{scene_to_json(made.scene)} {arrays} {made.attempts} {sorted(made.rejections.items())}"


def travel(made: Simulated) -> np.ndarray:
    path = made.trajectory.position[-1] - made.trajectory.position[0]
    return np.sqrt(np.sum(path**2, axis=-1))


def segmentations(made: Simulated, size: tuple[int, int], frame: int = 0) -> list[np.ndarray]:
    renderer = make_renderer("raster")
    renderer.load(made.scene, made.shapes)
    poses = made.trajectory.world_from_object[frame]
    images = [renderer.render(poses, camera, *size) for camera in made.scene.cameras]
    # Tables of random sizes, as in desk, leave a part of the picture empty.
    assert all(np.min(image.depth) > 0 or made.scene.table.size not in (2.0, 4.4) for image in images)
    assert all(np.max(image.depth) < MAX_DEPTH for image in images)
    return [image.segmentation for image in images]


def check_promises(name: str, made: Simulated) -> None:
    """Promises that every single scene of a recipe keeps."""
    recipe, trajectory = load_recipe(name), made.trajectory
    count = len(made.shapes)
    assert recipe.objects.minimum <= count <= recipe.objects.maximum
    assert trajectory.position.shape == (recipe.frames, count, 3)
    assert {array.dtype for array in vars(trajectory).values()} == {np.dtype(np.float32)}
    assert np.min(trajectory.contact_gap[0]) >= -1e-3
    assert np.min(trajectory.contact_gap) >= -2e-3
    assert np.min(trajectory.position[..., 2]) > 0
    assert made.attempts == 1 + sum(made.rejections.values())
    for segmentation in segmentations(made, recipe.visibility_resolution):
        assert np.min(np.bincount(segmentation.ravel(), minlength=count + 1)) >= recipe.least_visible_pixels
    if recipe.video:
        assert np.max(travel(made)) >= 0.03
    else:
        speed = np.sqrt(np.sum(trajectory.linear_velocity**2, axis=-1))
        assert np.max(speed) < 0.01


@pytest.mark.parametrize("name", names_without_meshes())
def test_scenes_keep_the_promises_of_their_recipe(name: str):
    for made in scenes(name, 2):
        check_promises(name, made)


@pytest.mark.slow
@pytest.mark.parametrize("name", names_without_meshes())
def test_many_scenes_keep_the_promises_of_their_recipe(name: str):
    for made in scenes(name, 40):
        check_promises(name, made)


def touching_share(made: Simulated) -> float:
    gaps = made.trajectory.contact_gap[:, 1:, 1:]
    return float(np.max(np.mean(gaps < 0.005, axis=0)))


@pytest.mark.parametrize("count", [3, pytest.param(40, marks=pytest.mark.slow)])
def test_in_touching_a_pair_stays_together_and_moves(count: int):
    for made in scenes("touching", count):
        assert touching_share(made) >= 0.8
        assert np.max(travel(made)) >= 0.03


@pytest.mark.slow
@pytest.mark.parametrize("name", VIDEO)
def test_over_a_dataset_at_least_half_of_the_objects_move(name: str):
    moved = np.concatenate([travel(made) > 0.01 for made in scenes(name, 40)])
    assert np.mean(moved) >= 0.5


@pytest.mark.slow
@pytest.mark.parametrize("name", VIDEO)
def test_over_a_dataset_all_kinds_of_motion_occur(name: str):
    made = scenes(name, 80 if name == "touching" else 60)
    motions = Counter(body.motion for one in made for body in one.scene.bodies)
    assert set(motions) == {"rest", "drop", "slide", "roll", "push", "throw"}
    collisions = [np.any(one.trajectory.contact_impulse[:, 1:, 1:] > 0) for one in made]
    assert np.mean(collisions) > 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "low", "high"), [("moving", 0.03, 0.06), ("noisy", 0.03, 0.06), ("static", 0.06, 0.09)]
)
def test_the_mean_foreground_is_that_of_the_papers_sets(name: str, low: float, high: float):
    made = scenes(name, 60)
    frames = (0, 4, 9) if load_recipe(name).video else (0,)
    shares = [np.mean(s > 0) for one in made for frame in frames for s in segmentations(one, (128, 128), frame)]
    assert low <= np.mean(shares) <= high


@pytest.mark.slow
def test_cluttered_scenes_are_full_and_objects_hide_each_other():
    made = scenes("cluttered", 20)
    renderer = make_renderer("raster")
    fractions = []
    for one in made:
        renderer.load(one.scene, one.shapes)
        image = renderer.render(one.trajectory.world_from_object[-1], one.scene.cameras[0], 128, 128)
        visible = np.bincount(image.segmentation.ravel(), minlength=len(one.shapes) + 1)[1:]
        fractions += list(visible / np.maximum(image.amodal_pixels, 1))
    assert np.mean(np.array(fractions) < 0.9) > 0.25


def test_the_shapes_of_the_test_split_are_unseen_in_training():
    pool = load_recipe("multishape").objects.shape_pool
    for split in ("train", "val", "test"):
        numbers = {body.shape_id for made in scenes("multishape", 2, split) for body in made.scene.bodies}
        assert all((number >= pool) == (split == "test") for number in numbers)


def test_a_scene_depends_on_its_own_numbers_only():
    recipe = load_recipe("moving")
    keys = [(0, "train", 0), (0, "train", 1), (0, "val", 0), (1, "train", 0)]
    forward = [fingerprint(simulate_scene(recipe, *key)) for key in keys]
    backward = [fingerprint(simulate_scene(recipe, *key)) for key in reversed(keys)]
    assert forward == backward[::-1]
    assert len(set(forward)) == len(keys)


@pytest.mark.parametrize("name", ["touching", "static"])
def test_another_process_gives_the_same_bits(name: str):
    code = (
        "from datagen.config import load_recipe\n"
        "from tests.datagen.pipeline.test_simulate import fingerprint, simulate_scene\n"
        f"print(fingerprint(simulate_scene(load_recipe({name!r}), 7, 'val', 3)))"
    )
    other = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert other.stdout.strip() == fingerprint(simulate_scene(load_recipe(name), 7, "val", 3))


def test_forty_objects_on_the_table_are_refused_at_once():
    many = dataclasses.replace(load_recipe("moving"), objects=Objects(minimum=40, maximum=40))
    with pytest.raises(ImpossibleScene, match=r"at least 40 objects.*lower --objects.minimum"):
        simulate_scene(many, 0, "train", 0)


@pytest.mark.parametrize("name", names_without_meshes())
def test_there_is_room_in_every_recipe(name: str):
    for index in range(5):
        check_room(load_recipe(name).for_scene(index))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"least_visible_pixels": 9999}, "lower --least-visible-pixels"),
        ({"layout": Layout(workspace_half_extent=(0.01, 0.01))}, "leaves the workspace"),
    ],
)
def test_after_all_attempts_the_message_says_what_to_change(changes: dict, words: str):
    recipe = dataclasses.replace(load_recipe("moving"), attempts=2, **changes)
    with pytest.raises(ImpossibleScene, match=f"train scene 3.*2 attempts.*{words}"):
        simulate_scene(recipe, 0, "train", 3)


def test_a_clip_in_which_nothing_travels_is_refused():
    from datagen.sampling import Rejected

    made = simulate_scene(load_recipe("moving"), 0, "train", 0)
    frozen = dataclasses.replace(made.trajectory, position=made.trajectory.position[:1].repeat(10, 0))
    with pytest.raises(Rejected, match="still"):
        check_course(load_recipe("moving"), frozen)


@pytest.mark.parametrize(("width", "height"), [(256, 128), (128, 256)])
def test_images_of_another_aspect_show_the_same_and_more(width: int, height: int):
    made = simulate_scene(load_recipe("moving"), 0, "train", 1)
    (frame,) = segmentations(made, (128, 128))
    renderer = make_renderer("raster")
    renderer.load(made.scene, made.shapes)
    image = renderer.render(made.trajectory.world_from_object[0], made.scene.cameras[0], width, height)
    left, top = (width - 128) // 2, (height - 128) // 2
    np.testing.assert_array_equal(image.segmentation[top : top + 128, left : left + 128], frame)


def test_a_clip_in_which_something_sinks_into_the_table_is_refused():
    from datagen.sampling import Rejected

    recipe = load_recipe("moving")
    made = simulate_scene(recipe, 0, "train", 0)
    gap = made.trajectory.contact_gap.copy()
    gap[5, 0, 1] = gap[5, 1, 0] = -0.0019
    check_course(recipe, dataclasses.replace(made.trajectory, contact_gap=gap))
    gap[0, 0, 1] = gap[0, 1, 0] = -0.0021  # the start has its own rule
    check_course(recipe, dataclasses.replace(made.trajectory, contact_gap=gap))
    gap[5, 0, 1] = gap[5, 1, 0] = -0.0021
    with pytest.raises(Rejected, match="sank"):
        check_course(recipe, dataclasses.replace(made.trajectory, contact_gap=gap))


def draws(recipe: Recipe, remedy: str = "lower --objects.minimum") -> int:
    """How many scenes of an impossible recipe are drawn."""
    with pytest.raises(ImpossibleScene, match=f"objects had a place in view.*{remedy}") as caught:
        simulate_scene(recipe, 0, "test", 0)
    found = re.search(r"no scene in (\d+) attempts", str(caught.value))
    assert found
    return int(found[1])


def test_objects_that_cannot_fit_are_given_up_early(monkeypatch: pytest.MonkeyPatch):
    still = load_recipe("static")
    objects = dataclasses.replace(still.objects, minimum=12, maximum=12, categories=("cube",), sizes=(0.1,))
    weights = dataclasses.replace(still.motion.weights, drop=0.0)
    motion = dataclasses.replace(still.motion, weights=weights)
    # As if there were room enough by the bound that is checked first.
    monkeypatch.setattr(simulate, "check_room", lambda recipe: None)
    assert draws(dataclasses.replace(still, objects=objects, motion=motion)) <= 30


def test_a_region_outside_of_the_workspace_is_given_up_early():
    moving = load_recipe("moving")
    layout = dataclasses.replace(moving.layout, workspace_half_extent=(0.002, 0.002))
    assert draws(dataclasses.replace(moving, layout=layout), "or enlarge --layout.workspace-half") <= 40


def test_a_recipe_is_hopeless_where_far_too_few_objects_fit():
    rng = np.random.default_rng(0)
    assert is_hopeless(rng.normal(9, 1.5, 20).round().astype(int).tolist(), 20)
    assert is_hopeless([3] * 20, 6)
    assert not is_hopeless([3] * 19, 6), "too few were drawn"
    assert not is_hopeless([4] * 20, 6), "counts that are all equal prove little"
    assert not is_hopeless([*[3] * 60, 5], 6), "one came near"
    assert not is_hopeless(rng.normal(9, 5, 200).clip(0, 18).round().astype(int).tolist(), 20), "they vary much"


@pytest.mark.parametrize("chance", [0.05, 0.02])
def test_recipes_of_which_few_draws_fit_are_not_given_up(chance: float):
    rng = np.random.default_rng(0)
    for _ in range(150):
        fitting = (10 - rng.poisson(-np.log(chance), 200)).clip(0)
        kept = next((n for n, count in enumerate(fitting) if count == 10), 200)
        assert not any(is_hopeless(fitting[:n].tolist(), 10) for n in range(kept))


def near_rig(**changes: object) -> Recipe:
    recipe = dataclasses.replace(load_recipe("moving"), frames=4, least_visible_pixels=0)
    return dataclasses.replace(recipe, rig=dataclasses.replace(recipe.rig, **changes))


def test_no_object_comes_nearer_to_a_camera_than_renderers_show():
    rejected = Counter()
    for index in range(6):
        made = simulate_scene(near_rig(distance=0.2), 0, "test", index)
        rejected.update(made.rejections)
        for camera in made.scene.cameras:
            assert near_object(camera, made.shapes, made.trajectory.world_from_object, 128, 128) is None
    assert rejected["near"]


def test_cameras_that_are_shaken_out_of_range_are_drawn_again():
    shaken = near_rig(distance=0.4, elevation=10.0, jitter=0.1)
    made = [simulate_scene(shaken, 0, "test", index) for index in range(4)]
    assert all(camera.position[2] > 0 for one in made for camera in one.scene.cameras)
    assert sum(one.rejections.get("near", 0) for one in made)


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        (
            {"elevation": 3.0, "distance": 0.35},
            "camera 0 sees the table from 4.4 cm; expected more than 5 cm.*--rig",
        ),
        ({"elevation": 10.0, "distance": 6.5}, "camera 0 sees the table at 7.*expected at most 6.5535 m"),
        ({"field_of_view": 170.0, "distance": 0.3}, "sees the table from"),
    ],
)
def test_a_rig_that_cannot_show_the_table_is_refused_at_once(rig: dict, words: str):
    hopeless = dataclasses.replace(near_rig(**rig), attempts=1, least_visible_pixels=10_000)
    with pytest.raises(UsageError, match=words):
        simulate_scene(hopeless, 0, "test", 0)


def test_objects_rest_in_their_container():
    recipe = load_recipe("static")
    recipe = dataclasses.replace(
        recipe,
        objects=Objects(minimum=2, maximum=2, categories=("cube",), size=(0.03, 0.3), sizes=(0.05,)),
        layout=dataclasses.replace(recipe.layout, container_share=1.0),
    )
    inside = []
    for index in range(6):
        made = simulate_scene(recipe, 0, "train", index)
        (x, y, z), container = np.abs(np.diff(made.trajectory.position[0], axis=0))[0], made.shapes[0]
        inside.append(np.hypot(x, y) < np.min(container.size[:2]) / 2 and z < container.size[2])
    assert sum(inside) >= 3
