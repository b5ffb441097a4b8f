"""Other renderers that render the same meshes; each function gives a call that makes colour, depth and ids of a frame.

They do not do the same work: shadows are hard or absent, edges are anti-aliased otherwise or not at all.
"""

import os
from collections.abc import Callable
from typing import Any
from unittest import mock

import numpy as np
import pytest

from datagen.render import make_renderer
from datagen.render.renderer import PathTracer, light_axes
from datagen.scene import Material, Scene
from datagen.shapes.shape import Shape
from tests.worlds.handmade import FRONT, poses

Frame = Callable[[], Any]
MITSUBA_SAMPLES = 16


def mitsuba(scene: Scene, shapes: list[Shape], size: int) -> Frame:
    """The renderer `mitsuba` of this package: path tracing, with 16 paths per pixel; labels by the rasteriser."""
    renderer, at = make_renderer("mitsuba", samples=MITSUBA_SAMPLES), poses(scene)
    assert isinstance(renderer, PathTracer)
    renderer.load(scene, shapes)

    def frame() -> Any:
        return renderer.photograph(at, FRONT, size, size), renderer.render(at, FRONT, size, size)

    return frame


def mujoco(scene: Scene, shapes: list[Shape], size: int) -> Frame:
    """MuJoCo on EGL: a pass for colour with shadow, one for depth, one for ids; the model is kept."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    mujoco = pytest.importorskip("mujoco", exc_type=ImportError)
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth = spec.visual.global_.offheight = size
    half = scene.table.size / 2
    table = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[half, half, 0.01], pos=[0, 0, -0.01])
    table.rgba = [*scene.table.material.color, 1]
    for row, (body, shape) in enumerate(zip(scene.bodies, shapes, strict=True)):
        spec.add_mesh(name=f"{row}", uservert=shape.vertices.ravel(), userface=shape.faces.ravel())
        place = {"pos": body.position, "quat": body.quaternion_wxyz, "rgba": [*body.material.color, 1]}
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{row}", contype=0, conaffinity=0, **place)
    light = spec.worldbody.add_light(pos=[0, 0, 2], castshadow=True)
    light.type, light.dir = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, [-x for x in scene.lights[0].direction]
    quaternion = np.zeros(4)
    axes = FRONT.world_from_camera[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(axes).ravel())
    spec.worldbody.add_camera(
        name="front", pos=FRONT.position, quat=quaternion, fovy=float(np.degrees(FRONT.field_of_view))
    )
    model = spec.compile()
    data, renderer = mujoco.MjData(model), mujoco.Renderer(model, size, size)
    mujoco.mj_forward(model, data)

    def frame() -> Any:
        renderer.update_scene(data, camera="front")
        rgb = renderer.render()
        renderer.enable_depth_rendering()
        depth = renderer.render()
        renderer.disable_depth_rendering()
        renderer.enable_segmentation_rendering()
        ids = renderer.render()
        renderer.disable_segmentation_rendering()
        return rgb, depth, ids

    return frame


def open3d(scene: Scene, shapes: list[Shape], size: int) -> Frame:
    """Open3D's ray caster (Embree), one ray per pixel, a hard shadow, Lambert's law in NumPy; the scene is kept."""
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    world = o3d.t.geometry.RaycastingScene(nthreads=1)
    half = scene.table.size / 2
    corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    meshes = [(corners, np.array([[0, 1, 2], [0, 2, 3]]))]
    meshes += [
        (shape.vertices @ pose[:3, :3].T + pose[:3, 3], shape.faces)
        for shape, pose in zip(shapes, poses(scene), strict=True)
    ]
    for vertices, faces in meshes:
        world.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    colors = np.array([scene.table.material.color, *(body.material.color for body in scene.bodies), (0.8, 0.8, 0.8)])
    camera, light = np.linalg.inv(FRONT.world_from_camera), np.array(scene.lights[0].direction, np.float32)
    rays = o3d.t.geometry.RaycastingScene.create_rays_pinhole(FRONT.k(size, size), camera, size, size)
    starts, ways = np.split(rays.numpy(), 2, axis=-1)

    def frame() -> Any:
        hit = world.cast_rays(rays, nthreads=1)
        distance, normals = hit["t_hit"].numpy(), hit["primitive_normals"].numpy()
        ids = np.minimum(hit["geometry_ids"].numpy(), len(scene.bodies) + 1)
        there = np.isfinite(distance)
        points = starts + ways * np.where(there, distance, 0)[..., None]
        toward_light = np.concatenate([points + 1e-3 * light, np.broadcast_to(light, points.shape)], axis=-1)
        dark = world.test_occlusions(o3d.core.Tensor(toward_light), tnear=1e-3, nthreads=1).numpy()
        facing = np.abs(normals @ light) * ~dark
        rgb = (255 * np.clip(colors[ids] * (0.3 + 0.7 * facing)[..., None], 0, 1)).astype(np.uint8)
        return rgb, np.where(there, distance, 0), ids

    return frame


class PyrenderPeer:
    """pyrender as one would use it: indexed meshes, shared normals, one pass for colour and one for depth and ids."""

    def __init__(self, size: int) -> None:
        import pyrender
        import trimesh

        self._p, self._trimesh = pyrender, trimesh
        self._context = pyrender.OffscreenRenderer(size, size)
        self._size = size

    def rebuilt(self, scene: Scene, shapes: list[Shape]) -> Frame:
        def frame() -> Any:
            world, ids = self._scene(scene, shapes)
            return self._two_passes(world, ids, self._p.RenderFlags.NONE)

        return frame

    def kept(self, scene: Scene, shapes: list[Shape]) -> Frame:
        world, ids = self._scene(scene, shapes)
        at = poses(scene)

        def frame() -> Any:
            for node, pose in zip(list(ids)[1:], at, strict=True):
                world.set_pose(node, pose)
            return self._two_passes(world, ids, self._p.RenderFlags.SHADOWS_DIRECTIONAL)

        return frame

    def _two_passes(self, world: Any, ids: dict[Any, int], flags: int) -> Any:
        colors = {node: (number, 0, 0) for node, number in ids.items()}
        # pyrender uses a name that NumPy 2 does not have.
        with mock.patch.object(np, "infty", np.inf, create=True):
            segmented: Any = self._context.render(world, flags=self._p.RenderFlags.SEG, seg_node_map=colors)
            shaded: Any = self._context.render(world, flags=flags)
        return shaded[0], *segmented

    def _scene(self, scene: Scene, shapes: list[Shape]) -> tuple[Any, dict[Any, int]]:
        p = self._p
        world = p.Scene(ambient_light=[0.3, 0.3, 0.3], bg_color=[0.8, 0.8, 0.8])
        slab = self._trimesh.creation.box((scene.table.size, scene.table.size, 0.02))
        slab.apply_translation((0, 0, -0.01))
        ids = {world.add(p.Mesh.from_trimesh(slab, smooth=False)): 0}
        for row, (body, shape, pose) in enumerate(zip(scene.bodies, shapes, poses(scene), strict=True)):
            mesh = self._trimesh.Trimesh(shape.vertices, shape.faces, process=False)
            node = world.add(p.Mesh.from_trimesh(mesh, material=self._material(body.material)), pose=pose)
            ids[node] = row + 1
        k = FRONT.k(self._size, self._size)
        camera = p.IntrinsicsCamera(k[0, 0], k[1, 1], k[0, 2], k[1, 2], znear=0.05, zfar=100.0)
        world.add(camera, pose=FRONT.world_from_camera @ np.diag([1.0, -1.0, -1.0, 1.0]))
        world.add(p.DirectionalLight(color=np.ones(3), intensity=3.0), pose=_toward_light(scene))
        return world, ids

    def _material(self, material: Material) -> Any:
        color = [*(channel**2.2 for channel in material.color), 1.0]
        return self._p.MetallicRoughnessMaterial(baseColorFactor=color, metallicFactor=0.0, roughnessFactor=0.5)


def _toward_light(scene: Scene) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = light_axes(scene.lights[0].direction).T
    return pose


def tiny(pybullet: Any, scene: Scene, shapes: list[Shape], size: int) -> tuple[Frame, int]:
    """PyBullet's software renderer on the same meshes, which it reads as visual shapes."""
    client = pybullet.connect(pybullet.DIRECT)
    slab = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=[scene.table.size / 2] * 2 + [0.01])
    pybullet.createMultiBody(0, -1, slab, [0, 0, -0.01])
    for body, shape in zip(scene.bodies, shapes, strict=True):
        look = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=shape.vertices[shape.faces].reshape(-1, 3).tolist(),
            indices=list(range(3 * len(shape.faces))),
            normals=shape.normals.reshape(-1, 3).tolist(),
            rgbaColor=[*body.material.color, 1],
        )
        w, x, y, z = body.quaternion_wxyz
        pybullet.createMultiBody(1, -1, look, body.position, [x, y, z, w])
    view = pybullet.computeViewMatrix(FRONT.position, FRONT.target, [0, 0, 1])
    lens = pybullet.computeProjectionMatrixFOV(np.degrees(FRONT.field_of_view), 1.0, 0.05, 10.0)

    def frame() -> Any:
        return pybullet.getCameraImage(
            size,
            size,
            view,
            lens,
            lightDirection=scene.lights[0].direction,
            shadow=1,
            renderer=pybullet.ER_TINY_RENDERER,
        )

    return frame, client
