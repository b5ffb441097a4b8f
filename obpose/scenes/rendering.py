"""Rendering of scenes: colour, depth and soft segmentation from any camera, with shadows of a known light."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.geometry import camera_rays
from obpose.model.nerf.along import JITTER
from obpose.model.nerf.detail import Detail
from obpose.model.nerf.field import Conditioning
from obpose.model.nerf.marching import Component, Picture, make_component, march, moved, thickness_towards
from obpose.model.nerf.voxels import THRESHOLD
from obpose.model.obpose import ObPose
from obpose.scenes.appearance.light import beams, strength
from obpose.scenes.appearance.table_texture import texture_at
from obpose.scenes.scene import Camera, Scene

RayVectors = Float[Tensor, "ray 3"]

_OPAQUE = 5.0
"""Optical thickness of an opaque object over the spacing of neighbouring training pixels. Fields are no sharper."""
_STEPS = 2.5
"""Samples over that spacing."""
_ACROSS = 2
"""Rays along each side of an antialiased pixel."""
_OUTLINE = 0.1
"""Difference of a component's share between neighbouring pixels that makes an outline."""
_KEPT = 256
"""Size of the cache of components."""
_SHADING = 1.0
"""Optical thickness of an opaque object over that spacing, towards a light. Fields are larger than their objects, and
`_OPAQUE` would make shadows too hard and too large."""
_LEAST_LIGHT = 1e-2
"""Least share of the background in a pixel for which shadows are computed."""
_LEAST_COLOUR = 1e-3
"""Least distance of colours from black and white when a texture is added to their logits."""
_OBJECT_CELLS = 16
_FINE_CELLS = 32
"""Cells along each edge of objects, and of residual grids that replace a field, which may be thinner."""
_BACKGROUND_CELLS, _BACKGROUND_LAYERS = 32, 8
"""Cells along each edge of the background, and layers in each, because tables may be thinner than a cell."""


@dataclass(frozen=True, eq=False)
class Image:
    """A rendered frame."""

    rgb: Float[Tensor, "height width 3"]
    """Colours in 0..1; empty space is black."""
    depth: Float[Tensor, "height width"]
    """Mean planar depth of the light, metres."""
    shares: Float[Tensor, "component height width"]
    """Soft segmentation: share of the light from the background (first) and each object, in the scene's order."""

    @property
    def nearest(self) -> Int[Tensor, "height width"]:
        """Index of the component with the largest share; 0 is the background."""
        return self.shares.argmax(dim=0)


