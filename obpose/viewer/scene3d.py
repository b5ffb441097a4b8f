"""The scene in three dimensions: points, boxes, shapes, cameras and the gizmo, as nodes of viser.

All nodes of an object hang below one frame at its pose, so that dragging it moves one node.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
import viser
from jaxtyping import Float
from torch import Tensor
from viser import transforms

from obpose.model.obpose import ObPose
from obpose.pictures import box_edges
from obpose.scenes.scene import Camera, Scene, upright
from obpose.types import Boxes
from obpose.viewer.point_clouds import Cloud, slot_colour, tinted
from obpose.viewer.session import Session

_LOOK_FROM, _LOOK_FARTHER, _LOOK_ANGLE = math.radians(50), 1.5, math.radians(40)
"""The page's first view: the first camera's, carried so far around and away from the objects, so that its picture hides
nothing; and its vertical angle."""
_DOWN = 0.003
"""Metres that the grid lies below the table, whose points would flicker."""


@dataclass(frozen=True)
class Layers:
    """What is drawn."""

    points: str = "by object"
    """One of `POINTS`."""
    shapes: bool = True
    boxes: bool = True
    cameras: bool = True


POINTS = ("by object", "as seen", "none")


@dataclass
class _Nodes:
    """What is drawn of one object."""

    frame: viser.FrameHandle
    box: viser.LineSegmentsHandle
    label: viser.LabelHandle
    cloud: Cloud | None = None
    points: viser.PointCloudHandle | None = None
    what: torch.Tensor | None = None
    """Of which codes the shape is, in all frames."""
    mesh: bytes | None = None
    shape: viser.GlbHandle | None = None


@dataclass(frozen=True)
class Events:
    """What the page is told of."""

    select: Callable[[int], None]
    """An object was clicked."""
    look: Callable[[int], None]
    """An input camera was clicked."""
    drag: Callable[[str, Float[Tensor, "3"], Float[Tensor, "3 3"]], None]
    """The gizmo: `start`, `update` or `end`, where it is in metres, and how it is turned."""


class Stage:
    """The nodes of one page."""

    def __init__(self, server: viser.ViserServer, model: ObPose, scene: Scene, events: Events):
        self._scene, self._events = server.scene, events
        self._spacing, self._box = model.config.model.spacing, model.config.model.pose.box_size
        self._layers = Layers()
        self._holding = False
        self._nodes: dict[int, _Nodes] = {}
        self._clouds: Mapping[int, Cloud] = {}
        self._table: viser.PointCloudHandle | None = None
        size = model.config.model.workspace_size
        self._scene.add_grid(
            "/table", width=size, height=size, cell_size=0.1, section_size=0.5, position=(0, 0, -_DOWN)
        )
        self._frusta = [self._frustum(view, camera) for view, camera in enumerate(scene.cameras)]
        self._gizmo = self._add_gizmo()
        look_from(server, scene.cameras[0], _middle(scene, model))

    def show(self, session: Session, layers: Layers) -> None:
        """Make the nodes those of the session."""
        if layers.points != self._layers.points:
            self._forget_points()
        self._layers = layers
        self._hold(session.selected is not None)
        for name in self._nodes.keys() - set(session.scene.ids):
            self._nodes.pop(name).frame.remove()
        for name in session.scene.ids:
            self._show_object(session, name)
        self._show_table(session)
        self._show_gizmo(session)
        for frustum in self._frusta:
            frustum.visible = layers.cameras

    def put_clouds(self, clouds: Mapping[int, Cloud]) -> None:
        """Points to show from the next `show` on."""
        self._clouds = clouds

    def put_shape(self, name: int, mesh: bytes | None) -> None:
        """Show an object's surface, a GLB in its frame, or that it has none."""
        nodes = self._nodes.get(name)
        if nodes is None or nodes.mesh is mesh:
            return
        self._forget_shape(nodes)
        nodes.mesh = mesh
        if mesh is not None:
            visible = self._layers.shapes
            nodes.shape = self._scene.add_glb(f"/objects/{name}/shape", mesh, visible=visible, cast_shadow=False)
            self._let_click(name, nodes)

    def put_inputs(self, images: list[np.ndarray]) -> None:
        """Show the images of a frame in the input cameras."""
        for frustum, image in zip(self._frusta, images, strict=True):
            frustum.image = image

    def _hold(self, holding: bool) -> None:
        if holding != self._holding:
            self._holding = holding
            for name, nodes in self._nodes.items():
                self._let_click(name, nodes)

    def _let_click(self, name: int, nodes: _Nodes) -> None:
        """Shapes are clicked while no object is held; else they would take clicks on the gizmo behind them."""
        if nodes.shape is not None:
            nodes.shape.remove_click_callback("all")
            if not self._holding:
                nodes.shape.on_click(lambda _: self._events.select(name))

    def _show_object(self, session: Session, name: int) -> None:
        nodes = self._nodes.get(name) or self._add_object(name)
        place, frame = session.scene.place(name), session.frame
        nodes.frame.position = session.scene.center[frame, place].numpy()
        nodes.frame.wxyz = _wxyz(session.scene.rotation[frame, place])
        nodes.frame.visible = name not in session.hidden
        nodes.box.visible = self._layers.boxes
        nodes.box.thickness = 0.004 if session.selected == name else 0.002
        what = session.scene.what[:, place]
        if nodes.what is None or not torch.equal(nodes.what, what):
            self._forget_shape(nodes)  # another object has come to this name
            nodes.what = what
        if nodes.shape is not None:
            nodes.shape.visible = self._layers.shapes
        seen_as = session.version.seen_as or {}
        cloud = self._clouds.get(seen_as.get(name, -1))
        if cloud is not nodes.cloud:
            self._put_points(name, nodes, cloud)

    def _add_object(self, name: int) -> _Nodes:
        root = f"/objects/{name}"
        frame = self._scene.add_frame(root, show_axes=False)
        here = Boxes(torch.zeros(1, 1, 1, 3), torch.eye(3).expand(1, 1, 1, 3, 3), self._box)
        edges = box_edges(here, 0, 0)[0].numpy()
        box = self._scene.add_line_segments(f"{root}/box", edges, slot_colour(name))
        label = self._scene.add_label(f"{root}/label", str(name), anchor="center-center", font_screen_scale=0.9)
        self._nodes[name] = _Nodes(frame, box, label)
        return self._nodes[name]

    def _forget_shape(self, nodes: _Nodes) -> None:
        if nodes.shape is not None:
            nodes.shape.remove()
        nodes.mesh = nodes.shape = None

    def _put_points(self, name: int, nodes: _Nodes, cloud: Cloud | None) -> None:
        if nodes.points is not None:
            nodes.points.remove()
        nodes.cloud, nodes.points = cloud, None
        if cloud is not None and self._layers.points != "none":
            colours = tinted(cloud, name) if self._layers.points == "by object" else cloud.colours
            nodes.points = self._add_points(f"/objects/{name}/points", cloud.points, colours)

    def _show_table(self, session: Session) -> None:
        cloud = self._clouds.get(0)
        if self._table is None and cloud is not None and self._layers.points != "none":
            self._table = self._add_points("/background", cloud.points, cloud.colours)
        if self._table is not None:
            self._table.visible = session.version.seen_as is not None

    def _forget_points(self) -> None:
        """As if none had been put, so that they are drawn anew."""
        if self._table is not None:
            self._table.remove()
            self._table = None
        for name, nodes in self._nodes.items():
            self._put_points(name, nodes, None)

    def _add_points(self, name: str, points: np.ndarray, colours: np.ndarray) -> viser.PointCloudHandle:
        size = self._spacing
        return self._scene.add_point_cloud(
            name, points, colours, point_size=size, point_shape="circle", precision="float32"
        )

    def _show_gizmo(self, session: Session) -> None:
        """Along the world's axes; who drags it has it where it is."""
        name = session.selected
        self._gizmo.visible = name is not None
        if name is not None and not session.is_dragging:
            self._gizmo.position = session.scene.center[session.frame, session.scene.place(name)].numpy()
            self._gizmo.wxyz = (1.0, 0.0, 0.0, 0.0)

    def _add_gizmo(self) -> viser.TransformControlsHandle:
        gizmo = self._scene.add_transform_controls("/gizmo", scale=0.8 * self._box, depth_test=False, visible=False)

        # A coroutine, because viser calls these in order, which threads would not keep.
        @gizmo.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            turn = transforms.SO3(np.asarray(event.target.wxyz)).as_matrix()
            at = torch.tensor(event.target.position, dtype=torch.float32)
            self._events.drag(event.phase, at, torch.tensor(turn, dtype=torch.float32))

        return gizmo

    def _frustum(self, view: int, camera: Camera) -> viser.CameraFrustumHandle:
        frustum = self._scene.add_camera_frustum(
            f"/cameras/{view}",
            fov=2 * math.atan(camera.height / (2 * float(camera.k[1, 1]))),
            aspect=camera.width / camera.height,
            scale=0.06,
            thickness=0.002,
            cast_shadow=False,
            position=camera.world_from_camera[:3, 3].numpy(),
            wxyz=_wxyz(camera.world_from_camera[:3, :3]),
        )
        frustum.on_click(lambda _: self._events.look(view))
        return frustum


def look_from(server: viser.ViserServer, camera: Camera, middle: Float[Tensor, "3"]) -> None:
    """Let pages begin with a view of the middle beside that of a camera."""
    away = camera.world_from_camera[:3, 3] - middle
    server.initial_camera.position = (middle + _LOOK_FARTHER * upright(_LOOK_FROM, middle) @ away).numpy()
    server.initial_camera.look_at = middle.numpy()
    server.initial_camera.up = (0.0, 0.0, 1.0)
    server.initial_camera.fov = _LOOK_ANGLE


def _middle(scene: Scene, model: ObPose) -> Float[Tensor, "3"]:
    """Of the objects in the first frame, else of the workspace."""
    return scene.center[0].mean(dim=0) if scene.ids else model.center


def _wxyz(rotation: Float[Tensor, "3 3"]) -> np.ndarray:
    return transforms.SO3.from_matrix(rotation.double().numpy()).wxyz
