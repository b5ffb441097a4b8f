"""Sample a scene from a random generator, without the physics engine."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from datagen.catalog import CONTAINERS
from datagen.config import Layout, Recipe
from datagen.geometry import quaternion_from_rotation
from datagen.meshes.library import Library
from datagen.sampling.appearance import sample_backdrop, sample_materials, sample_table
from datagen.sampling.cameras import exposed, sample_ambient, sample_cameras, sample_lights
from datagen.sampling.items import Item, Rejected, sample_item, sample_items
from datagen.sampling.layout import Spot, cluster, fill, fits, flattest, on_top, place, scatter, try_to_place
from datagen.sampling.motion import Start, sample_motion, sample_starts
from datagen.scene import Body, Camera, Material, Motion, Scene, Table, rounded, vector

__all__ = ["Rejected", "sample_scene"]

_MOST_INSIDE = 4
"""Largest number of objects in a container."""


def sample_scene(
    recipe: Recipe,
    rng: np.random.Generator,
    split: str,
    index: int,
    meshes: Library | None = None,
    cameras: tuple[Camera, ...] = (),
) -> Scene:
    """Draw scene `index` of a split once; the simulation decides whether it obeys the recipe's rules.

    `cameras` replace the recipe's if there are any.

    Raises:
        Rejected: the objects that were drawn found no place.
    """
    recipe = recipe.for_scene(index)
    spots = _sample_spots(recipe, split, rng, meshes)
    starts = sample_starts(spots, recipe.layout, recipe.motion, recipe.physics, rng)
    sizes = [float(np.max(spot.item.shape.size)) for spot in spots]
    materials = sample_materials(recipe.appearance, sizes, rng)
    materials = [_own_colors(spot, material) for spot, material in zip(spots, materials, strict=True)]
    scene = Scene(
        bodies=tuple(_body(*row) for row in zip(spots, starts, materials, strict=True)),
        table=Table(_table_size(recipe.layout, rng), sample_table(recipe.appearance, rng)),
        cameras=cameras or sample_cameras(recipe, rng),
        lights=sample_lights(recipe.lighting, rng),
        ambient=sample_ambient(recipe.lighting, rng),
        backdrop=sample_backdrop(rng),
        frames=recipe.frames,
        fps=recipe.fps,
    )
    return exposed(scene, recipe.lighting, rng)


def _table_size(layout: Layout, rng: np.random.Generator) -> float:
    if not layout.table_sizes:
        return layout.table_size
    least, greatest = layout.table_sizes
    return rounded(rng.uniform(least, greatest))


def _sample_spots(recipe: Recipe, split: str, rng: np.random.Generator, meshes: Library | None) -> list[Spot]:
    if recipe.layout.placement == "touching":
        return _touching(recipe, split, rng, meshes)
    items = sample_items(recipe.objects, split, rng, meshes)
    spots: list[Spot] = []
    if items and recipe.layout.container_share and rng.uniform() < recipe.layout.container_share:
        spots, items = _filled(recipe, items, split, rng)
    motions: list[Motion] = [sample_motion(item, recipe.motion, rng) for item in items]
    if recipe.layout.placement == "scattered":
        return scatter(items, motions, recipe.layout, recipe.motion, rng, spots)
    return _stacked(recipe, items, rng, spots)


def _filled(
    recipe: Recipe, items: Sequence[Item], split: str, rng: np.random.Generator
) -> tuple[list[Spot], list[Item]]:
    """A large container in place of the last object with some that fit in, and the rest."""
    greatest = recipe.objects.size[1]
    size = (greatest / 2, greatest)
    # Containers have sizes of their own, so they are no members of the pool.
    large = dataclasses.replace(recipe.objects, categories=CONTAINERS, size=size, sizes=(), shape_pool=0)
    container, items = sample_item(large, split, rng), items[:-1]
    inside = [item for item in items if fits(item, container)][: rng.integers(1, _MOST_INSIDE + 1)]
    return (
        fill(container, inside, recipe.layout, recipe.motion, rng),
        [item for item in items if item not in inside],
    )


def _touching(recipe: Recipe, split: str, rng: np.random.Generator, meshes: Library | None) -> list[Spot]:
    """A group of at least two in contact, and the rest apart from it."""
    count = int(rng.integers(recipe.objects.minimum, recipe.objects.maximum + 1))
    size = int(rng.integers(2, count + 1))
    kind: Motion = "slide" if rng.uniform() < 0.5 else "push"
    friction = rounded(rng.uniform(*recipe.objects.friction))
    members = [_steady_item(recipe, split, rng, meshes) for _ in range(size)]
    spots = cluster([dataclasses.replace(item, friction=friction) for item in members], kind, recipe.layout, rng)
    for _ in range(count - size):
        item = sample_item(recipe.objects, split, rng, meshes)
        spots.append(place(item, sample_motion(item, recipe.motion, rng), spots, recipe.layout, recipe.motion, rng))
    return spots


def _steady_item(recipe: Recipe, split: str, rng: np.random.Generator, meshes: Library | None) -> Item:
    for _ in range(recipe.layout.tries):
        item = sample_item(recipe.objects, split, rng, meshes)
        if flattest(item) is not None:
            return item
    raise Rejected("unsteady")


def _stacked(recipe: Recipe, items: Sequence[Item], rng: np.random.Generator, others: Sequence[Spot]) -> list[Spot]:
    """Objects on the table and on each other; what finds no place falls onto the rest."""
    spots = [*others]
    for item in items:
        spot = None
        stance = flattest(item)
        if spots and stance is not None and rng.uniform() < recipe.layout.stack_share:
            spot = on_top(item, "rest", stance.turned(rng.uniform(0, 2 * np.pi)), spots, rng)
        kind = sample_motion(item, recipe.motion, rng)
        spot = spot or try_to_place(item, kind, spots, recipe.layout, recipe.motion, rng)
        spots.append(spot or place(item, "drop", spots, recipe.layout, recipe.motion, rng))
    return spots


def _own_colors(spot: Spot, material: Material) -> Material:
    """The drawn material, or the mesh's own colours on a surface of medium roughness."""
    skin = spot.item.shape.skin
    return Material("image", skin.mean, skin.mean, "image", roughness=0.5) if skin else material


def _body(spot: Spot, start: Start, material: Material) -> Body:
    w, x, y, z = (rounded(value) for value in quaternion_from_rotation(spot.stance.rotation))
    item = spot.item
    return Body(
        category=item.category,
        shape=item.spec,
        material=material,
        density=item.density,
        friction=item.friction,
        restitution=item.restitution,
        motion=spot.motion,
        position=vector(spot.position),
        quaternion_wxyz=(w, x, y, z),
        linear_velocity=start.linear_velocity,
        angular_velocity=start.angular_velocity,
        push=start.push,
        touches=spot.touches,
        shape_id=item.shape_id,
    )
