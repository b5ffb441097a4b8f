"""Draw and simulate scenes until one obeys all rules of its recipe."""

import functools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datagen import shapes as shape_families
from datagen.config import Recipe
from datagen.errors import ImpossibleScene, UsageError
from datagen.meshes.library import Library
from datagen.physics.bullet import World
from datagen.random_streams import scene_rng
from datagen.render.renderer import NEAREST
from datagen.render.visible_range import near_object, table_fault, visible_pixels
from datagen.sampling import Rejected, sample_scene
from datagen.sampling.cameras import sample_cameras
from datagen.scene import Camera, Scene, Trajectory
from datagen.schema import MAX_DEPTH
from datagen.shapes.shape import Shape

_DENSEST = 0.6
"""Share of a region that discs at random places can fill before no free place is left."""

_LAYERS = 4
"""Number of times that stacked objects may cover the region; used if the placement is `stacked`."""

_LEAST_TRIED = 20
"""Number of scenes drawn before a recipe may count as hopeless."""

_DEVIATIONS = 2.5
"""Standard deviations by which the number of fitting objects must fall short of `objects.minimum` in hopeless recipes.

At this distance, at most one draw in 160 would fit by chance.
"""

_CAUTION = 3.0
"""Standard errors subtracted from the measured number of deviations, because it is estimated from few draws."""

_REMEDIES = {
    "crowded": "no free place: lower --objects.maximum or enlarge --layout.half-extent",
    "unsteady": "a group without shapes that lie steadily: name other --objects.categories",
    "overlap": "objects overlap at the start: enlarge --layout.gap",
    "sank": "bodies sink into each other in motion: lower --physics.step or --motion.speed",
    "left": "an object leaves the workspace: lower --motion.speed or enlarge --layout.workspace-half-extent",
    "apart": "objects that should touch come apart: lower --motion.speed",
    "unmet": "objects were not brought into contact: name other --objects.categories",
    "restless": "objects do not come to rest: raise --physics.settle-seconds",
    "hidden": "an object shows too few pixels: lower --least-visible-pixels or bring the camera closer",
    "still": "nothing moves far enough: raise --motion.speed",
    "near": f"a camera comes within {100 * NEAREST:.0f} cm of an object or the table, or sees the table from beyond "
    f"{MAX_DEPTH:.4f} m: change --rig.distance or lower --rig.jitter",
}


@dataclass(frozen=True, eq=False)
class Simulated:
    """A scene that obeys its recipe's rules, with its simulated trajectory."""

    scene: Scene
    shapes: tuple[Shape, ...]
    trajectory: Trajectory
    attempts: int
    """Number of scenes drawn, including this one."""
    rejections: dict[str, int]
    """Number of rejected scenes by the rule that they broke."""


def simulate_scene(
    recipe: Recipe,
    seed: int,
    split: str,
    index: int,
    meshes: Library | None = None,
    cameras: tuple[Camera, ...] = (),
) -> Simulated:
    """Scene `index` of a split, a pure function of its arguments, `DATA_VERSION` and the files of `meshes`.

    `cameras` replace the recipe's if there are any.

    Raises:
        ImpossibleScene: no scene that keeps the rules was found in `recipe.attempts` draws, or they came nowhere near.
        UsageError: the cameras cannot show the table, or PyBullet is not installed.
    """
    # Refuse recipes that can only fail.
    rng = scene_rng(seed, split, index, "scene")
    part = recipe.for_scene(index)
    check_room(part)
    check_rig(part, cameras)
    # Draw until a scene keeps all rules.
    rejections: Counter[str] = Counter()
    fitting: list[int] = []
    for attempt in range(1, recipe.attempts + 1):
        try:
            scene = sample_scene(part, rng, split, index, meshes, cameras)
            shapes = tuple(shape_families.build(body.shape, meshes) for body in scene.bodies)
            trajectory = _trajectory(part, scene, shapes)
        except Rejected as rejection:
            rejections[rejection.reason] += 1
            if rejection.fitting is not None:
                fitting.append(rejection.fitting)
            if is_hopeless(fitting, part.objects.minimum):
                break
            continue
        return Simulated(scene, shapes, trajectory, attempt, dict(rejections))
    raise ImpossibleScene(_explain(part, split, index, rejections, fitting))


def is_hopeless(fitting: Sequence[int], least: int) -> bool:
    """Whether scenes with `least` objects in view are out of reach, given how many had a place in each rejected one."""
    if len(fitting) < _LEAST_TRIED or max(fitting) > least - 2:
        return False
    # Counts are whole numbers, so that a few equal ones do not prove that there is no variation.
    short = (least - np.mean(fitting)) / max(np.std(fitting), 0.5)
    return bool(short * (1 - _CAUTION / np.sqrt(2 * len(fitting))) >= _DEVIATIONS)


def _trajectory(recipe: Recipe, scene: Scene, shapes: Sequence[Shape]) -> Trajectory:
    with World(scene, shapes, recipe.physics) as world:
        check_start(recipe, scene, shapes, world.start())
        trajectory = world.run()
    check_course(recipe, trajectory)
    # Depths beyond the range of renderers and format; last, so that it changes neither draws nor other rejections.
    size, poses = recipe.visibility_resolution, trajectory.world_from_object
    for camera in scene.cameras:
        if table_fault(camera, scene.table.size, *size) or near_object(camera, shapes, poses, *size):
            raise Rejected("near")
    return trajectory


