"""ObSuRF: one image of a scene to slots, slots to neural fields, supervised along rays of all views.

As in both published uses, the frames of a clip are independent: each has its own slots. In training, one random view of
each clip is the input, the same in all its frames. At evaluation, each view is segmented from its own image.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from einops import rearrange, repeat
from jaxtyping import Float, Int
from torch import Tensor

from obpose.baselines.obsurf import losses
from obpose.baselines.obsurf.config import ObsurfConfig
from obpose.baselines.obsurf.decoder import SlotField
from obpose.baselines.obsurf.encoder import ImageEncoder, code_size, fourier_code, nearest_cells, project
from obpose.baselines.obsurf.slots import SlotAttention, Slots
from obpose.data.clips import random_view, separate_views
from obpose.geometry import all_rays, sample_rays, sample_rays_where, unproject, view_directions
from obpose.model.attention.interface import not_largest
from obpose.model.nerf.along import NEAR_SHARE, air_points, surface_points
from obpose.trainable import Trainable
from obpose.types import Observation, RayPoints, Rays, Segmentation

JITTER = 0.07
"""Distance behind the surface up to which fields are fitted, units of planar depth. [code: along the ray]"""
_STRIDE, _OFFSET = 4, 2
"""Stride and offset of the pixels at which objects are expected, before rays are drawn."""


@dataclass(frozen=True, eq=False)
class Encoded:
    """Codes of scenes from one image each."""

    slots: Slots
    features: Float[Tensor, "image rows columns width"]
    k: Float[Tensor, "image 3 3"]
    world_from_camera: Float[Tensor, "image 4 4"]
    size: tuple[int, int]
    """Height and width of the images."""


class Obsurf(Trainable):
    """ObSuRF with depth, as published except for its projection and the norms of its encoder."""

    center: Tensor

    def __init__(self, config: ObsurfConfig):
        """Initialise the weights from PyTorch's global generator."""
        super().__init__()
        self.config = config
        model, width = config.model, config.model.encoder.width
        code = code_size(last=model.last_octave)
        self.encoder = ImageEncoder(model.encoder, camera_code=code)
        self.attention = SlotAttention(slots=model.segments, width=width)
        self.field = SlotField(model.decoder, code=code, slot=width, pixel=width)
        self.register_buffer("center", torch.tensor(model.workspace_center), persistent=False)

    def losses(
        self, observation: Observation, *, step: int, fraction: float, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Compute the loss terms and their weighted sum; pixels without depth do not count."""
        # Encode one view of each clip.
        inputs = random_view(observation, generator)
        batch, frames = observation.depth.shape[:2]
        noise = torch.randn(
            (batch * frames, *self.attention.evaluation_noise.shape), generator=generator, device=self.center.device
        )
        encoded = self.encode(inputs, noise)
        rays = self._sample_rays(observation, encoded, generator)
        return self._loss_terms(encoded, rays, fraction, generator)

    @property
    def background_slot(self) -> None:
        """None, because no slot stands for the background."""
        return None

    @torch.no_grad()
    def segment(self, observation: Observation) -> Segmentation:
        """Label every pixel with the densest slot at its surface, image by image.

        The slot of the background differs between images, so the slot with most pixels of an image becomes 0.
        """
        batch, frames, views = observation.depth.shape[:3]
        separate = separate_views(observation)
        encoded = self.encode(
            separate, repeat(self.attention.evaluation_noise, "k w -> i k w", i=batch * frames * views)
        )
        rays = all_rays(separate)
        logits, _ = self._densities(encoded, rays.origin + rays.direction * rays.depth[..., None])
        owners = rearrange(logits.argmax(dim=2), "b f (h w) -> (b f) h w", h=observation.depth.shape[3])
        # Slot with most pixels of each image; its number is swapped with 0.
        valid = rearrange(separate.valid, "b f 1 h w -> (b f) h w")
        pixels = F.one_hot(owners.flatten(1), self.config.model.segments) * valid.flatten(1)[..., None]
        largest = pixels.sum(dim=1).argmax(dim=-1)[:, None, None].expand_as(owners)
        labels, attention = (
            torch.where(maps == largest, 0, torch.where(maps == 0, largest, maps)) * valid
            for maps in (owners, _upsampled(encoded))
        )
        whole = {"pattern": "(b v f) h w -> b f v h w", "b": batch, "v": views}
        return Segmentation(rearrange(labels, **whole), rearrange(attention, **whole))

    def encode(self, observation: Observation, noise: Float[Tensor, "image slot width"]) -> Encoded:
        """Encode the images of one view, clip by clip and frame by frame."""
        frames, _, height, width = observation.depth.shape[1:]
        cameras = observation.k, observation.world_from_camera
        k, poses = (repeat(camera, "b 1 i j -> (b f) i j", f=frames) for camera in cameras)
        # Inputs of each pixel: direction of its ray, and surface point with its validity.
        rays = F.normalize(view_directions(observation)[:, 0], dim=-1)
        seen = self.to_units(unproject(observation)) * observation.valid[..., None]
        points = torch.cat([seen, observation.valid[..., None].to(seen.dtype)], dim=-1)
        model = self.config.model
        features = self.encoder(
            rearrange(observation.rgb, "b f 1 h w c -> (b f) h w c"),
            repeat(rays, "b h w c -> (b f) h w c", f=frames),
            rearrange(points, "b f 1 h w c -> (b f) h w c"),
            fourier_code(self.to_units(poses[:, :3, 3]), last=model.last_octave),
        )
        tokens = rearrange(features, "i rows columns w -> i (rows columns) w")
        return Encoded(self.attention(tokens, noise), features, k, poses, (height, width))

    def to_units(self, points: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3"]:
        """Convert world coordinates in metres to units around the middle of the workspace."""
        return (points - self.center) * self.config.model.units_per_metre

    @torch.no_grad()
    def _sample_rays(self, observation: Observation, encoded: Encoded, generator: torch.Generator | None) -> Rays:
        """Draw rays, a share of them outside of the largest slot of a frame, as found at some pixels of all views."""
        count, share = self.config.train.rays, self.config.train.object_rays
        if not share:
            return sample_rays(observation, count, generator)
        # Shares of the slots at some surface points.
        points, valid = (
            pixels[:, :, :, _OFFSET::_STRIDE, _OFFSET::_STRIDE]
            for pixels in (unproject(observation), observation.valid)
        )
        logits, _ = self._densities(encoded, rearrange(points, "b f v h w xyz -> b f (v h w) xyz"))
        log_shares = rearrange(losses.log_share(logits), "b f slot point -> (b f) 1 slot point")
        seen = rearrange(valid, "b f v h w -> (b f) 1 1 (v h w)")
        elsewhere = not_largest(log_shares.masked_fill(~seen, -torch.inf))
        sizes = dict(zip("vhw", valid.shape[2:], strict=True))
        # Back to the size of the images.
        interest = rearrange(elsewhere, "i 1 (v h w) -> i v h w", **sizes)
        interest = F.interpolate(interest, size=observation.depth.shape[3:], mode="nearest")
        interest = rearrange(interest, "(b f) v h w -> b f v h w", b=len(valid))
        return sample_rays_where(observation, count, interest, share=share, generator=generator)

    def _loss_terms(
        self, encoded: Encoded, rays: Rays, fraction: float, generator: torch.Generator | None
    ) -> dict[str, Tensor]:
        # Fields at the surface and in the air.
        scale = self.config.model.units_per_metre
        units = scale * rays.direction.norm(dim=-1)
        behind = surface_points(rays, JITTER / scale, generator)
        before, inverse_rho = air_points(rays, NEAR_SHARE, generator)
        surface, hidden = self._densities(encoded, behind)
        in_air, _ = self._densities(encoded, before)
        composed = losses.mean_colour(surface, self._colours(encoded, hidden, behind, rays))
        terms = {
            "colour": losses.colour(composed, rays.colour, rays.weight, std=self.config.loss.colour_std),
            "surface": losses.surface(surface, rays.weight),
            "air": losses.air(in_air, inverse_rho * units, rays.weight),
        }
        # Weighted sum.
        weights = dict.fromkeys(terms, 1.0)
        if self.config.loss.overlap:
            terms["overlap"] = losses.overlap(surface, rays.weight)
            weights["overlap"] = losses.overlap_weight(self.config.loss, fraction)
        total = sum((weights[name] * term for name, term in terms.items()), start=surface.new_zeros(()))
        return {"total": total, **{name: term.detach() for name, term in terms.items()}}

    def _densities(
        self, encoded: Encoded, points: RayPoints
    ) -> tuple[Float[Tensor, "batch frame slot ray"], Float[Tensor, "image slot ray hidden"]]:
        """Compute density logits of all slots at world points, and hidden values for colours."""
        model = self.config.model
        flat = rearrange(self.to_units(points), "b f ray xyz -> (b f) ray xyz")
        code = fourier_code(flat, last=model.last_octave)
        logits, hidden = self.field.density(code, encoded.slots.codes)
        return rearrange(logits, "(b f) slot ray -> b f slot ray", b=len(points)), hidden

    def _colours(
        self, encoded: Encoded, hidden: Tensor, points: RayPoints, rays: Rays
    ) -> Float[Tensor, "batch frame slot ray 3"]:
        """Compute colours of all slots, with the input image's features at the points' pixels; 0 behind the camera."""
        flat = rearrange(points, "b f ray xyz -> (b f) ray xyz")
        pixels, before = project(flat, encoded.k, encoded.world_from_camera)
        grid = (encoded.features.shape[1], encoded.features.shape[2])
        cells = nearest_cells(pixels, size=encoded.size, grid=grid)
        features = rearrange(encoded.features, "i rows columns w -> i (rows columns) w")
        seen = features.gather(1, repeat(cells, "i ray -> i ray w", w=features.shape[-1])) * before[..., None]
        directions = F.normalize(rearrange(rays.direction, "b f ray xyz -> (b f) ray xyz"), dim=-1)
        colours = self.field.colour(hidden, directions, seen)
        return rearrange(colours, "(b f) slot ray c -> b f slot ray c", b=len(points))


def _upsampled(encoded: Encoded) -> Int[Tensor, "image height width"]:
    """Slot with the largest attention at each pixel."""
    rows, columns = encoded.features.shape[1:3]
    maps = rearrange(
        encoded.slots.attention, "i slot (rows columns) -> i slot rows columns", rows=rows, columns=columns
    )
    return F.interpolate(maps, size=encoded.size, mode="bilinear", align_corners=False).argmax(dim=1)
