"""ObSuRF: one image of a scene to slots, slots to neural fields, supervised along rays of all views.

Clips are images that have nothing to do with each other, as in both published uses: each frame has slots of its own,
and in training one of its views, drawn at random, is the input. At evaluation each view is segmented from its own
image.
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
from obpose.baselines.obsurf.encoder import ImageEncoder
from obpose.baselines.obsurf.projection import code_size, fourier_code, nearest_cells, project
from obpose.baselines.obsurf.slots import SlotAttention, Slots
from obpose.data.clips import one_view, views_apart
from obpose.geometry import all_rays, sample_rays, sample_rays_where, unproject, view_directions
from obpose.model.attention.summary import not_largest
from obpose.model.nerf.points import air_points, surface_points
from obpose.trainable import Trainable
from obpose.types import Observation, Rays, Segmentation

_STRIDE, _OFFSET = 4, 2
"""Of the pixels at which it is looked for objects, before rays are drawn."""


@dataclass(frozen=True, eq=False)
class Encoded:
    """What is known of scenes from one image each."""

    slots: Slots
    features: Float[Tensor, "image rows columns width"]
    k: Float[Tensor, "image 3 3"]
    world_from_camera: Float[Tensor, "image 4 4"]
    size: tuple[int, int]
    """Height and width of the images."""


class Obsurf(Trainable):
    """The model with depth, as published but for its projection and the norms of its encoder."""

    center: Tensor

    def __init__(self, config: ObsurfConfig):
        """Build it with fresh weights, drawn from PyTorch's global generator."""
        super().__init__()
        self.config = config
        model, width = config.model, config.model.encoder.width
        code = code_size(first=model.first_octave, last=model.last_octave)
        self.encoder = ImageEncoder(model.encoder, camera_code=code)
        self.attention = SlotAttention(model.attention, slots=model.slots + 1, width=width)
        self.field = SlotField(model.decoder, code=code, slot=width, pixel=width)
        self.register_buffer("center", torch.tensor(model.workspace_center), persistent=False)

    def losses(
        self, observation: Observation, *, step: int, fraction: float, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Loss terms and their weighted sum; pixels without depth do not count."""
        inputs = one_view(observation, generator)
        batch, frames = observation.depth.shape[:2]
        noise = torch.randn(
            (batch * frames, *self.attention.evaluation_noise.shape), generator=generator, device=self.center.device
        )
        encoded = self.encode(inputs, noise)
        rays = self._sample_rays(observation, encoded, generator)
        return self._loss_terms(encoded, rays, fraction, generator)

    @property
    def background_slot(self) -> None:
        """No slot is told to be the background."""
        return None

    @torch.no_grad()
    def segment(self, observation: Observation) -> Segmentation:
        """The densest slot at each pixel's observed surface, each image by itself.

        Which slot covers the background may differ from image to image: 0 is the one with most pixels of its image.
        """
        batch, frames, views = observation.depth.shape[:3]
        apart = views_apart(observation)
        encoded = self.encode(apart, repeat(self.attention.evaluation_noise, "k w -> i k w", i=batch * frames * views))
        rays = all_rays(apart)
        logits, _ = self._densities(encoded, rays.origin + rays.direction * rays.depth[..., None])
        owners = rearrange(logits.argmax(dim=2), "b f (h w) -> (b f) h w", h=observation.depth.shape[3])
        valid = rearrange(apart.valid, "b f 1 h w -> (b f) h w")
        largest = _largest(owners, valid, slots=self.config.model.slots + 1)
        labels, attention = (
            rearrange(_swapped(maps, largest) * valid, "(b v f) h w -> b f v h w", b=batch, v=views)
            for maps in (owners, _upsampled(encoded))
        )
        return Segmentation(labels, attention)

    def encode(self, observation: Observation, noise: Float[Tensor, "image slot width"]) -> Encoded:
        """Slots and features of images, clip by clip and frame by frame, of a single view."""
        frames, _, height, width = observation.depth.shape[1:]
        cameras = observation.k, observation.world_from_camera
        k, poses = (repeat(camera, "b 1 i j -> (b f) i j", f=frames) for camera in cameras)
        rays = F.normalize(view_directions(observation)[:, 0], dim=-1)
        seen = self.to_units(unproject(observation)) * observation.valid[..., None]
        points = torch.cat([seen, observation.valid[..., None].to(seen.dtype)], dim=-1)
        model = self.config.model
        features = self.encoder(
            rearrange(observation.rgb, "b f 1 h w c -> (b f) h w c"),
            repeat(rays, "b h w c -> (b f) h w c", f=frames),
            rearrange(points, "b f 1 h w c -> (b f) h w c"),
            fourier_code(self.to_units(poses[:, :3, 3]), first=model.first_octave, last=model.last_octave),
        )
        tokens = rearrange(features, "i rows columns w -> i (rows columns) w")
        return Encoded(self.attention(tokens, noise), features, k, poses, (height, width))

    def to_units(self, points: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3"]:
        """World coordinates in metres as units around the middle of the workspace."""
        return (points - self.center) * self.config.model.units_per_metre

    @torch.no_grad()
    def _sample_rays(self, observation: Observation, encoded: Encoded, generator: torch.Generator | None) -> Rays:
        """A share of them where the densest slot of a frame is not, looked for at some pixels of all views."""
        count, share = self.config.train.rays, self.config.train.object_rays
        if not share:
            return sample_rays(observation, count, generator)
        looks, valid = (
            pixels[:, :, :, _OFFSET::_STRIDE, _OFFSET::_STRIDE]
            for pixels in (unproject(observation), observation.valid)
        )
        logits, _ = self._densities(encoded, rearrange(looks, "b f v h w xyz -> b f (v h w) xyz"))
        log_shares = rearrange(losses.log_share(logits), "b f slot point -> (b f) 1 slot point")
        seen = rearrange(valid, "b f v h w -> (b f) 1 1 (v h w)")
        elsewhere = not_largest(log_shares.masked_fill(~seen, -torch.inf))
        sizes = dict(zip("vhw", valid.shape[2:], strict=True))
        interest = rearrange(elsewhere, "i 1 (v h w) -> i v h w", **sizes)
        interest = F.interpolate(interest, size=observation.depth.shape[3:], mode="nearest")
        interest = rearrange(interest, "(b f) v h w -> b f v h w", b=len(valid))
        return sample_rays_where(observation, count, interest, share=share, generator=generator)

    def _loss_terms(
        self, encoded: Encoded, rays: Rays, fraction: float, generator: torch.Generator | None
    ) -> dict[str, Tensor]:
        config, model = self.config.loss, self.config.model
        sigma_max = model.sigma_max
        units = model.units_per_metre * rays.direction.norm(dim=-1)
        behind = surface_points(rays, config.jitter / model.units_per_metre, generator)
        before, inverse_rho = air_points(rays, config.near_share, generator)
        surface, hidden = self._densities(encoded, behind)
        in_air, _ = self._densities(encoded, before)
        composed = losses.mean_colour(surface, self._colours(encoded, hidden, behind, rays))
        terms = {
            "colour": losses.colour(composed, rays.colour, rays.weight, std=config.colour_std),
            "surface": losses.surface(surface, rays.weight, sigma_max=sigma_max),
            "air": losses.air(in_air, inverse_rho * units, rays.weight, sigma_max=sigma_max),
        }
        weights = {"colour": config.colour, "surface": config.surface, "air": config.air}
        if config.overlap:
            terms["overlap"] = losses.overlap(surface, rays.weight, sigma_max=sigma_max)
            weights["overlap"] = losses.overlap_weight(config, fraction)
        total = sum((weights[name] * term for name, term in terms.items()), start=surface.new_zeros(()))
        return {"total": total, **{name: term.detach() for name, term in terms.items()}}

    def _densities(
        self, encoded: Encoded, points: Float[Tensor, "batch frame ray 3"]
    ) -> tuple[Float[Tensor, "batch frame slot ray"], Float[Tensor, "image slot ray hidden"]]:
        """Density logits of all slots at world points, and what their colours are made from."""
        model = self.config.model
        flat = rearrange(self.to_units(points), "b f ray xyz -> (b f) ray xyz")
        code = fourier_code(flat, first=model.first_octave, last=model.last_octave)
        logits, hidden = self.field.density(code, encoded.slots.codes)
        return rearrange(logits, "(b f) slot ray -> b f slot ray", b=len(points)), hidden

    def _colours(
        self, encoded: Encoded, hidden: Tensor, points: Float[Tensor, "batch frame ray 3"], rays: Rays
    ) -> Float[Tensor, "batch frame slot ray 3"]:
        """Colours of all slots; a point takes the input image's features at its pixel, none from behind the camera."""
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
    """The slot that attends most to each pixel."""
    rows, columns = encoded.features.shape[1:3]
    maps = rearrange(
        encoded.slots.attention, "i slot (rows columns) -> i slot rows columns", rows=rows, columns=columns
    )
    return F.interpolate(maps, size=encoded.size, mode="bilinear", align_corners=False).argmax(dim=1)


def _largest(owners: Int[Tensor, "image height width"], valid: Tensor, *, slots: int) -> Int[Tensor, " image"]:
    """The slot with most pixels of each image."""
    pixels = F.one_hot(owners.flatten(1), slots) * valid.flatten(1)[..., None]
    return pixels.sum(dim=1).argmax(dim=-1)


def _swapped(
    owners: Int[Tensor, "image height width"], first: Int[Tensor, " image"]
) -> Int[Tensor, "image height width"]:
    """Slots numbered such that one of each image is 0, and slot 0 has its number."""
    number = first[:, None, None].expand_as(owners)
    return torch.where(owners == number, 0, torch.where(owners == 0, number, owners))
