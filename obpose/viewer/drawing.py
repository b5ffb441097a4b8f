"""The pieces of which the page shows a scene, in the order in which people want them: a small picture comes first."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import torch

from obpose.scenes.rendering import Image, Renderer
from obpose.scenes.scene import Camera, Scene
from obpose.types import Observation
from obpose.viewer.point_clouds import Cloud, observed_clouds
from obpose.viewer.shapes import Shapes

PREVIEW = 64
"""Pixels along the longer side of the picture that comes first."""
_AT_ONCE = 4096
"""Pixels that are rendered before it is asked whether the picture is still wanted."""


@dataclass(frozen=True, eq=False)
class Wish:
    """What the page wants to show."""

    scene: Scene
    """Without hidden objects."""
    frame: int
    view: int
    since: float
    """When it came to be, seconds of `time.monotonic`."""

    @property
    def camera(self) -> Camera:
        """Of the view."""
        return self.scene.cameras[self.view]


@dataclass(frozen=True, eq=False)
class Picture:
    """The scene from the wish's camera."""

    image: Image
    is_preview: bool
    """Whether one of the camera's own size follows."""


@dataclass(frozen=True, eq=False)
class Clouds:
    """What was observed in the wish's frame, by inferred object."""

    clouds: Mapping[int, Cloud]


@dataclass(frozen=True, eq=False)
class Shape:
    """The surface of one object in its frame as GLB, None where it is nowhere dense."""

    name: int
    mesh: bytes | None


@dataclass(frozen=True)
class Unfinished:
    """Part of a large picture is done."""


Piece = Picture | Clouds | Shape | Unfinished


class Drawer:
    """Makes the pieces of wishes; what does not change between them is kept."""

    def __init__(self, renderer: Renderer, inferred: Scene, clip: Observation | None):
        """`inferred` is the scene of the clip, before any edit."""
        self._renderer, self._inferred, self._clip = renderer, inferred, clip
        self._shapes = Shapes(renderer.model)
        self._clouds: dict[int, dict[int, Cloud]] = {}

    def draw(self, wish: Wish) -> Iterator[Piece]:
        """A small picture, the observed points, the shapes, and the picture in the camera's size where that is more."""
        small = preview_camera(wish.camera)
        yield Picture(self._render(wish, small), is_preview=small is not wish.camera)
        if self._clip is not None and wish.frame < self._inferred.frames:
            yield Clouds(self._clouds_of(wish.frame, self._clip))
        for name in wish.scene.ids:
            yield Shape(name, self._shapes.of(wish.scene, wish.frame, name))
        if small is not wish.camera:
            yield from self._whole(wish)

    def _whole(self, wish: Wish) -> Iterator[Piece]:
        """In bands, as a large picture takes seconds in which a newer wish may come."""
        images = []
        for band in bands(wish.camera):
            images.append(self._render(wish, band))
            yield Unfinished()
        yield Picture(joined(images), is_preview=False)

    def _render(self, wish: Wish, camera: Camera) -> Image:
        """Without antialiasing: it takes longer, and would leave the borders of bands out."""
        return self._renderer.render(wish.scene, wish.frame, camera, antialiased=False)

    def _clouds_of(self, frame: int, clip: Observation) -> dict[int, Cloud]:
        if frame not in self._clouds:
            self._clouds[frame] = observed_clouds(self._renderer, self._inferred, frame, clip)
        return self._clouds[frame]


def preview_camera(camera: Camera) -> Camera:
    """The same view in a picture of `PREVIEW` pixels; the camera itself where it has no more."""
    longer = max(camera.width, camera.height)
    if longer <= PREVIEW:
        return camera
    width, height = (max(1, round(side * PREVIEW / longer)) for side in (camera.width, camera.height))
    return camera.resized(width, height)


def bands(camera: Camera) -> list[Camera]:
    """Cameras of the picture's rows from top to bottom, as many rows each as are rendered at once."""
    rows = max(1, _AT_ONCE // camera.width)
    found = []
    for top in range(0, camera.height, rows):
        k = camera.k.clone()
        k[1, 2] -= top
        found.append(Camera(k, camera.world_from_camera, camera.width, min(rows, camera.height - top)))
    return found


def joined(images: list[Image]) -> Image:
    """Bands of a picture as one."""
    return Image(
        rgb=torch.cat([image.rgb for image in images]),
        depth=torch.cat([image.depth for image in images]),
        shares=torch.cat([image.shares for image in images], dim=1),
    )