def check_start(recipe: Recipe, scene: Scene, shapes: Sequence[Shape], start: Trajectory) -> None:
    """Check the rules about frame 0, cheap ones first.

    Raises:
        Rejected: one of them is broken.
    """
    if np.min(start.contact_gap) < -recipe.physics.deepest_overlap:
        raise Rejected("overlap")
    _check_workspace(recipe, start)
    if recipe.layout.placement == "touching":
        for row, body in enumerate(scene.bodies):
            if body.touches is not None and start.contact_gap[0, row + 1, body.touches + 1] > 0.001:
                raise Rejected("unmet")
    if not recipe.motion.moving and np.max(_surface_speed(start, shapes), initial=0) > recipe.motion.rest_speed:
        raise Rejected("restless")
    visible = visible_pixels(recipe, scene, shapes, start.world_from_object[0])
    if len(visible) and np.min(visible) < recipe.least_visible_pixels:
        raise Rejected("hidden", fitting=int(np.count_nonzero(visible >= recipe.least_visible_pixels)))


def check_course(recipe: Recipe, trajectory: Trajectory) -> None:
    """Check the rules about the whole clip.

    Raises:
        Rejected: one of them is broken.
    """
    if np.min(trajectory.contact_gap[1:], initial=np.inf) < -recipe.physics.deepest_in_motion:
        raise Rejected("sank")
    _check_workspace(recipe, trajectory)
    if recipe.video and recipe.motion.moving and trajectory.position.shape[1]:
        travel = np.sqrt(np.sum((trajectory.position[-1] - trajectory.position[0]) ** 2, axis=-1))
        if np.max(travel) < recipe.motion.least_travel:
            raise Rejected("still")
    if recipe.layout.placement == "touching":
        touching = trajectory.contact_gap[:, 1:, 1:] < recipe.motion.contact_gap
        if np.max(np.mean(touching, axis=0)) < recipe.motion.contact_share:
            raise Rejected("apart")


def _check_workspace(recipe: Recipe, trajectory: Trajectory) -> None:
    away = np.abs(trajectory.position[..., :2] - np.array(recipe.layout.center))
    inside = np.all(away < np.array(recipe.layout.workspace_half_extent), axis=(0, 2))
    if not np.all(inside):
        # Objects that leave later had a place at the start.
        raise Rejected("left", fitting=int(np.count_nonzero(inside)) if len(trajectory.position) == 1 else None)


def _surface_speed(start: Trajectory, shapes: Sequence[Shape]) -> np.ndarray:
    """Upper bound of the speed of any surface point of each object in frame 0, m/s."""
    linear = np.sqrt(np.sum(start.linear_velocity[0] ** 2, axis=-1))
    angular = np.sqrt(np.sum(start.angular_velocity[0] ** 2, axis=-1))
    return linear + angular * np.array([shape.radius for shape in shapes])


@functools.lru_cache(maxsize=8)
def check_room(recipe: Recipe) -> None:
    """Refuse recipes with more objects than the region has room for.

    Raises:
        ImpossibleScene: says what would have to change.
    """
    objects, layout = recipe.objects, recipe.layout
    length = np.mean(objects.sizes) if objects.sizes else np.mean(objects.size)
    layers = _LAYERS if layout.placement == "stacked" else 1
    room = layers * _DENSEST * 4 * np.prod(layout.half_extent)
    fits = int(room / (np.pi / 4 * (length + layout.gap) ** 2))
    if objects.minimum > fits:
        raise ImpossibleScene(
            f"Recipe {recipe.name!r} wants at least {objects.minimum} objects of about {100 * length:.0f} cm in a "
            f"region of {200 * layout.half_extent[0]:.0f} x {200 * layout.half_extent[1]:.0f} cm, which holds "
            f"about {fits}; lower --objects.minimum and --objects.maximum, lower --objects.size, or enlarge "
            "--layout.half-extent."
        )


@functools.lru_cache(maxsize=8)
def check_rig(recipe: Recipe, cameras: tuple[Camera, ...] = ()) -> None:
    """Refuse cameras that cannot show the table; cameras with random poses are checked scene by scene.

    `cameras` replace the recipe's if there are any.

    Raises:
        UsageError: says what would have to change.
    """
    rig = recipe.rig
    drawn = rig.distances or rig.elevations or rig.azimuths or rig.fields_of_view
    if not cameras and (rig.jitter or drawn or rig.motion == "handheld"):
        return
    remedy = "Change --rig.distance, --rig.elevation, --rig.target or --rig.field-of-view."
    if recipe.rig.motion != "still":
        remedy = (
            f"Change --rig.{'orbit' if recipe.rig.motion == 'orbit' else 'travel'}, --rig.distance or --rig.target."
        )
    for view, camera in enumerate(cameras or sample_cameras(recipe, np.random.default_rng(0))):
        if fault := table_fault(camera, recipe.layout.table_size, *recipe.visibility_resolution):
            where = f"View {view} of the cameras file" if cameras else f"Recipe {recipe.name!r}: camera {view}"
            raise UsageError(f"{where} {fault}. {'Change its pose.' if cameras else remedy}")


def _explain(recipe: Recipe, split: str, index: int, rejections: Counter[str], fitting: Sequence[int]) -> str:
    draws = rejections.total()
    reasons = "; ".join(f"{count} times {_REMEDIES[reason]}" for reason, count in rejections.most_common())
    text = f"Recipe {recipe.name!r}, {split} scene {index}: no scene in {draws} attempts. {reasons}."
    if draws == recipe.attempts:
        return text
    remedies = {
        "hidden": "let the cameras see more with --rig.distance or --rig.target",
        "left": "enlarge --layout.workspace-half-extent",
    }
    remedy = remedies.get(rejections.most_common(1)[0][0], "enlarge --layout.half-extent")
    return (
        f"{text} No more than {max(fitting)} of at least {recipe.objects.minimum} objects had a place in view, and "
        f"further attempts are hopeless; lower --objects.minimum and --objects.maximum or --objects.size, or {remedy}."
    )
