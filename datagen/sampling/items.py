"""Choice of the objects of a scene: category, shape and mechanical properties, before anything is placed."""

from dataclasses import dataclass

import numpy as np

from datagen import catalog, shapes
from datagen.config import MESH_PREFIX, Objects
from datagen.meshes.library import Library
from datagen.random_streams import pool_rng
from datagen.scene import ShapeSpec, rounded
from datagen.shapes.shape import Shape


@dataclass(frozen=True, eq=False)
class Item:
    """An object before it is placed."""

    category: str
    spec: ShapeSpec
    shape: Shape
    density: float
    friction: float
    restitution: float
    shape_id: int | None = None


def sample_items(objects: Objects, split: str, rng: np.random.Generator, meshes: Library | None = None) -> list[Item]:
    """Draw the objects of a scene; their number is between the recipe's minimum and maximum."""
    count = int(rng.integers(objects.minimum, objects.maximum + 1))
    return [sample_item(objects, split, rng, meshes) for _ in range(count)]


def sample_item(objects: Objects, split: str, rng: np.random.Generator, meshes: Library | None = None) -> Item:
    """Draw one object; if the recipe has a pool of shapes, the test split draws from its own part of the pool.

    With meshes, objects are those of the split, and the other categories that the recipe names.
    """
    # Category: built-in ones, and meshes of the split.
    categories = objects.categories or catalog.TABLETOP
    if meshes:
        named = [name for name in objects.categories if not name.startswith(MESH_PREFIX)]
        categories = [*named, *(MESH_PREFIX + name for name in meshes.names(split))]
    category = str(rng.choice(categories))
    # Shape: a mesh, a member of the pool, or a new one.
    shape_id = None
    if meshes and category.startswith(MESH_PREFIX):
        category = category.removeprefix(MESH_PREFIX)
        spec = meshes.entry(category).spec
    elif objects.shape_pool:
        shape_id = int(rng.integers(objects.shape_pool)) + (objects.shape_pool if split == "test" else 0)
        number = list(catalog.CATEGORIES).index(category)
        spec = _sample_spec(category, objects, pool_rng(number, shape_id))
    else:
        spec = _sample_spec(category, objects, rng)
    # Physical properties; densities are even in the logarithm.
    low, high = np.log(objects.density)
    return Item(
        category,
        spec,
        shapes.build(spec, meshes),
        density=rounded(np.exp(rng.uniform(low, high))),
        friction=rounded(rng.uniform(*objects.friction)),
        restitution=rounded(rng.uniform(*objects.restitution)),
        shape_id=shape_id,
    )


def _sample_spec(category: str, objects: Objects, rng: np.random.Generator) -> ShapeSpec:
    if objects.sizes:
        length = float(rng.choice(objects.sizes))
    else:
        low, high = objects.size
        length = low + (high - low) * rng.uniform() ** objects.size_skew
    return catalog.sample_shape(category, rng, (length, length))


class Rejected(Exception):
    """A sample that breaks the rule called `reason`; `fitting` counts objects with a place in view if all need one."""

    def __init__(self, reason: str, *, fitting: int | None = None):
        super().__init__(reason)
        self.reason = reason
        self.fitting = fitting
