"""Interface of the renderers, and the images they return."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from datagen.geometry import cross
from datagen.scene import Camera, Scene, Vector
from datagen.shapes.shape import Shape

NEAREST = 0.05
"""Planar depth up to which renderers clip surfaces, metres; scenes keep everything in view beyond it."""


@dataclass(frozen=True, eq=False)
class Image:
    """One rendered view."""

    rgb: UInt8[np.ndarray, "height width 3"]
    """Colour image, sRGB, anti-aliased."""
    depth: Float32[np.ndarray, "height width"]
    """Planar z at the pixel's centre, metres; 0 if the ray hits nothing."""
    segmentation: UInt8[np.ndarray, "height width"]
    """Object id (row in the scene's bodies plus one) at the pixel's centre, 0 for table and backdrop."""
    amodal_pixels: Int[np.ndarray, "object"]
    """Number of pixels whose centre each object would cover without the other objects."""


@runtime_checkable
class Renderer(Protocol):
    """Renderer of scenes. One scene is loaded at a time; poses and cameras may change between calls."""

    name: str
    version: int
    """Version number, raised when the rendered images change; part of a dataset's identity."""

    def load(self, scene: Scene, shapes: Sequence[Shape]) -> None:
        """Load a scene's materials, lights and shapes; rows follow `scene.bodies`."""
        ...

    def render(
        self, world_from_object: Float[np.ndarray, "object 4 4"], camera: Camera, width: int, height: int
    ) -> Image:
        """Render the loaded scene with its objects at the given poses."""
        ...


@runtime_checkable
class PathTracer(Renderer, Protocol):
    """Renderer whose `render` gives the rasteriser's images, and which makes other colours for them."""

    engine: str
    samples: int
    """Number of paths per pixel."""

    def photograph(
        self, world_from_object: Float[np.ndarray, "object 4 4"], camera: Camera, width: int, height: int
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Colours of the loaded scene with its objects at the given poses, sRGB; equal arguments give equal noise."""
        ...


def light_axes(direction: Vector) -> Float[np.ndarray, "3 3"]:
    """Right-handed axes in rows, the last one towards a light in the given world direction."""
    toward = np.asarray(direction, np.float64)
    toward = toward / np.sqrt(np.sum(toward * toward))
    side = np.array([1.0, 0.0, 0.0]) if abs(toward[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    u = side - np.sum(side * toward) * toward
    u = u / np.sqrt(np.sum(u * u))
    return np.stack([u, cross(toward, u), toward])


def render_clip(
    scene: Scene,
    shapes: Sequence[Shape],
    world_from_object: Float[np.ndarray, "frame object 4 4"],
    renderer: Renderer,
    resolution: tuple[int, int],
) -> list[list[Image]]:
    """Render images of a given (width, height), indexed [frame][view]."""
    renderer.load(scene, shapes)
    return [
        [renderer.render(pose, camera.at(frame), *resolution) for camera in scene.cameras]
        for frame, pose in enumerate(world_from_object)
    ]


def photographs(
    scene: Scene,
    shapes: Sequence[Shape],
    world_from_object: Float[np.ndarray, "frame object 4 4"],
    renderer: PathTracer,
    resolution: tuple[int, int],
) -> UInt8[np.ndarray, "frame view height width 3"]:
    """Path-trace the colours of the images that `render_clip` renders."""
    renderer.load(scene, shapes)
    return np.array(
        [
            [renderer.photograph(pose, camera.at(frame), *resolution) for camera in scene.cameras]
            for frame, pose in enumerate(world_from_object)
        ]
    )


def stack_images(images: list[list[Image]], name: str) -> np.ndarray:
    """Stack one attribute of images indexed [frame][view] into an array."""
    return np.array([[getattr(image, name) for image in views] for views in images])
