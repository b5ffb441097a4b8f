"""Shapes: families of solids that a `ShapeSpec` names, built into meshes, exact solids, convex parts and mass."""

import json
from collections.abc import Callable
from functools import lru_cache

from datagen.errors import UsageError
from datagen.scene import ShapeSpec
from datagen.shapes.families import composite, extrusion, furniture, lathe, mug, primitives, superquadric
from datagen.shapes.shape import MeshSource, Shape
from datagen.storage.safe_io import parse_json

FAMILIES: dict[str, Callable[..., Shape]] = {
    "box": primitives.build_box,
    "crate": primitives.build_crate,
    "sphere": primitives.build_sphere,
    "cylinder": primitives.build_cylinder,
    "frustum": primitives.build_frustum,
    "capsule": primitives.build_capsule,
    "torus": primitives.build_torus,
    "ellipsoid": primitives.build_ellipsoid,
    "superquadric": superquadric.build,
    "lathe": lathe.build,
    "mug": mug.build,
    "prism": extrusion.build_prism,
    "star": extrusion.build_star,
    "gear": extrusion.build_gear,
    "cross": extrusion.build_cross,
    "tee": extrusion.build_tee,
    "channel": extrusion.build_channel,
    "arrow": extrusion.build_arrow,
    "angle": extrusion.build_angle,
    "dumbbell": composite.build_dumbbell,
    "weight": composite.build_weight,
    "hammer": composite.build_hammer,
    "bracket": composite.build_bracket,
    "jack": composite.build_jack,
    "tower": composite.build_tower,
    "snowman": composite.build_snowman,
    "chair": furniture.build_chair,
    "stool": furniture.build_stool,
    "table": furniture.build_table,
    "desk": furniture.build_desk,
    "cabinet": furniture.build_cabinet,
    "shelf": furniture.build_shelf,
    "bench": furniture.build_bench,
    "lamp": furniture.build_lamp,
    "sofa": furniture.build_sofa,
    "bed": furniture.build_bed,
}
"""Family names and the functions that turn a family's parameters into a shape."""


def build(spec: ShapeSpec, meshes: MeshSource | None = None) -> Shape:
    """Build the shape of a spec; the last few are cached. `meshes` holds the geometry of the family `mesh`.

    Raises:
        UsageError: there is no such family, the parameters are not its own, or a mesh is missing.
    """
    if spec.family == "mesh":
        if meshes is None:
            raise UsageError("The scene holds meshes; give the folder that holds their files with --assets.")
        return meshes.shape(spec.parameters)
    if spec.family not in FAMILIES:
        raise UsageError(f"Unknown shape family {spec.family!r}; expected one of {', '.join(FAMILIES)}.")
    return _build(spec.family, json.dumps(spec.parameters, sort_keys=True))


@lru_cache(maxsize=32)
def _build(family: str, parameters: str) -> Shape:
    try:
        return FAMILIES[family](**parse_json(parameters))
    except (TypeError, ValueError, LookupError, ArithmeticError, AttributeError) as error:
        raise UsageError(
            f"Shape family {family!r} cannot be built from {parameters:.200}: {type(error).__name__} {error}"
        ) from error
