"""Photorealistic colours from the path tracer Mitsuba 3, on CPUs; depth, ids and all labels come from the rasteriser.

All light comes from one environment map: the room of rich images, tinted with the ambient light, and a disc for each
light. A white surface that receives an irradiance of 1 shows as white, as in the rasteriser, so that a radiance of the
scene is an irradiance of pi here.
"""

import functools
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from datagen.errors import UsageError
from datagen.geometry import linear
from datagen.render import kernels
from datagen.render.pyrender_gl import refine
from datagen.render.raster import RasterRenderer, pattern_index
from datagen.render.renderer import NEAREST, light_axes
from datagen.scene import Camera, Material, Scene
from datagen.shapes.shape import Shape

LEAST_LLVM = 19
"""Oldest LLVM known to compile Mitsuba's code: 14, 15 and 16 abort the process; 17 and 18 are untested."""

BOUNCES = 6
"""Longest path, in segments."""

PASSES = 4
"""Separate images of a pixel's samples, of which single bright ones are noise."""

BRIGHTER = 2.0
"""Largest brightness of a pass in a pixel, in units of the second lowest of all passes."""

SKY_SIZE = (256, 512)
"""Rows and columns of the environment map."""

MOST_TEXELS = 2048
"""Largest side of the image of a table's pattern."""

WIDE_LIGHT = np.radians(30)
"""Angular radius of lights that cast no shadow in the rasteriser: so wide that none is seen."""

MISSING = (
    "The mitsuba renderer needs Mitsuba ({reason}). Install it with `pip install 'obpose[mitsuba]'`, or use "
    "`--renderer rich`, which needs no further package."
)


