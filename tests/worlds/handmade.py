"""Small scenes made by hand, for tests of the renderers."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from datagen.geometry import rigid
from datagen.render import Image, Renderer
from datagen.scene import Body, Camera, Light, Material, Scene, ShapeSpec, Table
from datagen.shapes import build

FRONT = Camera((0.87, 0.0, 0.84), (0.28, 0.0, 0.0), np.radians(40))
"""The front camera of the moving recipe."""

ABOVE_LEFT = Light((0.35, -0.45, 0.8216), (0.75, 0.72, 0.68), np.radians(2.5))
FILL = Light((0.5, 0.7, 0.5099), (0.15, 0.17, 0.2), 0.1, casts_shadow=False)
TABLE = Material("table", (0.55, 0.5, 0.45), roughness=0.8)
SIX = (
    ("sphere", {"radius": 0.05}, (0.28, -0.15, 0.051)),
    ("box", {"size": [0.08, 0.06, 0.1]}, (0.4, -0.02, 0.051)),
    ("cylinder", {"radius": 0.035, "height": 0.1}, (0.2, 0.0, 0.051)),
    ("prism", {"corners": 5, "radius": 0.05, "height": 0.08}, (0.35, 0.15, 0.041)),
    ("superquadric", {"half_axes": [0.05, 0.035, 0.03], "roundness": 0.5, "squareness": 0.8}, (0.15, 0.17, 0.031)),
    ("torus", {"ring_radius": 0.05, "tube_radius": 0.018}, (0.42, -0.2, 0.019)),
)
COLORS = ((0.8, 0.2, 0.2), (0.2, 0.4, 0.8), (0.2, 0.65, 0.3), (0.9, 0.75, 0.1), (0.6, 0.3, 0.7), (0.2, 0.7, 0.7))


def body(
    family: str,
    parameters: dict[str, Any],
    position: tuple[float, float, float],
    quaternion_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    **material: Any,
) -> Body:
    """An object of the given shape, red rubber unless told otherwise."""
    look = Material(**{"name": "rubber", "color": (0.8, 0.2, 0.2), **material})
    return Body(
        category=family,
        shape=ShapeSpec(family, parameters),
        material=look,
        density=1000.0,
        friction=0.5,
        restitution=0.3,
        motion="rest",
        position=position,
        quaternion_wxyz=quaternion_wxyz,
    )


def scene(*bodies: Body, **changes: Any) -> Scene:
    """A lit table with these objects on it."""
    made = Scene(
        bodies=bodies,
        table=Table(1.2, TABLE),
        cameras=(FRONT,),
        lights=(ABOVE_LEFT, FILL),
        ambient=(0.28, 0.29, 0.31),
        backdrop=(0.75, 0.78, 0.82),
        frames=1,
        fps=12.0,
    )
    return dataclasses.replace(made, **changes)


def six_objects(rng: np.random.Generator | None = None) -> Scene:
    """Sphere, box, cylinder, convex prism, superquadric and torus; with `rng` turned any way and held off the table."""
    bodies = []
    for (family, parameters, position), color in zip(SIX, COLORS, strict=True):
        if rng is None:
            bodies.append(body(family, parameters, position, color=color))
            continue
        quaternion = rng.normal(size=4)
        w, x, y, z = quaternion / np.sqrt(np.sum(quaternion**2))
        above = (position[0] + rng.uniform(-0.02, 0.02), position[1] + rng.uniform(-0.02, 0.02), 0.09)
        bodies.append(body(family, parameters, above, (w, x, y, z), color=color))
    return scene(*bodies)


def poses(made: Scene) -> Float[np.ndarray, "object 4 4"]:
    """world_from_object of the scene's start."""
    if not made.bodies:
        return np.zeros((0, 4, 4))
    return np.stack([rigid(np.array(b.position), np.array(b.quaternion_wxyz)) for b in made.bodies])


def render(renderer: Renderer, made: Scene, camera: Camera = FRONT, width: int = 64, height: int = 64) -> Image:
    """Load and render the scene as it starts."""
    renderer.load(made, [build(b.shape) for b in made.bodies])
    return renderer.render(poses(made), camera, width, height)
