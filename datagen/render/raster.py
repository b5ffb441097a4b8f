"""The default renderer: a rasteriser in numba, without graphics libraries and bit-identical between runs."""

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from datagen.geometry import cross, invert_rigid, linear
from datagen.render import kernels
from datagen.render.renderer import Image, light_axes
from datagen.scene import Camera, Light, Material, Pattern, Scene
from datagen.shapes.shape import Shape

OCCLUSION_SIZE = 64
"""Texels along each side of the map that darkens the ambient light around objects, at least."""


def is_compiled() -> bool:
    """Whether an earlier run left its compiled kernels on this machine, possibly those of an earlier version."""
    return any(Path(kernels.shade.stats.cache_path or "").glob("kernels.shade-*.nbi"))


class RasterRenderer:
    """See `datagen.render.renderer.Renderer`; scenes share nothing but buffers that every call overwrites."""

    name = "raster"
    version = 1

    def __init__(self, *, rich: bool = False) -> None:
        self._rich = rich
        if rich:
            self.name, self.version = "rich", 2
        self._buffers: dict[tuple[int, int], _Buffers] = {}

    def load(self, scene: Scene, shapes: Sequence[Shape]) -> None:
        """Load a scene's materials, lights and shapes; rows follow `scene.bodies`."""
        # Geometry of all objects in common arrays.
        self._mesh, self._vertex_start, self._face_start = _pack_mesh(shapes)
        self._skins = _pack_skins(shapes, self._face_start)
        self._casters, self._caster_start = _casters(shapes, self._mesh.faces, self._face_start)
        # Materials and lights.
        materials = *(b.material for b in scene.bodies), scene.table.material
        self._materials = np.array([_pack_material(x, self._rich) for x in materials])
        self._table_half = 0.5 * scene.table.size
        self._lights = _pack_lights(scene.lights)
        self._ambient = np.array(scene.ambient, np.float64)
        self._ground, self._arriving = _ground(scene)
        self._backdrop = linear(scene.backdrop)
        # The first light casts the shadows.
        self._shadows = bool(shapes and scene.lights and scene.lights[0].casts_shadow)
        self._key_axes = light_axes(scene.lights[0].direction) if scene.lights else np.eye(3)
        angle = np.arctan2(self._key_axes[2, 1], self._key_axes[2, 0])
        self._turn = np.array([np.cos(angle), np.sin(angle)])
        # Positions for each call, in the world, the camera, the light and the image.
        count = len(self._mesh.vertices)
        self._world, self._homogeneous, self._light = (np.zeros((count, 3)) for _ in range(3))
        self._screen = np.zeros((count, 2))

    def render(
        self, world_from_object: Float[np.ndarray, "object 4 4"], camera: Camera, width: int, height: int
    ) -> Image:
        """Render the loaded scene with its objects at the given poses."""
        # Visibility, then colours, depths and ids of the visible triangles.
        poses, buffers, view = self._place(world_from_object, camera, width, height)
        amodal = self._visibility(view, buffers)
        image = Image(
            rgb=np.empty((height, width, 3), np.uint8),
            depth=np.empty((height, width), np.float32),
            segmentation=np.empty((height, width), np.uint8),
            amodal_pixels=amodal,
        )
        shadow = self._shadow_map(buffers)
        kernels.shade(
            view,
            self._mesh,
            self._skins,
            self._homogeneous,
            buffers.triangle,
            poses,
            self._materials,
            self._surroundings(buffers),
            self._rich or None,
            shadow,
            buffers.row,
            image.rgb,
            image.depth,
            image.segmentation,
        )
        return image

    def segment(
        self, world_from_object: Float[np.ndarray, "object 4 4"], camera: Camera, width: int, height: int
    ) -> UInt8[np.ndarray, "height width"]:
        """Render object ids alone, those of `render`."""
        _, buffers, view = self._place(world_from_object, camera, width, height)
        self._visibility(view, buffers)
        faces = buffers.triangle[kernels.SUB // 2 :: kernels.SUB, kernels.SUB // 2 :: kernels.SUB]
        return np.append(self._mesh.owners + 1, 0).astype(np.uint8)[faces]

    def _place(
        self, world_from_object: np.ndarray, camera: Camera, width: int, height: int
    ) -> tuple[np.ndarray, "_Buffers", np.ndarray]:
        """Move and project the vertices; returns poses, buffers and view."""
        poses = np.ascontiguousarray(world_from_object, np.float64)
        if (width, height) not in self._buffers:
            self._buffers[width, height] = _Buffers(width, height, self._rich)
        view, samples_from_world = _view(camera, width, height, self._table_half)
        kernels.place_vertices(self._mesh.vertices, self._vertex_start, poses, self._world)
        kernels.project_vertices(self._world, samples_from_world, self._homogeneous, self._screen)
        return poses, self._buffers[width, height], view

    def _visibility(self, view: np.ndarray, buffers: "_Buffers") -> np.ndarray:
        buffers.clear()
        amodal = np.zeros(len(self._face_start) - 1, np.int64)
        kernels.rasterise(
            self._world,
            self._homogeneous,
            self._screen,
            self._mesh.faces,
            self._face_start,
            view,
            buffers.triangle,
            buffers.inverse_depth,
            buffers.stamp,
            amodal,
        )
        return amodal

    def _shadow_map(self, buffers: "_Buffers") -> kernels.LightMap:
        light_map = buffers.shadow._replace(axes=self._key_axes)
        if self._shadows:
            self._light_map(light_map, margin=0.005)
        return light_map

    def _surroundings(self, buffers: "_Buffers") -> kernels.Surroundings:
        below = buffers.below
        # Darkness of the ambient light around the foot of objects; rich pictures add a narrow contact shadow.
        if len(self._world):
            self._light_map(below, margin=4 * kernels.AO_LENGTH)
            kernels.occlusion_map(below.texels, below.frame[2], kernels.AO_LENGTH, buffers.occlusion)
            if self._rich:
                kernels.occlusion_map(below.texels, below.frame[2], kernels.CONTACT_LENGTH, buffers.contact)
                buffers.occlusion = 1 - (1 - 0.7 * buffers.occlusion) * (1 - 0.9 * buffers.contact)
        else:
            buffers.occlusion.fill(0)
        return kernels.Surroundings(
            self._lights,
            self._shadows,
            self._ambient,
            self._ground,
            self._backdrop,
            buffers.occlusion,
            below.frame,
            self._turn,
            self._arriving,
            below.texels,
            float(np.max(self._world[:, 2], initial=0.0)),
        )

    def _light_map(self, m: kernels.LightMap, margin: float) -> None:
        kernels.light_vertices(self._world, m.axes, m.texels.shape[1], margin, self._light, m.frame)
        kernels.rasterise_light(self._light, self._casters, self._caster_start, m)


class _Buffers:
    """Scratch memory for one image size."""

    def __init__(self, width: int, height: int, rich: bool) -> None:
        size = (height * kernels.SUB, width * kernels.SUB)
        self.triangle = np.empty(size, np.int32)
        self.inverse_depth = np.empty(size, np.float32)
        self.stamp = np.empty((height, width), np.int32)
        self.row = _row(width)
        texels = 192 if max(width, height) <= 160 else 512 if max(width, height) <= 400 else 1024
        self.shadow = _light_map(texels, np.eye(3))
        # No power of two, whose columns would compete for the same lines of the processor's cache.
        size = max(texels // 5 // kernels.TILE * kernels.TILE, 56) if rich else OCCLUSION_SIZE
        self.below = _light_map(size, light_axes((0.0, 0.0, -1.0)))
        self.occlusion, self.contact = np.zeros((size, size)), np.zeros((size, size))

    def clear(self) -> None:
        self.triangle.fill(-1)
        self.inverse_depth.fill(0)
        self.stamp.fill(-1)


def _row(width: int) -> kernels.Row:
    count = width * kernels.SUB**2
    kind, owner, pixel = (np.empty(count, np.int32) for _ in range(3))
    share, second, blur, fade = (np.empty(count) for _ in range(4))
    at, point, normal, look, light, color, albedo, mirrored = (np.empty((count, 3)) for _ in range(8))
    total = np.empty((width, 3))
    return kernels.Row(
        kind, owner, pixel, share, at, point, normal, look, second, albedo, light, blur, color, total, mirrored, fade
    )


def _light_map(size: int, axes: np.ndarray) -> kernels.LightMap:
    tiles = size // max(kernels.TILE, size // 64)
    return kernels.LightMap(
        texels=np.full((3, size, size), kernels.FAR, np.float32),
        tiles=np.full((tiles, tiles, 3), kernels.FAR, np.float32),
        used=np.zeros((tiles, tiles), np.uint8),
        counts=np.zeros((tiles + 1, tiles + 1), np.int64),
        frame=np.zeros(4),
        axes=axes,
    )


@functools.lru_cache(maxsize=32)
def _view(camera: Camera, width: int, height: int, table_half: float) -> tuple[np.ndarray, np.ndarray]:
    """World direction of a sample's ray, scaled to depth 1, with position and sizes; and samples from world points."""
    k = camera.k(width, height)
    k[:2] *= kernels.SUB
    world_from_camera = camera.world_from_camera
    k_inverse = np.array([[1 / k[0, 0], 0, -k[0, 2] / k[0, 0]], [0, 1 / k[1, 1], -k[1, 2] / k[1, 1]], [0, 0, 1]])
    view = np.zeros((4, 4))
    view[:3, :3] = world_from_camera[:3, :3] @ k_inverse
    view[:3, 3] = world_from_camera[:3, 3]
    view[3, :2] = table_half, kernels.SUB / k[0, 0]
    return view, k @ invert_rigid(world_from_camera)[:3]


def _pack_mesh(shapes: Sequence[Shape]) -> tuple[kernels.Mesh, np.ndarray, np.ndarray]:
    vertex_start = np.cumsum([0, *(len(s.vertices) for s in shapes)])
    face_start = np.cumsum([0, *(len(s.faces) for s in shapes)])
    vertices = np.concatenate([np.zeros((0, 3)), *(s.vertices for s in shapes)])
    faces = np.concatenate(
        [np.zeros((0, 3)), *(s.faces + start for s, start in zip(shapes, vertex_start, strict=False))]
    )
    normals = np.concatenate([np.zeros((0, 3, 3)), *(s.normals for s in shapes)])
    faces = faces.astype(np.int32)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    # Unit normals of the faces; faces without area have none.
    across = cross(b - a, c - a)
    length = np.sqrt(np.sum(across * across, axis=1, keepdims=True))
    mesh = kernels.Mesh(
        vertices=vertices,
        faces=faces,
        owners=np.repeat(np.arange(len(shapes)), np.diff(face_start)).astype(np.int32),
        normals=normals.astype(np.float32),
        face_normals=(across / np.where(length > 0, length, 1)).astype(np.float32),
    )
    return mesh, vertex_start, face_start


def _casters(shapes: Sequence[Shape], faces: np.ndarray, face_start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces that cast shadows: all but the back sides of open surfaces, which would shade their own front sides."""
    if not any(shape.backs for shape in shapes):
        return faces, face_start
    ends = face_start[1:] - [shape.backs for shape in shapes]
    parts = [faces[start:end] for start, end in zip(face_start[:-1], ends, strict=True)]
    return np.concatenate(parts), np.cumsum([0, *(len(part) for part in parts)])


def _pack_skins(shapes: Sequence[Shape], face_start: np.ndarray) -> kernels.Skins | None:
    """Textures and colours of all meshes; None if no mesh has any."""
    skins = [shape.skin for shape in shapes]
    if not any(skins):
        return None
    count = int(face_start[-1])
    uv, colors = np.zeros((count, 3, 2), np.float32), np.zeros((count, 3, 3), np.float32)
    density, texture = np.zeros(count, np.float32), np.zeros(count, np.int32)
    # Pyramids of images in one array of texels; `levels` says where each pyramid starts.
    levels, images, texels = [0], [], [np.zeros((0, 3), np.uint8)]
    for skin, start, end in zip(skins, face_start[:-1], face_start[1:], strict=True):
        if skin is None:
            continue
        uv[start:end], colors[start:end], density[start:end] = skin.uv, skin.colors, skin.density
        texture[start:end] = skin.texture + len(levels) - 1
        for pyramid in skin.pyramids:
            for image in pyramid:
                images.append((sum(map(len, texels)), image.shape[1], image.shape[0]))
                texels.append(image.reshape(-1, 3))
            levels.append(len(images))
    return kernels.Skins(
        uv,
        colors,
        density,
        texture,
        np.array(levels, np.int64),
        np.array(images, np.int64).reshape(-1, 3),
        np.concatenate(texels),
    )


def pattern_index(pattern: Pattern, *, rich: bool) -> int:
    """Index into `kernels.PATTERNS`; rich images have their own noise."""
    return kernels.PATTERNS.index("clouds" if rich and pattern == "noise" else pattern)


def _pack_material(material: Material, rich: bool) -> Float[np.ndarray, "column"]:
    pattern = pattern_index(material.pattern, rich=rich)
    colors = [*linear(material.color), *linear(material.color2)]
    return np.array([*colors, pattern, material.period, *material.axis, material.roughness, material.metalness])


def _pack_lights(lights: Sequence[Light]) -> Float[np.ndarray, "light 8"]:
    rows = [[*light_axes(x.direction)[2], *x.radiance, x.angular_radius, np.tan(x.angular_radius)] for x in lights]
    return np.array(rows, np.float64).reshape(-1, 8)


def _ground(scene: Scene) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Linear RGB that the middle of the table sends upwards, as objects see it from above; and that arrives there."""
    material = scene.table.material
    albedo = linear(material.color)
    if material.pattern != "plain":
        albedo = 0.5 * (albedo + linear(material.color2))
    arriving = np.array(scene.ambient, np.float64)
    for light in scene.lights:
        arriving = arriving + max(light.direction[2], 0.0) * np.array(light.radiance)
    return albedo * arriving, arriving