class MitsubaRenderer(RasterRenderer):
    """The rasteriser, which makes all labels, with a second method that makes the colours.

    Raises:
        UsageError: Mitsuba is not installed.
    """

    name = "mitsuba"
    version = 2

    def __init__(self, samples: int) -> None:
        super().__init__()
        self.samples = samples
        self._mi, self.engine = start()
        self._far = RasterRenderer(rich=True)

    def load(self, scene: Scene, shapes: Sequence[Shape]) -> None:
        """Load a scene's materials, lights and shapes; rows follow `scene.bodies`."""
        super().load(scene, shapes)
        self._scene, self._shapes = scene, shapes
        self._far.load(scene, ())
        self._built: tuple[float, dict[str, Any], list[list[_Look]]] | None = None

    def photograph(
        self, world_from_object: Float[np.ndarray, "object 4 4"], camera: Camera, width: int, height: int
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Path-trace the loaded scene with its objects at the given poses; the noise follows from the arguments.

        Raises:
            UsageError: the camera's pixels are not square.
        """
        poses, k = np.ascontiguousarray(world_from_object, np.float64), camera.k(width, height)
        sensor = _sensor(self._mi, camera, width, height, self.samples)
        fixed, parts = self._build(float(np.linalg.norm(np.subtract(camera.position, camera.target)) / k[0, 0]))
        meshes = {
            f"object{row}-{i}": _mesh(self._mi, part, bsdf, pose)
            for row, pose in enumerate(poses)
            for i, (part, bsdf) in enumerate(parts[row])
        }
        digest = hashlib.sha256(poses.tobytes() + camera.world_from_camera.tobytes() + k.tobytes()).digest()
        world = self._mi.load_dict({**fixed, **meshes, "sensor": sensor})
        traced = self._trace(world, int.from_bytes(digest[:4], "little"))
        # Beyond the table, its surface fades into the backdrop of rich images.
        far = self._far.render(np.zeros((0, 4, 4)), camera, width, height).rgb
        missed = 1 - np.minimum(traced[..., 3:], 1.0)
        return kernels.encoded(kernels.toned(traced[..., :3].copy()) + missed * kernels.LINEAR[far])

    def _trace(self, world: Any, seed: int) -> Float[np.ndarray, "height width 4"]:
        """Mean of several passes; a pass that is much brighter than the others, by a rare path, is dimmed first."""
        shares = [share for i in range(PASSES) if (share := (self.samples + i) // PASSES)]
        passes = [self._mi.render(world, spp=share, seed=(seed + i) % 2**32) for i, share in enumerate(shares)]
        traced = np.maximum(np.array([np.asarray(one) for one in passes], np.float64), 0.0)
        bright = np.max(traced[..., :3], axis=-1)
        usual = np.sort(bright, axis=0)[(len(shares) - 1) // 2]
        traced[..., :3] *= np.minimum(1, (BRIGHTER * usual + 0.02) / np.maximum(bright, 1e-9))[..., None]
        return np.average(traced, axis=0, weights=shares)

    def _build(self, pixel: float) -> tuple[dict[str, Any], "list[list[_Look]]"]:
        """Everything but cameras and poses, for images whose pixels show about `pixel` metres."""
        # Meshes are as fine as the pixels, so that images of another scale need new ones.
        if self._built is None or not 0.8 < pixel / self._built[0] < 1.25:
            table = [_table(self._scene, pixel), _floor(self._scene, pixel)]
            fixed: dict[str, Any] = {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": BOUNCES, "hide_emitters": True},
                "sky": _sky(self._mi, self._scene, self._turn),
                **{
                    f"table-{i}": _mesh(self._mi, part, _bsdf(self._mi, part), np.eye(4))
                    for i, part in enumerate(table)
                },
            }
            bodies = zip(self._shapes, self._scene.bodies, strict=True)
            parts = [list(_parts(shape, body.material, pixel)) for shape, body in bodies]
            self._built = pixel, fixed, [[(part, _bsdf(self._mi, part)) for part in row] for row in parts]
        return self._built[1:]


@functools.cache
def start() -> tuple[Any, str]:
    """The module `mitsuba`, and its version with the back end that traces the paths."""
    try:
        import drjit
        import mitsuba
    except ImportError as error:
        raise UsageError(MISSING.format(reason=error)) from error
    mitsuba.set_variant("scalar_rgb")
    backend = "scalar"
    if drjit.has_backend(drjit.JitBackend.LLVM):
        mitsuba.set_variant("llvm_ad_rgb")
        if drjit.detail.llvm_version()[0] >= LEAST_LLVM:  # pyright: ignore[reportAttributeAccessIssue]
            backend = "llvm"
        else:
            mitsuba.set_variant("scalar_rgb")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    # Every worker is a process with one thread.
    drjit.set_thread_count(1)
    return mitsuba, f"{mitsuba.__version__} {backend}"


@dataclass(frozen=True, eq=False)
class _Part:
    """Triangles with one appearance, in the object frame."""

    corners: Float[np.ndarray, "face 3 3"]
    normals: Float[np.ndarray, "face 3 3"]
    roughness: float
    metalness: float
    colors: Float[np.ndarray, "face 3 3"] | None = None
    """Linear RGB of the corners."""
    uv: Float[np.ndarray, "face 3 2"] | None = None
    texture: Float[np.ndarray, "_ _ 3"] | None = None
    """Linear RGB that takes the place of `colors`; (0, 0) of `uv` is its upper left corner."""
    opacity: Float[np.ndarray, "_ _ 1"] | None = None


_Look = tuple[_Part, Any]
"""A part with its BSDF, which holds a copy of the texture and so is made once."""


def _bsdf(mi: Any, part: _Part) -> Any:
    bsdf: dict[str, Any] = {"type": "principled", "roughness": part.roughness, "metallic": part.metalness}
    bsdf["base_color"] = {"type": "mesh_attribute", "name": "vertex_color"}
    if part.texture is not None:
        bsdf["base_color"] = _bitmap(mi, part.texture)
    bsdf = {"type": "twosided", "material": bsdf}
    if part.opacity is not None:
        bsdf = {"type": "mask", "opacity": _bitmap(mi, part.opacity), "material": bsdf}
    return mi.load_dict(bsdf)


def _mesh(mi: Any, part: _Part, bsdf: Any, pose: Float[np.ndarray, "4 4"]) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    count = 3 * len(part.corners)
    mesh = mi.Mesh(
        "part", count, len(part.corners), props=properties, has_vertex_normals=True, has_vertex_texcoords=True
    )
    if part.colors is not None:
        mesh.add_attribute("vertex_color", 3, part.colors.astype(np.float32).ravel())
    # Every triangle has corners of its own, as normals and colours differ between faces.
    values = mi.traverse(mesh)
    points = part.corners.reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
    values["vertex_positions"] = points.astype(np.float32).ravel()
    values["vertex_normals"] = (part.normals.reshape(-1, 3) @ pose[:3, :3].T).astype(np.float32).ravel()
    values["faces"] = np.arange(count, dtype=np.uint32)
    if part.uv is not None:
        values["vertex_texcoords"] = part.uv.astype(np.float32).ravel()
    values.update()
    return mesh


def _bitmap(mi: Any, values: np.ndarray) -> dict[str, Any]:
    return {"type": "bitmap", "bitmap": mi.Bitmap(values.astype(np.float32)), "raw": True}


def _parts(shape: Shape, material: Material, pixel: float) -> Iterator[_Part]:
    """The parts of an object, each with one texture or with colours of corners no farther apart than a pixel."""
    front = slice(len(shape.faces) - shape.backs)
    corners, normals = shape.vertices[shape.faces][front], shape.normals[front]
    look: dict[str, Any] = {"roughness": material.roughness, "metalness": material.metalness}
    if material.pattern == "image" and shape.skin is not None:
        skin = shape.skin
        for row, pyramid in enumerate(skin.pyramids):
            own = skin.texture[front] == row
            colors, image = skin.colors[front][own], kernels.LINEAR[pyramid[0]]
            if not np.any(own):
                continue
            if image.size == 3:  # colours of vertices alone
                yield _Part(corners[own], normals[own], **look, colors=colors * image[0, 0])
            else:
                tint = np.mean(colors, axis=(0, 1))
                yield _Part(corners[own], normals[own], **look, uv=skin.uv[front][own], texture=image * tint)
        return
    if material.pattern != "plain":
        corners, normals = refine(corners, normals, pixel)
    yield _Part(corners, normals, **look, colors=_colors(material, corners, pixel))


def _colors(material: Material, points: Float[np.ndarray, "*axes 3"], width: float) -> Float[np.ndarray, "*axes 3"]:
    """Linear RGB of a material at points of the object frame, averaged over `width` metres."""
    pattern, flat = pattern_index(material.pattern, rich=True), np.ascontiguousarray(points.reshape(-1, 3))
    second = kernels.texture_weights(pattern, material.period, material.axis, flat, width)[:, None]
    return ((1 - second) * linear(material.color) + second * linear(material.color2)).reshape(points.shape)


def _square(scene: Scene, half: float, height: float, texel: float) -> _Part:
    """A square that shows the table's pattern in texels of `texel` metres."""
    count = 1 if scene.table.material.pattern == "plain" else int(np.clip(2 * half / texel, 2, MOST_TEXELS))
    center = half * (2 * (np.arange(count) + 0.5) / count - 1)
    x, y = np.meshgrid(center, -center)
    texture = _colors(scene.table.material, np.stack([x, y, 0 * x], axis=-1), 2 * half / count)
    square = np.array([[-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]])[[[0, 1, 2], [0, 2, 3]]]
    corners = np.concatenate([half * square, np.full((2, 3, 1), height)], axis=-1)
    uv = np.stack([0.5 + 0.5 * square[..., 0], 0.5 - 0.5 * square[..., 1]], axis=-1)
    material = scene.table.material
    up = np.tile([0.0, 0.0, 1.0], (2, 3, 1))
    return _Part(corners, up, material.roughness, material.metalness, uv=uv, texture=texture)


def _table(scene: Scene, pixel: float) -> _Part:
    return _square(scene, scene.table.size / 2, 0.0, pixel)


def _floor(scene: Scene, pixel: float) -> _Part:
    """Continuation of the table, a hair below it, that fades out within the first half of the `SWEEP`."""
    part = _square(scene, (1 + kernels.SWEEP / 2) * scene.table.size / 2, -5e-4, pixel)
    side = np.abs((1 + kernels.SWEEP / 2) * (2 * (np.arange(256) + 0.5) / 256 - 1))
    far = np.clip((np.maximum(side[:, None], side) - 1) / (kernels.SWEEP / 2), 0, 1)
    return replace(part, opacity=1 - (far * far * (3 - 2 * far))[..., None])


def _sky(mi: Any, scene: Scene, turn: np.ndarray) -> dict[str, Any]:
    """Environment map, whose columns turn from world y towards x and whose rows go down from z."""
    rows, columns = SKY_SIZE
    polar, turned = np.pi * (np.arange(rows) + 0.5) / rows, 2 * np.pi * (np.arange(columns) + 0.5) / columns
    polar, turned = np.meshgrid(polar, turned, indexing="ij")
    directions = np.stack([np.sin(polar) * np.sin(turned), np.sin(polar) * np.cos(turned), np.cos(polar)], axis=-1)
    # Ambient light; below the horizon it is that of the horizon.
    upward = directions * [1, 1, 0] + np.maximum(directions, 0.0) * [0, 0, 1]
    image = kernels.sky(turn, upward.reshape(-1, 3), 0.01).reshape(rows, columns, 1) * np.array(scene.ambient)
    # Discs of the lights, scaled to an irradiance of pi times the radiance on a facing surface.
    for light in scene.lights:
        radius = max(light.angular_radius, np.pi / rows) if light.casts_shadow else WIDE_LIGHT
        cosine = directions @ light_axes(light.direction)[2]
        disc = np.clip((radius - np.arccos(np.clip(cosine, -1, 1))) * rows / np.pi + 0.5, 0, 1)
        weight = np.sum(disc * cosine * np.sin(polar)) * 2 * np.pi**2 / (rows * columns)
        image += disc[..., None] * np.pi * np.array(light.radiance) / weight
    upright = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    return {"type": "envmap", "bitmap": mi.Bitmap(image.astype(np.float32)), "to_world": upright}


def _sensor(mi: Any, camera: Camera, width: int, height: int, samples: int) -> dict[str, Any]:
    k = camera.k(width, height)
    if abs(k[0, 0] / k[1, 1] - 1) > 1e-6:
        raise UsageError(
            f"The mitsuba renderer needs square pixels, but fx is {k[0, 0]:.2f} and fy is {k[1, 1]:.2f}; give a "
            "--resolution with the aspect of the cameras file, or use `--renderer rich`."
        )
    # OpenCV's x and y point right and down, Mitsuba's left and up.
    pose = camera.world_from_camera @ np.diag([-1.0, -1.0, 1.0, 1.0])
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(0.5 * width / k[0, 0]))),
        "principal_point_offset_x": float(0.5 - k[0, 2] / width),
        "principal_point_offset_y": float(0.5 - k[1, 2] / height),
        "near_clip": NEAREST,
        "to_world": mi.ScalarTransform4f(pose),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "rgba",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "multijitter", "sample_count": samples},
    }
