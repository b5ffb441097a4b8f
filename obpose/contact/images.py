"""Inputs of the network: colours, positions and normals of an image, in a frame that turns with the camera."""

from dataclasses import dataclass, fields, replace

import torch
from einops import rearrange, repeat
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.geometry import full_precision, unproject
from obpose.types import LabelledObservation, Observation, PastedObservation

CHANNELS = 11
"""Number of channels of `Images.inputs`."""
CLOSE = 0.004
"""Height in metres at which the saturating input is about 0.8: it resolves the edge between object and table."""


@dataclass(frozen=True, eq=False)
class Images:
    """Images of an observation, frame by frame and view by view.

    Positions are relative to the middle of the workspace and to the table. The first axis points to the right of the
    camera, the second away from it, and the third upwards, so that all cameras around a table give similar inputs.
    """

    rgb: Float[Tensor, "image 3 height width"]
    """sRGB in 0..1."""
    points: Float[Tensor, "image 3 height width"]
    """Surface points in metres; 0 where not valid."""
    normals: Float[Tensor, "image 3 height width"]
    """Unit normals from central differences; 0 where not valid."""
    valid: Bool[Tensor, "image height width"]
    labels: Int[Tensor, "image height width"]
    """Objects or pseudo-objects, 0 = background; all 0 if the observation has neither."""

    def inputs(self) -> Float[Tensor, "image 11 height width"]:
        """Input channels of the network, scaled to about -1..1."""
        height = self.points[:, 2:]
        channels = [
            (self.rgb - 0.5) * 3,
            self.points[:, :2] * 4,
            height * 20,
            torch.tanh(height / CLOSE),
            self.normals,
            self.valid[:, None].to(self.rgb.dtype),
        ]
        return torch.cat(channels, dim=1)

    def window(self, rows: Int[Tensor, "image row"], columns: Int[Tensor, "image column"]) -> "Images":
        """Cut a window out of each image."""
        index = torch.arange(len(rows), device=rows.device)[:, None, None], rows[:, :, None], columns[:, None]
        cut = {}
        for field in fields(self):
            value = getattr(self, field.name)
            cut[field.name] = value[index] if value.ndim == 3 else value.movedim(1, -1)[index].movedim(-1, 1)
        return replace(self, **cut)


@full_precision
def images_of(observation: Observation, *, center: Float[Tensor, "3"], table: float) -> Images:
    """Arrange the images of an observation: batch, then frame, then view."""
    frames = observation.depth.shape[1]
    cameras = repeat(observation.world_from_camera, "b v i j -> (b f v) i j", f=frames)
    valid = rearrange(observation.valid, "b f v h w -> (b f v) h w")
    origin = torch.stack([center[0], center[1], center.new_tensor(table)])
    points = rearrange(unproject(observation) - origin, "b f v h w c -> (b f v) h w c")
    points = torch.einsum("nij,nhwj->nihw", _turn(cameras), points) * valid[:, None]
    labels = torch.zeros_like(valid, dtype=torch.int64)
    if isinstance(observation, PastedObservation | LabelledObservation):
        pasted = isinstance(observation, PastedObservation)
        labels = observation.pseudo_labels if pasted else observation.segmentation
        labels = rearrange(labels, "b f v h w -> (b f v) h w") * valid
    rgb = rearrange(observation.rgb, "b f v h w c -> (b f v) c h w")
    return Images(rgb, points, _normals(points) * valid[:, None], valid, labels)


def _turn(cameras: Float[Tensor, "image 4 4"]) -> Float[Tensor, "image 3 3"]:
    """Rotations about the vertical from the world to axes that point right of each camera, away from it, and up."""
    right = cameras[:, :2, 0]
    right = right / right.norm(dim=1, keepdim=True).clamp(min=1e-6)
    x, y, zero, one = right[:, 0], right[:, 1], torch.zeros_like(right[:, 0]), torch.ones_like(right[:, 0])
    return torch.stack(
        [torch.stack([x, y, zero], -1), torch.stack([-y, x, zero], -1), torch.stack([zero, zero, one], -1)], dim=1
    )


def _normals(points: Float[Tensor, "image 3 height width"]) -> Float[Tensor, "image 3 height width"]:
    """Unit normals from central differences; 0 at the border of the image."""
    right, down = torch.zeros_like(points), torch.zeros_like(points)
    right[..., 1:-1] = points[..., 2:] - points[..., :-2]
    down[..., 1:-1, :] = points[..., 2:, :] - points[..., :-2, :]
    normal = torch.linalg.cross(down, right, dim=1)
    return normal / normal.norm(dim=1, keepdim=True).clamp(min=1e-9)


def augmented(images: Images, generator: torch.Generator | None) -> Images:
    """Mirror half of the images, permute the colours of half, and change brightness and balance."""
    count, device = len(images.rgb), images.rgb.device

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, device=device)

    mirrored = uniform(count) < 0.5

    def mirror(value: Tensor) -> Tensor:
        return torch.where(mirrored.view(-1, *[1] * (value.ndim - 1)), value.flip(-1), value)

    flipped = replace(images, **{field.name: mirror(getattr(images, field.name)) for field in fields(images)})
    sign = torch.ones(count, 3, 1, 1, device=device)
    sign[:, 0, 0, 0] = torch.where(mirrored, -1.0, 1.0)
    # Colours.
    order = torch.where(uniform(count, 1) < 0.6, uniform(count, 3).argsort(dim=1), torch.arange(3, device=device))
    rgb = flipped.rgb.gather(1, order[:, :, None, None].expand_as(flipped.rgb))
    gain, offset = 1 + 0.4 * (uniform(count, 3, 1, 1) - 0.5), 0.1 * (uniform(count, 1, 1, 1) - 0.5)
    return replace(flipped, rgb=rgb * gain + offset, points=flipped.points * sign, normals=flipped.normals * sign)


def cropped(images: Images, size: int, generator: torch.Generator | None) -> Images:
    """Cut a random window of at most `size` pixels square out of each image; it holds the objects if they fit."""
    height, width = images.labels.shape[1:]
    if size >= max(height, width):
        return images
    places = []
    for axis, length in ((2, height), (1, width)):
        # First and last row or column with an object.
        occupied = (images.labels > 0).any(dim=axis)
        edge = min(size, length)
        index = torch.arange(length, device=occupied.device)
        first = torch.where(occupied, index, length).amin(dim=1)
        last = torch.where(occupied, index, -1).amax(dim=1)
        empty = last < 0
        # Range of the starts of windows that hold both.
        low = torch.where(empty, 0, (last + 1 - edge).clamp(0, length - edge))
        high = torch.where(empty, length - edge, first.clamp(0, length - edge))
        low, high = torch.minimum(low, high), torch.maximum(low, high)
        draw = torch.rand(len(low), generator=generator, device=low.device)
        start = low + (draw * (high - low + 1)).long()
        places.append(torch.minimum(start, high)[:, None] + torch.arange(edge, device=low.device))
    return images.window(*places)
