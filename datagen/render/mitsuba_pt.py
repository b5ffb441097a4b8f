"""Photorealistic colours from the path tracer Mitsuba 3, on CPUs; depth, ids and all labels come from the rasteriser.

Light comes from one environment map: `kernels.sky` tinted with the scene's ambient light, and a disc for each light.
Irradiance of 1 on a white surface gives white, as in the rasteriser, so that radiances are those of the scene times pi.
"""

import functools
import hashlib
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from datagen.errors import UsageError
from datagen.render import kernels
from datagen.render.raster import RasterRenderer
from datagen.render.refine import refine
from datagen.render.renderer import Image, light_axes, linear, pack_material
from datagen.scene import Camera, Light, Material, Scene
from datagen.shapes.shape import Shape

SAMPLES = 64
"""Default number of paths per pixel."""

MOST_SAMPLES = 65_536

LEAST_LLVM = 17
"""First version of LLVM that compiles Mitsuba's kernels; older ones end the process."""

SKY_SIZE = (256, 512)
"""Rows and columns of the environment map."""

SURROUND = 4.0
"""Sides of the floor that continues the table, in sides of the table."""

MISSING = (
    "The mitsuba renderer needs the package mitsuba ({reason}). Install it with `pip install 'obpose[mitsuba]'`, or use "
    "`--renderer rich`, which needs nothing else."
)


class MitsubaRenderer(RasterRenderer):
    """The rasteriser, with a second method that path-traces the same image.

    Raises:
        UsageError: Mitsuba is not installed.
    """

    name = "mitsuba"
    version = 1

    def __init__(self, samples: int = SAMPLES) -> None:
        super().__init__()
        self.samples = samples
        self._mi, self.engine = _start()
        self._behind = RasterRenderer(rich=True)
        self._sizes: dict[int, dict[str, Any]] = {}

    def load(self, scene: Scene, shapes: Sequence[Shape]) -> None:
        """Load a scene's materials, lights and shapes; rows follow `scene.bodies`."""
        super().load(scene, shapes)
        self._scene, self._shapes = scene, shapes
        self._behind.load(scene, ())
        self._fixed: dict[str, Any] = {}
