"""The OpenGL renderer pyrender, through EGL: for GPUs, and as an independent check of the rasteriser.

Its colour pass is multisampled and resolves depth off the pixel's centre, so that depth and ids come from the SEG pass.
"""

import contextlib
import functools
import os
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from datagen.errors import UsageError
from datagen.geometry import linear
from datagen.render import kernels
from datagen.render.renderer import NEAREST, Image, light_axes
from datagen.scene import Camera, Light, Material, Scene
from datagen.shapes.shape import Shape, Skin

OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])

FAR_LIGHT = 1000.0
"""Metres to the point lights that stand for distant lights without shadow; pyrender's directional ones all cast one."""

GL_LINEAR, GL_LINEAR_MIPMAP_LINEAR, GL_REPEAT = 0x2601, 0x2703, 0x2901

COLORS_PER_PERIOD = 12
"""Vertices along one period of a pattern, whose colours OpenGL interpolates between."""

MOST_FACES = 200_000
"""Triangles up to which a patterned mesh is refined."""

MISSING = (
    "The pyrender renderer needs OpenGL through EGL, which does not work here ({reason}). On Debian or Ubuntu install "
    "libegl1 libgl1 libgl1-mesa-dri; or use `--renderer raster`, which needs no graphics library."
)


class PyrenderRenderer:
    """See `datagen.render.renderer.Renderer`.

    Raises:
        UsageError: OpenGL or EGL is not installed or has no working device.
    """

    name = "pyrender"
    version = 2

    def __init__(self) -> None:
        self._pyrender, self._context = _open_context()

    def load(self, scene: Scene, shapes: Sequence[Shape]) -> None:
        """Load a scene's materials, lights and shapes; rows follow `scene.bodies`."""
        self._scene = self._pyrender.Scene(ambient_light=[*scene.ambient], bg_color=[*scene.backdrop, 1.0])
        self._nodes = [self._scene.add(self._shape(s, b.material)) for s, b in zip(shapes, scene.bodies, strict=True)]
        self._table = self._scene.add(self._mesh(*_table(scene.table.size), scene.table.material, double_sided=True))
        self._shadows = bool(scene.lights) and scene.lights[0].casts_shadow
        for row, light in enumerate(scene.lights):
            self._add_light(light, shadow=self._shadows and row == 0)
        self._camera = self._scene.add(self._pyrender.IntrinsicsCamera(1, 1, 0, 0, znear=NEAREST, zfar=100.0))

    def render(
        self, world_from_object: Float[np.ndarray, "object 4 4"], camera: Camera, width: int, height: int
    ) -> Image:
        """Render the loaded scene with its objects at the given poses."""
        self._place(world_from_object, camera, width, height)
        flags = self._pyrender.RenderFlags.SHADOWS_DIRECTIONAL if self._shadows else self._pyrender.RenderFlags.NONE
        with _numpy_infty():
            rgb, _ = self._context.render(self._scene, flags=flags)
            ids, depth = self._segment({node: row + 1 for row, node in enumerate(self._nodes)} | {self._table: 0})
            amodal = [np.count_nonzero(self._segment({node: 1})[0]) for node in self._nodes]
        return Image(rgb.copy(), depth.copy(), ids.copy(), np.array(amodal, np.int64))

    def _place(self, poses: Float[np.ndarray, "object 4 4"], camera: Camera, width: int, height: int) -> None:
        self._context.viewport_width, self._context.viewport_height = width, height
        for node, pose in zip(self._nodes, poses, strict=True):
            self._scene.set_pose(node, pose)
        k = camera.k(width, height)
        lens = self._camera.camera
        lens.fx, lens.fy, lens.cx, lens.cy = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
        self._scene.set_pose(self._camera, camera.world_from_camera @ OPENGL_FROM_OPENCV)

    def _segment(
        self, ids: dict[Any, int]
    ) -> tuple[UInt8[np.ndarray, "height width"], Float[np.ndarray, "height width"]]:
        """Ids and depth of the given nodes, the others being absent."""
        colors = {node: (number, 0, 0) for node, number in ids.items()}
        image, depth = self._context.render(self._scene, flags=self._pyrender.RenderFlags.SEG, seg_node_map=colors)
        return image[..., 0], depth

    def _shape(self, shape: Shape, material: Material) -> Any:
        if material.pattern == "image" and shape.skin is not None:
            return self._skinned(shape, shape.skin, material)
        return self._mesh(shape.vertices[shape.faces], shape.normals, material)

    def _skinned(self, shape: Shape, skin: Skin, material: Material) -> Any:
        """A mesh with one primitive for each of its textures."""
        primitives = []
        for row, pyramid in enumerate(skin.pyramids):
            own = skin.texture == row
            if not np.any(own):
                continue
            sampler = self._pyrender.Sampler(
                magFilter=GL_LINEAR, minFilter=GL_LINEAR_MIPMAP_LINEAR, wrapS=GL_REPEAT, wrapT=GL_REPEAT
            )
            # OpenGL wants at least 2x2 texels for its mipmaps; pyrender counts v from the lower edge.
            image = pyramid[0]
            if image.size == 3:
                image = np.tile(image, (2, 2, 1))
            texture = self._pyrender.Texture(source=image, source_channels="RGB", sampler=sampler)
            surface = self._pyrender.MetallicRoughnessMaterial(
                baseColorTexture=texture, metallicFactor=material.metalness, roughnessFactor=material.roughness
            )
            colors = skin.colors[own].reshape(-1, 3)
            primitives.append(
                self._pyrender.Primitive(
                    positions=shape.vertices[shape.faces[own]].reshape(-1, 3),
                    normals=shape.normals[own].reshape(-1, 3),
                    texcoord_0=skin.uv[own].reshape(-1, 2) * [1, -1] + [0, 1],
                    color_0=np.concatenate([colors, np.ones((len(colors), 1))], axis=1),
                    material=surface,
                )
            )
        return self._pyrender.Mesh(primitives)

    def _mesh(
        self,
        corners: Float[np.ndarray, "face 3 3"],
        normals: Float[np.ndarray, "face 3 3"],
        material: Material,
        *,
        double_sided: bool = False,
    ) -> Any:
        # Patterns become colours of vertices, on a mesh that is fine enough.
        color, colors = linear(material.color), None
        if material.pattern != "plain":
            corners, normals = refine(corners, normals, material.period / COLORS_PER_PERIOD)
            color, colors = np.ones(3), _vertex_colors(material, corners.reshape(-1, 3))
        surface = self._pyrender.MetallicRoughnessMaterial(
            baseColorFactor=[*color, 1.0],
            metallicFactor=material.metalness,
            roughnessFactor=material.roughness,
            doubleSided=double_sided,
        )
        primitive = self._pyrender.Primitive(
            positions=corners.reshape(-1, 3), normals=normals.reshape(-1, 3), color_0=colors, material=surface
        )
        return self._pyrender.Mesh([primitive])

    def _add_light(self, light: Light, *, shadow: bool) -> None:
        # pyrender divides Lambert's law by pi; integers would be taken for bytes.
        color, intensity = np.array(light.radiance, np.float64), np.pi
        axes = light_axes(light.direction)
        pose = np.eye(4)
        pose[:3, :3] = axes.T
        if shadow:
            self._scene.add(self._pyrender.DirectionalLight(color=color, intensity=intensity), pose=pose)
        else:
            pose[:3, 3] = FAR_LIGHT * axes[2]
            self._scene.add(self._pyrender.PointLight(color=color, intensity=intensity * FAR_LIGHT**2), pose=pose)


