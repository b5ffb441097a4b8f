"""Pictures of scenes: colour, depth and soft segmentation from any camera, with the shadows of a known light."""

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
from obpose.scenes.appearance.table_texture import pattern_at
from obpose.scenes.scene import Camera, Scene

_OPAQUE = 5.0
"""Optical thickness of as much of an opaque thing as lies between the surface points of neighbouring pixels. The
fields were trained with such a spacing, and are no sharper."""
_STEPS = 2.5
"""Samples over that length."""
_ACROSS = 2
"""Rays along each side of a pixel at an outline."""
_OUTLINE = 0.1
"""Outlines are where the share of a component differs by more than this between neighbours."""
_KEPT = 256
"""Components that are remembered."""
_SHADING = 1.0
"""Optical thickness of as much of an opaque thing in the way of a light, which is sampled once: fields are fatter than
objects, and with `_OPAQUE` shadows were harder and larger than they should be."""
_LEAST_LIGHT = 1e-2
"""Share of a pixel's light that the background has at least where its shadows are looked for."""
_LEAST_COLOUR = 1e-3
"""Colours are at least so far from black and white where a pattern is added to their logits."""
_OBJECT_CELLS = 16
_FINE_CELLS = 32
"""Of objects whose detail is alone, and may be thinner than the others' cells."""
_BACKGROUND_CELLS, _BACKGROUND_LAYERS = 32, 8
"""Tables, and sheets of fog, may be much thinner than a cell."""


@dataclass(frozen=True, eq=False)
class Image:
    """What a camera sees of one frame."""

    rgb: Float[Tensor, "height width 3"]
    """0..1; black where nothing is."""
    depth: Float[Tensor, "height width"]
    """Mean planar depth at which light comes from, metres."""
    shares: Float[Tensor, "component height width"]
    """Soft segmentation: share of the light from the background (first) and each object, in the scene's order."""

    @property
    def nearest(self) -> Int[Tensor, "height width"]:
        """Place of the component that most light comes from; 0 is the background."""
        return self.shares.argmax(dim=0)


class Renderer:
    """Renders scenes of one model; what does not change between edits is kept."""

    def __init__(self, model: ObPose):
        """Only models with a background and posed objects have scenes (`obpose.scenes.model_ref.load_origin`)."""
        self.model = model.eval()
        self._known: dict[bytes, Component] = {}

    def render(self, scene: Scene, frame: int = 0, camera: Camera | None = None, *, antialiased: bool = True) -> Image:
        """One frame, from the first camera that the scene was seen with where no other is given.

        Depth and shares are those of a ray through the middle of each pixel, and so are colours, but for pixels at
        outlines: where not asked otherwise, these have the mean colour of `_ACROSS`^2 rays, as images of datasets are
        antialiased, too. It takes about half as long again.
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

    def _march(self, components: list[Component], direction: Float[Tensor, "ray 3"], camera: Camera) -> Picture:
        origin = camera.world_from_camera[:3, 3].expand_as(direction)
        return march(components, origin, direction, floor=self.model.config.model.table, **self.quadrature(camera))

    def _finished(
        self,
        picture: Picture,
        scene: Scene,
        components: list[Component],
        direction: Float[Tensor, "ray 3"],
        camera: Camera,
    ) -> Float[Tensor, "ray 3"]:
        """Colours with the table's pattern, and the background in shadow where objects are before the light."""
        share = picture.weights[0]
        shown = (share > _LEAST_LIGHT).nonzero()[:, 0]
        has_pattern, has_shadows = bool(scene.pattern.any()), strength(scene.light) > 0 and len(components) > 1
        if not len(shown) or not (has_pattern or has_shadows):
            return picture.colour
        share = share[shown, None]
        surface = camera.world_from_camera[:3, 3] + picture.depths[0, shown, None] / share * direction[shown]
        before = picture.colours[0, shown]
        after = before
        if has_pattern:
            pattern = pattern_at(self.model, scene.pattern, surface)
            after = share * torch.sigmoid(torch.logit(before / share, eps=_LEAST_COLOUR) + pattern)
        if has_shadows:
            occlusion = self.occlusion(components[1:], surface, scene.light[:3])
            after = after * (1 - strength(scene.light) * occlusion[:, None])
        return picture.colour.index_add(0, shown, after - before)

    def occlusion(
        self, objects: list[Component], surface: Float[Tensor, "point 3"], toward: Float[Tensor, "3"]
    ) -> Float[Tensor, "point"]:
        """Share of the light that does not arrive at points of the background, as objects are in the way.

        What is nearer to a point than pixels of training lie apart does not count: it is the noise of where the two
        meet.
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
        """Between which depths rays are sampled, how densely, and what counts as opaque, for a camera."""
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
        """The background, then the objects."""
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
        """The objects alone, which is quicker where nothing is remembered."""
        return [self._object(scene, frame, place) for place in range(len(scene.ids))]

    def _object(self, scene: Scene, frame: int, place: int) -> Component:
        model = self.model
        center, rotation = scene.center[frame, place], scene.rotation[frame, place]
        box = {"center": center, "rotation": rotation, "size": model.config.model.pose.box_size}
        box |= {"threshold": THRESHOLD}
        known = self._keep(
            scene.look(frame, place),
            lambda: make_component(
                model.object_field,
                object_codes(model, scene, frame, place),
                **box,
                bounded=True,
                resolution=_FINE_CELLS if scene.alone[place] > 0 else _OBJECT_CELLS,
            ),
        )
        return moved(known, center, rotation)

    def _keep(self, name: bytes, make: Callable[[], Component]) -> Component:
        """Components by what they look like, as edits leave most of them as they were."""
        if name not in self._known:
            if len(self._known) >= _KEPT:
                self._known.clear()
            self._known[name] = make()
        return self._known[name]


def object_codes(model: ObPose, scene: Scene, frame: int, place: int) -> Conditioning:
    """What makes an object of a scene out of the objects' field."""
    return conditioning(model, scene.what[frame, place], scene.detail[place], scene.alone[place])


def conditioning(
    model: ObPose, what: Float[Tensor, "what"], detail: Float[Tensor, "edge edge edge 4"], alone: Float[Tensor, ""]
) -> Conditioning:
    """What an object's latent and its detail add to the objects' field, or the detail alone (`Scene.alone`)."""
    is_alone = bool(alone > 0)
    if not is_alone and not detail.any():
        return model.object_field.condition(what)
    owner = torch.zeros((), dtype=torch.long)
    return model.object_field.condition(what).corrected(Detail(detail[None], owner, alone[None] if is_alone else None))


def outlines(shares: Float[Tensor, "component height width"]) -> Bool[Tensor, "height width"]:
    """Pixels around which, in themselves and their eight neighbours, the share of a component is not all the same."""
    visible = F.pad(shares, (1, 1, 1, 1), mode="replicate")
    most, least = (F.max_pool2d(sign * visible, 3, stride=1) for sign in (1, -1))
    return ((most + least) > _OUTLINE).any(dim=0)


def _directions(camera: Camera) -> Float[Tensor, "height width 3"]:
    return camera_rays(camera.k, camera.world_from_camera, camera.height, camera.width)[0]


def _reach(camera: Camera, model: ObPose) -> tuple[float, float]:
    """Planar depths between which the workspace and what stands around it lie, metres."""
    pose, reach = camera.world_from_camera, model.config.model.workspace_size
    middle = float((model.center - pose[:3, 3]) @ pose[:3, 2])
    return max(reach / 100, middle - reach), max(reach, middle + reach)
