"""Catalog of object categories, each with its family and the function that draws its members."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from datagen.errors import UsageError
from datagen.scene import ShapeSpec
from datagen.shapes.families import composite, extrusion, furniture, lathe, mug, primitives, superquadric

Sampler = Callable[[np.random.Generator, tuple[float, float]], dict[str, Any]]


@dataclass(frozen=True)
class Category:
    """A kind of object."""

    family: str
    """Key of `datagen.shapes.FAMILIES`."""
    sample: Sampler
    """Function that draws a member's parameters, given the bounds of its longest side in metres."""
    group: Literal["tabletop", "furniture", "named"] = "tabletop"
    """Group of the category. Furniture stands with +z up; `named` categories appear only if a recipe names them."""


CATEGORIES: dict[str, Category] = {
    "box": Category("box", primitives.sample_box),
    "cube": Category("box", primitives.sample_cube),
    "sphere": Category("sphere", primitives.sample_sphere),
    "cylinder": Category("cylinder", primitives.sample_cylinder),
    "can": Category("cylinder", primitives.sample_can, "named"),
    "cone": Category("frustum", primitives.sample_cone),
    "frustum": Category("frustum", primitives.sample_frustum),
    "capsule": Category("capsule", primitives.sample_capsule),
    "torus": Category("torus", primitives.sample_torus),
    "ellipsoid": Category("ellipsoid", primitives.sample_ellipsoid),
    "superquadric": Category("superquadric", superquadric.sample),
    "bottle": Category("lathe", lathe.sample_bottle),
    "pawn": Category("lathe", lathe.sample_pawn),
    "vase": Category("lathe", lathe.sample_vase),
    "bowl": Category("lathe", lathe.sample_bowl),
    "cup": Category("lathe", lathe.sample_cup),
    "goblet": Category("lathe", lathe.sample_goblet),
    "mug": Category("mug", mug.sample),
    "prism": Category("prism", extrusion.sample_prism),
    "star": Category("star", extrusion.sample_star),
    "gear": Category("gear", extrusion.sample_gear),
    "cross": Category("cross", extrusion.sample_cross),
    "tee": Category("tee", extrusion.sample_tee),
    "channel": Category("channel", extrusion.sample_channel),
    "arrow": Category("arrow", extrusion.sample_arrow),
    "angle": Category("angle", extrusion.sample_angle),
    "dumbbell": Category("dumbbell", composite.sample_dumbbell),
    "weight": Category("weight", composite.sample_weight),
    "hammer": Category("hammer", composite.sample_hammer),
    "bracket": Category("bracket", composite.sample_bracket),
    "jack": Category("jack", composite.sample_jack),
    "tower": Category("tower", composite.sample_tower),
    "snowman": Category("snowman", composite.sample_snowman),
    "chair": Category("chair", furniture.sample_chair, "furniture"),
    "stool": Category("stool", furniture.sample_stool, "furniture"),
    "table": Category("table", furniture.sample_table, "furniture"),
    "round table": Category("stool", furniture.sample_round_table, "furniture"),
    "desk": Category("desk", furniture.sample_desk, "furniture"),
    "cabinet": Category("cabinet", furniture.sample_cabinet, "furniture"),
    "shelf": Category("shelf", furniture.sample_shelf, "furniture"),
    "bench": Category("bench", furniture.sample_bench, "furniture"),
    "lamp": Category("lamp", furniture.sample_lamp, "furniture"),
    "sofa": Category("sofa", furniture.sample_sofa, "furniture"),
    "bed": Category("bed", furniture.sample_bed, "furniture"),
    "crate": Category("crate", primitives.sample_crate, "named"),
}
"""All categories by name."""

TABLETOP = tuple(name for name, category in CATEGORIES.items() if category.group == "tabletop")
"""Names of what may lie about on a table."""

CONTAINERS = ("bowl", "crate")
"""Names of what others may lie in."""


def sample_shape(category: str, rng: np.random.Generator, size: tuple[float, float]) -> ShapeSpec:
    """A member of a category whose longest side along the object frame's axes lies within `size` (metres).

    Raises:
        UsageError: there is no such category, or no such size.
    """
    if category not in CATEGORIES:
        raise UsageError(f"Unknown category {category!r}; expected one of {', '.join(CATEGORIES)}.")
    if not 0 < size[0] <= size[1]:
        raise UsageError(f"The size of objects is {size}; expected 0 < least <= greatest, in metres.")
    entry = CATEGORIES[category]
    return ShapeSpec(entry.family, entry.sample(rng, size))
