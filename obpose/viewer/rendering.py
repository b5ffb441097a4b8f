"""Progressive rendering of what the page shows: a small picture, points and shapes, then a larger picture."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import torch

from obpose.errors import UsageError
from obpose.scenes.rendering import Image, Renderer
from obpose.scenes.scene import Camera, Scene
from obpose.types import Observation
from obpose.viewer.point_clouds import Cloud, observed_clouds

_BAND_PIXELS = 4096
"""Pixels rendered between two checks for a newer request."""
_SHAPE_CELLS = 32
"""Mesh resolution: points along each edge of an object's box."""
_MOST_SHAPES = 512
"""Largest number of cached meshes."""


@dataclass(frozen=True, eq=False)
class RenderRequest:
    """A scene to draw, and how."""

    scene: Scene
    """Scene without hidden objects."""
    frame: int
    view: int
    since: float
    """Time of the request, seconds of `time.monotonic`."""


@dataclass(frozen=True, eq=False)
class Picture:
    """The scene from the requested camera."""

    image: Image
    is_preview: bool
    """Whether a larger picture follows."""


@dataclass(frozen=True, eq=False)
class Clouds:
    """Observed points of the requested frame, by name of the inferred object; 0 is the background."""

    clouds: Mapping[int, Cloud]


@dataclass(frozen=True, eq=False)
class Shape:
    """Surface of one object in its frame, as GLB; None if it is dense nowhere."""

    name: int
    mesh: bytes | None


@dataclass(frozen=True)
class Progress:
    """Finished share of the larger picture, 0 to 1."""

    share: float


Chunk = Picture | Clouds | Shape | Progress


class ProgressiveRenderer:
    """Renderer of requests in chunks; caches what edits leave unchanged."""

    def __init__(
        self, renderer: Renderer, inferred: Scene, clip: Observation | None, *, preview: int = 64, final: int = 256
    ):
        """Render scenes of one model.

        `inferred` is the scene of the clip before any edit, which assigns observed points to objects. `preview` and
        `final` are the longer sides of the first and the last picture, pixels.
        """
        self._renderer, self._inferred, self._clip = renderer, inferred, clip
        self._preview, self._final = preview, final
        self._shapes: dict[bytes, bytes | None] = {}
        self._clouds: dict[int, dict[int, Cloud]] = {}

    def render(self, request: RenderRequest) -> Iterator[Chunk]:
        """Yield a small picture, the observed points, the shapes, and a larger picture with its progress."""
        camera = request.scene.cameras[request.view]
        yield Picture(self._render(request, with_longer_side(camera, self._preview)), is_preview=True)
        if self._clip is not None and request.frame < self._inferred.frames:
            if request.frame not in self._clouds:
                clouds = observed_clouds(self._renderer, self._inferred, request.frame, self._clip)
                self._clouds[request.frame] = clouds
            yield Clouds(self._clouds[request.frame])
        for name in request.scene.ids:
            yield Shape(name, self._shape(request.scene, request.frame, name))
        images, parts = [], bands(with_longer_side(camera, self._final))
        for band in parts:
            images.append(self._render(request, band))
            yield Progress(len(images) / len(parts))
        yield Picture(joined(images), is_preview=False)

    def _render(self, request: RenderRequest, camera: Camera) -> Image:
        # Antialiasing takes longer and would not reach across the borders of bands.
        return self._renderer.render(request.scene, request.frame, camera, antialiased=False)

    def _shape(self, scene: Scene, frame: int, name: int) -> bytes | None:
        appearance = scene.look(frame, scene.place(name))
        if appearance not in self._shapes:
            if len(self._shapes) >= _MOST_SHAPES:
                self._shapes.clear()
            self._shapes[appearance] = self._make_shape(scene, frame, name)
        return self._shapes[appearance]

    def _make_shape(self, scene: Scene, frame: int, name: int) -> bytes | None:
        # Late, because trimesh and marching cubes take a second to import, and the first picture does not need them.
        from obpose.scenes.meshes import object_mesh, to_glb

        unrotated = torch.eye(3).expand_as(scene.rotation)
        posed = replace(scene, center=torch.zeros_like(scene.center), rotation=unrotated)
        try:
            mesh = object_mesh(self._renderer.model, posed, name, frame=frame, resolution=_SHAPE_CELLS)
        except UsageError:
            return None
        return to_glb(mesh)


def with_longer_side(camera: Camera, pixels: int) -> Camera:
    """Resize the image of a camera to this longer side."""
    scale = pixels / max(camera.width, camera.height)
    return camera.resized(*(max(1, round(side * scale)) for side in (camera.width, camera.height)))


def bands(camera: Camera) -> list[Camera]:
    """Split the image of a camera into horizontal bands, from top to bottom."""
    rows = max(1, _BAND_PIXELS // camera.width)
    parts = []
    for top in range(0, camera.height, rows):
        k = camera.k.clone()
        k[1, 2] -= top
        parts.append(Camera(k, camera.world_from_camera, camera.width, min(rows, camera.height - top)))
    return parts


def joined(images: list[Image]) -> Image:
    """Join the images of bands."""
    return Image(
        rgb=torch.cat([image.rgb for image in images]),
        depth=torch.cat([image.depth for image in images]),
        shares=torch.cat([image.shares for image in images], dim=1),
    )