class Renderer:
    """Renderer of the scenes of one model, with a cache of components."""

    def __init__(self, model: ObPose):
        """Wrap a model with a background and posed objects (`obpose.scenes.model_ref.load_origin`)."""
        self.model = model.eval()
        self._known: dict[bytes, Component] = {}

    def render(self, scene: Scene, frame: int = 0, camera: Camera | None = None, *, antialiased: bool = True) -> Image:
        """Render a frame, by default from the scene's first camera.

        One ray through the centre of each pixel gives depth, shares and colour. With antialiasing, pixels at outlines
        get the mean colour of `_ACROSS`^2 rays, like images of datasets; this takes about half as long again.
        """
        camera = scene.cameras[0] if camera is None else camera
        components, direction = self.components(scene, frame), _directions(camera).flatten(0, 1)
        picture = self._march(components, direction, camera)
        size = (camera.height, camera.width)
        rgb, shares = self._finished(picture, scene, components, direction, camera), picture.weights.unflatten(1, size)
        if antialiased:
            at = outlines(shares).flatten().nonzero()[:, 0]
            finer = _directions(camera.resized(camera.width * _ACROSS, camera.height * _ACROSS))
            several = rearrange(finer, "(h y) (w x) c -> (h w) (y x) c", y=_ACROSS, x=_ACROSS)[at]
            finer_picture = self._march(components, several.flatten(0, 1), camera)
            seen = self._finished(finer_picture, scene, components, several.flatten(0, 1), camera)
            rgb = rgb.index_copy(0, at, seen.unflatten(0, several.shape[:2]).mean(dim=1))
        return Image(rgb=rgb.clamp(0, 1).unflatten(0, size), depth=picture.depth.unflatten(0, size), shares=shares)

    def _march(self, components: list[Component], direction: RayVectors, camera: Camera) -> Picture:
        origin = camera.world_from_camera[:3, 3].expand_as(direction)
        return march(components, origin, direction, floor=self.model.config.model.table, **self.quadrature(camera))

    def _finished(
        self, picture: Picture, scene: Scene, components: list[Component], direction: RayVectors, camera: Camera
    ) -> RayVectors:
        """Add the table's texture and the shadows of objects on the background to colours."""
        share = picture.weights[0]
        shown = (share > _LEAST_LIGHT).nonzero()[:, 0]
        has_texture = bool(scene.appearance.texture.any())
        has_shadows = strength(scene.appearance.light) > 0 and len(components) > 1
        if not len(shown) or not (has_texture or has_shadows):
            return picture.colour
        share = share[shown, None]
        # Surface points of the background, and its share of their colours.
        surface = camera.world_from_camera[:3, 3] + picture.depths[0, shown, None] / share * direction[shown]
        before = picture.colours[0, shown]
        after = before
        if has_texture:
            # Textures are added to the logits of the colours.
            texture = texture_at(self.model, scene.appearance.texture, surface)
            after = share * torch.sigmoid(torch.logit(before / share, eps=_LEAST_COLOUR) + texture)
        if has_shadows:
            occlusion = self.occlusion(components[1:], surface, scene.appearance.light[:3])
            after = after * (1 - strength(scene.appearance.light) * occlusion[:, None])
        return picture.colour.index_add(0, shown, after - before)

    def occlusion(
        self, objects: list[Component], surface: Float[Tensor, "point 3"], toward: Float[Tensor, "3"]
    ) -> Float[Tensor, "point"]:
        """Compute the share of the light that objects keep from points of the background.

        Density nearer to a point than the spacing of training pixels is ignored, because it is noise of the contact.
        """
        config = self.model.config.model
        ways = [
            thickness_towards(
                objects,
                surface + config.spacing * beam,
                beam,
                step=config.spacing,
                sigma_max=_SHADING / config.spacing,
                floor=config.table,
                threshold=THRESHOLD,
            )
            for beam in beams(toward)
        ]
        return -torch.expm1(-torch.stack(ways)).mean(dim=0)

    def quadrature(self, camera: Camera) -> dict[str, Any]:
        """Give the depth range, the sampling density and the opacity for the rays of a camera."""
        spacing = self.model.config.model.spacing
        near, far = _reach(camera, self.model)
        return {
            "near": near,
            "far": far,
            "samples": max(1, round((far - near) / spacing * _STEPS)),
            "sigma_max": _OPAQUE / spacing,
            "threshold": THRESHOLD,
            "behind": JITTER,
        }

    def components(self, scene: Scene, frame: int) -> list[Component]:
        """Give the components of a frame: the background, then the objects."""
        model, settings = self.model, self.model.config.model
        field = model.background_field
        assert field is not None
        code = scene.background[frame]
        background = self._keep(
            code.numpy().tobytes(),
            lambda: make_component(
                field,
                field.condition(code),
                center=model.center,
                rotation=torch.eye(3),
                size=settings.background_size,
                threshold=THRESHOLD,
                bounded=False,
                resolution=_BACKGROUND_CELLS,
                layers=_BACKGROUND_LAYERS,
            ),
        )
        return [background, *self.objects(scene, frame)]

    def objects(self, scene: Scene, frame: int) -> list[Component]:
        """Give the objects of a frame without the background, which is faster without a cache."""
        return [self._object(scene, frame, place) for place in range(len(scene.ids))]

    def _object(self, scene: Scene, frame: int, place: int) -> Component:
        model = self.model
        center, rotation = scene.center[frame, place], scene.rotation[frame, place]
        known = self._keep(
            scene.look(frame, place),
            lambda: make_component(
                model.object_field,
                object_codes(model, scene, frame, place),
                center=center,
                rotation=rotation,
                size=model.config.model.pose.box_size,
                threshold=THRESHOLD,
                bounded=True,
                resolution=_FINE_CELLS if scene.appearance.own_scale[place] > 0 else _OBJECT_CELLS,
            ),
        )
        return moved(known, center, rotation)

    def _keep(self, name: bytes, make: Callable[[], Component]) -> Component:
        """Cache components by their look, because edits leave most of them unchanged."""
        if name not in self._known:
            if len(self._known) >= _KEPT:
                self._known.clear()
            self._known[name] = make()
        return self._known[name]


def object_codes(model: ObPose, scene: Scene, frame: int, place: int) -> Conditioning:
    """Give the conditioning of the object field for an object of a scene."""
    return conditioning(
        model, scene.what[frame, place], scene.appearance.detail[place], scene.appearance.own_scale[place]
    )


def conditioning(
    model: ObPose,
    what: Float[Tensor, "what"],
    detail: Float[Tensor, "edge edge edge 4"],
    own_scale: Float[Tensor, ""],
) -> Conditioning:
    """Give the conditioning of the object field for a code and a detail, which may replace it (`Appearance`)."""
    replaces = bool(own_scale > 0)
    if not replaces and not detail.any():
        return model.object_field.condition(what)
    owner = torch.zeros((), dtype=torch.long)
    return model.object_field.condition(what).corrected(
        Detail(detail[None], owner, own_scale[None] if replaces else None)
    )


def outlines(shares: Float[Tensor, "component height width"]) -> Bool[Tensor, "height width"]:
    """Find pixels whose 3x3 neighbourhood differs in the share of a component."""
    visible = F.pad(shares, (1, 1, 1, 1), mode="replicate")
    most, least = (F.max_pool2d(sign * visible, 3, stride=1) for sign in (1, -1))
    return ((most + least) > _OUTLINE).any(dim=0)


def _directions(camera: Camera) -> Float[Tensor, "height width 3"]:
    return camera_rays(camera.k, camera.world_from_camera, camera.height, camera.width)[0]


def _reach(camera: Camera, model: ObPose) -> tuple[float, float]:
    """Give the range of planar depths of the workspace and its surroundings, metres."""
    pose, reach = camera.world_from_camera, model.config.model.workspace_size
    middle = float((model.center - pose[:3, 3]) @ pose[:3, 2])
    return max(reach / 100, middle - reach), max(reach, middle + reach)
