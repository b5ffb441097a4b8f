"""The 3D scene: points, boxes, shapes, cameras and the gizmo, as nodes of viser.

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
from obpose.pictures import box_edges, to_bytes
from obpose.scenes.scene import Camera, Scene, upright
from obpose.viewer.point_clouds import Cloud, slot_colour, tinted
from obpose.viewer.session import Session

_VIEW_ANGLE, _VIEW_DISTANCE, _FIELD_OF_VIEW = math.radians(50), 1.5, math.radians(40)
"""First view of the page: the first input camera, turned around the objects, moved away by this factor (so that its own
image hides nothing), with this vertical field of view."""
_GRID_DEPTH = 0.003
"""Metres of the grid below the table, to avoid z-fighting with points on the table."""

DRAWN_AS = ("shapes", "points by object", "points as observed")
"""Ways to draw objects. Shapes and points of an object coincide and would flicker, so only one of them is visible."""

Edit = Callable[[Callable[[Session], None]], None]


@dataclass(frozen=True)
class Layers:
    """Visible parts of the 3D scene."""

    drawn_as: str = DRAWN_AS[0]
    """One of `DRAWN_AS`; objects without a shape are always drawn as points."""
    boxes: bool = True
    cameras: bool = True


@dataclass
class _ObjectNodes:
    """Nodes of one object."""

    frame: viser.FrameHandle
    box: viser.LineSegmentsHandle
    cloud: Cloud | None = None
    is_tinted: bool = True
    points: viser.PointCloudHandle | None = None
    mesh: bytes | None = None
    shape: viser.GlbHandle | None = None


class Scene3D:
    """The nodes of one page."""

    def __init__(self, server: viser.ViserServer, model: ObPose, scene: Scene, edit: Edit):
        """Add the nodes; clicks and drags call `edit` with a change of the session."""
        self._scene, self._edit = server.scene, edit
        self._spacing, self._box = model.config.model.spacing, model.config.model.pose.box_size
        self._holding = False
        self._unedited: Scene | None = None
        self._nodes: dict[int, _ObjectNodes] = {}
        self._clouds: Mapping[int, Cloud] = {}
        self._table: viser.PointCloudHandle | None = None
        self._table_cloud: Cloud | None = None
        self._dragging = -1  # browser window that started the latest drag
        size = model.config.model.workspace_size
        self._scene.add_grid(
            "/table", width=size, height=size, cell_size=0.1, section_size=0.5, position=(0, 0, -_GRID_DEPTH)
        )
        self._frusta = [self._add_frustum(view, camera) for view, camera in enumerate(scene.cameras)]
        self._gizmo = self._add_gizmo()
        middle = scene.center[0].mean(dim=0) if scene.ids else model.center
        set_initial_view(server, scene.cameras[0], middle)

    def show(self, session: Session, layers: Layers) -> None:
        """Update all nodes to the session."""
        if self._unedited is not session.version.unedited:
            # Another scene, in which equal names mean other objects.
            self._remove(set(self._nodes))
            self._unedited = session.version.unedited
        self._remove(self._nodes.keys() - set(session.scene.ids))
        for name in session.scene.ids:
            self._show_object(session, name, layers)
        self._hold(session.selected is not None)
        self._show_table(session)
        self._show_gizmo(session)
        for frustum in self._frusta:
            frustum.visible = layers.cameras

    def put_clouds(self, clouds: Mapping[int, Cloud]) -> None:
        """Set the observed points, which the next `show` draws."""
        self._clouds = clouds

    def put_shape(self, name: int, mesh: bytes | None) -> None:
        """Set the surface of an object, a GLB in its frame or None, which the next `show` makes visible."""
        nodes = self._nodes.get(name)
        if nodes is None or nodes.mesh is mesh:
            return
        if nodes.shape is not None:
            nodes.shape.remove()
        nodes.mesh, nodes.shape = mesh, None
        if mesh is not None:
            nodes.shape = self._scene.add_glb(f"/objects/{name}/shape", mesh, visible=False, cast_shadow=False)
            self._set_clickable(name, nodes)

    def put_inputs(self, images: Float[Tensor, "view h w 3"]) -> None:
        """Show the images of a frame in the input cameras."""
        for frustum, image in zip(self._frusta, images, strict=True):
            frustum.image = to_bytes(image)

    def _remove(self, names: set[int]) -> None:
        for name in names:
            self._nodes.pop(name).frame.remove()

    def _hold(self, holding: bool) -> None:
        if holding != self._holding:
            self._holding = holding
            for name, nodes in self._nodes.items():
                self._set_clickable(name, nodes)

    def _set_clickable(self, name: int, nodes: _ObjectNodes) -> None:
        """Make shapes clickable while no object is held; otherwise they would take clicks on the gizmo behind them."""
        if nodes.shape is not None:
            nodes.shape.remove_click_callback("all")
            if not self._holding:
                nodes.shape.on_click(lambda _: self._edit(lambda session: session.toggle(name)))

    def _show_object(self, session: Session, name: int, layers: Layers) -> None:
        nodes = self._nodes.get(name) or self._add_object(name)
        place, frame = session.scene.place(name), session.frame
        nodes.frame.position = session.scene.center[frame, place].numpy()
        nodes.frame.wxyz = _wxyz(session.scene.rotation[frame, place])
        nodes.frame.visible = name not in session.hidden
        nodes.box.visible = layers.boxes
        nodes.box.thickness = 0.004 if session.selected == name else 0.002
        self._put_points(session, name, nodes, layers)
        shape_visible = layers.drawn_as == "shapes" and nodes.shape is not None
        if nodes.shape is not None:
            nodes.shape.visible = shape_visible
        if nodes.points is not None:
            nodes.points.visible = not shape_visible

    def _add_object(self, name: int) -> _ObjectNodes:
        root = f"/objects/{name}"
        frame = self._scene.add_frame(root, show_axes=False)
        edges = box_edges(torch.zeros(3), torch.eye(3), torch.full((3,), self._box)).numpy()
        box = self._scene.add_line_segments(f"{root}/box", edges, slot_colour(name))
        self._scene.add_label(f"{root}/label", str(name), anchor="center-center", font_screen_scale=0.9)
        self._nodes[name] = _ObjectNodes(frame, box)
        return self._nodes[name]

    def _put_points(self, session: Session, name: int, nodes: _ObjectNodes, layers: Layers) -> None:
        """Draw the observed points of an object again if they or their colours changed."""
        cloud = self._clouds.get((session.version.sources or {}).get(name, -1))
        is_tinted = layers.drawn_as != "points as observed"
        if cloud is nodes.cloud and is_tinted == nodes.is_tinted:
            return
        if nodes.points is not None:
            nodes.points.remove()
        nodes.cloud, nodes.is_tinted, nodes.points = cloud, is_tinted, None
        if cloud is not None:
            colours = tinted(cloud, name) if is_tinted else cloud.colours
            nodes.points = self._add_points(f"/objects/{name}/points", cloud.points, colours)

    def _show_table(self, session: Session) -> None:
        cloud = self._clouds.get(0)
        if cloud is not None and cloud is not self._table_cloud:
            if self._table is not None:
                self._table.remove()
            self._table_cloud = cloud
            self._table = self._add_points("/background", cloud.points, cloud.colours)
        if self._table is not None:
            self._table.visible = session.version.sources is not None

    def _add_points(self, name: str, points: np.ndarray, colours: np.ndarray) -> viser.PointCloudHandle:
        size = self._spacing
        return self._scene.add_point_cloud(
            name, points, colours, point_size=size, point_shape="circle", precision="float32"
        )

    def _show_gizmo(self, session: Session) -> None:
        """Place the gizmo at the selected object, along the world's axes, unless it is being dragged."""
        name = session.selected
        self._gizmo.visible = name is not None
        if name is not None and not session.is_dragging:
            self._gizmo.position = session.scene.center[session.frame, session.scene.place(name)].numpy()
            self._gizmo.wxyz = (1.0, 0.0, 0.0, 0.0)

    def _add_gizmo(self) -> viser.TransformControlsHandle:
        gizmo = self._scene.add_transform_controls("/gizmo", scale=0.8 * self._box, depth_test=False, visible=False)

        # A coroutine, because viser calls coroutines in order, and threads in any order.
        @gizmo.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            to = torch.tensor(event.target.position, dtype=torch.float32)
            turn = torch.tensor(transforms.SO3(np.asarray(event.target.wxyz)).as_matrix(), dtype=torch.float32)
            if event.phase == "start":
                self._dragging = event.client_id
                self._edit(Session.grab)
            elif event.client_id != self._dragging:
                return  # another window has started to drag since
            elif event.phase == "update":
                self._edit(lambda session: session.drag(to, turn))
            else:
                self._edit(Session.drop)

        return gizmo

    def _add_frustum(self, view: int, camera: Camera) -> viser.CameraFrustumHandle:
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
        frustum.on_click(lambda _: self._edit(lambda session: session.go_to_view(view)))
        return frustum


def set_initial_view(server: viser.ViserServer, camera: Camera, middle: Float[Tensor, "3"]) -> None:
    """Let new browser windows look at the middle, from beside an input camera."""
    away = camera.world_from_camera[:3, 3] - middle
    server.initial_camera.position = (middle + _VIEW_DISTANCE * upright(_VIEW_ANGLE, middle) @ away).numpy()
    server.initial_camera.look_at = middle.numpy()
    server.initial_camera.up = (0.0, 0.0, 1.0)
    server.initial_camera.fov = _FIELD_OF_VIEW


def _wxyz(rotation: Float[Tensor, "3 3"]) -> np.ndarray:
    return transforms.SO3.from_matrix(rotation.double().numpy()).wxyz