def refine(
    corners: Float[np.ndarray, "face 3 3"], normals: Float[np.ndarray, "face 3 3"], longest: float
) -> tuple[Float[np.ndarray, "finer 3 3"], Float[np.ndarray, "finer 3 3"]]:
    """Halve the longest sides of triangles until none exceeds `longest` metres, or there are very many triangles."""
    values = np.concatenate([corners, normals], axis=-1)
    while True:
        sides = np.sum((np.roll(values, -1, axis=1) - values)[..., :3] ** 2, axis=-1)
        long = np.max(sides, axis=1) > longest**2
        if not np.any(long) or len(values) + np.count_nonzero(long) > MOST_FACES:
            break
        order = (np.argmax(sides[long], axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(values[long], order[..., None], axis=1), 1, 0)
        middle = (a + b) / 2
        halves = [np.stack(half, axis=1) for half in ((a, middle, c), (middle, b, c))]
        values = np.concatenate([values[~long], *halves])
    corners, normals = values[..., :3], values[..., 3:]
    return corners, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _table(size: float) -> tuple[Float[np.ndarray, "2 3 3"], Float[np.ndarray, "2 3 3"]]:
    square = 0.5 * size * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return square[[[0, 1, 2], [0, 2, 3]]], np.tile([0.0, 0.0, 1.0], (2, 3, 1))


def _vertex_colors(material: Material, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 4"]:
    pattern = kernels.PATTERNS.index(material.pattern)
    width = material.period / COLORS_PER_PERIOD
    second = kernels.texture_weights(pattern, material.period, material.axis, points, width)[:, None]
    colors = (1 - second) * linear(material.color) + second * linear(material.color2)
    return np.concatenate([colors, np.ones((len(points), 1))], axis=1)


@contextlib.contextmanager
def _numpy_infty() -> Iterator[None]:
    """Define `numpy.infty`, which NumPy 2 removed and pyrender 0.1.45 uses."""
    if hasattr(np, "infty"):
        yield
        return
    np.__dict__["infty"] = np.inf
    try:
        yield
    finally:
        del np.__dict__["infty"]


@functools.cache
def _open_context() -> tuple[Any, Any]:
    """The pyrender module and this process' one OpenGL context: deleting one would break all others."""
    os.environ["PYOPENGL_PLATFORM"] = "egl"
    os.environ.setdefault("PYGLET_HEADLESS", "1")
    # Mesa's software rasteriser would otherwise start a thread for each core in each worker.
    os.environ.setdefault("LP_NUM_THREADS", "0")
    try:
        with _numpy_infty():
            import pyrender

            return pyrender, pyrender.OffscreenRenderer(64, 64)
    except Exception as error:
        # PyOpenGL fails in many ways where a library is missing: ImportError, AttributeError, GLError and others.
        raise UsageError(MISSING.format(reason=error)) from error
